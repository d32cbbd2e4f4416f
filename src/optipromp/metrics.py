"""The judge: what a trajectory really does, by code that shares nothing with the solver.

Kinematics here are plain NumPy products of the robot's description, and distances come from the
shapes of the scene; no kernel of ``robots``, ``geometry`` or ``optimization`` is used. The
trajectory is checked between its knots too, so finely that no body sphere moves more than half its
radius from one check to the next (linear motion of the joints between knots).
"""

import functools
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from optipromp import distance_checks
from optipromp.arrays import FloatArray
from optipromp.robots.model import Robot
from optipromp.scenes.scene import JointGoal, PoseGoal, Scene, SceneObject
from optipromp.trajectory import Trajectory

GOAL_TOLERANCE = 1e-3  # [m], or [rad] for a goal in joints
AXIS_TOLERANCE = np.deg2rad(2.0)  # [rad]
START_TOLERANCE = 1e-6  # [rad]
RATIO_TOLERANCE = 1e-6  # share of a velocity or acceleration limit
DECIDED = np.sin(np.deg2rad(1.0))  # a stem leans to a side when this share of it is lateral
MOST_CHECKS = 200_000


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
    """Metrics, and every reason why the trajectory is not valid (empty when it is)."""

    metrics: Metrics
    violations: tuple[str, ...]
    contacts: tuple[Contact, ...]


def frames(robot: Robot, q: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Origins (M, S, 3) and rotations (M, S, 3, 3) of the segments at ``q`` (M, n)."""
    kin = robot.kinematics
    m = len(q)
    rotation, origin = np.broadcast_to(np.eye(3), (m, 3, 3)), np.zeros((m, 3))
    origins, rotations = np.empty((m, len(kin.kind), 3)), np.empty((m, len(kin.kind), 3, 3))
    for s in range(len(kin.kind)):
        value = kin.multiplier[s] * q[:, kin.dof[s]] + kin.offset[s]
        origin = origin + rotation @ kin.translation[s]
        rotation = rotation @ kin.rotation[s]
        a = kin.axis[s]
        if kin.kind[s] == 1:
            origin = origin + value[:, None] * (rotation @ a)
        else:
            cross = np.array([[0, -a[2], a[1]], [a[2], 0, -a[0]], [-a[1], a[0], 0]])
            turn = (
                np.eye(3)
                + np.sin(value)[:, None, None] * cross
                + (1 - np.cos(value))[:, None, None] * (cross @ cross)
            )
            rotation = rotation @ turn
        origins[:, s], rotations[:, s] = origin, rotation
    return origins, rotations


def centers(robot: Robot, origins: FloatArray, rotations: FloatArray) -> FloatArray:
    """World centres (M, B, 3) of the body spheres."""
    spheres = robot.spheres
    out = np.empty((len(origins), len(spheres.radius), 3))
    for s in np.unique(spheres.segment):
        on = spheres.segment == s
        local = spheres.center[on]
        if s < 0:
            out[:, on] = local
        else:
            out[:, on] = origins[:, None, s] + local @ rotations[:, s].transpose(0, 2, 1)
    return out


def tool(robot: Robot, origins: FloatArray, rotations: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Tool point and tool axis (M, 3) each."""
    return (
        origins[:, -1] + rotations[:, -1] @ robot.tool_point,
        rotations[:, -1] @ robot.tool_axis,
    )


def fine_positions(robot: Robot, positions: FloatArray) -> FloatArray:
    """The trajectory refined so that no sphere moves over half its radius between checks."""
    at_knots = centers(robot, *frames(robot, positions))
    if at_knots.shape[1] == 0:
        return positions
    moved = np.linalg.norm(np.diff(at_knots, axis=0), axis=2)
    parts = np.ceil(1.1 * np.max(moved / (0.5 * robot.spheres.radius), axis=1, initial=0.0))
    parts = np.maximum(parts, 1).astype(int)
    if parts.sum() > MOST_CHECKS:
        parts = np.maximum(1, parts * MOST_CHECKS // parts.sum())
    index = np.repeat(np.arange(len(parts)), parts)
    share = (np.arange(len(index)) - np.repeat(np.cumsum(parts) - parts, parts)) / parts[index]
    between = positions[index] + share[:, None] * (positions[index + 1] - positions[index])
    return np.vstack([between, positions[-1:]])


@functools.lru_cache(maxsize=16)
def _link_pairs(robot: Robot) -> distance_checks.LinkPairs:
    return distance_checks.link_pairs(np.asarray(robot.spheres.link), robot.self_pairs)


def clearances(
    scene: Scene, robot: Robot, q: FloatArray
) -> tuple[dict[str, float | None], list[Contact], FloatArray]:
    """Smallest distances over configurations ``q`` (M, n), what touches, and the sphere centres.

    Contacts count with static things for every sphere, with avoid things and pushables for B_d
    (all but the last link and the tool), and between links that are not neighbours.
    """
    contacts: list[Contact] = []
    spheres = centers(robot, *frames(robot, q))
    radius, link = robot.spheres.radius, robot.spheres.link
    distal = np.asarray(robot.spheres.distal)

    def closest(objects: tuple[SceneObject, ...], on: Any, fault: bool = True) -> float | None:
        best: float | None = None
        columns = np.flatnonzero(on)
        for thing in objects if len(columns) else ():
            d, where = distance_checks.closest(
                thing.shape, thing.position, thing.rotation, spheres[:, columns], radius[columns],
                np.inf if best is None else best,
            )  # fmt: skip
            if d is None:
                continue
            best = d if best is None else min(best, d)
            if d < 0.0 and fault:
                name = robot.link_names[link[columns[where]]]
                contacts.append(Contact(name, thing.id, thing.role, -d))
        return best

    out = {
        "clearance_static": closest(scene.static, np.ones(len(radius), dtype=bool)),
        "clearance_avoid": closest(scene.avoid, ~distal),
        "clearance_avoid_tool": closest(scene.avoid, distal, fault=False),
        "clearance_pushable": closest(scene.pushables, ~distal),
    }
    apart, pair = distance_checks.self_clearance(spheres, radius, _link_pairs(robot))
    out["clearance_self"] = apart
    if apart is not None and apart < 0.0:
        first, second = (robot.link_names[link[i]] for i in pair)
        contacts.append(Contact(first, second, "the robot itself", -apart))
    return out, contacts, spheres


def judge(
    scene: Scene, robot: Robot, trajectory: Trajectory, start: FloatArray | None = None
) -> Judgement:
    """Judge a trajectory against robot and scene.

    Args:
        scene: what must be reached, pushed, avoided.
        robot: the robot with the scene's tool.
        trajectory: what is to be executed.
        start: (n,) where it must begin; None: not checked.
    """
    q = trajectory.positions
    distances, contacts, spheres = clearances(scene, robot, fine_positions(robot, q))
    violations = [str(contact) for contact in contacts]
    tips, axes = tool(robot, *frames(robot, q))
    goal_error, axis_error = _goal(scene, q[-1], tips[-1], axes[-1], violations)
    m_p, projection = _passing(scene, tips, robot.gripper_radius, violations)
    excess = float(np.max(np.maximum(robot.lower - q, q - robot.upper), initial=0.0))
    if excess > 0.0:
        joint = int(np.argmax(np.max(np.maximum(robot.lower - q, q - robot.upper), axis=0)))
        violations.append(f"{robot.joint_names[joint]} leaves its limits by {excess:.4f}")
    velocity = float(np.max(np.abs(trajectory.velocities) / robot.velocity, initial=0.0))
    acceleration = float(np.max(np.abs(trajectory.accelerations) / robot.acceleration, initial=0.0))
    for name, ratio in (("velocity", velocity), ("acceleration", acceleration)):
        if ratio > 1.0 + RATIO_TOLERANCE:
            violations.append(f"{name} reaches {ratio:.3f} of its limit")
    if start is not None and np.max(np.abs(q[0] - start)) > START_TOLERANCE:
        violations.append("the trajectory does not begin at the start")
    steps = np.diff(q, axis=0)
    metrics = Metrics(
        M_c=distance_checks.core_distance((*scene.static, *scene.avoid), spheres),
        M_p=m_p,
        stem_projection=projection,
        **distances,
        goal_error=goal_error,
        goal_axis_error=axis_error,
        limit_violation=excess,
        max_step=float(np.max(np.abs(steps))),
        path_length=float(np.sum(np.linalg.norm(steps, axis=1))),
        smoothness=float(np.sqrt(np.mean(np.sum(trajectory.accelerations**2, axis=1)))),
        duration=trajectory.duration,
        velocity_ratio=velocity,
        acceleration_ratio=acceleration,
    )
    return Judgement(metrics, tuple(violations), tuple(contacts))


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
    if direction is None:
        return error, None
    unit = np.asarray(direction) / np.linalg.norm(direction)
    angle = float(np.arctan2(np.linalg.norm(np.cross(axis, unit)), axis @ unit))
    if angle > AXIS_TOLERANCE:
        violations.append(f"the tool axis ends {np.rad2deg(angle):.1f} degrees off the approach")
    return error, angle


def _passing(
    scene: Scene, tips: FloatArray, gripper_radius: float, violations: list[str]
) -> tuple[dict[str, float | None], dict[str, float | None]]:
    """M_p at the knot where the tool passes each pushable (the last passage), and y_g·S_n."""
    m_p: dict[str, float | None] = {}
    projection: dict[str, float | None] = {}
    lateral, up = scene.frame[1], scene.frame[2]
    for thing in scene.pushables:
        off = tips - thing.position
        height = off @ up
        crossings = np.flatnonzero(np.sign(height[:-1]) != np.sign(height[1:]))
        if len(crossings):
            before = int(crossings[-1])
            knot = before if abs(height[before]) <= abs(height[before + 1]) else before + 1
            m_p[thing.id] = float(off[knot] @ lateral)
        else:
            m_p[thing.id] = None
        if thing.stem is None:
            projection[thing.id] = None
            continue
        stem = np.asarray(thing.stem.points[1]) - np.asarray(thing.stem.points[0])
        share = float(lateral @ stem)
        projection[thing.id] = share
        flat = stem - (stem @ up) * up
        passed = m_p[thing.id]
        if passed is None or np.linalg.norm(flat) < DECIDED * np.linalg.norm(stem):
            continue
        at = off[knot] - (off[knot] @ up) * up
        near = float(np.linalg.norm(at)) < thing.radius + 2.0 * gripper_radius
        if not near and not _in_the_way(scene, thing, gripper_radius):
            continue
        side = float(at @ flat)
        if side > 0.0:
            violations.append(f"the tool passes {thing.id} on the side of its stem")
    return m_p, projection


def _in_the_way(scene: Scene, thing: SceneObject, gripper_radius: float) -> bool:
    """Whether a straight approach would push this pushable (method §4, 1)."""
    if scene.target is None:
        return False
    off = thing.position - scene.target.position
    along = float(off @ scene.frame[2])
    aside = float(np.linalg.norm(off - along * scene.frame[2]))
    return -0.2 <= along < 0.0 and aside <= 1.5 * gripper_radius
