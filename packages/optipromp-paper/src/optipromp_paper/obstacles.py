r"""``obstacles`` and ``chomp``: planners that avoid every pushable and push none.

:func:`descend` is covariant gradient descent, the update of CHOMP (Zucker et al. 2013) and of the
paper: :math:`\xi \leftarrow \xi - \gamma A^{-1} \bar\nabla F(\xi)`. A is the metric of finite
differences: :math:`\tfrac12\xi^\top A\,\xi=\tfrac12\int\lVert\ddot\xi\rVert^2dt` over the free
waypoints of a trajectory that rests at both ends. A step is therefore smooth. At a fixed end the
step and its slope are 0. The step length γ is halved where F does not fall.
"""

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from scipy.linalg import cho_solve_banded, cholesky_banded

from optipromp.core.arrays import FloatArray
from optipromp.core.budget import Budget
from optipromp.core.optimization.costs.joints import SmoothnessCost
from optipromp.core.optimization.costs.obstacles import ObstacleCost
from optipromp.core.optimization.gauss_newton import Result
from optipromp.core.optimization.problem import ANCHOR, Problem
from optipromp.core.planning.conditioned import ConditionedProMP
from optipromp.core.planning.planners import WAY, OptiProMP
from optipromp.core.planning.result import Answer, Failed, Planned, Proposal
from optipromp.core.planning.task import Task, changed
from optipromp.core.pushing.path import ToolPath
from optipromp.core.scenes.scene import Scene
from optipromp_paper.paper_costs import PaperSettings
from optipromp_paper.straight import gently

TRIES = 20  # smooth corrections of a trajectory beyond its limits, before it is clipped: a choice
FIRST_STEP = 0.05  # [rad or m] of the joint that moves most: a choice
GROW = 1.5  # factor on γ after a step that lowered F: a choice
HALVINGS = 12  # of γ in an iteration; where none lowers F, the descent ends: a choice
TOLERANCE = 1e-5  # the descent ends when a step lowers F by at most this share: a choice
BEYOND = 1e-9  # [rad or m] a joint this little beyond its limit is within it: rounding


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

    def solve(self, task: Task, budget: Budget, only: ToolPath | None = None) -> Answer:
        made = super().solve(avoiding(task), budget, only)
        if isinstance(made, Proposal):  # there is no other approach
            made = made.made()
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

    epsilon: float = PaperSettings.epsilon
    smoothness: float = 1e-5
    name: ClassVar[str] = "chomp"
    ignores: ClassVar[tuple[str, ...]] = WAY

    def solve(self, task: Task, budget: Budget) -> Planned | Failed:
        made = ConditionedProMP().solve(task, budget)
        if not isinstance(made, Planned):
            assert isinstance(made, Failed)
            return Failed(made.code, made.message)
        problem = self.problem(task, made.trajectory.n_waypoints)
        found = descend(problem, made.trajectory.positions, budget)
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
        )  # fmt: skip


def avoiding(task: Task) -> Task:
    """The task in which every pushable is a neighbour to be avoided."""
    return changed(replace(task, scene=as_obstacles(task.scene), neighbours=()), passed=())


def as_obstacles(scene: Scene) -> Scene:
    """The scene with every pushable in the role of a neighbour to be avoided."""
    return scene.each(lambda item: replace(item, role="avoid") if item.role == "pushable" else item)


def descend(problem: Problem, q: FloatArray, budget: Budget, iterations: int = 100) -> Result:
    """Descend from ``q`` (T, n) on the problem's merit; fixed waypoints do not change.

    After each step the trajectory is drawn within the joint limits (:func:`within_limits`).
    """
    factor = _factor(problem)
    q = within_limits(problem, factor, q)
    value = problem.evaluate(q)
    history, message, gamma, taken = [value.costs], "iteration limit", 0.0, 0
    for _ in range(iterations):
        if budget.spent():
            message = budget.ending
            break
        direction = _solved(problem, factor, problem.gradient())
        largest = float(np.abs(direction).max())
        gamma = gamma or FIRST_STEP / max(largest, 1e-12)
        for _ in range(HALVINGS):
            trial = within_limits(problem, factor, q - gamma * direction)
            new = problem.evaluate(trial)
            if new.merit < value.merit:
                break
            gamma *= 0.5
        else:
            problem.evaluate(q)
            message = "no step lowers the objective"
            break
        gain = value.merit - new.merit
        q, value, gamma, taken = trial, new, GROW * gamma, taken + 1
        history.append(value.costs)
        if gain <= TOLERANCE * value.merit:
            message = "converged"
            break
    return Result(q, value, tuple(history), taken, message)


def within_limits(problem: Problem, factor: FloatArray, q: FloatArray) -> FloatArray:
    """``q`` (T, n), drawn within the joint limits by smooth changes; fixed waypoints do not change.

    As in CHOMP, the excess over the limits is smoothed by :math:`A^{-1}` and scaled such that the
    joint with the largest excess comes to its limit. This is repeated until no joint exceeds its
    limits.
    """
    robot = problem.robot
    for _ in range(TRIES):
        beyond = q - np.clip(q, robot.lower, robot.upper)
        beyond[: problem.first], beyond[problem.last + 1 :] = 0.0, 0.0
        at = np.unravel_index(np.argmax(np.abs(beyond)), q.shape)
        if abs(beyond[at]) < BEYOND:
            break
        smooth = _solved(problem, factor, beyond)
        q = q - (beyond[at] / smooth[at]) * smooth
    out, free = q.copy(), slice(problem.first, problem.last + 1)
    out[free] = np.clip(q[free], robot.lower, robot.upper)
    return out


def _factor(problem: Problem) -> FloatArray:
    """The banded Cholesky factor of A: the problem's metric without its anchor."""
    metric = np.array(problem.metric)
    metric[0] -= ANCHOR * problem.dt
    return np.asarray(cholesky_banded(metric, lower=True))


def _solved(problem: Problem, factor: FloatArray, right: FloatArray) -> FloatArray:
    """:math:`A^{-1}` times ``right`` (T, n) over the free waypoints; 0 at the others."""
    free, out = slice(problem.first, problem.last + 1), np.zeros(right.shape)
    solved = cho_solve_banded((factor, True), right[free].ravel())
    out[free] = solved.reshape(-1, right.shape[1])
    return out
