"""The linear update of a ProMP by points in joint space, compiled.

Row (j, p) of H is joint j at point p: the bases at that point's phase, at the weights of joint j.
Shapes: n joints of K weights, nK = d; P points, nP = r rows.
"""

from typing import NamedTuple

import numpy as np

from optipromp.arrays import FloatArray
from optipromp.compiled import kernel


class Factor(NamedTuple):
    """What conditioning needs of points beside their values: H Σ, S = H Σ Hᵀ + R, its factor.

    D S D = L Lᵀ with D = diag(scale). Of no use where S is not safely ``definite``.
    """

    definite: bool
    cross: FloatArray  # H Σ (r, d)
    total: FloatArray  # S (r, r)
    lower: FloatArray  # L (r, r)
    scale: FloatArray  # (r,)


def joint_factor(
    prior: FloatArray, joints: int, values: FloatArray, noise: FloatArray, tolerance: float
) -> Factor:
    """The factor of points at which ``values`` (P, K) are the bases, or their derivatives.

    Args:
        prior: Σ (d, d).
        joints: n.
        values: (P, K).
        noise: R (r, r).
        tolerance: share of its variance that every row must add to those before it.
    """
    # a kernel returns no named tuple: see optipromp.pushing.stems.swinging
    return Factor(*_joint_factor(prior, joints, values, noise, tolerance))


@kernel
def _joint_factor(
    prior: FloatArray, joints: int, values: FloatArray, noise: FloatArray, tolerance: float
) -> tuple[bool, FloatArray, FloatArray, FloatArray, FloatArray]:
    """The fields of :class:`Factor`."""
    points, count = values.shape
    rows, size = joints * points, joints * count
    cross = np.zeros((rows, size))
    for r in range(rows):
        for k in range(count):
            value = values[r % points, k]
            for c in range(size):
                cross[r, c] += value * prior[r // points * count + k, c]
    total = along_rows(cross, values, count)
    for r in range(rows):
        for s in range(rows):
            total[r, s] += noise[r, s]
    scale, lower, definite = np.empty(rows), np.zeros((rows, rows)), True
    for r in range(rows):
        reference = 0.0
        j = r // points * count
        for k in range(count):
            reference += np.sqrt(max(prior[j + k, j + k], 0.0)) * abs(values[r % points, k])
        if not total[r, r] > 1e-13 * (reference * reference + noise[r, r]):
            return False, cross, total, lower, scale
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
    return definite, cross, total, lower, scale


@kernel
def joint_mean(
    factor: Factor, mean: FloatArray, values: FloatArray, target: FloatArray
) -> FloatArray:
    """Posterior weights (d,), for a mean (n, K), bases (P, K) and values of the points (P, n)."""
    _, cross, total, lower, scale = factor
    points, count = values.shape
    rows = total.shape[0]
    gap = np.empty(rows)
    for r in range(rows):
        j, p = r // points, r % points
        gap[r] = target[p, j]
        for k in range(count):
            gap[r] -= values[p, k] * mean[j, k]
    dual = gap.copy()
    _solve_one(lower, scale, dual)
    rest = gap.copy()
    for r in range(rows):
        for c in range(rows):
            rest[r] -= total[r, c] * dual[c]
    _solve_one(lower, scale, rest)
    for r in range(rows):
        dual[r] += rest[r]
    weights = mean.copy().reshape(-1)
    for r in range(rows):
        for c in range(mean.size):
            weights[c] += dual[r] * cross[r, c]
    return weights


@kernel
def joint_covariance(
    factor: Factor, prior: FloatArray, values: FloatArray, noise: FloatArray
) -> FloatArray:
    r"""Posterior covariance (d, d): Joseph's form (I - KH) Σ (I - KH)ᵀ + K R Kᵀ.

    It is multiplied out from the left so that no product of two (d, d) matrices is made:

    .. math:: A = \Sigma - K (H \Sigma), \qquad \Sigma^+ = A + (K R - A H^T) K^T.
    """
    _, cross, _, lower, scale = factor
    rows, size = cross.shape
    gain = cross.copy()  # Kᵀ = S⁻¹ H Σ
    substitute(lower, scale, gain)
    kept = prior.copy()
    for i in range(size):
        for r in range(rows):
            share = gain[r, i]
            for c in range(size):
                kept[i, c] -= share * cross[r, c]
    correction = along_rows(kept, values, values.shape[1])
    for r in range(rows):
        for i in range(size):
            correction[i, r] = -correction[i, r]
        for s in range(rows):
            if noise[s, r] != 0.0:
                for i in range(size):
                    correction[i, r] += gain[s, i] * noise[s, r]
    for i in range(size):
        for r in range(rows):
            share = correction[i, r]
            for c in range(size):
                kept[i, c] += share * gain[r, c]
    for i in range(size):
        for c in range(i):
            kept[i, c] = kept[c, i] = 0.5 * (kept[i, c] + kept[c, i])
    return kept


@kernel
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


@kernel
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


@kernel
def _solve_one(lower: FloatArray, scale: FloatArray, right: FloatArray) -> None:
    """:func:`substitute` for one right-hand side (r,), along the rows of L both ways."""
    rows = right.shape[0]
    for i in range(rows):
        right[i] *= scale[i]
        for k in range(i):
            right[i] -= lower[i, k] * right[k]
        right[i] /= lower[i, i]
    for i in range(rows - 1, -1, -1):
        right[i] /= lower[i, i]
        for k in range(i):
            right[k] -= lower[i, k] * right[i]
    for i in range(rows):
        right[i] *= scale[i]
