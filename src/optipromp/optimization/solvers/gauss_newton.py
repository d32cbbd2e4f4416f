r"""Gauss-Newton on the penalised problem, in the covariant metric.

Each step solves :math:`(H + \nu A)\,\delta = -g`, with H the Gauss-Newton curvature of all terms
and penalties (block-banded over the knots), A the finite-difference metric of CHOMP (so that a step
is smooth wherever the terms do not say otherwise) and ν a Levenberg-Marquardt damping. The
penalties stiffen in a few stages.
"""

import time
from dataclasses import dataclass

import numpy as np
from scipy.linalg.lapack import dpbsv

from optipromp.arrays import FloatArray
from optipromp.optimization.problem import Problem, Value


@dataclass(frozen=True)
class GaussNewtonOptions:
    """Stages of penalty stiffness, iterations in each, and when to stop."""

    stages: tuple[float, ...] = (0.02, 1.0)
    iterations: tuple[int, ...] = (8, 16)
    tolerance: float = 2e-3
    damping: float = 1e-4
    largest_step: float = 0.3


@dataclass(frozen=True, eq=False)
class Result:
    """Where a solver stopped.

    Attributes:
        q: (T, n).
        value: the objective there.
        history: value of each term after each iteration, the start first.
        iterations: steps taken.
        message: why it stopped.
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
    deadline: float = np.inf,
    stages: slice = slice(None),
) -> Result:
    """Descend from ``q`` (T, n) through the given penalty stages.

    Args:
        problem: what to minimise.
        q: initial trajectory; its fixed knots stay as they are.
        options: see :class:`GaussNewtonOptions`.
        deadline: ``time.perf_counter()`` after which it stops with what it has.
        stages: which of the penalty stages to run (for solving many starts a stage at a time).
    """
    q = np.array(q)
    n = q.shape[1]
    history: list[dict[str, float]] = []
    taken = 0
    damping = options.damping
    message = "converged"
    value = Value(np.inf, {})
    for scale, limit in zip(options.stages[stages], options.iterations[stages], strict=True):
        value = problem.evaluate(q, scale)
        if not history:
            history.append(value.terms)
        gradient, curvature = problem.gradient(), problem.curvature()
        message, idle = "iteration limit", 0
        for _ in range(limit):
            if time.perf_counter() > deadline:
                return Result(q, value, tuple(history), taken, "time ran out")
            matrix = curvature + damping * problem.metric
            rhs = -gradient[problem.first : problem.last + 1].ravel()
            _, step, info = dpbsv(matrix, rhs, lower=1, overwrite_ab=1, overwrite_b=1)
            if info != 0 or not np.isfinite(step).all():
                damping = max(damping * 30.0, 1e-6)
                continue
            step = step.reshape(-1, n)
            largest = float(np.max(np.abs(step), initial=0.0))
            if largest > options.largest_step:
                step *= options.largest_step / largest
            trial = q.copy()
            trial[problem.first : problem.last + 1] += step
            new = problem.evaluate(trial, scale)
            taken += 1
            if new.merit < value.merit:
                gain = value.merit - new.merit
                q, value = trial, new
                gradient, curvature = problem.gradient(), problem.curvature()
                history.append(value.terms)
                damping = max(damping * 0.2, 1e-8)
                idle = idle + 1 if gain < options.tolerance * value.merit else 0
                if idle == 2:
                    message = "converged"
                    break
            else:
                history.append(value.terms)
                damping *= 8.0
                if largest < 1e-6:
                    message = "converged"
                    break
    return Result(q, value, tuple(history), taken, message)
