"""Leaves on petioles about the fruits of a picture: some before stems and fruits, most behind."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from optipromp.core.arrays import FloatArray, IntArray, frame_along, rotation
from optipromp.core.parameters import Checked, parameter
from optipromp.core.scenes.pose import Pose
from optipromp.core.scenes.rotations import to_quaternion
from optipromp.core.scenes.scene import Scene
from optipromp.laboratory.simulation.dress import SHOWN
from optipromp.laboratory.simulation.engine import engine
from optipromp.laboratory.simulation.painting import blade
from optipromp.laboratory.simulation.rich import textured

LEAF = "leaf:"
"""Begin of the names of the geoms of leaves and petioles."""
FORMS, COATS = 6, 3  # different leaves, and paintings of them, in a picture: choices
ACROSS, ALONG = 4, 20  # faces of a leaflet: choices
TEETH = 0.08  # depth of the teeth of its edge over its width: a choice
SPREAD = math.radians(78.0)  # between leaflets: a choice
TILT = 0.7  # of a leaf off the line of sight, deviation of each coordinate: a choice


@dataclass(frozen=True)
class LeafParameters(Checked):
    """How many leaves there are, where, and how large."""

    before_root: float = parameter(
        0.60, "1", "measured", "of roots of stems before which a leaf is put; with those that "
        "others hide and those outside, a third of stems' ends is visible (StrawDI)"
    )  # fmt: skip
    before_fruit: float = parameter(0.12, "1", "guess", "of fruits, a part of which a leaf hides")
    behind: tuple[int, int] = parameter((4, 26), "1", "choice", "leaves behind the fruits")
    size: tuple[float, float] = parameter((0.035, 0.075), "m", "guess", "length of a leaflet")
    single: float = parameter(0.3, "1", "choice", "of leaves that show one leaflet of three")
    depth: tuple[float, float] = parameter((0.05, 0.35), "m", "choice", "behind the fruits")


def leafy(
    spec: Any, scene: Scene, camera: Pose, p: LeafParameters, rng: np.random.Generator
) -> None:
    """Add leaves to a world's ``spec``. They touch nothing and weigh nothing.

    ``spec``: of MuJoCo. ``scene``: with the fruits. ``camera``: that takes the picture. ``p``:
    numbers. ``rng``: of all that is random.
    """
    fruits = [item for item in scene.objects if item.stem is not None]
    if not fruits:
        return
    lengths = _forms(spec, p, rng)
    axes = camera.rotation
    places = []
    for item in fruits:
        assert item.stem is not None
        if rng.random() < p.before_root:
            places.append(_toward(item.stem.root, camera, 0.012, rng))
        if rng.random() < p.before_fruit:
            turn, away = rng.uniform(0.0, 2.0 * np.pi), item.radius * rng.uniform(1.2, 2.0)
            aside = axes[:, :2] @ [away * np.cos(turn), away * np.sin(turn)]
            places.append(_toward(item.position + aside, camera, 0.03, rng))
    middle = np.mean([item.position for item in fruits], axis=0)
    for _ in range(int(rng.integers(p.behind[0], p.behind[1] + 1))):
        aside = axes[:, :2] @ rng.uniform([-0.25, -0.30], [0.25, 0.15])  # [m] y is down: choices
        places.append(middle + aside + rng.uniform(*p.depth) * axes[:, 2])
    for k, place in enumerate(places):
        _leaf(spec, f"{LEAF}{k}", place, camera, lengths, np.asarray(scene.up), rng)


def _toward(place: FloatArray, camera: Pose, most: float, rng: np.random.Generator) -> FloatArray:
    """A place (3,) moved towards the camera by 5 mm, and up to ``most`` [m] more."""
    way = camera.position - place
    return np.asarray(place + (0.005 + most * rng.random()) * way / np.linalg.norm(way))


def _forms(spec: Any, p: LeafParameters, rng: np.random.Generator) -> FloatArray:
    """Add meshes and paintings of leaves; returns the length (FORMS,) of their leaflets [m]."""
    for k in range(COATS):
        textured(spec, f"{LEAF}coat{k}", blade(rng), specular=0.3, shininess=0.3)
    out = []
    for k in range(FORMS):
        length = float(rng.uniform(*p.size))
        sides = (0.0,) if rng.random() < p.single else (0.0, SPREAD, -SPREAD)
        points, faces, shares = leaf(
            length, length * rng.uniform(0.5, 0.8), rng.uniform(-0.3, 0.3), sides
        )
        spec.add_mesh(
            name=f"{LEAF}form{k}", uservert=points.ravel().tolist(),
            userface=faces.ravel().astype(np.int32).tolist(),
            usertexcoord=shares.ravel().tolist(),
            userfacetexcoord=faces.ravel().astype(np.int32).tolist(),
            inertia=engine().mjtMeshInertia.mjMESH_INERTIA_SHELL,
        )  # fmt: skip
        out.append(length)
    return np.array(out)


def _leaf(
    spec: Any, name: str, place: FloatArray, camera: Pose, lengths: FloatArray, up: FloatArray,
    rng: np.random.Generator,
) -> None:  # fmt: skip
    """One leaf whose first leaflet is about ``place`` (3,), half turned to the camera."""
    mujoco = engine()
    facing = camera.position - place
    normal = facing / np.linalg.norm(facing) + TILT * rng.standard_normal(3)
    normal /= np.linalg.norm(normal)
    axes = rotation(normal, rng.uniform(0.0, 2.0 * np.pi)) @ frame_along(normal)
    form = int(rng.integers(FORMS))
    joint = place - 0.5 * lengths[form] * axes[:, 0]
    shared = {"mass": 0.0, "contype": 0, "conaffinity": 0, "group": SHOWN}
    spec.worldbody.add_geom(
        name=name, type=mujoco.mjtGeom.mjGEOM_MESH, meshname=f"{LEAF}form{form}", pos=joint,
        quat=to_quaternion(axes), material=f"{LEAF}coat{int(rng.integers(COATS))}", **shared,
    )  # fmt: skip
    colour = np.clip([0.36, 0.48, 0.20] + 0.08 * rng.standard_normal(3), 0.02, 1.0)
    away = -axes[:, 0] * rng.uniform(0.02, 0.06)
    rise = up * rng.uniform(-0.02, 0.10)
    share = np.linspace(0.0, 1.0, 4)[:, None]
    bowed = joint + share * away + share**2 * rise
    for k in range(3):
        spec.worldbody.add_geom(
            name=f"{name}:{k}", type=mujoco.mjtGeom.mjGEOM_CAPSULE, size=[0.0012, 0.0, 0.0],
            fromto=[*bowed[k], *bowed[k + 1]], rgba=[*colour, 1.0], **shared,
        )  # fmt: skip


def leaf(
    length: float, width: float, fold: float, sides: tuple[float, ...]
) -> tuple[FloatArray, IntArray, FloatArray]:
    """Vertices (V, 3) [m], faces (F, 3) and places on the painting (V, 2) of leaflets.

    Leaflets begin at the origin, at angles ``sides`` [rad] from x about z. Each is folded along its
    middle, with the slope ``fold`` of each half, and has teeth and two sides.
    """
    u = np.linspace(0.0, 1.0, ALONG + 1)[:, None]
    v = np.linspace(-1.0, 1.0, ACROSS + 1)[None]
    teeth = 1.0 - TEETH * (np.arange(ALONG + 1)[:, None] % 2) * (np.abs(v) == 1.0)
    half = 0.5 * width * np.maximum(np.sin(np.pi * u**0.8), 0.03) * teeth
    x, y = length * (u + 0.06 * np.abs(v) * np.sin(np.pi * u)), half * v
    z = fold * np.abs(y) - 0.8 * fold * length * (u - 0.4) ** 2
    upper = np.stack([x, y, z], axis=-1).reshape(-1, 3)
    lower = upper - [0.0, 0.0, 4e-4]
    i, j = np.meshgrid(np.arange(ALONG), np.arange(ACROSS), indexing="ij")
    a = (i * (ACROSS + 1) + j).ravel()
    b, c, d = a + 1, a + ACROSS + 1, a + ACROSS + 2
    top = np.concatenate([np.column_stack([a, c, b]), np.column_stack([b, c, d])])
    one = np.vstack([top, top[:, ::-1] + len(upper)])
    across = 0.25 + 0.23 * np.broadcast_to(v, half.shape).ravel()
    along = np.broadcast_to(u, half.shape).ravel()
    at = np.column_stack([np.r_[across, across + 0.5], np.r_[along, along]])
    flat = np.vstack([upper, lower])
    points = [flat @ rotation([0.0, 0.0, 1.0], side).T for side in sides]
    count = len(flat)
    faces = np.vstack([one + k * count for k in range(len(sides))])
    return np.vstack(points), faces, np.tile(at, (len(sides), 1))
