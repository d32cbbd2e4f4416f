"""The constraints of a path as the planner takes them: costs, and starts that keep them.

The optimisation sees a robot whose tool axis is the axis that is held upright. Where the
constraints hold, the point of the tool and this axis are those of the motion; elsewhere the nearest
that are allowed, to which inverse kinematics leads the arm.
"""

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from optipromp.core.arrays import FloatArray, frozen, lengths
from optipromp.core.optimization.costs import Cost
from optipromp.core.optimization.costs.tool import CorridorCost, UprightCost
from optipromp.core.planning.follow import Start
from optipromp.core.planning.parameters import KEPT, SOLVE
from optipromp.core.planning.task import Task
from optipromp.core.robots import ik
from optipromp.core.robots.model import Robot
from optipromp.core.scenes.goals import PathConstraints


def held(task: Task) -> Task:
    """The task whose robot has the axis that is held upright for its tool axis."""
    path = task.scene.path
    if path is None or path.upright is None:
        return task
    axis = frozen(task.robot.tool_rotation @ path.upright.axis)
    return replace(task, robot=_along(task.robot, axis))


def _along(robot: Robot, axis: FloatArray) -> Robot:
    same = float(np.abs(axis - robot.tool_axis).max()) < 1e-12  # rounding: the robot as it is
    return robot if same else replace(robot, tool_axis=axis)


def costs(path: PathConstraints | None, count: int) -> list[Cost]:
    """The penalties of a path's constraints at ``count`` waypoints, with a margin for the curve."""
    out: list[Cost] = []
    if path is None:
        return out
    if path.upright is not None:
        chord = 2.0 * math.sin(0.5 * KEPT.share * math.radians(path.upright.angle))
        out.append(UprightCost(SOLVE.kept, path.upright.direction[None], chord, 0))
    if path.plane is not None:
        points = np.tile(path.plane.point, (count, 1))
        within = KEPT.share * path.plane.within
        axes = path.plane.normal[None]
        out.append(CorridorCost(SOLVE.must, points, axes, within, 0, SOLVE.within))
    return out


def keeps(task: Task, q: FloatArray) -> FloatArray:
    """Whether configurations ``q`` (m, n) keep the constraints."""
    points, axes = held(task).robot.tool_pose(q)
    near, turned = _allowed(task.scene.path, points, axes, 1.0)
    off = lengths(points - near) + lengths(axes - turned)
    return np.asarray(off < 1e-6)  # [m or rad] rounding


def led(task: Task, start: Start) -> Start:
    """The start, led to the nearest poses of the tool that keep the constraints."""
    q = start.followed
    points, axes = task.robot.tool_pose(q)
    points, axes = _allowed(task.scene.path, points, axes, KEPT.share)
    found, errors = ik.each(task.robot, points[1:-1], axes[1:-1], q[1:-1])
    if errors.max(initial=0.0) > KEPT.reached:
        return start
    return replace(start, followed=np.vstack([q[:1], found, q[-1:]]))


def starts(task: Task, given: Iterator[Start]) -> Iterator[Start]:
    """The starts, led where the scene has constraints of a path."""
    return given if task.scene.path is None else (led(task, start) for start in given)


def _allowed(
    path: PathConstraints | None, points: FloatArray, axes: FloatArray, share: float
) -> tuple[FloatArray, FloatArray]:
    """The nearest tool points (m, 3) and axes (m, 3) within ``share`` of the limits."""
    if path is not None and path.plane is not None:
        height = (points - path.plane.point) @ path.plane.normal
        most = share * path.plane.within
        points = points - (height - np.clip(height, -most, most))[:, None] * path.plane.normal
    if path is not None and path.upright is not None:
        up, angle = path.upright.direction, share * math.radians(path.upright.angle)
        along = axes @ up
        aside = axes - along[:, None] * up
        flat = lengths(aside)
        leaning = np.arctan2(flat, along) > angle
        way = aside / np.maximum(flat, 1e-12)[:, None]
        edge = math.cos(angle) * up + math.sin(angle) * way
        axes = np.where(leaning[:, None], edge, axes)
    return points, axes
