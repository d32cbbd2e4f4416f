r"""Timing: the times of a trajectory's waypoints, such that its curve keeps every limit.

The curve is the quintic spline through the waypoints
(:class:`optipromp.core.trajectory.Trajectory`). Within an interval its derivatives stay in the
convex hull of their control points. Where the hull keeps the limits of velocity v, acceleration a
and jerk j, the curve keeps them at every instant. Stretching all times by c divides the k-th
derivative by :math:`c^k`, so the least stretch is

.. math:: c = \max\left(|\dot q|/v,\; (|\ddot q|/a)^{1/2},\; (|\dddot q|/j)^{1/3}\right).
"""

import math

import numpy as np

from optipromp.core.arrays import BoolArray, FloatArray, lengths
from optipromp.core.planning.fastest import fastest, needs, ramped, shares, within
from optipromp.core.planning.options import Timed
from optipromp.core.planning.parameters import TIMING, UNDERWAY
from optipromp.core.planning.task import Task, stands
from optipromp.core.pushing.parameters import PUSH
from optipromp.core.pushing.path import STEP, along, evenly, length
from optipromp.core.robots.model import Robot
from optipromp.core.trajectory import State, Trajectory, control_points

Slow = int | BoolArray | None
"""The intervals in which the tool is to be slow: from a waypoint on, by mask (T-1,), or none."""


def timed(
    task: Task,
    options: Timed,
    q: FloatArray,
    slow: Slow,
    speed: float | None = None,
) -> Trajectory:
    """Waypoints (T, n) as a trajectory of ``options.duration``, or as :func:`shortest` times them.

    Without a duration the tool's speed stays in the ``slow`` intervals below
    ``options.approach_speed``, or else below ``speed`` [m/s] (None: that of the push model).
    """
    usual = PUSH.standing.speed if stands(task) else PUSH.hanging.speed
    limit = options.approach_speed or speed or usual
    made = shortest(task.robot, q, None if options.duration else slow, limit)
    if options.duration is not None:
        made = made.slowed(options.duration / made.duration)
    if not task.state.moving:
        return made
    return joined(task.robot, task.state, made, slow, options.corridor)


def shortest(robot: Robot, q: FloatArray, slow: Slow = None, speed: float = np.inf) -> Trajectory:
    """The shortest trajectory found through waypoints ``q`` (T, n), from rest to rest.

    Another may be shorter: equal intervals are not tried against others, and the search is local.
    It keeps the robot's limits of velocity, acceleration and jerk at every instant. In the ``slow``
    intervals it keeps the tool's ``speed`` [m/s] in the mean. Where the tool's speed decides, the
    intervals are equal, unless ``slow`` is a mask. Where the joints' limits decide, the intervals
    near the ends are widened, then each interval by its :func:`needs`. Finally the intervals are
    widened within which the tool exceeds ``speed`` by more than ``TIMING.spare``.
    """
    count, names = len(q), robot.joint_names
    least = np.zeros(count - 1)
    single, slow = isinstance(slow, np.ndarray), intervals(slow, count)
    if slow.any():
        points, _ = robot.tool_pose(q)
        least[slow] = lengths(points[1:] - points[:-1])[slow] / speed
    even = np.arange(count, dtype=np.float64)
    dt = max(float(least.max()), TIMING.least_dt)
    made = Trajectory.through(q, dt * even, names)
    if not single and needs(robot, made).max() <= 1.0:
        return _calmed(robot, made, slow, speed)
    made = fastest(robot, q, least, ramped(np.linspace(0.0, 1.0, count)))
    return _calmed(robot, made, slow, speed)


def intervals(slow: Slow, count: int) -> BoolArray:
    """``slow`` as a mask (count-1,) over the intervals of ``count`` waypoints."""
    if isinstance(slow, np.ndarray):
        return slow
    return np.arange(count - 1) >= (count if slow is None else slow)


def _calmed(robot: Robot, made: Trajectory, slow: BoolArray, speed: float) -> Trajectory:
    """A trajectory, with intervals widened in which the tool is too fast."""
    for _ in range(TIMING.refinements):
        fast = tool_speeds(robot, made, slow, TIMING.parts) / speed
        if fast.max() <= 1.0 + TIMING.spare:
            break
        widths = np.diff(made.times) * np.maximum(fast, 1.0)
        made = within(robot, made.positions, np.append(0.0, np.cumsum(widths)), widths)
    return made


def joined(
    robot: Robot,
    state: State,
    made: Trajectory,
    slow: Slow = None,
    corridor: float = np.inf,
) -> Trajectory:
    """A trajectory that begins in a moving ``state`` instead of at rest.

    One quintic from the state to a waypoint ahead replaces the beginning of the trajectory
    ``made``; the number of waypoints stays. The waypoint is at most ``UNDERWAY.join`` ahead [s].
    Waypoint and quintic's duration are those of the earliest end within all limits. In the ``slow``
    intervals the quintic leads the tool no faster than ``made``, and within ``corridor`` [m] of its
    path. Among quintics that keep the limits, those within the corridor come first. Where none
    keeps the limits, the quintic that comes nearest is chosen, and the judge reports it.
    """
    last = max(2, int(np.searchsorted(made.times, UNDERWAY.join, side="right")))
    rows = np.arange(1, min(last, made.n_waypoints))
    spans = np.geomspace(UNDERWAY.quickest, UNDERWAY.slowest, UNDERWAY.durations)
    row, h = np.repeat(rows, len(spans)), np.tile(spans, len(rows))
    many = (len(row), 1)
    begin = np.tile(state.q, many), np.tile(state.velocity, many), np.tile(state.acceleration, many)
    points = control_points(h[:, None], begin, made.rows(row))
    outside = np.maximum(robot.lower - points, points - robot.upper).max(axis=(0, 2))
    over = np.maximum(shares(robot, points, h[:, None]) - 1.0, 0.0) + np.maximum(outside, 0.0)
    off, ends = np.zeros(len(row)), h - made.times[row]
    slow = intervals(slow, made.n_waypoints)
    if slow[:last].any():
        path, _ = robot.tool_pose(made.positions)
        speed = max(float(tool_speeds(robot, made, slow).max()), 1e-6)
        gone = np.append(0.0, np.cumsum(np.where(slow, lengths(np.diff(path, axis=0)), 0.0)))
        over += np.maximum(gone[row] / h / speed - 1.0 - TIMING.spare, 0.0)
        some = np.flatnonzero(over <= over.min())
        row, h, ends, over = row[some], h[some], ends[some], over[some]
        fast, off = _led(robot, points[:, some], h, path[: last + 1], slow[:last], speed)
        over, off = over + fast, np.maximum(off - corridor, 0.0)
    best = int(np.lexsort((ends, off, over))[0])
    j, span, names = int(row[best]), float(h[best]), made.joint_names
    q, velocity, acceleration = (
        np.stack([one[0], other]) for one, other in zip(begin, made.rows(j), strict=True)
    )
    lead = Trajectory(np.array([0.0, span]), q, velocity, acceleration, names)
    at = np.linspace(0.0, span, j + 1)[:-1]
    q, velocity, acceleration = (
        np.concatenate([new, old])
        for new, old in zip(lead.sample(at), made.rows(slice(j, None)), strict=True)
    )
    times = np.append(at, made.times[j:] - made.times[j] + span)
    return Trajectory(times, q, velocity, acceleration, names)


def tool_speeds(robot: Robot, made: Trajectory, slow: Slow, parts: int = 1) -> FloatArray:
    """Speed (T-1,) of the tool in each slow interval, 0 in the others [m/s].

    The speed of an interval is the largest of the means over its equal ``parts``.
    """
    slow = intervals(slow, made.n_waypoints)
    if not slow.any():
        return np.zeros(len(slow))
    share = np.linspace(0.0, 1.0, parts + 1)
    times = made.times[:-1][slow, None] + share * np.diff(made.times)[slow, None]
    points, _ = robot.tool_pose(made.sample(times.ravel())[0].reshape(*times.shape, -1))
    gone = np.sqrt(np.square(np.diff(points, axis=1)).sum(axis=2))
    out = np.zeros(len(slow))
    out[slow] = (gone / np.diff(times, axis=1)).max(axis=1)
    return out


def _led(
    robot: Robot, points: FloatArray, h: FloatArray, path: FloatArray, slow: BoolArray, speed: float
) -> tuple[FloatArray, FloatArray]:
    """Excess speed (m,) and largest distance from the path (m,) [m] of the tool on each quintic.

    The excess is the time integral of (speed of the tool / ``speed`` - 1) [s] where that is over
    ``TIMING.spare``.
    """
    s = np.linspace(0.0, 1.0, UNDERWAY.samples + 1)[:, None]
    power = np.arange(6)
    binomial = np.array([1.0, 5.0, 10.0, 10.0, 5.0, 1.0])
    blend = binomial * s**power * (1.0 - s) ** (5 - power)
    tool, _ = robot.tool_pose(np.einsum("sk,kmn->msn", blend, points))
    count = max(2, math.ceil(length(path) / STEP) + 1)
    row = along(path, np.arange(len(path), dtype=np.float64)[:, None], count)[:, 0]
    away = lengths((tool[:, :, None] - evenly(path, count)).reshape(-1, 3))
    away = away.reshape(*tool.shape[:2], count)
    near = np.minimum(row[away.argmin(axis=2)] + 1e-9, len(slow) - 1)
    counts = slow[near.astype(int)]
    off = np.where(counts, away.min(axis=2), 0.0).max(axis=1)
    times = h[:, None] / UNDERWAY.samples
    fast = lengths(np.diff(tool, axis=1).reshape(-1, 3)).reshape(len(h), -1) / times / speed - 1.0
    fast = np.where(counts[:, 1:] & (fast > TIMING.spare), fast * times, 0.0).sum(axis=1)
    return fast, off


def stopped(robot: Robot, state: State) -> Trajectory:
    """From a moving ``state`` to rest: the shortest quintic that keeps all limits.

    A quintic of duration h moves a joint of speed v by v·h/2, as constant deceleration does. Where
    no quintic keeps all limits, each joint is braked as hard as acceleration and jerk allow; it
    exceeds the limits of position by the least, and the judge reports it.
    """
    rest = np.zeros((2, robot.n_joints))
    rest[0] = state.velocity
    gain = np.stack([state.acceleration, rest[1]])
    for h in np.geomspace(UNDERWAY.quickest, UNDERWAY.slowest, UNDERWAY.durations):
        q = np.stack([state.q, state.q + 0.5 * h * state.velocity])
        made = Trajectory(np.array([0.0, h]), q, rest, gain, robot.joint_names)
        points = control_points(np.array([[h]]), made.rows([0]), made.rows([1]))
        inside = ((points >= robot.lower) & (points <= robot.upper)).all()
        if inside and shares(robot, points, np.array([[h]])).max() <= 1.0:
            return made
    return _braked(robot, state)


def _braked(robot: Robot, state: State) -> Trajectory:
    """From a moving ``state`` to rest, each joint as soon as its acceleration and jerk allow.

    The acceleration changes evenly to a peak, stays there, and changes evenly to zero. The times of
    these three phases are whole ticks, the same for all joints, so that no two rows are too close.
    """
    v, a, least = state.velocity, state.acceleration, TIMING.least_dt
    most = np.maximum(np.minimum(robot.acceleration, np.abs(v) / least), np.abs(a)) + 1e-9
    jerk = np.minimum(robot.jerk, most / least)
    sign = -np.sign(v + 0.5 * a * np.abs(a) / jerk)  # against the speed that is left without a peak
    wanted, now = -sign * v, sign * a  # change of speed, acceleration
    peak = np.minimum(np.sqrt(np.maximum(jerk * wanted + 0.5 * now**2, 0.0)), most)
    tick = max(least, float(((peak + np.abs(now)) / jerk).max()) / UNDERWAY.ticks)
    held = (wanted - (peak**2 - 0.5 * now**2) / jerk) / np.maximum(peak, 1e-9)
    held = np.ceil(np.maximum(held, 0.0) / tick - 1e-6)
    ticks = np.array(
        [_phases(*one, tick) for one in zip(wanted, now, most, jerk, held, strict=True)]
    ).T
    peak = (wanted / tick - 0.5 * now * ticks[0]) / (0.5 * (ticks[0] + ticks[2]) + ticks[1])
    jerks = sign * np.stack([(peak - now) / ticks[0], 0.0 * peak, -peak / ticks[2]]) / tick
    ends = np.cumsum(ticks, axis=0)
    times = np.append(0.0, np.unique(ends)) * tick
    q, v, a = (np.tile(one, (len(times), 1)) for one in (state.q, v, a))
    for begin, span, slope in zip((ends - ticks) * tick, ticks * tick, jerks, strict=True):
        t = np.clip(times[:, None] - begin, 0.0, span)
        q = q + t * (v + t * (a / 2.0 + t * slope / 6.0))
        v, a = v + t * (a + t * slope / 2.0), a + t * slope
    v[-1] = a[-1] = 0.0  # without rounding
    return Trajectory(times, q, v, a, robot.joint_names)


def _phases(
    wanted: float, now: float, most: float, jerk: float, held: float, tick: float
) -> tuple[float, float, float]:
    """The fewest whole ticks of the three phases of :func:`_braked` for one joint.

    The speed changes by ``wanted``; the acceleration is ``now`` at first, and at its peak for
    ``held`` ticks or little more. Limits are ``most`` (acceleration) and ``jerk``.
    """
    first, last = np.mgrid[1 : UNDERWAY.ticks + 3, 1 : UNDERWAY.ticks + 3] * tick
    slack = 1.0 + 1e-9
    for more in range(UNDERWAY.ticks):
        peak = (wanted - 0.5 * now * first) / (0.5 * (first + last) + (held + more) * tick)
        fits = np.abs(peak) <= np.minimum(jerk * last, most) * slack
        fits &= np.abs(peak - now) <= jerk * first * slack
        if fits.any():
            break
    row, column = np.unravel_index(np.argmin(np.where(fits, first + last, np.inf)), fits.shape)
    return float(row + 1), held + more, float(column + 1)
