"""Entries of the field that no planner of ours is: trees, push-aside."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from benchmarks.entries.pathed import Pathed
from benchmarks.peers import checker, grown
from optipromp.core.arrays import FloatArray, evenly_along
from optipromp.core.budget import Budget
from optipromp.core.errors import OptiPrompError
from optipromp.core.planning.planners import goal_configurations
from optipromp.core.planning.task import Task, pushed_aside, resolve
from optipromp.core.pushing.model import PushModel
from optipromp.core.pushing.parameters import PUSH
from optipromp.core.pushing.path import ToolPath, through
from optipromp.core.scenes.scene import Scene
from optipromp.core.trajectory import Trajectory
from optipromp.timing import LEAST, gentle
from optipromp_bench.entries.planners import OfPlanner


@dataclass(frozen=True)
class BesideFruits(Pathed):
    """The tool rises beside each neighbour in its way, pushes it aside, and goes on.

    After Xiong, Ge and From (2019 and 2020): from the lowest neighbour on, the tool comes up in the
    free space between neighbour and target, and moves towards the neighbour to push it away.
    """

    name: ClassVar[str] = "push-aside"
    gap: ClassVar[float] = 0.005  # [m] between tool and fruit before a push
    widest: ClassVar[float] = 0.06  # [m] of a push's way
    least: ClassVar[float] = 0.01  # [m] between heights of pushes

    def path(self, task: Task, model: PushModel | None, seed: int) -> ToolPath:
        """See :class:`Pathed`."""
        begin, end = task.camera, task.goal.position  # type: ignore[union-attr]
        frame, radius = task.scene.frame, task.robot.gripper_radius
        corners, low = [begin], float((begin - end) @ frame[2])
        for height, aside in self._pushes(task, radius):
            at = max(height - self.least, low + self.least)
            if at >= -self.least:
                break
            column = end + at * frame[2]
            corners += [column - aside @ frame[:2], column + min(self.least, -at) * frame[2]]
            low = at + self.least
        return through(np.array([*corners, end]), PUSH.hanging.speed)

    def _pushes(self, task: Task, radius: float) -> list[tuple[float, FloatArray]]:
        """Heights [m] from the target and ways (2,) [m] of pushes, the lowest first."""
        frame, end = task.scene.frame, task.goal.position  # type: ignore[union-attr]
        found: list[tuple[float, FloatArray]] = []
        for item in task.neighbours:
            off = frame @ (item.position - end)
            way, wide = off[:2], float(np.hypot(*off[:2]))
            reach = radius + item.radius + self.gap
            if wide >= reach or off[2] > 0.0:
                continue
            unit = way / wide if wide > 1e-6 else np.array([1.0, 0.0])
            found.append((float(off[2]) - item.radius, min(reach - wide, self.widest) * unit))
        merged: list[tuple[float, FloatArray]] = []
        for height, way in sorted(found, key=lambda each: each[0]):
            if merged and height - merged[-1][0] < 2.0 * self.least:  # one push for both
                low, before = merged[-1]
                both = before + way
                size = float(np.linalg.norm(both))
                merged[-1] = low, both * min(1.0, self.widest / max(size, 1e-9))
            else:
                merged.append((height, way))
        return merged


class PushAside(OfPlanner):
    """Push each fruit aside from the free space beside it; no model of the push."""

    planner = BesideFruits()


class Rrt:
    """RRT-Connect of OMPL; last link and tool may touch fruits, which are no obstacles to them."""

    def plan(self, scene: Scene, seed: int) -> Trajectory | None:
        """See :class:`optipromp_bench.tracks.Planning`; raises as :func:`grown` does."""
        task = resolve(scene)
        free = checker(task)
        try:
            ends = [q for q in goal_configurations(pushed_aside(task), Budget()).q if free(q)]
        except OptiPrompError:
            return None
        corners = grown(task, ends, free, seed) if ends else None
        return None if corners is None else gentle(scene, evenly_along(corners, LEAST))
