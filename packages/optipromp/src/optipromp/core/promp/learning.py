"""Learning a ProMP, and choosing the number of bases.

:func:`fit` learns from complete demonstrations, :func:`fit_em` from partial or unevenly sampled
ones.
"""

import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from optipromp.core.arrays import FloatArray
from optipromp.core.errors import InvalidDemonstrationError, InvalidRequestError
from optipromp.core.promp import checks
from optipromp.core.promp.basis import Basis
from optipromp.core.promp.conditioning import conditioned_mean
from optipromp.core.promp.demonstrations import Demonstration, Demonstrations
from optipromp.core.promp.gaussian import add_noise, square_root
from optipromp.core.promp.model import ProMP, made
from optipromp.core.values import Positive, array, value

DemonstrationsLike = Demonstrations | Sequence[Demonstration] | Sequence[ArrayLike] | FloatArray
"""Demonstrations, a sequence of arrays (m_i, n), or one array (N, T, n)."""

NOISE_FLOOR = 1e-10  # [rad² or m²] smallest observation variance learnt: (1e-5 rad or m) squared
RIDGE = 1e-10  # [-] λ of :func:`fit`, too small to move a weight that the samples determine
COUNTS = range(4, 21)
"""Numbers of bases tried: from the smallest with one outside on each side to 20, where the held-out
residual of every tried set has risen again (docs/demonstrations.md)."""
FOLDS = 10  # parts into which demonstrations are divided; ten is the usual choice (Kohavi, 1995)


@dataclass(frozen=True, eq=False)
class Samples:
    """Demonstrations aligned on phase.

    ``phases`` and ``positions`` hold one array (m_i,) and (m_i, n) per demonstration. ``stacked``
    (N, T, n) holds all positions where the phases of all demonstrations are the same.
    """

    phases: tuple[FloatArray, ...]
    positions: tuple[FloatArray, ...]
    stacked: FloatArray | None
    joint_names: tuple[str, ...]

    @property
    def n_joints(self) -> int:
        """Number of joints n."""
        return int(self.positions[0].shape[1])

    @property
    def extent(self) -> FloatArray:
        """Largest minus smallest position of each joint over all demonstrations, (n,)."""
        return np.asarray(np.ptp(np.concatenate(self.positions), axis=0))

    def split(self, rows: FloatArray) -> list[FloatArray]:
        """Rows (M, ...) of all samples as N arrays (m_i, ...), one per demonstration."""
        return np.split(rows, np.cumsum([phases.size for phases in self.phases])[:-1])

    def bases(self, basis: Basis) -> list[FloatArray]:
        """Basis matrices Φ_i (m_i, K)."""
        return self.split(basis.evaluate(np.concatenate(self.phases)))


def fit(
    demonstrations: DemonstrationsLike,
    basis: Basis | None = None,
    *,
    ridge: float = RIDGE,
    joint_names: Sequence[str] | None = None,
) -> ProMP:
    r"""Learn a ProMP from complete demonstrations, in closed form.

    Demonstrations are aligned on phase. The weights of each are found by ridge regression, shrunk
    towards the mean position :math:`\bar y_i` of the demonstration:

    .. math:: W_i = \arg\min_W \tfrac{1}{m_i}\|Y_i - \Phi_i W\|^2 + \lambda\|W - \bar y_i\|^2

    :math:`\mu_w` is the mean of the weights. With
    :math:`S = \sum_i (w_i - \mu_w)(w_i - \mu_w)^T`

    .. math:: \Sigma_w = \frac{S + \Sigma_0}{N + 1}

    is the mode under an inverse-Wishart prior worth one demonstration of covariance
    :math:`\Sigma_0`. :math:`\Sigma_0` is the diagonal of S/N, with no entry below
    (1 % of the joint's range of motion)², or (10 %)² for a single demonstration. So
    :math:`\Sigma_w` is positive definite for any number of demonstrations.

    Args:
        demonstrations: N demonstrations. Arrays are evenly spaced in phase from 0 to 1.
        basis: by default ``Basis()``, the paper's.
        ridge: λ > 0 [-].
        joint_names: n names, in place of the demonstrations' names.

    Warns:
        RegularisedWarning: the prior decided: one demonstration, identical ones, or fewer samples
            than bases.

    Raises:
        InvalidDemonstrationError: no demonstration, a value that is not finite, unequal joints, or
            a partial demonstration (see :func:`fit_em`).
        InvalidRequestError: another argument out of range.
    """
    basis = basis or Basis()
    ridge = value("ridge", ridge, Positive)
    samples = gather(demonstrations, joint_names)
    complete(samples)
    short = [i for i, phases in enumerate(samples.phases) if phases.size < basis.count]
    if short:
        size = samples.phases[short[0]].size
        checks.regularised(
            f"{len(short)} demonstration(s) have fewer samples than the {basis.count} bases, the "
            f"first is number {short[0]} with {size}; ridge regression completes them"
        )
    weights = ridge_weights(samples, basis, ridge)
    rest = residuals_of(samples, basis, weights)
    mean, covariance = distribution(weights)
    demos = len(weights)
    if demos == 1:
        checks.regularised(
            "one demonstration says nothing about spread; the covariance is the prior's"
        )
    elif np.abs(weights - mean).max() <= 1e-9 * max(float(np.abs(weights).max()), 1e-3):
        checks.regularised(
            f"the {demos} demonstrations are identical; the covariance is the prior's"
        )
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
        if phases[0] > checks.PHASE_TOLERANCE or phases[-1] < 1.0 - checks.PHASE_TOLERANCE:
            raise InvalidDemonstrationError(
                f"demonstration {i} is partial (phases {phases[0]:.3g} to {phases[-1]:.3g}); "
                "fit_em learns from partial ones"
            )


def distribution(weights: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Mean (n, K) and covariance (nK, nK) of :func:`fit` for weights (N, n, K)."""
    demos, _, count = weights.shape
    mean = weights.mean(axis=0)
    centred = (weights - mean).reshape(demos, -1)
    scatter = centred.T @ centred
    floor = np.repeat(deviation_floor(np.ptp(weights, axis=(0, 2)), demos) ** 2, count)
    prior = np.diag(np.maximum(np.diagonal(scatter) / demos, floor))
    return mean, (scatter + prior) / (demos + 1.0)


def ridge_weights(samples: Samples, basis: Basis, ridge: float = RIDGE) -> FloatArray:
    """Weights (N, n, K) by ridge regression, as in :func:`fit`."""
    count = basis.count
    if samples.stacked is not None:
        y = samples.stacked
        demos, size, n = y.shape
        values = basis.evaluate(samples.phases[0])
        gram = values.T @ values / size
        gram.flat[:: count + 1] += ridge
        middle = np.full((1, size), 1.0 / size) @ y
        right = (values.T / size) @ (y - middle)
        flat = right.transpose(1, 0, 2).reshape(count, demos * n)
        solved = np.linalg.solve(gram, flat).reshape(count, demos, n)
        return np.asarray(solved.transpose(1, 2, 0) + middle.transpose(0, 2, 1))
    pairs = list(zip(samples.bases(basis), samples.positions, strict=True))
    grams = np.stack([values.T @ values / len(values) for values, _ in pairs])
    grams += ridge * np.eye(count)
    means = np.stack([y.mean(axis=0) for y in samples.positions])
    rights = np.stack([v.T @ (y - c) / len(v) for (v, y), c in zip(pairs, means, strict=True)])
    solved = np.linalg.solve(grams, rights).transpose(0, 2, 1)
    return np.asarray(solved + means[:, :, None])


def residuals_of(samples: Samples, basis: Basis, weights: FloatArray) -> FloatArray:
    """Residuals Y_i - Φ_i W_i (M, n) of weights (N, n, K), demonstration by demonstration."""
    if samples.stacked is not None:
        rest = samples.stacked - basis.evaluate(samples.phases[0]) @ weights.transpose(0, 2, 1)
        return rest.reshape(-1, samples.n_joints)
    triples = zip(samples.positions, samples.bases(basis), weights, strict=True)
    return np.concatenate([y - v @ w.T for y, v, w in triples])


def residuals(demonstrations: DemonstrationsLike, basis: Basis) -> list[FloatArray]:
    r"""Residuals :math:`Y_i - \Phi_i W_i` of each demonstration: N arrays (m_i, n) [rad or m].

    The weights are those of :func:`fit`.

    Raises:
        InvalidDemonstrationError: as :func:`fit`, but for partial demonstrations.
    """
    samples = gather(demonstrations, None)
    return samples.split(residuals_of(samples, basis, ridge_weights(samples, basis)))


def held_out_residuals(
    demonstrations: DemonstrationsLike,
    counts: Iterable[int] = COUNTS,
    width: float = Basis.width,
    progress: Callable[[int], object] | None = None,
) -> dict[int, float]:
    """Errors of predicted demonstrations for each number of bases, by 10-fold cross-validation.

    Demonstration i is in fold i mod 10. For each fold a ProMP is learnt from the other folds as in
    :func:`fit`, and conditioned on the first and last position of each demonstration in the fold,
    which a planner knows beforehand. The residual is the demonstration less the conditioned mean.
    With too few bases the mean cannot follow the motion; with too many it follows features of the
    other folds alone. The result is deterministic.

    Args:
        demonstrations: N > 1, complete.
        counts: numbers of bases. Numbers above the samples of the shortest demonstration are
            skipped, except the first.
        width: of the bases.
        progress: called with each count before it is tried.

    Returns:
        The root mean square over all samples and joints [rad or m] for each count. Take the
        smallest: ``min(found, key=found.get)``.

    Raises:
        InvalidDemonstrationError: fewer than two demonstrations, a partial one, or as :func:`fit`.
        InvalidRequestError: a count too small for a basis.
    """
    samples = gather(demonstrations, None)
    complete(samples)
    demos, shortest = len(samples.phases), min(len(phases) for phases in samples.phases)
    if demos < 2:
        raise InvalidDemonstrationError("cross-validation needs at least two demonstrations")
    part = np.arange(demos) % FOLDS
    ends = [positions[[0, -1]] for positions in samples.positions]
    tried = list(counts)
    found = {}
    for count in [k for i, k in enumerate(tried) if i == 0 or k <= shortest]:
        if progress is not None:
            progress(count)
        basis = Basis(count, width)
        weights = ridge_weights(samples, basis)
        predicted = np.empty_like(weights)
        for held in np.unique(part):
            mean, covariance = distribution(weights[part != held])
            noise = np.zeros(samples.n_joints)
            promp = made(basis, mean, covariance, noise, samples.joint_names)
            for i in np.flatnonzero(part == held):
                at = ((0.0, 0), (1.0, 0))
                predicted[i] = conditioned_mean(promp, at, ends[i], (0.0, 0.0))
        found[count] = float(np.sqrt(np.mean(residuals_of(samples, basis, predicted) ** 2)))
    return found


def gather(demonstrations: DemonstrationsLike, joint_names: Sequence[str] | None) -> Samples:
    """Check demonstrations and align them on phase."""
    error = InvalidDemonstrationError
    if isinstance(demonstrations, Demonstration):
        demonstrations = (demonstrations,)
    stacked = _stacked(demonstrations)
    if stacked is not None:
        if stacked.shape[0] == 0:
            raise error("no demonstrations: at least one is needed")
        if stacked.shape[1] < 2 or stacked.shape[2] == 0:
            raise error(f"demonstrations: expected (N, T >= 2, n >= 1), got shape {stacked.shape}")
        phases = np.linspace(0.0, 1.0, stacked.shape[1])
        names = checks.names_for(joint_names or (), stacked.shape[2])
        return Samples((phases,) * len(stacked), tuple(stacked), stacked, names)
    if not isinstance(demonstrations, Demonstrations):
        items = []
        for i, item in enumerate(demonstrations):
            if not isinstance(item, Demonstration):
                given = array(f"demonstration {i}", item, None, None, error=error)
                if len(given) < 2:
                    raise error(f"demonstration {i} needs at least 2 samples, got {len(given)}")
                item = Demonstration(np.linspace(0.0, 1.0, len(given)), given)
            items.append(item)
        demonstrations = Demonstrations(tuple(items))
    names = checks.names_for(joint_names or demonstrations.joint_names, demonstrations.n_joints)
    all_phases = tuple(item.phases for item in demonstrations)
    positions = tuple(item.positions for item in demonstrations)
    first = all_phases[0]
    same = all(p.size == first.size for p in all_phases) and all(
        bool(np.abs(p - first).max() < 1e-12) for p in all_phases
    )
    return Samples(all_phases, positions, np.stack(positions) if same else None, names)


def _stacked(demonstrations: DemonstrationsLike) -> FloatArray | None:
    """A copy (N, T, n) of arrays of finite numbers of one shape; None for anything else."""
    if isinstance(demonstrations, np.ndarray):
        if demonstrations.ndim != 3:
            return None
        return array(
            "demonstrations", demonstrations, None, None, None, error=InvalidDemonstrationError
        )
    if not isinstance(demonstrations, list | tuple) or not demonstrations:
        return None
    if not all(
        isinstance(item, np.ndarray) and item.dtype == np.float64 for item in demonstrations
    ):
        return None
    shapes = {item.shape for item in demonstrations}
    if len(shapes) != 1 or len(shapes.pop()) != 2:
        return None
    stacked = np.stack(demonstrations)
    return stacked if np.isfinite(stacked).all() else None


def deviation_floor(extent: FloatArray, demonstrations: int) -> FloatArray:
    """Smallest prior standard deviation (n,) of a weight of each joint [rad or m].

    It is 1 % of the joint's range of motion ``extent`` (n,), or 10 % for a single demonstration.
    The range of a joint that hardly moves is taken as a tenth of the largest range, at least 0.01.
    """
    share = 0.1 if demonstrations == 1 else 0.01
    floor: FloatArray = np.maximum(np.maximum(extent, 0.1 * extent.max()), 0.01)
    return share * floor


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
        checks.regularised(gap)
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
            checks.ConvergenceWarning,
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
    factor = square_root(covariance)
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
