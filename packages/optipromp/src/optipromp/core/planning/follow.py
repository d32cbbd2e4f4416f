r"""Following a tool path: the primitive is conditioned on the path, then led along it exactly.

The ProMP's weights w ~ N(μ, Σ) are conditioned on the start and the goal configuration (exactly, at
rest) and on tool points and tool axes of the path at a few *stations*. With rows H, the joints at
the stations or the Jacobian of the tool there, and noise R,

.. math:: w = \mu + \Sigma H^T (H \Sigma H^T + R)^{-1} (y - H\mu)

is one Gaussian update, that of :class:`optipromp.core.promp.gaussian.Update`. It is written out
here to keep the order of its sums: the end rows are exact to a variance of 1e-10, and another order
changes plans by 1e-7 rad. The update is iterated, because the Jacobian depends on the
configuration. The arm's posture, which the path leaves free, stays as it was demonstrated. Inverse
kinematics then removes the remaining millimetres between the tool and the path.

At the end stand the other starts of the optimisation: along the constraints of a path, and round
obstacles by the corners of :mod:`optipromp.core.planning.collision`.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from optipromp.core.arrays import FloatArray, frozen, lengths
from optipromp.core.budget import Budget
from optipromp.core.optimization.costs import Cost
from optipromp.core.optimization.costs.tool import CorridorCost, UprightCost
from optipromp.core.planning import collision
from optipromp.core.planning.goals import clearance
from optipromp.core.planning.options import Searched
from optipromp.core.planning.parameters import CONSTRAINT, FOLLOW, SOLVE, TREE, WAYPOINT
from optipromp.core.planning.primitive import led_through
from optipromp.core.planning.task import Task
from optipromp.core.promp.conditioning import condition_joints
from optipromp.core.promp.gaussian import add_noise
from optipromp.core.promp.model import ProMP
from optipromp.core.promp.tasks import JointPoint
from optipromp.core.pushing.path import ToolPath
from optipromp.core.robots import ik
from optipromp.core.robots.ik import level
from optipromp.core.robots.model import Robot
from optipromp.core.scenes.goals import PathConstraints
from optipromp.core.scenes.scene import PoseGoal
from optipromp.core.trajectory import Trajectory


@dataclass(frozen=True)
class Waypoints:
    """The ``count`` of a trajectory's waypoints, and the index of the ``first`` on the path."""

    count: int
    first: int

    @property
    def phase(self) -> float:
        """Phase of the first waypoint on the path."""
        return self.first / (self.count - 1)

    @property
    def phases(self) -> FloatArray:
        """Phase (T,) of each waypoint."""
        return np.linspace(0.0, 1.0, self.count)


@dataclass(frozen=True, eq=False)
class Start:
    """The start of an optimisation."""

    primitive: FloatArray  # (T, n) the conditioned ProMP
    followed: FloatArray  # (T, n) the conditioned ProMP, led along the path
    waypoints: Waypoints  # their number, and the first on the path
    path: ToolPath | None  # the tool path that is followed; None where there is none
    # the trajectory through ``followed``, where it runs already and is not optimised
    running: Trajectory | None = None


def starts(
    task: Task, path: ToolPath, promp: ProMP, options: Searched, goals: FloatArray,
    most: int | None = None,
) -> Iterator[Start]:  # fmt: skip
    """The primitive conditioned on start, path and goal, and led along the path.

    There is one start for each of the goal configurations ``goals`` (m, n) from which the arm can
    follow the path back, the fewest waypoints first. At ``most`` so many goals are tried. A goal
    from which the path cannot be followed exactly gives no start.
    """
    assert isinstance(task.goal, PoseGoal)
    share = np.linspace(1.0, 0.0, FOLLOW.stations)
    points, axes = path.at(share), task.axes(share)
    tracked = []
    for goal in goals:
        back, errors = ik.track(task.robot, points, axes, goal)
        if errors.max() < FOLLOW.tracked:
            stations = back[::-1]
            tracked.append((goal, stations, _waypoints(task, stations, path, options)))
    tracked.sort(key=lambda item: item[2].count)
    for goal, stations, waypoints in tracked[:most]:
        start = _follow(task, path, promp, goal, stations, waypoints)
        if start is not None:
            yield start


def _waypoints(task: Task, stations: FloatArray, path: ToolPath, options: Searched) -> Waypoints:
    """Waypoints such that no joint moves much over ``max_step``, before the path and on it.

    ``stations`` (S, n) are configurations along the path.
    """
    step = WAYPOINT.share * options.max_step
    reach = 0.0
    if task.underway.entry is None:  # the tool is before its path
        reach = max(reach_count(stations[0] - task.start, options.max_step), WAYPOINT.fewest_reach)
    turn = float(np.abs(np.diff(stations, axis=0)).max(axis=1).sum())
    slowed = 1.0 / (1.0 - 0.5 * WAYPOINT.braking)
    approach = slowed * max(
        turn / step,
        path.length / min(WAYPOINT.tool_step, WAYPOINT.tool_time * path.speed),
        WAYPOINT.fewest_approach,
    )
    total = options.waypoints or within_limits(10 * np.ceil((reach + approach) / 10))
    first = round(reach / (reach + approach) * (total - 1))
    if reach:
        first = int(np.clip(first, 1, total - 2))
    return Waypoints(total, first)


def reach_count(turns: FloatArray, max_step: float) -> float:
    """Steps of a smooth reach by ``turns`` (n,), such that none is over ``max_step``."""
    return WAYPOINT.peak * float(np.abs(turns).max()) / (WAYPOINT.share * max_step)


def free_count(turns: FloatArray, max_step: float) -> int:
    """Number of waypoints of a reach by ``turns`` (n,) that no path follows."""
    return within_limits(np.ceil(reach_count(turns, max_step)) + 1)


def within_limits(count: float) -> int:
    """``count``, clipped to the least and the largest number of waypoints."""
    return int(min(max(count, WAYPOINT.fewest), WAYPOINT.most))


def braked(share: FloatArray) -> FloatArray:
    """Shares (m,) of the path's length that the tool has passed at shares (m,) of its time.

    The speed is constant, then falls to zero with a continuous acceleration.
    """
    late = np.maximum(share - (1.0 - WAYPOINT.braking), 0.0) / WAYPOINT.braking
    gone = np.minimum(share, 1.0 - WAYPOINT.braking) + WAYPOINT.braking * (
        late - late**3 + 0.5 * late**4
    )
    return np.asarray(gone / (1.0 - 0.5 * WAYPOINT.braking))


def _follow(
    task: Task, path: ToolPath, promp: ProMP, goal: FloatArray, stations: FloatArray,
    waypoints: Waypoints,
) -> Start | None:  # fmt: skip
    """The start to a goal (n,) through configurations ``stations`` (S, n); None: out of reach."""
    assert isinstance(task.goal, PoseGoal)
    robot, first, z = task.robot, waypoints.first, waypoints.phases
    share = np.linspace(0.0, 1.0, FOLLOW.stations)
    table = np.linspace(0.0, 1.0, FOLLOW.braked)
    times = np.interp(share, braked(table), table)  # the inverse of braked
    phases = z[first] + (1.0 - z[first]) * times
    poses = path.at(share), task.axes(share)
    weights = conditioned(robot, promp, task.start, goal, *poses, stations, phases)
    q = promp.basis.evaluate(waypoints.count) @ weights.T
    q[0], q[-1] = task.start, goal
    share = braked((z[first:] - z[first]) / (1.0 - z[first]))
    points, axes = path.at(share), task.axes(share)
    on_path, errors = ik.each(robot, points, axes, q[first:])
    if errors.max() > FOLLOW.tracked:
        return None
    on_path[-1] = goal
    on_path = level(robot, on_path[::-1], task.scene.frame[0], path=True)[::-1]
    if first == 0:  # the arm is on the path, perhaps in another posture
        on_path = on_path + (1.0 - z[:, None]) * (task.start - on_path[0])
        on_path, errors = ik.each(robot, points, axes, on_path)
        on_path[0], on_path[-1] = task.start, goal
        return Start(q, on_path, waypoints, path) if errors.max() < FOLLOW.tracked else None
    off, u = on_path - q[first:], np.arange(first)[:, None] / first
    slope = (off[1] - off[0]) * first
    # offsets from 0 with slope 0 to the first on the path with its slope
    lead_in = off[0] * u**2 * (3.0 - 2.0 * u) + slope * u**2 * (u - 1.0)
    return Start(q, np.vstack([q[:first] + lead_in, on_path]), waypoints, path)


def conditioned(
    robot: Robot, promp: ProMP, start: FloatArray, goal: FloatArray, points: FloatArray,
    axes: FloatArray, near: FloatArray, phases: FloatArray,
) -> FloatArray:  # fmt: skip
    """Mean weights (n, K) of the ProMP given start, goal and tool poses at stations.

    ``start``: (n,) at phase 0; ``goal`` (n,) at phase 1; both at rest. ``points``: (S, 3) tool
    points at the stations [m]; the last is at the goal. ``axes``: (S, 3) tool axes at the stations.
    ``near``: (S, n) configurations at the stations, with which the iteration begins. ``phases``:
    (S,) of the stations.
    """
    n, stations = promp.n_joints, len(points) - 1
    values, cross, joint = _prior_at(promp, tuple(phases[:-1].tolist()))
    mean = (values @ promp.mean.T).ravel()  # by place, then joint
    ends = 4 * n
    rows = np.zeros((ends + 6 * stations, len(mean)))
    rows[:ends, :ends] = np.eye(ends)
    wanted = np.concatenate([start, goal, np.zeros(2 * n), np.zeros(6 * stations)])
    noise = np.full(len(rows), FOLLOW.station_deviation**2)
    noise[:ends] = 1e-10  # [rad²] nearly exact
    q = np.array(near[:-1])
    for _ in range(FOLLOW.linearisations):
        point, pointing, jp, ja = robot.tool_map(q)
        jacobian = np.concatenate([jp, FOLLOW.axis_lever * ja], axis=1)
        turn = FOLLOW.axis_lever * (axes[:-1] - pointing)
        off = np.concatenate([points[:-1] - point, turn], axis=1)
        for s in range(stations):
            low, at = ends + 6 * s, ends + n * s
            rows[low : low + 6, at : at + n] = jacobian[s]
        wanted[ends:] = (off + np.einsum("sij,sj->si", jacobian, q)).ravel()
        spread = rows @ joint
        total = spread @ rows.T
        add_noise(total, noise)
        force = np.linalg.solve(total, wanted - rows @ mean)
        there = (mean + spread.T @ force)[ends:].reshape(stations, n)
        step = np.clip(there - q, -FOLLOW.posture_step, FOLLOW.posture_step)
        q = np.clip(q + step, robot.lower, robot.upper)
    return np.asarray(promp.mean + (cross @ (rows.T @ force)).reshape(promp.mean.shape))


@lru_cache(maxsize=16)
def _prior_at(promp: ProMP, phases: tuple[float, ...]) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Bases (P, K) at P places, and the prior's covariances there.

    The places are start, goal, the velocities at both, and the stations. The covariances are those
    of the weights with the joints (nK, Pn) and of the joints (Pn, Pn), by place, then joint.
    """
    n, count = promp.mean.shape
    ends = np.array([0.0, 1.0])
    at = promp.basis.evaluate
    values = np.vstack([at(ends), at(ends, 1), at(np.array(phases))])
    cross = promp.covariance.reshape(n * count, n, count) @ values.T
    cross = np.ascontiguousarray(cross.transpose(0, 2, 1)).reshape(n * count, -1)
    joint = (values @ cross.reshape(n, count, -1)).transpose(1, 0, 2).reshape(cross.shape[1], -1)
    return frozen(values), frozen(cross), frozen(joint)


def uprighted(task: Task) -> Task:
    """The task whose robot has the axis that is held upright for its tool axis.

    Where a path's constraints hold, the point of the tool and this axis are those of the motion;
    elsewhere the nearest that are allowed, to which inverse kinematics leads the arm.
    """
    path = task.scene.path
    if path is None or path.upright is None:
        return task
    axis = frozen(task.robot.tool_rotation @ path.upright.axis)
    if float(np.abs(axis - task.robot.tool_axis).max()) < 1e-12:  # rounding: the robot as it is
        return task
    return replace(task, robot=replace(task.robot, tool_axis=axis))


def path_costs(path: PathConstraints | None, count: int) -> list[Cost]:
    """The penalties of a path's constraints at ``count`` waypoints, with a margin for the curve."""
    out: list[Cost] = []
    if path is None:
        return out
    if path.upright is not None:
        chord = 2.0 * math.sin(0.5 * CONSTRAINT.share * math.radians(path.upright.angle))
        out.append(UprightCost(SOLVE.kept, path.upright.direction[None], chord, 0))
    if path.plane is not None:
        points = np.tile(path.plane.point, (count, 1))
        within = CONSTRAINT.share * path.plane.within
        axes = path.plane.normal[None]
        out.append(CorridorCost(SOLVE.must, points, axes, within, 0, SOLVE.within))
    return out


def keeps_path(task: Task, q: FloatArray) -> FloatArray:
    """Whether configurations ``q`` (m, n) keep the constraints."""
    points, axes = uprighted(task).robot.tool_pose(q)
    near, turned = _allowed(task.scene.path, points, axes, 1.0)
    off = lengths(points - near) + lengths(axes - turned)
    return np.asarray(off < 1e-6)  # [m or rad] rounding


def constrained(task: Task, start: Start) -> Start:
    """The start, led to the nearest poses of the tool that keep the constraints, if any."""
    if task.scene.path is None:
        return start
    q = start.followed
    points, axes = task.robot.tool_pose(q)
    points, axes = _allowed(task.scene.path, points, axes, CONSTRAINT.share)
    allowed, errors = ik.each(task.robot, points[1:-1], axes[1:-1], q[1:-1])
    if errors.max(initial=0.0) > CONSTRAINT.reached:
        return start
    return replace(start, followed=np.vstack([q[:1], allowed, q[-1:]]))


def _allowed(
    path: PathConstraints | None, points: FloatArray, axes: FloatArray, share: float
) -> tuple[FloatArray, FloatArray]:
    """The nearest tool points (m, 3) and axes (m, 3) within ``share`` of the limits."""
    if path is not None and path.plane is not None:
        height = (points - path.plane.point) @ path.plane.normal
        most = share * path.plane.within
        points = points - (height - np.clip(height, -most, most))[:, None] * path.plane.normal
    if path is not None and path.upright is not None:
        up, angle = path.upright.direction, share * math.radians(path.upright.angle)
        along = axes @ up
        aside = axes - along[:, None] * up
        flat = lengths(aside)
        leaning = np.arctan2(flat, along) > angle
        flat_axis = aside / np.maximum(flat, 1e-12)[:, None]
        edge = math.cos(angle) * up + math.sin(angle) * flat_axis
        axes = np.where(leaning[:, None], edge, axes)
    return points, axes


def free_starts(
    task: Task, options: Searched, promp: ProMP, goals: FloatArray, rng: np.random.Generator,
    budget: Budget,
) -> Iterator[Start]:  # fmt: skip
    """Starts of a reach without a tool path, to goal configurations ``goals`` (m, n).

    First comes the primitive conditioned on start and goal, the nearest goal first, where it does
    not go deep into obstacles. Ways round the obstacles follow, then the deep primitives.
    """
    order = np.argsort(np.abs(goals - task.start).max(axis=1), kind="stable")
    deep = []
    for goal in goals[order]:
        count = options.waypoints or free_count(goal - task.start, options.max_step)
        q = led_through(promp, task.start, np.array([1.0]), goal[None], np.zeros(1), count)
        start = Start(q, q, Waypoints(count, count - 1), None)
        if clearance(task, q).min() < -TREE.deep:
            deep.append(start)
        else:
            yield start
    ends = enumerate([JointPoint(0.0, task.start), JointPoint(1.0, goals[order[0]])])
    shown = condition_joints(promp, ends).sample(rng, TREE.shown, WAYPOINT.fewest)
    for _ in range(TREE.rounds):
        corners = collision.way(task, goals, shown.reshape(-1, shown.shape[2]), rng, budget)
        if corners is None:
            break
        count = options.waypoints or within_limits(way_count(corners, options) + 1)
        q = along_corners(corners, count)
        yield Start(q, q, Waypoints(len(q), len(q) - 1), None)
    yield from deep


def led_round(
    task: Task, start: Start, options: Searched, rng: np.random.Generator, budget: Budget
) -> Iterator[Start]:
    """The start to the same tool path whose reach goes round obstacles, if there is a way."""
    first, last = start.waypoints.first, start.waypoints.count - 1
    corners = None
    if first:
        corners = collision.way(
            task, start.followed[first : first + 1], start.primitive[:first], rng, budget
        )
    if corners is None:
        return
    reach = first
    if not options.waypoints:
        most = WAYPOINT.most - (last - first)
        reach = max(int(min(way_count(corners, options), most)), WAYPOINT.fewest_reach)
    q = np.vstack([along_corners(corners, reach + 1, stop=False)[:-1], start.followed[first:]])
    reached = np.linspace(0, first, reach, endpoint=False)
    rows = np.concatenate([reached, np.arange(first, last + 1)])
    shown = np.stack([np.interp(rows, np.arange(last + 1), one) for one in start.primitive.T], 1)
    yield Start(shown, q, Waypoints(len(q), reach), start.path)


def way_count(corners: FloatArray, options: Searched) -> float:
    """Number of steps along a way (k, n), such that none is over ``max_step``."""
    turns = float(np.abs(np.diff(corners, axis=0)).max(axis=1).sum())
    return float(np.ceil(turns / (1.0 - TREE.ramp) / (WAYPOINT.share * options.max_step)))


def along_corners(corners: FloatArray, count: int, *, stop: bool = True) -> FloatArray:
    """Waypoints (count, n) along corners (k, n), from rest, and with ``stop`` to rest.

    Between the ends, the joint that turns most on an edge has the same speed on all edges.
    """
    u = np.linspace(0.0, 1.0, count)
    done = _started(u)
    if stop:
        done = np.where(u < 0.5, done, 1.0 - TREE.ramp - _started(1.0 - u))
    turned = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(corners, axis=0)).max(axis=1))])
    at = done / done[-1] * turned[-1]
    return np.stack([np.interp(at, turned, one) for one in corners.T], axis=1)


def _started(u: FloatArray) -> FloatArray:
    """Distance (m,) at times ``u`` (m,) from rest; the speed rises smoothly to 1."""
    x = np.minimum(u / TREE.ramp, 1.0)
    return np.asarray(TREE.ramp * (x**3 - 0.5 * x**4) + np.maximum(u - TREE.ramp, 0.0))
