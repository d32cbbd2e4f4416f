"""The linear update of a ProMP by points in joint space, compiled.

Row (j, p) of H is joint j at point p: the bases at that point's phase, at the weights of joint j.
Shapes: n joints of K weights, nK = d; P points, nP = r rows.
"""

import numpy as np
from numba import njit

from optipromp.arrays import FloatArray


@njit(cache=True, error_model="numpy", nogil=True)
def joint_update(
    prior: FloatArray,
    mean: FloatArray,
    values: FloatArray,
    target: FloatArray,
    noise: FloatArray,
    tolerance: float,
    only_mean: bool,
) -> tuple[bool, FloatArray, FloatArray]:
    r"""Posterior weights (d,) and covariance (d, d), where S = HΣHᵀ + R is safely definite.

    The covariance is Joseph's form (I - KH) Σ (I - KH)ᵀ + K R Kᵀ, multiplied out from the left so
    that no product of two (d, d) matrices is made:

    .. math:: A = \Sigma - K (H \Sigma), \qquad \Sigma^+ = A + (K R - A H^T) K^T.

    Args:
        prior: Σ (d, d).
        mean: (n, K).
        values: (P, K) bases, or their derivatives, at each point.
        target: (P, n).
        noise: R (r, r).
        tolerance: share of its variance that every row must add to those before it.
        only_mean: leave the covariance as it is.

    Returns:
        Whether S is that definite (the rest means nothing where not), weights, covariance.
    """
    n, count = mean.shape
    points, size = values.shape[0], mean.size
    rows = n * points
    cross = np.zeros((rows, size))  # H Σ
    for r in range(rows):
        for k in range(count):
            value = values[r % points, k]
            for c in range(size):
                cross[r, c] += value * prior[r // points * count + k, c]
    total = along_rows(cross, values, count)
    for r in range(rows):
        for s in range(rows):
            total[r, s] += noise[r, s]
    scale = np.empty(rows)
    lower, definite = np.zeros((rows, rows)), True
    for r in range(rows):
        reference = 0.0
        j = r // points * count
        for k in range(count):
            reference += np.sqrt(max(prior[j + k, j + k], 0.0)) * abs(values[r % points, k])
        if not total[r, r] > 1e-13 * (reference * reference + noise[r, r]):
            return False, np.zeros(0), prior
        scale[r] = 1.0 / np.sqrt(total[r, r])
    for i in range(rows):
        for j in range(i + 1):
            value = total[i, j] * scale[i] * scale[j]
            for k in range(j):
                value -= lower[i, k] * lower[j, k]
            if i == j:
                definite = definite and value > tolerance
                lower[i, i] = np.sqrt(max(value, tolerance))
            else:
                lower[i, j] = value / lower[j, j]
    if not definite:
        return False, np.zeros(0), prior

    gap = np.empty((rows, 1))
    for r in range(rows):
        j, p = r // points, r % points
        gap[r, 0] = target[p, j]
        for k in range(count):
            gap[r, 0] -= values[p, k] * mean[j, k]
    dual = gap.copy()
    substitute(lower, scale, dual)
    rest = gap.copy()
    for r in range(rows):
        for c in range(rows):
            rest[r, 0] -= total[r, c] * dual[c, 0]
    substitute(lower, scale, rest)
    for r in range(rows):
        dual[r, 0] += rest[r, 0]
    weights = np.empty(size)
    for c in range(size):
        weights[c] = mean[c // count, c % count]
        for r in range(rows):
            weights[c] += dual[r, 0] * cross[r, c]

    if only_mean:
        return True, weights, prior
    gain = cross.copy()  # Kᵀ = S⁻¹ H Σ
    substitute(lower, scale, gain)
    kept = prior.copy()
    for i in range(size):
        for r in range(rows):
            factor = gain[r, i]
            for c in range(size):
                kept[i, c] -= factor * cross[r, c]
    correction = along_rows(kept, values, count)
    for r in range(rows):
        for i in range(size):
            correction[i, r] = -correction[i, r]
        for s in range(rows):
            if noise[s, r] != 0.0:
                for i in range(size):
                    correction[i, r] += gain[s, i] * noise[s, r]
    for i in range(size):
        for r in range(rows):
            factor = correction[i, r]
            for c in range(size):
                kept[i, c] += factor * gain[r, c]
    for i in range(size):
        for c in range(i):
            kept[i, c] = kept[c, i] = 0.5 * (kept[i, c] + kept[c, i])
    return True, weights, kept


@njit(cache=True, error_model="numpy", nogil=True)
def along_rows(matrix: FloatArray, values: FloatArray, count: int) -> FloatArray:
    """M Hᵀ (m, r) for M (m, d)."""
    points, joints = values.shape[0], matrix.shape[1] // count
    out = np.zeros((matrix.shape[0], joints * points))
    for i in range(matrix.shape[0]):
        for j in range(joints):
            for p in range(points):
                value = 0.0
                for k in range(count):
                    value += matrix[i, j * count + k] * values[p, k]
                out[i, j * points + p] = value
    return out


@njit(cache=True, error_model="numpy", nogil=True)
def substitute(lower: FloatArray, scale: FloatArray, right: FloatArray) -> None:
    """Solve S x = b in place for b (r, m), with D S D = L Lᵀ and D = diag(scale)."""
    rows, columns = right.shape
    for i in range(rows):
        for c in range(columns):
            right[i, c] *= scale[i]
        for k in range(i):
            factor = lower[i, k]
            for c in range(columns):
                right[i, c] -= factor * right[k, c]
        for c in range(columns):
            right[i, c] /= lower[i, i]
    for i in range(rows - 1, -1, -1):
        for k in range(i + 1, rows):
            factor = lower[k, i]
            for c in range(columns):
                right[i, c] -= factor * right[k, c]
        for c in range(columns):
            right[i, c] /= lower[i, i]
    for i in range(rows):
        for c in range(columns):
            right[i, c] *= scale[i]
