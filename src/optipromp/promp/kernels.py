"""Inner loops of task-space conditioning, compiled.

Small dense algebra in plain loops: at these sizes (some 30 rows) it beats the calls into LAPACK.
Shapes: m points, n joints, r rows a point (3 of position, or 5 with the axis).
"""

import numpy as np
from numba import njit

from optipromp.arrays import BoolArray, FloatArray

_PIVOT = 1e-11


@njit(cache=True, error_model="numpy", nogil=True)
def residuals(
    point: FloatArray,
    axis: FloatArray,
    point_jacobian: FloatArray,
    axis_jacobian: FloatArray,
    position: FloatArray,
    turn: FloatArray,
    target_axis: FloatArray,
    with_axis: BoolArray,
    r: int,
) -> tuple[FloatArray, FloatArray, bool]:
    """Residuals (m, r) and Jacobian (m, r, n) of the rows, and whether all are finite.

    The axis rows are the rotation [rad] along the great circle from ``axis`` to its target, in
    two directions across ``axis``.
    """
    m, _, n = point_jacobian.shape
    residual = np.zeros((m, r))
    jacobian = np.zeros((m, r, n))
    finite = 0.0
    across = np.empty((2, 3))
    for i in range(m):
        for s in range(3):
            for c in range(3):
                residual[i, s] += turn[i, s, c] * (position[i, c] - point[i, c])
                for j in range(n):
                    jacobian[i, s, j] += turn[i, s, c] * point_jacobian[i, c, j]
        if r == 3 or not with_axis[i]:
            continue
        x, y, z = axis[i, 0], axis[i, 1], axis[i, 2]
        sign = np.copysign(1.0, z)
        k = -1.0 / (sign + z)
        across[0, 0] = 1.0 + sign * x * x * k
        across[0, 1] = sign * x * y * k
        across[0, 2] = -sign * x
        across[1, 0] = x * y * k
        across[1, 1] = sign + y * y * k
        across[1, 2] = -y
        cosine = 0.0
        first = 0.0
        second = 0.0
        for c in range(3):
            cosine += axis[i, c] * target_axis[i, c]
            first += across[0, c] * target_axis[i, c]
            second += across[1, c] * target_axis[i, c]
        sine = np.sqrt(first * first + second * second)
        angle = np.arctan2(sine, cosine)
        if sine > 1e-12:
            residual[i, 3] = first * angle / sine
            residual[i, 4] = second * angle / sine
        elif cosine < 0.0:  # opposite: any direction will do
            residual[i, 3] = angle
        for s in range(2):
            for c in range(3):
                for j in range(n):
                    jacobian[i, 3 + s, j] += across[s, c] * axis_jacobian[i, c, j]
    for i in range(m):
        for s in range(r):
            finite += 0.0 * residual[i, s]
            for j in range(n):
                finite += 0.0 * jacobian[i, s, j]
    return residual, jacobian, finite == 0.0


@njit(cache=True, error_model="numpy", nogil=True)
def spread(jacobian: FloatArray, covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
    """J Σ (mr, mn) and J Σ Jᵀ (mr, mr) for block-diagonal J (m, r, n) and Σ (mn, mn)."""
    m, r, n = jacobian.shape
    half = np.zeros((m * r, m * n))
    for i in range(m):
        for s in range(r):
            for j in range(n):
                value = jacobian[i, s, j]
                if value != 0.0:
                    for k in range(m * n):
                        half[i * r + s, k] += value * covariance[i * n + j, k]
    total = np.empty((m * r, m * r))
    for p in range(m * r):
        for i in range(m):
            for s in range(r):
                if i * r + s > p:
                    continue
                value = 0.0
                for j in range(n):
                    value += half[p, i * n + j] * jacobian[i, s, j]
                total[p, i * r + s] = value
                total[i * r + s, p] = value
    return half, total


@njit(cache=True, error_model="numpy", nogil=True)
def solve_definite(matrix: FloatArray, right: FloatArray) -> FloatArray:
    """x with A x = b for symmetric positive semi-definite A, refined once.

    A row that depends on those before it (pivot below 1e-11 of its variance) is left out: x = 0.
    """
    size = right.size
    lower = np.zeros((size, size))
    for i in range(size):
        for j in range(i):
            if lower[j, j] > 0.0:
                value = matrix[i, j]
                for k in range(j):
                    value -= lower[i, k] * lower[j, k]
                lower[i, j] = value / lower[j, j]
        pivot = matrix[i, i]
        for k in range(i):
            pivot -= lower[i, k] * lower[i, k]
        if pivot > _PIVOT * matrix[i, i]:
            lower[i, i] = np.sqrt(pivot)
    solution = np.zeros(size)
    rest = right.copy()
    for _ in range(2):
        part = np.zeros(size)
        for i in range(size):
            if lower[i, i] > 0.0:
                value = rest[i]
                for k in range(i):
                    value -= lower[i, k] * part[k]
                part[i] = value / lower[i, i]
        for i in range(size - 1, -1, -1):
            if lower[i, i] > 0.0:
                value = part[i]
                for k in range(i + 1, size):
                    value -= lower[k, i] * part[k]
                part[i] = value / lower[i, i]
        solution += part
        for i in range(size):
            value = right[i]
            for k in range(size):
                value -= matrix[i, k] * solution[k]
            rest[i] = value
    return solution


@njit(cache=True, error_model="numpy", nogil=True)
def merit(
    multipliers: FloatArray, offset: FloatArray, residual: FloatArray, variance: FloatArray
) -> tuple[float, float, float]:
    """½ aᵀΣa + ½Σ e²/R over rows with R > 0; norm and largest of e over the others."""
    m, n = offset.shape
    cost = 0.0
    square = 0.0
    largest = 0.0
    for i in range(m):
        for j in range(n):
            cost += 0.5 * multipliers[i, j] * offset[i, j]
        for s in range(residual.shape[1]):
            e = residual[i, s]
            if variance[i, s] > 0.0:
                cost += 0.5 * e * e / variance[i, s]
            else:
                square += e * e
                largest = max(largest, abs(e))
    return cost, np.sqrt(square), largest


@njit(cache=True, error_model="numpy", nogil=True)
def step(
    jacobian: FloatArray,
    residual: FloatArray,
    half: FloatArray,
    total: FloatArray,
    variance: FloatArray,
    multipliers: FloatArray,
    offset: FloatArray,
    hold: float,
    damping: float,
) -> tuple[FloatArray, FloatArray, float, float, float, float]:
    r"""Step of a and of q, and the dual λ, of the linearised problem held near where it is.

    Minimises ½|q - μ|² + ½ρ|q - q_k|² + ½|e - J(q - q_k)|²/R in the metric of Σ⁻¹:
    λ = (S/(1+ρ) + R + D)⁻¹ (e + J Σ a/(1+ρ)), δa = (Jᵀλ - a)/(1+ρ), δq = Σ δa.

    Args:
        jacobian: J (m, r, n).
        residual: e (m, r).
        half: J Σ (mr, mn).
        total: S = J Σ Jᵀ (mr, mr).
        variance: R (m, r).
        multipliers: a (m, n).
        offset: Σ a = q - μ (m, n).
        hold: ρ >= 0.
        damping: D is this times the diagonal of S, and a little of its mean.

    Returns:
        δa and δq (m, n); the largest |δq|; the norm of λ over exact rows; and the first two values
        of :func:`merit` that the linearisation promises after the step.
    """
    m, r, n = jacobian.shape
    size = m * r
    rate = 1.0 / (1.0 + hold)
    matrix = total * rate
    middle = 0.0
    for i in range(size):
        middle += matrix[i, i] / size
    right = np.empty(size)
    for i in range(m):
        for s in range(r):
            p = i * r + s
            matrix[p, p] += variance[i, s] + damping * (matrix[p, p] + 1e-3 * middle)
            value = residual[i, s]
            for j in range(n):
                value += jacobian[i, s, j] * offset[i, j] * rate
            right[p] = value
    dual = solve_definite(matrix, right)
    a_step = np.empty((m, n))
    q_step = np.empty((m, n))
    for i in range(m):
        for j in range(n):
            value = -multipliers[i, j]
            for s in range(r):
                value += jacobian[i, s, j] * dual[i * r + s]
            a_step[i, j] = value * rate
            value = -offset[i, j]
            for p in range(size):
                value += half[p, i * n + j] * dual[p]
            q_step[i, j] = value * rate
    largest = 0.0
    force = 0.0
    promised = np.empty((m, r))
    for i in range(m):
        for j in range(n):
            largest = max(largest, abs(q_step[i, j]))
        for s in range(r):
            if variance[i, s] == 0.0:
                force += dual[i * r + s] ** 2
            promised[i, s] = residual[i, s]
            for j in range(n):
                promised[i, s] -= jacobian[i, s, j] * q_step[i, j]
    cost, off, _ = merit(multipliers + a_step, offset + q_step, promised, variance)
    return a_step, q_step, largest, np.sqrt(force), cost, off
