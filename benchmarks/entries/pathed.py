"""What entries share: planners that follow a tool path of their own."""

from abc import abstractmethod
from dataclasses import dataclass

from optipromp.core.budget import Budget
from optipromp.core.errors import Code
from optipromp.core.planning.planners import OptiProMP, goal_configurations
from optipromp.core.planning.result import Answer, Failed
from optipromp.core.planning.task import Task, pushed_aside
from optipromp.core.pushing.model import PushModel
from optipromp.core.pushing.path import ToolPath
from optipromp.core.scenes.scene import PoseGoal


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
