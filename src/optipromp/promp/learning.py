"""Learning a ProMP: in closed form from complete demonstrations, by EM from partial ones."""

import warnings
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from optipromp.arrays import FloatArray
from optipromp.errors import InvalidDemonstrationError
from optipromp.promp.basis import Basis
from optipromp.promp.checks import PHASE_TOLERANCE, RegularisedWarning, positive
from optipromp.promp.em import fit_em
from optipromp.promp.model import ProMP, made
from optipromp.promp.samples import (
    NOISE_FLOOR,
    DemonstrationsLike,
    Samples,
    deviation_floor,
    gather,
    given_prior,
)

__all__ = ["fit", "fit_em"]


def fit(
    demonstrations: DemonstrationsLike,
    basis: Basis | None = None,
    *,
    ridge: float = 1e-10,
    prior_strength: float = 1.0,
    prior_covariance: ArrayLike | None = None,
    joint_names: Sequence[str] | None = None,
) -> ProMP:
    r"""Learn a ProMP from complete demonstrations, in closed form.

    Each demonstration is aligned on phase and gets its weights by ridge regression, shrunk towards
    its own mean position :math:`\bar y_i`:

    .. math:: W_i = \arg\min_W \tfrac{1}{m_i}\|Y_i - \Phi_i W\|^2 + \lambda\|W - \bar y_i\|^2

    :math:`\mu_w` is their mean, and with :math:`S = \sum_i (w_i - \mu_w)(w_i - \mu_w)^T`

    .. math:: \Sigma_w = \frac{S + N_0 \Sigma_0}{N + N_0},

    the mode under an inverse-Wishart prior worth :math:`N_0` demonstrations of covariance
    :math:`\Sigma_0`. By default :math:`\Sigma_0` is the diagonal of S/N, no entry below
    (1 % of that joint's range of motion)² — 10 % for a single demonstration, which says nothing
    about spread — so :math:`\Sigma_w` is positive definite for any number of demonstrations.
    Demonstrations on the same phases share one factorisation.

    Args:
        demonstrations: N of them. Bare arrays are evenly spaced in phase from 0 to 1.
        basis: by default ``Basis()``, the paper's.
        ridge: λ > 0 [-].
        prior_strength: N_0 > 0 [demonstrations].
        prior_covariance: Σ_0, (nK, nK) positive definite, or a variance for all weights.
        joint_names: n names, in place of those of the demonstrations.

    Warns:
        RegularisedWarning: the prior decided: one demonstration, identical ones, or fewer samples
            than bases.

    Raises:
        InvalidDemonstrationError: none, values that are not finite, unequal joints, or a partial
            one (see :func:`fit_em`).
        InvalidRequestError: another argument out of range.
    """
    basis = basis or Basis()
    ridge = positive(ridge, "ridge")
    strength = positive(prior_strength, "prior_strength")
    samples = gather(demonstrations, joint_names)
    for i, phases in enumerate(samples.phases):
        if phases[0] > PHASE_TOLERANCE or phases[-1] < 1.0 - PHASE_TOLERANCE:
            raise InvalidDemonstrationError(
                f"demonstration {i} is partial (phases {phases[0]:.3g} to {phases[-1]:.3g}); "
                "fit_em learns from partial ones"
            )
    short = [i for i, phases in enumerate(samples.phases) if phases.size < basis.count]
    if short:
        size = samples.phases[short[0]].size
        _regularised(
            f"{len(short)} demonstration(s) have fewer samples than the {basis.count} bases, the "
            f"first is number {short[0]} with {size}; ridge regression completes them"
        )
    weights, residual = _ridge_weights(samples, basis, ridge)
    n, demos = samples.n_joints, len(samples.phases)
    mean = weights.mean(axis=0)
    centred = weights - mean
    scatter = centred.T @ centred
    if prior_covariance is None:
        extent = np.ptp(weights.reshape(demos, n, -1), axis=(0, 2))
        floor = np.repeat(deviation_floor(extent, demos) ** 2, basis.count)
        prior = np.diag(np.maximum(np.diagonal(scatter) / demos, floor))
    else:
        prior = given_prior(prior_covariance, mean.size)
    covariance = (scatter + strength * prior) / (demos + strength)
    if demos == 1:
        _regularised("one demonstration says nothing about spread; the covariance is the prior's")
    elif np.abs(centred).max() <= 1e-9 * max(float(np.abs(weights).max()), 1e-3):
        _regularised(f"the {demos} demonstrations are identical; the covariance is the prior's")
    total = sum(phases.size for phases in samples.phases)
    freedom = total - demos * basis.count
    noise = np.maximum(residual / (freedom if freedom > 0 else total), NOISE_FLOOR)
    if not np.isfinite(covariance).all():
        raise InvalidDemonstrationError("the demonstrations' values are too large to learn from")
    return made(basis, mean.reshape(n, -1), covariance, noise, samples.joint_names)


def _regularised(message: str) -> None:
    warnings.warn(message, RegularisedWarning, stacklevel=3)


def _ridge_weights(samples: Samples, basis: Basis, ridge: float) -> tuple[FloatArray, FloatArray]:
    """Weights (N, nK) of each demonstration and the squared residual (n,) over all of them."""
    n, count = samples.n_joints, basis.count
    if samples.stacked is not None:
        y = samples.stacked
        demos, size = y.shape[:2]
        values = basis.evaluate(size if samples.even else samples.phases[0])
        gram = values.T @ values / size
        gram.flat[:: count + 1] += ridge
        middle = np.full((1, size), 1.0 / size) @ y
        right = (values.T / size) @ (y - middle)
        flat = right.transpose(1, 0, 2).reshape(count, demos * n)
        solved = np.linalg.solve(gram, flat).reshape(count, demos, n)
        weights = solved.transpose(1, 2, 0) + middle.transpose(0, 2, 1)
        rest = y - values @ weights.transpose(0, 2, 1)
        residual: FloatArray = np.einsum("itj,itj->j", rest, rest)
        return weights.reshape(demos, n * count), residual
    ends = np.cumsum([phases.size for phases in samples.phases])[:-1]
    values_of = np.split(basis.evaluate(np.concatenate(samples.phases)), ends)
    pairs = list(zip(values_of, samples.positions, strict=True))
    grams = np.stack([values.T @ values / len(values) for values in values_of])
    grams += ridge * np.eye(count)
    means = np.stack([y.mean(axis=0) for y in samples.positions])
    rights = np.stack([v.T @ (y - c) / len(v) for (v, y), c in zip(pairs, means, strict=True)])
    weights = np.linalg.solve(grams, rights).transpose(0, 2, 1) + means[:, :, None]
    residual = np.zeros(n)
    for (values, y), w in zip(pairs, weights, strict=True):
        residual += ((y - values @ w.T) ** 2).sum(axis=0)
    return weights.reshape(len(pairs), n * count), residual
