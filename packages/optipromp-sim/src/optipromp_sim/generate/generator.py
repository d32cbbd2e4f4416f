"""Random scenes: sampled, checked, and sampled again until one is possible.

The number of pushables is sampled once and stays while the rest is sampled again: otherwise crowded
scenes, which are hard to place, would be rare. The side of the gutter stays for :data:`PATIENCE`
samples.
"""

import zlib
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Literal, NamedTuple, get_args

import numpy as np

from optipromp.core.errors import InvalidRequestError, check_one_of
from optipromp.core.robots.library import NOTHING, Choice
from optipromp.core.scenes.crops import Crop, load_crop
from optipromp.core.scenes.scene import Scene
from optipromp_sim.generate import beds, bunches, plants, shelves, vines
from optipromp_sim.generate.checks import OverlapError, interpenetration, unsolvable
from optipromp_sim.generate.placing import UnfitError, at_robot

Preset = Literal[
    "cluster", "side-clusters", "table-top", "mixed", "tight", "limp", "elongated", "truss",
    "field", "shelf", "wild", "standing", "vine", "trusses",
]  # fmt: skip
PRESETS: tuple[Preset, ...] = get_args(Preset)
PANDA = "panda"
PATIENCE = 1000  # samples before the side of the gutter is sampled again
MOST_UNFIT = 30  # samples that the arm can work at from no place, before it is an error: a choice
MOST_REDRAWS = 50_000  # samples before it is an error: far more than any preset needs

Sampler = Callable[[str, int, np.random.Generator], Scene]
"""A sample of a name and a number of pushables."""


class Kind(NamedTuple):
    """What distinguishes a preset."""

    sample: Callable[..., Scene]
    fewest: int = 1  # pushables; each number up to the most has even odds
    most: int = 4
    # samples the number of pushables in place of both
    number: Callable[[np.random.Generator], int] | None = None
    gutter: bool | None = None  # whether one stands on the sampled side; None: no side is sampled
    plants: tuple[Sampler, ...] = ()  # one is sampled, and is the first argument of ``sample``
    panda_only: bool = False
    crop: str = "strawberry"  # that the fruits are of, though no scene states it; empty: of none


KINDS: Mapping[Preset, Kind] = {
    "cluster": Kind(bunches.sample, gutter=False),
    "side-clusters": Kind(partial(bunches.sample, sides=True), gutter=False),
    "table-top": Kind(bunches.sample, gutter=True),
    "mixed": Kind(partial(bunches.sample, sides=True), gutter=True),
    "tight": Kind(bunches.tight, 2),
    "limp": Kind(partial(bunches.sample, inclination=bunches.PLUMB), gutter=False),
    "elongated": Kind(bunches.elongated),
    "truss": Kind(plants.truss, 2),
    "field": Kind(plants.field, 2, plants=(bunches.sample, bunches.tight, plants.truss)),
    "shelf": Kind(shelves.sample, 2, 6, panda_only=True, crop=""),
    "wild": Kind(
        plants.wild, number=lambda rng: round(plants.of_quantiles(rng, plants.WILD_FRUITS))
    ),
    "standing": Kind(
        lambda plants, *given: plants(*given),
        2,
        5,
        plants=(beds.mushrooms, beds.asparagus),
        panda_only=True,
        crop="",
    ),
    "vine": Kind(vines.sample, 1, 3, panda_only=True, crop=""),
    "trusses": Kind(vines.trusses, 0, 2, panda_only=True, crop=""),
}


def crop_of(preset: str) -> Crop | None:
    """The crop of a preset's fruits, None of others: by it harm is judged; physics is drawn."""
    name = next((kind.crop for known, kind in KINDS.items() if known == preset), "")
    return load_crop(name) if name else None


@dataclass(frozen=True)
class GenerationReport:
    """The impossible samples before a scene."""

    preset: Preset  # of the scene
    seed: int  # of the scene
    redraws: int  # number of impossible samples
    # number of impossible samples by reason
    reasons: Mapping[str, int] = field(default_factory=dict)


def generate(
    preset: Preset, seed: int, robot: str | Path = PANDA, choice: Choice = NOTHING,
    crop: Crop | None = None,
) -> Scene:  # fmt: skip
    """The scene of a preset and a seed; see :func:`generate_with_report`."""
    return generate_with_report(preset, seed, robot, choice, crop)[0]


def generate_with_report(
    preset: Preset, seed: int, robot: str | Path = PANDA, choice: Choice = NOTHING,
    crop: Crop | None = None,
) -> tuple[Scene, GenerationReport]:  # fmt: skip
    """Sample a random scene.

    docs/reference/scenes.md describes the presets.

    A scene is sampled again only where objects interpenetrate, or where no arm could solve it: the
    target out of reach, inside something static, a stem rooted where the cup must pass, or every
    goal configuration in collision.

    Args:
        preset: one of :data:`PRESETS`.
        seed: not negative; the same seed gives the same scene.
        robot: name or path. The base of any but the built-in Panda is placed so that the robot
            reaches the scene (:mod:`optipromp_sim.generate.placing`), where no one place
            serves for each scene anew. The sampled world is the same, in the frame of that base.
        choice: of the arm in the robot's file.
        crop: whose fruits take the place of the preset's
            (:func:`optipromp_sim.generate.plants.with_fruits_of`); None: the preset's.

    Raises:
        InvalidRequestError: an unknown preset or a negative seed; another robot than the Panda, or
            a crop, for a shelf, a bed or a vine; a robot that can work at none of
            :data:`MOST_UNFIT` samples from any place.
        InvalidRobotError: a robot that cannot be loaded.
    """
    check_one_of("preset", preset, PRESETS)
    if seed < 0:
        raise InvalidRequestError(f"seed is {seed}; it must not be negative")
    other = robot != PANDA
    kind = KINDS[preset]
    if other and kind.panda_only:
        raise InvalidRequestError(f"scenes of the preset {preset} are for the built-in panda only")
    if crop is not None and not kind.crop:
        raise InvalidRequestError(f"the preset {preset} has objects of its own: it takes no crop")
    rng = np.random.default_rng([zlib.crc32(preset.encode()), seed])
    reasons: Counter[str] = Counter()
    count = kind.number(rng) if kind.number else int(rng.integers(kind.fewest, kind.most + 1))
    sample, unfits = kind.sample, 0
    if kind.plants:
        sample = partial(sample, kind.plants[int(rng.integers(len(kind.plants)))])
    for tried in range(MOST_REDRAWS):
        if kind.gutter is not None and tried % PATIENCE == 0:
            side = bunches.GUTTER_SIDES[int(rng.integers(len(bunches.GUTTER_SIDES)))]
            sample = partial(kind.sample, gutter=side) if kind.gutter else kind.sample
        try:
            scene = sample(f"{preset}-{seed}", count, rng)
            scene = scene if crop is None else plants.with_fruits_of(scene, crop, rng)
        except OverlapError as overlap:
            reasons[str(overlap)] += 1
            continue
        fault = interpenetration(scene)
        if fault is None:
            try:
                scene = at_robot(scene, robot, choice) if other else scene
            except UnfitError as unfit:
                reasons[unfit.requirement] += 1
                unfits += 1
                if unfits >= MOST_UNFIT:
                    raise InvalidRequestError(f"{scene.name}: {unfit}") from None
                continue
            fault = unsolvable(scene)
        if fault is None:
            report = GenerationReport(preset, seed, reasons.total(), dict(sorted(reasons.items())))
            return scene, report
        reasons[fault] += 1
    raise InvalidRequestError(  # cannot happen with the presets above
        f"no possible scene of {preset} within {MOST_REDRAWS} samples: {dict(reasons)}"
    )
