"""From a plan's waypoints to a reference that keeps velocity, acceleration and jerk limits."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from optipromp.arrays import FloatArray, frozen
from optipromp.robots.model import Robot
from optipromp.trajectory import Trajectory

RAMPS = (0.02, 0.05, 0.1, 0.2, 0.3, 0.5, 0.8)  # shares of the plan's duration that are tried
SAMPLES = 8  # per waypoint, to find the largest derivatives
MARGIN = 3e-3  # share below the limits, for peaks between the samples


@dataclass(frozen=True, eq=False)
class Reference:
    """A motion in time, from rest to rest.

    Attributes:
        times: (N,) at the controller's rate [s].
        q: (N, n), ``velocity`` (N, n), ``acceleration`` (N, n).
        use: largest share of each limit used: ``velocity``, ``acceleration``, ``jerk``.
    """

    times: FloatArray
    q: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    use: dict[str, float]

    @property
    def duration(self) -> float:
        """[s]."""
        return float(self.times[-1])


def reference(trajectory: Trajectory, robot: Robot, *, speed: float, dt: float) -> Reference:
    r"""Run along the plan's path within shares of the limits.

    The path P(u) is the quintic spline through the waypoints over the plan's own time u, so that
    the geometry stays the plan's. The law u(t) starts and ends with a ramp of length τ in which u̇
    rises from 0 to its cruising value by the smoothest quintic step, and cruises in between. For
    each τ of :data:`RAMPS` the cruising speed is the largest at which

    .. math:: |q̇| \le σ v,\quad |q̈| \le σ^2 a,\quad |\dddot q| \le σ^3 j

    for ``speed`` σ (time scaled by 1/σ uses exactly these shares) and at most the plan's own speed;
    the τ that ends first is taken.

    Args:
        trajectory: (T, n) waypoints.
        robot: its velocity, acceleration and jerk limits, which may be infinite.
        speed: σ.
        dt: spacing of the reference [s].
    """
    from scipy.interpolate import make_interp_spline

    waypoints, times = trajectory.positions, trajectory.times
    order = 5 if len(waypoints) >= 6 else 2
    ends = None
    if order == 5:
        none = np.zeros(waypoints.shape[1])
        ends = ([(3, none), (4, none)], [(3, none), (4, none)])
    path = make_interp_spline(times, waypoints, k=order, bc_type=ends)
    limits = (speed * robot.velocity, speed**2 * robot.acceleration, speed**3 * robot.jerk)
    best = (np.inf, 1.0, RAMPS[-1])
    for share in RAMPS:
        ramp = share * trajectory.duration
        scale = _slowest(path, trajectory, ramp, limits)
        best = min(best, (scale * (trajectory.duration + ramp), scale, ramp))
    _, scale, ramp = best
    while True:  # the samples at ``dt`` may find a peak between those the scale was chosen by
        t, q, velocity, acceleration, use = _sampled(path, trajectory, robot, scale, ramp, dt)
        excess = max(use[name] ** (1.0 / k) / speed for k, name in enumerate(use, start=1))
        if not excess > 1.0 + 1e-9:
            break
        scale *= excess * (1.0 + 1e-6)
    return Reference(frozen(t), frozen(q), frozen(velocity), frozen(acceleration), use)


def _sampled(
    path: Any, trajectory: Trajectory, robot: Robot, scale: float, ramp: float, dt: float
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, dict[str, float]]:
    """Times, positions, velocities, accelerations at ``dt``, and the share of each limit used."""
    end = trajectory.duration + ramp
    count = max(int(np.ceil(scale * end / dt - 1e-9)), 2)
    t = np.asarray(np.arange(count + 1) * dt, dtype=np.float64)
    law = _law(np.minimum(t / scale, end), trajectory.duration, ramp)
    rates = (law[0], law[1] / scale, law[2] / scale**2, law[3] / scale**3)
    velocity, acceleration, jerk = _chain(
        tuple(np.asarray(path(rates[0], k)) for k in (1, 2, 3)), rates
    )
    use = {
        name: float(np.max(np.abs(values) / limit, initial=0.0))
        for name, values, limit in (
            ("velocity", velocity, robot.velocity),
            ("acceleration", acceleration, robot.acceleration),
            ("jerk", jerk, robot.jerk),
        )
    }
    return t, np.asarray(path(rates[0])), velocity, acceleration, use


def _slowest(
    path: Any, trajectory: Trajectory, ramp: float, limits: tuple[FloatArray, ...]
) -> float:
    """The factor >= 1 by which time must be stretched for the limits to hold."""
    end = trajectory.duration + ramp
    u = _law(np.linspace(0.0, end, SAMPLES * trajectory.n_waypoints), trajectory.duration, ramp)
    along = tuple(np.asarray(path(u[0], order)) for order in (1, 2, 3))
    worst = 1.0
    for order, (values, limit) in enumerate(zip(_chain(along, u), limits, strict=True), start=1):
        ratio = float(np.max(np.abs(values) / limit, initial=0.0))
        worst = max(worst, ((1.0 + MARGIN) * ratio) ** (1.0 / order))
    return worst


def _chain(
    p: tuple[FloatArray, ...], u: tuple[FloatArray, ...]
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """First three time derivatives of P(u(t)) from P', P'', P''' (N, n) and u, u̇, ü, u⃛ (N,)."""
    u1, u2, u3 = (values[:, None] for values in u[1:])
    return p[0] * u1, p[1] * u1**2 + p[0] * u2, p[2] * u1**3 + 3.0 * p[1] * u1 * u2 + p[0] * u3


def _law(t: FloatArray, duration: float, ramp: float) -> tuple[FloatArray, ...]:
    """U and its three derivatives (N,): 0 to ``duration`` in ``duration + ramp``, cruising at 1."""
    end = duration + ramp
    late = t > end / 2.0
    x = np.clip(np.where(late, end - t, t) / ramp, 0.0, 1.0)
    travelled = ramp * x**4 * (2.5 - 3.0 * x + x**2) + np.maximum(
        np.where(late, end - t, t) - ramp, 0.0
    )
    first = x**3 * (10.0 - 15.0 * x + 6.0 * x**2)
    second = 30.0 * x**2 * (1.0 - x) ** 2 / ramp
    third = 60.0 * x * (1.0 - x) * (1.0 - 2.0 * x) / ramp**2
    u = np.where(late, duration - travelled, travelled)
    return np.clip(u, 0.0, duration), first, np.where(late, -second, second), third
