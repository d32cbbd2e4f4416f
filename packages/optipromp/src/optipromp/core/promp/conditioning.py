"""Conditioning a ProMP on points in joint space and task space, all at once."""

import warnings
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from optipromp.core.arrays import FloatArray, read_only
from optipromp.core.errors import InvalidRequestError
from optipromp.core.promp.basis import Basis
from optipromp.core.promp.checks import PHASE_TOLERANCE, ConditioningWarning
from optipromp.core.promp.gaussian import Update, factorise, observed
from optipromp.core.promp.model import ProMP, trusted
from optipromp.core.promp.tasks import JointPoint, Point, Rows, Search, TaskMap, TaskPoint
from optipromp.core.values import array

REACH_TOLERANCE = 1e-8
"""[rad or m] Exact points that cannot be met to this tolerance contradict each other."""
_RESTARTS = 24  # samples of the prior from which a search that missed begins again: a choice


@dataclass(frozen=True, eq=False)
class ConditioningReport:
    """How well the task points were met.

    Attributes:
        converged: every exact point is met to the tolerance and the iteration has settled.
        iterations: linearisations used; 0 without task points.
        position_error: (m,) distance of the conditioned mean's tool point from each task point [m],
            in the order of the argument. A point with a covariance is a compromise, not a miss.
        axis_error: (m,) angle between tool axis and task point's axis [rad]; 0 without an axis.
        missed: indices, among all points, of the exact points that are missed.
    """

    converged: bool
    iterations: int
    position_error: FloatArray
    axis_error: FloatArray
    missed: tuple[int, ...]


def condition(
    promp: ProMP, points: Sequence[Point] | Point, task_map: TaskMap | None = None,
    iterations: int = 60, *, tolerance: float = 1e-6, initial: ArrayLike | None = None,
) -> ProMP:  # fmt: skip
    r"""Condition a ProMP on points in joint space and task space, in a single Gaussian update.

    The order of the points does not matter. H and R are the stacked rows and the covariance of all
    points in :class:`optipromp.core.promp.gaussian.Update`.

    Joint points are linear: their update is exact. Task points are met by iterated linearisation of
    ``task_map``, up to the most probable weights given all points
    (:mod:`optipromp.core.promp.tasks`); :math:`\Sigma_w^+` is the Laplace approximation there. A
    direction in which the prior has no variance has none afterwards.

    Args:
        promp: the prior; unchanged.
        points: any number of :class:`JointPoint` and :class:`TaskPoint`. Zero variance is exact.
        task_map: ``q (m, n) -> (point (m, 3), unit axis (m, 3), point Jacobian (m, 3, n), axis
            Jacobian (m, 3, n))``; needed for task points.
        iterations: largest number of linearisations, > 0.
        tolerance: largest error of an exact task point that is met [m, rad].
        initial: weights (n, K) or (nK,) at which the search begins. By default the mean, then,
            while an exact point is missed, up to 24 samples of the prior, the same in each call.

    Returns:
        The conditioned ProMP. :func:`condition_with_report` also returns the errors of the points.

    Warns:
        ConditioningWarning: an exact task point is missed: it is out of reach or too far from the
            demonstrations, or the iterations were too few.

    Raises:
        InvalidRequestError: exact points that contradict each other or a value of which the prior
            is certain; more exact points than the bases can meet; wrong shapes; task points without
            ``task_map``.
    """
    result, report = condition_with_report(
        promp, points, task_map, iterations, tolerance=tolerance, initial=initial
    )
    if report.missed:
        worst = max(float(report.position_error.max()), float(report.axis_error.max()))
        warnings.warn(
            f"conditioning misses point(s) {', '.join(map(str, report.missed))} by up to "
            f"{worst:.3g} (m or rad) after {report.iterations} iterations",
            ConditioningWarning,
            stacklevel=2,
        )
    return result


def condition_with_report(
    promp: ProMP, points: Sequence[Point] | Point, task_map: TaskMap | None = None,
    iterations: int = 60, *, tolerance: float = 1e-6, initial: ArrayLike | None = None,
) -> tuple[ProMP, ConditioningReport]:  # fmt: skip
    """:func:`condition` with a report in place of the warning; same arguments and errors."""
    if isinstance(points, (JointPoint, TaskPoint)):
        points = (points,)
    joints = [(i, point) for i, point in enumerate(points) if isinstance(point, JointPoint)]
    tasks = [(i, point) for i, point in enumerate(points) if isinstance(point, TaskPoint)]
    for i, point in enumerate(points):
        if not isinstance(point, JointPoint | TaskPoint):
            raise InvalidRequestError(
                f"point {i}: expected a JointPoint or TaskPoint, got {type(point).__name__}"
            )
    if iterations < 1:
        raise InvalidRequestError(f"iterations must be at least 1, got {iterations}")
    if not tolerance > 0.0:
        raise InvalidRequestError(f"tolerance must be above 0, got {tolerance}")
    promp = condition_joints(promp, joints)
    if not tasks:
        nothing = read_only(np.zeros(0))
        return promp, ConditioningReport(True, 0, nothing, nothing, ())
    if task_map is None:
        raise InvalidRequestError("task points need a task_map (the robot's forward kinematics)")
    tasks.sort(key=lambda item: (item[1].phase, *item[1].position))
    _check_conflicts(tasks)
    return _condition_tasks(promp, tasks, joints, task_map, iterations, tolerance, initial)


def conditioned_mean(
    promp: ProMP,
    places: tuple[tuple[float, int], ...],
    values: FloatArray,
    variances: tuple[float, ...],
) -> FloatArray:
    """Mean weights (n, K) of :func:`condition` on joint points, for a fraction of its work.

    The part that does not depend on ``values`` is cached.

    ``places``: phase and order of derivative of each of P points. ``values``: (P, n) joint
    positions or their derivatives. ``variances``: of each point, the same for all joints; 0 is
    exact.
    """
    update = _update(promp, places, variances)
    if update.inverse.null is None:
        return update.mean(promp.weights, values.T.flatten()).reshape(promp.mean.shape)
    points = (
        JointPoint(phase, value, variance or None, derivative)
        for (phase, derivative), value, variance in zip(places, values, variances, strict=True)
    )
    return condition_joints(promp, enumerate(points)).mean


@lru_cache(maxsize=16)
def _update(
    promp: ProMP, places: tuple[tuple[float, int], ...], variances: tuple[float, ...]
) -> Update:
    """The update by independent observations at ``places``."""
    noise = np.tile(variances, promp.n_joints)
    return observed(promp.covariance, _rows(promp.basis, places, promp.n_joints), noise)


def condition_joints(promp: ProMP, numbered: Iterable[tuple[int, JointPoint]]) -> ProMP:
    """:func:`condition` on joint points alone, each with the index that an error names."""
    points, n = list(numbered), promp.n_joints
    for i, point in points:
        if point.value.size != n:
            raise InvalidRequestError(
                f"point {i}: expected {n} joint values, got {point.value.size}"
            )
    if not points:
        return promp
    p = len(points)
    rows = _rows(promp.basis, tuple((point.phase, point.derivative) for _, point in points), n)
    noise = np.zeros((n, p, n, p))
    diagonal = np.arange(n)
    for i, (_, point) in enumerate(points):
        if isinstance(point.covariance, float):
            noise[diagonal, i, diagonal, i] = point.covariance
        elif point.covariance is not None:
            noise[:, i, :, i] = point.covariance
    update = observed(promp.covariance, rows, noise.reshape(n * p, n * p))
    values = np.array([point.value for _, point in points]).T.flatten()
    missed = update.inverse.out_of_reach(values - rows @ promp.weights)
    if missed is not None and float(np.abs(missed).max()) > REACH_TOLERANCE:
        _refuse(np.abs(missed).reshape(n, p), points, promp)
    return trusted(promp, update.mean(promp.weights, values), update.covariance())


@lru_cache(maxsize=64)
def _rows(basis: Basis, places: tuple[tuple[float, int], ...], joints: int) -> FloatArray:
    """H (nP, nK) of n joints at P phases and orders of derivatives; rows are joint-major."""
    rows = np.zeros((joints, len(places), joints, basis.count))
    for i, (phase, order) in enumerate(places):
        rows[range(joints), i, range(joints)] = basis.evaluate([phase], order)
    return read_only(rows.reshape(joints * len(places), -1))


def _refuse(missed: FloatArray, points: Sequence[tuple[int, JointPoint]], promp: ProMP) -> None:
    joint, worst = (int(i) for i in np.unravel_index(int(missed.argmax()), missed.shape))
    index, point = points[worst]
    same = [
        i
        for i, other in points
        if i != index and abs(other.phase - point.phase) <= 1e-6 and other.exact
    ]
    if same:
        reason = f"it contradicts point {same[0]} at the same phase"
    elif sum(other.exact for _, other in points) > promp.basis.count:
        reason = f"{promp.basis.count} bases cannot pass through so many exact points"
    else:
        reason = "the ProMP is already certain of another value there"
    raise InvalidRequestError(
        f"point {index} (phase {point.phase:.6g}) cannot be met exactly: "
        f"{promp.joint_names[joint]} is off by {missed.max():.3g}; {reason}"
    )


def _check_conflicts(points: Sequence[tuple[int, TaskPoint]]) -> None:
    """Refuse exact task points that differ at one phase; the points are sorted by phase."""
    for (i, first), (k, second) in pairwise(points):
        if second.phase - first.phase > PHASE_TOLERANCE:
            continue
        apart, what = 0.0, "positions"
        if first.exact and second.exact:
            apart = float(np.abs(first.position - second.position).max())
        loose = first.axis_covariance or second.axis_covariance or apart > REACH_TOLERANCE
        if not loose and first.axis is not None and second.axis is not None:
            apart, what = float(np.abs(first.axis - second.axis).max()), "axes"
        if apart > REACH_TOLERANCE:
            raise InvalidRequestError(
                f"points {min(i, k)} and {max(i, k)} ask for {what} {apart:.3g} apart, exactly, at "
                f"one phase ({first.phase:.6g})"
            )


def _condition_tasks(
    promp: ProMP, points: Sequence[tuple[int, TaskPoint]], joints: Sequence[tuple[int, JointPoint]],
    task_map: TaskMap, iterations: int, tolerance: float, initial: ArrayLike | None,
) -> tuple[ProMP, ConditioningReport]:  # fmt: skip
    """The iterated update by task points; ``promp`` is conditioned on the joint points already."""
    n, count = promp.mean.shape
    size, m = n * count, len(points)
    phases = np.array([point.phase for _, point in points])
    values = promp.basis.evaluate(phases)
    rows = Rows.of([point for _, point in points])
    prior = promp.covariance
    joint_major = (prior.reshape(size * n, count) @ values.T).reshape(size, n, m)
    cross = joint_major.transpose(0, 2, 1).reshape(size, m * n)  # Σ Φᵀ
    spread = (values @ cross.reshape(n, count, m * n)).transpose(1, 0, 2).reshape(m * n, m * n)
    spread = 0.5 * (spread + spread.T)
    search = Search(rows, task_map, values @ promp.mean.T, spread)
    start = np.zeros((m, n))
    if initial is not None:
        weights = array("initial", initial, ...)
        if weights.size != size:
            raise InvalidRequestError(f"initial: expected {size} weights, got {weights.size}")
        start = _multipliers(promp, weights.reshape(1, n, count), values, spread)[0]
    found = search.solve(start, iterations, tolerance)
    if initial is None and found.missed > tolerance:
        samples = promp.sample_weights(np.random.default_rng(0), _RESTARTS)
        for start in _multipliers(promp, samples, values, spread):
            other = search.solve(start, iterations, tolerance)
            found = other if other.missed < found.missed else found
            if found.missed <= tolerance:
                break

    jacobian = found.state.jacobian
    H = (jacobian[:, :, :, None] * values[:, None, None, :]).reshape(-1, size)
    update = observed(prior, H, rows.variance.reshape(-1))
    mean = promp.weights + cross @ found.state.multipliers.reshape(-1)
    result = trusted(promp, mean, update.covariance())

    residual = found.state.residual
    position_error = np.sqrt((residual[:, :3] ** 2).sum(axis=1))
    axis_error = np.sqrt((residual[:, 3:] ** 2).sum(axis=1))
    off = np.abs(np.where(rows.variance == 0.0, residual, 0.0)).max(axis=1)
    over = np.flatnonzero(off > tolerance).tolist()
    missed = tuple(points[i][0] for i in over)
    given = [(k, p.phase) for k, p in joints if p.exact and p.derivative == 0]
    for i in over:
        index, point = points[i]
        for k, phase in given:
            if abs(phase - point.phase) <= PHASE_TOLERANCE:
                raise InvalidRequestError(
                    f"points {k} and {index} contradict: at phase {phase:.6g} the joints are "
                    f"given, and put the tool {off[i]:.3g} (m or rad) from where it must be"
                )
    given_order = np.argsort([index for index, _ in points])
    report = ConditioningReport(
        found.converged,
        found.iterations,
        read_only(position_error[given_order]),
        read_only(axis_error[given_order]),
        tuple(sorted(missed)),
    )
    return result, report


def _multipliers(
    promp: ProMP, weights: FloatArray, values: FloatArray, spread: FloatArray
) -> FloatArray:
    """The a (c, m, n) for which q = μ_q + Σ_q a equals the positions of weights (c, n, K)."""
    gap = (values @ (weights - promp.mean).transpose(0, 2, 1)).reshape(len(weights), -1)
    reference = np.full(gap.shape[1], max(float(np.diagonal(spread).max()), 1e-300))
    solved = factorise(spread, reference).solve(gap.T).T
    return np.ascontiguousarray(solved).reshape(len(weights), len(values), -1)
