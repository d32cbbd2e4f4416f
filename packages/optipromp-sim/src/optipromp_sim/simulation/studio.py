"""The studio of films, photographs and live cameras: a world dressed for pictures, painted, drawn.

Rich looks are painted with skins of fruits, leaves and backgrounds.
"""

import math
from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from optipromp.core.arrays import FloatArray, IntArray, frame_along, rotation
from optipromp.core.errors import InvalidRequestError
from optipromp.core.scenes.pose import Pose
from optipromp.core.scenes.rotations import to_quaternion
from optipromp.core.scenes.scene import Scene
from optipromp.looks.appearance import Part, arm_parts, object_parts, scenery
from optipromp_eyes.pictures import CameraModel, Image8
from optipromp_sim.simulation.engine import engine
from optipromp_sim.simulation.world import FLOOR, World

EYE = "eye"  # Name of the camera of photographs in MuJoCo's model

SHOWN, HIDDEN = 2, 4  # MuJoCo's groups of geoms; of these, pictures show the first
GLOSS = {"target": (0.7, 0.6), "pushable": (0.5, 0.5), "floor": (0.0, 0.0)}  # specular, shininess
MATT = 0.25, 0.35
GLOW = 0.35  # share of its colour that the floor shows in the shade


def dressed(world: World, more: Callable[[Any], None] | None = None, *, props: bool = False) -> Any:
    """The world's model with visible parts that touch nothing and weigh nothing.

    Bodies, joints and their order are the world's, so states of one model are states of the other.
    The geoms that a part covers (body spheres, the tool's solids, fruits and objects) are hidden;
    stems, and the fruits of real neighbouring clusters, are shown as they collide. The world's
    ``spec`` changes: build another world for any other use. ``more`` changes it, too, at the end.
    ``props``: see :func:`optipromp.looks.appearance.scenery`.
    """
    spec, robot, scene = world.spec, world.robot, world.scene
    names = {body.name for body in spec.bodies}
    base = spec.worldbody
    hidden = [FLOOR, "body:", "tool:"]
    for part in arm_parts(robot):
        _add(spec, spec.body(f"segment:{part.segment}") if part.segment >= 0 else base, [part])
    for item in scene.objects:
        bodies = [f"fruit:{item.id}", f"static:{item.id}", f"avoid:{item.id}"]
        name = next((body for body in bodies if body in names), None)
        if name is None:
            continue
        hidden.append(name)
        parts = object_parts(scene, item)
        if not name.startswith("fruit:"):  # its body stands at the origin
            parts = tuple(part.placed(item.position, item.rotation) for part in parts)
        _add(spec, spec.body(name), parts)
    _add(spec, base, scenery(scene, props=props))
    for geom in spec.geoms:
        if geom.group != SHOWN:
            covered = any(
                geom.name == name or geom.name.startswith(name + ":" * (name[-1] != ":"))
                for name in hidden
            )
            geom.group = HIDDEN if covered else SHOWN
    if more is not None:
        more(spec)
    model = spec.compile()
    _light(model)
    return model


def _add(spec: Any, body: Any, parts: Iterable[Part]) -> None:
    mujoco = engine()
    for part in parts:
        if len(part.vertices) < 4:  # MuJoCo refuses it
            continue
        name = f"look:{part.segment}:{part.name}"
        kind = part.name.split(":")[0]
        specular, shininess = GLOSS.get(kind, MATT)
        rgba = [*(value / 255.0 for value in part.colour), part.opacity]
        spec.add_material(
            name=name,
            rgba=rgba,
            specular=specular,
            shininess=shininess,
            emission=GLOW if kind == "floor" else 0.0,
        )
        spec.add_mesh(
            name=name,
            uservert=part.vertices.ravel().tolist(),
            userface=part.faces.ravel().astype(np.int32).tolist(),
            inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
        )
        body.add_geom(
            name=name, type=mujoco.mjtGeom.mjGEOM_MESH, meshname=name, material=name, mass=0.0,
            contype=0, conaffinity=0, group=SHOWN,
        )  # fmt: skip


def _light(model: Any) -> None:
    """Light the model softly."""
    model.vis.headlight.ambient[:] = 0.35
    model.vis.headlight.diffuse[:] = 0.30
    model.vis.headlight.specular[:] = 0.15
    model.vis.map.znear = 0.01
    model.light_castshadow[:] = 0  # a shadow doubles the time of a picture, and speckles


class Studio:
    """A world dressed for pictures, its state, and the renderers that draw it.

    ``world``: that is drawn; its own ``spec`` stays as it is. ``fine``: whether edges are smoothed,
    which takes twice as long without a graphics card. ``lens``: of the camera :data:`EYE`, placed
    by :meth:`aim`. ``more``, ``props``: see :func:`dressed`.

    Renderers are made at the first picture of their size, and given back by :meth:`close`: what
    changes shadows or textures of :attr:`model` comes before the first picture.
    """

    def __init__(
        self, world: World, *, fine: bool = False, lens: CameraModel | None = None,
        more: Callable[[Any], None] | None = None, props: bool = False,
    ) -> None:  # fmt: skip
        own = replace(world, spec=world.spec.copy())
        if lens is not None:
            angle = 2.0 * math.degrees(math.atan(0.5 * lens.height / lens.fy))
            own.spec.worldbody.add_camera(name=EYE, fovy=angle)
        self.model = dressed(own, more, props=props)
        self.model.vis.quality.offsamples = 4 if fine else 0
        self._data = engine().MjData(self.model)
        self._renderers: dict[tuple[int, int], Any] = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Give the renderers back."""
        while self._renderers:
            self._renderers.popitem()[1].close()

    def stand(self, positions: FloatArray) -> None:
        """Bring everything to MuJoCo's first generalised ``positions``; the others stay."""
        self._data.qpos[: len(positions)] = positions
        engine().mj_kinematics(self.model, self._data)
        engine().mj_camlight(self.model, self._data)

    def aim(self, pose: Pose) -> None:
        """Place the camera :data:`EYE`, whose z points forward and y down; after :meth:`stand`."""
        eye = self.model.camera(EYE).id
        self._data.cam_xpos[eye] = pose.position
        self._data.cam_xmat[eye] = (pose.rotation * [1.0, -1.0, -1.0]).ravel()

    def colours(
        self, camera: Any, width: int, height: int, add: Callable[[Any], None] | None = None
    ) -> Image8:
        """The picture (height, width, 3) of a camera of MuJoCo; ``add`` changes MuJoCo's scene."""
        renderer = self.renderer(width, height)
        renderer.update_scene(self._data, camera)
        if add is not None:
            add(renderer.scene)
        return np.array(renderer.render())

    def depths(self, width: int, height: int) -> FloatArray:
        """Depth (height, width) [m] of the last picture of this size."""
        renderer = self.renderer(width, height)
        renderer.enable_depth_rendering()
        depth = renderer.render().astype(np.float64)
        renderer.disable_depth_rendering()
        return np.asarray(depth)

    def geoms(self, width: int, height: int) -> NDArray[np.int32]:
        """The geom of each pixel (height, width) of the last picture of this size; -1: none."""
        renderer = self.renderer(width, height)
        renderer.enable_segmentation_rendering()
        segments = renderer.render().copy()
        renderer.disable_segmentation_rendering()
        geom = segments[:, :, 1] == int(engine().mjtObj.mjOBJ_GEOM)
        return np.where(geom, segments[:, :, 0], -1)

    def renderer(self, width: int, height: int) -> Any:
        """MuJoCo's renderer of pictures of ``width`` x ``height`` pixels."""
        size = width, height
        if size not in self._renderers:
            try:
                made = engine().Renderer(self.model, height=height, width=width)
            except Exception as error:  # whatever the platform's OpenGL raises
                raise InvalidRequestError(
                    f"MuJoCo cannot draw off screen ({error}); on Linux it needs libEGL (Debian: "
                    "apt-get install libegl1), or set MUJOCO_GL"
                ) from None
            self._renderers[size] = made
        return self._renderers[size]


SEEDS = 60, 220  # on a fruit; a strawberry has about 200
SKIN, BLADE = (48, 96), 64  # [texel] rows and columns; side
PALE = np.array([0.88, 0.84, 0.66])  # shoulder of a ripe fruit
PINK = np.array([0.85, 0.35, 0.30])  # of a fruit that begins to ripen
GREENS = np.array([[0.06, 0.12, 0.05], [0.14, 0.30, 0.10], [0.30, 0.48, 0.16], [0.42, 0.52, 0.24]])
EARTH = np.array([  # soil, straw, film, concrete, sky
    [0.25, 0.17, 0.11], [0.62, 0.52, 0.34], [0.85, 0.86, 0.85], [0.08, 0.08, 0.09],
    [0.55, 0.54, 0.52], [0.66, 0.75, 0.86],
])  # fmt: skip


def skin(colour: FloatArray, ripe: bool, rng: np.random.Generator) -> Image8:
    """The skin of a fruit of a ``colour`` (3,), 0 to 1: rows from the stem to the tip, columns
    around, with seeds; a ripe fruit may have a pale shoulder, an unripe one a blush."""
    rows, columns = SKIN
    polar = np.pi * (np.arange(rows) + 0.5) / rows
    turn = 2.0 * np.pi * (np.arange(columns) + 0.5) / columns
    way = _directions(polar[:, None], turn[None])
    out = colour * (1.0 + 0.08 * noise(SKIN, 4.0, rng)[:, :, None])
    if ripe:
        edge = polar[:, None] / np.pi + 0.05 * noise(SKIN, 6.0, rng)
        out = _mixed(out, PALE, rng.uniform(0.0, 0.8) * np.clip(1.0 - edge / 0.22, 0.0, 1.0))
    elif rng.random() < 0.3:
        side = way @ _directions(rng.uniform(0.5, 2.5), rng.uniform(0.0, 2.0 * np.pi))
        out = _mixed(out, PINK, rng.uniform(0.05, 0.3) * np.clip(side, 0.0, 1.0))
    count = int(rng.integers(SEEDS[0], SEEDS[1] + 1))
    k = np.arange(count) + 0.5
    dots = _directions(np.arccos(1.0 - 2.0 * k / count), np.pi * (1.0 + np.sqrt(5.0)) * k)
    off = np.arccos(np.clip((way @ dots.T).max(axis=2), -1.0, 1.0))
    dot = out.mean(axis=(0, 1)) * rng.uniform(0.5, 1.1) + [0.15, 0.12, 0.0]
    out = out * (1.0 - 0.15 * np.exp(-((off / 0.12) ** 2)))[:, :, None]  # the dimple of a seed
    return _bytes(_mixed(out, dot, 0.9 * (off < 0.05)))


def blade(rng: np.random.Generator) -> Image8:
    """A leaf: rows along it, the first half of the columns across its upper side, the second half
    across its paler lower side."""
    u, v = np.mgrid[0:BLADE, 0:BLADE] / (BLADE - 1.0)
    aside = np.abs(2.0 * v - 1.0)
    side_veins = np.abs((7.0 * u - 2.5 * aside) % 1.0 - 0.5) < 0.06
    veins = np.maximum(0.35 * side_veins, 0.6 * (aside < 0.06))
    tint = GREENS[1] + rng.uniform(0.0, 0.7) * (GREENS[2] - GREENS[1])
    green = np.clip(tint * (1.0 + 0.12 * rng.standard_normal(3)), 0.0, 1.0)
    upper = green * (1.0 + 0.12 * noise((BLADE, BLADE), 5.0, rng)[:, :, None])
    if rng.random() < 0.3:  # old
        dry = np.clip(noise((BLADE, BLADE), 8.0, rng) - 0.6 + 0.8 * aside, 0.0, 1.0)
        upper = _mixed(upper, np.array([0.55, 0.45, 0.18]), 0.8 * dry)
    upper = _mixed(upper, np.array([0.50, 0.62, 0.32]), veins)
    lower = _mixed(upper, np.array([0.55, 0.62, 0.45]), 0.5)
    return _bytes(np.concatenate([upper, lower], axis=1))


def background(width: int, height: int, rng: np.random.Generator) -> Image8:
    """What is behind a plant: foliage, ground and film, or two colours of any kind."""
    chance = rng.random()
    if chance < 0.6:
        return foliage(width, height, rng)
    pool = EARTH if chance < 0.85 else rng.uniform(0.1, 0.9, (3, 3))
    out = np.broadcast_to(pool[rng.integers(len(pool))], (height, width, 3))
    for _ in range(2):
        share = 1.0 / (1.0 + np.exp(-3.0 * noise((height, width), rng.uniform(1.0, 30.0), rng)))
        out = _mixed(out, pool[rng.integers(len(pool))], share)
    fine = 1.0 + rng.uniform(0.0, 0.06) * noise((height, width), 0.8, rng)
    return _bytes(out * fine[:, :, None])


def foliage(width: int, height: int, rng: np.random.Generator) -> Image8:
    """Leaves and stems before the dark, more or less in focus."""
    from PIL import Image, ImageDraw, ImageFilter

    dark, light = rng.uniform(0.2, 1.5), rng.uniform(0.6, 1.1)
    picture = Image.new("RGB", (width, height), _colour(dark * GREENS[0]))
    draw = ImageDraw.Draw(picture)
    u = np.linspace(0.0, 1.0, 7)
    half = 0.33 * np.sin(np.pi * u**0.8)
    side = np.stack([u, half], axis=1)
    other = side[::-1] * [1.0, -1.0]
    size, count = width * rng.uniform(0.04, 0.14), int(rng.integers(120, 320))
    for k in range(count):
        at, turn = rng.uniform([0, 0], [width, height]), rng.uniform(0.0, 2.0 * np.pi)
        long = size * rng.uniform(0.6, 1.4)
        c, s = long * np.cos(turn), long * np.sin(turn)
        green = GREENS[1:][rng.integers(3)] * (0.25 + 0.75 * k / count) * light
        green = green * rng.uniform(0.8, 1.15, 3)
        if rng.random() < 0.15:
            draw.line([*at, *(at + [2.0 * c, 2.0 * s])], fill=_colour(green), width=2)
            continue
        turned = np.array([[c, s], [-s, c]])
        for edge, shade in ((side, 1.0), (other, rng.uniform(0.7, 1.0))):
            draw.polygon((at + edge @ turned).ravel().tolist(), fill=_colour(shade * green))
        draw.line([*at, *(at + [c, s])], fill=_colour(1.25 * green))
    blurred = picture.filter(ImageFilter.GaussianBlur(width * rng.uniform(0.0, 0.012)))
    return np.asarray(blurred, dtype=np.uint8)


def _colour(values: FloatArray) -> tuple[int, ...]:
    return tuple(_bytes(values).tolist())


def _directions(polar: object, turn: object) -> FloatArray:
    """Unit vectors (..., 3) at angles from z and about it [rad]."""
    polar, turn = np.broadcast_arrays(np.asarray(polar), np.asarray(turn))
    flat = np.sin(polar)
    return np.stack([flat * np.cos(turn), flat * np.sin(turn), np.cos(polar)], axis=-1)


def noise(size: tuple[int, ...], width: float, rng: np.random.Generator) -> FloatArray:
    """Noise of unit deviation, correlated over ``width`` texels, that repeats without a seam."""
    rough = gaussian_filter(rng.standard_normal(size), width, mode="wrap")
    return np.asarray(rough / rough.std())


def _mixed(one: FloatArray, other: FloatArray, share: FloatArray | float) -> FloatArray:
    """Colours (..., 3) with a ``share`` (...) of another colour."""
    part = np.asarray(share)[..., None]
    return np.asarray(one * (1.0 - part) + other * part)


def _bytes(colours: FloatArray) -> Image8:
    return np.asarray(np.clip(255.0 * colours, 0.0, 255.0), dtype=np.uint8)


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


LEAF = "leaf:"  # Begin of the names of the geoms of leaves and petioles
FORMS, COATS = 6, 3  # different leaves, and paintings of them, in a picture: choices
ACROSS, ALONG = 4, 20  # faces of a leaflet: choices
TEETH = 0.08  # depth of the teeth of its edge over its width: a choice
SPREAD = math.radians(78.0)  # between leaflets: a choice
TILT = 0.7  # of a leaf off the line of sight, deviation of each coordinate: a choice
# [1] measured: share of roots of stems before which a leaf is put; with those that others hide and
# those outside, a third of stems' ends is visible (StrawDI)
BEFORE_ROOT = 0.60
BEFORE_FRUIT = 0.12  # [1] guess: share of fruits, a part of which a leaf hides
BEHIND = 4, 26  # choice: leaves behind the fruits
LEAFLET = 0.035, 0.075  # [m] guess: length of a leaflet
SINGLE = 0.3  # [1] choice: share of leaves that show one leaflet of three
DEPTH = 0.05, 0.35  # [m] choice: of a leaf behind the fruits


def leafy(spec: Any, scene: Scene, camera: Pose, rng: np.random.Generator) -> None:
    """Add leaves to a world's ``spec`` (MuJoCo). They touch nothing and weigh nothing."""
    fruits = [item for item in scene.objects if item.stem is not None]
    if not fruits:
        return
    lengths = _forms(spec, rng)
    axes = camera.rotation
    places = []
    for item in fruits:
        assert item.stem is not None
        if rng.random() < BEFORE_ROOT:
            places.append(_toward(item.stem.root, camera, 0.012, rng))
        if rng.random() < BEFORE_FRUIT:
            turn, away = rng.uniform(0.0, 2.0 * np.pi), item.radius * rng.uniform(1.2, 2.0)
            aside = axes[:, :2] @ [away * np.cos(turn), away * np.sin(turn)]
            places.append(_toward(item.position + aside, camera, 0.03, rng))
    middle = np.mean([item.position for item in fruits], axis=0)
    for _ in range(int(rng.integers(BEHIND[0], BEHIND[1] + 1))):
        aside = axes[:, :2] @ rng.uniform([-0.25, -0.30], [0.25, 0.15])  # [m] y is down: choices
        places.append(middle + aside + rng.uniform(*DEPTH) * axes[:, 2])
    for k, place in enumerate(places):
        _leaf(spec, f"{LEAF}{k}", place, camera, lengths, np.asarray(scene.up), rng)


def _toward(place: FloatArray, camera: Pose, most: float, rng: np.random.Generator) -> FloatArray:
    """A place (3,) moved towards the camera by 5 mm, and up to ``most`` [m] more."""
    way = camera.position - place
    return np.asarray(place + (0.005 + most * rng.random()) * way / np.linalg.norm(way))


def _forms(spec: Any, rng: np.random.Generator) -> FloatArray:
    """Add meshes and paintings of leaves; returns the length (FORMS,) of their leaflets [m]."""
    for k in range(COATS):
        textured(spec, f"{LEAF}coat{k}", blade(rng), specular=0.3, shininess=0.3)
    out = []
    for k in range(FORMS):
        length = float(rng.uniform(*LEAFLET))
        sides = (0.0,) if rng.random() < SINGLE else (0.0, SPREAD, -SPREAD)
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
