"""Conditioning against exact rational arithmetic: every float is a fraction, nothing is rounded.

What floats lose is then known to the last digit, also where covariances are ill-conditioned.
"""

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from optipromp.core.errors import InvalidRequestError
from optipromp.core.promp import Basis, JointPoint, ProMP, condition

N, K = 2, 6
exact = np.vectorize(Fraction, otypes=[object])  # a float's own value
quick = settings(max_examples=6, deadline=None)
seeds = st.integers(0, 10**6)
VARIANCES = None, 1e-300, 1e-30, 1e-12, 1e-6, 1.0, "full"


def solved(left: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Gauss and Jordan: left⁻¹ right."""
    rows, size = np.concatenate([left, right], axis=1), len(left)
    for k in range(size):
        pivot = next(i for i in range(k, size) if rows[i, k])
        rows[[k, pivot]] = rows[[pivot, k]]
        rows[k] = rows[k] / rows[k, k]
        others = np.arange(size) != k
        rows[others] = rows[others] - rows[others, k : k + 1] * rows[k]
    return rows[:, size:]


def updated(promp: ProMP, points: list[JointPoint]) -> tuple[np.ndarray, np.ndarray]:
    """The mean (nK,) and covariance (nK, nK) of the textbook update, rounded once at the end."""
    rows = [np.kron(np.eye(N), promp.basis.evaluate([p.phase])) for p in points]
    noise = np.zeros((N * len(points),) * 2)
    for i, p in enumerate(points):
        own = slice(N * i, N * i + N)
        if p.covariance is not None:
            full = not isinstance(p.covariance, float)
            noise[own, own] = p.covariance if full else p.covariance * np.eye(N)
    H, R, prior = exact(np.concatenate(rows)), exact(noise), exact(promp.covariance)
    gap = exact(np.concatenate([p.value for p in points])) - H @ exact(promp.weights)
    cross = H @ prior
    found = solved(cross @ H.T + R, np.column_stack([cross, gap]))
    mean = exact(promp.weights) + cross.T @ found[:, -1]
    return mean.astype(float), (prior - cross.T @ found[:, :-1]).astype(float)


def drawn(seed: int, condition_number: float) -> tuple[ProMP, list[JointPoint]]:
    """A prior of that condition number, and up to three points of any variance."""
    rng = np.random.default_rng(seed)
    axes, _ = np.linalg.qr(rng.normal(size=(N * K, N * K)))
    spread = np.exp(np.linspace(0.0, -np.log(condition_number), N * K))
    covariance = rng.choice([1e-6, 1.0, 1e4]) * (axes * spread) @ axes.T
    promp = ProMP(Basis(K), rng.normal(size=(N, K)), 0.5 * (covariance + covariance.T))
    count, points = rng.integers(1, 4), []
    for phase in (rng.permutation(count) + 0.5) / count:
        variance = VARIANCES[rng.integers(len(VARIANCES))]
        if variance == "full":
            factor = rng.normal(size=(N, N))
            variance = factor @ factor.T
        points.append(JointPoint(float(phase), rng.normal(size=N), variance))
    return promp, points


@pytest.mark.parametrize(
    ("condition_number", "of_mean", "of_covariance"),
    [(1e2, 1e-12, 1e-13), (1e6, 1e-10, 1e-12), (1e10, 1e-8, 1e-11), (1e17, 1e-5, 1e-10)],
)
def test_the_update_is_the_exact_one(condition_number, of_mean, of_covariance):
    """Mean trajectory, by its size, and covariance, by that of the prior."""

    @given(seeds)
    @quick
    def check(seed: int) -> None:
        promp, points = drawn(seed, condition_number)
        mean, covariance = updated(promp, points)
        found = condition(promp, points)
        bases = np.kron(np.eye(N), promp.basis.evaluate(np.linspace(0.0, 1.0, 20)))
        size = max(1.0, np.abs(bases @ mean).max())
        assert np.abs(bases @ (found.weights - mean)).max() < of_mean * size
        scale = np.sqrt(np.diagonal(promp.covariance))
        off = np.abs(found.covariance - covariance) / np.outer(scale, scale)
        assert off.max() < of_covariance

    check()


@given(seeds, st.floats(1e-9, 10.0))
@settings(max_examples=30, deadline=None)
def test_an_indefinite_covariance_is_refused(seed: int, share: float) -> None:
    """Of the prior and of a point, by its smallest eigenvalue; none of them is used or mended."""
    rng = np.random.default_rng(seed)
    axes, _ = np.linalg.qr(rng.normal(size=(N * K, N * K)))
    spread = rng.uniform(0.1, 1.0, N * K)
    spread[0] = -share * spread.max()
    covariance = (axes * spread) @ axes.T
    with pytest.raises(InvalidRequestError, match="not positive semi-definite: smallest eigenv"):
        ProMP(Basis(K), np.zeros((N, K)), 0.5 * (covariance + covariance.T))
    of_point = np.array([[1.0, 1.0 + share], [1.0 + share, 1.0]])
    with pytest.raises(InvalidRequestError, match="positive semi-definite"):
        JointPoint(0.5, np.zeros(N), of_point)


@given(seeds)
@settings(max_examples=30, deadline=None)
def test_what_is_indefinite_by_rounding_only_gives_a_true_gaussian(seed: int) -> None:
    rng = np.random.default_rng(seed)
    axes, _ = np.linalg.qr(rng.normal(size=(N * K, N * K)))
    spread = np.exp(rng.uniform(-40.0, 0.0, N * K))
    spread[:2] = 0.0, 1.0
    covariance = (axes * spread) @ axes.T
    prior = ProMP(Basis(K), rng.normal(size=(N, K)), 0.5 * (covariance + covariance.T))
    found = condition(prior, JointPoint(0.3, prior.mean_trajectory([0.3])[0] + 1e-9, 1e-12))
    assert np.isfinite(found.mean).all()
    assert np.isfinite(found.covariance).all()
    assert np.linalg.eigvalsh(found.covariance)[0] > -1e-13
