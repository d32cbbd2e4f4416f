"""Leaves on petioles about the fruits of a picture: some before stems and fruits, most behind."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from optipromp.core.arrays import FloatArray, frame_along
from optipromp.core.parameters import Checked, parameter
from optipromp.core.scenes.pose import Pose
from optipromp.core.scenes.scene import Scene
from optipromp.laboratory.simulation.dress import SHOWN
from optipromp.laboratory.simulation.engine import engine

LEAF = "leaf:"
"""Begin of the names of the geoms of leaves and petioles."""
ACROSS, ALONG = 6, 8  # faces of a blade: choices


@dataclass(frozen=True)
class LeafParameters(Checked):
    """How many leaves there are, where, and how large."""

    before_root: float = parameter(
        0.65, "1", "measured", "of roots of stems that a leaf hides; two thirds of stems' ends are "
        "hidden or outside in pictures of plantations (StrawDI)"
    )  # fmt: skip
    before_fruit: float = parameter(0.10, "1", "guess", "of fruits, a part of which a leaf hides")
    behind: tuple[int, int] = parameter((6, 16), "1", "choice", "leaves behind the fruits")
    size: tuple[float, float] = parameter((0.04, 0.09), "m", "guess", "length of a leaf")
    depth: tuple[float, float] = parameter((0.08, 0.35), "m", "choice", "behind the fruits")


def leafy(
    spec: Any, scene: Scene, camera: Pose, p: LeafParameters, rng: np.random.Generator
) -> None:
    """Add leaves to a world's ``spec``. They touch nothing and weigh nothing.

    Args:
        spec: of MuJoCo.
        scene: with the fruits.
        camera: that takes the picture.
        p: numbers.
        rng: of all that is random.
    """
    count = 0
    fruits = [item for item in scene.objects if item.stem is not None]
    for item in fruits:
        assert item.stem is not None
        if rng.random() < p.before_root:
            _leaf(spec, count, _toward(item.stem.root, camera, 0.012, rng), camera, p, rng)
            count += 1
        if rng.random() < p.before_fruit:
            away = item.radius * rng.uniform(1.0, 1.6)
            turn = rng.uniform(0.0, 2.0 * np.pi)
            aside = camera.rotation[:, :2] @ [away * np.cos(turn), away * np.sin(turn)]
            place = _toward(item.position + aside, camera, 0.03, rng)
            _leaf(spec, count, place, camera, p, rng)
            count += 1
    middle = np.mean([item.position for item in fruits], axis=0)
    for _ in range(int(rng.integers(p.behind[0], p.behind[1] + 1))):
        aside = camera.rotation[:, :2] @ rng.uniform(-0.22, 0.22, 2)  # [m] across: a choice
        place = middle + aside + rng.uniform(*p.depth) * camera.rotation[:, 2]
        _leaf(spec, count, place, camera, p, rng)
        count += 1


def _toward(place: FloatArray, camera: Pose, most: float, rng: np.random.Generator) -> FloatArray:
    """A place (3,) moved towards the camera by 5 mm, and up to ``most`` [m] more."""
    way = camera.position - place
    return np.asarray(place + (0.005 + most * rng.random()) * way / np.linalg.norm(way))


def _leaf(
    spec: Any, index: int, place: FloatArray, camera: Pose, p: LeafParameters,
    rng: np.random.Generator,
) -> None:  # fmt: skip
    """One leaf about ``place`` (3,), half turned to the camera, on its petiole."""
    mujoco = engine()
    facing = camera.position - place
    normal = facing / np.linalg.norm(facing) + 0.7 * rng.standard_normal(3)
    axes = frame_along(normal / np.linalg.norm(normal))
    turn = rng.uniform(0.0, 2.0 * np.pi)
    c, s = math.cos(turn), math.sin(turn)
    axes = np.column_stack([c * axes[:, 0] + s * axes[:, 1], c * axes[:, 1] - s * axes[:, 0],
                            axes[:, 2]])  # fmt: skip
    length = float(rng.uniform(*p.size))
    points, faces = blade(length, length * rng.uniform(0.5, 0.9), rng.uniform(-0.25, 0.25))
    name = f"{LEAF}{index}"
    colour = np.clip([0.20, 0.42, 0.14] + 0.08 * rng.standard_normal(3), 0.02, 1.0)
    spec.add_mesh(
        name=name, uservert=(points @ axes.T + place).ravel().tolist(),
        userface=faces.ravel().astype(np.int32).tolist(),
        inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
    )  # fmt: skip
    shared = {
        "mass": 0.0, "contype": 0, "conaffinity": 0, "group": SHOWN, "rgba": [*colour, 1.0],
    }  # fmt: skip
    spec.worldbody.add_geom(name=name, type=mujoco.mjtGeom.mjGEOM_MESH, meshname=name, **shared)
    end = place - 0.5 * length * axes[:, 0]
    root = end - axes[:, 0] * rng.uniform(0.03, 0.08) + [0.0, 0.0, rng.uniform(0.0, 0.06)]
    spec.worldbody.add_geom(
        name=f"{name}:petiole", type=mujoco.mjtGeom.mjGEOM_CAPSULE, size=[0.0012, 0.0, 0.0],
        fromto=[*end, *root], **shared,
    )  # fmt: skip


def blade(length: float, width: float, fold: float) -> tuple[FloatArray, FloatArray]:
    """Vertices (V, 3) [m] and faces (F, 3) of a pointed leaf along x, folded along its middle.

    Both sides have faces. ``fold`` is the slope of each half.
    """
    u = np.linspace(-0.5, 0.5, ALONG + 1)[:, None]
    v = np.linspace(-1.0, 1.0, ACROSS + 1)[None]
    half = 0.5 * width * np.maximum(1.0 - (2.0 * np.abs(u)) ** 2, 0.02)
    x, y = length * (u + 0.0 * v), half * v
    z = fold * np.abs(y) - 0.8 * fold * length * u**2
    upper = np.stack([x, y, z], axis=-1).reshape(-1, 3)
    lower = upper - [0.0, 0.0, 4e-4]
    i, j = np.meshgrid(np.arange(ALONG), np.arange(ACROSS), indexing="ij")
    a = (i * (ACROSS + 1) + j).ravel()
    b, c, d = a + 1, a + ACROSS + 1, a + ACROSS + 2
    top = np.concatenate([np.column_stack([a, c, b]), np.column_stack([b, c, d])])
    return np.vstack([upper, lower]), np.vstack([top, top[:, ::-1] + len(upper)])
