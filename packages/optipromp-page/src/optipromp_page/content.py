"""The content of the page about a plan: bundle, candidates, clearances, pushed objects, charts."""

import inspect
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from optipromp.core.arrays import BoolArray, FloatArray, IntArray, lengths
from optipromp.core.budget import Budget, clock
from optipromp.core.errors import OptiPrompError
from optipromp.core.geometry import distances
from optipromp.core.planning import Picked, Plan
from optipromp.core.planning.legs import curve_of, legs_of
from optipromp.core.planning.parameters import FOLLOW
from optipromp.core.planning.primitive import is_learnt, learnt
from optipromp.core.promp.conditioning import condition
from optipromp.core.promp.model import ProMP
from optipromp.core.promp.tasks import JointPoint, TaskPoint
from optipromp.core.pushing.model import Combined, PushModel
from optipromp.core.pushing.searching import search
from optipromp.core.robots.model import Robot
from optipromp.core.robots.tools import TOOLS
from optipromp.core.scenes.objects import rooted
from optipromp.core.scenes.scene import PoseGoal, Role, Scene, SceneObject, ToolSpec, packed
from optipromp.looks.appearance import rgb
from optipromp.looks.viewer.drawn import FOLLOWED, GREEN, OPTIMISED, RED, PushedPlaces, pushed

# choices for the eye
SAMPLES, ROWS = 24, 60  # trajectories of the bundle, waypoints of each
CANDIDATES = 40  # tool paths, at most
SEARCHING = 1.0  # [s] of the repeated search, at most
WIDE = 2.0  # standard deviations within a tube
RED_AT, GREEN_AT = 0.0, 0.05  # [m] clearance
CHART_ROWS = 120  # times of a chart
JOINT_COLOURS = (
    OPTIMISED, "#d1661a", GREEN, RED, "#7d55a8", "#8a5a44", "#c05a9c", "#6f757d",
)  # fmt: skip
ROLE_COLOURS = {
    "static": "#7a5c2e",
    "arm to avoid": GREEN,
    "tool to avoid": OPTIMISED,
    "arm to pushable": FOLLOWED,
}


@dataclass(frozen=True, eq=False)
class Bundle:
    """Tool paths of a movement primitive: mean (T, 3), 2σ radius (T,) and samples (N, T, 3) [m]."""

    mean: FloatArray
    radius: FloatArray
    samples: FloatArray


def bundle(promp: ProMP, robot: Robot, middle: FloatArray | None = None) -> Bundle:
    """The tool paths of a primitive, about its mean or about waypoints ``middle`` (T, n). The
    radius is along the direction of the largest spread of the tool point."""
    q = promp.sample(np.random.default_rng(0), SAMPLES, ROWS)
    tool = robot.tool_pose(q)[0]
    mean = robot.tool_pose(promp.mean_trajectory(ROWS))[0]
    off = tool - tool.mean(axis=0)
    spread = np.einsum("nti,ntj->tij", off, off) / (SAMPLES - 1)
    radius = WIDE * np.sqrt(np.maximum(np.linalg.eigvalsh(spread)[:, -1], 0.0))
    if middle is not None:
        rows = np.linspace(0.0, len(middle) - 1.0, ROWS)
        points = robot.tool_pose(middle)[0]
        mean = np.stack([np.interp(rows, np.arange(len(points)), c) for c in points.T], axis=1)
        tool = mean + off
    return Bundle(mean, radius, tool)


def initial_bundle(plan: Plan, demonstrations: Any = None) -> Bundle | None:
    """The conditioned primitive of a plan; None where nothing was learnt, nothing moves or nothing
    can be conditioned. As in the plan, it is conditioned on the start, the goal, and tool points:
    the via points, or stations on the tool path."""
    q = plan.initial.positions
    if (q == q[0]).all() or not is_learnt(plan.robot, demonstrations):
        return None
    phases, tool = np.linspace(0.0, 1.0, len(q)), plan.robot.tool_pose(q)[0]
    wanted = np.linspace(plan.first, len(q) - 1, FOLLOW.stations)[1:-1].round().astype(int)
    if plan.via:
        wanted = np.array([int(lengths(tool - via.position).argmin()) for via in plan.via[:-1]])
    elif np.array_equal(plan.initial.positions, plan.followed.positions):
        wanted = wanted[:0]
    inside = wanted[(wanted > 0) & (wanted < len(q) - 1)].tolist()
    points = [JointPoint(0.0, q[0]), JointPoint(1.0, q[-1])] + [
        TaskPoint(phases[row], tool[row], covariance=FOLLOW.station_deviation**2)
        for row in dict.fromkeys(inside)
    ]
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of points that are missed a little
            given = condition(learnt(plan.task, demonstrations), points, plan.robot.tool_map)
    except OptiPrompError:
        return None
    return bundle(given, plan.robot, q)


def candidates(plan: Plan) -> list[tuple[FloatArray, float]]:
    """Tool paths (P, 3) that the search of a plan tries, each with its harm; the worst first. The
    search is repeated with the plan's seed. The list is empty where no push model applies."""
    task, model = plan.task, plan.push_model
    if model is None or not isinstance(task.goal, PoseGoal):
        return []
    watched = _Watched(model)
    budget = Budget(clock() + SEARCHING)
    found = search(watched, task.axes, np.random.default_rng(plan.seed), budget)
    for path, good in found:
        if path.harm <= good:
            break
    best = sorted(watched.seen.values(), key=lambda item: item[1])[:CANDIDATES]
    return best[::-1]


class _Watched(Combined):
    """A push model that records the paths whose harm is asked, each with its last harm."""

    def __init__(self, model: PushModel) -> None:
        super().__init__(model)
        self.seen: dict[bytes, tuple[FloatArray, float]] = {}

    def harm(
        self, points: FloatArray, axes: FloatArray, states: int, limit: float = np.inf
    ) -> float:
        value = super().harm(points, axes, states, limit)
        self.seen[points.tobytes()] = points, value
        return value


def between(value: FloatArray, worst: float, best: float) -> IntArray:
    """Colours (..., 3), 0 to 255: red at ``worst``, over yellow, to green at ``best``."""
    share = np.clip((np.asarray(value) - worst) / (best - worst), 0.0, 1.0)
    marks = np.array([rgb(RED), (240, 196, 60), rgb(GREEN)])
    mixed = [np.interp(share, [0.0, 0.5, 1.0], column) for column in marks.T]
    return np.stack(mixed, axis=-1).astype(np.uint8)


@dataclass(frozen=True, eq=False)
class Clearances:
    """Distances of the body spheres along a motion."""

    # (T, S) distance of each sphere to the objects it must not touch [m]; infinite where there are
    # none
    nearest: FloatArray
    series: dict[str, FloatArray]  # smallest distance (T,) [m], by a name such as "arm to avoid"


def clearances(scene: Scene, robot: Robot, q: FloatArray) -> Clearances:
    """Distances of the body spheres at configurations ``q`` (T, n) to the objects as perceived."""
    centers, radius = robot.sphere_centers(q), np.asarray(robot.spheres.radius)
    distal = np.asarray(robot.spheres.distal, dtype=bool)
    nearest, series = np.full(centers.shape[:2], np.inf), {}
    pairs: tuple[tuple[str, Role, BoolArray], ...] = (
        ("static", "static", np.ones_like(distal)),
        ("arm to avoid", "avoid", ~distal),
        ("tool to avoid", "avoid", distal),
        ("arm to pushable", "pushable", ~distal),
    )
    for words, role, mine in pairs:
        rows = scene.rows(role)
        if not len(rows) or not mine.any():
            continue
        points = centers[:, mine].reshape(-1, 3)
        found = distances(packed(scene, rows), points)[0].min(axis=1)
        found = found.reshape(len(q), -1) - radius[mine]
        series[words] = found.min(axis=1)
        if words != "tool to avoid":
            nearest[:, mine] = np.minimum(nearest[:, mine], found)
    return Clearances(nearest, series)


@dataclass(frozen=True, eq=False)
class Around:
    """What surrounds a plan: clearances at ``times`` (T,) [s], and the objects that it pushes."""

    times: FloatArray
    near: Clearances
    pushed: PushedPlaces


def around(made: Plan | Picked) -> Around:
    """What surrounds a plan or a pick."""
    plan, curve = legs_of(made)["reach"], curve_of(made)
    times = np.linspace(0.0, curve.duration, CHART_ROWS)
    near = clearances(plan.scene, plan.robot, curve.sample(times)[0])
    return Around(times, near, pushed(made))


def passing(plan: Plan) -> list[tuple[str, FloatArray, FloatArray]]:
    """Id and position (3,) of each pushable that the tool passes, and the tool point there (3,)."""
    tool = plan.robot.tool_pose(plan.trajectory.positions[plan.first :])[0]
    up, out = plan.scene.frame[2], []
    for item in plan.scene.pushables:
        if plan.metrics.M_p.get(item.id) is None:
            continue
        point = tool[int(np.abs((tool - item.position) @ up).argmin())]
        out.append((item.id, item.position, point - ((point - item.position) @ up) * up))
    return out


@dataclass(frozen=True, eq=False)
class Chart:
    """Curves over one axis: x (T,), and by label values (T,) with a colour."""

    title: str
    x: FloatArray
    curves: tuple[tuple[str, FloatArray, str], ...]
    timed: bool = True


def charts(made: Plan | Picked, around: Around) -> list[Chart]:
    """Joints, speeds, clearances over time, and costs over the iterations."""
    near, times = around.near, around.times
    plan, (q, velocity, _) = legs_of(made)["reach"], curve_of(made).sample(times)
    names = plan.robot.joint_names
    speed = np.linalg.norm(np.gradient(plan.robot.tool_pose(q)[0], times, axis=0), axis=1)
    share = 100.0 * np.abs(velocity) / plan.robot.velocity
    out = [
        Chart("joints [rad or m]", times, _by_joint(names, q)),
        Chart("joint speeds [% of limit]", times, _by_joint(names, share)),
        Chart("tool speed [m/s]", times, (("tool", speed, JOINT_COLOURS[0]),)),
    ]
    if near.series:
        curves = tuple((name, 1e3 * v, ROLE_COLOURS[name]) for name, v in near.series.items())
        out.append(Chart("clearances [mm]", times, curves))
    for stage in plan.stages[-1:]:
        if len(stage.history) > 1:
            values = {t: np.array([h.get(t, 0.0) for h in stage.history]) for t in stage.terms}
            shown = [t for t in sorted(values, key=lambda t: -values[t].max()) if values[t].max()]
            lines = [
                (t, np.log10(np.maximum(values[t], 1e-12)), JOINT_COLOURS[i])
                for i, t in enumerate(shown[: len(JOINT_COLOURS)])
            ]
            iterations = np.arange(len(stage.history), dtype=float)
            out.append(Chart(f"costs, {stage.name} [log10, by iteration]", iterations,
                             tuple(lines), timed=False))  # fmt: skip
    return out


def _by_joint(names: Sequence[str], values: FloatArray) -> tuple[tuple[str, FloatArray, str], ...]:
    return tuple(
        (name, values[:, j], JOINT_COLOURS[j % len(JOINT_COLOURS)]) for j, name in enumerate(names)
    )


FRUITS = "all fruits"


@dataclass(frozen=True)
class Grip:
    """Objects, or parts of them, that are dragged together."""

    name: str  # shown to the user; unique in the scene
    ids: tuple[str, ...]  # of the objects
    # ``object`` (the root of its stem stays), ``root`` (of its stem), or ``whole`` (the object and
    # its stem)
    part: str = "object"


def grips(scene: Scene) -> dict[str, Grip]:
    """All grips of a scene by name; the target comes first."""
    first = sorted(scene.objects, key=lambda item: item.role != "target")
    found = [Grip(item.id, (item.id,)) for item in first]
    hanging = tuple(item.id for item in first if item.stem is not None)
    found += [Grip(f"{name}: stem root", (name,), "root") for name in hanging]
    if len(hanging) > 1:
        found.append(Grip(FRUITS, hanging, "whole"))
    return {grip.name: grip for grip in found}


def place(scene: Scene, grip: Grip) -> FloatArray:
    """The position (3,) of a grip [m]: the object's, the root's, or the mean of several."""
    items = [item for item in scene.objects if item.id in grip.ids]
    points = [
        item.stem.root if grip.part == "root" and item.stem else item.position for item in items
    ]
    return np.asarray(np.mean(points, axis=0))


def moved(scene: Scene, grip: Grip, to: FloatArray) -> Scene:
    """The scene with a grip at ``to`` (3,) [m]."""
    shift = np.asarray(to) - place(scene, grip)
    objects = (
        item.shifted(shift, grip.part) if item.id in grip.ids else item for item in scene.objects
    )
    return replace(scene, objects=rooted(objects))


def tool_radius(scene: Scene) -> float | None:
    """The radius of the scene's tool [m]; None where the scene names no tool that has one."""
    if scene.tool is None:
        return None
    known = inspect.signature(TOOLS[scene.tool.kind]).parameters
    if "radius" not in known:
        return None
    return float(scene.tool.parameters.get("radius", known["radius"].default))


def with_radius(scene: Scene, radius: float) -> Scene:
    """The scene whose tool has another radius [m]."""
    assert scene.tool is not None
    parameters = {**scene.tool.parameters, "radius": radius}
    return replace(scene, tool=ToolSpec(scene.tool.kind, parameters))


def sigma(scene: Scene) -> float:
    """Largest standard deviation of a coordinate of a fruit's detected position [m]."""
    variances = [
        np.trace(item.covariance) / 3.0 for item in scene.objects if item.covariance is not None
    ]
    return float(np.sqrt(max(variances, default=0.0)))


def with_sigma(scene: Scene, value: float) -> Scene:
    """The scene whose target and pushables were detected with this standard deviation [m]."""

    def detected(item: SceneObject) -> SceneObject:
        if item.role not in ("target", "pushable"):
            return item
        return replace(item, covariance=None, sigma=value or None)

    return scene.each(detected)


def culprit(scene: Scene, found: Plan | OptiPrompError, dragged: Grip | None) -> FloatArray:
    """The position (3,) of the cause of a failure [m]. It is that of the object that the plan
    touches, or of the first object that the message names; else of the grip that was dragged last,
    the target, or the last tool point."""
    by_id = {item.id: item for item in scene.objects}
    words = [] if isinstance(found, OptiPrompError) else [c.other for c in found.contacts]
    message = found.message.replace("'", " ").replace(",", " ").replace(":", " ").split()
    for word in [*words, *message]:
        if word in by_id:
            return by_id[word].position
    if dragged is not None and set(dragged.ids) <= by_id.keys():
        return place(scene, dragged)
    if scene.target is not None:
        return scene.target.position
    if isinstance(found, OptiPrompError):
        return np.zeros(3)
    return np.asarray(found.robot.tool_pose(found.trajectory.positions[-1])[0])
