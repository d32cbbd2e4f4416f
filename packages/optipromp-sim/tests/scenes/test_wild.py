"""The preset ``wild`` has the quantiles of fruits in pictures of plantations."""

import numpy as np
import pytest

from optipromp.core.scenes.scene import SceneObject
from optipromp_sim.generate import generate

COUNTED = {  # shares, values and tolerance; StrawDI with key points, 1,704 strawberries
    "longer": ((0.10, 0.25, 0.50, 0.75, 0.90), (1.12, 1.23, 1.37, 1.56, 1.89), 0.06),
    "leaning": ((0.10, 0.25, 0.50, 0.75), (3.0, 8.0, 18.0, 40.0), 2.5),
    "crooked": ((0.10, 0.25, 0.50, 0.75, 0.90), (1.5, 4.0, 9.0, 15.0, 24.0), 2.0),
    "near": ((0.05, 0.10, 0.25, 0.50), (0.67, 0.78, 1.03, 1.6), 0.1),
    "many": ((0.10, 0.50, 0.90), (3.0, 5.0, 9.0), 0.5),
}


def figures(count: int) -> dict[str, list[float]]:
    out: dict[str, list[float]] = {name: [] for name in COUNTED}
    for seed in range(count):
        fruits = generate("wild", 65_000 + seed).objects
        out["many"].append(len(fruits))
        for item in fruits:
            edges = np.ptp(item.shape.surface().reshape(-1, 3), axis=0)
            out["longer"].append(edges[2] / edges[0])
            _, across, up = item.stem.vector
            out["leaning"].append(np.degrees(np.arctan2(abs(across), up)))
            cosine = item.stem.vector @ item.rotation[:, 2] / np.linalg.norm(item.stem.vector)
            out["crooked"].append(np.degrees(np.arccos(min(cosine, 1.0))))
            out["near"].append(nearest(item, fruits) / edges[0])
    return out


def nearest(item: SceneObject, fruits: tuple[SceneObject, ...]) -> float:
    """Distance of the nearest other fruit in the picture, between centres [m]."""
    others = [other.position[1:] for other in fruits if other is not item]
    return float(np.linalg.norm(np.array(others) - item.position[1:], axis=1).min())


def test_the_quantiles_are_those_of_the_labels() -> None:
    for name, values in figures(250).items():
        shares, wanted, slack = COUNTED[name]
        assert np.quantile(values, shares) == pytest.approx(wanted, abs=slack), name
