"""``straight``: to the camera point, then straight along the approach; fruits are ignored."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from optipromp.core.arrays import FloatArray
from optipromp.core.budget import Budget
from optipromp.core.errors import Code, InvalidRequestError
from optipromp.core.planning.planners import WAY
from optipromp.core.planning.result import Failed, Planned
from optipromp.core.planning.task import Task
from optipromp.core.planning.timing import shortest
from optipromp.core.robots import ik
from optipromp.core.robots.ik import level
from optipromp.core.scenes.scene import PoseGoal

SPEED = 0.1  # [m/s] of the tool after the camera point, as in the other planners
STEP = 0.04  # [rad or m] largest motion of a joint between two waypoints: a choice
LINE_STEP = 0.005  # [m] between two tool points of a line: a choice
FOLLOWED = 1e-5  # [m] largest error of inverse kinematics on a line that counts as followed


@dataclass(frozen=True)
class Straight:
    """The tool moves to the camera point, stops, and moves straight along the approach.

    Each part is a line of the tool point, followed by inverse kinematics from the start with the
    timing of least jerk. Where the arm cannot follow the first line, it moves in joint space to a
    branch of inverse kinematics that reaches the target. Obstacles are ignored.
    """

    name: ClassVar[str] = "straight"
    ignores: ClassVar[tuple[str, ...]] = WAY

    def solve(self, task: Task, budget: Budget) -> Planned | Failed:
        parts = _parts(task)
        if parts is None:
            away = "no configuration follows the approach line to the target"
            return Failed(Code.GOAL_UNREACHABLE, away)
        q = np.vstack([parts[0], parts[1][1:]])
        q[1:] = level(task.robot, q, task.scene.frame[0], path=True)[1:]
        return gently(task, q)


def gently(task: Task, q: FloatArray) -> Planned:
    """The plan through waypoints ``q`` (T, n), from the camera point on no faster than SPEED."""
    first = None
    if task.neighbours and isinstance(task.goal, PoseGoal):
        points, _ = task.robot.tool_pose(q)
        first = int(np.argmin(np.linalg.norm(points - task.camera, axis=1)))
    return Planned(shortest(task.robot, q, first, SPEED), first or 0)


def _parts(task: Task) -> tuple[FloatArray, FloatArray] | None:
    """Waypoints (m, n) from start to camera point, and on to the target; None where unreachable."""
    if not isinstance(task.goal, PoseGoal):
        raise InvalidRequestError("straight needs a target, or a goal with position and axis alone")
    robot, goal, axis = task.robot, task.goal.position, task.goal.axis
    camera = task.camera
    point, pointing = robot.tool_pose(task.start)
    there, missed = ik.track(robot, *_line(point, camera, pointing, axis), task.start)
    ahead, off = ik.track(robot, *_line(camera, goal, axis, axis), there[-1])
    if max(missed.max(), off.max()) < FOLLOWED:
        first = np.vstack([task.start, there])
        return _least_jerk(first), _least_jerk(np.vstack([there[-1], ahead]))
    best: tuple[float, FloatArray] | None = None
    for end in ik.solve(robot, goal, axis, near=task.start[None], rest=task.start).joints:
        back, off = ik.track(robot, *_line(goal, camera, axis, axis), end)
        turn = float(np.max(np.abs(back[-1] - task.start)))
        if off.max() < FOLLOWED and (best is None or turn < best[0]):
            best = turn, np.vstack([end, back])[::-1]
    if best is None:
        return None
    return _least_jerk(np.vstack([task.start, best[1][0]])), _least_jerk(best[1])


def _line(
    begin: FloatArray, end: FloatArray, first: FloatArray, last: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Tool points (m, 3) and axes (m, 3) from ``begin`` to ``end``, ``begin`` left out."""
    count = max(2, int(np.ceil(np.linalg.norm(end - begin) / LINE_STEP)))
    share = np.linspace(0.0, 1.0, count + 1)[1:, None]
    axes = first + share * (last - first)
    return begin + share * (end - begin), axes / np.linalg.norm(axes, axis=1, keepdims=True)


def _least_jerk(path: FloatArray) -> FloatArray:
    """Waypoints (T, n) along a path (m, n) with the timing 10 τ³ − 15 τ⁴ + 6 τ⁵."""
    lengths = np.max(np.abs(np.diff(path, axis=0)), axis=1)
    along = np.concatenate([[0.0], np.cumsum(np.maximum(lengths, 1e-12))])
    count = max(10, int(np.ceil(1.9 * along[-1] / STEP)))  # the middle is 1.9 times as fast
    tau = np.linspace(0.0, 1.0, count + 1)
    share = along[-1] * (10.0 * tau**3 - 15.0 * tau**4 + 6.0 * tau**5)
    return np.stack([np.interp(share, along, column) for column in path.T], axis=1)
