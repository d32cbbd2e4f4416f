"""The fastest times found of waypoints within limits of velocity, acceleration and jerk.

The mathematics is that of :mod:`optipromp.core.planning.timing`; no robot is needed.
"""

import functools
from collections.abc import Iterable, Iterator
from operator import attrgetter
from typing import Protocol

import numpy as np

from optipromp.core.arrays import FloatArray, frozen
from optipromp.core.planning.parameters import TIMING
from optipromp.core.trajectory import Trajectory, control_points

_FINE = 2001  # times from which those of waypoints that are not evenly spaced are interpolated


class Limited(Protocol):
    """Names and limits of joints: a robot, or limits alone."""

    @property
    def joint_names(self) -> tuple[str, ...]:
        """The n names."""

    @property
    def velocity(self) -> FloatArray:
        """Limit (n,) [rad/s or m/s]."""

    @property
    def acceleration(self) -> FloatArray:
        """Limit (n,) [rad/s² or m/s²]."""

    @property
    def jerk(self) -> FloatArray:
        """Limit (n,) [rad/s³ or m/s³]."""


def fastest(
    limits: Limited,
    q: FloatArray,
    least: FloatArray,
    begins: Iterable[FloatArray],
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


def smoothed(values: FloatArray) -> FloatArray:
    """The largest of each three neighbours (m,), then their mean."""
    p = np.pad(values, 1, mode="edge")
    p = np.pad(np.maximum(np.maximum(p[:-2], p[1:-1]), p[2:]), 1, mode="edge")
    return np.asarray((p[:-2] + p[1:-1] + p[2:]) / 3.0)
