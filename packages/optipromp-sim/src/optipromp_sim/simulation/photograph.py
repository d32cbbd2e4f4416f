"""Pictures of scenes with truth: colour, depth as a stereo camera measures it, instance masks."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, maximum_filter, minimum_filter
from scipy.spatial import ConvexHull

from optipromp.core.arrays import BoolArray, FloatArray
from optipromp.core.geometry.shapes import Sphere
from optipromp.core.parameters import Checked, parameter
from optipromp.core.planning.task import posed
from optipromp.core.robots.model import Robot
from optipromp.core.scenes.hand import tool_frame
from optipromp.core.scenes.pose import Pose
from optipromp.core.scenes.scene import Scene, SceneObject
from optipromp_eyes.pictures import CameraModel, DepthPicture, Image8
from optipromp_sim.simulation.detector_parameters import DetectorParameters
from optipromp_sim.simulation.parameters import SimulationParameters
from optipromp_sim.simulation.sight import hand_pose, standing_pose
from optipromp_sim.simulation.simulation import Simulation
from optipromp_sim.simulation.studio import EYE, LEAF, Studio, furnished, leafy, noise
from optipromp_sim.simulation.world import CLUSTER_FRUIT_RADIUS, World, build

Kind = Literal["ripe", "unripe", "calyx", "stem", "leaf", "static", "other"]
Looks = Literal["plain", "rich"]
SHADOW = 1024  # [texel] side of the map of shadows
FRUITS: tuple[Kind, ...] = ("ripe", "unripe")


@dataclass(frozen=True)
class PhotoParameters(Checked):
    """The camera, and how light, colours and background vary from picture to picture."""

    width: int = parameter(640, "pixel", "choice", "of a picture")
    height: int = parameter(480, "pixel", "choice", "of a picture")
    focal: float = parameter(480.0, "pixel", "choice", "67° across; RGB-D cameras see 42-87°")
    jitter: float = parameter(0.03, "m", "choice", "deviation of a camera's place, each axis")
    ambient: tuple[float, float] = parameter((0.20, 0.50), "1", "choice", "light from everywhere")
    sun: tuple[float, float] = parameter((0.2, 0.8), "1", "choice", "light from one side")
    tint: float = parameter(0.06, "1", "choice", "standard deviation of the light's colour")
    hue: float = parameter(6.0, "deg", "choice", "standard deviation of the hue of each surface")
    paint: float = parameter(0.10, "1", "choice", "deviation of a surface's saturation and value")
    metered: float = parameter(0.32, "1", "choice", "rich looks: mean colour of the exposure")
    exposure: float = parameter(0.18, "1", "choice", "rich looks: deviation of log brightness")
    corners: float = parameter(0.3, "1", "choice", "rich looks: most light that corners lack")
    blur: float = parameter(0.9, "pixel", "choice", "rich looks: of a point's image, at 640 pixels")
    grain: float = parameter(2.5, "1", "guess", "deviation of each pixel's colours, of 255")

    @property
    def lens(self) -> CameraModel:
        """The camera, whose pose is not known yet."""
        middle = 0.5 * (self.width - 1), 0.5 * (self.height - 1)
        return CameraModel(self.width, self.height, self.focal, self.focal, *middle)


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
    parameters: PhotoParameters | None = None, looks: Looks = "plain",
) -> Photograph:  # fmt: skip
    """Take a picture of a scene, its arm at the start.

    Objects to avoid are shown as the fruits of a real neighbouring cluster.

    Args:
        scene: with its robot.
        mount: of the camera: ``beside``, ``palm`` or ``hand``, as for closed loops.
        seed: of light, colours, background, depth errors and a standing camera's place.
        parameters: of the camera and the looks.
        looks: ``rich`` has leaves, bowed stems, painted surfaces, shadows and a lens.

    Raises:
        InvalidRequestError: an unknown mount; MuJoCo is not installed, or cannot draw.
    """
    p, rng = parameters or PhotoParameters(), np.random.default_rng([seed, 35])
    robot, state = posed(scene)
    physics = SimulationParameters().changed(thing={"avoid_as": "fruits"})
    if looks == "plain":
        physics = physics.changed(stem={"bow_least": 0.0, "bow_most": 0.0})
    pose = _mounted(mount, scene, robot)
    world = build(scene, robot, physics, seed)
    if mount == "beside":
        pose = Pose(pose.position + p.jitter * rng.standard_normal(3), pose.orientation)
    else:
        pose = tool_frame(robot, state.q) @ pose
    camera = replace(p.lens, pose=pose)
    other = np.random.default_rng([seed, 36])

    def rich(spec: Any) -> None:
        leafy(spec, scene, pose, other)
        furnished(spec, scene, pose, other)

    with Studio(world, lens=camera, more=rich if looks == "rich" else None, props=True) as studio:
        model = studio.model
        painted(model, p, rng, looks)
        studio.stand(world.drives.segments(state.q))
        rgb, depth = _taken(studio, camera)
        seen = studio.geoms(p.width, p.height)
    if looks == "rich":
        rgb = _lensed(rgb, p, other)
    rgb = _exposed(rgb, p, rng)
    fruits = _fruits(world)
    masks, marked = _masks(model, seen, fruits, camera)
    picture = DepthPicture(rgb, sensed(depth, p.focal, StereoParameters(), rng), camera)
    return Photograph(picture, depth, masks, marked, world.scene, fruits)


class LiveCamera(Studio):
    """Photographs a simulation as it runs; fruits hang where they hang now.

    Args:
        simulation: whose world is shown. Objects to avoid are as its parameters say.
        mount: of the camera: ``beside``, ``palm`` or ``hand``, as for closed loops.
        seed: of light, colours and background, which last, and of each picture's errors of depth.
        parameters: of the camera and the looks; a standing camera has no ``jitter``.

    Raises:
        InvalidRequestError: an unknown mount, or MuJoCo cannot draw.
    """

    def __init__(
        self, simulation: Simulation, mount: str = "beside", seed: int = 0,
        parameters: PhotoParameters | None = None,
    ) -> None:  # fmt: skip
        p = self._parameters = parameters or PhotoParameters()
        self._simulation, self._on_tool = simulation, mount != "beside"
        self._rng = np.random.default_rng([seed, 35])
        self._pose = _mounted(mount, simulation.scene, simulation.robot)
        super().__init__(simulation.world, lens=p.lens, props=True)
        painted(self.model, p, self._rng)
        self.renderer(p.width, p.height)

    @property
    def camera(self) -> CameraModel:
        """The camera where it is now."""
        pose = self._pose
        if self._on_tool:
            pose = tool_frame(self._simulation.robot, self._simulation.state().q) @ pose
        return replace(self._parameters.lens, pose=pose)

    def take(self) -> DepthPicture:
        """A picture of what is there now."""
        camera, p = self.camera, self._parameters
        self.stand(self._simulation.data.qpos)
        rgb, depth = _taken(self, camera)
        rgb = _exposed(rgb, p, self._rng)
        return DepthPicture(rgb, sensed(depth, p.focal, StereoParameters(), self._rng), camera)


def _mounted(mount: str, scene: Scene, robot: Robot) -> Pose:
    """The pose of a camera by its mount: in the base frame, or in the tool axes on the hand."""
    detector = DetectorParameters(mount=mount)  # type: ignore[arg-type]
    if mount == "beside":
        return upright(standing_pose(scene, detector), scene.up)
    return hand_pose(robot, detector)


def _taken(studio: Studio, camera: CameraModel) -> tuple[Image8, FloatArray]:
    """Colours and true depths [m] of what is in the studio, by a camera in the base frame."""
    studio.aim(camera.pose)
    rgb = studio.colours(EYE, camera.width, camera.height)
    return rgb, studio.depths(camera.width, camera.height)


def upright(pose: Pose, up: FloatArray) -> Pose:
    """The same place and gaze, rolled so that the vertical is upright in the picture."""
    z = pose.rotation[:, 2]
    x = np.cross(z, up)
    if np.linalg.norm(x) < 1e-3:
        return pose
    x /= np.linalg.norm(x)
    return Pose(pose.position, np.column_stack([x, np.cross(z, x), z]))


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


def _exposed(rgb: Image8, p: PhotoParameters, rng: np.random.Generator) -> Image8:
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
    model: Any, seen: NDArray[np.int32], fruits: Mapping[str, SceneObject], camera: CameraModel
) -> tuple[NDArray[np.uint8], tuple[Marked, ...]]:
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


@dataclass(frozen=True)
class StereoParameters(Checked):
    """Errors of a stereo camera of short range on a hand."""

    baseline: float = parameter(0.018, "m", "published", "imagers of a RealSense D405 (sheet)")
    subpixel: float = parameter(0.08, "pixel", "published", "of the disparity; tuned (Intel)")
    window: float = parameter(1.5, "pixel", "guess", "deviation of the noise's filter")
    scale: float = parameter(0.005, "1", "guess", "of depth; sheet of the D405: < 0.02 at 0.5 m")
    ragged: float = parameter(1.0, "pixel", "guess", "deviation of an edge's place, each axis")
    step: float = parameter(0.015, "m", "choice", "least step of depth that is an edge")
    edge_holes: float = parameter(0.3, "1", "guess", "share of pixels at edges without a depth")
    holes: float = parameter(0.01, "1", "guess", "of all pixels: gloss and no texture")
    hole_size: float = parameter(3.0, "pixel", "guess", "correlation length of these holes")
    nearest: float = parameter(0.07, "m", "published", "least depth of a D405 (data sheet)")
    farthest: float = parameter(1.5, "m", "choice", "largest depth that is kept")


def sensed(
    depth: FloatArray, focal: float, parameters: StereoParameters, rng: np.random.Generator
) -> FloatArray:
    r"""Depth (height, width) [m] as measured from the true one; 0 where nothing is measured.

    The disparity is :math:`d = f b / z`. Its error :math:`\sigma_d` is an error
    :math:`\sigma_z = z^2 \sigma_d / (f b)` of depth. A pixel that the second imager does not see is
    a hole.

    ``depth``: true depth along the optical axis [m]. ``focal``: length [pixel].
    """
    p, size = parameters, depth.shape
    rows, columns = np.indices(size)
    ragged = [p.ragged * noise(size, p.window, rng) for _ in range(2)]
    low = np.clip(np.rint(rows + ragged[0]).astype(int), 0, size[0] - 1)
    right = np.clip(np.rint(columns + ragged[1]).astype(int), 0, size[1] - 1)
    moved = depth[low, right]
    disparity = focal * p.baseline / np.maximum(moved, 1e-3)
    holes = _unseen(disparity)
    disparity = disparity + p.subpixel * noise(size, p.window, rng)
    measured = focal * p.baseline / np.maximum(disparity, 1e-3)
    measured *= 1.0 + p.scale * rng.standard_normal()
    steps = maximum_filter(moved, 3) - minimum_filter(moved, 3) > p.step
    holes |= steps & (rng.random(size) < p.edge_holes)
    blobs = noise(size, p.hole_size, rng)
    holes |= blobs > np.quantile(blobs, 1.0 - p.holes)
    holes |= (measured < p.nearest) | (measured > p.farthest)
    return np.where(holes, 0.0, measured)


def _unseen(disparity: FloatArray) -> BoolArray:
    """Whether (height, width) a nearer surface hides a pixel from the imager to the right."""
    there = np.arange(disparity.shape[1]) - disparity
    least = np.minimum.accumulate(there[:, ::-1], axis=1)[:, ::-1]
    beyond = np.full_like(there, np.inf)
    beyond[:, :-1] = least[:, 1:]
    return np.asarray(beyond <= there - 1.0)
