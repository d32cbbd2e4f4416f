"""The states of fruits on stems in which a path is tried: the perceived state, and samples."""

from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from optipromp.core.arrays import FloatArray, frozen
from optipromp.core.pushing.parameters import PUSH
from optipromp.core.pushing.rules import detection_variance
from optipromp.core.pushing.stems.bending import Stems, balls_of, bowed, moved, parents, stems
from optipromp.core.pushing.stems.parting import part
from optipromp.core.scenes.objects import UNSEEN_SPREAD
from optipromp.core.scenes.scene import SceneObject

HANGING = PUSH.hanging
STIFFNESS_SPREAD = PUSH.beam.stiffness_spread


@lru_cache(maxsize=4)  # by identity: all approaches to a target meet the same fruits
def sampled(
    fruits: tuple[SceneObject, ...], searched: int, states: int, vertical: tuple[float, ...]
) -> Stems:
    """``searched`` states for the search, the perceived one first, then ``states`` for the harm.

    A path does better in the states that it was chosen in: its harm is predicted in other states.
    The samples for the harm have the spread of the errors, those for the search a wider spread.
    """
    up, samples = np.array(vertical), searched - 1 + states
    wider = np.where(np.arange(samples) < searched - 1, HANGING.wider, 1.0)[:, None]
    cases = _cases(fruits, up)
    seen, count = cases[0], len(fruits)
    sure = [fruit.covariance is None for fruit in fruits]
    deviation = np.sqrt([detection_variance(fruit) for fruit in fruits])
    spread = np.where(sure, HANGING.shift, deviation * wider)
    turn = np.where(sure, HANGING.turn, HANGING.detected_turn)
    told = [None if fruit.stem is None else fruit.stem.tilt for fruit in fruits]
    turn = np.array([own if own is not None else by for own, by in zip(told, turn, strict=True)])
    turn = np.deg2rad(turn) * seen.length
    shifted, swung = _normal((samples, len(fruits), 3))
    shift = spread[..., None] * shifted
    swing = turn[:, None] * (swung - (swung @ up)[..., None] * up)  # level
    place = np.array([balls_of(fruit).center for fruit in fruits])
    hidden = [fruit.stem is not None and fruit.stem.unseen for fruit in fruits]
    longer = np.exp(np.where(hidden, UNSEEN_SPREAD, 0.0) * (swung @ up)) - 1.0
    swing = swing + longer[..., None] * (seen.root - place)
    places = np.concatenate([place[None], place + shift])
    roots = np.concatenate([seen.root[None], seen.root + shift + swing])
    part(places, roots, seen.radius, seen.above, (1.0 - seen.upper) * seen.length)
    size, turn = _uniform((2, (samples + 1) * count))
    beam = PUSH.beam
    size = beam.bow_least + size * (beam.bow_most - beam.bow_least)
    return bowed(moved(cases, roots, places), size, 2.0 * np.pi * turn)


def _cases(fruits: Sequence[SceneObject], up: FloatArray) -> list[Stems]:
    """The expected stems; where stiffnesses are uncertain, also all stems softer, and all stiffer.

    The stems of a plant are alike.
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
    """Standard deviation of a stem's stiffness as a factor; 1 for a known stiffness."""
    assumed = 1.0 if "stem_stiffness" in fruit.physical else STIFFNESS_SPREAD
    return fruit.physical.get("stem_stiffness_spread", assumed)


@lru_cache(maxsize=16)
def _uniform(shape: tuple[int, ...]) -> FloatArray:
    """Uniform numbers between 0 and 1 of a fixed seed."""
    return frozen(np.random.default_rng(1).random(shape))


@lru_cache(maxsize=16)
def _normal(shape: tuple[int, ...]) -> tuple[FloatArray, FloatArray]:
    """Two arrays of standard normal numbers of a fixed seed."""
    rng = np.random.default_rng(0)
    return frozen(rng.standard_normal(shape)), frozen(rng.standard_normal(shape))
