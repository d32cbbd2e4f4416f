"""The speed of the tool among what it pushes: push prediction holds for a slow tool."""

import math

import numpy as np

from optipromp.core.arrays import BoolArray, FloatArray, IntArray
from optipromp.core.compiled import inner, kernel
from optipromp.core.judging.curve import along
from optipromp.core.judging.distances import (
    PUSHABLE,
    apart_by,
    inside,
    nearest,
    objects_of,
    to_surface,
)
from optipromp.core.judging.kinematics import Body, body_of, carried, centers, segments
from optipromp.core.judging.passing import pushables_of
from optipromp.core.robots.model import Robot
from optipromp.core.scenes.scene import Scene
from optipromp.core.trajectory import Trajectory

PUSHED = 0.1  # [m/s] largest speed of the tool for which push prediction holds
BESIDE = 0.03  # [m/s] the same among objects that stand: at 0.05 m/s packs are pressed with 10 N
FASTER = 0.1  # [-] share by which a trajectory may exceed either: a choice
NEAR = 0.02  # [m] tool to fruit: a choice, several standard deviations of a well-known position
TOUCHED = 0.01  # [m] body to an object that stands: a choice, less than the planner's distance
LEVEL = math.sin(math.radians(5.0))  # [-] of an approach that pushes what stands: a choice
CONFIGURATIONS = 4_000  # measured together: 10 MB of sphere centres
PARTS = 8  # of the time between two checks; the speed is a mean over one part: a choice


def among_fruits(
    scene: Scene,
    robot: Robot,
    trajectory: Trajectory,
    rows: IntArray,
    points: FloatArray,
    axes: FloatArray,
) -> tuple[float, float] | None:
    """Largest speed of the tool among pushables [m/s], and its time [s].

    Where :func:`stands` applies, the speed is that near objects that stand: nearer than
    :data:`TOUCHED` to the first place of one of them is any part of the body. Else it is the speed
    near pushables that hang.

    The tool counts as a cylinder of the gripper's radius from flange to rim. The tool is among
    fruits where the distance to one of them, in its first place, is below :data:`NEAR`.

    ``scene``: with the fruits. ``robot``: with the scene's tool. ``trajectory``: of the robot.
    ``rows``: (T,) indices of the waypoints among the checks. ``points``, ``axes``: (M, 3) tool
    points [m] and tool axes at the checks.

    Returns:
        None where the tool is never among pushables, neither applies, or the robot has no tool.
    """
    target, tool, near = scene.target, robot.tool, np.zeros(len(points), dtype=bool)
    if tool is None or target is None:
        return None
    if stands(scene):
        q = np.array(along(trajectory, np.diff(rows))[1])
        return _fastest(robot, trajectory, rows, _touching(scene, robot, q))
    if target.stem is None:
        return None
    objects = pushables_of(scene, robot.gripper_radius)
    moves = np.array([name in scene.drifting for name in objects.ids], dtype=bool)
    tools = [(points, objects.hangs & ~moves)]
    for k in np.flatnonzero(moves).tolist():  # the tool relative to what is where it is at time 0
        by = scene.drifting[objects.ids[k]].at(along(trajectory, np.diff(rows))[0])
        tools.append((points - by + objects.places[k], np.arange(len(moves)) == k))
    for at, which in tools:
        mark(
            np.array(at), np.array(axes), np.array(objects.places[which]),
            np.array(objects.radii[which]) + NEAR, robot.gripper_radius, tool.reach, tool.depth,
            near,
        )  # fmt: skip
    return _fastest(robot, trajectory, rows, near)


def _fastest(
    robot: Robot, trajectory: Trajectory, rows: IntArray, near: BoolArray
) -> tuple[float, float] | None:
    """Largest speed of the tool [m/s] and its time [s] where it is ``near`` (M,) at the checks."""
    if not near.any():
        return None
    times, q, _ = along(trajectory, PARTS * np.diff(rows))
    fast = speeds(body_of(robot), times, q, np.repeat(near[1:] | near[:-1], PARTS))
    worst = int(np.argmax(fast))
    return float(fast[worst]), float(times[worst])


def stands(scene: Scene) -> bool:
    """Whether the approach is level, and a pushable without a stem stands in the scene."""
    if scene.target is None:
        return False
    steep = max(abs(float(axis @ scene.up)) for axis in scene.frame[1:])
    return steep < LEVEL and any(item.stem is None for item in scene.pushables)


def largest(scene: Scene) -> float:
    """The largest speed for which push prediction holds in the scene [m/s]."""
    return BESIDE if stands(scene) else PUSHED


def too_fast(scene: Scene, speed: float | None) -> bool:
    """Whether a ``speed`` among pushables [m/s] is above that for which push prediction holds."""
    return speed is not None and speed > largest(scene) * (1.0 + FASTER)


def _touching(scene: Scene, robot: Robot, q: FloatArray) -> BoolArray:
    """Whether any part of the body is near the first place of an object that stands, at ``q``."""
    objects, rest = objects_of(scene)
    loose = np.flatnonzero(objects.role == PUSHABLE)
    held = [item.stem is None for item in scene.objects_at(objects.rows[loose])]
    loose, near = loose[np.array(held, dtype=bool)], np.zeros(len(q), dtype=bool)
    radius = np.array(robot.spheres.radius)
    for start in range(0, len(q), CONFIGURATIONS):
        spheres, part = centers(robot, q[start : start + CONFIGURATIONS]), slice(start, None)
        for k in loose:
            beside(objects, k, spheres, radius, near[part])
        for item in rest:
            if item.role == "pushable" and item.stem is None:
                for m, row in enumerate(spheres):
                    away = nearest(item, row[None], radius, TOUCHED)[0]
                    near[start + m] |= away < TOUCHED
    return near


@inner
def beside(objects, k, spheres, radius, near):
    """Set ``near`` where one of spheres (M, B, 3) is near object ``k``; ``radius`` (B,) [m]."""
    size, p = objects.size[k], objects.position
    for m in range(spheres.shape[0]):
        for b in range(radius.shape[0]):
            reach = radius[b] + TOUCHED
            if near[m] or apart_by(spheres[m], b, p, k) > objects.bound[k] + reach:
                continue
            x, y, z = inside(objects.rotation, p, k, spheres[m], b)
            if to_surface(objects.kind[k], size[0], size[1], size[2], x, y, z) < reach:
                near[m] = True


@kernel
def mark(points, axes, places, reach, radius, behind, ahead, near):
    """Set ``near`` (M,) where the tool is near a fruit.

    ``points``, ``axes``: (M, 3) tool points [m] and tool axes. ``places``, ``reach``: (K, 3)
    centres of the fruits; (K,) distance to the tool's surface below which each is near [m].
    ``radius``, ``behind``, ``ahead``: of the tool, and its length on either side of the tool point
    [m]. ``near``: written in place.
    """
    for m in range(len(points)):
        for k in range(len(places)):
            along = squared = 0.0
            for i in range(3):
                off = places[k, i] - points[m, i]
                along += off * axes[m, i]
                squared += off * off
            aside = radius + reach[k]
            if (
                -behind - reach[k] < along < ahead + reach[k]
                and squared - along * along < aside * aside
            ):
                near[m] = True
                break


@kernel
def speeds(body: Body, times: FloatArray, q: FloatArray, asked: BoolArray) -> FloatArray:
    """Mean speeds (M-1,) of the tool point between configurations ``q`` (M, n) [m/s].

    Intervals that are not ``asked`` (M-1,) get 0.
    """
    count = body.driver.shape[0]
    turns, origins = np.empty((count, 3, 3)), np.empty((count, 3))
    out, here, before = np.zeros(len(asked)), np.zeros(3), np.zeros(3)
    for m in range(len(q)):
        if not (m < len(asked) and asked[m]) and not (m > 0 and asked[m - 1]):
            continue
        segments(body, q[m], turns, origins)
        before[:] = here
        here[0], here[1], here[2] = carried(turns, origins, count - 1, body.tool, 0)
        if m > 0 and asked[m - 1]:
            out[m - 1] = np.sqrt(((here - before) ** 2).sum()) / (times[m] - times[m - 1])
    return out
