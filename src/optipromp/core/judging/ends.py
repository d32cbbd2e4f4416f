"""The end of a trajectory against the goals: one of them must be reached."""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from optipromp.core.arrays import BoolArray, FloatArray, frame_along
from optipromp.core.compiled import kernel
from optipromp.core.geometry.shapes import FINE, Capsule, Cone, Ellipsoid, PointCloudShape, Sphere
from optipromp.core.judging.kinematics import body_of, segments
from optipromp.core.robots.model import Robot
from optipromp.core.robots.tool_protocol import Tool
from optipromp.core.scenes.goals import Goal, JointGoal, PoseGoal, RegionGoal
from optipromp.core.scenes.scene import Scene, SceneObject


@dataclass(frozen=True)
class Violation:
    """One reason why a trajectory is not valid.

    Args:
        kind: ``contact``, ``unchecked``, ``goal``, ``axis``, ``stem side``, ``limit``,
            ``velocity``, ``acceleration``, ``jerk``, ``speed``, ``start``, ``motion``, ``drift``,
            ``stem``, ``upright``, ``plane``, ``line``, ``line speed`` or ``opening``.
        message: the reason as a sentence, which is also ``str(violation)``.
        subject: the link, joint or object concerned; empty where there is none.
        time: of the largest amount [s]; None where the violation has no time.
        amount: size of the violation, in ``unit``; for a velocity, acceleration or jerk the share
            of the limit.
    """

    kind: str
    message: str
    subject: str = ""
    time: float | None = None
    amount: float | None = None
    unit: str = ""

    def __str__(self) -> str:
        return self.message


GOAL_TOLERANCE = 1e-3  # [m], or [rad] for a goal in joints; method §5
AXIS_TOLERANCE = np.deg2rad(2.0)  # [rad]; method §5
SIDEWAYS = 0.5  # sine of the slope below which an approach comes from the side: 30 degrees
MOUTH_ROOM = 1e-3  # [m] chosen: of a target in the mouth, below which a note says its width
ACROSS = 90  # directions across an axis in half a turn: an extent is exact to 0.02 %
BORDER = 1e-6  # [m or rad] beyond the border of a tolerance region: rounding


class End(NamedTuple):
    """The end of a trajectory against one goal."""

    error: float  # of the tool point [m], or of the configuration [rad or m]
    angle: float | None  # of the tool axis or the orientation [rad]; None without one
    missed: list[Violation]  # the violations; none where the goal is reached


def ends(
    scene: Scene, robot: Robot, last: FloatArray, tip: FloatArray, axis: FloatArray, time: float
) -> tuple[End, list[str]]:
    """The end against the goal that it reaches, or else misses least; and notes.

    ``scene``: with the goals, or a target. ``robot``: with the scene's tool. ``last``: (n,)
    configuration at the end. ``tip``: (3,) tool point there [m]. ``axis``: (3,) tool axis there.
    ``time``: of the end [s].
    """
    if scene.target is not None:
        aim = scene.target.position + scene.approach.shift
        end = _pose(aim, scene.frame[2], tip, axis, time)
        wide, notes = _in_mouth(scene, scene.target, robot.tool, axis, time)
        return end._replace(missed=[*end.missed, *wide]), notes
    found = [_against(goal, robot, last, tip, axis, time) for goal in scene.goals]
    best = min(range(len(found)), key=lambda k: (len(found[k].missed), found[k].error))
    several = len(found) > 1 and not found[best].missed
    return found[best], [f"ends at goal {best + 1} of {len(found)}"] if several else []


def _in_mouth(
    scene: Scene, target: SceneObject, tool: Tool | None, axis: FloatArray, time: float
) -> tuple[list[Violation], list[str]]:
    """What is wrong with a target that is wider across ``axis`` (3,) than a round mouth; notes.

    A target that stands and is met from the side is not taken in: the tool comes to its front.
    """
    stands = target.stem is None and abs(float(axis @ scene.up)) < SIDEWAYS
    if tool is None or tool.fingers or tool.mouth[0] <= 0.0 or stands:
        return [], []
    half, inner = half_width(target, axis), tool.mouth[0]
    text = (
        f"the half width of {target.id} across the approach is {1e3 * half:.1f} mm, that of the "
        f"tool's opening {1e3 * inner:.1f} mm"
    )
    if half > inner + BORDER:
        return [Violation("opening", text, target.id, time, half - inner, "m")], []
    return [], [text] if half > inner - MOUTH_ROOM else []


def half_width(item: SceneObject, axis: FloatArray) -> float:
    """Half of the largest extent of an object across ``axis`` (3,) [m].

    Nothing narrower than twice this lets it through; of ellipsoids, boxes and solids of revolution
    it is the radius of a circle that does.
    """
    local, shape = axis @ item.rotation, item.shape
    sine = math.hypot(local[0], local[1])
    match shape:
        case Sphere(radius=r):
            return r
        case Capsule(radius=r, length=length):
            return r + 0.5 * length * sine
        case Cone(radius=r, tip=tip, length=length):
            return max(r, tip, 0.5 * (r + tip + length * sine))
        case Ellipsoid(radii=radii):  # the larger semi-axis of an ellipse of this sum and product
            square = np.square(radii)
            half = 0.5 * float(square.sum() - square @ local**2)
            product = float(square.prod() * (local**2 / square).sum())
            return math.sqrt(half + math.sqrt(max(half**2 - product, 0.0)))
    turn = np.linspace(0.0, np.pi, ACROSS, endpoint=False)
    rays = frame_along(local)[:, :2] @ [np.cos(turn), np.sin(turn)]  # (3, ACROSS)
    if isinstance(shape, PointCloudShape):
        return float(0.5 * np.ptp(shape.points @ rays, axis=0).max()) + shape.radius
    return float(0.5 * np.ptp(shape.mesh(FINE).vertices @ rays, axis=0).max())


def _against(
    goal: Goal, robot: Robot, last: FloatArray, tip: FloatArray, axis: FloatArray, time: float
) -> End:
    if isinstance(goal, PoseGoal):
        return _pose(goal.position, goal.axis, tip, axis, time)
    if isinstance(goal, RegionGoal):
        return _region(goal, robot, last, tip, axis, time)
    assert isinstance(goal, JointGoal)
    off = last - goal.joints
    turns = unlimited(robot)
    off[turns] = np.mod(off[turns] + np.pi, 2.0 * np.pi) - np.pi
    error = float(np.max(np.abs(off)))
    text = f"the end is {error:.4f} rad from the goal configuration"
    missed = Violation("goal", text, "", time, error, "rad")
    return End(error, None, [missed] if error > GOAL_TOLERANCE else [])


def _pose(
    position: FloatArray, direction: FloatArray, tip: FloatArray, axis: FloatArray, time: float
) -> End:
    error, angle = math.dist(tip, position), _between(axis.tolist(), direction.tolist())
    out = []
    if error > GOAL_TOLERANCE:
        text = f"the tool ends {error * 1e3:.1f} mm from the goal"
        out.append(Violation("goal", text, "", time, error, "m"))
    if angle > AXIS_TOLERANCE:
        text = f"the tool axis ends {np.rad2deg(angle):.1f} degrees off the approach"
        out.append(Violation("axis", text, "", time, angle, "rad"))
    return End(error, angle, out)


def _region(
    goal: RegionGoal, robot: Robot, last: FloatArray, tip: FloatArray, axis: FloatArray, time: float
) -> End:
    error, off, out = math.dist(tip, goal.position), tip - goal.position, []
    within, box = goal.within, goal.extents
    if box is not None:
        over = float(np.max(np.abs(off @ box[1]) - box[0]))
    else:
        over = error - (GOAL_TOLERANCE if within is None else float(within))
    if over > BORDER:
        where = "the goal" if within is None else "the middle of the goal's region"
        text = f"the tool ends {error * 1e3:.1f} mm from {where}, {over * 1e3:.1f} mm outside"
        out.append(Violation("goal", text, "", time, error, "m"))
    angle, what = None, "tool axis"
    if goal.axis is not None:
        angle = _between(axis.tolist(), goal.axis.tolist())
    elif goal.rotation is not None:
        angle, what = turned_by(poses_of_tool(robot, last[None])[1][0], goal.rotation), "tool"
    most = AXIS_TOLERANCE if goal.angle is None else math.radians(goal.angle)
    if angle is not None and angle > most + BORDER:
        text = (
            f"the {what} ends {np.rad2deg(angle):.1f} degrees off the goal (at most "
            f"{np.rad2deg(most):g})"
        )
        out.append(Violation("axis", text, "", time, angle, "rad"))
    return End(error, angle, out)


def _between(a: list[float], b: list[float]) -> float:
    """Angle between two vectors [rad], exact for small angles too."""
    cross = a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]
    return math.atan2(math.hypot(*cross), a[0] * b[0] + a[1] * b[1] + a[2] * b[2])


def turned_by(a: FloatArray, b: FloatArray) -> float:
    """Angle of the rotation between two frames (3, 3) [rad], exact for small angles too.

    Its sine and cosine follow from the antisymmetric part and the trace of R = a bᵀ.
    """
    r = a @ b.T
    twice = r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]
    return math.atan2(math.hypot(*twice), float(np.trace(r)) - 1.0)


def unlimited(robot: Robot) -> BoolArray:
    """Whether each joint (n,) turns without limits, and all that it drives in whole turns."""
    body = body_of(robot)
    out = ~(np.isfinite(robot.lower) | np.isfinite(robot.upper))
    for driver, slides, ratio in zip(body.driver, body.prismatic, body.ratio, strict=True):
        out[driver] &= not slides and float(ratio).is_integer()
    return np.asarray(out, dtype=np.bool_)


def poses_of_tool(robot: Robot, q: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Tool points (M, 3) [m], axes (M, 3, 3) of the tool's frame in columns, at ``q`` (M, n)."""
    turns, origins, body = np.empty((len(q), 3, 3)), np.empty((len(q), 3)), body_of(robot)
    last_poses(body, np.array(q, dtype=np.float64, order="C"), turns, origins)
    turn = np.eye(3) if robot.tool is None else np.asarray(robot.tool.rotation)
    frames = np.asarray(turns @ robot.flange_rotation @ turn)
    return np.asarray(origins + turns @ body.tool[0]), frames


@kernel
def last_poses(body, q, out, at):
    """Rotations (M, 3, 3) and origins (M, 3) of the last segment at ``q`` (M, n), in place."""
    count = body.driver.shape[0]
    turns, origins = np.empty((count, 3, 3)), np.empty((count, 3))
    for m in range(len(q)):
        segments(body, q[m], turns, origins)
        out[m] = turns[count - 1]
        at[m] = origins[count - 1]
