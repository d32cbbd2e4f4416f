"""Linear algebra of Gaussians whose covariance may be singular.

NumPy only, on purpose: NumPy and SciPy bring a threaded OpenBLAS each, and calls that alternate
between the two wait for one another's threads (measured on two cores: 8 ms instead of 0.2 ms).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from optipromp.arrays import FloatArray
from optipromp.errors import InvalidRequestError
from optipromp.promp.checks import finite_array

RANK_TOLERANCE = 1e-11
"""Directions whose share of the variance is below this count as having none."""
_SURE_PIVOT = 1e-6
"""A pivot above it is none of rounding, which overlapping bases raise to 1e-9."""
_SYMMETRY_TOLERANCE = 1e-8
_NEGATIVE_TOLERANCE = 1e-10


def check_covariance(covariance: ArrayLike, size: int, name: str) -> FloatArray:
    """A symmetric positive semi-definite copy, or ``InvalidRequestError`` saying what is wrong.

    Asymmetry and negative eigenvalues of the size of rounding are let through; singular matrices
    are allowed (a distribution conditioned exactly has one).
    """
    matrix = finite_array(covariance, name, 2)
    if matrix.shape != (size, size):
        raise InvalidRequestError(f"{name}: expected shape ({size}, {size}), got {matrix.shape}")
    scale = float(np.abs(matrix).max(initial=0.0))
    asymmetry = float(np.abs(matrix - matrix.T).max(initial=0.0))
    if asymmetry > _SYMMETRY_TOLERANCE * scale:
        raise InvalidRequestError(f"{name} is not symmetric: entries differ by {asymmetry:.3g}")
    matrix = 0.5 * (matrix + matrix.T)
    if is_definite(matrix):
        return matrix
    eigenvalues = np.linalg.eigvalsh(matrix)
    if eigenvalues[0] < -_NEGATIVE_TOLERANCE * max(float(eigenvalues[-1]), 0.0):
        raise InvalidRequestError(
            f"{name} is not positive semi-definite: smallest eigenvalue {eigenvalues[0]:.3g}, "
            f"largest {eigenvalues[-1]:.3g}"
        )
    return matrix


def root(covariance: FloatArray) -> FloatArray:
    """A factor L (d, d) with L Lᵀ = covariance, also for a singular one."""
    try:
        return np.asarray(np.linalg.cholesky(covariance))
    except np.linalg.LinAlgError:
        eigenvalues, vectors = np.linalg.eigh(covariance)
    factor: FloatArray = vectors * np.sqrt(np.maximum(eigenvalues, 0.0))
    return factor


def add_noise(matrix: FloatArray, noise: ArrayLike) -> None:
    """Add variances to the diagonals of positive semi-definite matrices (..., d, d), in place.

    Where a diagonal is so large that they would be lost, as much as rounding makes of it is added:
    the result can always be inverted.
    """
    diagonal = np.einsum("...ii->...i", matrix)  # a view
    rounding = 10.0 * diagonal.shape[-1] * np.finfo(np.float64).eps
    diagonal += np.maximum(noise, rounding * diagonal)


@dataclass(frozen=True)
class Inverse:
    """A symmetric positive semi-definite S (p, p), ready for S⁺ b.

    ``inverse`` is the (pseudo-)inverse of S scaled to a unit diagonal by ``scale`` (p,), the
    square roots of its own. ``null`` spans the scaled directions without variance; None: none.
    """

    scale: FloatArray
    inverse: FloatArray
    null: FloatArray | None

    def solve(self, right: FloatArray) -> FloatArray:
        """S⁺ b for b (p,) or (p, m)."""
        scale = self.scale if right.ndim == 1 else self.scale[:, None]
        solution: FloatArray = self.inverse @ (right / scale)
        return solution / scale

    def out_of_reach(self, right: FloatArray) -> FloatArray | None:
        """The part of b (p,) outside the range of S, or None if S has full rank."""
        if self.null is None:
            return None
        part: FloatArray = self.scale * (self.null @ (self.null.T @ (right / self.scale)))
        return part


def factorise(matrix: FloatArray, reference: FloatArray, pivot: float = RANK_TOLERANCE) -> Inverse:
    """Invert S (p, p): plainly if it is safely definite, else without its null directions.

    Args:
        matrix: S, symmetric.
        reference: (p,) upper bounds on each variance, before cancellation: a diagonal entry
            below 1e-13 of it is rounding and counts as 0.
        pivot: of the scaled S, above which it is safely definite.
    """
    diagonal = np.diagonal(matrix)
    alive = diagonal > 1e-13 * reference
    if alive.all():
        scale = np.sqrt(diagonal)
        scaled = matrix / scale
        scaled /= scale[:, None]
        if is_definite(scaled, pivot):
            return Inverse(scale, np.asarray(np.linalg.inv(scaled)), None)
    else:
        scale = np.where(alive, np.sqrt(np.maximum(diagonal, 0.0)), 1.0)
        scaled = matrix / scale / scale[:, None]
        scaled[~alive] = 0.0
        scaled[:, ~alive] = 0.0
    eigenvalues, vectors = np.linalg.eigh(0.5 * (scaled + scaled.T))
    kept = eigenvalues > RANK_TOLERANCE * max(float(eigenvalues[-1]), 1.0)
    inverse = (vectors[:, kept] / eigenvalues[kept]) @ vectors[:, kept].T
    return Inverse(scale, inverse, None if kept.all() else vectors[:, ~kept])


def is_definite(matrix: FloatArray, share: float = 0.0) -> bool:
    """Whether a Cholesky factorisation succeeds with no pivot below ``share``."""
    try:
        factor = np.linalg.cholesky(matrix)
    except np.linalg.LinAlgError:
        return False
    return bool(np.diagonal(factor).min() ** 2 > share)


def joseph(
    covariance: FloatArray, gain: FloatArray, gain_rows: FloatArray, noise: FloatArray
) -> FloatArray:
    """Updated covariance (I - KH) Σ (I - KH)ᵀ + K R Kᵀ, which errors of K reach only squared.

    Args:
        covariance: Σ (d, d).
        gain: K (d, p).
        gain_rows: K H (d, d).
        noise: R (p,) diagonal or (p, p).
    """
    keep = -gain_rows
    keep.flat[:: keep.shape[0] + 1] += 1.0
    updated = keep @ covariance @ keep.T
    updated += (gain * noise if noise.ndim == 1 else gain @ noise) @ gain.T
    return 0.5 * (updated + updated.T)


def product(
    first: tuple[FloatArray, FloatArray], second: tuple[FloatArray, FloatArray], name: str
) -> tuple[FloatArray, FloatArray]:
    """Normalised product N(a, A) N(b, B) of two Gaussians, each its mean (d,), covariance (d, d).

    The update of N(a, A) by an observation b of covariance B, gain K = A (A + B)⁺: no inverse of A
    or B, so either may be singular.

    Raises:
        InvalidRequestError: both have no variance in a direction in which they differ; the message
            begins with ``name``.
    """
    (a, A), (b, B) = first, second
    total = factorise(A + B, np.diagonal(A) + np.diagonal(B), _SURE_PIVOT)
    missed = total.out_of_reach(b - a)
    if missed is not None and float(np.abs(missed).max()) > 1e-8:
        raise InvalidRequestError(
            f"{name}: both are certain of different values (they differ by "
            f"{np.abs(missed).max():.3g} where neither has variance)"
        )
    gain = total.solve(A).T
    return a + gain @ (b - a), joseph(A, gain, gain, B)
