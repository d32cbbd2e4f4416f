"""``obstacles`` and ``chomp``: planners that avoid every pushable and push none."""

from dataclasses import dataclass, replace
from typing import ClassVar

from optipromp.core.budget import Budget
from optipromp.core.optimization import covariant
from optipromp.core.optimization.costs.joints import SmoothnessCost
from optipromp.core.optimization.costs.obstacles import ObstacleCost
from optipromp.core.optimization.problem import Problem
from optipromp.core.planning.options import PaperOptions
from optipromp.core.planning.planner import WAY
from optipromp.core.planning.planners import ConditionedProMP, OptiProMP
from optipromp.core.planning.result import Failed, Harmful, Planned
from optipromp.core.planning.task import Task
from optipromp.core.scenes.scene import Scene
from optipromp.laboratory.planners.straight import gently


@dataclass(frozen=True)
class Avoiding(OptiProMP):
    """opti-promp with every pushable in the role of an object to avoid.

    The obstacle cost keeps the whole robot, tool included, away from it.
    """

    name: ClassVar[str] = "obstacles"
    ignores: ClassVar[tuple[str, ...]] = ("waypoints",)  # it is timed anew

    @property
    def approaches(self) -> bool:
        """False: approaches are compared by their push prediction, and nothing is pushed here."""
        return False

    def solve(self, task: Task, budget: Budget) -> Planned | Failed | Harmful:
        """See :class:`optipromp.core.planning.planner.Planner`."""
        made = super().solve(avoiding(task), budget)
        if isinstance(made, Harmful):  # there is no other approach
            made = super().solve(made.task, budget)
        return gently(task, made.trajectory.positions) if isinstance(made, Planned) else made


@dataclass(frozen=True)
class Chomp:
    """CHOMP: covariant gradient descent from the trajectory of the planner ``promp``.

    The objective is F_s + F_d over all body spheres + ``smoothness`` · ½∫‖ξ̈‖² dt. The start and
    the goal configuration stay.

    Attributes:
        epsilon: ε, the safety distance of the obstacle cost [m].
        smoothness: weight of ½∫‖ξ̈‖² dt beside the obstacle functionals; a choice.
    """

    epsilon: float = PaperOptions.epsilon
    smoothness: float = 1e-5
    name: ClassVar[str] = "chomp"
    ignores: ClassVar[tuple[str, ...]] = WAY

    def solve(self, task: Task, budget: Budget) -> Planned | Failed:
        """See :class:`optipromp.core.planning.planner.Planner`."""
        made = ConditionedProMP().solve(task, budget)
        if not isinstance(made, Planned):
            assert isinstance(made, Failed)
            return Failed(made.code, made.message)
        problem = self.problem(task, made.trajectory.n_waypoints)
        found = covariant.descend(problem, made.trajectory.positions, covariant.DescentOptions())
        return gently(task, found.q)

    def problem(self, task: Task, waypoints: int) -> Problem:
        """The objective over ``waypoints`` waypoints; the first and the last are fixed."""
        costs = [
            *(ObstacleCost(name, 1.0, self.epsilon, "sum") for name in ("static", "avoid")),
            ObstacleCost("tool avoid", 1.0, self.epsilon, "sum"),
            SmoothnessCost(self.smoothness),
        ]
        around = avoiding(task).surroundings
        return Problem(
            task.robot, around, costs, (), waypoints, cutoff=self.epsilon + 1e-3, end_fixed=True,
            body=task.body,
        )  # fmt: skip


def avoiding(task: Task) -> Task:
    """The task in which every pushable is a neighbour to be avoided."""
    return replace(task, scene=as_obstacles(task.scene), neighbours=(), passed=())


def as_obstacles(scene: Scene) -> Scene:
    """The scene with every pushable in the role of a neighbour to be avoided."""
    objects = tuple(
        replace(item, role="avoid") if item.role == "pushable" else item for item in scene.objects
    )
    return replace(scene, objects=objects)
