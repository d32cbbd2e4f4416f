r"""Gauss-Newton on the penalised problem, in the covariant metric.

Each step solves :math:`(H + \nu A)\,\delta = -g`. H is the Gauss-Newton curvature of all costs
and penalties; it is block-banded over the waypoints. A is the finite-difference metric of CHOMP; it
keeps a step smooth where the costs have no curvature. ν is a Levenberg-Marquardt damping. The
penalties stiffen in a few stages.

A start whose penalties are small beside its cost begins at the last stage: softer penalties would
let the trajectory drift into obstacles that it already avoids.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg.lapack import dpbsv

from optipromp.core.arrays import FloatArray
from optipromp.core.budget import Budget
from optipromp.core.optimization.problem import Problem, Value


@dataclass(frozen=True)
class GaussNewtonOptions:
    """Stages of penalty stiffness, iterations in each, and when to stop.

    Attributes:
        stages: factors on the constraints, one per stage.
        iterations: largest number of steps in each stage.
        tolerance: a stage ends when a step lowers the objective by at most this share, or is not
            expected to lower it by more.
        damping: ν at the beginning.
        largest_step: of a joint [rad or m].
        kept: a start begins at the last stage where its penalty is at most this share of its cost.
    """

    stages: tuple[float, ...] = (0.02, 1.0)
    iterations: tuple[int, ...] = (8, 16)
    tolerance: float = 5e-2
    damping: float = 1e-5
    largest_step: float = 0.3
    kept: float = 0.3

    def keeps(self, value: Value) -> bool:
        """Whether the constraints hold so nearly that the last stage is enough."""
        return value.penalty <= self.kept * value.cost


@dataclass(frozen=True, eq=False)
class Result:
    """The result of a solver.

    Attributes:
        q: (T, n) the trajectory.
        value: the objective at ``q``.
        history: value of each cost after each iteration, the start first.
        iterations: number of steps.
        message: why the solver stopped.
    """

    q: FloatArray
    value: Value
    history: tuple[dict[str, float], ...]
    iterations: int
    message: str


def solve(
    problem: Problem,
    q: FloatArray,
    options: GaussNewtonOptions,
    budget: Budget | None = None,
    stages: slice = slice(None),
    value: Value | None = None,
) -> Result:
    """Descend from ``q`` (T, n) through the given penalty stages.

    Args:
        problem: to be solved.
        q: initial trajectory; its fixed waypoints do not change.
        options: see :class:`GaussNewtonOptions`.
        budget: asked before each iteration; the solver stops when it is spent.
        stages: which of the penalty stages to run.
        value: of ``q`` in the first of these stages, if the problem evaluated ``q`` last.
    """
    q = np.array(q)
    n = q.shape[1]
    history: list[dict[str, float]] = []
    taken = 0
    damping = options.damping
    message = "converged"
    free = slice(problem.first, problem.last + 1)
    for scale, limit in zip(options.stages[stages], options.iterations[stages], strict=True):
        if value is None or history:
            value = problem.evaluate(q, scale)
        if not history:
            history.append(value.costs)
        gradient, curvature = problem.gradient(), problem.curvature()
        message = "iteration limit"
        for _ in range(limit):
            if budget is not None and budget.spent():
                return Result(q, value, tuple(history), taken, budget.ending)
            down = -gradient[free].ravel()
            matrix = curvature + damping * problem.metric
            _, step, info = dpbsv(matrix, down, lower=1, overwrite_ab=1)
            if info != 0 or not np.isfinite(step).all():
                damping = max(damping * 30.0, 1e-6)
                continue
            expected = 0.5 * float(down @ step)
            step = step.reshape(-1, n)
            largest = float(np.abs(step).max(initial=0.0))
            if largest > options.largest_step:
                step *= options.largest_step / largest
            trial = q.copy()
            trial[free] += step
            new = problem.evaluate(trial, scale)
            taken += 1
            gain = value.merit - new.merit
            if gain > 0.0:
                q, value = trial, new
                damping = max(damping * 0.2, 1e-8)
            else:
                damping *= 8.0
            history.append(value.costs)
            enough = options.tolerance * value.merit
            if 0.0 < gain < enough or (gain <= 0.0 and expected < 0.25 * enough) or largest < 1e-6:
                message = "converged"
                break
            if gain > 0.0:
                gradient, curvature = problem.gradient(), problem.curvature()
    assert value is not None  # there is at least one stage
    return Result(q, value, tuple(history), taken, message)
