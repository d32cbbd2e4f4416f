"""Pictures of scenes with truth: colour, depth and instance masks, off screen."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter
from scipy.spatial import ConvexHull

from optipromp.core.arrays import FloatArray
from optipromp.core.errors import InvalidRequestError
from optipromp.core.geometry.shapes import Sphere
from optipromp.core.parameters import Checked, parameter
from optipromp.core.planning.task import posed
from optipromp.core.scenes.pose import Pose
from optipromp.core.scenes.rotations import to_quaternion
from optipromp.core.scenes.scene import Scene, SceneObject
from optipromp.laboratory.simulation.detector_parameters import MOUNTS, DetectorParameters
from optipromp.laboratory.simulation.dress import dressed
from optipromp.laboratory.simulation.engine import engine
from optipromp.laboratory.simulation.leaves import LEAF, LeafParameters, leafy
from optipromp.laboratory.simulation.parameters import SimulationParameters
from optipromp.laboratory.simulation.render import canvas
from optipromp.laboratory.simulation.rich import furnished
from optipromp.laboratory.simulation.sight import hand_pose, standing_pose, tool_frame
from optipromp.laboratory.simulation.stereo import StereoParameters, sensed
from optipromp.laboratory.simulation.world import CLUSTER_FRUIT_RADIUS, World, build
from optipromp.perception.pictures import CameraModel, DepthPicture, Image8

EYE = "eye"
Kind = Literal["ripe", "unripe", "calyx", "stem", "leaf", "static", "other"]
Looks = Literal["plain", "rich"]
SHADOW = 1024  # [texel] side of the map of shadows
FRUITS: tuple[Kind, ...] = ("ripe", "unripe")


@dataclass(frozen=True)
class PhotoParameters(Checked):
    """The camera, and how light, colours and background vary from picture to picture."""

    width: int = parameter(640, "pixel", "choice", "of a picture")
    height: int = parameter(480, "pixel", "choice", "of a picture")
    focal: float = parameter(
        480.0, "pixel", "choice", "67 degrees across; RGB-D cameras see 42-87 degrees"
    )
    jitter: float = parameter(
        0.03, "m", "choice", "standard deviation of a standing camera's place along each axis"
    )
    ambient: tuple[float, float] = parameter((0.20, 0.50), "1", "choice", "light from everywhere")
    sun: tuple[float, float] = parameter((0.2, 0.8), "1", "choice", "light from one side")
    tint: float = parameter(0.06, "1", "choice", "standard deviation of the light's colour")
    hue: float = parameter(6.0, "deg", "choice", "standard deviation of the hue of each surface")
    paint: float = parameter(
        0.10, "1", "choice", "standard deviation of saturation and value of each surface"
    )
    metered: float = parameter(
        0.32, "1", "choice", "rich looks: mean of the colours that exposure aims at"
    )
    exposure: float = parameter(
        0.18, "1", "choice", "rich looks: standard deviation of the logarithm of brightness"
    )
    corners: float = parameter(0.3, "1", "choice", "rich looks: most light that corners lack")
    blur: float = parameter(
        0.9, "pixel", "choice", "rich looks: largest deviation of a point's image at 640 pixels"
    )
    grain: float = parameter(
        2.5, "1", "guess", "standard deviation of each pixel's colours, of 255"
    )


class Marked(NamedTuple):
    """What an instance of the masks is."""

    id: str  # of the object; of a real neighbouring cluster's fruit, that of its body
    kind: Kind  # of the surface
    share: float  # pixels that are seen over those of the whole outline; fruits only, else nan


@dataclass(frozen=True, eq=False)
class Photograph:
    """A picture with its truth.

    Attributes:
        picture: colour, depth as measured, camera.
        true_depth: (height, width) [m].
        masks: (height, width) instance + 1 of each pixel; 0: nothing.
        marked: what each instance is.
        scene: the true scene.
        fruits: targets and pushables of the scene, and the fruits of its neighbouring clusters.
    """

    picture: DepthPicture
    true_depth: FloatArray
    masks: NDArray[np.uint8]
    marked: tuple[Marked, ...]
    scene: Scene
    fruits: Mapping[str, SceneObject]

    def mask(self, name: str, *kinds: Kind) -> NDArray[np.bool_]:
        """The pixels (height, width) of an object's surfaces of these kinds."""
        rows = [k + 1 for k, m in enumerate(self.marked) if m.id == name and m.kind in kinds]
        return np.isin(self.masks, rows)

    @property
    def keys(self) -> dict[str, FloatArray]:
        """Of each fruit on a stem before the camera, pixels (3, 2) of its tip, of its end at the
        stem, and of its stem's root."""
        camera, out = self.picture.camera, {}
        for name, item in self.fruits.items():
            if item.stem is None:
                continue
            begin, root = np.asarray(item.stem.points)[[0, -1]]
            corners = _corners(item)
            up = begin - item.position if np.ptp(begin - item.position) > 1e-6 else root - begin
            up = up / np.linalg.norm(up)
            low, high = (edge(corners @ up) - item.position @ up for edge in (np.min, np.max))
            points = [item.position + low * up, item.position + high * up, root]
            local = camera.pose.inverse() @ np.array(points)
            if (local[:, 2] > 1e-3).all():
                out[name] = camera.pixels(local)
        return out


def photograph(
    scene: Scene, mount: str = "beside", seed: int = 0,
    parameters: PhotoParameters | None = None, stereo: StereoParameters | None = None,
    looks: Looks = "plain",
) -> Photograph:  # fmt: skip
    """Take a picture of a scene, its arm at the start.

    Objects to avoid are shown as the fruits of a real neighbouring cluster.

    Args:
        scene: with its robot.
        mount: of the camera: ``beside``, ``palm`` or ``hand``, as for closed loops.
        seed: of light, colours, background, depth errors and a standing camera's place.
        parameters: of the camera and the looks.
        stereo: of the errors of depth.
        looks: ``rich`` has leaves, bowed stems, painted surfaces, shadows and a lens.

    Raises:
        InvalidRequestError: an unknown mount; MuJoCo is not installed, or cannot draw.
    """
    if mount not in MOUNTS:
        raise InvalidRequestError(f"mount is {mount!r}; valid are {', '.join(MOUNTS)}")
    p, rng = parameters or PhotoParameters(), np.random.default_rng([seed, 35])
    robot, state = posed(scene)
    physics = SimulationParameters()
    physics = replace(
        physics,
        thing=replace(physics.thing, avoid_as="fruits"),
    )
    if looks == "plain":
        physics = replace(physics, stem=replace(physics.stem, bow_least=0.0, bow_most=0.0))
    world = build(scene, robot, physics, seed)
    detector = DetectorParameters(mount=mount)  # type: ignore[arg-type]
    if mount == "beside":
        pose = upright(standing_pose(scene, detector), scene.up)
        pose = Pose(pose.position + p.jitter * rng.standard_normal(3), pose.orientation)
    else:
        pose = tool_frame(robot, state.q) @ hand_pose(robot, detector)
    middle = 0.5 * (p.width - 1), 0.5 * (p.height - 1)
    camera = CameraModel(p.width, p.height, p.focal, p.focal, *middle, pose)
    world.spec.worldbody.add_camera(
        name=EYE, pos=pose.position, quat=to_quaternion(pose.rotation * [1.0, -1.0, -1.0]),
        fovy=2.0 * math.degrees(math.atan(0.5 * p.height / p.focal)),
    )  # fmt: skip
    other = np.random.default_rng([seed, 36])

    def rich(spec: Any) -> None:
        leafy(spec, scene, pose, LeafParameters(), other)
        furnished(spec, scene, pose, other)

    model = dressed(world, rich if looks == "rich" else None)
    model.vis.quality.offsamples = 0
    painted(model, p, rng, looks)
    rgb, depth, seen = _drawn(model, world, state.q, camera)
    if looks == "rich":
        rgb = _lensed(rgb, p, other)
    rgb = exposed(rgb, p, rng)
    fruits = _fruits(world)
    masks, marked = _masks(model, seen, fruits, camera, scene)
    measured = sensed(depth, p.focal, stereo or StereoParameters(), rng)
    picture = DepthPicture(rgb, measured, camera)
    return Photograph(picture, depth, masks, marked, world.scene, fruits)


def upright(pose: Pose, up: FloatArray) -> Pose:
    """The same place and gaze, rolled so that the vertical is upright in the picture."""
    z = pose.rotation[:, 2]
    x = np.cross(z, up)
    if np.linalg.norm(x) < 1e-3:
        return pose
    x /= np.linalg.norm(x)
    return Pose(pose.position, np.column_stack([x, np.cross(z, x), z]))


def _drawn(
    model: Any, world: World, q: FloatArray, camera: CameraModel
) -> tuple[Image8, FloatArray, NDArray[np.int32]]:
    """Colours, depths [m] and geoms (-1: none) of all pixels."""
    mujoco = engine()
    data = mujoco.MjData(model)
    data.qpos[: world.robot.n_segments] = world.drives.segments(q)
    mujoco.mj_kinematics(model, data)
    mujoco.mj_camlight(model, data)
    with canvas(model, camera.width, camera.height) as renderer:
        renderer.update_scene(data, EYE)
        rgb = renderer.render().copy()
        renderer.enable_depth_rendering()
        depth = renderer.render().astype(np.float64)
        renderer.disable_depth_rendering()
        renderer.enable_segmentation_rendering()
        segments = renderer.render().copy()
    geom = segments[:, :, 1] == int(mujoco.mjtObj.mjOBJ_GEOM)
    return rgb, depth, np.where(geom, segments[:, :, 0], -1)


def painted(
    model: Any, p: PhotoParameters, rng: np.random.Generator, looks: Looks = "plain"
) -> None:
    """Vary light and colours of a model, and the background of plain looks."""
    tint = 1.0 + p.tint * rng.standard_normal(3)
    ambient, sun = rng.uniform(*p.ambient), rng.uniform(*p.sun)
    model.vis.headlight.ambient[:] = np.clip(ambient * tint, 0.0, 1.0)
    model.vis.headlight.diffuse[:] = rng.uniform(0.1, 0.4)  # a choice
    model.light_diffuse[0] = np.clip(sun * tint, 0.0, 1.0)
    way = rng.standard_normal(3)
    way[2] = -abs(way[2]) - 0.3  # from above: a choice
    model.light_dir[0] = way / np.linalg.norm(way)
    model.mat_rgba[:, :3] = _varied(model.mat_rgba[:, :3], p, rng)
    bare = model.geom_matid < 0  # a geom's own colour covers that of its material
    model.geom_rgba[bare, :3] = _varied(model.geom_rgba[bare, :3], p, rng)
    if looks == "rich":
        first: dict[str, int] = {}  # geom of each stem and petiole, whose pieces have one colour
        for geom in np.flatnonzero(bare).tolist():
            own, body = model.geom(geom).name, model.body(model.geom_bodyid[geom]).name
            piece = own if own.startswith(LEAF) else body
            if piece.startswith((LEAF, "stem:")):
                alike = first.setdefault(piece.rpartition(":")[0], geom)
                model.geom_rgba[geom, :3] = model.geom_rgba[alike, :3]
        model.light_castshadow[0] = 1
        model.vis.quality.shadowsize = SHADOW
        return
    sky = model.tex_data.reshape(-1, int(model.tex_width[0]), 3)
    rough = gaussian_filter(rng.standard_normal(sky.shape[:2]), 3.0)  # [texel] a choice
    one, other = rng.uniform(0.1, 0.9, (2, 3))  # two colours of the background
    share = 1.0 / (1.0 + np.exp(-2.0 * rough / rough.std()))[:, :, None]
    sky[:] = (255.0 * (share * one + (1.0 - share) * other)).astype(np.uint8)


def _varied(colours: FloatArray, p: PhotoParameters, rng: np.random.Generator) -> FloatArray:
    """Colours (N, 3), 0 to 1, each turned about the grey axis and scaled."""
    turn = np.deg2rad(p.hue) * rng.standard_normal(len(colours))
    grey = colours.mean(axis=1, keepdims=True)
    off = colours - grey
    axis = np.full(3, 1.0 / math.sqrt(3.0))
    off = np.cos(turn)[:, None] * off + np.sin(turn)[:, None] * np.cross(axis, off)
    dyed, bright = 1.0 + p.paint * rng.standard_normal((2, len(colours), 1))
    return np.asarray(np.clip((grey + dyed * off) * bright, 0.0, 1.0))


def _lensed(rgb: Image8, p: PhotoParameters, rng: np.random.Generator) -> Image8:
    """The picture through a lens: a little out of focus, darker in its corners, any exposure."""
    size = rgb.shape[:2]
    row, column = (np.linspace(-1.0, 1.0, n) for n in size)
    dark = 1.0 - rng.uniform(0.0, p.corners) * 0.5 * (row[:, None] ** 2 + column[None] ** 2)
    metered = 255.0 * p.metered / max(float(rgb.mean()), 1.0)
    gain = np.clip(metered, 0.8, 2.0) * np.exp(
        p.exposure * rng.standard_normal() + p.tint * rng.standard_normal(3)
    )
    focus = rng.uniform(0.3, p.blur) * size[1] / 640.0  # [pixel]
    soft = gaussian_filter(rgb.astype(np.float32), (focus, focus, 0.0), truncate=3.0)
    return np.asarray(np.clip(soft * dark[:, :, None] * gain, 0.0, 255.0), dtype=np.uint8)


def exposed(rgb: Image8, p: PhotoParameters, rng: np.random.Generator) -> Image8:
    """The picture with the sensor's grain."""
    noisy = rgb + p.grain * rng.standard_normal(rgb.shape)
    return np.asarray(np.clip(np.rint(noisy), 0, 255), dtype=np.uint8)


def _fruits(world: World) -> dict[str, SceneObject]:
    """Fruits by the key of their body."""
    own = {item.id: item for item in world.scene.objects}
    out = {}
    for fruit in world.fruits:
        if fruit.built.shown:
            out[fruit.id] = own[fruit.id]
        else:
            place = np.array(world.model.body_pos[fruit.body])
            ball = Sphere(CLUSTER_FRUIT_RADIUS)
            out[fruit.built.key] = SceneObject(fruit.built.key, "avoid", ball, place)
    return out


def _masks(
    model: Any, seen: NDArray[np.int32], fruits: Mapping[str, SceneObject], camera: CameraModel,
    scene: Scene,
) -> tuple[NDArray[np.uint8], tuple[Marked, ...]]:  # fmt: skip
    masks = np.zeros(seen.shape, dtype=np.uint8)
    rows: dict[tuple[str, Kind], int] = {}
    for geom in np.unique(seen[seen >= 0]).tolist():
        what = _what(model.geom(geom).name, model.body(model.geom_bodyid[geom]).name, fruits)
        row = rows.setdefault(what, min(len(rows), 254))
        masks[seen == geom] = row + 1
    marked = []
    for (name, kind), row in rows.items():
        share = math.nan
        if kind in FRUITS:
            whole = _outline(fruits[name], camera)
            share = min(float((masks == row + 1).sum()) / max(whole, 1.0), 1.0)
        marked.append(Marked(name, kind, share))
    return masks, tuple(marked)


def _what(geom: str, body: str, fruits: Mapping[str, SceneObject]) -> tuple[str, Kind]:
    """Id and kind of a surface."""
    if geom.startswith(LEAF):
        return geom.split(":")[1], "leaf"
    kind, _, key = body.partition(":")
    if kind == "fruit":
        if ":calyx:" in geom:
            return key, "calyx"
        return key, "ripe" if fruits[key].role == "target" else "unripe"
    if kind == "stem":
        return key.rpartition(":")[0], "stem"
    return (key, "static") if kind == "static" else ("", "other")


def _outline(item: SceneObject, camera: CameraModel) -> float:
    """Area [pixel] of a whole fruit's outline in the picture; 0 behind the camera."""
    local = camera.pose.inverse() @ _corners(item)
    if (local[:, 2] < 1e-3).any():
        return 0.0
    return float(ConvexHull(camera.pixels(local)).volume)


def _corners(item: SceneObject) -> FloatArray:
    """Corners (N, 3) of the surface of an object [m]."""
    return np.asarray(item.shape.surface().reshape(-1, 3) @ item.rotation.T + item.position)
