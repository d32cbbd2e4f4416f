r"""The maximum a posteriori trajectory through task points, by iterated linearisation.

The tool's pose depends on the weights only through the joint positions at the m phases of the
points, :math:`q = (q_1 \ldots q_m) = \Phi w`. The most probable weights that give q have the form
:math:`w = \mu_w + \Sigma_w\Phi^T a`; with :math:`\Sigma_q = \Phi\Sigma_w\Phi^T`

.. math:: q = \mu_q + \Sigma_q a, \qquad
          (w - \mu_w)^T\Sigma_w^{-1}(w - \mu_w) = a^T\Sigma_q a,

which needs no inverse and allows a singular :math:`\Sigma_w`. The points ask for
:math:`g(q) = x` with variance R (0: exactly). With residual :math:`e = x - g(q)` and Jacobian J,

.. math:: \lambda = (J\Sigma_q J^T + R)^{-1}(e + J(q - \mu_q)), \qquad a = J^T\lambda

is the minimiser of the linearised problem (Gauss-Newton; sequential quadratic programming where
R = 0). The step to the minimiser is limited to 1 rad and halved until the merit
:math:`\tfrac12 a^T\Sigma_q a + \tfrac12\sum e^2/R + \nu\|e_{R=0}\|` falls. Where no step lowers
the merit, Levenberg damping is added to R. Exact rows that are not met at the end are met by steps
of least change.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Annotated, NamedTuple

import numpy as np
from annotated_types import Ge, Le
from pydantic import PlainValidator

from optipromp.core.arrays import BoolArray, FloatArray, all_finite, read_only
from optipromp.core.errors import InvalidRequestError
from optipromp.core.promp.checks import phase_array
from optipromp.core.promp.gaussian import check_covariance, observed
from optipromp.core.values import Array, NotNegative, Validated, direction, value


def _phase(phase: float) -> float:
    if isinstance(phase, float) and 0.0 <= phase <= 1.0:
        return float(phase)
    array = phase_array(phase if np.ndim(phase) else float(phase))
    if array.size != 1:
        raise InvalidRequestError(f"phase: expected one number, got {phase}")
    return min(max(float(array[0]), 0.0), 1.0)


Phase = Annotated[float, PlainValidator(_phase)]


@dataclass(frozen=True, eq=False)
class JointPoint(Validated, label="joint point "):
    """The joint positions at a phase: y(z) ~ N(value, covariance).

    Args:
        phase: z in [0, 1].
        value: (n,) joint positions [rad or m], or their derivative with respect to the phase.
        covariance: (n, n), one variance for all joints, or None: exact.
        derivative: 0 for positions; 1 or 2 for derivatives with respect to the phase (velocity
            times duration; acceleration times duration squared).

    Raises:
        InvalidRequestError: a phase outside [0, 1], a value that is not finite, a covariance that
            is not positive semi-definite.
    """

    phase: Phase
    value: Annotated[FloatArray, Array(None)]
    covariance: FloatArray | float | None = None
    derivative: Annotated[int, Ge(0), Le(2)] = 0

    def __post_init__(self) -> None:
        super().__post_init__()
        covariance = _covariance(self.covariance, self.value.size, "joint point covariance")
        object.__setattr__(self, "covariance", covariance)

    @property
    def exact(self) -> bool:
        """Whether the point is exact."""
        return self.covariance is None or not np.any(self.covariance)


@dataclass(frozen=True, eq=False)
class TaskPoint(Validated, label="task point "):
    """The tool point at a phase, x(z) ~ N(position, covariance), and optionally the tool axis.

    Args:
        phase: z in [0, 1].
        position: (3,) of the tool point in the world [m].
        axis: (3,) direction of the tool axis, of any length but 0; None: free.
        covariance: of the position [m²]: (3, 3), one variance, or None: exact. The covariance of a
            detected object goes here.
        axis_covariance: variance of the angle between the tool axis and ``axis`` [rad²] in each of
            the two directions of tilt, or None: exact.

    Raises:
        InvalidRequestError: a phase outside [0, 1], a value that is not finite, an axis of length
            0, a covariance that is not positive semi-definite.
    """

    phase: Phase
    position: Annotated[FloatArray, Array(3)]
    axis: Annotated[FloatArray, PlainValidator(direction)] | None = None
    covariance: FloatArray | float | None = None
    axis_covariance: NotNegative | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        covariance = _covariance(self.covariance, 3, "task point covariance")
        object.__setattr__(self, "covariance", covariance)

    @property
    def exact(self) -> bool:
        """Whether the position is exact."""
        return self.covariance is None or not np.any(self.covariance)


Point = JointPoint | TaskPoint


def _covariance(
    covariance: FloatArray | float | None, size: int, name: str
) -> FloatArray | float | None:
    if covariance is None or (type(covariance) is float and 0.0 <= covariance < math.inf):
        return covariance
    if np.ndim(covariance) == 0:
        return float(value(name, covariance, NotNegative))
    return read_only(check_covariance(covariance, size, name))


TaskMap = Callable[[FloatArray], tuple[FloatArray, FloatArray, FloatArray, FloatArray]]
"""q (m, n) -> tool point (m, 3), unit tool axis (m, 3), their Jacobians (m, 3, n) each."""

_HALVINGS = 6  # of a step, to 1/32: a shorter step means that damping is needed
_TRIALS = 16  # of one step; the damping, from 1e-6 by tens, then makes the step negligible
_SETTLED = 1e-3  # [-] relative gain of the merit at which the search ends
_ROUNDING = 1e-12  # [-] relative error of a merit: the gain of a step at the minimum, of any sign
_CLOSING = 1e-10  # [m, rad] norm of the residuals of exact rows that needs no further step
_CLOSING_STEPS = 60  # at most: a choice


@dataclass(frozen=True, eq=False)
class Rows:
    """Task points as r scalar rows each: 3 of the position and, if any point has an axis, 2 of it.

    The rows of the position are along the principal axes of the covariance: their errors are
    independent.
    """

    position: FloatArray  # (m, 3) targets [m]
    turn: FloatArray  # (m, 3, 3) directions of the rows of the position
    axis: FloatArray  # (m, 3) unit targets
    with_axis: BoolArray  # (m,) whether a point has an axis
    # (m, r), r = 3 or 5; 0: exact; 1 in the unused rows of points without axis
    variance: FloatArray

    @staticmethod
    def of(points: Sequence[TaskPoint]) -> "Rows":
        """Rows of the given points."""
        m = len(points)
        position, axis = np.empty((m, 3)), np.zeros((m, 3))
        with_axis = np.array([point.axis is not None for point in points])
        variance = np.zeros((m, 5 if with_axis.any() else 3))
        turn = np.tile(np.eye(3), (m, 1, 1))
        for i, point in enumerate(points):
            position[i] = point.position
            if isinstance(point.covariance, np.ndarray):
                values, vectors = np.linalg.eigh(point.covariance)
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
        """Residuals (m, r) and Jacobian (m, r, n) at joints q (m, n)."""
        m, n = q.shape
        outputs = [np.ascontiguousarray(part, dtype=np.float64) for part in task_map(q)]
        shapes = [part.shape for part in outputs]
        if shapes != [(m, 3), (m, 3), (m, 3, n), (m, 3, n)]:
            raise InvalidRequestError(
                f"task_map: expected point ({m}, 3), axis ({m}, 3) and their Jacobians "
                f"({m}, 3, {n}), got {shapes}"
            )
        point, axis, point_jacobian, axis_jacobian = outputs
        residual = (self.turn @ (self.position - point)[:, :, None])[:, :, 0]
        jacobian = self.turn @ point_jacobian
        if self.variance.shape[1] == 5:
            across = _across(axis)
            turn = _rotation(axis, self.axis, across) * self.with_axis[:, None]
            turning = (across @ axis_jacobian) * self.with_axis[:, None, None]
            residual = np.concatenate([residual, turn], axis=1)
            jacobian = np.concatenate([jacobian, turning], axis=1)
        if not (all_finite(residual) and all_finite(jacobian)):
            raise InvalidRequestError("task_map returned a value that is not finite")
        return residual, jacobian


def _across(axis: FloatArray) -> FloatArray:
    """Two unit vectors (m, 2, 3) across each unit axis (m, 3) (Duff et al., 2017)."""
    x, y, z = axis.T
    sign = np.copysign(1.0, z)
    k = -1.0 / (sign + z)
    first = 1.0 + sign * x * x * k, sign * x * y * k, -sign * x
    second = x * y * k, sign + y * y * k, -y
    return np.array([first, second]).transpose(2, 0, 1)


def _rotation(axis: FloatArray, target: FloatArray, across: FloatArray) -> FloatArray:
    """Rotation (m, 2) [rad] from ``axis`` to ``target`` along a great circle, by ``across``."""
    towards = (across @ target[:, :, None])[:, :, 0]
    sine = np.sqrt((towards**2).sum(axis=1))
    towards[sine < 1e-12] = (1.0, 0.0)  # opposite: any direction serves; equal: the angle is 0
    angle = np.arctan2(sine, (axis * target).sum(axis=1))
    return np.asarray(towards * (angle / np.where(sine < 1e-12, 1.0, sine))[:, None])


class Iterate(NamedTuple):
    """A point of the iteration."""

    multipliers: FloatArray  # a (m, n)
    offset: FloatArray  # Σ_q a = q - μ_q (m, n)
    residual: FloatArray  # e (m, r)
    jacobian: FloatArray  # J (m, r, n)

    def merit(self, variance: FloatArray) -> tuple[float, float, float]:
        """½ aᵀΣa + ½Σ e²/R over rows with R > 0; norm and largest |e| of exact rows."""
        exact = variance == 0.0
        left = np.where(exact, self.residual, 0.0)
        loose = (self.residual - left) ** 2 / np.where(exact, 1.0, variance)
        cost = 0.5 * float(np.vdot(self.multipliers, self.offset) + loose.sum())
        return cost, float(np.sqrt(np.vdot(left, left))), float(np.abs(left).max())


class Solution(NamedTuple):
    """End of the iteration."""

    state: Iterate
    iterations: int  # linearisations used
    missed: float  # largest residual of an exact row [m, rad]
    converged: bool  # exact rows are met, and the merit has settled


@dataclass(frozen=True, eq=False)
class Search:
    """The task points, the arm, and the prior N(μ_q, Σ_q) of the joints at the points.

    The shapes are (m, n) for ``mean`` and (mn, mn), by point, then joint, for ``covariance``.
    """

    rows: Rows
    task_map: TaskMap
    mean: FloatArray
    covariance: FloatArray

    def at(self, a: FloatArray) -> Iterate:
        """The state at multipliers a (m, n)."""
        offset = (self.covariance @ a.reshape(-1)).reshape(a.shape)
        return Iterate(a, offset, *self.rows.evaluate(self.task_map, self.mean + offset))

    def step(self, state: Iterate, variance: FloatArray, damping: float) -> tuple[Iterate, float]:
        """The minimiser of the linearised problem.

        λ = (S + R + D)⁻¹ (e + J(q_k - μ)), a = Jᵀλ.

        ``state``: at q_k. ``variance``: R (m, r). ``damping``: factor of D, which is the diagonal
        of S = J Σ Jᵀ and 0.1 % of its mean.

        Returns: The minimiser with the e of the linearisation and the J of ``state``; the norm of λ
        over exact rows.
        """
        _, offset, residual, jacobian = state
        noise = variance
        if damping > 0.0:
            own = self.own_variance(jacobian)
            noise = variance + damping * (own + 1e-3 * own.mean())
        right = residual + (jacobian @ offset[:, :, None])[:, :, 0]
        m, r, n = jacobian.shape
        rows = np.zeros((m, r, m, n))  # block-diagonal
        rows[range(m), :, range(m)] = jacobian
        update = observed(self.covariance, rows.reshape(m * r, m * n), noise.reshape(-1))
        force = update.force(right.reshape(-1))
        dual = force.reshape(residual.shape)
        a = (dual[:, None, :] @ jacobian)[:, 0]
        moved = (force @ update.cross).reshape(a.shape)
        promised = right - (jacobian @ moved[:, :, None])[:, :, 0]
        return Iterate(a, moved, promised, jacobian), float(np.linalg.norm(dual[variance == 0.0]))

    def own_variance(self, jacobian: FloatArray) -> FloatArray:
        """The diagonal of J Σ_q Jᵀ (m, r)."""
        m, _, n = jacobian.shape
        each = np.einsum("iaib->iab", self.covariance.reshape(m, n, m, n))
        return np.asarray(((jacobian @ each) * jacobian).sum(axis=2))

    def solve(self, start: FloatArray, iterations: int, tolerance: float) -> Solution:
        """Minimise the merit from a = ``start`` (m, n).

        Args:
            start: multipliers.
            iterations: largest number of linearisations.
            tolerance: largest error of an exact row that is met [m, rad].
        """
        variance = self.rows.variance
        state = self.at(start)
        here = state.merit(variance)
        damping, penalty, done, settled = 0.0, 0.0, 0, False
        while done < iterations and not settled:
            done += 1
            for _ in range(_TRIALS):
                step, force = self.step(state, variance, damping)
                cost, off, _ = step.merit(variance)
                penalty = max(1.5 * force, 0.25 * penalty)
                gain = here[0] - cost + penalty * (here[1] - off)
                found = self.shortened(state, step, here, penalty, gain)
                if found is not None:
                    break
                damping = max(10.0 * damping, 1e-6)
            else:
                break
            state, here, share = found
            damping = 0.01 * damping if damping > 1e-7 else 0.0
            settled = share == 1.0 and gain <= _SETTLED * (1.0 + abs(here[0]))
        state = self.closed(state)
        missed = state.merit(variance)[2]
        return Solution(state, done, missed, settled and missed <= tolerance)

    def shortened(
        self, state: Iterate, goal: Iterate, here: tuple[float, ...], penalty: float, gain: float
    ) -> tuple[Iterate, tuple[float, float, float], float] | None:
        """The first state on the way to ``goal`` with sufficient decrease of the merit.

        The first step is at most 1 rad long; then steps are halved.

        Returns: The state, its merit, and its share of the way; None where no step suffices.
        """
        largest = float(np.abs(goal.offset - state.offset).max())
        share = min(1.0, 1.0 / largest) if largest > 0.0 else 1.0
        ceiling = (1.0 + _ROUNDING) * (here[0] + penalty * here[1])
        for _ in range(_HALVINGS if gain >= -_ROUNDING * (1.0 + abs(here[0])) else 0):
            a = state.multipliers + share * (goal.multipliers - state.multipliers)
            offset = state.offset + share * (goal.offset - state.offset)
            found = self.rows.evaluate(self.task_map, self.mean + offset)
            tried = Iterate(a, offset, *found)
            reached = tried.merit(self.rows.variance)
            if reached[0] + penalty * reached[1] <= ceiling - 1e-4 * share * gain:
                return tried, reached, share
            share *= 0.5
        return None

    def closed(self, state: Iterate) -> Iterate:
        """Meet the exact rows by damped steps of least change, whatever the other rows."""
        exact = self.rows.variance == 0.0
        missed = float((state.residual[exact] ** 2).sum())
        nothing, damping = np.zeros_like(state.multipliers), 0.0
        for _ in range(_CLOSING_STEPS):
            if missed <= _CLOSING**2 or damping > 1e3:
                break
            left = Iterate(nothing, nothing, np.where(exact, state.residual, 0.0), state.jacobian)
            own = float(self.own_variance(state.jacobian).max())
            loose = np.where(exact, 0.0, 1e6 * (own + 1e-300))
            step, _ = self.step(left, loose, damping)
            largest = float(np.abs(step.offset).max())
            share = min(1.0, 0.5 / largest) if largest > 0.0 else 1.0
            tried = self.at(state.multipliers + share * step.multipliers)
            reached = float((tried.residual[exact] ** 2).sum())
            if reached < missed:
                state, missed = tried, reached
                damping = 0.1 * damping if damping > 1e-6 else 0.0
            else:
                damping = max(10.0 * damping, 1e-4)
        return state
