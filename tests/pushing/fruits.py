"""Fruits on stems and paths of a cup for tests."""

import itertools
from typing import Any

import numpy as np

from optipromp.core.geometry.obstacles import Obstacles, pack
from optipromp.core.pushing.stems.bending import Stems, bent_stems
from optipromp.core.pushing.stems.cup import Mouth
from optipromp.core.pushing.stems.kept_states import NOT_KEPT
from optipromp.core.pushing.stems.swinging import NEVER, push

CUP = Mouth(inner=0.023, outer=0.025, base=-0.03, rim=0.02, floor=0.002, neck=0.01)
UP = np.array([0.0, 0.0, 1.0])
DT = 0.04  # [s]
TARGET = np.array([0.4, 0.1, 0.9])


def hung(*fruits: tuple[Any, Any], radius: float = 0.015, apart: float = 0.0) -> Stems:
    """Fruits at places relative to the target's, on stems ``vector`` to their roots.

    With ``apart`` [m] they are long: capsules along their stems, the place is the lower ball's.
    """
    fruit = TARGET + np.array([place for place, _ in fruits], dtype=float)
    root = fruit + np.array([vector for _, vector in fruits], dtype=float)
    radii, thickness = np.full(len(fruit), radius), np.full(len(fruit), 0.0015)
    return bent_stems(root, fruit, radii, thickness, apart=np.full(len(fruit), apart))


def along(*corners: Any, step: float = 0.003) -> np.ndarray:
    """Points every ``step`` through corners relative to the target's place."""
    places = TARGET + np.array(corners, dtype=float)
    parts = [
        a + np.linspace(0.0, 1.0, int(np.linalg.norm(b - a) / step) + 2)[:-1, None] * (b - a)
        for a, b in itertools.pairwise(places)
    ]
    return np.ascontiguousarray(np.vstack([*parts, places[-1:]]))


NOTHING = pack([])


def led(
    stems: Stems,
    points: np.ndarray,
    axis: np.ndarray = UP,
    cup: Mouth = CUP,
    solid: Obstacles = NOTHING,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Positions (P, N, 3) of the fruits (of long ones the lower balls), forces (P, N) on fruits and
    on stems."""
    count, steps = len(stems.root), len(points)
    out = np.zeros((steps, count, 3)), np.zeros((steps, count)), np.zeros((steps, count))
    axes = np.tile(axis, (steps, 1))
    new = np.zeros(5), np.zeros(count), NEVER, 0.0, 0, NOT_KEPT
    assert push(stems, points, axes, DT, cup, solid, np.inf, *out, *new) == steps
    return out
