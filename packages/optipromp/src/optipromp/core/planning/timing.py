r"""Timing: the times of a trajectory's waypoints, such that its curve keeps every limit.

The curve is the quintic spline through the waypoints
(:class:`optipromp.core.trajectory.Trajectory`). Within an interval its derivatives stay in the
convex hull of their control points. Where the hull keeps the limits of velocity v, acceleration a
and jerk j, the curve keeps them at every instant. Stretching all times by c divides the k-th
derivative by :math:`c^k`, so the least stretch is

.. math:: c = \max\left(|\dot q|/v,\; (|\ddot q|/a)^{1/2},\; (|\dddot q|/j)^{1/3}\right).
"""

import functools
import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from operator import attrgetter

import numpy as np

from optipromp.core.arrays import BoolArray, FloatArray, frozen, lengths
from optipromp.core.compiled import inner, kernel
from optipromp.core.optimization.evaluation import Evaluation
from optipromp.core.planning.options import Timed
from optipromp.core.planning.parameters import TIMING, UNDERWAY
from optipromp.core.planning.task import Task, stands
from optipromp.core.pushing.parameters import PUSH
from optipromp.core.pushing.path import STEP, along, evenly, length
from optipromp.core.robots.model import Robot
from optipromp.core.scenes.objects import SceneObject
from optipromp.core.scenes.scene import packed
from optipromp.core.trajectory import State, Trajectory, control_points

Slow = int | BoolArray | None
"""The intervals in which the tool is to be slow: from a waypoint on, by mask (T-1,), or none."""


def timed(
    task: Task, options: Timed, q: FloatArray, slow: Slow, speed: float | None = None
) -> Trajectory:
    """Waypoints (T, n) as a trajectory of ``options.duration``, or as :func:`shortest` times them.

    Without a duration the tool's speed stays in the ``slow`` intervals below
    ``options.approach_speed``, or else below ``speed`` [m/s] (None: that of the push model).
    """
    usual = PUSH.standing.speed if stands(task) else PUSH.hanging.speed
    limit = options.approach_speed or speed or usual
    robot = eased(task.robot, options)
    made = shortest(robot, q, None if options.duration else slow, limit)
    if options.duration is not None:
        made = made.slowed(options.duration / made.duration)
    if not task.state.moving:
        return made
    return joined(robot, task.state, made, slow, options.corridor)


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
    if single or needs(robot, made).max() > 1.0:
        made = fastest(robot, q, least, ramped(np.linspace(0.0, 1.0, count)))
    for _ in range(TIMING.refinements):
        fast = tool_speeds(robot, made, slow, TIMING.parts) / speed
        if fast.max() <= 1.0 + TIMING.spare:
            break
        widths = np.diff(made.times) * np.maximum(fast, 1.0)
        made = within(robot, q, np.append(0.0, np.cumsum(widths)), widths)
    return made


def eased(robot: Robot, options: Timed) -> Robot:
    """The robot with the shares of its limits that a motion may use."""
    shares = options.velocity_scaling, options.acceleration_scaling
    return robot if shares == (1.0, 1.0) else _scaled(robot, *shares)


@functools.lru_cache(maxsize=8)
def _scaled(robot: Robot, velocity: float, acceleration: float) -> Robot:
    return replace(
        robot,
        velocity=frozen(velocity * robot.velocity),
        acceleration=frozen(acceleration * robot.acceleration),
        jerk=frozen(acceleration * robot.jerk),
    )


def intervals(slow: Slow, count: int) -> BoolArray:
    """``slow`` as a mask (count-1,) over the intervals of ``count`` waypoints."""
    if isinstance(slow, np.ndarray):
        return slow
    return np.arange(count - 1) >= (count if slow is None else slow)


def joined(
    robot: Robot, state: State, made: Trajectory, slow: Slow = None, corridor: float = np.inf
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


_FINE = 2001  # times from which those of waypoints that are not evenly spaced are interpolated


@dataclass(frozen=True, eq=False)
class JointLimits:
    """Names and limits (n,) of joints."""

    joint_names: tuple[str, ...]
    velocity: FloatArray  # [rad/s or m/s]
    acceleration: FloatArray  # [rad/s² or m/s²]
    jerk: FloatArray  # [rad/s³ or m/s³]


Limited = Robot | JointLimits


def fastest(
    limits: Limited, q: FloatArray, least: FloatArray, begins: Iterable[FloatArray]
) -> Trajectory:
    """The fastest trajectory found through waypoints ``q`` (T, n) within limits, rest to rest.

    The best of the times ``begins`` (T,) is refined: each interval is widened by its
    :func:`needs`. No interval is shorter than ``least`` (T-1,) [s].
    """
    duration = attrgetter("duration")
    best = made = min((within(limits, q, times, least) for times in begins), key=duration)
    for _ in range(TIMING.refinements):
        need = smoothed(needs(limits, made))
        widths = np.diff(made.times) * np.clip(need**TIMING.gain, TIMING.shrink, TIMING.widen)
        made = within(limits, q, np.append(0.0, np.cumsum(widths)), least)
        best = min(best, made, key=duration)
    return best


def ramped(gone: FloatArray) -> Iterator[FloatArray]:
    """Times (T,) of waypoints at shares ``gone`` (T,) of a path, for each of ``TIMING.ramps``."""
    even = np.linspace(0.0, 1.0, len(gone))
    if np.array_equal(gone, even):
        yield from (_ramped(len(gone), ramp) for ramp in TIMING.ramps)
        return
    for ramp in TIMING.ramps:
        yield np.interp(gone, np.linspace(0.0, 1.0, _FINE), _ramped(_FINE, ramp))


def needs(limits: Limited, made: Trajectory) -> FloatArray:
    """The least stretch c (T-1,) of each interval of a trajectory; see the module."""
    h = np.diff(made.times)[:, None]
    points = control_points(h, made.rows(slice(None, -1)), made.rows(slice(1, None)))
    return shares(limits, points, h)


def shares(limits: Limited, points: FloatArray, h: FloatArray) -> FloatArray:
    """The least stretch (m,) of quintics with control points (6, m, n) and durations (m, 1) [s]."""
    worst = np.zeros(len(h))
    most = limits.velocity, limits.acceleration, limits.jerk
    for order, (factor, limit) in enumerate(zip((5.0, 20.0, 60.0), most, strict=True), start=1):
        points = np.diff(points, axis=0)
        share = factor * np.abs(points).max(axis=0) / h**order / limit
        worst = np.maximum(worst, share.max(axis=1) ** (1.0 / order))
    return worst


def within(limits: Limited, q: FloatArray, times: FloatArray, least: FloatArray) -> Trajectory:
    """The trajectory at ``times`` (T,), stretched to keep all limits.

    No interval is shorter than ``least`` (T-1,) [s].
    """
    made = Trajectory.through(q, times, limits.joint_names)
    factor = float(needs(limits, made).max())
    widths = factor * np.diff(times)
    if (widths < least).any():
        times = np.append(0.0, np.cumsum(np.maximum(widths, least)))
        made = Trajectory.through(q, times, limits.joint_names)
        factor = max(float(needs(limits, made).max()), 1.0)
    return made.slowed(
        max(factor * (1.0 + 1e-9), TIMING.least_dt / float(np.diff(made.times).max()))
    )


@functools.lru_cache(maxsize=64)
def _ramped(count: int, ramp: float) -> FloatArray:
    """Times (T,) of evenly spaced waypoints that are passed at speed 1 between two ramps.

    Over the time ``ramp`` at either end (the cruise takes 1), the speed changes by the quintic step
    10 x³ − 15 x⁴ + 6 x⁵.
    """
    gone = np.linspace(0.0, 1.0, count)
    if ramp == 0.0:
        return frozen(gone)
    x = np.linspace(0.0, 1.0, 401)
    travelled = ramp * x**4 * (2.5 - 3.0 * x + x**2)

    def since(distance: FloatArray) -> FloatArray:
        rising = ramp * np.interp(distance, travelled, x)
        return np.where(distance < 0.5 * ramp, rising, distance + 0.5 * ramp)

    return frozen(np.where(gone <= 0.5, since(gone), 1.0 + ramp - since(1.0 - gone)))


@kernel
def smoothed(values):
    """The largest of each three neighbours (m,), then their mean."""
    last = len(values) - 1
    p = np.empty(last + 3)
    for i in range(last + 1):
        p[i + 1] = max(values[max(i - 1, 0)], values[i], values[min(i + 1, last)])
    p[0], p[last + 2] = p[1], p[last + 1]
    return (p[:-2] + p[1:-1] + p[2:]) / 3.0


def slowly(task: Task, q: FloatArray, first: int | None) -> Slow:
    """The intervals between waypoints (T, n) in which the tool is to be slow.

    Where objects stand, these are the intervals shortly before and while the tool pushes: see
    :meth:`optipromp.core.pushing.model.PushModel.pushing`.

    Elsewhere, these are all intervals from waypoint ``first`` on (None: none of these), and the
    intervals before it in which the tool is near a hanging pushable. There the tool counts as a
    cylinder with the gripper's radius, up to the rim.
    """
    if not stands(task):
        return _among_hanging(task, q, first)
    model, pushes = task.push_model(q[-1]), np.zeros(len(q), dtype=bool)
    if first is None or model is None:
        return first
    points, axes = task.robot.tool_pose(q[first:])
    gone = np.append(0.0, np.cumsum(lengths(np.diff(points, axis=0))))
    for at in gone[model.pushing(points, axes)]:
        pushes[first:] |= (gone > at - TIMING.ahead) & (gone <= at)
    return np.asarray(pushes[1:] | pushes[:-1])


def paced(
    task: Task, options: Timed, q: FloatArray, first: int | None, speed: float | None
) -> Trajectory:
    """Waypoints (T, n) as a trajectory whose tool is slow where :func:`slowly` asks for it.

    ``first`` is the first waypoint on the path of the tool, whose largest speed is ``speed`` [m/s];
    see :func:`optipromp.core.planning.timing.timed`. Such a trajectory is led faster where nothing
    is pushed: among fruits that hang, until the tool comes near the first of them, unless the
    options are ``unhurried``. Beside the first places of objects that stand, the tool keeps to
    ``PUSH.standing.beside``. Near the target that stands the tool keeps the profile of its speed,
    which brakes, or ``TIMING.meeting`` of its largest speed.
    """
    slow = slowly(task, q, first)
    robot = eased(task.robot, options)
    if not (stands(task) and isinstance(slow, np.ndarray)) or options.duration is not None:
        made = timed(task, options, q, slow, speed)
        free = np.zeros(len(q) - 1, dtype=bool) if task.state.moving else hurried(task, options, q)
        if first is None or not free.any():
            return made
        return quickened(robot, made, np.where(free, np.inf, 1.0))
    limit = options.approach_speed or speed or PUSH.standing.speed
    even, near = shortest(robot, q, first, limit), _near_standing(task, q)
    own = tool_speeds(task.robot, even, np.ones(len(slow), dtype=bool), TIMING.parts)
    own = np.maximum(own, TIMING.still)
    aside = np.where(near[1:] | near[:-1], max(PUSH.standing.beside, limit), np.inf) / own
    points, _ = task.robot.tool_pose(q[1:])
    last = lengths(points - points[-1]) < TIMING.last
    usual = np.where(last, np.median(own[slow]) if slow.any() else limit, 0.0)
    slowest = np.maximum(own, np.minimum(usual, own / TIMING.meeting))
    made = quickened(robot, even, np.where(slow, limit / slowest, aside))
    if not task.state.moving:
        return made
    return joined(robot, task.state, made, slow, options.corridor)


def leaving(
    robot: Robot, options: Timed, q: FloatArray, fruits: Iterable[SceneObject], speed: float
) -> Trajectory:
    """A way out through waypoints (T, n), from among ``fruits`` that hang, from rest to rest.

    The tool has the ``speed`` [m/s] until it is past the last of them for good. Then it is as fast
    as the joints allow, unless the options are ``unhurried`` or state a speed or a duration.
    """
    made = shortest(eased(robot, options), q, 0, speed)
    free = np.cumsum(_near_hanging(robot, q, fruits)[::-1])[::-1] == 0
    if options.unhurried or options.timed or not free.any():
        return made
    return quickened(eased(robot, options), made, np.where(free, np.inf, 1.0))


def among_fruits(robot: Robot, made: Trajectory, fruits: Iterable[SceneObject]) -> float:
    """Largest speed of the tool near any of the ``fruits`` that hang [m/s].

    It is the speed of a push times a power of ``TIMING.told``: speeds that differ little are one.
    """
    near = _near_hanging(robot, made.positions, fruits)
    fast = float(tool_speeds(robot, made, near, TIMING.parts).max(initial=TIMING.still))
    steps = round(math.log(fast / PUSH.hanging.speed) / math.log(TIMING.told))
    return float(PUSH.hanging.speed * TIMING.told**steps)


def quickened(robot: Robot, made: Trajectory, rate: FloatArray) -> Trajectory:
    """A trajectory, led faster, at a ``rate`` (T-1,) of at most so much by interval.

    A rate below 1 counts as 1. All limits are kept that ``made`` keeps. The rate changes by at most
    the factor ``TIMING.grade`` from waypoint to waypoint. It shrinks where the joints' limits are
    exceeded.
    """
    steps = np.diff(made.times)
    most = np.minimum(np.minimum(rate, TIMING.quickest), steps / TIMING.least_dt)
    most = np.log(np.maximum(most, 1.0))
    most = np.minimum(np.append(most, most[-1]), np.append(most[0], most))
    limits = np.stack([robot.velocity, robot.acceleration, robot.jerk])
    v, a = made.velocities.copy(), made.accelerations.copy()
    if not _hurry(made.times, made.positions, v, a, limits, most, steps):
        return made
    times = np.append(0.0, np.cumsum(steps))
    return Trajectory(times, made.positions, v, a, made.joint_names)


_RATES = TIMING.paces, math.log(TIMING.grade), TIMING.spare, TIMING.gain


@kernel
def _hurry(times, q, v, a, limits, most, steps):
    """Lead waypoints ``q`` (T, n) at the largest rates up to exp(``most``) (T,) within ``limits``.

    ``v``, ``a`` (T, n), in and out: at ``times`` (T,) before, and at the rates r: q̇ = q′ r and
    q̈ = q″ r² + q′ ṙ. The time per time before, 1 / r, is a cubic in each interval, with continuous
    slopes. ``limits`` (3, n) of velocity, acceleration and jerk. ``steps`` (T-1,) out, between the
    times at the rates. Returns whether there are such rates within ``TIMING.paces`` trials.
    """
    count, n = q.shape
    slower, bent, (paces, grade, spare, gain) = v.copy(), a.copy(), _RATES
    need, pace, slope = np.empty(count - 1), np.empty(count), np.empty(count)
    for _ in range(paces):
        for i in range(1, count):
            most[i] = min(most[i], most[i - 1] + grade)
        for i in range(count - 1, 0, -1):
            most[i - 1] = min(most[i - 1], most[i] + grade)
        pace[:] = np.exp(-most)
        for i in range(count):  # differences of second order; at the ends of first
            low, high = max(i - 1, 0), min(i + 1, count - 1)
            before, after = times[i] - times[low], times[high] - times[i]
            rise = before**2 * (pace[high] - pace[i]) + after**2 * (pace[i] - pace[low])
            if before * after > 0.0:
                slope[i] = rise / (before * after * (before + after))
            else:
                slope[i] = (pace[high] - pace[low]) / (before + after)
            rate = 1.0 / pace[i]
            for k in range(n):
                v[i, k] = slower[i, k] * rate
                a[i, k] = bent[i, k] * rate**2 - slower[i, k] * slope[i] * rate**3
        worst = 0.0
        for i in range(count - 1):
            step = times[i + 1] - times[i]
            steps[i] = 0.5 * step * (pace[i + 1] + pace[i])
            steps[i] -= step**2 * (slope[i + 1] - slope[i]) / 12.0
            need[i] = _need(q, v, a, i, steps[i], limits)
            worst = max(worst, need[i])
        if worst <= 1.0:
            return True
        need = smoothed(np.maximum(need * (1.0 + spare), 1.0))
        for i in range(count):
            excess = max(need[max(i - 1, 0)], need[min(i, count - 2)])
            most[i] = max(most[i] - gain * math.log(excess), 0.0)
    return False


@inner
def _need(q, v, a, i, h, limits):
    """The least stretch of the interval i, which lasts ``h`` [s]; see :func:`shares`."""
    worst = 0.0
    for k in range(q.shape[1]):
        v0, a0 = h * v[i, k] / 5.0, h * h * a[i, k] / 20.0
        v1, a1 = h * v[i + 1, k] / 5.0, h * h * a[i + 1, k] / 20.0
        d0, d1, d3, d4 = v0, v0 + a0, v1 - a1, v1
        d2 = q[i + 1, k] - q[i, k] - d0 - d1 - d3 - d4
        most = max(abs(d0), abs(d1), abs(d2), abs(d3), abs(d4))
        worst = max(worst, 5.0 * most / (h * limits[0, k]))
        d0, d1, d2, d3 = d1 - d0, d2 - d1, d3 - d2, d4 - d3
        most = max(abs(d0), abs(d1), abs(d2), abs(d3))
        worst = max(worst, math.sqrt(20.0 * most / (h * h * limits[1, k])))
        most = max(abs(d1 - d0), abs(d2 - d1), abs(d3 - d2))
        worst = max(worst, (60.0 * most / (h**3 * limits[2, k])) ** (1.0 / 3.0))
    return worst


def _near_standing(task: Task, q: FloatArray) -> BoolArray:
    """Whether any part of the body is near an object that stands, at waypoints (T, n)."""
    scene = task.scene
    rows = scene.rows("pushable")
    rows = rows[~scene.hangs[rows]]
    body = Evaluation(task.robot, task.body, len(q), 1.0)
    body.move_to(q)
    body.static.measure(body, packed(scene, rows), len(rows), TIMING.beside)
    return np.asarray((body.static.distance < TIMING.beside).any(axis=1))


def _among_hanging(task: Task, q: FloatArray, first: int | None) -> Slow:
    target = task.scene.target
    if task.robot.tool is None or target is None or target.stem is None:
        return first
    among, path = _near_hanging(task.robot, q, task.scene.pushables), intervals(first, len(q))
    return among | path if (among & ~path).any() else first


def hurried(task: Task, options: Timed, q: FloatArray) -> BoolArray:
    """The intervals (T-1,) before the tool first comes near a fruit, where all of these hang.

    None where the options state a speed or a duration, or are ``unhurried``.
    """
    target, plain = task.scene.target, options.unhurried or options.timed or stands(task)
    if plain or task.robot.tool is None or target is None or target.stem is None:
        return np.zeros(len(q) - 1, dtype=bool)
    near = _near_hanging(task.robot, q, (*task.scene.pushables, target))
    return np.asarray((np.cumsum(near) == 0) & near.any())


def _near_hanging(robot: Robot, q: FloatArray, fruits: Iterable[SceneObject]) -> BoolArray:
    """The intervals (T-1,) in which the tool is near any of the ``fruits`` that hang."""
    near, tool = np.zeros(len(q), dtype=bool), robot.tool
    assert tool is not None
    points, axes = robot.tool_pose(q)
    low, high = points.min(axis=0), points.max(axis=0)
    hanging = [fruit for fruit in fruits if fruit.stem is not None]
    places = frozen([fruit.position for fruit in hanging]).reshape(-1, 3)
    reaches = np.array([fruit.radius for fruit in hanging]) + TIMING.among
    depth, above = tool.depth, tool.reach
    far = (reaches + above + robot.gripper_radius)[:, None]
    for k in np.flatnonzero(((places + far >= low) & (places - far <= high)).all(axis=1)):
        off, reach = places[k] - points, reaches[k]
        along = np.einsum("ti,ti->t", off, axes)
        aside = lengths(off - along[:, None] * axes)
        level = (along < depth + reach) & (along > -above - reach)
        near |= level & (aside < robot.gripper_radius + reach)
    return np.asarray(near[1:] | near[:-1])
