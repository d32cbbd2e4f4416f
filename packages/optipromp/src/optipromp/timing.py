r"""Jerk-limited timing of any waypoints: of any arm, or of a scene's robot, slow near fruits.

>>> from optipromp.timing import gentle, timed
>>> curve = timed(waypoints, velocity=2.0, acceleration=10.0, jerk=100.0)
>>> rows = curve.resample(1000)
>>> motion = gentle(scene, waypoints)

The path through the waypoints is a spline over the chord length. The path is sampled at
many points, and the times of these are chosen as :mod:`optipromp.core.planning.timing` says: the
resulting curve keeps every limit at every instant, because within an interval its derivatives stay
in the hull of their control points.
"""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from optipromp.core.arrays import FloatArray, evenly_along, lengths
from optipromp.core.errors import InvalidRequestError
from optipromp.core.planning.parameters import TIMING
from optipromp.core.planning.task import robot_of
from optipromp.core.planning.timing import JointLimits, fastest, ramped, shortest
from optipromp.core.pushing.parameters import PUSH
from optipromp.core.scenes.scene import Scene
from optipromp.core.trajectory import GREATEST, Trajectory, chained

__all__ = ["gentle", "timed"]

ROWS = 20, 60, 100
"""Numbers of intervals between two stops that are tried, chosen: the fastest curve is kept."""

EACH = 4  # intervals between two waypoints that are tried, too, chosen
NEAR = 0.12  # [m] of the tool point from a fruit's surface, within which the tool is slow: a choice
LEAST = 250  # waypoints of a gentle motion, at least: a choice
RATE = 1000.0  # [Hz] at which the curve through fewer is sampled, to space them evenly: a choice


def timed(
    waypoints: ArrayLike,
    velocity: ArrayLike,
    acceleration: ArrayLike,
    jerk: ArrayLike,
    *,
    stops: Sequence[int] = (),
    joint_names: Sequence[str] | None = None,
) -> Trajectory:
    """A curve through waypoints, from rest to rest, within limits at every instant.

    The joints stop at no waypoint between the first and the last but those of ``stops``. The curve
    passes each waypoint exactly, and is a smooth spline between two of them; more waypoints hold it
    nearer to a path. Limits of position are not known here: compare ``curve.positions``.

    Args:
        waypoints: (m, n) of n joints, m >= 2 [rad or m]; two neighbours must differ.
        velocity: limit of each joint, (n,) or one for all [rad/s or m/s]; may be infinite.
        acceleration: likewise [rad/s² or m/s²].
        jerk: likewise [rad/s³ or m/s³].
        stops: indices of waypoints at which all joints rest.
        joint_names: n names; None: ``joint1`` and on.

    Returns:
        The curve, with a row at each waypoint and rows between them.

    Raises:
        InvalidRequestError: fewer than two waypoints, a value that is not finite, neighbours that
            are the same, a limit that is not above 0 or of another shape, a stop that is no inner
            waypoint, or a wrong number of names.
    """
    q = np.asarray(waypoints, dtype=np.float64)
    if q.ndim != 2 or len(q) < 2 or not q.shape[1]:
        raise InvalidRequestError(f"waypoints have shape {q.shape}: must be (m, n), m >= 2")
    if not (np.abs(q) <= GREATEST).all():
        row, joint = (int(i) for i in np.argwhere(~(np.abs(q) <= GREATEST))[0])
        raise InvalidRequestError(
            f"waypoints[{row}][{joint}] is {q[row, joint]}: must be finite, at most {GREATEST:g}"
        )
    count = q.shape[1]
    names = tuple(joint_names or (f"joint{k + 1}" for k in range(count)))
    if len(names) != count:
        raise InvalidRequestError(f"{len(names)} joint names for {count} columns")
    chords = lengths(np.diff(q, axis=0))
    if (same := np.flatnonzero(chords < 1e-9)).size:
        raise InvalidRequestError(
            f"waypoints {same[0]} and {same[0] + 1} are the same: must differ; to rest there, name "
            "it among stops"
        )
    given = {"velocity": velocity, "acceleration": acceleration, "jerk": jerk}
    limits = JointLimits(names, **{name: _limit(name, one, count) for name, one in given.items()})
    for stop in stops:
        if not 0 < stop < len(q) - 1:
            raise InvalidRequestError(f"stop is {stop}: must be from 1 to {len(q) - 2}")
    ends = [0, *sorted({*stops}), len(q) - 1]
    parts = [_between(limits, q[a : b + 1], chords[a:b]) for a, b in pairwise(ends)]
    return chained(parts)


def gentle(scene: Scene, waypoints: ArrayLike) -> Trajectory:
    """The fastest motion of a scene's robot through waypoints that is slow near fruits.

    It goes from rest to rest within the robot's limits of velocity, acceleration and jerk at every
    instant. Within 12 cm of the surface of an object that is not static, the tool point is at most
    as fast as in our plans (0.1 m/s). The benchmark's entries, ours too, are timed so.

    Args:
        scene: whose robot and tool :func:`optipromp.robot_of` has.
        waypoints: (m, n) of its n joints, m >= 2 [rad or m]. The curve of :func:`timed` joins
            fewer than 250, and is sampled evenly.

    Raises:
        InvalidRequestError: waypoints as for :func:`timed`, or of another number of joints.
        OptiPrompError: what :func:`optipromp.robot_of` raises.
    """
    robot, q = robot_of(scene), np.asarray(waypoints, dtype=np.float64)
    if len(q) < LEAST:
        limits = robot.velocity, robot.acceleration, robot.jerk
        path = timed(q, *limits, joint_names=robot.joint_names)
        q = evenly_along(path.resample(RATE).positions, LEAST)
    points, _ = robot.tool_pose(q)
    away = np.full(len(q), np.inf)
    for item in scene.objects:
        if item.role != "static":
            away = np.minimum(away, lengths(points - item.position) - item.radius)
    near = away < NEAR
    return shortest(robot, q, near[1:] | near[:-1], PUSH.hanging.speed)


def _limit(name: str, value: ArrayLike, count: int) -> FloatArray:
    limit = np.asarray(value, dtype=np.float64)
    if limit.shape not in ((), (count,)):
        raise InvalidRequestError(f"{name} has shape {limit.shape}: must be one or ({count},)")
    if not (limit > 0.0).all():
        raise InvalidRequestError(f"{name} is {limit.tolist()}: must be above 0")
    return np.broadcast_to(limit, (count,))


def _between(limits: JointLimits, q: FloatArray, chords: FloatArray) -> Trajectory:
    """The fastest curve found through waypoints (m, n) without a stop."""
    at = np.append(0.0, np.cumsum(chords))
    path = Trajectory(at, q, *_slopes(q, at), limits.joint_names)
    made = list[Trajectory]()
    for rows in (*ROWS, EACH * len(chords)):
        pieces = np.maximum(np.round(rows * chords / at[-1]).astype(int), 1)
        if made and pieces.sum() == made[-1].n_waypoints - 1:
            continue  # one row a waypoint, again
        share = [
            np.linspace(a, b, k, endpoint=False)
            for a, b, k in zip(at[:-1], at[1:], pieces, strict=True)
        ]
        s = np.append(np.concatenate(share), at[-1])
        q = path.sample(s)[0]
        least = np.full(len(s) - 1, TIMING.least_dt / len(s))
        made.append(fastest(limits, q, least, ramped(s / at[-1])))
    return min(made, key=lambda curve: curve.duration)


def _slopes(q: FloatArray, at: FloatArray) -> tuple[FloatArray, FloatArray]:
    """First and second derivatives (m, n) of the spline by chord length."""
    if len(q) == 2:
        line = (q[1] - q[0]) / at[1]
        return np.stack([line, line]), np.zeros_like(q)
    from scipy.interpolate import CubicSpline

    spline = CubicSpline(at, q, bc_type="natural")
    return spline(at, 1), spline(at, 2)
