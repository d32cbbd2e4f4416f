"""The primitive as a motion: the planners ``promp`` and ``i-promp``, without an optimisation."""

import math
from dataclasses import dataclass, replace
from typing import Annotated, ClassVar

import numpy as np
from annotated_types import Ge, Unit

from optipromp.core.arrays import FloatArray
from optipromp.core.budget import Budget, clock
from optipromp.core.planning import primitive
from optipromp.core.planning.options import Metres, Phase, Timed
from optipromp.core.planning.parameters import GOAL, PRIMITIVE, WAYPOINT
from optipromp.core.planning.planners import WAY, goal_configurations
from optipromp.core.planning.primitive import learnt
from optipromp.core.planning.result import Answer, Planned, ViaPoint
from optipromp.core.planning.task import Task
from optipromp.core.planning.timing import timed
from optipromp.core.promp.model import ProMP
from optipromp.core.pushing.rules import detection_variance, pushes
from optipromp.core.scenes.scene import PoseGoal


@dataclass(frozen=True)
class ConditionedProMP(Timed):
    """The primitive, conditioned on start, camera point and target: the planner ``promp``.

    Attributes:
        camera_phase: t_1, the phase of the camera point in (0, 1); None: 0.5.
        camera_point: whether the camera point is passed; None: as the scene says (by default yes).
        via_deviation: standard deviation with which the ProMP is held to a point [m].
    """

    camera_phase: Phase | None = None
    camera_point: bool | None = None
    via_deviation: Metres = 1e-3
    name: ClassVar[str] = "promp"
    ignores: ClassVar[tuple[str, ...]] = WAY

    def solve(self, task: Task, budget: Budget) -> Answer:
        promp = learnt(task, task.demonstrations)
        chosen = goal_configurations(task, budget, GOAL.few_starts, primitive.end(promp))
        if not len(chosen.q):
            return chosen.failed
        budget.say(self.name)
        began = clock()
        ends = np.linalg.norm(chosen.q - primitive.end(promp), axis=1)
        made = self.conditioned(task, promp, chosen.q[int(np.argmin(ends))])
        made = replace(made, time={self.name: clock() - began})
        return replace(chosen, reason="").told(made)  # the judge reports contacts at the goal

    def conditioned(self, task: Task, promp: ProMP, goal: FloatArray) -> Planned:
        """The ProMP, conditioned on start, camera point, :meth:`passed` and the ``goal`` (n,).

        The phases are evenly spaced; the arm pauses at the camera point, unless the scene or the
        settings leave the point out.
        """
        phase = self.camera_phase or PRIMITIVE.camera_phase
        branch: FloatArray | None = None
        met: tuple[ViaPoint, ...] = (ViaPoint("goal", task.robot.tool_pose(goal)[0]),)
        if isinstance(task.goal, PoseGoal) and self.through_camera(task):
            names, positions, variances = self.passed(task)
            points, deviations = primitive.via_points(task, positions, self.via_deviation)
            branch = primitive.on_branch(task, points, goal)
            if branch is not None:
                met = (*map(ViaPoint, ("camera", *names), points), *met)
        count = self.waypoints or WAYPOINT.primitive
        if branch is None:
            phases, values, spread, pause = np.array([1.0]), goal[None], np.zeros(1), None
        else:
            spread = (deviations / PRIMITIVE.lever_arm) ** 2
            spread[1:-1] += np.array(variances) / PRIMITIVE.lever_arm**2
            phases, values, pause = np.linspace(phase, 1.0, len(branch)), branch, phase
        q = primitive.led_through(promp, task.start, phases, values, spread, count, pause)
        q[-1] = goal
        first = math.ceil(phase * (count - 1))
        return Planned(timed(task, self, q, first if task.neighbours else None), first, via=met)

    def through_camera(self, task: Task) -> bool:
        """Whether the camera point is passed."""
        stated = self.camera_point
        return bool(task.scene.options.get("camera_point", True) if stated is None else stated)

    def passed(self, task: Task) -> tuple[list[str], list[FloatArray], list[float]]:
        """Names, tool points (3,) [m] and variances [m²] between the camera point and the goal."""
        return [], [], []


@dataclass(frozen=True)
class IProMP(ConditionedProMP):
    """The primitive, conditioned also on every neighbour and its pushed pose.

    Attributes:
        direction_deviation: standard deviation of the push direction [rad]; above 0 the direction
            is sampled.
        guard: the mouth is closed while the tool pushes. The closed rim, not the tool point, is led
            under each neighbour and under its pushed pose.
    """

    direction_deviation: Annotated[float, Ge(0.0), Unit("rad")] = 0.0
    guard: bool = False
    name: ClassVar[str] = "i-promp"

    def through_camera(self, task: Task) -> bool:
        """True: the pushes begin there."""
        return True

    def passed(self, task: Task) -> tuple[list[str], list[FloatArray], list[float]]:
        """Each neighbour and its pushed pose."""
        names, positions, variances = list[str](), list[FloatArray](), list[float]()
        deviation, tool = self.direction_deviation, task.robot.tool
        rng = np.random.default_rng(task.seed) if deviation > 0.0 else None
        below = 0.0 if tool is None else tool.depth
        made = pushes(task.scene, task.neighbours, task.robot.gripper_radius, rng, deviation)
        for push, item in zip(made, task.neighbours, strict=True):
            drop = task.scene.frame[2] * (below + item.radius if self.guard else 0.0)
            names += [push.id, f"{push.id} pushed"]
            positions += [push.position - drop, push.pushed - drop]
            variances += [detection_variance(item)] * 2
        return names, positions, variances
