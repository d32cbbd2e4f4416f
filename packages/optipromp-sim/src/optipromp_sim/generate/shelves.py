"""A can behind other packs on a shelf: upright, without stems, approached horizontally."""

from dataclasses import dataclass

import numpy as np

from optipromp.core.arrays import FloatArray
from optipromp.core.geometry.shapes import Box, Cylinder
from optipromp.core.scenes.scene import Approach, Scene, SceneObject, ToolSpec
from optipromp_sim.generate.checks import OverlapError

BEFORE_SHELF = (-0.4001, -1.3608, 0.5859, -2.9529, 2.3117, 2.8412, -0.9618)
"""Panda with the hand level at (0.34, 0, 0.50), fingers side by side [rad]."""

# choices; a number between two ends is sampled uniformly; lengths in [m]
PACK_LOW, PACK_HIGH = (0.64, -0.04), (0.72, 0.04)  # x and y of the target
BOARD = (0.42, 0.48)  # height of the board's upper side
DEPTH = 0.12, 0.18  # of the target behind the front edge
# The tool point of a hand is 0.21 m before the wrist (link 6 of a Panda, 53 mm in radius), and a
# level hand at the middle of a can is 55 to 75 mm over the board: deeper in, the wrist would be
# among the packs with a centimetre over the board.
BEHIND = (0.06, 0.15)  # of the back wall behind the target's axis
WIDTH = (0.40, 0.70)  # of the shelf
SHIFT = 0.05  # of the shelf's middle to the side of the target, at most
HEADROOM = (0.28, 0.40)  # from board to ceiling
THICK = 0.02  # of boards and walls
ASIDE = 0.10  # of a pack to the side of the target, at most
TARGET_RADIUS, TARGET_HEIGHT = (0.022, 0.030), (0.11, 0.15)
CAN_RADIUS, PACK_EDGE, PACK_HEIGHT = (0.025, 0.033), (0.04, 0.07), (0.09, 0.16)
PLACES_TRIED = 200  # for a pack before the shelf is sampled again
GAP = 1e-3  # between packs, and from packs to walls


@dataclass(frozen=True, eq=False)
class Footprint:
    """The footprint of a pack on the board: a disc, or a rectangle with ``half`` edges (2,) [m]."""

    center: FloatArray
    radius: float  # of the disc; of the circle about the rectangle
    half: FloatArray | None = None
    yaw: float = 0.0

    @property
    def axes(self) -> FloatArray:
        """(2, 2) rows: the rectangle's edge directions."""
        c, s = np.cos(self.yaw), np.sin(self.yaw)
        return np.array([[c, s], [-s, c]])

    @property
    def corners(self) -> FloatArray:
        """(4, 2) of the rectangle [m]."""
        assert self.half is not None
        signs = np.array([[1, 1], [1, -1], [-1, -1], [-1, 1]])
        return np.asarray(self.center + (signs * self.half) @ self.axes)

    def extent(self) -> FloatArray:
        """(2,) half edges of its bounding box along the world's axes [m]."""
        if self.half is None:
            return np.full(2, self.radius)
        return np.asarray(np.abs(self.axes).T @ self.half)


def apart(one: Footprint, other: Footprint) -> bool:
    """Whether two footprints are more than :data:`GAP` apart."""
    if one.half is None and other.half is None:
        return float(np.linalg.norm(one.center - other.center)) > one.radius + other.radius + GAP
    if one.half is None:
        one, other = other, one
    assert one.half is not None
    if other.half is None:
        local = one.axes @ (other.center - one.center)
        outside = np.maximum(np.abs(local) - one.half, 0.0)
        return float(np.linalg.norm(outside)) > other.radius + GAP
    for axis in (*one.axes, *other.axes):  # separating axes
        a, b = one.corners @ axis, other.corners @ axis
        if a.min() > b.max() + GAP or b.min() > a.max() + GAP:
            return True
    return False


def sample(name: str, count: int, rng: np.random.Generator) -> Scene:
    """One sample of ``count`` packs before a can."""
    board = float(rng.uniform(*BOARD))
    at = rng.uniform(PACK_LOW, PACK_HIGH)
    front, back = float(at[0] - rng.uniform(*DEPTH)), float(at[0] + rng.uniform(*BEHIND))
    middle = float(at[1] + rng.uniform(-SHIFT, SHIFT))
    width, headroom = float(rng.uniform(*WIDTH)), float(rng.uniform(*HEADROOM))
    low = np.array([front, middle - 0.5 * width]) + GAP
    high = np.array([back, middle + 0.5 * width]) - GAP
    radius, tall = float(rng.uniform(*TARGET_RADIUS)), float(rng.uniform(*TARGET_HEIGHT))
    target = SceneObject(
        "can", "target", Cylinder(radius, tall), np.array([*at, board + 0.5 * tall])
    )
    taken = [Footprint(at, radius)]
    packs = []
    for i in range(count):
        place, height = _place(taken, at, low, high, rng), float(rng.uniform(*PACK_HEIGHT))
        taken.append(place)
        position = np.array([*place.center, board + 0.5 * height])
        if place.half is None:
            shape: Cylinder | Box = Cylinder(place.radius, height)
        else:
            shape = Box((2.0 * float(place.half[0]), 2.0 * float(place.half[1]), height))
        turn = np.eye(3)
        turn[:2, :2] = place.axes.T
        rotation = np.eye(3) if place.half is None else turn
        packs.append(SceneObject(f"n{i + 1}", "pushable", shape, position, rotation))
    return Scene(
        name=name,
        robot="panda",
        tool=ToolSpec("franka_hand"),
        start=np.array(BEFORE_SHELF),
        objects=(target, *packs, *_shelf(front, back, middle, width, board, headroom)),
        approach=Approach(np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0])),
    )


def _place(
    taken: list[Footprint],
    target: FloatArray,
    low: FloatArray,
    high: FloatArray,
    rng: np.random.Generator,
) -> Footprint:
    """A can or a box, with even odds, before the target, within the shelf, apart from ``taken``."""
    can = bool(rng.integers(2))
    radius, yaw = float(rng.uniform(*CAN_RADIUS)), float(rng.uniform(0.0, np.pi))
    half = 0.5 * rng.uniform(*PACK_EDGE, 2)
    for _ in range(PLACES_TRIED):
        center = np.array([rng.uniform(low[0], target[0]), target[1] + rng.uniform(-ASIDE, ASIDE)])
        if can:
            place = Footprint(center, radius)
        else:
            place = Footprint(center, float(np.linalg.norm(half)), half, yaw)
        reach = place.extent()
        if (center - reach < low).any() or (center + reach > high).any():
            continue
        if center[0] + reach[0] < target[0] and all(apart(place, other) for other in taken):
            return place
    raise OverlapError("no place for a pack")


def _shelf(
    front: float, back: float, middle: float, width: float, board: float, headroom: float
) -> list[SceneObject]:
    deep, x = back - front + THICK, 0.5 * (front + back + THICK)
    level = board + 0.5 * headroom
    wall = 0.5 * (width + THICK)

    def box(name: str, size: tuple[float, float, float], *position: float) -> SceneObject:
        return SceneObject(name, "static", Box(size), np.array(position))

    flat = (deep, width + 2.0 * THICK, THICK)
    return [
        box("board", flat, x, middle, board - 0.5 * THICK),
        box("ceiling", flat, x, middle, board + headroom + 0.5 * THICK),
        box("left-wall", (deep, THICK, headroom), x, middle + wall, level),
        box("right-wall", (deep, THICK, headroom), x, middle - wall, level),
        box("back-wall", (THICK, width, headroom), back + 0.5 * THICK, middle, level),
    ]
