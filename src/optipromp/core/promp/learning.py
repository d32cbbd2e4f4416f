"""Learning a ProMP from complete demonstrations, and how many bases follow them well.

Partial ones are learnt from by EM (:mod:`optipromp.core.promp.em`).
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
"""What the learners take: demonstrations, a sequence of arrays (m_i, n), or one array (N, T, n)."""

NOISE_FLOOR = 1e-10
"""Smallest observation variance learnt: (1e-5 rad or m) squared."""
RIDGE = 1e-10
"""λ [-] of :func:`fit`: weights that the samples determine move by less than rounding matters."""
COUNTS = range(4, 21)
"""Numbers of bases tried. From the least with one outside on each side; at 20 the held-out
residual of every set tried has risen again (docs/demonstrations.md)."""
FOLDS = 10
"""Parts into which demonstrations are divided; ten is the usual choice (Kohavi, 1995)."""


@dataclass(frozen=True, eq=False)
class Samples:
    """Demonstrations ready to learn from.

    ``phases`` and ``positions`` hold one array per demonstration, (m_i,) and (m_i, n). If all have
    the same phases, ``stacked`` is all positions at once, (N, T, n).
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
        flat = np.concatenate(self.positions)
        high: FloatArray = flat.max(axis=0)
        low: FloatArray = flat.min(axis=0)
        return high - low


def fit(
    demonstrations: DemonstrationsLike,
    basis: Basis | None = None,
    *,
    ridge: float = RIDGE,
    joint_names: Sequence[str] | None = None,
) -> ProMP:
    r"""Learn a ProMP from complete demonstrations, in closed form.

    Each demonstration is aligned on phase and gets its weights by ridge regression, shrunk towards
    its own mean position :math:`\bar y_i`:

    .. math:: W_i = \arg\min_W \tfrac{1}{m_i}\|Y_i - \Phi_i W\|^2 + \lambda\|W - \bar y_i\|^2

    :math:`\mu_w` is their mean, and with :math:`S = \sum_i (w_i - \mu_w)(w_i - \mu_w)^T`

    .. math:: \Sigma_w = \frac{S + \Sigma_0}{N + 1},

    the mode under an inverse-Wishart prior worth one demonstration of covariance
    :math:`\Sigma_0`, which is the diagonal of S/N, no entry below
    (1 % of that joint's range of motion)² — 10 % for a single demonstration, which says nothing
    about spread — so :math:`\Sigma_w` is positive definite for any number of demonstrations.
    Demonstrations on the same phases share one factorisation.

    Args:
        demonstrations: N of them. Bare arrays are evenly spaced in phase from 0 to 1.
        basis: by default ``Basis()``, the paper's.
        ridge: λ > 0 [-].
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
    """Mean (n, K) and covariance (nK, nK) of the weights (N, n, K), as :func:`fit` has them."""
    demos, _, count = weights.shape
    mean = weights.mean(axis=0)
    centred = (weights - mean).reshape(demos, -1)
    scatter = centred.T @ centred
    floor = np.repeat(deviation_floor(np.ptp(weights, axis=(0, 2)), demos) ** 2, count)
    prior = np.diag(np.maximum(np.diagonal(scatter) / demos, floor))
    return mean, (scatter + prior) / (demos + 1.0)


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
    return basis.evaluate(samples.phases[0])


def _each_bases(samples: Samples, basis: Basis) -> list[FloatArray]:
    ends = np.cumsum([phases.size for phases in samples.phases])[:-1]
    return np.split(basis.evaluate(np.concatenate(samples.phases)), ends)


def residuals(demonstrations: DemonstrationsLike, basis: Basis) -> list[FloatArray]:
    r"""What the bases cannot follow of each demonstration: N arrays (m_i, n) [rad or m].

    :math:`Y_i - \Phi_i W_i`, with the :math:`W_i` of :func:`fit`.

    Raises:
        InvalidDemonstrationError: as :func:`fit`, but for partial demonstrations.
    """
    samples = gather(demonstrations, None)
    ends = np.cumsum([phases.size for phases in samples.phases])[:-1]
    return np.split(residuals_of(samples, basis, ridge_weights(samples, basis)), ends)


def held_out_residuals(
    demonstrations: DemonstrationsLike,
    counts: Iterable[int] = COUNTS,
    width: float = Basis.width,
    progress: Callable[[int], object] | None = None,
) -> dict[int, float]:
    """Cross-validation: how well a ProMP of so many bases predicts a demonstration it has not seen.

    The demonstrations are divided into 10 parts, demonstration i into part i mod 10 (with fewer,
    each is a part). For each part a ProMP is learnt from the others, as :func:`fit` does, and
    conditioned on the first and last position of each demonstration in the part: what a planner
    knows of a motion beforehand. The residual is that demonstration less the conditioned mean. Too
    few bases cannot follow the motion; too many follow what only those seen have in common. No
    chance enters.

    Args:
        demonstrations: N > 1, complete.
        counts: numbers of bases; those above the samples of the shortest demonstration are left
            out, except the first.
        width: of the bases.
        progress: called with each count before it is tried.

    Returns:
        The RMS over all samples and joints [rad or m] for each count. Take the smallest:
        ``min(found, key=found.get)``.

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
    """Check demonstrations and align them on phase.

    Raises:
        InvalidDemonstrationError: none; a value that is not finite; unequal numbers of joints.
    """
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
    """A copy (N, T, n) of bare arrays of finite numbers, all of one shape; None of anything else.

    Raises:
        InvalidDemonstrationError: one array of three dimensions with a value that is not finite.
    """
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
    """Smallest standard deviation (n,) the default prior gives a weight of each joint.

    1 % of the joint's range of motion ``extent`` (n,), 10 % if there is but one demonstration. A
    joint that hardly moves counts with a tenth of the largest range, at least 0.01 rad or m.
    """
    share = 0.1 if demonstrations == 1 else 0.01
    floor: FloatArray = np.maximum(np.maximum(extent, 0.1 * extent.max()), 0.01)
    return share * floor
