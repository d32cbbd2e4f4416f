r"""A trajectory against the goals, its path's constraints, and lines between way points.

One of the goals must be reached. A motion of any origin does not tell when it is on which line. Of
all ways to divide it, the one counts whose largest deviation is least. With the deviation
:math:`d_k(m)` of check m from line k, and that of the motion between two checks from point k,
:math:`e_k(m)`, both in units of what is allowed, the least largest deviation of a motion that is on
line k at check m is

.. math:: c_k(m) = \max(d_k(m), \min(c_k(m-1), \max(c_{k-1}(m-1), e_k(m-1)))), \quad c_{-1} = 0.
"""

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from optipromp.core.arrays import FloatArray, IntArray, frame_along
from optipromp.core.geometry.shapes import FINE, Capsule, Cone, Ellipsoid, PointCloudShape, Sphere
from optipromp.core.judging.curve import along
from optipromp.core.judging.kinematics import fitting, last_poses
from optipromp.core.robots.model import Robot
from optipromp.core.robots.tool_protocol import Tool
from optipromp.core.scenes.goals import (
    Goal,
    JointGoal,
    Lines,
    PoseGoal,
    RegionGoal,
    axes_of,
    pose_name,
)
from optipromp.core.scenes.scene import Scene, SceneObject
from optipromp.core.trajectory import Trajectory


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

    ``scene``: with the goals, or a target. ``last``: (n,) configuration at the end. ``tip``: (3,)
    tool point there [m]. ``axis``: (3,) tool axis there. ``time``: of the end [s].
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
    error = float(np.max(np.abs(robot.turns.missed(last, goal.joints))))
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
        frames = poses_of_tool(robot, last[None])[1]
        angle, what = float(_angles(frames, goal.rotation)[0]), "tool"
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


def poses_of_tool(robot: Robot, q: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Tool points (M, 3) [m], axes (M, 3, 3) of the tool's frame in columns, at ``q`` (M, n)."""
    points, turns = last_poses(robot, q)
    turn = np.eye(3) if robot.tool is None else np.asarray(robot.tool.rotation)
    return points, np.asarray(turns @ robot.flange_rotation @ turn)


STEP = 1e-3  # [m] of the tool between two checks: a choice
TURN = 0.02  # [rad or m] of all joints together between two checks: a choice
SPARE = 0.02  # [1] share by which the tool may exceed its speed on the lines: a choice


class Deviation(NamedTuple):
    """Distances (M,) [m] of the tool point and angles (M,) [rad] of the tool."""

    off: FloatArray
    angle: FloatArray

    def share(self, lines: Lines) -> FloatArray:
        """The larger of both (M,), as a share of what is allowed."""
        return np.asarray(np.maximum(self.off / lines.within, self.angle / AXIS_TOLERANCE))


def left_path(scene: Scene, robot: Robot, times: FloatArray, q: FloatArray) -> list[Violation]:
    """Violations of the path's constraints, each at its largest amount.

    ``times``: (M,) of the checks [s]. ``q``: (M, n) configurations at the checks.
    """
    out: list[Violation] = []
    if scene.path is None:
        return out
    upright, plane = scene.path.upright, scene.path.plane
    points, frames = poses_of_tool(robot, q)
    if upright is not None:
        axes = frames @ upright.axis
        across = np.linalg.norm(np.cross(axes, upright.direction), axis=1)
        off = np.arctan2(across, axes @ upright.direction)
        worst = int(np.argmax(off))
        if off[worst] > math.radians(upright.angle) + BORDER:
            text = (
                f"the tool leans {math.degrees(off[worst]):.1f} degrees at {times[worst]:.2f} s "
                f"(path.upright: at most {upright.angle:g})"
            )
            amount = float(off[worst])
            out.append(Violation("upright", text, "", float(times[worst]), amount, "rad"))
    if plane is not None:
        far = np.abs((points - plane.point) @ plane.normal)
        worst = int(np.argmax(far))
        if far[worst] > plane.within + BORDER:
            text = (
                f"the tool is {1e3 * far[worst]:.1f} mm off its plane at {times[worst]:.2f} s "
                f"(path.plane: at most {1e3 * plane.within:g})"
            )
            amount = float(far[worst])
            out.append(Violation("plane", text, "", float(times[worst]), amount, "m"))
    return out


def left_lines(
    scene: Scene, robot: Robot, trajectory: Trajectory, points: FloatArray, waypoints: IntArray
) -> list[Violation]:
    """Violations of the straight lines between the scene's way points, at their largest amount.

    ``points``: (M, 3) tool points at the judge's checks [m]. ``waypoints``: (T,) indices of the
    trajectory's waypoints among the checks.
    """
    lines = scene.waypoints
    if lines is None:
        return []
    gone = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1)))
    turned = np.abs(np.diff(trajectory.positions, axis=0)).sum(axis=1)
    parts = np.maximum(1.1 * np.diff(gone[waypoints]) / STEP, turned / TURN)  # arcs, not chords
    times, q, _ = along(trajectory, fitting(np.ceil(np.maximum(parts, 1.0)))[0])
    tips, frames = poses_of_tool(robot, q)
    poses = lines.to(scene.goals[0])
    where = [
        _from_line(a.position, b.position, axes_of(a), axes_of(b), tips, frames)
        for a, b in pairwise(poses)
    ]
    visits = [_from_point(a.position, axes_of(a), tips, frames) for a in poses[:-1]]
    worst, k, m, visit, began = _divided(
        [one.share(lines) for one in where], [one.share(lines) for one in visits]
    )
    out = []
    if worst > 1.0 + 1e-6:  # rounding
        count = len(lines.points)
        names = [pose_name(i, count) for i in range(count + 1)]
        found = visits[k] if visit else where[k]
        at = names[k] if visit else f"the line from {names[k]} to {names[k + 1]}"
        off, angle, when = float(found.off[m]), float(found.angle[m]), float(times[m])
        if off / lines.within >= angle / AXIS_TOLERANCE:
            text = (
                f"the tool is {1e3 * off:.1f} mm off {at} at {when:.2f} s "
                f"(at most {1e3 * lines.within:g})"
            )
            out.append(Violation("line", text, "", when, off, "m"))
        else:
            text = (
                f"the tool is turned {math.degrees(angle):.1f} degrees off {at} at {when:.2f} s "
                f"(at most {math.degrees(AXIS_TOLERANCE):g})"
            )
            out.append(Violation("line", text, "", when, angle, "rad"))
    elif lines.speed is not None and began < len(times) - 1:
        steps = np.linalg.norm(np.diff(tips[began:], axis=0), axis=1)
        speeds = steps / np.diff(times[began:])
        at_most = int(np.argmax(speeds))
        if speeds[at_most] > lines.speed * (1.0 + SPARE):
            speed, when = float(speeds[at_most]), float(times[began + at_most])
            text = (
                f"the tool moves at {speed:.3f} m/s on the lines at {when:.2f} s "
                f"(waypoints.speed: at most {lines.speed:g})"
            )
            out.append(Violation("line speed", text, "", when, speed, "m/s"))
    return out


def _from_line(
    a: FloatArray, b: FloatArray, u: FloatArray, v: FloatArray, tips: FloatArray, frames: FloatArray
) -> Deviation:
    """From the line between points ``a`` and ``b`` (3,), with directions ``u``, ``v`` (A, 3)."""
    way, now = b - a, _stated(frames, len(u))
    length = float(np.linalg.norm(way))
    share = np.clip((tips - a) @ way / max(length, 1e-12) ** 2, 0.0, 1.0)
    off = np.linalg.norm(tips - a - share[:, None] * way, axis=1)
    if not len(u):
        return Deviation(off, np.zeros(len(off)))
    about = np.cross(u, v).sum(axis=0)  # along the axis of the turn, for one axis and for frames
    turn = float(_angles(u[None], v)[0])
    if turn > 1e-9:
        about /= np.linalg.norm(about)
        if length < 1e-6:  # the tool turns in place
            share = np.clip(_angles(now, u) / turn, 0.0, 1.0)
    along_axis = (u @ about)[:, None] * about
    angle = (share * turn)[:, None, None]
    wanted = along_axis + np.cos(angle) * (u - along_axis) + np.sin(angle) * np.cross(about, u)
    return Deviation(off, _angles(now, wanted))


def _from_point(a: FloatArray, u: FloatArray, tips: FloatArray, frames: FloatArray) -> Deviation:
    """Of the motion from each check to the next from a point ``a`` (3,), directions ``u`` (A, 3).

    The last row is that of the last check.
    """
    step = np.diff(tips, axis=0, append=tips[-1:])
    squared = np.maximum(np.einsum("mi,mi->m", step, step), 1e-18)
    share = np.clip(np.einsum("mi,mi->m", a - tips, step) / squared, 0.0, 1.0)
    off = np.linalg.norm(tips + share[:, None] * step - a, axis=1)
    return Deviation(off, _angles(_stated(frames, len(u)), u) if len(u) else np.zeros(len(off)))


def _stated(frames: FloatArray, count: int) -> FloatArray:
    """The tool's directions (M, A, 3) that a pose with ``count`` directions states."""
    turned = frames.transpose(0, 2, 1)
    return turned if count == 3 else turned[:, 2:][:, :count]


def _angles(now: FloatArray, wanted: FloatArray) -> FloatArray:
    """Angles (M,) between directions ``now`` (M, A, 3) and ``wanted``, A of 1 or 3 [rad].

    The chord of one direction is 2 sin(θ/2); the Frobenius norm of frames is √2 times that.
    """
    chord = np.sqrt(np.square(now - wanted).sum(axis=(1, 2)) / (1 if now.shape[1] == 1 else 2))
    return np.asarray(2.0 * np.arcsin(np.minimum(0.5 * chord, 1.0)))


def _divided(
    where: list[FloatArray], visits: list[FloatArray]
) -> tuple[float, int, int, bool, int]:
    """The least largest deviation; its line or point, its check, and whether it is of a point.

    Last comes the check at which the motion is at the first point.
    """
    count, before = len(where[0]), np.zeros(len(where[0]))
    costs, enters = [], []
    for k, (line, visit) in enumerate(zip(where, visits, strict=True)):
        enter = np.append(visit[0] if k == 0 else np.inf, np.maximum(before, visit)[:-1])
        cost, least = np.empty(count), math.inf
        for m, (d, e) in enumerate(zip(line.tolist(), enter.tolist(), strict=True)):
            least = max(d, min(least, e))
            cost[m] = least
        costs.append(cost)
        enters.append(enter)
        before = cost
    k, m, worst = len(where) - 1, count - 1, float(costs[-1][-1])
    found: tuple[int, int, bool] | None = None
    while True:
        if found is None and where[k][m] >= worst:
            found = k, m, False
        if m and costs[k][m - 1] < enters[k][m]:
            m -= 1
            continue
        if found is None and visits[k][max(m - 1, 0)] >= worst:
            found = k, max(m - 1, 0), True
        m = max(m - 1, 0)
        if k == 0:
            break
        k -= 1
    return worst, *(found or (0, 0, False)), m
