from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from optipromp.core.errors import InvalidRequestError
from optipromp.core.promp import Basis, ProMP

Make = Callable[..., ProMP]


def dense(promp: ProMP, phases: np.ndarray, order: int = 0) -> np.ndarray:
    """Φ as one matrix (Tn, nK), rows time-major."""
    values = promp.basis.evaluate(phases, order)
    return np.concatenate([np.kron(np.eye(promp.n_joints), v) for v in values])


@pytest.mark.parametrize("order", [0, 1, 2, 3])
def test_marginals_are_those_of_the_dense_matrix(make_promp: Make, order: int) -> None:
    promp, z = make_promp(1), np.linspace(0, 1, 7)
    phi = dense(promp, z, order) / 2.0**order
    whole = phi @ promp.covariance @ phi.T
    mean, covariance = promp.marginals(z, order, duration=2.0)
    np.testing.assert_allclose(mean.ravel(), phi @ promp.weights, atol=1e-9)
    for t in range(7):
        block = whole[3 * t : 3 * t + 3, 3 * t : 3 * t + 3]
        np.testing.assert_allclose(covariance[t], block, atol=1e-9 * np.abs(whole).max())
    deviation = promp.standard_deviation(z, order, duration=2.0)
    np.testing.assert_allclose(deviation.ravel() ** 2, np.diagonal(whole), rtol=1e-9)


def test_mean_derivatives_are_finite_differences(make_promp: Make) -> None:
    promp, z, h, duration = make_promp(2), np.linspace(0.1, 0.9, 9), 1e-5, 3.0
    for order in (1, 2):
        ahead, behind = (promp.marginals(z + e, order - 1, duration)[0] for e in (h, -h))
        derivative = promp.marginals(z, order, duration)[0]
        np.testing.assert_allclose(derivative, (ahead - behind) / (2 * h * duration), atol=1e-5)


def test_observation_noise_is_added(make_promp: Make) -> None:
    promp = make_promp(3)
    without = promp.marginals(5)[1]
    added = promp.marginals(5, observation_noise=True)[1]
    np.testing.assert_allclose(added - without, np.tile(np.diag(promp.noise), (5, 1, 1)))
    with pytest.raises(InvalidRequestError):
        promp.marginals(5, derivative=1, observation_noise=True)


def test_samples_have_the_moments(make_promp: Make) -> None:
    promp = make_promp(4)
    samples = promp.sample(np.random.default_rng(0), 20000, 5)
    mean, covariance = promp.marginals(5)
    np.testing.assert_allclose(samples.mean(axis=0), mean, atol=0.05)
    for t in range(5):
        np.testing.assert_allclose(np.cov(samples[:, t].T), covariance[t], atol=0.05)
    noisy = promp.sample(np.random.default_rng(0), 4000, 5, observation_noise=True)
    rough = (noisy - promp.sample(np.random.default_rng(0), 4000, 5)).var(axis=(0, 1))
    np.testing.assert_allclose(rough, promp.noise, rtol=0.1)


def test_samples_are_seeded(make_promp: Make) -> None:
    samples = [make_promp(4).sample(np.random.default_rng(7), 3, 5) for _ in range(2)]
    np.testing.assert_array_equal(samples[0], samples[1])
    assert make_promp(4).sample(np.random.default_rng(0), 0, 5).shape == (0, 5, 3)


def test_is_immutable(make_promp: Make) -> None:
    promp = make_promp(7)
    for array in (promp.mean, promp.covariance, promp.noise, promp.weights):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1.0
    mean, covariance = np.zeros(6), np.eye(6)
    ProMP(Basis(6), mean, covariance)
    mean[0] = covariance[0, 0] = 2.0  # the caller's arrays stay the caller's


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"mean": np.zeros(7)}, "mean"),
        ({"mean": np.full(10, np.inf)}, r"mean\[0\] is inf"),
        ({"covariance": np.eye(9)}, "covariance"),
        ({"covariance": np.triu(np.ones((10, 10)))}, "not symmetric"),
        ({"covariance": -np.eye(10)}, "positive semi-definite"),
        ({"covariance": np.diag([1.0] * 9 + [-1e-3])}, "smallest eigenvalue -0.001"),
        ({"covariance": np.full((10, 10), np.nan)}, r"covariance\[0, 0\] is nan"),
        ({"covariance": np.diag([1.0] * 9 + [1e19])}, r"covariance reaches 1e\+19: at most 1e\+18"),
        ({"noise": 1e300}, "noise reaches"),
        ({"noise": -1.0}, "noise"),
        ({"noise": np.ones(3)}, "noise"),
        ({"joint_names": ("a",)}, "joint_names"),
        ({"joint_names": ("a", "a")}, "'a' appears twice"),
        ({"joint_names": "ab"}, "joint_names"),
        ({"basis": 5}, "basis"),
    ],
)
def test_refuses(change: dict[str, object], message: str) -> None:
    values = {"basis": Basis(5), "mean": np.zeros(10), "covariance": np.eye(10), "noise": 0.1}
    with pytest.raises(InvalidRequestError, match=message):
        ProMP(**(values | change))  # type: ignore[arg-type]


def test_saves_and_loads(make_promp: Make, tmp_path: Path) -> None:
    promp = make_promp(8)
    path = tmp_path / "reach.npz"
    promp.save(path)
    promp.save(path)
    loaded = ProMP.load(path)
    assert (loaded.basis, loaded.joint_names) == (promp.basis, promp.joint_names)
    for name in ("mean", "covariance", "noise"):
        np.testing.assert_array_equal(getattr(loaded, name), getattr(promp, name))
    assert [p.name for p in tmp_path.iterdir()] == ["reach.npz"]


def test_load_refuses(make_promp: Make, tmp_path: Path) -> None:
    good = tmp_path / "good.npz"
    make_promp(8).save(good)
    data = dict(np.load(good))
    cases = {
        "newer": data | {"format": np.array(99)},
        "lacking": {"mean": data["mean"]},
        "wrong": data | {"covariance": -data["covariance"]},
        "pickled": data | {"mean": np.array([object()])},
        "odd": data | {"basis": np.array([5.5, 4, 1])},
        "words": data | {"mean": np.array(["a"])},
        "complex": data | {"noise": data["noise"] + 1j},
        "named": data | {"joint_names": np.array("joint")},  # without dimensions
    }
    for name, arrays in cases.items():
        np.savez(tmp_path / f"{name}.npz", **arrays)
        with pytest.raises(InvalidRequestError, match=name):
            ProMP.load(tmp_path / f"{name}.npz")
    (tmp_path / "cut.npz").write_bytes(good.read_bytes()[:200])
    (tmp_path / "empty.npz").write_bytes(b"")
    np.save(tmp_path / "single.npy", np.eye(2))
    for name in ("cut.npz", "empty.npz", "single.npy", "missing.npz"):
        with pytest.raises(InvalidRequestError, match=name):
            ProMP.load(tmp_path / name)
    with pytest.raises(InvalidRequestError):
        ProMP.load(tmp_path)
