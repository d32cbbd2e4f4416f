import warnings

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import multivariate_normal

from optipromp.core.errors import InvalidDemonstrationError, InvalidRequestError
from optipromp.core.promp import (
    Basis,
    ConvergenceWarning,
    Demonstration,
    Demonstrations,
    JointPoint,
    ProMP,
    RegularisedWarning,
    condition,
    fit,
    fit_em,
)


def truth(seed: int, n: int = 2, count: int = 6, rank: int = 3) -> ProMP:
    """A movement whose weights vary in a few directions only."""
    rng = np.random.default_rng(seed)
    factor = 0.3 * rng.normal(size=(n * count, rank))
    mean = rng.normal(size=(n, count))
    return ProMP(Basis(count), mean, factor @ factor.T, np.full(n, 1e-4))


def test_recovers_weights_without_noise() -> None:
    source = truth(0)
    weights = source.sample_weights(np.random.default_rng(1), 30)
    learnt = fit(source.trajectory(weights, 80), source.basis)
    np.testing.assert_allclose(learnt.mean, weights.mean(axis=0), atol=1e-5)
    flat = weights.reshape(30, -1)
    spread = np.cov(flat.T, bias=True)
    expected = (30 * spread + np.diag(np.diagonal(learnt.covariance))) / 31
    np.testing.assert_allclose(learnt.covariance, expected, atol=2e-3)


def test_shared_phases_equal_the_loop() -> None:
    source = truth(1)
    rng = np.random.default_rng(0)
    y = source.sample(rng, 9, 60, observation_noise=True)
    stacked = fit(y, source.basis)
    looped = fit([*y[:-1], np.repeat(y[-1:], 1, axis=0)[0]], source.basis)
    uneven = fit(
        [Demonstration(np.linspace(0, 1, 60) * (1 + 1e-9 * i), p) for i, p in enumerate(y)],
        source.basis,
    )
    single = [fit_quietly(demo, source.basis).mean for demo in y]
    for other in (looped, uneven):
        np.testing.assert_allclose(other.mean, stacked.mean, atol=1e-9)
        np.testing.assert_allclose(other.covariance, stacked.covariance, atol=1e-9)
        np.testing.assert_allclose(other.noise, stacked.noise, rtol=1e-6)
    np.testing.assert_allclose(np.mean(single, axis=0), stacked.mean, atol=1e-9)


def fit_quietly(demo: np.ndarray, basis: Basis) -> ProMP:
    with pytest.warns(RegularisedWarning, match="one demonstration"):
        return fit([demo], basis)


def test_unequal_lengths_are_aligned_on_phase() -> None:
    source = truth(2)
    weights = source.sample_weights(np.random.default_rng(0), 12)
    rng = np.random.default_rng(5)
    demos = []
    for w in weights:
        z = np.concatenate([[0.0], np.sort(rng.uniform(0, 1, rng.integers(30, 90))), [1.0]])
        demos.append(Demonstration(3.0 + 7.0 * z, source.trajectory(w, z)))
    learnt = fit(demos, source.basis)
    np.testing.assert_allclose(learnt.mean, weights.mean(axis=0), atol=1e-4)


@given(st.integers(0, 10**6), st.floats(-50, 50))
@settings(max_examples=20, deadline=None)
def test_shifting_the_demonstrations_shifts_the_answer(seed: int, shift: float) -> None:
    y = truth(3).sample(np.random.default_rng(seed), 5, 40)
    one, other = fit(y), fit(y + shift)
    np.testing.assert_allclose(other.mean, one.mean + shift, atol=1e-9)
    np.testing.assert_allclose(other.covariance, one.covariance, atol=1e-9)


@given(st.integers(0, 10**6), st.integers(1, 40), st.integers(1, 4), st.integers(2, 30))
@settings(max_examples=40, deadline=None)
def test_covariance_is_always_definite(seed: int, demos: int, joints: int, size: int) -> None:
    y = np.random.default_rng(seed).normal(size=(demos, size, joints))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RegularisedWarning)
        learnt = fit(y)
    assert np.linalg.eigvalsh(learnt.covariance)[0] > 0.0
    assert np.isfinite(learnt.mean).all()
    assert (learnt.noise > 0.0).all()


def test_regularised_cases_warn_and_stay_usable() -> None:
    y = truth(4).sample(np.random.default_rng(0), 1, 50)
    cases = {"one demonstration": y, "identical": np.repeat(y, 4, axis=0)}
    for message, demos in cases.items():
        with pytest.warns(RegularisedWarning, match=message):
            learnt = fit(demos, Basis(6))
        assert np.linalg.eigvalsh(learnt.covariance)[0] > 1e-10
        moved = condition(learnt, [JointPoint(1.0, [0.5, -0.5])])
        np.testing.assert_allclose(moved.mean_trajectory([1.0])[0], [0.5, -0.5], atol=1e-10)
    with pytest.warns(RegularisedWarning, match="fewer samples than the 6 bases.*number 1 with 3"):
        learnt = fit([y[0], y[0, :3] + 0.1, y[0] + 0.2], Basis(6))
    assert np.abs(learnt.mean).max() < 10.0


def test_a_constant_joint() -> None:
    y = np.concatenate([truth(5).sample(np.random.default_rng(0), 8, 50), np.ones((8, 50, 1))], 2)
    learnt = fit(y)
    np.testing.assert_allclose(learnt.mean_trajectory(20)[:, 2], 1.0, atol=1e-12)


def test_names() -> None:
    y = np.random.default_rng(0).normal(size=(3, 20, 2))
    assert fit(y).joint_names == ("joint_1", "joint_2")
    assert fit(y, joint_names=("a", "b")).joint_names == ("a", "b")
    demos = Demonstrations(tuple(Demonstration(np.arange(20.0), p) for p in y), ("c", "d"))
    assert fit(demos).joint_names == ("c", "d")
    with pytest.raises(InvalidRequestError):
        fit(y, joint_names=("a",))


@pytest.mark.filterwarnings("ignore::UserWarning")
@pytest.mark.parametrize("value", [-756_802.0, 1e6])
@pytest.mark.parametrize("size", [3, 30])
def test_em_takes_a_number_that_lost_its_point(size: int, value: float) -> None:
    y = np.sin(np.arange(7 * size)).reshape(1, size, 7)
    y[0, 0, 3] = value
    promp = fit_em(y, Basis(5))
    assert np.isfinite(promp.mean).all()
    assert np.linalg.eigvalsh(promp.covariance).min() >= -1e-10 * promp.covariance.max()


@pytest.mark.parametrize("learn", [fit, fit_em])
def test_refuses(learn: object) -> None:
    assert callable(learn)
    good = np.random.default_rng(0).normal(size=(3, 20, 2))
    bad = good.copy()
    bad[1, 4, 0] = np.nan
    for demos, message in (
        ([], "no demonstrations"),
        (np.zeros((0, 5, 2)), "no demonstrations"),
        (bad, r"\[1, 4, 0\] is nan"),
        (list(bad), r"demonstration 1\[4, 0\] is nan"),
        ([good[0], good[1][:, :1]], "demonstration 1 has 1 joints"),
        ([good[0], good[1][:1]], "at least 2 samples"),
        (np.zeros((2, 1, 3)), "T >= 2"),
        ([["a"]], "numbers"),
    ):
        with pytest.raises(InvalidDemonstrationError, match=message):
            learn(demos)
    for ridge in (-1.0, float("nan")):
        with pytest.raises(InvalidRequestError, match="ridge"):
            fit(good, ridge=ridge)
    with pytest.raises(InvalidRequestError, match="iterations"):
        fit_em(good, iterations=0)


def test_em_equals_the_closed_form_on_complete_demonstrations() -> None:
    """They differ by the noise of each weight, r (ΦᵀΦ)⁻¹: about 1e-6 K/T ~ 1e-7 here."""
    source = truth(7)
    y = source.sample(np.random.default_rng(0), 25, 100)
    y = y + 1e-3 * np.random.default_rng(1).normal(size=y.shape)
    closed, em = fit(y, source.basis), fit_em(y, source.basis)
    np.testing.assert_allclose(em.mean, closed.mean, atol=1e-3)
    scale = np.abs(closed.covariance).max()
    np.testing.assert_allclose(em.covariance, closed.covariance, atol=2e-3 * scale)
    np.testing.assert_allclose(em.noise, 1e-6, rtol=0.1)
    np.testing.assert_allclose(closed.noise, 1e-6, rtol=0.1)


def test_em_fills_in_what_partial_demonstrations_hide() -> None:
    """Each shows half of the movement; what is hidden follows from how all co-vary."""
    source = truth(8)
    rng = np.random.default_rng(2)
    weights = source.sample_weights(rng, 80)
    demos, hidden = [], []
    for w in weights:
        z = np.linspace(0, 1, 60)
        start = rng.uniform(0, 0.5)
        seen = (z >= start) & (z <= start + 0.5)
        y = source.trajectory(w, z)
        noisy = y + 0.01 * rng.normal(size=y.shape)
        demos.append(Demonstration(z[seen], noisy[seen], span=(0.0, 1.0)))
        hidden.append((z[~seen], y[~seen]))
    learnt = fit_em(demos, source.basis)
    gap = learnt.mean_trajectory(60) - source.trajectory(weights.mean(axis=0), 60)
    assert np.sqrt((gap**2).mean()) < 0.1
    errors, guesses = [], []
    for demo, (z, y) in zip(demos, hidden, strict=True):
        points = [JointPoint(p, v, 1e-4) for p, v in zip(demo.phases, demo.positions, strict=True)]
        completed = condition(learnt, points)
        errors.append(((completed.mean_trajectory(z) - y) ** 2).mean())
        guesses.append(((learnt.mean_trajectory(z) - y) ** 2).mean())
    assert np.mean(errors) < 0.1 * np.mean(guesses)


def test_partial_demonstrations_are_for_em_only() -> None:
    demos = [Demonstration(np.arange(30.0), np.zeros((30, 1)), span=(0.0, 40.0))]
    with pytest.raises(InvalidDemonstrationError, match=r"demonstration 0 is partial.*fit_em"):
        fit(demos)


def test_em_raises_the_likelihood() -> None:
    source = truth(9)
    y = source.sample(np.random.default_rng(0), 12, 30, observation_noise=True)
    with pytest.warns(ConvergenceWarning, match="after 1 iterations"):
        early = fit_em(y, source.basis, iterations=1)
    late = fit_em(y, source.basis)

    def likelihood(promp: ProMP) -> float:
        rows = np.kron(np.eye(promp.n_joints), promp.basis.evaluate(30))
        noise = np.diag(np.repeat(promp.noise, 30))
        spread = rows @ promp.covariance @ rows.T + noise
        found = multivariate_normal(rows @ promp.weights, spread)
        return float(found.logpdf(y.transpose(0, 2, 1).reshape(12, -1)).sum())

    assert likelihood(late) > likelihood(early)


def test_em_warns_where_nothing_was_shown() -> None:
    z = np.linspace(0, 0.4, 30)
    demos = [Demonstration(z, np.sin(3 * z + s)[:, None], span=(0.0, 1.0)) for s in (0.0, 0.1, 0.3)]
    with pytest.warns(RegularisedWarning, match="no demonstration shows"):
        learnt = fit_em(demos, Basis(10))
    assert np.isfinite(learnt.mean_trajectory(50)).all()
    assert np.linalg.eigvalsh(learnt.covariance)[0] > 0.0


def test_em_on_one_and_on_identical() -> None:
    y = truth(10).sample(np.random.default_rng(0), 1, 40)
    with pytest.warns(RegularisedWarning, match="one demonstration"):
        one = fit_em(y)
    with pytest.warns(RegularisedWarning, match="5 demonstrations are identical"):
        many = fit_em(np.repeat(y, 5, axis=0))
    for learnt in (one, many):
        assert np.linalg.eigvalsh(learnt.covariance)[0] > 0.0
        assert np.abs(learnt.mean_trajectory(40) - y[0]).max() < 0.3


def test_recorded_demonstrations(recorded: Demonstrations) -> None:
    learnt = fit(recorded)
    assert len(recorded) == 104
    assert learnt.n_joints == 7
    assert np.linalg.eigvalsh(learnt.covariance)[0] > 1e-5
    assert np.sqrt(learnt.noise).max() < 0.1
    em = fit_em(recorded)
    np.testing.assert_allclose(em.mean, learnt.mean, atol=0.02)
