"""What entries share: planners that follow a tool path of their own, and the harm of weights."""

from abc import abstractmethod
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from optipromp.core.arrays import FloatArray
from optipromp.core.budget import Budget
from optipromp.core.errors import Code
from optipromp.core.planning import Plan, plan
from optipromp.core.planning.planners import OptiProMP, goal_configurations
from optipromp.core.planning.result import Answer, Failed
from optipromp.core.planning.task import Task, pushed_aside, spaced
from optipromp.core.pushing.model import PushModel
from optipromp.core.pushing.path import ToolPath
from optipromp.core.scenes.scene import PoseGoal, Scene
from optipromp_bench.primitive import COUNT, path_of


@dataclass(frozen=True)
class Pathed(OptiProMP):
    """A planner that makes a tool path of its own, which the arm follows as it follows ours."""

    @property
    def approaches(self) -> bool:
        """No other approach is tried: the path is of this one."""
        return False

    @abstractmethod
    def path(self, task: Task, model: PushModel | None, seed: int) -> ToolPath:
        """The tool path for a task; the push model is None where nothing is to be pushed."""

    def solve(self, task: Task, budget: Budget, only: ToolPath | None = None) -> Answer:
        """See :class:`optipromp.core.planning.planners.Planner`."""
        if not isinstance(task.goal, PoseGoal):
            return Failed(Code.GOAL_UNREACHABLE, "a tool path needs a goal with place and axis")
        chosen = goal_configurations(pushed_aside(task), budget)
        if not len(chosen.q):
            return chosen.failed
        path = self.path(task, task.push_model(chosen.q[0]), task.seed)
        return super().solve(task, budget, only or path)


def harm_of(task: Task, model: PushModel, weights: FloatArray, states: int) -> float:
    """The predicted harm of weights (2, COUNT) of a primitive."""
    points = path_of(task, weights.reshape(2, COUNT)).points
    axes = task.axes(np.linspace(0.0, 1.0, len(points)))
    return model.harm(*spaced(points, axes), states)


class Refusing:
    """A planner of its own as an entry; it knows the push model, and refuses by it."""

    planner: ClassVar[Pathed]

    def plan(self, scene: Scene, seed: int) -> Plan:
        """See :class:`optipromp_bench.tracks.Planning`."""
        return plan(scene, planner=self.planner, seed=seed)
