"""The 3-D part of the page: nodes of one robot, its scene and a plan, in one browser window."""

import functools
import textwrap
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from optipromp.core.arrays import BoolArray, FloatArray
from optipromp.core.documents import read_document
from optipromp.core.errors import InvalidRequestError, InvalidSceneError, OptiPrompError
from optipromp.core.files import is_file, is_folder, is_there, read_npz, reading
from optipromp.core.output import OVERLAY, ROWS, load_pick
from optipromp.core.planning import Picked, Plan
from optipromp.core.planning.legs import legs_of
from optipromp.core.planning.task import posed
from optipromp.core.robots.model import Robot
from optipromp.core.scenes.io import load_scene, scene_from_dict, scene_names
from optipromp.core.scenes.scene import Scene
from optipromp.looks.appearance import rgb
from optipromp.looks.viewer.drawn import PRIMITIVE, RED, STILL, Placed, motions
from optipromp.looks.viewer.serving import FLAT, Nodes, tube
from optipromp_eyes.pictures import Image8, read_pixels
from optipromp_page.content import GREEN_AT, RED_AT, Bundle, Clearances, between
from optipromp_sim.simulation import files
from optipromp_sim.simulation.parameters import SimulationParameters

_WIDTH = {"conditioned ProMP": 4.0, "followed path": 3.0, "optimised": 5.0, "way out": 3.0}  # [px]
_CANDIDATE_ROWS = 24  # points of a candidate's line
_LINE_POINTS = 60  # points of a motion's line
_BALL_CORNERS = 10  # corners around a body sphere
_ARROW = {"shaft_radius": 0.0025, "head_radius": 0.006, "head_length": 0.014}  # [m]
_FORCE = 0.02  # [m/N] length of a force's arrow
SIDE = (32, 90, 167)
SPREAD = 0.18  # opacity of a primitive's tube
SURE, UNSURE = (26, 90, 255), (120, 120, 120)  # tracked fruits
_GLASS = 0.45  # opacity of fruits that tracks are drawn in
AHEAD, BACK = ("#0d73f2", "#d91abf", "#009e73", "#7340e6"), "#f28000"  # of the path ahead

PLANNED = (
    "initial bundle", "candidate paths", "trajectories", "passing sides", "pushed objects",
    "conditioned on",
)  # fmt: skip
LAYERS = (*PLANNED, "body spheres")


class PlanNodes(Nodes):
    """A robot, its scene and its plan in one window; nothing is shared between windows."""

    def __init__(self, api: Any, root: str = "a", offset: Sequence[float] = (0.0, 0.0, 0.0)):
        super().__init__(api, root, offset)
        self.near: Clearances | None = None
        self._shown: dict[str, Any] = {}
        self._hidden = {"body spheres"}
        self._muted = False

    def clear(self) -> None:
        """Remove every node."""
        super().clear()
        self._shown, self.near = {}, None

    def _mount(self, robot: Robot) -> None:
        super()._mount(robot)
        if "body spheres" in self._shown:
            self._shown.pop("body spheres").remove()

    def pose(self, q: FloatArray) -> None:
        """Move the arm, and its body spheres where they are shown, to ``q`` (n,)."""
        super().pose(q)
        if self.robot is not None and "body spheres" not in self._hidden:
            self._balls().batched_positions = self.robot.sphere_centers(q).astype(np.float32)

    def place(self, items: Iterable[Placed]) -> None:
        """Move objects to their places of a moment."""
        for item in items:
            self.put(item.item, item.position, item.rotation, item.stem)

    # -- what belongs to a plan -----------------------------------------------------------------

    def layer(self, name: str, shown: bool) -> None:
        """Show or hide a layer of :data:`LAYERS`."""
        (self._hidden.discard if shown else self._hidden.add)(name)
        if name == "body spheres" and shown and self.robot is not None:
            self._balls()
        self._refresh()

    def mute(self, muted: bool) -> None:
        """Hide all layers of a plan, or show those that are on again."""
        self._muted = muted
        self._refresh()

    def visible(self, name: str) -> bool:
        """Whether a layer is shown."""
        return name not in self._hidden and not (self._muted and name in PLANNED)

    def _refresh(self) -> None:
        for key, node in self._shown.items():
            node.visible = self.visible(key.partition("|")[0])

    def _add(self, key: str, make: Callable[..., Any], *args: Any, **options: Any) -> None:
        name, visible = f"{self.root}/{key.replace('|', '/')}", self.visible(key.partition("|")[0])
        self._shown[key] = make(name, *args, visible=visible, **options)

    def drop(self, layer: str) -> None:
        """Remove the nodes of a layer."""
        for key in [key for key in self._shown if key.partition("|")[0] == layer]:
            self._shown.pop(key).remove()

    def trajectories(self, made: Plan | Picked) -> None:
        """Show the tool path of each trajectory of the plan, and that of the way out."""
        self.drop("trajectories")
        plan = legs_of(made)["reach"]
        for motion in motions(made):
            name, q = motion.name, motion.trajectory.positions
            rows = np.unique(np.linspace(0, len(q) - 1, _LINE_POINTS).round().astype(int))
            points = plan.robot.tool_pose(q[rows])[0]
            self._add(f"trajectories|{name}", self.line, points, motion.colour, _WIDTH[name])

    def bundle(self, found: Bundle | None, layer: str = "initial bundle") -> None:
        """Show a primitive's tube of two standard deviations, and its samples."""
        self.drop(layer)
        if found is None:
            return
        corners, faces = tube(found.mean, found.radius)
        self._add(f"{layer}|tube", self.api.add_mesh_simple, corners, faces, color=rgb(PRIMITIVE),
                  opacity=SPREAD, side="double", **FLAT)  # fmt: skip
        samples = np.stack([found.samples[:, :-1], found.samples[:, 1:]], axis=2)
        self._add(f"{layer}|samples", self.api.add_line_segments,
                  samples.reshape(-1, 2, 3).astype(np.float32), rgb(PRIMITIVE), thickness=1.0,
                  thickness_units="screen")  # fmt: skip

    def candidates(self, found: Sequence[tuple[FloatArray, float]], threshold: float) -> None:
        """Show candidate tool paths; red where the predicted harm is above the threshold."""
        self.drop("candidate paths")
        if not found:
            return
        lines, colours = [], []
        for points, harm in found:
            rows = np.linspace(0, len(points) - 1, _CANDIDATE_ROWS).round().astype(int)
            lines.append(np.stack([points[rows[:-1]], points[rows[1:]]], axis=1))
            colour = between(np.array(harm), threshold, 0.0)
            colours.append(np.broadcast_to(colour, (len(lines[-1]), 2, 3)))
        self._add("candidate paths|all", self.api.add_line_segments,
                  np.concatenate(lines).astype(np.float32), np.concatenate(colours),
                  thickness=2.0, thickness_units="screen")  # fmt: skip

    def sides(self, found: Sequence[tuple[str, FloatArray, FloatArray]]) -> None:
        """Show an arrow from each pushable to the tool point that passes it."""
        self.drop("passing sides")
        if found:
            points = np.array([[begin, end] for _, begin, end in found], dtype=np.float32)
            self._add("passing sides|all", self.api.add_arrows, points, SIDE, **_ARROW)

    def via(self, points: Sequence[tuple[str, FloatArray, str]]) -> None:
        """Show the tool points that a primitive was conditioned on."""
        self.drop("conditioned on")
        for name, point, colour in points:
            self._add(f"conditioned on|{name}", self.api.add_icosphere, radius=0.006,
                      color=rgb(colour), position=point)  # fmt: skip

    def ghosts(self, items: Iterable[Placed]) -> None:
        """Show labels at the predicted last places of pushed objects."""
        self.drop("pushed objects")
        for item in items:
            if item.shift > STILL:
                self._add(f"pushed objects|{item.item.id}", self.api.add_label, item.label,
                          position=item.position, font_screen_scale=0.8)  # fmt: skip

    def colour(self, row: int) -> None:
        """Colour the body spheres by their clearance in row ``row`` of :attr:`near`."""
        if self.near is not None and "body spheres" not in self._hidden:
            self._balls().batched_colors = between(self.near.nearest[row], RED_AT, GREEN_AT)

    def _balls(self) -> Any:
        assert self.robot is not None
        if "body spheres" not in self._shown:
            ball = _ball()
            radius = np.asarray(self.robot.spheres.radius)
            self._add("body spheres", self.api.add_batched_meshes_simple, ball.vertices,
                      ball.faces, np.tile([1.0, 0.0, 0.0, 0.0], (len(radius), 1)),
                      self.robot.sphere_centers(self.robot.home), batched_scales=radius,
                      batched_colors=np.full((len(radius), 3), 170, np.uint8), opacity=0.45,
                      lod="off", **FLAT)  # fmt: skip
        return self._shown["body spheres"]

    def forces(self, points: FloatArray, forces: FloatArray) -> None:
        """Show contact forces (k, 3) [N] as arrows that end at points (k, 3) [m]."""
        self.drop("forces")
        if len(points):
            arrows = np.stack([points - _FORCE * forces, points], axis=1).astype(np.float32)
            self._add("forces|all", self.api.add_arrows, arrows, rgb(RED), **_ARROW)

    def tracks(self, places: FloatArray, covariance: FloatArray, confirmed: BoolArray) -> None:
        """Show ellipsoids of two standard deviations at places (k, 3) [m] by covariances (k, 3, 3)
        [m²]; those not confirmed are grey."""
        half, turns = files.ellipsoids(covariance)
        self.drop("tracks")
        if len(places):
            turned = Rotation.from_matrix(turns).as_quat(scalar_first=True)
            colours = np.where(confirmed[:, None], SURE, UNSURE).astype(np.uint8)
            ball = _ball()
            self._add("tracks|all", self.api.add_batched_meshes_simple, ball.vertices, ball.faces,
                      turned, places, batched_scales=2.0 * half, batched_colors=colours,
                      opacity=0.75, lod="off", **FLAT)  # fmt: skip

    def glass(self, on: bool) -> None:
        """Let fruits be seen through, so that the ellipsoids inside them are seen; or not."""
        for part, node in self._meshes.values():
            if part.name.startswith(("target:", "pushable:")):
                whole = part.opacity if part.opacity < 1.0 else None
                node.opacity = _GLASS if on else whole

    def ahead(self, points: FloatArray, plan: int, retreat: bool) -> None:
        """Show the path ahead of the tool through points (k, 3) [m], in the colour of its plan."""
        self.drop("path ahead")
        if len(points) > 1:
            colour = BACK if retreat else AHEAD[plan % len(AHEAD)]
            self._add("path ahead", self.line, points, colour, 4.0)

    def say(self, text: str, at: FloatArray | None) -> None:
        """Show a label at a point (3,) of the scene [m]; without text or point, none."""
        self.drop("message")
        if text and at is not None:
            words = "\n".join(textwrap.wrap(text, 36)[:7])
            self._add("message|text", self.api.add_label, words, position=at, anchor="bottom-right")


def _ball() -> Any:
    """A mesh of a ball of radius 1."""
    import trimesh

    return trimesh.creation.uv_sphere(count=[_BALL_CORNERS, _BALL_CORNERS])


# choices for the eye
UPWARDS = 0.7  # cosine to the vertical of an approach above which the camera is beyond the target
NEAREST = 0.30  # [m] from the camera to the nearest thing framed, at least
TOOL = 0.07  # [m] radius of the ball around the tool point that is framed
CAMERA_LOWEST = 0.15  # [m] height of the camera over the base, at least
MARGIN = 0.10  # share of half the picture that is kept free at each edge
RAISED, RAISES = 0.15, 12  # step by which a camera too low is turned up, and most steps
PANEL = 400  # [pixel] of the width that the controls hide at the right
NARROW = 576  # [pixel] width of a screen up to which they are below: viser's 36 em
SHEET = 0.50  # share of the height that they hide then, see :mod:`optipromp_page.panel`


def look(
    camera: Any, scene: Scene, tool: FloatArray | None = None, beside: FloatArray | None = None
) -> None:
    """Frame target, pushables, tool: from beyond the target, or from the robot's side of a shelf. A
    scene without target and pushables is framed whole. ``tool``: (3,) tool point in the base frame
    [m]. ``beside``: (3,) offset of the same scene, where it is shown a second time [m]."""
    centres, radii = balls(scene, tool)
    if beside is not None:
        centres, radii = np.concatenate([centres, centres + beside]), np.tile(radii, 2)
    edges = free(camera.image_width, camera.image_height, camera.fov)
    away = direction(scene)
    for _ in range(RAISES):
        place, focus = framed(centres, radii, away, scene.up, edges)
        if place @ scene.up >= CAMERA_LOWEST:
            break
        away = away + RAISED * scene.up
        away = away / np.linalg.norm(away)
    camera.up_direction = (0.0, 0.0, 1.0)
    camera.position = scene.base @ place
    camera.look_at = scene.base @ focus


AIMS = 20  # of a view that does not arrive in a page, at most: a choice
ARRIVED = 1e-3  # [m] of a view from where it was placed: a choice


class View:
    """A window's ``camera``, and what it frames; what it causes is posted by ``post``."""

    def __init__(self, camera: Any, post: Callable[[str, Callable[[], None]], None]) -> None:
        self.camera, self.post = camera, post
        self._aimed: tuple[Any, ...] | None = None  # what is framed, for which size, from where
        self._arrived, self._aims = False, AIMS
        camera.on_update(self._reported)

    def look(self, *what: Any) -> None:
        """See :func:`look`."""
        size = self.camera.image_width, self.camera.image_height
        look(self.camera, *what)
        self._aimed = what, size, np.array(self.camera.position)

    def _reported(self, camera: Any) -> None:
        """Frame the scene again: the page has another size, and its user did not turn the view; or
        the view did not arrive, which a page that opens may not hear."""
        if self._aimed is None:
            return
        what, size, place = self._aimed
        there = np.abs(camera.position - place).max() < ARRIVED
        self._arrived |= there
        other = (camera.image_width, camera.image_height) != size
        if other if there else not self._arrived and self._aims > 0:
            self._aims -= not there
            self.post("look", lambda: self.look(*what))


def balls(scene: Scene, tool: FloatArray | None = None) -> tuple[FloatArray, FloatArray]:
    """Centres (k, 3) and radii (k,) [m] framed: target, pushables, nodes of a truss, tool."""
    items = [item for item in scene.objects if item.role in ("target", "pushable")]
    items = items or [item for item in scene.objects if np.isfinite(item.radius)]
    found = [(item.position, float(item.radius)) for item in items]
    stems = [item.stem for item in items if item.stem is not None]
    found += [(stem.root, stem.radius) for stem in stems if stem.parent is not None]
    if tool is not None:
        found.append((np.asarray(tool), TOOL))
    found = found or [(np.zeros(3), 0.5)]  # [m] an empty scene: around the base
    return np.array([centre for centre, _ in found]), np.array([radius for _, radius in found])


def direction(scene: Scene) -> FloatArray:
    """The unit vector (3,) from the cluster to the camera, in the base frame."""
    up, (_, y, z) = scene.up, scene.frame
    middle = balls(scene)[0].mean(axis=0) if scene.target is None else scene.target.position
    out = middle - (middle @ up) * up
    out = out / max(float(np.linalg.norm(out)), 1e-6)
    steep = z @ up > UPWARDS
    away = 0.8 * out + 0.5 * y - 0.12 * up if steep else -0.7 * z + 0.5 * y + 0.6 * up
    return np.asarray(away / np.linalg.norm(away))


def free(width: int, height: int, fov: float) -> FloatArray:
    """Edges (2, 2) of the free part of a picture [pixel], right and up: tangents of angles to the
    axis. ``fov``: angle of the whole height [rad]."""
    low, high = np.array([-1.0, -1.0]), np.array([1.0, 1.0])
    if width <= NARROW:
        low[1] += 2.0 * SHEET
    else:
        high[0] -= 2.0 * PANEL / width
    half = np.tan(0.5 * fov) * np.array([width / height, 1.0])
    return np.asarray(np.stack([low + MARGIN, high - MARGIN], axis=1) * half[:, None])


def framed(
    centres: FloatArray, radii: FloatArray, away: FloatArray, up: FloatArray, edges: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Position (3,) of the camera, and its focus (3,) on its axis, that frame balls. A ball is in
    the picture if its centre is at least its radius from the four planes through the camera and the
    edges. These conditions are linear in the camera's position, so the nearest position along
    ``away`` is exact. ``away``, ``up``: (3,) unit vectors from the balls to the camera, and upright
    in the picture."""
    forward = -away
    right = np.cross(forward, up)
    right = right / np.linalg.norm(right)
    axes = np.stack([right, np.cross(right, forward)])
    along, depth = centres @ axes.T, centres @ forward
    slant = np.sqrt(1.0 + edges**2)
    most = (along - edges[:, 0] * depth[:, None] - slant[:, 0] * radii[:, None]).min(axis=0)
    least = (along - edges[:, 1] * depth[:, None] + slant[:, 1] * radii[:, None]).max(axis=0)
    near = float((depth - radii).min()) - NEAREST
    at = min(float(((most - least) / (edges[:, 1] - edges[:, 0])).min()), near)
    aside = 0.5 * (most + edges[:, 0] * at + least + edges[:, 1] * at)
    place = aside @ axes + at * forward
    return np.asarray(place), np.asarray(place + (float(depth.mean()) - at) * forward)


ROLLOUTS_APART = 1.3  # [m] between two rollouts side by side
LEAST_FORCE = 0.02  # [N] a contact with less force is not drawn


@dataclass(frozen=True, eq=False)
class Replay:
    """An executed plan."""

    name: str  # shown to the user
    scene: Scene
    robot: Robot
    seed: int  # of the world
    arrays: dict[str, Any]  # of :meth:`optipromp_sim.simulation.records.Rollout.arrays`
    success: bool  # whether the target alone was picked and nothing was harmed
    message: str  # of the outcome
    parameters: SimulationParameters  # of the physics
    record: files.LoopRecord | None = None  # of the controller; None: executed without looking

    @property
    def duration(self) -> float:
        """Time of the last record [s]."""
        return float(self.arrays["times"][-1])

    @functools.cached_property
    def _moving(self) -> Any:
        from optipromp_sim.simulation.execute import Moving
        from optipromp_sim.simulation.world import build

        return Moving(build(self.scene, self.robot, self.parameters, self.seed))

    def show(self, stage: PlanNodes, now: float) -> str:
        """Show arm, objects, contacts and what the controller thinks at the time ``now`` [s].

        Returns: Forces and stage in words.
        """
        arrays = self.arrays
        row = int(np.abs(arrays["times"] - now).argmin())
        stage.pose(arrays["q"][row])
        for moved in self._moving.at(arrays["states"][row]):
            stage.put(*moved)
        found = arrays["contacts"][arrays["contacts"][:, 0] == row]
        felt = found[np.linalg.norm(found[:, 6:], axis=1) > LEAST_FORCE]
        stage.forces(felt[:, 3:6], felt[:, 6:])
        told = [self._words(felt)]
        if self.record is not None:
            told = [self._thought(stage, self.record, now), *told]
        return "  \n".join(filter(None, told))

    def _thought(self, stage: PlanNodes, record: files.LoopRecord, now: float) -> str:
        """Show tracks and path ahead; returns the stage, and why it began, in words."""
        row = record.row(now)
        stage.tracks(*record.tracks(row))
        stage.ahead(record.path(row), int(record.plans[row]), record.stages[row] == "leave")
        why = record.why(now)
        return f"**{record.words(row)}**" + (f": {why}" if why else "")

    def _words(self, felt: FloatArray) -> str:
        names = [entity.label for entity in self._moving.world.entities]
        pairs: dict[str, FloatArray] = {}
        for row in felt:
            key = f"{names[int(row[1])]} on {names[int(row[2])]}"
            pairs[key] = pairs.get(key, np.zeros(3)) + row[6:]
        return "  \n".join(f"{key}: {np.linalg.norm(force):.2f} N" for key, force in pairs.items())


def load_replay(folder: Path) -> Replay:
    """The replay of what ``optipromp simulate`` left in a folder. Raises errors as a scene does."""
    outcome = read_document(folder / "outcome.json", InvalidRequestError, "an outcome")
    arrays: dict[str, Any] = dict(read_npz(folder / "rollout.npz"))
    with reading(folder, "not a rollout that this version wrote", passes=(InvalidSceneError,)):
        scene = scene_from_dict(outcome["scene_file"], base_dir=folder, source=str(folder))
        robot = posed(scene)[0]
        if arrays["contacts"].shape[1] != 9 or arrays["q"].shape[1] != robot.n_joints:
            raise InvalidRequestError(f"{folder}: its arrays do not fit its scene")
        record = files.read_loop(folder / files.NAME) if is_file(folder / files.NAME) else None
        if record is not None and not record.belongs(arrays):  # of an earlier run
            record = None
        return Replay(folder.name, scene, robot, int(outcome["seed"]), arrays,
                      bool(outcome["success"]), str(outcome["message"]),
                      files.read_parameters(outcome), record)  # fmt: skip


def execute(plan: Plan | Picked, name: str) -> Replay:
    """Execute a plan or a pick in the simulation."""
    from optipromp_sim.simulation import simulate

    run = simulate(plan, seed=legs_of(plan)["reach"].seed)
    arrays = {key: np.asarray(value) for key, value in run.rollout.arrays().items()}
    return Replay(name, run.scene, run.robot, run.seed, arrays, run.success, run.outcome.message,
                  run.parameters)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Source:
    """A scene, its plan, executed plans of it, and the picture in which it was seen, if any."""

    scene: Scene
    plan: Plan | Picked | None = None
    replays: tuple[Replay, ...] = ()
    seen: Image8 | None = None
    reach: bool = False  # whether the reach alone is planned


def open_source(item: str, beside: str | None = None) -> Source:
    """The source in a scene file, a built-in scene, or a folder of a plan or a rollout; and a
    second folder of a rollout, which is replayed ``beside`` the first. Raises errors of OptI-ProMP
    where it is none of these, or cannot be read."""
    folder = Path(item)
    replays = tuple(
        load_replay(Path(name))
        for name in (item, beside)
        if name is not None and is_there(Path(name) / "rollout.npz")
    )
    if beside is not None and len(replays) < 2:
        raise InvalidRequestError(f"{item} and {beside} are not both folders of a rollout")
    if is_folder(folder) and item not in scene_names():
        if is_there(folder / ROWS):
            raise InvalidRequestError(
                f"{item} is a study: 'optipromp report {item}' writes a page about it"
            )
        if is_there(folder / "plan.json"):
            plan = load_pick(folder)
            return Source(legs_of(plan)["reach"].scene, plan, replays, _seen(folder / "seen"))
        if replays:
            return Source(replays[0].scene, None, replays)
        raise InvalidRequestError(
            f"{item} holds neither a plan (plan.json) nor a rollout (rollout.npz)"
        )
    if folder.name == "plan.json":
        return open_source(str(folder.parent), beside)
    return Source(load_scene(item), seen=_seen(folder))


def _seen(scene: Path) -> Image8 | None:
    """The picture that ``see`` left beside a scene; None: there is none that can be read."""
    picture = scene.with_suffix(OVERLAY)
    if is_file(picture):
        with suppress(OptiPrompError):
            return read_pixels(picture, "RGB").astype("uint8")
    return None
