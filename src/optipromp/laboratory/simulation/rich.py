"""Rich looks of a world for pictures: painted fruits, floor and background."""

from typing import Any

import numpy as np

from optipromp.core.arrays import FloatArray
from optipromp.core.scenes.pose import Pose
from optipromp.core.scenes.rotations import to_quaternion
from optipromp.core.scenes.scene import Scene
from optipromp.laboratory.simulation.dress import SHOWN
from optipromp.laboratory.simulation.engine import engine
from optipromp.laboratory.simulation.painting import background, skin
from optipromp.perception.pictures import Image8

SKY = 256  # [texel] side of each of the six faces of the sky
WALL = 384, 288  # [texel]
WALLS = 0.75  # share of pictures with a wall behind the plant: a choice
FAR = 0.9, 2.0  # [m] from the camera to it: a choice
BUMPS = 0.04  # deviation of a fruit's surface from smooth, over its radius: a choice
GUTTERS = ((0.93, 0.93, 0.92), (0.12, 0.12, 0.13), (0.55, 0.57, 0.58), (0.35, 0.30, 0.25))


def textured(spec: Any, name: str, picture: Image8, **looks: float) -> None:
    """Add a material ``name`` that shows a picture, first row at v = 0."""
    mujoco = engine()
    texture = spec.add_texture(
        name=name, type=mujoco.mjtTexture.mjTEXTURE_2D, width=picture.shape[1],
        height=picture.shape[0], nchannel=3,
    )  # fmt: skip
    texture.data = picture.tobytes()
    material = spec.add_material(name=name, rgba=[1.0, 1.0, 1.0, 1.0], **looks)
    material.textures[int(mujoco.mjtTextureRole.mjTEXROLE_RGB)] = name


def furnished(spec: Any, scene: Scene, camera: Pose, rng: np.random.Generator) -> None:
    """Paint the fruits, the gutter, the floor and the sky of a dressed world; add a wall behind."""
    for item in scene.objects:
        name = f"look:-1:{item.role}:{item.id}"
        if item.stem is not None and any(mesh.name == name for mesh in spec.meshes):
            _skinned(spec, name, item.role == "target", rng)
    sky = spec.texture("sky")
    sides = background(SKY, 6 * SKY, rng)
    sky.builtin, sky.width, sky.height = engine().mjtBuiltin.mjBUILTIN_NONE, SKY, 6 * SKY
    sky.nchannel, sky.data = 3, sides.tobytes()
    textured(spec, "ground", background(SKY, SKY, rng), emission=0.2)
    for geom in spec.geoms:
        if geom.name == "look:-1:floor":
            geom.material = "ground"
        elif geom.name == "look:-1:gutter":
            colour = GUTTERS[rng.integers(len(GUTTERS))]
            spec.material(geom.material).rgba = [*colour, 1.0]
    if rng.random() < WALLS:
        textured(spec, "wall", background(*WALL, rng), emission=float(rng.uniform(0.0, 0.3)))
        away = float(rng.uniform(*FAR))
        spec.worldbody.add_geom(
            name="wall", type=engine().mjtGeom.mjGEOM_BOX, size=[1.1 * away, 0.85 * away, 0.001],
            pos=camera.position + away * camera.rotation[:, 2], material="wall",
            quat=to_quaternion(camera.rotation * [1.0, -1.0, -1.0]), mass=0.0, contype=0,
            conaffinity=0, group=SHOWN,
        )  # fmt: skip


def _skinned(spec: Any, name: str, ripe: bool, rng: np.random.Generator) -> None:
    """Give a fruit a skin and bumps. Its stem is at the upper end of its z."""
    mesh, material = spec.mesh(name), spec.material(name)
    points = np.reshape(mesh.uservert, (-1, 3))
    faces = np.reshape(mesh.userface, (-1, 3))
    way = points / np.linalg.norm(points, axis=1, keepdims=True)
    waves, phases = 2.5 * rng.standard_normal((4, 3)), rng.uniform(0.0, 2.0 * np.pi, 4)
    bump = np.sin(way @ waves.T + phases).mean(axis=1)
    mesh.uservert = (points * (1.0 + BUMPS * bump)[:, None]).ravel().tolist()
    low, high = points[:, 2].min(), points[:, 2].max()
    u = np.arctan2(points[:, 1], points[:, 0]) / (2.0 * np.pi)
    v = np.arccos(np.clip(2.0 * (points[:, 2] - low) / (high - low) - 1.0, -1.0, 1.0)) / np.pi
    around = _unbroken(u[faces])
    mesh.usertexcoord = np.stack([around, v[faces]], axis=-1).ravel().tolist()
    mesh.userfacetexcoord = np.arange(faces.size, dtype=np.int32).tolist()
    colour = np.asarray(material.rgba[:3], dtype=np.float64)
    picture = skin(colour * np.exp(0.06 * rng.standard_normal(3)), ripe, rng)
    textured(spec, f"{name}:skin", picture, specular=float(rng.uniform(0.2, 0.8)),
             shininess=float(rng.uniform(0.3, 0.8)))  # fmt: skip
    next(geom for geom in spec.geoms if geom.name == name).material = f"{name}:skin"


def _unbroken(turns: FloatArray) -> FloatArray:
    """Shares of a turn (F, 3) at the corners of triangles, with none across the seam."""
    return np.asarray(turns + (turns < turns.max(axis=1, keepdims=True) - 0.5))
