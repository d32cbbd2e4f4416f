from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from optipromp.errors import InvalidRequestError
from optipromp.promp import (
    Basis,
    JointPoint,
    ProMP,
    Timing,
    blend,
    coactivate,
    coactivate_marginals,
    condition,
    modulate,
)

Make = Callable[..., ProMP]
seeds = st.integers(0, 10**6)


@given(seeds, st.lists(st.floats(0.05, 3.0), min_size=1, max_size=4))
@settings(max_examples=25, deadline=None)
def test_coactivation_is_the_product(make_promp: Make, seed: int, alpha: list[float]) -> None:
    promps = [make_promp(seed + i) for i in range(len(alpha))]
    precision = [a * np.linalg.inv(p.covariance) for a, p in zip(alpha, promps, strict=True)]
    covariance = np.linalg.inv(sum(precision))
    mean = covariance @ sum(P @ p.weights for P, p in zip(precision, promps, strict=True))
    result = coactivate(promps, alpha)
    np.testing.assert_allclose(result.weights, mean, atol=1e-8)
    np.testing.assert_allclose(result.covariance, covariance, atol=1e-8)


@given(seeds)
@settings(max_examples=20, deadline=None)
def test_marginal_coactivation_is_the_product(make_promp: Make, seed: int) -> None:
    rng = np.random.default_rng(seed)
    promps = [make_promp(seed + i, count=5 + i) for i in range(3)]
    alpha = rng.uniform(0.1, 2.0, size=(3, 9))
    result = coactivate_marginals(promps, alpha, 9)
    for t in range(9):
        moments = [(p.marginals(9)[0][t], p.marginals(9)[1][t]) for p in promps]
        precision = [a * np.linalg.inv(c) for a, (_, c) in zip(alpha[:, t], moments, strict=True)]
        covariance = np.linalg.inv(sum(precision))
        mean = covariance @ sum(P @ m for P, (m, _) in zip(precision, moments, strict=True))
        np.testing.assert_allclose(result.mean[t], mean, atol=1e-7)
        np.testing.assert_allclose(result.covariance[t], covariance, atol=1e-7)


def test_zero_activation_is_absence(make_promp: Make) -> None:
    promps = [make_promp(i) for i in range(3)]
    only = coactivate(promps, [0.0, 2.0, 0.0])
    np.testing.assert_allclose(only.mean, promps[1].mean)
    np.testing.assert_allclose(only.covariance, promps[1].covariance / 2.0)
    each = coactivate_marginals(promps, np.eye(3), 3)
    for t, promp in enumerate(promps):
        mean, covariance = promp.marginals(3)
        np.testing.assert_allclose(each.mean[t], mean[t], atol=1e-12)
        np.testing.assert_allclose(each.covariance[t], covariance[t], atol=1e-12)
    assert each.standard_deviation.shape == (3, 3)


def test_certain_primitives(make_promp: Make) -> None:
    """One certain of its start, the other of its end: together they keep both."""
    first = condition(make_promp(0), JointPoint(0.0, np.zeros(3)))
    second = condition(make_promp(1), JointPoint(1.0, np.ones(3)))
    both = coactivate([first, second])
    np.testing.assert_allclose(both.mean_trajectory(2), [np.zeros(3), np.ones(3)], atol=1e-7)
    assert np.linalg.eigvalsh(both.covariance)[0] > -1e-12
    other = condition(make_promp(2), JointPoint(0.0, np.ones(3)))
    with pytest.raises(InvalidRequestError, match="certain of different values"):
        coactivate([first, other])
    with pytest.raises(InvalidRequestError, match="certain of different values"):
        coactivate_marginals([first, other], np.ones((2, 3)), 3)


@pytest.mark.parametrize("seed", range(20))
def test_certainty_of_different_values_is_noticed_whatever_rounding_says(
    make_promp: Make, seed: int
) -> None:
    first, other = (
        condition(make_promp(seed + k), JointPoint(0.0, np.full(3, 1.0 * k))) for k in (0, 100)
    )
    with pytest.raises(InvalidRequestError, match="certain of different values"):
        coactivate([first, other])


def test_blend_goes_from_one_to_the_other(make_promp: Make) -> None:
    first, second = make_promp(0), make_promp(1, count=8)
    result = blend(first, second, 101, at=0.4, width=0.2)
    np.testing.assert_allclose(result.mean[:31], first.mean_trajectory(101)[:31], atol=1e-9)
    np.testing.assert_allclose(result.mean[50:], second.mean_trajectory(101)[50:], atol=1e-9)
    assert np.isfinite(result.covariance).all()
    assert (np.linalg.eigvalsh(result.covariance) > 0.0).all()


def test_combining_refuses(make_promp: Make) -> None:
    one, other = make_promp(0), make_promp(0, n=2)
    with pytest.raises(InvalidRequestError, match="at least one"):
        coactivate([])
    with pytest.raises(InvalidRequestError, match="ProMP 1 moves joint_1, joint_2; the first"):
        coactivate([one, other])
    with pytest.raises(InvalidRequestError, match="ProMP 1 has Basis"):
        coactivate([one, make_promp(0, count=7)])
    for alpha in ([1.0], [1.0, -1.0], [0.0, 0.0], [np.nan, 1.0]):
        with pytest.raises(InvalidRequestError, match="activations"):
            coactivate([one, one], alpha)
    with pytest.raises(InvalidRequestError):
        blend(one, one, 10, at=1.5)
    with pytest.raises(InvalidRequestError):
        blend(one, one, 10, width=0.0)


@pytest.mark.parametrize(
    "timing",
    [
        Timing.linear(2.5),
        Timing.minimum_jerk(2.5),
        Timing.through([0.0, 0.5, 2.0, 2.5], [0.0, 0.6, 0.6, 1.0]),
    ],
)
def test_modulation_is_consistent(make_promp: Make, timing: Timing) -> None:
    promp = make_promp(3)
    h = 1e-5
    t = np.linspace(0.1, 2.4, 14)
    y, velocity, acceleration = modulate(promp, timing, t)
    ahead, behind = modulate(promp, timing, t + h), modulate(promp, timing, t - h)
    np.testing.assert_allclose(velocity, (ahead[0] - behind[0]) / (2 * h), atol=1e-5)
    np.testing.assert_allclose(acceleration, (ahead[1] - behind[1]) / (2 * h), atol=1e-3)
    np.testing.assert_allclose(timing.phase([0.0, 2.5]), [0.0, 1.0], atol=1e-12)
    ends = modulate(promp, timing, 2)[0]
    np.testing.assert_allclose(ends, promp.mean_trajectory(2), atol=1e-9)
    np.testing.assert_allclose(y, promp.mean_trajectory(timing.phase(t)))


def test_minimum_jerk_starts_and_ends_at_rest(make_promp: Make) -> None:
    _, velocity, acceleration = modulate(make_promp(3), Timing.minimum_jerk(4.0), 2)
    np.testing.assert_allclose(velocity, 0.0, atol=1e-12)
    np.testing.assert_allclose(acceleration, 0.0, atol=1e-12)


def test_timing_refuses(make_promp: Make) -> None:
    for bad in (0.0, -1.0, float("inf"), float("nan")):
        with pytest.raises(InvalidRequestError):
            Timing.linear(bad)
    for times, phases in (
        ([0.0], [0.0]),
        ([0.0, 1.0], [0.0, 0.9]),
        ([0.0, 1.0, 1.0], [0.0, 0.5, 1.0]),
        ([0.0, 1.0, 2.0], [0.0, 1.1, 1.0]),
        ([0.1, 1.0], [0.0, 1.0]),
        ([0.0, 1.0], [0.0, np.nan]),
    ):
        with pytest.raises(InvalidRequestError):
            Timing.through(times, phases)
    with pytest.raises(InvalidRequestError, match="outside"):
        modulate(make_promp(3), Timing.linear(1.0), [0.5, 1.5])
    with pytest.raises(InvalidRequestError):
        modulate(make_promp(3), Timing.linear(1.0), 0)


def test_basis_of_the_combination(make_promp: Make) -> None:
    result = coactivate([make_promp(0), make_promp(1)])
    assert result.basis == Basis(6)
