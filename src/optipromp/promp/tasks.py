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
where R = 0). The step towards it is cut to at most a radian and halved until the merit
:math:`\tfrac12 a^T\Sigma_q a + \tfrac12\sum e^2/R + \nu\|e_{R=0}\|` falls below the largest of the
last three; where that fails, Levenberg damping is added to R.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from optipromp.arrays import BoolArray, FloatArray
from optipromp.errors import InvalidRequestError
from optipromp.promp.gaussian import factorise
from optipromp.promp.points import TaskPoint, as_matrix

TaskMap = Callable[[FloatArray], tuple[FloatArray, FloatArray, FloatArray, FloatArray]]
"""q (m, n) -> tool point (m, 3), unit tool axis (m, 3), their Jacobians (m, 3, n) each."""

_LARGEST_STEP: Final = 1.0
_HALVINGS: Final = 6
_MEMORY: Final = 3
_STEP_TOLERANCE: Final = 1e-6


@dataclass(frozen=True, eq=False)
class Rows:
    """Task points as scalar rows: 3 of position, turned so that their errors are independent,
    and 2 of the axis if any point has one.

    Attributes:
        position: (m, 3) targets [m].
        turn: (m, 3, 3) rows are the directions of the position rows; None: the world's.
        axis: (m, 3) unit targets, or None if no point has one.
        with_axis: (m,) which points have one.
        variance: (m, r), r = 3 or 5; 0: exact. 1 in the unused rows of points without axis.
    """

    position: FloatArray
    turn: FloatArray | None
    axis: FloatArray | None
    with_axis: BoolArray
    variance: FloatArray

    @staticmethod
    def of(points: Sequence[TaskPoint]) -> "Rows":
        """Rows of the given points."""
        position = np.array([point.position for point in points])
        with_axis = np.array([point.axis is not None for point in points])
        variance = np.zeros((len(points), 5 if with_axis.any() else 3))
        turn = None
        for i, point in enumerate(points):
            if point.covariance is not None and np.ndim(point.covariance) == 2:
                values, vectors = np.linalg.eigh(as_matrix(point.covariance, 3))
                values[values < 1e-14 * max(float(values[-1]), 0.0)] = 0.0
                turn = np.tile(np.eye(3), (len(points), 1, 1)) if turn is None else turn
                turn[i], variance[i, :3] = vectors.T, np.maximum(values, 0.0)
            else:
                variance[i, :3] = point.covariance or 0.0
        axis = None
        if with_axis.any():
            unused = np.array([0.0, 0.0, 1.0])
            axis = np.array([unused if p.axis is None else p.axis for p in points])
            free = [1.0 if p.axis is None else p.axis_covariance or 0.0 for p in points]
            variance[:, 3:] = np.array(free)[:, None]
        return Rows(position, turn, axis, with_axis, variance)

    def evaluate(self, task_map: TaskMap, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Residuals (m, r) and Jacobian (m, r, n) at joints q (m, n)."""
        point, axis, point_jacobian, axis_jacobian = task_map(q)
        residual = self.position - point
        jacobian = point_jacobian
        if self.turn is not None:
            residual = (self.turn @ residual[..., None])[..., 0]
            jacobian = self.turn @ jacobian
        if self.axis is not None:
            angles, tilt = _tilt(axis, self.axis)
            angles[~self.with_axis] = 0.0
            tilt[~self.with_axis] = 0.0
            residual = np.concatenate([residual, angles], axis=1)
            jacobian = np.concatenate([jacobian, tilt @ axis_jacobian], axis=1)
        return residual, jacobian


def _tilt(axis: FloatArray, target: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Rotation (m, 2) [rad] that takes ``axis`` to ``target`` along the great circle, and the
    directions (m, 2, 3) across ``axis`` it is given in.
    """
    x, y, z = axis.T
    sign = np.copysign(1.0, z)
    s = -1.0 / (sign + z)
    t = x * y * s
    across = np.empty((len(axis), 2, 3))
    across[:, 0, 0], across[:, 0, 1], across[:, 0, 2] = 1.0 + sign * x * x * s, sign * t, -sign * x
    across[:, 1, 0], across[:, 1, 1], across[:, 1, 2] = t, sign + y * y * s, -y
    sine = (across @ target[..., None])[..., 0]
    length = np.sqrt((sine**2).sum(axis=1))
    angle = np.arctan2(length, (axis * target).sum(axis=1))
    opposite = (length < 1e-12) & (angle > 1.0)  # any direction will do
    sine[opposite] = (1.0, 0.0)
    length = np.where(opposite, 1.0, np.maximum(length, 1e-300))
    return sine * (angle / length)[:, None], across


@dataclass(frozen=True, eq=False)
class Solution:
    """Where the iteration ended.

    Attributes:
        multipliers: a (m, n).
        residual: (m, r) at the end.
        jacobian: (m, r, n) at the end.
        iterations: linearisations used.
        converged: exact rows are met and the last step was small.
    """

    multipliers: FloatArray
    residual: FloatArray
    jacobian: FloatArray
    iterations: int
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

    Raises:
        InvalidRequestError: the task map returns wrong shapes or values that are not finite.
    """
    m, n = mean.shape
    variance = rows.variance
    exact = variance == 0.0
    weight = np.where(exact, 0.0, 1.0 / np.where(exact, 1.0, variance))
    any_exact = bool(exact.any())
    blocks = covariance.reshape(m, n, m * n)
    reach = np.sqrt(np.diagonal(covariance)).reshape(m, 1, n)

    def merit(a: FloatArray, q: FloatArray, residual: FloatArray) -> tuple[float, float]:
        off = float(np.sqrt((residual[exact] ** 2).sum())) if any_exact else 0.0
        cost = float((a * (q - mean)).sum() + (weight * residual * residual).sum())
        return 0.5 * cost, off

    a = start
    q = mean + (covariance @ a.reshape(-1)).reshape(m, n)
    residual, jacobian = rows.evaluate(task_map, q)
    _check(residual, jacobian, variance.shape, n)
    history = [merit(a, q, residual)]
    damping, penalty, done = 0.0, 0.0, 0
    size = variance.size
    while done < iterations:
        done += 1
        turned = (jacobian @ blocks).reshape(size, m, n).transpose(1, 0, 2)
        spread = (turned @ jacobian.transpose(0, 2, 1)).transpose(1, 0, 2).reshape(size, size)
        reference = ((np.abs(jacobian) * reach).sum(axis=2) ** 2 + variance).reshape(-1)
        diagonal = np.diagonal(spread).copy()
        right = (residual + (jacobian @ (q - mean)[..., None])[..., 0]).reshape(-1)
        step_found = False
        while damping < 1e3:
            total = spread.copy()
            total.flat[:: size + 1] += variance.reshape(-1) + damping * (
                diagonal + 1e-3 * diagonal.mean()
            )
            factor = factorise(total, reference)
            dual = factor.solve(right)
            dual += factor.solve(right - total @ dual)
            dual = dual.reshape(variance.shape)
            new_a = (dual[:, None, :] @ jacobian)[:, 0]
            new_q = mean + (covariance @ new_a.reshape(-1)).reshape(m, n)
            a_step, q_step = new_a - a, new_q - q
            largest = float(np.abs(q_step).max())
            if any_exact:
                force = float(np.sqrt((dual[exact] ** 2).sum()))
                penalty = max(1.5 * force, 0.25 * penalty)
            linear = residual - (jacobian @ q_step[..., None])[..., 0]
            promised = merit(new_a, new_q, linear)
            now = history[-1][0] + penalty * history[-1][1]
            gain = max(now - promised[0] - penalty * promised[1], 0.0)
            ceiling = max(cost + penalty * off for cost, off in history[-_MEMORY:])
            share = min(1.0, _LARGEST_STEP / largest) if largest > 0.0 else 1.0
            for _ in range(_HALVINGS):
                try_a, try_q = a + share * a_step, q + share * q_step
                try_residual, try_jacobian = rows.evaluate(task_map, try_q)
                cost, off = merit(try_a, try_q, try_residual)
                if cost + penalty * off <= ceiling - 1e-4 * share * gain + 1e-12 * abs(ceiling):
                    step_found = True
                    break
                share *= 0.5
            if step_found:
                break
            damping = max(100.0 * damping, 1e-6)
        if not step_found:
            break
        a, q, residual, jacobian = try_a, try_q, try_residual, try_jacobian
        history.append((cost, off))
        damping = 0.01 * damping if damping > 1e-7 else 0.0
        missed = float(np.abs(residual[exact]).max()) if any_exact else 0.0
        if share == 1.0 and largest < _STEP_TOLERANCE and damping == 0.0 and missed < tolerance:
            return Solution(a, residual, jacobian, done, True)
    return Solution(a, residual, jacobian, done, False)


def _check(
    residual: FloatArray, jacobian: FloatArray, shape: tuple[int, ...], joints: int
) -> None:
    if residual.shape != shape or jacobian.shape != (*shape, joints):
        raise InvalidRequestError(
            f"task_map: expected point (m, 3), axis (m, 3) and Jacobians (m, 3, {joints}) for "
            f"m = {shape[0]}"
        )
    if not (np.isfinite(residual).all() and np.isfinite(jacobian).all()):
        raise InvalidRequestError("task_map returned a value that is not finite")
