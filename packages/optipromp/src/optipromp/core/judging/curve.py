r"""The curve between waypoints as the judge sees it: quintic polynomials and their extremes.

Between two waypoints at an interval h [s], a joint moves along :math:`\sum_k c_k s^k`, s from 0
to 1. The extremes of each derivative are exact, not sampled: an extreme lies at an end of the
interval or at a root of the next derivative. That derivative has at most one root between two
neighbouring roots of the derivative after it.
"""

import functools
from typing import NamedTuple

import numpy as np

from optipromp.core.arrays import FloatArray, IntArray, read_only
from optipromp.core.compiled import inner, kernel
from optipromp.core.trajectory import Trajectory


class Extremes(NamedTuple):
    """Extremes of each joint over a whole trajectory, and when they occur."""

    lowest: FloatArray  # (n,) positions [rad or m]
    highest: FloatArray  # (n,)
    largest: FloatArray  # (3, n) absolute velocity, acceleration, jerk
    when: FloatArray  # (5, n) times of the five rows above [s]


@functools.lru_cache(maxsize=4)  # compares trajectories by identity
def coefficients(trajectory: Trajectory) -> FloatArray:
    """Coefficients c (T-1, n, 6) of the quintics that meet both rows of each interval."""
    q, h = trajectory.positions, np.diff(trajectory.times)[:, None]
    v, a = h * trajectory.velocities[:-1], h * h * trajectory.accelerations[:-1]
    w, b = h * trajectory.velocities[1:], h * h * trajectory.accelerations[1:]
    d = q[1:] - q[:-1]
    c = (
        q[:-1], v, 0.5 * a, 10.0 * d - 6.0 * v - 4.0 * w - 1.5 * a + 0.5 * b,
        -15.0 * d + 8.0 * v + 7.0 * w + 1.5 * a - b, 6.0 * d - 3.0 * (v + w) - 0.5 * (a - b),
    )  # fmt: skip
    return read_only(np.stack(c, axis=2))


def extremes(trajectory: Trajectory) -> Extremes:
    """The extremes of a trajectory."""
    n = trajectory.positions.shape[1]
    c, times = coefficients(trajectory), np.array(trajectory.times)
    values, when = np.zeros((5, n)), np.zeros((5, n))
    values[0] = values[1] = trajectory.positions[0]
    find_extremes(c, times, values, when)
    return Extremes(values[0], values[1], values[2:], when)


@kernel
def find_extremes(c, times, values, when):
    """Rows of :class:`Extremes` (5, n) from coefficients ``c`` (T-1, n, 6), in place.

    The ends of all intervals come first. Then come the insides of the intervals where a derivative
    may be larger: it differs from its value at the nearer end by at most half its largest slope.
    """
    places, turning, p = np.empty(8), np.empty(8), np.empty(6)
    for t in range(c.shape[0]):
        h = times[t + 1] - times[t]
        for j in range(c.shape[1]):
            for order in range(4):
                _derived(c[t, j], order, h, p)
                for s in (0.0, 1.0):
                    _noted(_value(p, 5 - order, s), order, times[t] + s * h, j, values, when)
    for t in range(c.shape[0]):
        h = times[t + 1] - times[t]
        for j in range(c.shape[1]):
            lowest = 4  # order of the lowest derivative that may be larger inside
            for order in range(3, -1, -1):
                _derived(c[t, j], order, h, p)
                slope = 0.0
                for k in range(1, 6 - order):
                    slope += k * abs(p[k])
                a, b = _value(p, 5 - order, 0.0), _value(p, 5 - order, 1.0)
                if order == 0:
                    inside = max(a, b) + 0.5 * slope > values[1, j]
                    inside |= min(a, b) - 0.5 * slope < values[0, j]
                else:
                    inside = max(abs(a), abs(b)) + 0.5 * slope > values[order + 1, j]
                if inside:
                    lowest = order
            count = 0  # of places where the next derivative has its extremes
            for order in range(3, lowest - 1, -1):
                _derived(c[t, j], order + 1, h, p)
                count = _roots(p, 4 - order, places, count, turning)
                _derived(c[t, j], order, h, p)
                for i in range(count):
                    s = places[i] = turning[i]
                    _noted(_value(p, 5 - order, s), order, times[t] + s * h, j, values, when)


@inner
def _derived(c, order, h, p):
    """Coefficients ``p`` (6,) in s of a derivative with respect to time, in place."""
    power = h**order
    for k in range(6 - order):
        factor = 1.0
        for i in range(order):
            factor *= k + order - i
        p[k] = c[k + order] * factor / power


@inner
def _noted(value, order, time, j, values, when):
    """Keep a value of a derivative of joint ``j`` if it is an extreme so far."""
    if order == 0:
        if value < values[0, j]:
            values[0, j], when[0, j] = value, time
        if value > values[1, j]:
            values[1, j], when[1, j] = value, time
    elif abs(value) > values[order + 1, j]:
        values[order + 1, j], when[order + 1, j] = abs(value), time


@inner
def _value(p, degree, s):
    """The polynomial with coefficients ``p`` at s (Horner)."""
    out = p[degree]
    for k in range(degree - 1, -1, -1):
        out = out * s + p[k]
    return out


@inner
def _roots(p, degree, places, count, out):
    """Write the roots in (0, 1) of the polynomial ``p`` to ``out``; return their number.

    ``places`` are the ``count`` roots of its derivative, in ascending order: the polynomial is
    monotone between them.
    """
    found, low = 0, 0.0
    before = _value(p, degree, 0.0)
    for i in range(count + 1):
        high = places[i] if i < count else 1.0
        after = _value(p, degree, high)
        if before * after < 0.0:
            a, b = low, high
            for _ in range(60):
                middle = 0.5 * (a + b)
                if _value(p, degree, middle) * before > 0.0:
                    a = middle
                else:
                    b = middle
            out[found] = 0.5 * (a + b)
            found += 1
        low, before = high, after
    return found


def along(trajectory: Trajectory, parts: IntArray) -> tuple[FloatArray, FloatArray, IntArray]:
    """The curve, each interval cut evenly in time into ``parts`` (T-1,).

    Returns:
        Times (M,) [s], configurations (M, n), and the indices (T,) of the waypoints among them.
    """
    rows = np.zeros(trajectory.n_waypoints, dtype=np.int64)
    np.cumsum(parts, out=rows[1:])
    fine, times = np.empty((rows[-1] + 1, trajectory.positions.shape[1])), np.empty(rows[-1] + 1)
    _cut(coefficients(trajectory), np.array(trajectory.times), rows, times, fine)
    fine[rows] = trajectory.positions
    return times, fine, rows


@kernel
def _cut(c, times, rows, at, fine):
    """Write times ``at`` (M,) and configurations ``fine`` (M, n); row ``rows[t]`` is waypoint t."""
    for t in range(c.shape[0]):
        count = rows[t + 1] - rows[t]
        for i in range(count):
            s = i / count
            at[rows[t] + i] = times[t] + s * (times[t + 1] - times[t])
            for j in range(c.shape[1]):
                fine[rows[t] + i, j] = _value(c[t, j], 5, s)
    at[rows[-1]] = times[-1]
