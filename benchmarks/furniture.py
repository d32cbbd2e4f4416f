"""Goals in joints among furniture: a bookshelf, a box, a cage, a laid table, under a table.

The families are those of MotionBenchMaker (Chamzas et al., 2022); the measures are our own. The
hand ends in the furniture. It begins near home, or elsewhere in the furniture.
"""

import zlib
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np

from optipromp.core.arrays import BoolArray, FloatArray
from optipromp.core.geometry import distances
from optipromp.core.geometry.shapes import Box, Cylinder
from optipromp.core.planning.task import posed
from optipromp.core.robots import ik
from optipromp.core.robots.model import Robot
from optipromp.core.scenes.scene import JointGoal, Scene, SceneObject, ToolSpec, obstacles_of
from optipromp_sim.generate.checks import OverlapError

Furniture = Literal["bookshelf", "box", "cage", "table-pick", "under-table"]
FURNITURE: tuple[Furniture, ...] = get_args(Furniture)

THICK = 0.02  # [m] of boards and walls
CLEARANCE = 0.01  # [m] of the body spheres from what stands there, at start and goal
TILT = 0.35  # [rad] of the hand, at most, from the family's way of reaching
NEAR_HOME = 0.3  # [rad] of a start's joints from home, at most
FAR_ENOUGH = 1.0  # [rad] between start and goal, at least, as a norm
POSES = 40  # poses of the hand tried before the furniture is sampled again
POSE_STARTS = 16  # of the inverse kinematics of a pose

DOWN, LEVEL = np.array([0.0, 0.0, -1.0]), np.array([1.0, 0.0, 0.0])


@dataclass(frozen=True, eq=False)
class Place:
    """Where the tool point may be: a box between two corners (3,) [m], and the way of reaching."""

    low: FloatArray
    high: FloatArray
    along: FloatArray


Sampler = Callable[[np.random.Generator], tuple[list[SceneObject], list[Place]]]


def generate(family: Furniture, seed: int) -> Scene:
    """The scene of a family and a seed: sampled again until start and goal are free."""
    rng = np.random.default_rng([zlib.crc32(family.encode()), seed])
    while True:
        with suppress(OverlapError):
            return sample(family, f"{family}-{seed}", rng)


def sample(family: Furniture, name: str, rng: np.random.Generator) -> Scene:
    """One scene of a family.

    Raises:
        OverlapError: no free start or goal was found.
    """
    objects, places = FAMILIES[family](rng)
    scene = Scene(
        name=name,
        robot="panda",
        tool=ToolSpec("franka_hand"),
        objects=tuple(objects),
        goal=JointGoal(np.zeros(7)),
    )
    robot, _ = posed(scene)
    goal = _reaching(scene, robot, places, rng)
    start = _near_home(scene, robot, rng)
    if rng.random() < 0.5:
        start = _reaching(scene, robot, places, rng)
    if np.linalg.norm(goal - start) < FAR_ENOUGH:
        raise OverlapError("start beside the goal")
    return replace(scene, start=start, goal=JointGoal(goal))


def _near_home(scene: Scene, robot: Robot, rng: np.random.Generator) -> FloatArray:
    q = robot.home + rng.uniform(-NEAR_HOME, NEAR_HOME, (POSES, robot.n_joints))
    found = np.flatnonzero(_free(scene, robot, np.clip(q, robot.lower, robot.upper)))
    if not len(found):
        raise OverlapError("no free start near home")
    return np.asarray(np.clip(q[found[0]], robot.lower, robot.upper))


def _reaching(
    scene: Scene, robot: Robot, places: list[Place], rng: np.random.Generator
) -> FloatArray:
    """A free configuration (n,) with the hand in one of the places."""
    for _ in range(POSES):
        place = places[int(rng.integers(len(places)))]
        axis = place.along + np.tan(TILT) * rng.uniform(-1.0, 1.0, 3)
        axis /= np.linalg.norm(axis)
        point, seed = rng.uniform(place.low, place.high), int(rng.integers(2**31))
        found = ik.solve(robot, point, axis, starts=POSE_STARTS, seed=seed).joints
        if not len(found):
            continue
        q = np.array(found[int(rng.integers(len(found)))])
        q[-1] = rng.uniform(robot.lower[-1], robot.upper[-1])
        if _free(scene, robot, q[None])[0]:
            return q
    raise OverlapError("no free goal among the furniture")


def _free(scene: Scene, robot: Robot, q: FloatArray) -> BoolArray:
    """(m,) whether ``q`` (m, n) keep :data:`CLEARANCE` from the furniture, and touch not the arm.

    The planner's own check (:mod:`optipromp.core.planning.collision`) knows no clearance.
    """
    away, _ = distances(obstacles_of(scene, "static"), robot.sphere_centers(q).reshape(-1, 3))
    room = (away.min(axis=1).reshape(len(q), -1) - robot.spheres.radius).min(axis=1)
    apart = robot.self_gaps(q).min(axis=1, initial=0.0)
    return np.asarray((room >= CLEARANCE) & (apart >= 0.0))


def _box(name: str, size: tuple[float, float, float], *position: float) -> SceneObject:
    return SceneObject(name, "static", Box(size), np.array(position))


def _bookshelf(rng: np.random.Generator) -> tuple[list[SceneObject], list[Place]]:
    """Three bays, one over another, some with things that stand in them."""
    front, depth = float(rng.uniform(0.45, 0.60)), float(rng.uniform(0.25, 0.35))
    wide, middle = float(rng.uniform(0.6, 1.0)), float(rng.uniform(-0.15, 0.15))
    tall, low = float(rng.uniform(0.28, 0.40)), float(rng.uniform(-0.1, 0.15))
    x, top = front + 0.5 * depth, low + 3 * tall
    objects = [
        _box(f"board-{i}", (depth, wide, THICK), x, middle, low + i * tall) for i in range(4)
    ]
    for side, sign in (("left", 1.0), ("right", -1.0)):
        wall = (depth, THICK, 3 * tall + THICK)
        objects.append(_box(side, wall, x, middle + sign * 0.5 * (wide + THICK), 0.5 * (low + top)))
    back = (THICK, wide + 2 * THICK, 3 * tall + THICK)
    objects.append(_box("back", back, front + depth + 0.5 * THICK, middle, 0.5 * (low + top)))
    places = []
    for i in range(3):
        floor = low + i * tall + 0.5 * THICK
        for k in range(int(rng.integers(0, 3))):
            height, radius = float(rng.uniform(0.08, 0.18)), float(rng.uniform(0.025, 0.04))
            y = middle + float(rng.uniform(-0.4, 0.4)) * wide
            at = np.array([front + float(rng.uniform(0.4, 0.8)) * depth, y, floor + 0.5 * height])
            objects.append(SceneObject(f"can-{i}{k}", "static", Cylinder(radius, height), at))
        places.append(
            Place(
                np.array([front + 0.05, middle - 0.35 * wide, floor + 0.08]),
                np.array([front + 0.6 * depth, middle + 0.35 * wide, floor + tall - 0.10]),
                LEVEL,
            )
        )
    return objects, places


def _open_box(rng: np.random.Generator) -> tuple[list[SceneObject], list[Place]]:
    """A box that is open at its top, reached into from above."""
    size = rng.uniform([0.35, 0.40, 0.15], [0.50, 0.60, 0.28])
    at = np.array([*rng.uniform([0.45, -0.25], [0.60, 0.25]), float(rng.uniform(-0.1, 0.1))])
    objects = _walls(at, size)
    half, height = 0.5 * size[:2] - 0.10, float(size[2])
    low, high = at + [*-half, 0.05], at + [*half, 0.7 * height]
    return objects, [Place(low, high, DOWN)]


def _walls(at: FloatArray, size: FloatArray) -> list[SceneObject]:
    """Floor and four walls of a box whose floor's middle is ``at`` (3,) [m]."""
    (x, y, z), (dx, dy, dz) = at.tolist(), size.tolist()
    return [
        _box("floor", (dx, dy, THICK), x, y, z - 0.5 * THICK),
        _box("front", (THICK, dy, dz), x - 0.5 * dx, y, z + 0.5 * dz),
        _box("back", (THICK, dy, dz), x + 0.5 * dx, y, z + 0.5 * dz),
        _box("left", (dx, THICK, dz), x, y + 0.5 * dy, z + 0.5 * dz),
        _box("right", (dx, THICK, dz), x, y - 0.5 * dy, z + 0.5 * dz),
    ]


def _cage(rng: np.random.Generator) -> tuple[list[SceneObject], list[Place]]:
    """A cage of upright bars with a roof, reached into between the bars."""
    edge, height = float(rng.uniform(0.45, 0.60)), float(rng.uniform(0.40, 0.55))
    at = np.array([*rng.uniform([0.55, -0.2], [0.70, 0.2]), float(rng.uniform(-0.05, 0.15))])
    x, y, z = at.tolist()
    plate = (edge, edge, THICK)
    objects = [_box("floor", plate, x, y, z - 0.5 * THICK), _box("roof", plate, x, y, z + height)]
    bars = int(rng.integers(2, 4))  # on a side
    for k in range(4 * (bars - 1)):
        side, step = divmod(k, bars - 1)
        along, across = (step / (bars - 1) - 0.5) * edge, -0.5 * edge
        for _ in range(side):  # a quarter turn for each side
            along, across = -across, along
        bar = Cylinder(0.01, height)
        place = np.array([x + across, y + along, z + 0.5 * height])
        objects.append(SceneObject(f"bar-{k}", "static", bar, place))
    reach = np.array([0.3 * edge, 0.3 * edge])
    low, high = at + [*-reach, 0.10], at + [*reach, height - 0.10]
    return objects, [Place(low, high, LEVEL)]


def _table(rng: np.random.Generator, height: float) -> list[SceneObject]:
    size, x = rng.uniform([0.6, 0.9], [0.8, 1.3]), float(rng.uniform(0.58, 0.65))
    top = _box("table", (float(size[0]), float(size[1]), THICK), x, 0.0, height - 0.5 * THICK)
    legs = [
        _box(
            f"leg-{i}", (0.04, 0.04, 0.6),
            x + sx * (0.5 * float(size[0]) - 0.03), sy * (0.5 * float(size[1]) - 0.03),
            height - THICK - 0.3,
        )
        for i, (sx, sy) in enumerate(((-1, -1), (-1, 1), (1, -1), (1, 1)))
    ]  # fmt: skip
    return [top, *legs]


def _table_pick(rng: np.random.Generator) -> tuple[list[SceneObject], list[Place]]:
    """Things on a table; the hand comes down between them."""
    height = float(rng.uniform(0.0, 0.25))
    objects = _table(rng, height)
    for k in range(int(rng.integers(5, 10))):
        tall = float(rng.uniform(0.08, 0.30))
        at = np.array([*rng.uniform([0.35, -0.45], [0.85, 0.45]), height + 0.5 * tall])
        shape: Box | Cylinder = Cylinder(float(rng.uniform(0.03, 0.06)), tall)
        if rng.random() < 0.5:
            shape = Box((*rng.uniform(0.05, 0.15, 2).tolist(), tall))
        objects.append(SceneObject(f"thing-{k}", "static", shape, at))
    low, high = np.array([0.40, -0.35, height + 0.03]), np.array([0.70, 0.35, height + 0.15])
    return objects, [Place(low, high, DOWN)]


def _under_table(rng: np.random.Generator) -> tuple[list[SceneObject], list[Place]]:
    """A goal under the table's top."""
    height = float(rng.uniform(0.40, 0.60))
    low = np.array([0.42, -0.30, height - 0.30])
    return _table(rng, height), [Place(low, np.array([0.70, 0.30, height - 0.10]), LEVEL)]


FAMILIES: dict[Furniture, Sampler] = {
    "bookshelf": _bookshelf,
    "box": _open_box,
    "cage": _cage,
    "table-pick": _table_pick,
    "under-table": _under_table,
}
