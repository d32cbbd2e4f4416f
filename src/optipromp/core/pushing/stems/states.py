"""The states of fruits on stems in which a path is tried: the perceived one, and sampled ones."""

from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from optipromp.core.arrays import FloatArray, frozen
from optipromp.core.pushing.parameters import PUSH
from optipromp.core.pushing.rules import detection_variance
from optipromp.core.pushing.stems.bending import Stems, balls_of, bowed, moved, parents, stems
from optipromp.core.pushing.stems.parting import part
from optipromp.core.scenes.scene import SceneObject

HANGING = PUSH.hanging
STIFFNESS_SPREAD = PUSH.beam.stiffness_spread


@lru_cache(maxsize=4)  # by identity: all approaches to a target meet the same fruits
def sampled(
    fruits: tuple[SceneObject, ...], searched: int, states: int, vertical: tuple[float, ...]
) -> Stems:
    """The states that a path is searched in, the perceived one first; then those that tell harm.

    A path that was chosen for some states does better there than elsewhere. So its harm is told by
    ``states`` others, which are spread as the errors are. Those of the search are spread wider.
    """
    up, samples = np.array(vertical), searched - 1 + states
    wider = np.where(np.arange(samples) < searched - 1, HANGING.wider, 1.0)[:, None]
    cases = _cases(fruits, up)
    seen, count = cases[0], len(fruits)
    sure = [fruit.covariance is None for fruit in fruits]
    spread = np.array(
        [HANGING.shift if known else np.sqrt(detection_variance(fruit))
         for known, fruit in zip(sure, fruits, strict=True)]
    ) * np.where(sure, 1.0, wider)  # fmt: skip
    degrees = [HANGING.turn if known else HANGING.detected_turn for known in sure]
    turn = np.deg2rad(degrees) * seen.length
    shifted, swung = _normal((samples, len(fruits), 3))
    shift = spread[..., None] * shifted
    swing = turn[:, None] * (swung - (swung @ up)[..., None] * up)  # level
    place = np.array([balls_of(fruit).center for fruit in fruits])
    places = np.concatenate([place[None], place + shift])
    roots = np.concatenate([seen.root[None], seen.root + shift + swing])
    part(places, roots, seen.radius, seen.above, (1.0 - seen.upper) * seen.length)
    size, turn = _uniform((2, (samples + 1) * count))
    beam = PUSH.beam
    size = beam.bow_least + size * (beam.bow_most - beam.bow_least)
    return bowed(moved(cases, roots, places), size, 2.0 * np.pi * turn)


def _cases(fruits: Sequence[SceneObject], up: FloatArray) -> list[Stems]:
    """The stems as told or assumed; where that is a belief, also softer ones and stiffer ones.

    The stems of a plant are alike: in one case all of them are softer.
    """
    wide = np.array([_spread(fruit) for fruit in fruits])
    if (wide == 1.0).all():
        return [stems(fruits, up)]
    factors = np.stack([np.ones(len(fruits)), 1.0 / wide, wide])
    if (parents(fruits) >= 0).any():
        return [stems(fruits, up, factor) for factor in factors]
    every, count = stems([*fruits] * len(factors), up, factors.ravel()), len(fruits)
    return [
        Stems(*(values[k : k + count] for values in every))
        for k in range(0, len(factors) * count, count)
    ]


def _spread(fruit: SceneObject) -> float:
    """The factor by which a stem may well be softer or stiffer than told, or than assumed."""
    assumed = 1.0 if "stem_stiffness" in fruit.physical else STIFFNESS_SPREAD
    return fruit.physical.get("stem_stiffness_spread", assumed)


@lru_cache(maxsize=16)
def _uniform(shape: tuple[int, ...]) -> FloatArray:
    """Numbers between 0 and 1, always the same."""
    return frozen(np.random.default_rng(1).random(shape))


@lru_cache(maxsize=16)
def _normal(shape: tuple[int, ...]) -> tuple[FloatArray, FloatArray]:
    """Two arrays of standard normal numbers, always the same."""
    rng = np.random.default_rng(0)
    return frozen(rng.standard_normal(shape)), frozen(rng.standard_normal(shape))
