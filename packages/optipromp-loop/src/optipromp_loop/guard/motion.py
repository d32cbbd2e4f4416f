"""Joints that come to other velocities within their limits, and the nearest velocities allowed.

A change of velocity is a cubic polynomial of time for each joint, as short as the limits of
acceleration and jerk allow, and a whole number of control periods. So all that is left of a change
after a period is a change again, and a braking arm stays on its curve.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.optimize import nnls

from optipromp.core.arrays import BoolArray, FloatArray, lengths
from optipromp.core.pushing.path import STEP
from optipromp.core.robots.model import Robot
from optipromp.core.trajectory import Motion, State, Trajectory

PERIODS = 400  # of the longest change of a velocity: 8 s at 50 Hz, more than any arm's
FEW = 30  # of nearly all changes: those are tried first
ROUNDING = 1e-9  # share of a limit
LARGE = 1e9  # in place of a limit that there is not [rad or m, and per s² or s³]
GAIN = 3.0  # [1/s] of the turn of the tool's axis: a choice
LEVER = 0.2  # [m] by which a turn counts as a length: a choice
DAMPING = 0.01  # [m] of the least squares: a choice


class Limits(NamedTuple):
    """Of the joints, and what a state exceeds of these: it may stay, not go farther."""

    lower: FloatArray  # (n,) [rad or m]
    upper: FloatArray  # (n,)
    rates: FloatArray  # (3, n) of velocity, acceleration and jerk


@dataclass(frozen=True, eq=False)
class Change:
    """Joints that come from a state to velocities without acceleration, and go on with these.

    Attributes:
        begin: of the n joints.
        velocity: (n,) at the end [rad/s or m/s].
        lasting: (n,) until each joint is there [s].
    """

    begin: State
    velocity: FloatArray
    lasting: FloatArray

    @classmethod
    def of(cls, robot: Robot, begin: State, velocity: FloatArray, period: float) -> "Change":
        """The shortest change within the limits, in whole periods [s].

        Where no change is within the limits, it lasts ``PERIODS``.
        """
        for most in (FEW, PERIODS):
            lasting = period * np.arange(1.0, most + 1.0)[:, None]
            fits = cls._within(robot, begin, velocity, lasting)
            if fits.any(axis=0).all():
                break
        else:
            fits[-1] = True
        return cls(begin, velocity, period * (1 + np.argmax(fits, axis=0)))

    @staticmethod
    def _within(robot: Robot, begin: State, velocity: FloatArray, lasting: FloatArray) -> BoolArray:
        """Whether changes that last so long (m, 1) [s] keep the limits (m, n)."""
        by, gain = velocity - begin.velocity, begin.acceleration * lasting
        middle, last = 3.0 * by - 2.0 * gain, gain - 2.0 * by  # coefficients of s² and s³
        turn = -middle / np.where(last == 0.0, np.inf, 3.0 * last)
        turn = np.clip(turn, 0.0, 1.0)
        peak = np.abs(gain + 2.0 * middle * turn + 3.0 * last * turn**2) / lasting
        jerk = np.maximum(np.abs(2.0 * middle), np.abs(2.0 * middle + 6.0 * last)) / lasting**2
        most = 1.0 + ROUNDING
        return np.asarray((peak <= most * robot.acceleration) & (jerk <= most * robot.jerk))

    def at(self, times: FloatArray) -> Motion:
        """Positions, velocities and accelerations (m, n) at ``times`` (m,) from the begin [s]."""
        q, v, a = self.begin.q, self.begin.velocity, self.begin.acceleration
        span, t = self.lasting, np.asarray(times)[:, None]
        s, by, gain = np.minimum(t / span, 1.0), self.velocity - v, a * span
        c, d = 3.0 * by - 2.0 * gain, gain - 2.0 * by
        gone = span * s * (v + s * (gain / 2.0 + s * (c / 3.0 + s * d / 4.0)))
        after = np.maximum(t - span, 0.0)
        return (
            q + gone + self.velocity * after,
            np.where(s < 1.0, v + s * (gain + s * (c + s * d)), self.velocity),
            np.where(s < 1.0, (gain + s * (2.0 * c + 3.0 * s * d)) / span, 0.0),
        )


def stopping(robot: Robot, step: Change, period: float) -> Trajectory:
    """The first ``period`` of a change [s], after which all joints brake to a stop.

    Its second row is the state after the period.
    """
    (q,), (v,), (a,) = step.at(np.array([period]))
    brake = Change.of(robot, State(q, v, a), np.zeros(len(q)), period)
    ends = np.unique(brake.lasting)
    rows = zip(step.at(np.array([0.0, period])), brake.at(ends), strict=True)
    q, v, a = (np.vstack(pair) for pair in rows)
    return Trajectory(np.concatenate([[0.0, period], period + ends]), q, v, a, robot.joint_names)


def later(curve: Trajectory, period: float) -> Trajectory:
    """What is left of a curve after a ``period`` [s]; its second row is one more period later."""
    rest = curve.times[curve.times > 1.5 * period] - period
    times = np.unique(np.concatenate([[0.0, period], np.round(rest / period) * period]))
    return Trajectory(times, *curve.sample(times + period), curve.joint_names)


def sampled(poses: FloatArray) -> FloatArray:
    """Poses (P, 6) each :data:`STEP` farther along a way through tool poses (k, 6), and its end.

    They stay where they are when the way grows, all but the last.
    """
    gone = np.append(0.0, np.cumsum(lengths(np.diff(poses[:, :3], axis=0))))
    at = np.append(np.arange(0.0, max(gone[-1] - ROUNDING, 0.0), STEP), gone[-1])
    out = np.stack([np.interp(at, gone, column) for column in poses.T], axis=1)
    out[:, 3:] /= lengths(out[:, 3:])[:, None]
    return out


def fastest(room: FloatArray, acceleration: FloatArray, jerk: FloatArray) -> FloatArray:
    """Velocities (n,) from which joints without acceleration stop within ``room`` (n,).

    A :class:`Change` from v to rest takes 3 v / 2 A, and at least (6 v / J)^(1/2); the joint moves
    half as far as it would at v.
    """
    far = np.clip(room, 0.0, LARGE)
    by_acceleration = np.sqrt(far * np.minimum(acceleration, LARGE) / 0.75)
    return np.minimum(by_acceleration, np.cbrt(far * far * np.minimum(jerk, LARGE) / 1.5))


def nearest(wanted: FloatArray, slopes: FloatArray, least: FloatArray) -> FloatArray | None:
    """The velocities (n,) nearest to ``wanted`` (n,) with ``slopes @ v >= least``; None: none.

    ``slopes`` (m, n), ``least`` (m,). The problem of least distance is one of least squares with
    non-negative multipliers (Lawson and Hanson, 1974, chapter 23), which SciPy solves exactly: a
    solver of general quadratic programs is not needed.
    """
    rows = np.vstack([slopes.T, least - slopes @ wanted])
    aim = np.append(np.zeros(len(wanted)), 1.0)
    left = rows @ nnls(rows, aim)[0] - aim
    return None if abs(left[-1]) < 1e-9 else np.asarray(wanted - left[:-1] / left[-1])


def joints_for(
    robot: Robot, q: FloatArray, linear: FloatArray, axis: FloatArray | None = None
) -> FloatArray:
    """Joint velocities (n,) by which the tool point moves and the tool's axis turns.

    Damped least squares on the Jacobians of tool point and axis.

    ``linear``: (3,) velocity of the tool point [m/s]. ``axis``: (3,) to which the tool's axis
    turns; None: it keeps its direction.
    """
    _, now, along, turning = robot.tool_map(q)
    turn = np.zeros(3) if axis is None else GAIN * (axis - now)
    rows = np.vstack([along, LEVER * turning])
    asked = np.concatenate([linear, LEVER * turn])
    damped = rows @ rows.T + DAMPING**2 * np.eye(len(asked))
    return np.asarray(rows.T @ np.linalg.solve(damped, asked))
