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
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from optipromp.core.arrays import FloatArray, frozen
from optipromp.core.planning.options import Searched
from optipromp.core.planning.parameters import FOLLOW, WAYPOINT
from optipromp.core.planning.task import Task
from optipromp.core.promp.gaussian import add_noise
from optipromp.core.promp.model import ProMP
from optipromp.core.pushing.path import ToolPath
from optipromp.core.robots import ik
from optipromp.core.robots.model import Robot
from optipromp.core.robots.roll import level
from optipromp.core.scenes.scene import PoseGoal
from optipromp.core.trajectory import Trajectory


@dataclass(frozen=True)
class Waypoints:
    """The ``count`` of a trajectory's waypoints, and the index of the ``first`` on the path."""

    count: int
    first: int

    @staticmethod
    def at_phase(count: int, phase: float) -> "Waypoints":
        """``count`` waypoints, of which the first at or after a phase is the first on the path."""
        return Waypoints(count, int(np.ceil(phase * (count - 1) - 1e-9)))

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
    """The start of an optimisation.

    Attributes:
        primitive: (T, n) the conditioned ProMP.
        followed: (T, n) the conditioned ProMP, led along the path.
        waypoints: their number, and the first on the path.
        path: the tool path that is followed; None where there is none.
        running: the trajectory through ``followed``, where it runs already and is not optimised.
    """

    primitive: FloatArray
    followed: FloatArray
    waypoints: Waypoints
    path: ToolPath | None
    running: Trajectory | None = None


def starts(
    task: Task,
    path: ToolPath,
    promp: ProMP,
    options: Searched,
    goals: FloatArray,
    most: int | None = None,
) -> Iterator[Start]:
    """The primitive conditioned on start, path and goal, and led along the path.

    There is one start for each of the goal configurations ``goals`` (m, n) from which the arm can
    follow the path back, the fewest waypoints first. At ``most`` so many goals are tried. A goal
    from which the path cannot be followed exactly gives no start.
    """
    assert isinstance(task.goal, PoseGoal)
    share = np.linspace(1.0, 0.0, FOLLOW.stations)
    points, axes = path.at(share), task.axes(share)
    found = []
    for goal in goals:
        back, errors = ik.track(task.robot, points, axes, goal)
        if errors.max() < FOLLOW.tracked:
            stations = back[::-1]
            found.append((goal, stations, _waypoints(task, stations, path, options)))
    found.sort(key=lambda item: item[2].count)
    for goal, stations, waypoints in found[:most]:
        start = _follow(task, path, promp, goal, stations, waypoints)
        if start is not None:
            yield start


def _waypoints(task: Task, stations: FloatArray, path: ToolPath, options: Searched) -> Waypoints:
    """Waypoints such that no joint moves much over ``max_step``, before the path and on it.

    ``stations`` (S, n) are configurations along the path.
    """
    step = WAYPOINT.share * options.max_step
    reach = 0.0
    if task.entry is None:  # the tool is before its path
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
    task: Task,
    path: ToolPath,
    promp: ProMP,
    goal: FloatArray,
    stations: FloatArray,
    waypoints: Waypoints,
) -> Start | None:
    """The start to a goal (n,) through configurations ``stations`` (S, n); None: out of reach."""
    assert isinstance(task.goal, PoseGoal)
    robot, first, z = task.robot, waypoints.first, waypoints.phases
    share = np.linspace(0.0, 1.0, FOLLOW.stations)
    table = np.linspace(0.0, 1.0, 401)
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
    followed = np.vstack([q[:first] + _lead_in(on_path - q[first:], first), on_path])
    return Start(q, followed, waypoints, path)


def _lead_in(off: FloatArray, count: int) -> FloatArray:
    """Offsets (count, n) from 0 with slope 0 to ``off[0]`` with its slope; ``off`` (m, n)."""
    u = np.arange(count)[:, None] / count
    slope = (off[1] - off[0]) * count
    return np.asarray(off[0] * u**2 * (3.0 - 2.0 * u) + slope * u**2 * (u - 1.0))


def conditioned(
    robot: Robot,
    promp: ProMP,
    start: FloatArray,
    goal: FloatArray,
    points: FloatArray,
    axes: FloatArray,
    near: FloatArray,
    phases: FloatArray,
) -> FloatArray:
    """Mean weights (n, K) of the ProMP given start, goal and tool poses at stations.

    ``robot``: the arm with its tool. ``promp``: the prior. ``start``: (n,) at phase 0; ``goal``
    (n,) at phase 1; both at rest. ``points``: (S, 3) tool points at the stations [m]; the last is
    at the goal. ``axes``: (S, 3) tool axes at the stations. ``near``: (S, n) configurations at the
    stations, with which the iteration begins. ``phases``: (S,) of the stations.
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
