"""Learning a ProMP from partial or unevenly sampled demonstrations."""

import warnings
from collections.abc import Iterator, Sequence

import numpy as np

from optipromp.core.arrays import FloatArray
from optipromp.core.errors import InvalidRequestError
from optipromp.core.promp.basis import Basis
from optipromp.core.promp.checks import ConvergenceWarning, regularised
from optipromp.core.promp.gaussian import add_noise, root
from optipromp.core.promp.learning import (
    NOISE_FLOOR,
    DemonstrationsLike,
    Samples,
    deviation_floor,
    gather,
)
from optipromp.core.promp.model import ProMP

TOLERANCE = 1e-3  # [-] a choice: far below the standard error of a mean or a variance
Parameters = tuple[FloatArray, FloatArray, FloatArray]  # mean, covariance, noise


def fit_em(
    demonstrations: DemonstrationsLike,
    basis: Basis | None = None,
    *,
    iterations: int = 1000,
    joint_names: Sequence[str] | None = None,
) -> ProMP:
    r"""Learn a ProMP by expectation-maximisation; demonstrations may be partial.

    The weights of each demonstration are hidden. :math:`\Phi_i` is the basis matrix at the phases
    of demonstration i. The E-step is the posterior :math:`N(m_i, C_i)` of its weights given
    :math:`\mu_w, \Sigma_w, r`; the M-step is

    .. math:: \mu_w = \tfrac1N\sum_i m_i, \quad
              \Sigma_w = \frac{S + \Sigma_0}{N + 1}, \quad
              S = \sum_i C_i + (m_i - \mu_w)(m_i - \mu_w)^T,

    .. math:: r_j = \tfrac1M\sum_i \|y_{ij} - \Phi_i m_{ij}\|^2
              + \mathrm{tr}(\Phi_i^T\Phi_i C_{i,jj}).

    The missing part of a demonstration is inferred from the covariance of the others. On complete,
    densely sampled demonstrations the result agrees with :func:`fit`, except that :math:`\Sigma_w`
    contains no observation noise. :math:`\Sigma_0` is as in :func:`fit`, with the diagonal of the
    current S/N. The iteration ends when every mean changes by less than :data:`TOLERANCE` of a
    standard deviation, and every variance and noise by less than :data:`TOLERANCE` of itself.

    Args:
        demonstrations: as for :func:`fit`; a partial one has :attr:`Demonstration.span`.
        basis: by default ``Basis()``.
        iterations: largest number of iterations, > 0.
        joint_names: n names, in place of the demonstrations' names.

    Warns:
        RegularisedWarning: one demonstration, identical ones, or phases that no demonstration
            covers.
        ConvergenceWarning: ``iterations`` were not enough.

    Raises:
        InvalidDemonstrationError: no demonstration, a value that is not finite, or unequal joints.
        InvalidRequestError: another argument out of range.
    """
    basis = basis or Basis()
    if iterations < 1:
        raise InvalidRequestError(f"iterations must be at least 1, got {iterations}")
    samples = gather(demonstrations, joint_names)
    data = _Sums(samples, basis)
    n, count, demos = samples.n_joints, basis.count, len(samples.phases)
    for gap in _gaps(data, basis):
        regularised(gap)
    floor = np.repeat(deviation_floor(samples.extent, demos) ** 2, count)

    current = _start(data, floor)
    for _ in range(iterations):
        means, covariances = _expectation(data, *current)
        new = _maximisation(data, means, covariances, floor)
        change, current = _change(current, new), new
        if change < TOLERANCE:
            break
    else:
        warnings.warn(
            f"expectation-maximisation still changed by {change:.2g} (tolerance {TOLERANCE:.2g}) "
            f"after {iterations} iterations",
            ConvergenceWarning,
            stacklevel=2,
        )
    mean, covariance, noise = current
    return ProMP(basis, mean.reshape(n, count), covariance, noise, samples.joint_names)


class _Sums:
    """Sums over the samples of each demonstration.

    ``gram`` (N, K, K) and ``moment`` (N, K, n) are Φᵀ Φ and Φᵀ Y. Demonstrations with the same
    phases share a posterior covariance, and so a kind: ``kind`` (N,) numbers the kinds, ``first``
    (U,) is the first demonstration of each kind, ``multiplicity`` (U,) their number.
    """

    def __init__(self, samples: Samples, basis: Basis) -> None:
        self.samples, self.n, self.count = samples, samples.n_joints, basis.count
        self.total = sum(phases.size for phases in samples.phases)
        self.values = values = samples.bases(basis)
        self.gram = np.stack([v.T @ v for v in values])
        self.moment = np.stack([v.T @ y for v, y in zip(values, samples.positions, strict=True)])
        keys: dict[bytes, int] = {}
        self.kind = np.array([keys.setdefault(g.tobytes(), len(keys)) for g in self.gram])
        self.first = np.array([int(np.argmax(self.kind == k)) for k in range(len(keys))])
        self.multiplicity = np.bincount(self.kind).astype(np.float64)
        apart = float(np.ptp(self.moment, axis=0).max())
        self.identical = len(keys) == 1 and apart <= 1e-9 * float(np.abs(self.moment).max())


def _gaps(data: _Sums, basis: Basis) -> Iterator[str]:
    """Messages about a spread or phases that the demonstrations leave to the prior."""
    demos = len(data.samples.phases)
    if demos == 1:
        yield "one demonstration says nothing about spread; the covariance is the prior's"
    elif data.identical:
        yield f"the {demos} demonstrations are identical; the covariance is the prior's"
    cover = data.gram.sum(axis=0).diagonal()
    if (cover < 1e-3).any():
        yield (
            f"no demonstration shows the movement near phase "
            f"{basis.centers[int(np.argmin(cover))]:.2f}; the prior completes it"
        )


def _change(old: Parameters, new: Parameters) -> float:
    """Largest change of a mean in standard deviations, or relative change of a variance."""
    variance = np.diagonal(old[1])
    return max(
        float((np.abs(new[0] - old[0]) / np.sqrt(variance)).max()),
        float(np.abs(np.diagonal(new[1]) / variance - 1.0).max()),
        float(np.abs(new[2] / old[2] - 1.0).max()),
    )


def _start(data: _Sums, floor: FloatArray) -> Parameters:
    """Mean and variance of all samples pooled; 1 % of the variance as noise."""
    gram = data.gram.sum(axis=0)
    gram.flat[:: data.count + 1] += 1e-6 * data.total
    middle = np.concatenate(data.samples.positions).mean(axis=0)
    right = data.moment.sum(axis=0) - np.outer(data.gram.sum(axis=0).sum(axis=1), middle)
    mean = np.linalg.solve(gram, right).T + middle[:, None]
    spread = np.zeros(data.n)
    for values, y in zip(data.values, data.samples.positions, strict=True):
        spread += ((y - values @ mean.T) ** 2).sum(axis=0)
    spread /= data.total
    covariance = np.diag(np.maximum(np.repeat(spread, data.count), floor))
    noise = np.maximum(1e-2 * spread, NOISE_FLOOR)
    return mean.reshape(-1), covariance, noise


def _expectation(
    data: _Sums, mean: FloatArray, covariance: FloatArray, noise: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Posterior means (N, nK) and, per kind of demonstration, covariances (U, nK, nK)."""
    n, count = data.n, data.count
    factor = root(covariance)
    blocks = factor.reshape(n, count, -1)
    gram = data.gram[data.first]
    weighted = gram[:, None] @ (blocks / noise[:, None, None])
    matrix = factor.T @ weighted.reshape(len(gram), n * count, -1)
    add_noise(matrix, 1.0)
    covariances = factor @ np.linalg.solve(matrix, factor.T)
    covariances = 0.5 * (covariances + covariances.transpose(0, 2, 1))
    gap = data.moment - data.gram @ mean.reshape(n, count).T
    force = (gap / noise).transpose(0, 2, 1).reshape(len(gap), -1)
    means = mean + (covariances[data.kind] @ force[..., None])[..., 0]
    return means, covariances


def _maximisation(
    data: _Sums, means: FloatArray, covariances: FloatArray, floor: FloatArray
) -> Parameters:
    """The M-step: mean (nK,), covariance (nK, nK) and noise (n,) given the posteriors."""
    demos = len(means)
    mean = means.mean(axis=0)
    centred = means - mean
    scatter = centred.T @ centred + np.tensordot(data.multiplicity, covariances, axes=1)
    prior = np.diag(np.maximum(np.diagonal(scatter) / demos, floor))
    covariance = (scatter + prior) / (demos + 1.0)
    return mean, covariance, _noise(data, means, covariances)


def _noise(data: _Sums, means: FloatArray, covariances: FloatArray) -> FloatArray:
    """Observation variance (n,) that maximises the expected log-likelihood."""
    n, count = data.n, data.count
    blocks = np.einsum("ujkjl->ujkl", covariances.reshape(-1, n, count, n, count))
    traces = np.einsum("ukl,ujkl->uj", data.gram[data.first], blocks)
    total: FloatArray = data.multiplicity @ traces
    for values, y, weights in zip(data.values, data.samples.positions, means, strict=True):
        total = total + ((y - values @ weights.reshape(n, count).T) ** 2).sum(axis=0)
    return np.maximum(total / data.total, NOISE_FLOOR)
