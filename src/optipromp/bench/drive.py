"""Velocities in, references of the joint controller out, within the limits of the joints."""

import numpy as np

from optipromp.core.arrays import FloatArray
from optipromp.core.robots.model import Robot
from optipromp.core.trajectory import State

BRAKE = 0.9  # share of the acceleration limit that brakes before the end of a range: a choice
GAIN = 3.0  # [1/s] of the turn of the tool's axis: a choice
LEVER = 0.2  # [m] by which a turn counts as a length: a choice
DAMPING = 0.01  # [m] of the least squares: a choice


def driven(
    robot: Robot, before: State, wanted: FloatArray, period: float, count: int
) -> list[State]:
    """References of ``count`` ticks of a controller in which the joints come to a velocity.

    The acceleration is constant, at most its limit. The velocity is at most its limit, and so low
    that the joint can brake before the end of its range.

    ``robot``: whose limits are kept. ``before``: the last reference. ``wanted``: (n,) velocity at
    the end [rad/s or m/s]. ``period``: time from ``before`` to the last tick [s]. ``count``: number
    of ticks.

    Returns: The references, a tick apart, the last one ``period`` after ``before``.
    """
    most = BRAKE * robot.acceleration
    ahead = before.q + 0.5 * period * before.velocity  # about where the velocity is reached
    up, down = robot.upper - ahead, ahead - robot.lower
    rise = _braking(up, most, period, before.velocity)
    fall = _braking(down, most, period, -before.velocity)
    top = np.minimum(robot.velocity, rise)
    low = -np.minimum(robot.velocity, fall)
    aim = np.clip(wanted, np.minimum(low, top), top)
    change = np.clip(
        aim - before.velocity, -robot.acceleration * period, robot.acceleration * period
    )
    gain, out = change / period, []
    for k in range(1, count + 1):
        t = period * k / count
        q = before.q + t * before.velocity + 0.5 * t * t * gain
        out.append(State(np.clip(q, robot.lower, robot.upper), before.velocity + t * gain, gain))
    return out


def _braking(room: FloatArray, most: FloatArray, period: float, speed: FloatArray) -> FloatArray:
    """The velocity (n,) a period later from which a joint still stops within its range.

    Where ``room`` (n,) is negative, the joint has to stop within the period, and turns back: it
    brakes from ``speed`` (n,) by ``most`` (n,) throughout.
    """
    lead = 0.5 * most * period
    far = np.nan_to_num(np.maximum(room, 0.0), posinf=1e9)
    return np.where(room >= 0.0, np.sqrt(lead**2 + 2.0 * most * far) - lead, speed - most * period)


def joints_for(
    robot: Robot, q: FloatArray, linear: FloatArray, axis: FloatArray | None = None
) -> FloatArray:
    """Joint velocities (n,) by which the tool point moves and the tool's axis turns.

    Damped least squares on the Jacobians of tool point and axis.

    ``robot``: with its tool. ``q``: (n,) configuration. ``linear``: (3,) velocity of the tool point
    [m/s]. ``axis``: (3,) to which the tool's axis turns; None: it keeps its direction.
    """
    _, now, along, turning = robot.tool_map(q)
    turn = np.zeros(3) if axis is None else GAIN * (axis - now)
    rows = np.vstack([along, LEVER * turning])
    asked = np.concatenate([linear, LEVER * turn])
    damped = rows @ rows.T + DAMPING**2 * np.eye(len(asked))
    return np.asarray(rows.T @ np.linalg.solve(damped, asked))
