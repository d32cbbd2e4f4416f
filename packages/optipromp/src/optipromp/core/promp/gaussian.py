"""Gaussians whose covariance may be singular, and their update by observations."""

from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from optipromp.core.arrays import FloatArray
from optipromp.core.compiled import kernel
from optipromp.core.errors import InvalidRequestError
from optipromp.core.values import array

RANK_TOLERANCE = 1e-11  # [-] a direction with a smaller share of the variance counts as having none


def check_covariance(covariance: ArrayLike, size: int, name: str) -> FloatArray:
    """A symmetric copy (size, size) of a positive semi-definite matrix, which may be singular."""
    matrix = array(name, covariance, size, size, order="K")
    scale = float(np.abs(matrix).max(initial=0.0))
    asymmetry = float(np.abs(matrix - matrix.T).max(initial=0.0))
    if asymmetry > 1e-8 * scale:
        raise InvalidRequestError(f"{name} is not symmetric: entries differ by {asymmetry:.3g}")
    matrix = 0.5 * (matrix + matrix.T)
    with suppress(np.linalg.LinAlgError):
        np.linalg.cholesky(matrix)
        return matrix
    eigenvalues = np.linalg.eigvalsh(matrix)
    if eigenvalues[0] < -1e-10 * max(float(eigenvalues[-1]), 0.0):
        raise InvalidRequestError(
            f"{name} is not positive semi-definite: smallest eigenvalue {eigenvalues[0]:.3g}, "
            f"largest {eigenvalues[-1]:.3g}"
        )
    return matrix


def square_root(covariance: FloatArray) -> FloatArray:
    """A factor L (d, d) with L Lᵀ = covariance, which may be singular."""
    try:
        return np.asarray(np.linalg.cholesky(covariance))
    except np.linalg.LinAlgError:
        eigenvalues, vectors = np.linalg.eigh(covariance)
    return np.asarray(vectors * np.sqrt(np.maximum(eigenvalues, 0.0)))


def add_noise(matrix: FloatArray, noise: ArrayLike) -> None:
    """Add variances to the diagonals of positive semi-definite matrices (..., d, d), in place.

    At least the rounding error of the diagonal is added, so that the sum is invertible.
    """
    diagonal = np.einsum("...ii->...i", matrix)  # a view
    rounding = 10.0 * diagonal.shape[-1] * np.finfo(np.float64).eps
    diagonal += np.maximum(noise, rounding * diagonal)


@dataclass(frozen=True, eq=False)
class Inverse:
    """A symmetric positive semi-definite S (p, p), ready for S⁺ b."""

    scale: FloatArray  # (p,) diagonal of D, with which D S D has a unit diagonal
    lower: FloatArray  # (p, p) L with L Lᵀ = D S D, where S is safely definite
    pseudo: FloatArray | None = None  # (p, p) pseudo-inverse of D S D, where S is not
    # (p, m) scaled directions without variance; None where S has full rank
    null: FloatArray | None = None

    def solve(self, right: FloatArray) -> FloatArray:
        """S⁺ b for b (p,) or (p, m)."""
        columns = right.reshape(len(right), -1)
        if self.pseudo is None:
            solved = _substituted(self.lower, self.scale, columns)
        else:
            scale = self.scale[:, None]
            solved = scale * (self.pseudo @ (scale * columns))
        return np.asarray(solved.reshape(right.shape))

    def out_of_reach(self, right: FloatArray) -> FloatArray | None:
        """The part of b (p,) outside the range of S, or None if S has full rank."""
        if self.null is None:
            return None
        return np.asarray(self.null @ (self.null.T @ (self.scale * right)) / self.scale)


def factorise(matrix: FloatArray, reference: FloatArray) -> Inverse:
    """Invert S (p, p): by Cholesky if S is safely definite, else without its null directions.

    ``matrix``: S, symmetric. ``reference``: (p,) upper bound of each variance before cancellation.
    A diagonal entry below 1e-13 of its bound is rounding and counts as 0.
    """
    definite, scale, lower = _cholesky(matrix, reference)
    if definite:
        return Inverse(scale, lower)
    diagonal = np.diagonal(matrix)
    alive = diagonal > 1e-13 * reference
    scale = 1.0 / np.sqrt(np.where(alive, diagonal, 1.0))
    scaled = matrix * scale * scale[:, None]
    scaled[~alive] = 0.0
    scaled[:, ~alive] = 0.0
    eigenvalues, vectors = np.linalg.eigh(0.5 * (scaled + scaled.T))
    kept = eigenvalues > RANK_TOLERANCE * max(float(eigenvalues[-1]), 1.0)
    pseudo = (vectors[:, kept] / eigenvalues[kept]) @ vectors[:, kept].T
    return Inverse(scale, lower, pseudo, None if kept.all() else vectors[:, ~kept])


@dataclass(frozen=True, eq=False)
class Update:
    r"""The update of a Gaussian by observations, by which every primitive is conditioned.

    The prior is :math:`w \sim N(\mu, \Sigma)`, an observation :math:`y = Hw + \epsilon` with
    :math:`\epsilon \sim N(0, R)`. Then :math:`S = H\Sigma H^T + R`,
    :math:`K = \Sigma H^T S^{-1}` and

    .. math:: \mu^+ = \mu + K(y - H\mu), \qquad
              \Sigma^+ = (I - KH)\Sigma(I - KH)^T + KRK^T

    (Paraschos et al., 2013; the covariance in the form of Bucy and Joseph, 1968, in which an error
    of K counts only squared). S may be singular where observations are exact. :func:`observed`
    builds an update.
    """

    prior: FloatArray  # Σ (d, d)
    rows: FloatArray  # H (r, d)
    noise: FloatArray  # R (r, r)
    cross: FloatArray  # H Σ (r, d)
    total: FloatArray  # S (r, r)
    inverse: Inverse  # S⁺

    def mean(self, mean: FloatArray, values: FloatArray) -> FloatArray:
        """The posterior mean μ⁺ (d,), for the prior's μ (d,) and observed values y (r,)."""
        inverse = self.inverse
        if inverse.pseudo is None:
            solved = inverse.lower, inverse.scale
            return np.asarray(_mean(self.rows, self.cross, self.total, *solved, mean, values))
        return mean + self.force(values - self.rows @ mean) @ self.cross

    def force(self, gap: FloatArray) -> FloatArray:
        """λ = S⁺ (y - H μ) (r,) for a gap y - H μ, refined once: μ⁺ = μ + Σ Hᵀ λ."""
        if self.inverse.pseudo is None:
            lower, scale = self.inverse.lower, self.inverse.scale
            return np.asarray(_force(self.total, lower, scale, gap))
        force = self.inverse.solve(gap)
        return force + self.inverse.solve(gap - self.total @ force)

    def covariance(self) -> FloatArray:
        """The posterior covariance Σ⁺ (d, d)."""
        gain = self.inverse.solve(self.cross)
        return np.asarray(_joseph(self.prior, self.rows, self.noise, self.cross, gain))


def observed(prior: FloatArray, rows: FloatArray, noise: FloatArray) -> Update:
    """The update of a Gaussian of covariance ``prior`` Σ (d, d) by observations.

    ``prior``: Σ. ``rows``: H (r, d). The cost of a row grows with the span of its nonzero entries.
    ``noise``: R (r, r), or (r,) the variances of independent observations; 0 is exact.
    """
    noise = np.diag(noise) if noise.ndim == 1 else noise
    cross, total, reference = _spread(prior, rows, noise)
    return Update(prior, rows, noise, cross, total, factorise(total, reference))


@kernel
def _spread(prior, rows, noise):
    """H Σ (r, d), S (r, r), and upper bounds (r,) of the variances of S before cancellation."""
    count, size = rows.shape
    cross, reference = np.zeros((count, size)), np.empty(count)
    for r in range(count):
        deviation = 0.0
        for k in range(size):
            value = rows[r, k]
            if value != 0.0:
                deviation += np.sqrt(max(prior[k, k], 0.0)) * abs(value)
                for c in range(size):
                    cross[r, c] += value * prior[k, c]
        reference[r] = deviation * deviation + noise[r, r]
    total = _along_rows(cross, rows)
    for r in range(count):
        for s in range(count):
            total[r, s] += noise[r, s]
    return cross, total, reference


@kernel
def _along_rows(matrix, rows):
    """M Hᵀ (m, r) for M (m, d) and H (r, d)."""
    count, size = rows.shape
    out = np.empty((matrix.shape[0], count))
    for r in range(count):
        first, last = 0, size
        while first < last and rows[r, first] == 0.0:
            first += 1
        while last > first and rows[r, last - 1] == 0.0:
            last -= 1
        for i in range(matrix.shape[0]):
            value = 0.0
            for k in range(first, last):
                value += matrix[i, k] * rows[r, k]
            out[i, r] = value
    return out


@kernel
def _cholesky(matrix, reference):
    """Whether S is safely definite; if so, the scale (p,) and L (p, p) of :class:`Inverse`.

    Given the earlier rows, each row must keep a share of RANK_TOLERANCE of its variance.
    """
    size = matrix.shape[0]
    scale, lower = np.empty(size), np.zeros((size, size))
    for i in range(size):
        if not matrix[i, i] > 1e-13 * reference[i]:
            return False, scale, lower
        scale[i] = 1.0 / np.sqrt(matrix[i, i])
    for i in range(size):
        for j in range(i + 1):
            value = matrix[i, j] * scale[i] * scale[j]
            for k in range(j):
                value -= lower[i, k] * lower[j, k]
            if j < i:
                lower[i, j] = value / lower[j, j]
            elif value > RANK_TOLERANCE:
                lower[i, i] = np.sqrt(value)
            else:
                return False, scale, lower
    return True, scale, lower


@kernel
def _substituted(lower, scale, right):
    """S⁻¹ b for b (p, m)."""
    rows, columns = right.shape
    out = np.empty((rows, columns))
    for i in range(rows):
        for c in range(columns):
            out[i, c] = right[i, c] * scale[i]
        for k in range(i):
            factor = lower[i, k]
            for c in range(columns):
                out[i, c] -= factor * out[k, c]
        for c in range(columns):
            out[i, c] /= lower[i, i]
    for i in range(rows - 1, -1, -1):
        for k in range(i + 1, rows):
            factor = lower[k, i]
            for c in range(columns):
                out[i, c] -= factor * out[k, c]
        for c in range(columns):
            out[i, c] /= lower[i, i]
    for i in range(rows):
        for c in range(columns):
            out[i, c] *= scale[i]
    return out


@kernel
def _force(total, lower, scale, gap):
    """S⁻¹ b for one b (p,), refined once."""
    rows = len(gap)
    force, rest = np.zeros(rows), gap.copy()
    for turn in range(2):
        for i in range(rows):
            rest[i] *= scale[i]
            for k in range(i):
                rest[i] -= lower[i, k] * rest[k]
            rest[i] /= lower[i, i]
        for i in range(rows - 1, -1, -1):
            rest[i] /= lower[i, i]
            for k in range(i):
                rest[k] -= lower[i, k] * rest[i]
        for i in range(rows):
            force[i] += rest[i] * scale[i]
        for i in range(rows if turn == 0 else 0):
            rest[i] = gap[i]
            for k in range(rows):
                rest[i] -= total[i, k] * force[k]
    return force


@kernel
def _mean(rows, cross, total, lower, scale, mean, values):
    """μ + Σ Hᵀ S⁻¹ (y - H μ) (d,)."""
    gap = values.copy()
    for r in range(len(gap)):
        for k in range(len(mean)):
            if rows[r, k] != 0.0:
                gap[r] -= rows[r, k] * mean[k]
    force = _force(total, lower, scale, gap)
    moved = mean.copy()
    for r in range(len(gap)):
        for c in range(len(mean)):
            moved[c] += force[r] * cross[r, c]
    return moved


@kernel
def _joseph(prior, rows, noise, cross, gain):
    r"""Σ⁺ (d, d), for the gain Kᵀ (r, d), without a product of two (d, d) matrices.

    .. math:: A = \Sigma - K (H \Sigma), \qquad \Sigma^+ = A + (K R - A H^T) K^T.
    """
    count, size = cross.shape
    kept = prior.copy()
    for i in range(size):
        for r in range(count):
            share = gain[r, i]
            for c in range(size):
                kept[i, c] -= share * cross[r, c]
    correction = -_along_rows(kept, rows)
    for r in range(count):
        for s in range(count):
            if noise[s, r] != 0.0:
                for i in range(size):
                    correction[i, r] += gain[s, i] * noise[s, r]
    for i in range(size):
        for r in range(count):
            share = correction[i, r]
            for c in range(size):
                kept[i, c] += share * gain[r, c]
    for i in range(size):
        for c in range(i):
            kept[i, c] = kept[c, i] = 0.5 * (kept[i, c] + kept[c, i])
    return kept
