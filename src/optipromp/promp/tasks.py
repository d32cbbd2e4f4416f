r"""The maximum a posteriori trajectory through task points, by iterated linearisation.

The tool's pose depends on the weights only through the joints at the m phases of the points,
:math:`q = (q_1 \ldots q_m) = \Phi w`, so the search runs there. Every weight vector worth
considering is :math:`w = \mu_w + \Sigma_w\Phi^T a`; with :math:`\Sigma_q = \Phi\Sigma_w\Phi^T`

.. math:: q = \mu_q + \Sigma_q a, \qquad
          (w - \mu_w)^T\Sigma_w^{-1}(w - \mu_w) = a^T\Sigma_q a,

which asks for no inverse and allows a singular :math:`\Sigma_w`. Points ask for
:math:`g(q) = x` up to a variance R (0: exactly). With residual :math:`e = x - g(q)` and Jacobian J,

.. math:: \lambda = (J\Sigma_q J^T + R)^{-1}(e + J(q - \mu_q)), \qquad a = J^T\lambda

is the minimiser of the linearised problem (Gauss-Newton, or sequential quadratic programming
where R = 0). Far from the mean the linearisation misleads, so the step towards it is cut to at
most a radian and halved until the merit
:math:`\tfrac12 a^T\Sigma_q a + \tfrac12\sum e^2/R + \nu\|e_{R=0}\|` falls below the largest of the
last three. Where steps must be halved, a proximal term in the prior's own metric
:math:`\tfrac\rho2\|w - w_k\|^2_{\Sigma_w^{-1}}` shortens the next; where none helps, Levenberg
damping is added to R (near a singular configuration). Exact rows left open at the end are closed
by steps of least change.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from optipromp.arrays import BoolArray, FloatArray
from optipromp.errors import InvalidRequestError
from optipromp.promp import kernels
from optipromp.promp.points import TaskPoint, as_matrix

TaskMap = Callable[[FloatArray], tuple[FloatArray, FloatArray, FloatArray, FloatArray]]
"""q (m, n) -> tool point (m, 3), unit tool axis (m, 3), their Jacobians (m, 3, n) each."""

_LARGEST_STEP: Final = 1.0
_HALVINGS: Final = 6
_MEMORY: Final = 3
_SETTLED: Final = 1e-3
_CLOSING: Final = 1e-10
_CLOSING_STEPS: Final = 60


@dataclass(frozen=True, eq=False)
class Rows:
    """Task points as scalar rows: 3 of position, turned so that their errors are independent,
    and 2 of the axis if any point has one.

    Attributes:
        position: (m, 3) targets [m].
        turn: (m, 3, 3) rows are the directions of the position rows.
        axis: (m, 3) unit targets.
        with_axis: (m,) which points have one.
        variance: (m, r), r = 3 or 5; 0: exact. 1 in the unused rows of points without axis.
    """

    position: FloatArray
    turn: FloatArray
    axis: FloatArray
    with_axis: BoolArray
    variance: FloatArray

    @staticmethod
    def of(points: Sequence[TaskPoint]) -> "Rows":
        """Rows of the given points."""
        m = len(points)
        position, axis = np.empty((m, 3)), np.zeros((m, 3))
        with_axis = np.array([point.axis is not None for point in points])
        variance = np.zeros((m, 5 if with_axis.any() else 3))
        turn = np.zeros((m, 3, 3))
        turn[:, (0, 1, 2), (0, 1, 2)] = 1.0
        for i, point in enumerate(points):
            position[i] = point.position
            if isinstance(point.covariance, np.ndarray):
                values, vectors = np.linalg.eigh(as_matrix(point.covariance, 3))
                values[values < 1e-14 * max(float(values[-1]), 0.0)] = 0.0
                turn[i], variance[i, :3] = vectors.T, values
            else:
                variance[i, :3] = point.covariance or 0.0
            if point.axis is not None:
                axis[i] = point.axis
                variance[i, 3:] = point.axis_covariance or 0.0
            else:
                variance[i, 3:] = 1.0
        return Rows(position, turn, axis, with_axis, variance)

    def evaluate(self, task_map: TaskMap, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Residuals (m, r) and Jacobian (m, r, n) at joints q (m, n).

        Raises:
            InvalidRequestError: the task map returns a wrong shape or a value that is not finite.
        """
        m, n = q.shape
        outputs = [np.ascontiguousarray(part, dtype=np.float64) for part in task_map(q)]
        shapes = [part.shape for part in outputs]
        if shapes != [(m, 3), (m, 3), (m, 3, n), (m, 3, n)]:
            raise InvalidRequestError(
                f"task_map: expected point ({m}, 3), axis ({m}, 3) and their Jacobians "
                f"({m}, 3, {n}), got {shapes}"
            )
        point, axis, point_jacobian, axis_jacobian = outputs
        residual, jacobian, finite = kernels.residuals(
            point,
            axis,
            point_jacobian,
            axis_jacobian,
            self.position,
            self.turn,
            self.axis,
            self.with_axis,
            self.variance.shape[1],
        )
        if not finite:
            raise InvalidRequestError("task_map returned a value that is not finite")
        return residual, jacobian


@dataclass(frozen=True, eq=False)
class Solution:
    """Where the iteration ended.

    Attributes:
        multipliers: a (m, n).
        residual: (m, r) at the end.
        jacobian: (m, r, n) at the end.
        iterations: linearisations used.
        missed: largest residual of an exact row.
        converged: exact rows are met and the merit has settled.
    """

    multipliers: FloatArray
    residual: FloatArray
    jacobian: FloatArray
    iterations: int
    missed: float
    converged: bool


def solve(
    rows: Rows,
    task_map: TaskMap,
    mean: FloatArray,
    covariance: FloatArray,
    start: FloatArray,
    iterations: int,
    tolerance: float,
) -> Solution:
    """Minimise over the joints at the points; see the module.

    Args:
        rows: what is asked.
        task_map: forward kinematics with Jacobians.
        mean: μ_q (m, n).
        covariance: Σ_q (mn, mn), point-major.
        start: a (m, n) to begin with.
        iterations: at most so many.
        tolerance: of exact rows [m, rad].
    """
    variance = rows.variance
    a = start
    offset = (covariance @ a.reshape(-1)).reshape(mean.shape)
    residual, jacobian = rows.evaluate(task_map, mean + offset)
    history = [kernels.merit(a, offset, residual, variance)]
    hold, damping, penalty = 0.0, 0.0, 0.0
    done, settled = 0, False
    while done < iterations and not settled:
        done += 1
        half, total = kernels.spread(jacobian, covariance)
        for attempt in range(16):
            a_step, o_step, largest, force, cost, off = kernels.step(
                jacobian, residual, half, total, variance, a, offset, hold, damping
            )
            share = min(1.0, _LARGEST_STEP / largest) if largest > 0.0 else 1.0
            penalty = max(1.5 * force, 0.25 * penalty)
            gain = history[-1][0] - cost + penalty * (history[-1][1] - off)
            ceiling = max(past[0] + penalty * past[1] for past in history[-_MEMORY:])
            ceiling += 1e-12 * abs(ceiling)
            found = False
            for _ in range(_HALVINGS if gain >= 0.0 else 0):
                try_a, try_o = a + share * a_step, offset + share * o_step
                try_residual, try_jacobian = rows.evaluate(task_map, mean + try_o)
                reached = kernels.merit(try_a, try_o, try_residual, variance)
                if reached[0] + penalty * reached[1] <= ceiling - 1e-4 * share * gain:
                    found = True
                    break
                share *= 0.5
            if found:
                break
            if attempt % 2 == 0:
                hold = max(4.0 * hold, 0.25)
            else:
                damping = max(100.0 * damping, 1e-6)
        if not found:
            break
        a, offset, residual, jacobian = try_a, try_o, try_residual, try_jacobian
        history.append(reached)
        damping = 0.01 * damping if damping > 1e-7 else 0.0
        if share < 1.0 and largest < _LARGEST_STEP:
            hold = max(2.0 * hold, 0.25)
        else:
            hold = hold / 3.0 if hold > 0.05 else 0.0
        settled = share == 1.0 and gain * (1.0 + hold) <= _SETTLED * (1.0 + abs(reached[0]))
    a, offset, residual, jacobian = _close(
        rows, task_map, mean, covariance, (a, offset, residual, jacobian)
    )
    missed = kernels.merit(a, offset, residual, variance)[2]
    return Solution(a, residual, jacobian, done, missed, settled and missed <= tolerance)


_State = tuple[FloatArray, FloatArray, FloatArray, FloatArray]


def _close(
    rows: Rows, task_map: TaskMap, mean: FloatArray, covariance: FloatArray, state: _State
) -> _State:
    """Close exact rows left open by damped steps of least change; the others are let go."""
    exact = rows.variance == 0.0
    a, offset, residual, jacobian = state
    missed = float((residual[exact] ** 2).sum())
    nothing = np.zeros_like(a)
    damping = 0.0
    for _ in range(_CLOSING_STEPS):
        if missed <= _CLOSING**2:
            break
        half, total = kernels.spread(jacobian, covariance)
        a_step, o_step, largest, *_ = kernels.step(
            jacobian,
            np.where(exact, residual, 0.0),
            half,
            total,
            np.where(exact, 0.0, 1e6 * (total.diagonal().max() + 1e-300)),
            nothing,
            nothing,
            0.0,
            damping,
        )
        share = min(1.0, 0.5 / largest) if largest > 0.0 else 1.0
        try_a, try_o = a + share * a_step, offset + share * o_step
        try_residual, try_jacobian = rows.evaluate(task_map, mean + try_o)
        reached = float((try_residual[exact] ** 2).sum())
        if reached < missed:
            a, offset, residual, jacobian = try_a, try_o, try_residual, try_jacobian
            missed = reached
            damping = 0.1 * damping if damping > 1e-6 else 0.0
        elif damping > 1e3:
            break
        else:
            damping = max(10.0 * damping, 1e-4)
    return a, offset, residual, jacobian
