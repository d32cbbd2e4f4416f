"""Learning a ProMP: in closed form from complete demonstrations, by EM from partial ones."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from optipromp.arrays import FloatArray
from optipromp.errors import InvalidDemonstrationError
from optipromp.promp.basis import Basis
from optipromp.promp.checks import PHASE_TOLERANCE, positive, regularised
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

RIDGE = 1e-10
"""λ [-] of :func:`fit`: weights that the samples determine move by less than rounding matters."""


def fit(
    demonstrations: DemonstrationsLike,
    basis: Basis | None = None,
    *,
    ridge: float = RIDGE,
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
    complete(samples)
    short = [i for i, phases in enumerate(samples.phases) if phases.size < basis.count]
    if short:
        size = samples.phases[short[0]].size
        regularised(
            f"{len(short)} demonstration(s) have fewer samples than the {basis.count} bases, the "
            f"first is number {short[0]} with {size}; ridge regression completes them"
        )
    weights = ridge_weights(samples, basis, ridge)
    rest = residuals_of(samples, basis, weights)
    mean, covariance = distribution(weights, strength, prior_covariance)
    demos = len(weights)
    if demos == 1:
        regularised("one demonstration says nothing about spread; the covariance is the prior's")
    elif np.abs(weights - mean).max() <= 1e-9 * max(float(np.abs(weights).max()), 1e-3):
        regularised(f"the {demos} demonstrations are identical; the covariance is the prior's")
    total = sum(phases.size for phases in samples.phases)
    freedom = total - demos * basis.count
    squares = np.einsum("mj,mj->j", rest, rest)
    noise = np.maximum(squares / (freedom if freedom > 0 else total), NOISE_FLOOR)
    if not np.isfinite(covariance).all():
        raise InvalidDemonstrationError("the demonstrations' values are too large to learn from")
    return made(basis, mean, covariance, noise, samples.joint_names)


def complete(samples: Samples) -> None:
    """Raise ``InvalidDemonstrationError`` if a demonstration is partial."""
    for i, phases in enumerate(samples.phases):
        if phases[0] > PHASE_TOLERANCE or phases[-1] < 1.0 - PHASE_TOLERANCE:
            raise InvalidDemonstrationError(
                f"demonstration {i} is partial (phases {phases[0]:.3g} to {phases[-1]:.3g}); "
                "fit_em learns from partial ones"
            )


def distribution(
    weights: FloatArray, strength: float, prior_covariance: ArrayLike | None = None
) -> tuple[FloatArray, FloatArray]:
    """Mean (n, K) and covariance (nK, nK) of the weights (N, n, K), as :func:`fit` has them."""
    demos, _, count = weights.shape
    mean = weights.mean(axis=0)
    centred = (weights - mean).reshape(demos, -1)
    scatter = centred.T @ centred
    if prior_covariance is None:
        floor = np.repeat(deviation_floor(np.ptp(weights, axis=(0, 2)), demos) ** 2, count)
        prior = np.diag(np.maximum(np.diagonal(scatter) / demos, floor))
    else:
        prior = given_prior(prior_covariance, mean.size)
    return mean, (scatter + strength * prior) / (demos + strength)


def ridge_weights(samples: Samples, basis: Basis, ridge: float = RIDGE) -> FloatArray:
    """Weights (N, n, K) of each demonstration."""
    count = basis.count
    weights: FloatArray
    if samples.stacked is not None:
        y = samples.stacked
        demos, size, n = y.shape
        values = _shared_bases(samples, basis)
        gram = values.T @ values / size
        gram.flat[:: count + 1] += ridge
        middle = np.full((1, size), 1.0 / size) @ y
        right = (values.T / size) @ (y - middle)
        flat = right.transpose(1, 0, 2).reshape(count, demos * n)
        solved = np.linalg.solve(gram, flat).reshape(count, demos, n)
        weights = solved.transpose(1, 2, 0) + middle.transpose(0, 2, 1)
        return weights
    pairs = list(zip(_each_bases(samples, basis), samples.positions, strict=True))
    grams = np.stack([values.T @ values / len(values) for values, _ in pairs])
    grams += ridge * np.eye(count)
    means = np.stack([y.mean(axis=0) for y in samples.positions])
    rights = np.stack([v.T @ (y - c) / len(v) for (v, y), c in zip(pairs, means, strict=True)])
    weights = np.linalg.solve(grams, rights).transpose(0, 2, 1) + means[:, :, None]
    return weights


def residuals_of(samples: Samples, basis: Basis, weights: FloatArray) -> FloatArray:
    """Y_i - Φ_i W_i for weights (N, n, K), one demonstration after another (M, n)."""
    if samples.stacked is not None:
        rest = samples.stacked - _shared_bases(samples, basis) @ weights.transpose(0, 2, 1)
        return rest.reshape(-1, samples.n_joints)
    values = _each_bases(samples, basis)
    pairs = zip(samples.positions, values, weights, strict=True)
    return np.concatenate([y - v @ w.T for y, v, w in pairs])


def _shared_bases(samples: Samples, basis: Basis) -> FloatArray:
    return basis.evaluate(len(samples.phases[0]) if samples.even else samples.phases[0])


def _each_bases(samples: Samples, basis: Basis) -> list[FloatArray]:
    ends = np.cumsum([phases.size for phases in samples.phases])[:-1]
    return np.split(basis.evaluate(np.concatenate(samples.phases)), ends)
