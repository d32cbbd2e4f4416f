"""Learning a ProMP from complete demonstrations, and choosing the number of bases.

:mod:`optipromp.core.promp.em` learns from partial demonstrations.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from optipromp.core.arrays import FloatArray
from optipromp.core.errors import InvalidDemonstrationError
from optipromp.core.promp.basis import Basis
from optipromp.core.promp.checks import (
    PHASE_TOLERANCE,
    finite_array,
    names_for,
    positive,
    regularised,
)
from optipromp.core.promp.conditioning import conditioned_mean
from optipromp.core.promp.demonstrations import Demonstration, Demonstrations
from optipromp.core.promp.model import ProMP, made

DemonstrationsLike = Demonstrations | Sequence[Demonstration] | Sequence[ArrayLike] | FloatArray
"""Demonstrations, a sequence of arrays (m_i, n), or one array (N, T, n)."""

NOISE_FLOOR = 1e-10
"""[rad² or m²] Smallest observation variance learnt: (1e-5 rad or m) squared."""
RIDGE = 1e-10
"""[-] λ of :func:`fit`, too small to move a weight that the samples determine."""
COUNTS = range(4, 21)
"""Numbers of bases tried: from the smallest with one outside on each side to 20, where the held-out
residual of every tried set has risen again (docs/demonstrations.md)."""
FOLDS = 10
"""Parts into which demonstrations are divided; ten is the usual choice (Kohavi, 1995)."""


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
    ridge = positive(ridge, "ridge")
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
    mean, covariance = distribution(weights)
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
    weights: FloatArray
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
        weights = solved.transpose(1, 2, 0) + middle.transpose(0, 2, 1)
        return weights
    pairs = list(zip(samples.bases(basis), samples.positions, strict=True))
    grams = np.stack([values.T @ values / len(values) for values, _ in pairs])
    grams += ridge * np.eye(count)
    means = np.stack([y.mean(axis=0) for y in samples.positions])
    rights = np.stack([v.T @ (y - c) / len(v) for (v, y), c in zip(pairs, means, strict=True)])
    weights = np.linalg.solve(grams, rights).transpose(0, 2, 1) + means[:, :, None]
    return weights


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
        names = names_for(joint_names or (), stacked.shape[2])
        return Samples((phases,) * len(stacked), tuple(stacked), stacked, names)
    if not isinstance(demonstrations, Demonstrations):
        items = []
        for i, item in enumerate(demonstrations):
            if not isinstance(item, Demonstration):
                array = finite_array(item, f"demonstration {i}", 2, error)
                if array.shape[0] < 2:
                    raise error(f"demonstration {i} needs at least 2 samples, got {len(array)}")
                item = Demonstration(np.linspace(0.0, 1.0, len(array)), array)
            items.append(item)
        demonstrations = Demonstrations(tuple(items))
    names = names_for(joint_names or demonstrations.joint_names, demonstrations.n_joints)
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
        return finite_array(demonstrations, "demonstrations", 3, InvalidDemonstrationError)
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
