from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from optipromp.core.errors import InvalidRequestError
from optipromp.core.promp import Basis, JointPoint, ProMP, TaskPoint, condition
from optipromp.core.promp.conditioning import conditioned_mean

Make = Callable[..., ProMP]
seeds = st.integers(0, 10**6)
quick = settings(max_examples=30, deadline=None)


def random_points(rng: np.random.Generator, n: int, count: int) -> list[JointPoint]:
    """Points at phases well apart, exact, isotropic or with a full covariance."""
    points = []
    for phase in (rng.permutation(count) + 0.5) / count:
        kind, factor = rng.integers(3), rng.normal(size=(n, n))
        covariance = [None, 0.01, factor @ factor.T][kind]
        points.append(JointPoint(float(phase), rng.normal(size=n), covariance))
    return points


@given(seeds, st.integers(1, 6))
@quick
def test_the_mean_alone_is_that_of_the_whole_update(make_promp, seed, count):
    rng, promp = np.random.default_rng(seed), make_promp(seed)
    places = tuple(
        (float(phase), int(rng.integers(3))) for phase in (rng.permutation(count) + 0.5) / count
    )
    variances = tuple(rng.choice([0.0, 0.01, 3.0], count).tolist())
    for _ in range(2):  # the second time with what was kept from the first
        values = rng.normal(size=(count, 3))
        points = [
            JointPoint(phase, value, variance or None, order)
            for (phase, order), value, variance in zip(places, values, variances, strict=True)
        ]
        mean = conditioned_mean(promp, places, values, variances)
        np.testing.assert_array_equal(mean, condition(promp, points).mean)


def test_the_mean_alone_of_what_is_certain_already(make_promp: Make) -> None:
    value = np.array([0.1, -0.2, 0.3])
    promp = condition(make_promp(0), JointPoint(0.5, value))
    mean = conditioned_mean(promp, ((0.5, 0), (1.0, 0)), np.array([value, value]), (0.0, 0.0))
    passed = promp.basis.evaluate([0.5, 1.0]) @ mean.T
    np.testing.assert_allclose(passed, [value, value], atol=1e-9)


def test_the_mean_alone_refuses_what_contradicts(make_promp: Make) -> None:
    values = np.array([np.zeros(3), np.ones(3)])
    with pytest.raises(InvalidRequestError, match="contradicts"):
        conditioned_mean(make_promp(0), ((0.5, 0), (0.5, 0)), values, (0.0, 0.0))


@given(seeds, st.integers(1, 6))
@quick
def test_exact_points_are_hit(make_promp: Make, seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    promp = make_promp(seed)
    z = (np.arange(count) + 0.5) / count
    y = rng.normal(size=(count, 3))
    result = condition(promp, [JointPoint(*pair) for pair in zip(z, y, strict=True)])
    np.testing.assert_allclose(result.mean_trajectory(z), y, atol=1e-8)
    assert result.standard_deviation(z).max() < 1e-5
    samples = result.sample(np.random.default_rng(0), 5, z)
    np.testing.assert_allclose(samples, np.broadcast_to(y, samples.shape), atol=1e-5)


@given(seeds, st.integers(2, 5))
@quick
def test_order_does_not_matter(make_promp: Make, seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    promp = make_promp(seed)
    points = random_points(rng, 3, count)
    together = condition(promp, points)
    reversed_ = condition(promp, points[::-1])
    one_by_one = promp
    for point in points:
        one_by_one = condition(one_by_one, point)
    for other in (reversed_, one_by_one):
        np.testing.assert_allclose(other.mean, together.mean, atol=1e-6)
        np.testing.assert_allclose(other.covariance, together.covariance, atol=1e-7)


@given(seeds, st.integers(1, 8), st.sampled_from([None, 4, 9]))
@quick
def test_covariance_stays_symmetric_and_shrinks(make_promp, seed, count, rank):
    rng = np.random.default_rng(seed)
    promp = make_promp(seed, rank=rank)
    points = [JointPoint(p.phase, p.value, 1e-6) for p in random_points(rng, 3, count)]
    result = condition(promp, points)
    np.testing.assert_array_equal(result.covariance, result.covariance.T)
    scale = np.abs(promp.covariance).max()
    assert np.linalg.eigvalsh(result.covariance)[0] >= -1e-12 * scale
    shrunk = promp.covariance - result.covariance
    assert np.linalg.eigvalsh(shrunk)[0] >= -1e-9 * scale


def test_inputs_are_unchanged(make_promp: Make) -> None:
    promp = make_promp(0)
    before = promp.mean.copy(), promp.covariance.copy()
    value = np.ones(3)
    point = JointPoint(0.5, value)
    condition(promp, [point])
    value[:] = 9.0
    np.testing.assert_array_equal(point.value, np.ones(3))
    np.testing.assert_array_equal(promp.mean, before[0])
    np.testing.assert_array_equal(promp.covariance, before[1])


def test_derivative_points(make_promp: Make) -> None:
    """Start at rest in a given posture, and pass the middle at a given velocity."""
    promp = make_promp(1)
    rest, speed = np.zeros(3), np.array([1.0, 2.0, 3.0])
    result = condition(
        promp,
        [
            JointPoint(0.0, speed),
            JointPoint(0.0, rest, derivative=1),
            JointPoint(0.0, rest, derivative=2),
            JointPoint(0.5, speed, derivative=1),
        ],
    )
    np.testing.assert_allclose(result.mean_trajectory([0.0])[0], speed, atol=1e-9)
    np.testing.assert_allclose(result.marginals([0.0], 1)[0][0], rest, atol=1e-8)
    np.testing.assert_allclose(result.marginals([0.0], 2)[0][0], rest, atol=1e-6)
    np.testing.assert_allclose(result.marginals([0.5], 1)[0][0], speed, atol=1e-8)


def test_nothing_to_condition_on(make_promp: Make) -> None:
    promp = make_promp(2)
    assert condition(promp, []) is promp


def test_same_point_twice_is_once(make_promp: Make) -> None:
    promp, point = make_promp(4), JointPoint(0.4, np.ones(3))
    once, twice = condition(promp, [point]), condition(promp, [point, point])
    np.testing.assert_allclose(twice.mean, once.mean, atol=1e-9)
    np.testing.assert_allclose(twice.covariance, once.covariance, atol=1e-9)
    again = condition(once, [point])
    np.testing.assert_allclose(again.mean, once.mean, atol=1e-9)


def test_contradictions_are_refused(make_promp: Make) -> None:
    promp = make_promp(6)
    here, there = JointPoint(0.4, np.zeros(3)), JointPoint(0.4, np.array([0.0, 0.1, 0.0]))
    with pytest.raises(InvalidRequestError, match=r"contradicts point . at the same phase"):
        condition(promp, [here, there])
    with pytest.raises(InvalidRequestError, match="already certain"):
        condition(condition(promp, here), there)
    many = [JointPoint(z, np.full(3, (-1.0) ** i)) for i, z in enumerate(np.linspace(0, 1, 9))]
    with pytest.raises(InvalidRequestError, match="6 bases cannot pass"):
        condition(promp, many)
    certain = ProMP(Basis(6), np.zeros((3, 6)), np.zeros((18, 18)))
    with pytest.raises(InvalidRequestError, match=r"joint_2 is off by 0\.1"):
        condition(certain, there)
    assert np.isfinite(condition(certain, here).mean).all()


@pytest.mark.parametrize(
    "make",
    [
        lambda: JointPoint(1.2, np.zeros(3)),
        lambda: JointPoint(-0.1, np.zeros(3)),
        lambda: JointPoint(float("nan"), np.zeros(3)),
        lambda: JointPoint(0.5, np.array([0.0, np.inf, 0.0])),
        lambda: JointPoint(0.5, np.zeros((3, 1))),
        lambda: JointPoint(0.5, np.zeros(3), -1.0),
        lambda: JointPoint(0.5, np.zeros(3), np.eye(2)),
        lambda: JointPoint(0.5, np.zeros(3), -np.eye(3)),
        lambda: JointPoint(0.5, np.zeros(3), np.triu(np.ones((3, 3)))),
        lambda: JointPoint(0.5, np.zeros(3), derivative=3),
        lambda: TaskPoint(2.0, np.zeros(3)),
        lambda: TaskPoint(0.5, np.zeros(2)),
        lambda: TaskPoint(0.5, np.array([0.0, 0.0, np.nan])),
        lambda: TaskPoint(0.5, np.zeros(3), np.zeros(3)),
        lambda: TaskPoint(0.5, np.zeros(3), covariance=-np.eye(3)),
        lambda: TaskPoint(0.5, np.zeros(3), np.ones(3), axis_covariance=-1.0),
    ],
)
def test_bad_points_are_refused(make: Callable[[], object]) -> None:
    with pytest.raises(InvalidRequestError):
        make()


def test_bad_requests_are_refused(make_promp: Make) -> None:
    promp = make_promp(7)
    with pytest.raises(InvalidRequestError, match="point 1: expected 3 joint values, got 2"):
        condition(promp, [JointPoint(0.5, np.zeros(3)), JointPoint(0.5, np.zeros(2))])
    with pytest.raises(InvalidRequestError, match="point 0"):
        condition(promp, [0.5])  # type: ignore[list-item]
    with pytest.raises(InvalidRequestError, match="task_map"):
        condition(promp, [TaskPoint(0.5, np.zeros(3))])
    with pytest.raises(InvalidRequestError, match="iterations"):
        condition(promp, [JointPoint(0.5, np.zeros(3))], iterations=0)
    with pytest.raises(InvalidRequestError, match="tolerance"):
        condition(promp, [JointPoint(0.5, np.zeros(3))], tolerance=0.0)


@given(seeds)
@settings(max_examples=15, deadline=None)
def test_badly_scaled_priors(seed: int) -> None:
    """A prismatic joint in metres beside revolute ones, twelve orders of variance apart."""
    rng = np.random.default_rng(seed)
    scales = np.repeat([1e-5, 1.0, 10.0], 6)
    factor = scales[:, None] * rng.normal(size=(18, 18))
    promp = ProMP(Basis(6), np.zeros((3, 6)), factor @ factor.T)
    value = np.array([1e-5, 1.0, -10.0]) * rng.normal(size=3)
    result = condition(promp, [JointPoint(0.2, value), JointPoint(0.9, -value)])
    np.testing.assert_allclose(result.mean_trajectory([0.2])[0], value, rtol=1e-7, atol=1e-12)
    assert np.linalg.eigvalsh(result.covariance)[0] > -1e-12 * 1e2


def test_the_compiled_update_is_that_of_the_equations() -> None:
    """Against the textbook's form, with points of every order and covariance."""
    rng = np.random.default_rng(4)
    basis = Basis(9, 3.0, 1)
    root = rng.normal(size=(27, 40))
    prior = ProMP(basis, rng.normal(size=(3, 9)), root @ root.T)
    spread = rng.normal(size=(3, 5))
    points = [
        JointPoint(0.1, rng.normal(size=3)),
        JointPoint(0.4, rng.normal(size=3), spread @ spread.T),
        JointPoint(0.7, rng.normal(size=3), 0.3, derivative=1),
        JointPoint(0.9, rng.normal(size=3), 0.02, derivative=2),
    ]
    rows, noises = [], []
    for point in points:
        rows.append(np.kron(np.eye(3), basis.evaluate(point.phase, point.derivative)))
        given = 0.0 if point.covariance is None else point.covariance
        noises.append(given * np.eye(3) if np.ndim(given) == 0 else np.asarray(given))
    H, R = np.vstack(rows), np.zeros((12, 12))
    for i, block in enumerate(noises):
        R[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] = block
    target = np.concatenate([point.value for point in points])
    gain = prior.covariance @ H.T @ np.linalg.inv(H @ prior.covariance @ H.T + R)
    keep = np.eye(27) - gain @ H
    covariance = keep @ prior.covariance @ keep.T + gain @ R @ gain.T
    found = condition(prior, points)
    np.testing.assert_allclose(
        found.weights, prior.weights + gain @ (target - H @ prior.weights), rtol=1e-8
    )
    scale = np.abs(covariance).max()
    np.testing.assert_allclose(found.covariance, covariance, atol=1e-9 * scale)
    np.testing.assert_array_equal(found.covariance, found.covariance.T)
