"""Bunches as wild as those in pictures of plantations: the preset ``wild``.

The quantiles are counted from the labels of 1,704 strawberries in 300 public pictures (StrawDI with
key points; Tafuro et al., ICRA 2022), as a standing camera sees them: across is y, up is z. Many of
those fruits lie on beds, whose stems may be level. A fruit that hangs pulls its stem down, so the
tail of the inclinations (73 degrees at 90 %) ends at :data:`STEEPEST`; the quantiles up to 75 %
hold. Leaves of rich pictures hide stems' ends (:mod:`optipromp.laboratory.simulation.leaves`).
"""

from dataclasses import replace

import numpy as np

from optipromp.core.arrays import FloatArray, frame_along, rotation
from optipromp.core.geometry.shapes import Cone, Ellipsoid, Shape, Sphere
from optipromp.core.scenes.pose import Pose
from optipromp.core.scenes.scene import Scene, SceneObject, Stem
from optipromp.laboratory.generate import bunches
from optipromp.laboratory.generate.checks import OverlapError
from optipromp.laboratory.generate.plants import TIP, physical

STEEPEST = np.deg2rad(60.0)  # [rad] of a hanging stem off the vertical, as seen: a choice
SHARES = (0.0, 0.10, 0.25, 0.50, 0.75, 0.90, 1.0)
LONGER = (1.05, 1.12, 1.23, 1.37, 1.56, 1.89, 2.0)  # length over width; the ends: choices
LEAN = np.minimum(np.deg2rad((0.0, 3.0, 8.0, 18.0, 40.0, 73.0, 90.0)), STEEPEST)  # [rad]
CROOKED = np.deg2rad((0.0, 1.5, 4.0, 9.0, 15.0, 24.0, 30.0))  # [rad] of a fruit off its stem
FRUITS = (1.0, 2.0, 3.0, 4.0, 6.0, 8.0, 9.0)
"""Besides the target: 3, 5 and 9 in all at 10, 50 and 90 %."""
NEAR_SHARES = (0.0, 0.05, 0.10, 0.25, 0.50, 1.0)
NEAR = (0.62, 0.70, 0.87, 1.21, 2.10, 5.2)
"""So that the nearest neighbours are 0.67, 0.78, 1.03 and 1.6 widths away at 5, 10, 25 and 50 %."""
GAP = 0.001  # [m] between the bounding balls of two neighbours: a choice
DEEPER = 0.012  # [m] standard deviation of a fruit's depth behind another: a choice
PLACES = 60  # tries to place a fruit before the scene is sampled again: a choice


def drawn(rng: np.random.Generator, values: FloatArray | tuple[float, ...]) -> float:
    """A number whose quantiles at :data:`SHARES` are ``values``."""
    return float(np.interp(rng.random(), SHARES, values))


def count(rng: np.random.Generator) -> int:
    """Number of pushables."""
    return round(drawn(rng, FRUITS))


def sample(name: str, pushables: int, rng: np.random.Generator) -> Scene:
    """One sample of a target and ``pushables`` fruits."""
    scene = bunches.sample(name, 0, False, None, rng)
    ripe = scene.objects[0]
    fruits = [_hung("ripe", "target", ripe.radius, ripe.position, rng)]
    for k in range(pushables):
        wide = float(rng.uniform(*bunches.FRUIT_RADII))
        fruits.append(_beside(f"n{k + 1}", wide, fruits, rng))
    return replace(scene, objects=tuple(physical(fruits, rng)))


def _beside(
    name: str, wide: float, fruits: list[SceneObject], rng: np.random.Generator
) -> SceneObject:
    """A fruit beside one of ``fruits``, as far from it in the picture as neighbours are."""
    for _ in range(PLACES):
        near = fruits[int(rng.integers(len(fruits)))]
        away = float(np.interp(rng.random(), NEAR_SHARES, NEAR)) * 2.0 * wide
        turn = float(rng.uniform(0.0, 2.0 * np.pi))
        flat = away * np.array([0.0, np.cos(turn), np.sin(turn)])
        made = _hung(name, "pushable", wide, near.position + flat, rng)
        room = near.shape.measure.bound + made.shape.measure.bound + GAP
        least = np.sqrt(max(room**2 - away**2, 0.0))  # behind or before, so that they do not touch
        deep = (1.0 if rng.random() < 0.5 else -1.0) * (least + abs(DEEPER * rng.standard_normal()))
        made = made.transformed(Pose(np.array([deep, 0.0, 0.0]), np.eye(3)))
        if all(_free(made, other) for other in fruits):
            return made
    raise OverlapError("no place for a fruit")


def _free(one: SceneObject, other: SceneObject) -> bool:
    """Whether two fruits surely do not touch."""
    away = float(np.linalg.norm(one.position - other.position))
    return away > one.shape.measure.bound + other.shape.measure.bound + GAP


def _hung(
    name: str, role: str, wide: float, position: FloatArray, rng: np.random.Generator
) -> SceneObject:
    """A fruit of radius ``wide`` [m] on a stem that leans across the picture, and into it."""
    lean = [drawn(rng, LEAN) * (1.0 if rng.random() < 0.5 else -1.0) for _ in range(2)]
    line = np.array([np.tan(lean[1]), np.tan(lean[0]), 1.0])
    line /= np.linalg.norm(line)
    length = float(rng.uniform(*bunches.STEM_LENGTH))
    stem = Stem(np.array([position, position + length * line]))
    ball = SceneObject(name, role, Sphere(wide), position, stem=stem)  # type: ignore[arg-type]
    shape, half = _long(wide, drawn(rng, LONGER), rng)
    turn = float(rng.uniform(0.0, 2.0 * np.pi))
    across = frame_along(line)[:, :2] @ [np.cos(turn), np.sin(turn)]
    made = bunches.hung(ball, shape, half, rotation(across, drawn(rng, CROOKED)) @ line)
    assert made.stem is not None
    return replace(made, stem=Stem(made.stem.points[0] + np.outer([0.0, length], line)))


def _long(wide: float, longer: float, rng: np.random.Generator) -> tuple[Shape, float]:
    """An ellipsoid or a cone, ``longer`` times as long as wide, and the half of its length [m]."""
    half = longer * wide
    if rng.random() < 0.5:
        return Ellipsoid((wide, wide, half)), half
    tip = wide * float(rng.uniform(*TIP))
    length = 2.0 * half - wide - tip
    return Cone(wide, tip, length), 0.5 * length + wide
