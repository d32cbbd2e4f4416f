"""The speed of the tool among hanging fruits: push prediction holds for a slow tool."""

import numpy as np

from optipromp.core.arrays import BoolArray, FloatArray, IntArray
from optipromp.core.compiled import kernel
from optipromp.core.judging.curve import along
from optipromp.core.judging.kinematics import Body, body_of, carried, segments
from optipromp.core.judging.passing import pushables_of
from optipromp.core.robots.model import Robot
from optipromp.core.scenes.scene import Scene
from optipromp.core.trajectory import Trajectory

PUSHED = 0.1  # [m/s] largest speed of the tool for which push prediction holds
FASTER = 0.1  # [-] share by which a trajectory may exceed PUSHED: a choice
NEAR = 0.02  # [m] tool to fruit: a choice, several standard deviations of a well-known position
PARTS = 8  # of the time between two checks; the speed is a mean over one part: a choice


def among_fruits(
    scene: Scene,
    robot: Robot,
    trajectory: Trajectory,
    rows: IntArray,
    points: FloatArray,
    axes: FloatArray,
) -> tuple[float, float] | None:
    """Largest speed of the tool among hanging pushables [m/s], and its time [s].

    The tool counts as a cylinder of the gripper's radius from flange to rim. The tool is among
    fruits where the distance to one of them, in its first place, is below :data:`NEAR`.

    Args:
        scene: with the fruits.
        robot: with the scene's tool.
        trajectory: of the robot.
        rows: (T,) indices of the waypoints among the checks.
        points, axes: (M, 3) tool points [m] and tool axes at the checks.

    Returns:
        None where the tool is never among fruits, no target hangs, or the robot has no tool.
    """
    target, tool = scene.target, robot.tool
    if tool is None or target is None or target.stem is None:
        return None
    objects, near = pushables_of(scene, robot.gripper_radius), np.zeros(len(points), dtype=bool)
    mark(
        np.array(points), np.array(axes), np.array(objects.places[objects.hangs]),
        np.array(objects.radii[objects.hangs]) + NEAR, robot.gripper_radius, tool.reach, tool.depth,
        near,
    )  # fmt: skip
    if not near.any():
        return None
    times, q, _ = along(trajectory, PARTS * np.diff(rows))
    fast = speeds(body_of(robot), times, q, np.repeat(near[1:] | near[:-1], PARTS))
    worst = int(np.argmax(fast))
    return float(fast[worst]), float(times[worst])


def too_fast(speed: float | None) -> bool:
    """Whether a ``speed`` among fruits [m/s] is above that for which push prediction holds."""
    return speed is not None and speed > PUSHED * (1.0 + FASTER)


@kernel
def mark(points, axes, places, reach, radius, behind, ahead, near):
    """Set ``near`` (M,) where the tool is near a fruit.

    Args:
        points, axes: (M, 3) tool points [m] and tool axes.
        places, reach: (K, 3) centres of the fruits; (K,) distance to the tool's surface below which
            each is near [m].
        radius, behind, ahead: of the tool, and its length on either side of the tool point [m].
        near: written in place.
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
