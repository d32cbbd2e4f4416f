r"""Where the tool is to be slow, and a trajectory that is slow only there.

A trajectory q(s) of an even pace is led at the rate :math:`r = ds/dt \ge 1`:

.. math:: \dot q = q' r, \qquad \ddot q = q'' r^2 + q' \dot r.

The curve's waypoints and its shape stay. Where the rate is 1, the speed stays.
"""

import numpy as np

from optipromp.core.arrays import BoolArray, FloatArray, lengths
from optipromp.core.optimization.evaluation import Evaluation
from optipromp.core.planning.fastest import needs, smoothed
from optipromp.core.planning.options import Timed
from optipromp.core.planning.parameters import TIMING
from optipromp.core.planning.task import Task, stands
from optipromp.core.planning.timing import (
    Slow,
    intervals,
    joined,
    shortest,
    timed,
    tool_speeds,
)
from optipromp.core.pushing.parameters import PUSH
from optipromp.core.robots.model import Robot
from optipromp.core.trajectory import Trajectory


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
    see :func:`optipromp.core.planning.timing.timed`. Where objects stand, a trajectory that is slow
    on its whole path is quickened where nothing is pushed. Beside the first places of these
    objects, the tool keeps to ``PUSH.standing.beside``. Near the target the tool keeps
    the profile of its speed, which brakes, or ``TIMING.meeting`` of its largest speed.
    """
    slow = slowly(task, q, first)
    if not (stands(task) and isinstance(slow, np.ndarray)) or options.duration is not None:
        return timed(task, options, q, slow, speed)
    limit = options.approach_speed or speed or PUSH.standing.speed
    even, near = shortest(task.robot, q, first, limit), _near_standing(task, q)
    own = tool_speeds(task.robot, even, np.ones(len(slow), dtype=bool), TIMING.parts)
    own = np.maximum(own, TIMING.still)
    aside = np.where(near[1:] | near[:-1], max(PUSH.standing.beside, limit), np.inf) / own
    points, _ = task.robot.tool_pose(q[1:])
    last = lengths(points - points[-1]) < TIMING.last
    usual = np.where(last, np.median(own[slow]) if slow.any() else limit, 0.0)
    slowest = np.maximum(own, np.minimum(usual, own / TIMING.meeting))
    made = quickened(task.robot, even, np.where(slow, limit / slowest, aside))
    if not task.state.moving:
        return made
    return joined(task.robot, task.state, made, slow, options.corridor)


def quickened(robot: Robot, made: Trajectory, rate: FloatArray) -> Trajectory:
    """A trajectory, led faster, at a ``rate`` (T-1,) of at most so much by interval.

    A rate below 1 counts as 1. All limits are kept that ``made`` keeps. The rate changes by at most
    the factor ``TIMING.grade`` from waypoint to waypoint. It shrinks where the joints' limits are
    exceeded.
    """
    most = np.minimum(np.minimum(rate, TIMING.quickest), np.diff(made.times) / TIMING.least_dt)
    most = np.log(np.maximum(most, 1.0))
    most = np.minimum(np.append(most, most[-1]), np.append(most[0], most))
    for _ in range(TIMING.paces):
        for i in range(1, len(most)):
            most[i] = min(most[i], most[i - 1] + np.log(TIMING.grade))
        for i in range(len(most) - 1, 0, -1):
            most[i - 1] = min(most[i - 1], most[i] + np.log(TIMING.grade))
        led = _led(made, np.exp(most))
        need = needs(robot, led)
        if need.max() <= 1.0:
            return led
        need = smoothed(np.maximum(need * (1.0 + TIMING.spare), 1.0))
        excess = np.maximum(np.append(need, need[-1]), np.append(need[0], need))
        most = np.maximum(most - TIMING.gain * np.log(excess), 0.0)
    return made


def _led(made: Trajectory, rate: FloatArray) -> Trajectory:
    """A trajectory led at ``rate`` (T,) at its waypoints; see the module.

    The time per time of ``made``, 1 / rate, is a cubic in each interval, with continuous slopes.
    """
    steps, pace = np.diff(made.times), 1.0 / rate
    slope = np.gradient(pace, made.times)
    widths = 0.5 * steps * (pace[1:] + pace[:-1]) - steps**2 * np.diff(slope) / 12.0
    gain = (-slope * rate**3)[:, None]
    each = rate[:, None]
    return Trajectory(
        np.append(0.0, np.cumsum(widths)),
        made.positions,
        made.velocities * each,
        made.accelerations * each**2 + made.velocities * gain,
        made.joint_names,
    )


def _near_standing(task: Task, q: FloatArray) -> BoolArray:
    """Whether any part of the body is near an object that stands, at waypoints (T, n)."""
    scene = task.scene
    rows = scene.rows("pushable")
    rows = rows[[item.stem is None for item in scene.objects_at(rows)]]
    body = Evaluation(task.robot, task.body, len(q), 1.0)
    body.move_to(q)
    body.static.measure(body, scene.packed(rows), len(rows), TIMING.beside)
    return np.asarray((body.static.distance < TIMING.beside).any(axis=1))


def _among_hanging(task: Task, q: FloatArray, first: int | None) -> Slow:
    robot, target, near = task.robot, task.scene.target, np.zeros(len(q), dtype=bool)
    tool, hangs = robot.tool, target is not None and target.stem is not None
    if tool is None or not hangs:
        return first
    points, axes = robot.tool_pose(q)
    low, high = points.min(axis=0), points.max(axis=0)
    for fruit in task.scene.pushables:
        reach = fruit.radius + TIMING.among
        far = reach + tool.reach + robot.gripper_radius
        apart = (fruit.position + far < low) | (fruit.position - far > high)
        if fruit.stem is None or apart.any():
            continue
        off = fruit.position - points
        along = np.einsum("ti,ti->t", off, axes)
        aside = lengths(off - along[:, None] * axes)
        level = (along < tool.depth + reach) & (along > -tool.reach - reach)
        near |= level & (aside < robot.gripper_radius + reach)
    among, path = near[1:] | near[:-1], intervals(first, len(q))
    return among | path if (among & ~path).any() else first
