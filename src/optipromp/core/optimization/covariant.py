r"""Covariant gradient descent, the update of CHOMP (Zucker et al. 2013) and of the paper.

:math:`\xi \leftarrow \xi - \gamma A^{-1} \bar\nabla F(\xi)`. A is the metric of finite differences:
:math:`\tfrac12\xi^\top A\,\xi=\tfrac12\int\lVert\ddot\xi\rVert^2dt` over the free waypoints of a
trajectory that rests at both ends. A step is therefore smooth. At a fixed end the step and its
slope are 0. The step length γ is halved where F does not fall.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_solve_banded, cholesky_banded

from optipromp.core.arrays import FloatArray
from optipromp.core.budget import Budget
from optipromp.core.optimization.gauss_newton import Result
from optipromp.core.optimization.problem import ANCHOR, Problem

TRIES = 20  # smooth corrections of a trajectory beyond its limits, before it is clipped: a choice
BEYOND = 1e-9  # [rad or m] a joint this little beyond its limit is within it: rounding


@dataclass(frozen=True)
class DescentOptions:
    """Step lengths, and when to stop.

    Attributes:
        iterations: largest number of steps.
        step: change of the joint that moves most in the first step [rad or m].
        grow: factor on γ after a step that lowered F.
        halvings: largest number of trials of γ in an iteration; where none lowers F, the descent
            ends.
        tolerance: the descent ends when a step lowers F by at most this share.
    """

    iterations: int = 100
    step: float = 0.05
    grow: float = 1.5
    halvings: int = 12
    tolerance: float = 1e-5


def descend(
    problem: Problem, q: FloatArray, options: DescentOptions, budget: Budget | None = None
) -> Result:
    """Descend from ``q`` (T, n) on the problem's merit; fixed waypoints do not change.

    After each step the trajectory is drawn within the joint limits (:func:`within_limits`).
    """
    factor = _factor(problem)
    q = within_limits(problem, factor, q)
    value = problem.evaluate(q)
    history, message, gamma, taken = [value.costs], "iteration limit", 0.0, 0
    for _ in range(options.iterations):
        if budget is not None and budget.spent():
            message = budget.ending
            break
        direction = _solved(problem, factor, problem.gradient())
        largest = float(np.abs(direction).max())
        gamma = gamma or options.step / max(largest, 1e-12)
        for _ in range(options.halvings):
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
        q, value, gamma, taken = trial, new, options.grow * gamma, taken + 1
        history.append(value.costs)
        if gain <= options.tolerance * value.merit:
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
