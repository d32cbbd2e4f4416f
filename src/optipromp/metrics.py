"""The judge: what a trajectory really does, by code that shares nothing with the solver.

Kinematics and distances are the judge's own (:mod:`.kinematic_checks`, :mod:`.sweep`,
:mod:`.distance_checks`), and so is how it sees pushables passed (:mod:`.passing`); no kernel of
``robots``, ``geometry`` or ``optimization`` is used. The trajectory is checked between its knots
too, so finely that no body sphere moves more than half its radius from one check to the next
(linear motion of the joints between knots).
"""

import functools
import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from optipromp import distance_checks
from optipromp.arrays import FloatArray, IntArray, lengths
from optipromp.kinematic_checks import Body, cut, divisions, place
from optipromp.passing import passing
from optipromp.robots.model import Robot
from optipromp.scenes.rotations import to_quaternion
from optipromp.scenes.scene import JointGoal, PoseGoal, Scene, SceneObject
from optipromp.sweep import entered_first, sweep
from optipromp.trajectory import Trajectory

GOAL_TOLERANCE = 1e-3  # [m], or [rad] for a goal in joints
AXIS_TOLERANCE = np.deg2rad(2.0)  # [rad]
START_TOLERANCE = 1e-6  # [rad]
RATIO_TOLERANCE = 1e-6  # share of a velocity or acceleration limit
MOST_CHECKS = 200_000
LARGEST_TURN = 0.2  # [rad or m] over all joints, between two configurations whose chord counts


@dataclass(frozen=True)
class Metrics:
    """What a plan reports (method §6). SI units; None where the scene has nothing of the kind.

    ``clearance_pushable`` is B_d's distance to the pushables and ``smoothness`` the root mean
    square joint acceleration [rad/s²] at the knots.
    """

    M_c: float | None
    M_p: Mapping[str, float | None]
    stem_projection: Mapping[str, float | None]
    clearance_static: float | None
    clearance_avoid: float | None
    clearance_avoid_tool: float | None
    clearance_pushable: float | None
    clearance_self: float | None
    goal_error: float
    goal_axis_error: float | None
    limit_violation: float
    max_step: float
    path_length: float
    smoothness: float
    duration: float
    velocity_ratio: float
    acceleration_ratio: float

    def to_dict(self) -> dict[str, Any]:
        """The metrics as plain values for JSON."""
        out = {f.name: getattr(self, f.name) for f in fields(self)}
        return {k: dict(v) if isinstance(v, Mapping) else v for k, v in out.items()}


@dataclass(frozen=True)
class Contact:
    """Two things that touch and must not: a link, an object or another link, how deep [m]."""

    link: str
    other: str
    role: str
    depth: float

    def __str__(self) -> str:
        return f"{self.link} enters {self.other} ({self.role}) by {self.depth * 1e3:.1f} mm"


@dataclass(frozen=True)
class Judgement:
    """Metrics, every reason why the trajectory is not valid (empty when it is), and remarks."""

    metrics: Metrics
    violations: tuple[str, ...]
    contacts: tuple[Contact, ...]
    notes: tuple[str, ...] = ()


@functools.lru_cache(maxsize=32)
def judged_body(robot: Robot) -> Body:
    """The robot as the sweep takes it."""
    kin, spheres = robot.kinematics, robot.spheres
    order = np.argsort(spheres.link, kind="stable")
    link, radius = np.asarray(spheres.link)[order], np.asarray(spheres.radius)[order]
    local, carrier = np.asarray(spheres.center)[order], np.asarray(spheres.segment)[order]
    names, start = np.unique(link, return_index=True)
    start = np.append(start, len(link)).astype(np.int64)
    spans = list(itertools.pairwise(start))
    hub = np.array([local[i:j].mean(axis=0) for i, j in spans]).reshape(-1, 3)
    reach = [
        np.max(np.linalg.norm(local[i:j] - h, axis=1) + radius[i:j])
        for (i, j), h in zip(spans, hub, strict=True)
    ]
    pairs = np.sort(np.argsort(order)[np.asarray(robot.self_pairs).reshape(-1, 2)], axis=1)
    keys = np.searchsorted(names, link[pairs])
    by = np.lexsort((pairs[:, 1], pairs[:, 0], keys[:, 1], keys[:, 0]))
    pairs, keys = pairs[by], keys[by]
    cuts = np.flatnonzero(np.any(np.diff(keys, axis=0) != 0, axis=1)) + 1
    edges = np.concatenate([[0], cuts, [len(pairs)]]) if len(pairs) else np.zeros(1, dtype=int)
    groups = [(*keys[i], i, j) for i, j in itertools.pairwise(edges)]
    levers = np.zeros((len(groups), robot.n_segments))
    for g, (a, b, *_) in enumerate(groups):
        both = [local[slice(*spans[a])], local[slice(*spans[b])]]
        levers[g] = _levers(robot, carrier[start[[a, b]]], both)
    quaternions = np.array([to_quaternion(rotation) for rotation in kin.rotation])
    return Body(
        prismatic=kin.kind == 1, turn=quaternions.reshape(-1, 4), shift=kin.translation,
        axis=kin.axis, driver=kin.dof, ratio=kin.multiplier, offset=kin.offset, carrier=carrier,
        local=local, radius=radius, original=order, start=start,
        distal=np.asarray(spheres.distal)[order][start[:-1]], hub=hub, hub_radius=np.array(reach),
        slimmest=np.minimum.reduceat(radius, start[:-1]),
        tool=np.array([robot.tool_point, robot.tool_axis]),
        groups=np.array(groups, dtype=np.int64).reshape(-1, 4), pairs=pairs.astype(np.int64),
        levers=levers, longest=levers.max(axis=0, initial=0.0),
    )  # fmt: skip


def _levers(robot: Robot, segments: IntArray, locals_: Sequence[FloatArray]) -> FloatArray:
    """How far (S,) one of two links moves about the other, at most, by a joint's value.

    ``segments`` (2,) carry them and ``locals_`` are the centres (k, 3) of their spheres. No farther
    than the chain is long from the joint to the spheres; without bound before a prismatic joint.
    """
    kin, out = robot.kinematics, np.zeros(robot.n_segments)
    far = int(np.argmax(segments))
    axis = kin.axis[segments[far]]
    length = np.linalg.norm(locals_[far], axis=1).max()
    for s in range(segments[far], segments[1 - far], -1):
        aside = np.linalg.norm(np.cross(locals_[far], axis), axis=1).max()
        lever = aside if s == segments[far] else length
        out[s] = 1.0 if kin.kind[s] == 1 else lever
        length += np.inf if kin.kind[s] == 1 else np.linalg.norm(kin.translation[s])
    return out


def centers(robot: Robot, q: FloatArray) -> FloatArray:
    """World centres (M, B, 3) of the body spheres at ``q`` (M, n), in the robot's own order."""
    body = judged_body(robot)
    placed = np.empty((len(q), len(body.radius), 3))
    place(body, np.array(q, dtype=np.float64, order="C"), placed)
    out = np.empty_like(placed)
    out[:, body.original] = placed
    return out


def fine_positions(robot: Robot, positions: FloatArray) -> tuple[FloatArray, bool]:
    """The trajectory refined so that no sphere moves over half its radius between checks.

    Returns:
        (M, n) positions, the knots among them, and whether they are as fine as that: at most
        :data:`MOST_CHECKS` are made.
    """
    fine, _, complete = _refined(robot, positions)
    return fine, complete


def _refined(robot: Robot, positions: FloatArray) -> tuple[FloatArray, IntArray, bool]:
    """:func:`fine_positions`, and which of them (T,) are the knots."""
    kin = robot.kinematics
    positions = np.array(positions, dtype=np.float64, order="C")
    turns = np.abs(positions[1:] - positions[:-1])[:, kin.dof] @ np.abs(kin.multiplier)
    coarse, knots, fits = positions, None, True
    if turns.max(initial=0.0) > LARGEST_TURN:  # a chord says little about a large arc
        coarse, knots, fits = _cut(positions, np.maximum(1, np.ceil(turns / LARGEST_TURN)))
    parts = np.empty(len(coarse) - 1, dtype=np.int64)
    divisions(judged_body(robot), coarse, parts)
    fine, at, complete = _cut(coarse, parts)
    return fine, at if knots is None else at[knots], fits and complete


def _cut(positions: FloatArray, parts: Any) -> tuple[FloatArray, IntArray, bool]:
    """Each interval in as many ``parts`` (T-1,), where the knots are, and whether all were made."""
    total = float(np.sum(parts))
    if total > MOST_CHECKS:
        parts = np.maximum(1, np.floor(parts * (MOST_CHECKS / total)))
    parts = parts.astype(np.int64)
    knots = np.zeros(len(positions), dtype=np.int64)
    np.cumsum(parts, out=knots[1:])
    fine = np.empty((knots[-1] + 1, positions.shape[1]))
    cut(positions, parts, fine)
    return fine, knots, total <= MOST_CHECKS


def clearances(
    scene: Scene, robot: Robot, q: FloatArray
) -> tuple[dict[str, float | None], list[Contact]]:
    """Smallest distances over configurations ``q`` (M, n), and what touches and must not.

    Contacts count with static things for every sphere, with avoid things and pushables for B_d
    (all but the last link and the tool), and between links that are not neighbours. The dictionary
    has the keys of :class:`Metrics`; None where there is nothing to measure.
    """
    distances, contacts, _, _ = swept(scene, robot, q)
    return distances, contacts


def swept(
    scene: Scene, robot: Robot, q: FloatArray
) -> tuple[dict[str, float | None], list[Contact], FloatArray, FloatArray]:
    """:func:`clearances`, and tool point and tool axis (M, 3) at every configuration."""
    body = judged_body(robot)
    things, rest = distance_checks.judged_things(scene)
    closest, core, apart = np.full(4, np.inf), np.full(1, np.inf), np.full(3, np.inf)
    count = len(things.kind)
    depth, deepest = np.full(count, np.inf), np.zeros(count, dtype=np.int64)
    q = np.array(q, dtype=np.float64, order="C")  # always writable: kernels compile once
    points, axes = np.empty((len(q), 3)), np.empty((len(q), 3))
    sweep(body, things, q, points, axes, closest, core, depth, deepest, apart)

    def name(sphere: int) -> str:
        return str(robot.link_names[robot.spheres.link[body.original[sphere]]])

    contacts = []
    if count and depth.min() < 0.0:
        met = np.flatnonzero(depth < 0.0)
        met = met[np.argsort(things.place[met])]
        contacts = [
            Contact(name(int(deepest[k])), thing.id, thing.role, -float(depth[k]))
            for k, thing in zip(met.tolist(), scene.things(things.place[met]), strict=True)
        ]
    if rest:
        contacts += _other_shapes(rest, robot, q, closest, core)
    if apart[0] < 0.0:
        pair = name(int(apart[1])), name(int(apart[2]))
        contacts.append(Contact(*pair, "the robot itself", -float(apart[0])))

    def known(value: float) -> float | None:
        return float(value) if math.isfinite(value) else None

    distances = {
        "M_c": known(core[0]),
        "clearance_static": known(closest[0]),
        "clearance_avoid": known(closest[1]),
        "clearance_avoid_tool": known(closest[2]),
        "clearance_pushable": known(closest[3]),
        "clearance_self": known(apart[0]),
    }
    return distances, contacts, points, axes


def _other_shapes(
    objects: Sequence[SceneObject],
    robot: Robot,
    q: FloatArray,
    closest: FloatArray,
    core: FloatArray,
) -> list[Contact]:
    """Meshes and point clouds, measured in NumPy; updates ``closest`` and ``core``."""
    spheres, radius = centers(robot, q), np.asarray(robot.spheres.radius)
    distal = np.asarray(robot.spheres.distal)
    sets = {
        "static": ((0, np.ones_like(distal), True),),
        "avoid": ((1, ~distal, True), (2, distal, False)),
        "pushable": ((3, ~distal, True),),
    }
    contacts = []
    for thing in objects:
        for slot, chosen, fault in sets[thing.role]:
            columns = np.flatnonzero(chosen)
            if not len(columns):
                continue
            d, where = distance_checks.closest(
                thing.shape, thing.position, thing.rotation, spheres[:, columns], radius[columns],
                float(closest[slot]),
            )  # fmt: skip
            if d is None:
                continue
            closest[slot] = min(closest[slot], d)
            if fault and d < 0.0:
                link = robot.link_names[robot.spheres.link[columns[where]]]
                contacts.append(Contact(link, thing.id, thing.role, -d))
        if thing.role != "pushable":  # their core is their surface
            d, _ = distance_checks.closest(
                thing.shape, thing.position, thing.rotation, spheres, np.zeros_like(radius),
                float(core[0]),
            )  # fmt: skip
            core[0] = core[0] if d is None else min(core[0], d)
    return contacts


def pushed_away(
    scene: Scene, robot: Robot, q: FloatArray, contacts: Sequence[Contact]
) -> tuple[list[Contact], list[str]]:
    """Contacts without those with what the tool has pushed away by then, and a note on each.

    A pushable on no stem stays where it was pushed to. Once the tool has been inside the place
    where it stood, to some depth, it has moved by that much at least; an arm link that gets into
    that place later, and no deeper, finds it empty. Of meshes and point clouds that is not asked.
    """
    met = {contact.other for contact in contacts if contact.role == "pushable"}
    if not met:
        return list(contacts), []
    things, _ = distance_checks.judged_things(scene)
    loose = {
        thing.id: k
        for k, thing in enumerate(scene.things(things.place))
        if thing.id in met and thing.stem is None
    }
    spheres, radius = centers(robot, q), np.array(robot.spheres.radius)
    distal = np.array(robot.spheres.distal)
    kept, notes = [], []
    for contact in contacts:
        k = loose.get(contact.other)
        if k is None:
            kept.append(contact)
            continue
        depth, sphere = entered_first(
            things.kind[k], things.size[k], things.bound[k], things.rotation[k : k + 1],
            things.position[k : k + 1], spheres, radius, distal,
        )  # fmt: skip
        if depth > 0.0:
            link = str(robot.link_names[robot.spheres.link[sphere]])
            kept.append(replace(contact, link=link, depth=float(depth)))
        else:
            notes.append(
                f"{contact.link} passes where {contact.other} stood, from where the tool has "
                "pushed it by then"
            )
    return kept, notes


def judge(
    scene: Scene,
    robot: Robot,
    trajectory: Trajectory,
    start: FloatArray | None = None,
    *,
    stem_side: bool = True,
) -> Judgement:
    """Judge a trajectory against robot and scene.

    Args:
        scene: what must be reached, pushed, avoided.
        robot: the robot with the scene's tool.
        trajectory: what is to be executed.
        start: (n,) where it must begin; None: not checked.
        stem_side: whether passing a pushable on the side of its stem (constraint 2 of the method)
            makes it invalid, or is only noted.
    """
    q = trajectory.positions
    fine, knots, complete = _refined(robot, q)
    distances, contacts, points, axes = swept(scene, robot, fine)
    tips, axes = points[knots], axes[knots]
    contacts, notes = pushed_away(scene, robot, fine, contacts)
    violations = [str(contact) for contact in contacts]
    if not complete:
        violations.append(f"it moves too far to be checked between its knots ({MOST_CHECKS} times)")
    goal_error, axis_error = _goal(scene, q[-1], tips[-1], axes[-1], violations)
    rims = tips + getattr(robot.tool, "depth", 0.0) * axes
    m_p, projection = passing(
        scene, tips, rims, robot.gripper_radius, violations if stem_side else notes
    )
    beyond = np.maximum(robot.lower - q.min(axis=0), q.max(axis=0) - robot.upper)
    joint = int(np.argmax(beyond))
    excess = max(float(beyond[joint]), 0.0)
    if excess > 0.0:
        violations.append(f"{robot.joint_names[joint]} leaves its limits by {excess:.4f}")
    accelerations, steps = trajectory.accelerations, q[1:] - q[:-1]
    velocity = float(np.max(np.abs(trajectory.velocities) / robot.velocity))
    acceleration = float(np.max(np.abs(accelerations) / robot.acceleration))
    for name, ratio in (("velocity", velocity), ("acceleration", acceleration)):
        if ratio > 1.0 + RATIO_TOLERANCE:
            violations.append(f"{name} reaches {ratio:.3f} of its limit")
    if start is not None and np.max(np.abs(q[0] - start)) > START_TOLERANCE:
        violations.append("the trajectory does not begin at the start")
    metrics = Metrics(
        M_p=m_p,
        stem_projection=projection,
        **distances,
        goal_error=goal_error,
        goal_axis_error=axis_error,
        limit_violation=excess,
        max_step=float(np.max(np.abs(steps))),
        path_length=float(lengths(steps).sum()),
        smoothness=math.sqrt(np.vdot(accelerations, accelerations) / len(q)),
        duration=trajectory.duration,
        velocity_ratio=velocity,
        acceleration_ratio=acceleration,
    )
    return Judgement(metrics, tuple(violations), tuple(contacts), tuple(notes))


def _goal(
    scene: Scene, last: FloatArray, tip: FloatArray, axis: FloatArray, violations: list[str]
) -> tuple[float, float | None]:
    """Distance [m] (or joint distance [rad]) and axis error [rad] at the last knot."""
    if isinstance(scene.goal, JointGoal):
        error = float(np.max(np.abs(last - scene.goal.joints)))
        if error > GOAL_TOLERANCE:
            violations.append(f"the end is {error:.4f} rad from the goal configuration")
        return error, None
    if isinstance(scene.goal, PoseGoal):
        position, direction = scene.goal.position, scene.goal.axis
    else:
        assert scene.target is not None  # the schema asks for a target or a goal
        position, direction = scene.target.position, scene.frame[2]
    error = float(np.linalg.norm(tip - position))
    if error > GOAL_TOLERANCE:
        violations.append(f"the tool ends {error * 1e3:.1f} mm from the goal")
    angle = _angle(axis.tolist(), direction.tolist())
    if angle > AXIS_TOLERANCE:
        violations.append(f"the tool axis ends {np.rad2deg(angle):.1f} degrees off the approach")
    return error, angle


def _angle(a: list[float], b: list[float]) -> float:
    """Angle between two vectors [rad], exact also where it is small."""
    cross = a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]
    return math.atan2(math.hypot(*cross), a[0] * b[0] + a[1] * b[1] + a[2] * b[2])
