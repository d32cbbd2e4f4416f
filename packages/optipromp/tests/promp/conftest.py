"""Movements and an arm to try the primitives on."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from optipromp.core.promp import Basis, Demonstrations, ProMP, load_demonstrations

RECORDED = (
    Path(__file__).resolve().parents[4] / "../shared/data/panda_demonstrations/demonstrations.npz"
)


@pytest.fixture(scope="session")
def recorded() -> Demonstrations:
    if not RECORDED.exists():
        pytest.skip("the recorded Panda demonstrations are not here (they carry no licence)")
    return load_demonstrations(RECORDED)


@pytest.fixture(scope="session")
def make_promp() -> Callable[..., ProMP]:
    def make(seed: int, n: int = 3, count: int = 6, rank: int | None = None) -> ProMP:
        rng = np.random.default_rng(seed)
        size = n * count
        factor = rng.normal(size=(size, rank or size)) / np.sqrt(size)
        covariance = factor @ factor.T + (0.0 if rank else 1e-2) * np.eye(size)
        noise = rng.uniform(1e-4, 1e-2, n)
        return ProMP(Basis(count), rng.normal(size=(n, count)), covariance, noise)

    return make


def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """As np.cross on the last axis, which takes several times as long."""
    (x, y, z), (u, v, w) = a.T, b.T
    return np.array([y * w - z * v, z * u - x * w, x * v - y * u]).T


class Arm:
    """Links along local x, joints about z and y in turn; tool axis along the last link."""

    def __init__(self, n: int = 7, link: float = 0.2) -> None:
        self.n, self.link = n, link
        axes = (np.eye(3)[2 - j % 2] for j in range(n))
        self.turns = [(a, np.cross(a, np.eye(3)).T) for a in axes]  # k @ v = axis × v

    def __call__(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        m = len(q)
        rotation = np.tile(np.eye(3), (m, 1, 1))
        origin, origins, axes = np.zeros((m, 3)), [], []
        for j, (axis, k) in enumerate(self.turns):
            origins.append(origin)
            axes.append(rotation @ axis)
            s, c = np.sin(q[:, j])[:, None, None], np.cos(q[:, j])[:, None, None]
            rotation = rotation @ (np.eye(3) + s * k + (1.0 - c) * k @ k)
            origin = origin + self.link * rotation[:, :, 0]
        tool = rotation[:, :, 0]
        point_jacobian = np.stack(
            [cross(a, origin - o) for a, o in zip(axes, origins, strict=True)], axis=2
        )
        axis_jacobian = np.stack([cross(a, tool) for a in axes], axis=2)
        return origin, tool, point_jacobian, axis_jacobian


@pytest.fixture(scope="session")
def arm() -> Arm:
    return Arm()


@pytest.fixture(scope="session")
def arm_promp() -> ProMP:
    """A bent arm that sways: 7 joints, 5 bases, correlated weights."""
    rng = np.random.default_rng(3)
    basis = Basis()
    mean = np.array([0.2, -0.6, 0.3, 0.9, -0.2, 0.7, 0.1])[:, None] * np.linspace(0.4, 1.0, 5)
    factor = rng.normal(size=(35, 12)) * 0.15
    return ProMP(basis, mean, factor @ factor.T + 4e-3 * np.eye(35), np.full(7, 1e-5))
