"""The independent library `movement_primitives`, where its definitions and ours agree."""

import numpy as np
import pytest

from optipromp.core.promp import Basis, JointPoint, ProMP, condition, fit

peer = pytest.importorskip("movement_primitives.promp", reason="movement_primitives not installed")

K, N = 8, 2


def same_basis() -> Basis:
    """Its h = -1/(8 K² ln 0.7) with centres from 0 to 1 is our width Δ²/h with none outside."""
    h = -1.0 / (8.0 * K**2 * np.log(0.7))
    return Basis(K, (1.0 / (K - 1)) ** 2 / h, 0)


@pytest.fixture
def pair() -> tuple[ProMP, object]:
    rng = np.random.default_rng(0)
    factor = rng.normal(size=(N * K, N * K))
    mean, covariance = rng.normal(size=N * K), factor @ factor.T
    other = peer.ProMP(N, K)
    other.from_weight_distribution(mean, covariance)
    return ProMP(same_basis(), mean, covariance), other


def test_mean_variance_and_velocity(pair) -> None:  # type: ignore[no-untyped-def]
    ours, theirs = pair
    z = np.linspace(0, 1, 30)
    np.testing.assert_allclose(ours.mean_trajectory(z), theirs.mean_trajectory(z), atol=1e-12)
    np.testing.assert_allclose(ours.marginals(z, 1)[0], theirs.mean_velocities(z), atol=1e-10)
    np.testing.assert_allclose(ours.standard_deviation(z) ** 2, theirs.var_trajectory(z), rtol=1e-9)
    variance = ours.standard_deviation(z, derivative=1) ** 2
    np.testing.assert_allclose(variance, theirs.var_velocities(z), rtol=1e-9)


@pytest.mark.parametrize("variance", [None, 0.3])
def test_conditioning(pair, variance: float | None) -> None:  # type: ignore[no-untyped-def]
    ours, theirs = pair
    for phase, value in ((0.0, [1.0, 2.0]), (0.7, [-1.0, 0.5])):
        ours = condition(ours, JointPoint(phase, np.array(value), variance))
        noise = None if variance is None else variance * np.eye(N)
        theirs = theirs.condition_position(np.array(value), noise, phase)
    np.testing.assert_allclose(ours.weights, theirs.weight_mean, rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(ours.covariance, theirs.weight_cov, rtol=0.0, atol=1e-12)


def test_ridge_weights_and_mean(pair) -> None:  # type: ignore[no-untyped-def]
    ours, _ = pair
    z = np.linspace(0, 1, 60)
    y = ours.sample(np.random.default_rng(1), 12, z)
    theirs = peer.ProMP(N, K)
    weights = np.mean([theirs.weights(z, demo) for demo in y], axis=0)
    learnt = fit(y, same_basis(), ridge=1e-12)
    np.testing.assert_allclose(learnt.weights, weights, atol=1e-4)
    theirs.imitate(np.tile(z, (12, 1)), y)
    np.testing.assert_allclose(learnt.mean_trajectory(z), theirs.mean_trajectory(z), atol=0.05)
