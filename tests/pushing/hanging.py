"""A bench for the push model of fruits on stems: a target, neighbours about it, and a cup."""

from dataclasses import replace
from typing import Any

import numpy as np
from tests.pushing.fruits import TARGET, UP

from optipromp.core.geometry import Sphere
from optipromp.core.pushing.path import ToolPath, through
from optipromp.core.pushing.rules import neighbours
from optipromp.core.pushing.stems.hanging import Hanging
from optipromp.core.robots.tools import Cup
from optipromp.core.scenes import Scene, SceneObject, Stem

CUP = Cup(radius=0.025, opening=0.046)
CAMERA = TARGET - [0.0, 0.0, 0.25]
VERTICAL = (0.0, 0.0, 0.2)
LEANING = (0.05, 0.0, 0.2)


def fruit(name: str, off: Any, stem: Any = VERTICAL, role: Any = "pushable") -> SceneObject:
    at = TARGET + np.asarray(off, dtype=float)
    hung = Stem(np.array([at, at + np.asarray(stem, dtype=float)]))
    return SceneObject(name, role, Sphere(0.015), at, stem=hung)


RIPE = fruit("ripe", (0.0, 0.0, 0.0), (0.0, 0.0, 0.1), "target")
UNDER = fruit("n1", (0.003, 0.0, -0.08))  # on the approach line
BESIDE = fruit("n1", (0.07, 0.0, -0.08), LEANING)  # the cup passes it by 3 cm


def scene(*fruits: SceneObject) -> Scene:
    return Scene("bench", "panda", (RIPE, *fruits))


def model(*fruits: SceneObject, cup: Cup = CUP) -> Hanging:
    one = scene(*fruits)
    return Hanging(one, cup, neighbours(one, cup.gripper_radius), CAMERA, cup.gripper_radius)


def led(*corners: Any) -> ToolPath:
    """The tool led through corners relative to the target."""
    return through(TARGET + np.array(corners, dtype=float), 0.1)


STRAIGHT = led((0, 0, -0.25), (0, 0, 0))


def judged(path: ToolPath) -> tuple[np.ndarray, np.ndarray]:
    return path.points, np.tile(UP, (len(path.points), 1))


def harm(a: Hanging, path: ToolPath, states: int = 1) -> float:
    return a.harm(*judged(path), states)


def detected(obj: SceneObject, deviation: float = 0.005) -> SceneObject:
    return replace(obj, covariance=deviation**2 * np.eye(3))
