"""Points and the spheres that cover them."""

import numpy as np


def away(points: np.ndarray, spheres: np.ndarray) -> np.ndarray:
    """How far (m,) points lie outside of the nearest sphere of (k, 4) [m]; below 0 inside."""
    distances = np.linalg.norm(points[:, None] - spheres[:, :3], axis=2) - spheres[:, 3]
    return np.asarray(distances.min(axis=1))


def worst_gap(points: np.ndarray, spheres: np.ndarray) -> float:
    """How far the worst point lies outside of every sphere [m]; below 0 where none does."""
    return float(away(points, spheres).max())


def directions(count: int) -> np.ndarray:
    """Unit vectors (count, 3), evenly spread (Fibonacci)."""
    i = np.arange(count) + 0.5
    polar, turn = np.arccos(1.0 - 2.0 * i / count), np.pi * (1.0 + 5.0**0.5) * i
    return np.column_stack(
        [np.cos(turn) * np.sin(polar), np.sin(turn) * np.sin(polar), np.cos(polar)]
    )
