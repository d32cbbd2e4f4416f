"""The judge: checks any trajectory, with code that shares nothing with the planners.

The judge has its own kinematics (:mod:`.kinematics`), distances (:mod:`.distances`,
:mod:`.clearance`) and rules for passing a pushable (:mod:`.speed`). It uses no kernel of
``robots``, ``geometry`` or ``optimization``. It judges the curve that is executed, between
waypoints too (:mod:`.curve`): no body sphere moves more than half its radius from one check to the
next, or lets a point in deeper than 1 mm in between. The extremes of positions, velocities,
accelerations and jerks are exact.

Objects that move are measured at the times of the motion. The checks are so dense that between two
of them neither body nor object moves far; half of what they may come nearer between two checks is
taken off each distance.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import compress, product
from typing import Any

import numpy as np

from optipromp.core.arrays import BoolArray, FloatArray, IntArray, lengths
from optipromp.core.compiled import called
from optipromp.core.geometry.shapes import GRID, PointCloudShape
from optipromp.core.judging import clearance, kinematics, speed
from optipromp.core.judging.clearance import Overlap, pieces, radii
from optipromp.core.judging.curve import along, extremes
from optipromp.core.judging.distances import Objects, measured, nearest, to_surface
from optipromp.core.judging.ends import Violation, ends, left_lines, left_path
from optipromp.core.judging.kinematics import MOST_CHECKS, centers
from optipromp.core.robots.model import Robot
from optipromp.core.scenes.scene import Scene, SceneObject
from optipromp.core.trajectory import State, Trajectory

APART = 0.004  # [m] that an object moves between two checks, at most: a choice
BY_TOOL = "clearance_avoid_tool"


def _asked(
    item: SceneObject, distal: BoolArray
) -> Iterator[tuple[list[SceneObject], str, BoolArray, str]]:
    """What an object's role asks for; every stem is to be avoided by the arm (B_d).

    Parts as objects that stand, their name, the spheres (B,) that are measured against them, and
    the metric of the distance, "" for none.
    """
    metric = f"clearance_{item.role}"
    yield [item], item.id, ~distal if item.role != "static" else np.ones_like(distal), metric
    if item.role == "avoid":
        yield [item], item.id, distal, BY_TOOL
    if item.stem is not None:
        stems = [piece for one in item.stem.likely() for piece in pieces(item, one)]
        yield stems, f"the stem of {item.id}", ~distal, ""


def met(
    scene: Scene, robot: Robot, trajectory: Trajectory, rows: IntArray
) -> tuple[dict[str, float], list[Overlap]]:
    """Smallest distances to objects that move [m], by the name of the metric, and the contacts.

    Which links must not touch an object depends on its role, as for those that stand. Pairs that
    may touch are left out; the padding of an object is taken off its distances. ``rows`` (T,) are
    indices of the waypoints among the checks of objects that stand: there are no fewer checks here.
    """
    least, found = dict[str, float](), list[Overlap]()
    parts, steps = np.diff(rows), np.diff(trajectory.times)
    distal = np.asarray(robot.spheres.distal, dtype=np.bool_)
    for item, course in scene.movers if len(distal) else ():
        asked = np.ceil(course.fastest * steps / APART)
        share = min(1.0, MOST_CHECKS / max(float(asked.sum()), 1.0))
        times, q, _ = along(trajectory, np.maximum(parts, asked * share).astype(np.int64))
        radius, places = radii(scene, robot, item) + scene.padding_of(item), course.at(times)
        for objects, name, counted, metric in _asked(item, distal):
            own = np.where(counted, radius, -np.inf)
            if np.isneginf(own).all():
                continue
            gap, sphere, at = min(
                _nearest(part, robot, own, places + (part.position - item.position), np.array(q))
                for part in objects
            )
            if metric:
                least[metric] = min(least.get(metric, np.inf), float(gap))
            if gap < 0.0 and metric != BY_TOOL:  # which is allowed
                link = str(robot.link_names[robot.spheres.link[sphere]])
                found.append(Overlap(link, name, item.role, -gap, float(times[at])))
    return least, found


def _nearest(
    item: SceneObject, robot: Robot, radius: FloatArray, places: FloatArray, q: FloatArray
) -> tuple[float, int, int]:
    """Smallest distance [m] at the checks, with the index of the sphere and that of the check.

    ``radius`` (B,) of the robot's spheres; minus infinity leaves a sphere out. ``places`` (M, 3) of
    the object at the checks [m].
    """
    (kind,), size, _ = measured([item.shape])
    counted = np.flatnonzero(np.isfinite(radius))
    radius = radius[counted]
    best = np.inf, 0, 0
    for start in range(0, len(q), clearance.CONFIGURATIONS):
        part = slice(start, start + clearance.CONFIGURATIONS)
        spheres = centers(robot, q[part])[:, counted]
        relative = spheres - places[part, None]
        step, by = np.zeros(len(relative)), np.diff(relative, axis=0)
        step[1:] = np.sqrt(np.einsum("mbi,mbi->mb", by, by)).max(axis=1)
        if kind == GRID:
            gap, sphere, at = nearest(item, relative + item.position, radius, np.inf)
            gap -= 0.5 * float(step.max())
        else:
            out = np.array([np.inf, 0.0, 0.0])
            closest(kind, size[0], relative @ item.rotation, radius, 0.5 * step, out)
            gap, sphere, at = float(out[0]), int(out[1]), int(out[2])
        if gap < best[0]:
            best = gap, int(counted[sphere]), start + at
    return best


@called
def closest(kind, size, spheres, radius, nearer, out):
    """Write distance, sphere and row of the closest of spheres (M, B, 3) to ``out`` (3,).

    The spheres are in the frame of the shape. ``nearer`` (M,) is taken off each distance [m].
    """
    for m in range(spheres.shape[0]):
        for b in range(radius.shape[0]):
            x, y, z = spheres[m, b, 0], spheres[m, b, 1], spheres[m, b, 2]
            d = to_surface(kind, size[0], size[1], size[2], x, y, z) - radius[b] - nearer[m]
            if d < out[0]:
                out[0], out[1], out[2] = d, b, m


ROUNDING = 1e-6  # [rad, rad/s, rad/s²] of start states, [-] of shares of a limit: files round
RATES = ("velocity", "acceleration", "jerk")

# [m] measured: clearance from static objects that a controller needs, below which there is a note:
# in the simulation the tool is up to 1 mm off its path in free motion; the rest is for an arm known
# to some mm
STATIC_MARGIN = 5e-3


@dataclass(frozen=True)
class Metrics:
    """Figures of a trajectory (method §6). A figure without meaning in the scene is None.

    Attributes:
        M_c: smallest distance from a body point to the core of an obstacle [m].
        M_p: by pushable, the lateral offset y_g·(fk − X_n) of the tool as it passes [m].
        passage: by pushable, the offsets along x_g and y_g at which the tool passes [m]; the second
            is M_p.
        stem_projection: by pushable, y_g·S_n of its stem [m].
        drift_shortfall: by pushable, what constraint 1 lacks from t_1 on: the scene's
            ``drift_offset``, else the gripper's radius, less the least s_n·y_g·(fk − X_n) [m].
        stem_gap: by pushable, smallest distance between the segment from tool to fruit and the
            stem's line (constraint 2) [m].
        clearance_static: smallest distance of a body sphere to a static object [m].
        clearance_avoid: smallest distance of the arm (B_d) to an object to avoid [m].
        clearance_avoid_tool: smallest distance of last link and tool to an object to avoid [m].
        clearance_pushable: smallest distance of the arm (B_d) to a pushable in its first place [m].
        clearance_self: smallest distance between links that are not neighbours [m].
        approach_speed: largest speed of the tool among pushables [m/s].
        goal_error: of the tool point at the end [m], or of a goal in joints [rad or m]; of several
            goals, that of the goal which is reached or missed least.
        goal_axis_error: of the tool axis or the orientation at the end [rad].
        limit_violation: largest excess over a position limit [rad or m].
        max_step: largest step of a joint between waypoints [rad or m].
        path_length: in joint space [rad].
        smoothness: root mean square joint acceleration [rad/s²].
        duration: of the trajectory [s].
        velocity_ratio: largest share of a velocity limit in use, at any instant.
        acceleration_ratio: largest share of an acceleration limit.
        jerk_ratio: largest share of a jerk limit.
        unseen: volume that no picture shows, into which the robot comes [m³]; None: not told.
    """

    M_c: float | None
    M_p: Mapping[str, float | None]
    passage: Mapping[str, tuple[float, float] | None]
    stem_projection: Mapping[str, float | None]
    drift_shortfall: Mapping[str, float | None]
    stem_gap: Mapping[str, float | None]
    clearance_static: float | None
    clearance_avoid: float | None
    clearance_avoid_tool: float | None
    clearance_pushable: float | None
    clearance_self: float | None
    approach_speed: float | None
    goal_error: float
    goal_axis_error: float | None
    limit_violation: float
    max_step: float
    path_length: float
    smoothness: float
    duration: float
    velocity_ratio: float
    acceleration_ratio: float
    jerk_ratio: float
    unseen: float | None = None

    def to_dict(self) -> dict[str, Any]:
        """The metrics as plain values for JSON."""
        ways = {name: way and list(way) for name, way in self.passage.items()}
        return vars(self) | {"passage": ways}


@dataclass(frozen=True)
class Judgement:
    """The judgement of a trajectory.

    Attributes:
        metrics: figures of the trajectory.
        violations: every reason why the trajectory is not valid; empty when it is valid.
        contacts: pairs that touch but must not.
        notes: remarks that do not make the trajectory invalid.
        at_start: pairs that touch but must not at the first instant, with their depths then.
    """

    metrics: Metrics
    violations: tuple[Violation, ...]
    contacts: tuple[Overlap, ...]
    notes: tuple[str, ...] = ()
    at_start: tuple[Overlap, ...] = ()

    @property
    def message(self) -> str:
        """All violations in one line."""
        return "; ".join(map(str, self.violations))


def judge(
    scene: Scene, robot: Robot, trajectory: Trajectory, start: State | None = None, *,
    stem_side: bool = True, begun: bool = False,
) -> Judgement:  # fmt: skip
    """Judge a trajectory against robot and scene.

    Args:
        scene: with the goal and the objects.
        robot: the robot with the scene's tool.
        trajectory: of the robot.
        start: state in which the trajectory must begin; None: anywhere, at rest.
        stem_side: whether passing a pushable on the side of its stem is a violation, else a note.
        begun: whether tool and last link may be inside of targets and pushables at the first
            instant.

    Returns:
        The judgement. The trajectory is valid if there are no violations.
    """
    q = trajectory.positions
    times, fine, waypoints, complete = kinematics.refined(robot, trajectory)
    distances, contacts, points, every = clearance.swept(scene, robot, fine, times)
    beside, moving = met(scene, robot, trajectory, waypoints)
    contacts, notes = clearance.pushed_away(scene, robot, fine, contacts)
    inside = [] if begun else entered(scene, robot, q[0], points[0], every[0])
    contacts += [*inside, *moving]
    at_start = touching(scene, robot, q[0], begun=begun) if contacts else []
    tips, axes = points[waypoints], every[waypoints]
    rims = tips + (0.0 if robot.tool is None else robot.tool.depth) * axes
    passed = speed.passages(
        speed.as_passed(scene, trajectory.times, tips), tips, rims, robot.gripper_radius
    )
    end, at_goal = ends(scene, robot, q[-1], tips[-1], axes[-1], trajectory.duration)
    missed = [*end.missed, *left_path(scene, robot, times, fine)]
    missed += left_lines(scene, robot, trajectory, points, waypoints)
    motion, broken = _motion(robot, trajectory, start)
    instants = trajectory.times.tolist()
    told = "the tool passes {} on the side of its stem"
    own = {item.id for item in scene.taken}  # fruits of a truss go with the target
    wrong = [(name, instants[at], by) for name, at, by in passed.wrong if name not in own]
    astray = [Violation("stem side", told.format(one[0]), *one, "m") for one in wrong]
    violations = [Violation("contact", str(c), c.link, c.time, c.depth, "m") for c in contacts]
    if not complete:
        most = kinematics.MOST_CHECKS
        text = f"it moves too far to be checked between waypoints: {most} checks are not enough"
        violations.append(Violation("unchecked", text))
    violations += [*missed, *(astray if stem_side else []), *broken]
    fastest = speed.among_fruits(scene, robot, trajectory, waypoints, points, every)
    fast, when = fastest or (None, None)
    if speed.too_fast(scene, fast):
        among = "objects that stand" if speed.stands(scene) else "fruits"
        text = (
            f"the tool moves at {fast:.3f} m/s among {among} (pushes are predicted for "
            f"{speed.largest_speed(scene):g})"
        )
        violations.append(Violation("speed", text, "", when, fast, "m/s"))
    notes += at_goal if stem_side else [*at_goal, *map(str, astray)]
    room = distances["clearance_static"]
    if room is not None and room < STATIC_MARGIN:
        near = clearance.nearest_static(scene, robot, fine, times)
        if near is not None and 0.0 < -near.depth < STATIC_MARGIN:
            notes.append(
                f"{near.link} comes within {-1e3 * near.depth:.1f} mm of {near.other}; a "
                f"controller needs about {1e3 * STATIC_MARGIN:g} mm"
            )
    for name, away in beside.items():
        closest = distances[name]
        distances[name] = away if closest is None else min(closest, away)
    unseen = swept_unseen(scene, robot, fine, points)
    if unseen:
        notes.append(
            f"the robot comes into {1e6 * unseen:.0f} cm³ that no picture shows: take another from "
            "aside, and look at all with --together"
        )
    figures: dict[str, Any] = {**distances, **motion, "unseen": unseen}
    metrics = Metrics(
        M_p=passed.M_p, passage=passed.passage, stem_projection=passed.stem_projection,
        drift_shortfall=passed.drift_shortfall, stem_gap=passed.stem_gap,
        approach_speed=fast, goal_error=end.error, goal_axis_error=end.angle, **figures,
    )  # fmt: skip
    notes += scene.assumed
    return Judgement(metrics, tuple(violations), tuple(contacts), tuple(notes), tuple(at_start))


def swept_unseen(scene: Scene, robot: Robot, q: FloatArray, points: FloatArray) -> float | None:
    """Volume of the scene's ``unseen`` cells whose middles come into the robot [m³].

    Over configurations ``q`` (M, n), with the tool points (M, 3) there; None: no cells are told.
    """
    item = scene.unseen
    if item is None:
        return None
    from scipy.spatial import cKDTree  # slow to import, seldom needed

    assert isinstance(item.shape, PointCloudShape)
    side = 2.0 * item.shape.radius
    gone = np.append(0.0, np.cumsum(lengths(np.diff(points, axis=0))))
    rows = np.unique(np.searchsorted(gone, np.arange(0.0, gone[-1] + side, 0.5 * side)))
    at = centers(robot, q[np.minimum(rows, len(q) - 1)])
    radius = np.tile(robot.spheres.radius, len(at))
    tree = cKDTree(item.position + item.shape.points @ item.rotation.T)
    inside = tree.query_ball_point(at.reshape(-1, 3), radius, return_sorted=False)
    return side**3 * len(set().union(*inside))


def _motion(
    robot: Robot, trajectory: Trajectory, start: State | None
) -> tuple[dict[str, float], list[Violation]]:
    """Figures of the joint trajectory, and the limits it breaks (constraint 4)."""
    steps, found = np.diff(trajectory.positions, axis=0), extremes(trajectory)
    names, out = robot.joint_names, []
    beyond = np.stack([robot.lower - found.lowest, found.highest - robot.upper])
    excess = max(float(beyond.max()), 0.0)
    if excess > 0.0:
        side, joint = divmod(int(np.argmax(beyond)), len(names))
        amount = f"{excess:.4f}" if excess >= 1e-4 else f"{excess:.2g}"  # never by 0.0000
        text = f"{names[joint]} leaves its limits by {amount}"
        when = float(found.when[side, joint])
        out.append(Violation("limit", text, names[joint], when, excess, "rad or m"))
    ratios = {}
    limits = robot.velocity, robot.acceleration, robot.jerk
    for row, (kind, limit) in enumerate(zip(RATES, limits, strict=True)):
        shares = found.largest[row] / limit
        joint = int(np.argmax(shares))
        ratio = ratios[f"{kind}_ratio"] = float(shares[joint])
        if ratio > 1.0 + ROUNDING:
            text = f"{kind} of {names[joint]} reaches {ratio:.3f} of its limit"
            when = float(found.when[2 + row, joint])
            out.append(Violation(kind, text, names[joint], when, ratio, "of the limit"))
    out += _ends(robot, trajectory, start)
    squared = np.einsum("ti,ti->t", trajectory.accelerations, trajectory.accelerations)
    mean = np.trapezoid(squared, trajectory.times) / trajectory.duration
    return {
        "limit_violation": excess,
        "max_step": float(np.max(np.abs(steps))),
        "path_length": float(lengths(steps).sum()),
        "smoothness": math.sqrt(mean),
        "duration": trajectory.duration,
        **ratios,
    }, out


def _ends(robot: Robot, trajectory: Trajectory, start: State | None) -> list[Violation]:
    """Violations where the trajectory does not begin in the start's state or not end at rest.

    A jump in acceleration counts only for joints whose jerk is limited.
    """
    begin, end = State(trajectory.positions[0]), State(trajectory.positions[-1])
    out, names = [], robot.joint_names
    if start is not None:
        begin = start
        off = float(np.max(np.abs(robot.apart(trajectory.positions[0], start.q))))
        if off > ROUNDING:
            text = "the trajectory does not begin at the start"
            out.append(Violation("start", text, "", 0.0, off, "rad or m"))
    for row, verb, state in ((0, "begins", begin), (-1, "ends", end)):
        rate = trajectory.velocities[row], state.velocity
        gain = (
            np.where(np.isfinite(robot.jerk), x, 0.0)
            for x in (trajectory.accelerations[row], state.acceleration)
        )
        for kind, (is_, asked) in (("velocity", rate), ("acceleration", gain)):
            joint = int(np.argmax(np.abs(is_ - asked)))
            amount = float(abs(is_[joint] - asked[joint]))
            if amount > ROUNDING:
                text = f"{names[joint]} {verb} with {kind} {is_[joint]:.4g}, not {asked[joint]:.4g}"
                when = float(trajectory.times[row])
                out.append(Violation("motion", text, names[joint], when, amount))
    return out


BRUSHED = 0.005  # [m] depth that does not count: spheres stand out of a cup's wall by 4.5 mm


def touching(scene: Scene, robot: Robot, q: FloatArray, *, begun: bool = False) -> list[Overlap]:
    """Contacts that no motion may begin with, at ``q`` (n,).

    A motion that continues one that ran (``begun``) may begin inside of targets and pushables.
    Objects that move are where they are at time 0.
    """
    scene = scene.standing({item.id: 0.0 for item, _ in scene.movers})
    _, contacts, points, axes = clearance.swept(scene, robot, q[None])
    return [*contacts, *([] if begun else entered(scene, robot, q, points[0], axes[0]))]


def entered(
    scene: Scene, robot: Robot, q: FloatArray, point: FloatArray, axis: FloatArray
) -> list[Overlap]:
    """Penetrations of the tool or the last link into the target or a pushable.

    Both may touch these during a motion, but no motion may begin inside of one.
    An object in the tool's mouth, or before the mouth, does not touch the tool. Depths up to
    :data:`BRUSHED` do not count.

    ``point``, ``axis``: (3,) tool point [m] and tool axis at ``q``.
    """
    distal = np.flatnonzero(robot.spheres.distal)
    if not len(distal):
        return []
    spheres, radius = centers(robot, q[None])[:, distal], np.asarray(robot.spheres.radius)[distal]
    middle = spheres[0].mean(axis=0)
    reach = float((lengths(spheres[0] - middle) + radius).max())
    rows = np.concatenate([scene.rows("target"), scene.rows("pushable")])
    off, items = lengths(scene.positions[rows] - middle), scene.objects_at(rows)
    _, _, bound = measured([item.shape for item in items])
    link, out = np.asarray(robot.spheres.link)[distal], []
    for item in compress(items, off < bound + reach):
        for one in np.unique(link):
            if one == link.max() and _in_mouth(robot, item, point, axis):
                continue
            if scene.may_meet(str(robot.link_names[one]), item.id):
                continue
            depth = _depth(item, spheres[:, link == one], radius[link == one])
            if depth > BRUSHED:
                out.append(Overlap(str(robot.link_names[one]), item.id, item.role, depth, 0.0))
    return out


def struck(
    scene: Scene, robot: Robot, q: FloatArray, by: Mapping[str, FloatArray]
) -> Overlap | None:
    """The deepest penetration of the tool or the last link into a target, a pushable or a stem.

    It is the deepest over configurations ``q`` (M, n); None where none exceeds :data:`BRUSHED`.
    ``by``: displacements (M, 3) or more from its place of each object that moves, by id [m].
    """
    distal = np.flatnonzero(robot.spheres.distal)
    if not len(distal):
        return None
    spheres, radius = centers(robot, q)[:, distal], np.asarray(robot.spheres.radius)[distal]
    link, found = np.asarray(robot.spheres.link)[distal], list[Overlap]()
    rows = np.concatenate([scene.rows("target"), scene.rows("pushable")])
    for item, one in product(scene.objects_at(rows), np.unique(link)):
        name, mine = str(robot.link_names[one]), (spheres[:, link == one], radius[link == one])
        if scene.may_meet(name, item.id):
            continue
        if item.id in by:
            mine = mine[0] - by[item.id][: len(q), None], mine[1]
        found.append(Overlap(name, item.id, item.role, _depth(item, *mine)))
        for piece in () if item.stem is None else pieces(item, item.stem):
            told = f"the stem of {item.id}"
            found.append(Overlap(name, told, item.role, _depth(piece, *mine)))
    deepest = max(found, key=lambda overlap: overlap.depth, default=None)
    return None if deepest is None or deepest.depth <= BRUSHED else deepest


def _in_mouth(robot: Robot, item: SceneObject, point: FloatArray, axis: FloatArray) -> bool:
    """Whether an object is in the tool's mouth or before it.

    The smallest half size of the object decides whether it fits.
    """
    tool = robot.tool
    if tool is None:
        return False
    off = item.position - point
    height = float(off @ axis)
    aside = float(np.linalg.norm(off - height * axis))
    _, size, _ = measured([item.shape])
    thin = float(size.min(where=size > 0.0, initial=np.inf)) if size.any() else 0.0
    return height > tool.front - tool.reach and aside + thin < tool.mouth[0] + BRUSHED


def _depth(item: SceneObject, spheres: FloatArray, radius: FloatArray) -> float:
    """Largest depth [m] of spheres (M, B, 3) in an object; at most 0 where none touches it."""
    kind, size, bound = measured([item.shape])
    if kind[0] == GRID:
        return -nearest(item, spheres, radius, 0.0)[0]
    none, found = np.zeros(1, dtype=np.int64), np.zeros(3)
    alone = Objects(
        none, kind, none, np.array([item.position]), np.array([item.rotation]), size, bound, none,
        np.zeros((0, 3)), np.zeros(0),
    )  # fmt: skip
    clearance.enter(alone, 0, spheres, radius, np.ones(len(radius), dtype=np.bool_), found)
    return float(found[0])
