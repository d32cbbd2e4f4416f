"""How well bases follow demonstrations, and how many of them to take."""

from collections.abc import Callable, Iterable

import numpy as np

from optipromp.arrays import FloatArray
from optipromp.errors import InvalidDemonstrationError
from optipromp.promp.basis import Basis
from optipromp.promp.conditioning import conditioned_mean
from optipromp.promp.learning import complete, distribution, residuals_of, ridge_weights
from optipromp.promp.model import made
from optipromp.promp.samples import DemonstrationsLike, gather

COUNTS = range(4, 21)
"""Numbers of bases tried. From the least with one outside on each side; at 20 the held-out
residual of every set tried has risen again (docs/demonstrations.md)."""
FOLDS = 10
"""Parts into which demonstrations are divided; ten is the usual choice (Kohavi, 1995)."""


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
            mean, covariance = distribution(weights[part != held], 1.0)
            noise = np.zeros(samples.n_joints)
            promp = made(basis, mean, covariance, noise, samples.joint_names)
            for i in np.flatnonzero(part == held):
                at = ((0.0, 0), (1.0, 0))
                predicted[i] = conditioned_mean(promp, at, ends[i], (0.0, 0.0))
        found[count] = float(np.sqrt(np.mean(residuals_of(samples, basis, predicted) ** 2)))
    return found
