"""Temporal modulation: at what phase a movement is at what time."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from optipromp.arrays import FloatArray
from optipromp.errors import InvalidRequestError
from optipromp.promp.checks import finite_array, positive
from optipromp.promp.model import ProMP

if TYPE_CHECKING:
    from scipy.interpolate import PPoly


@dataclass(frozen=True, eq=False)
class Timing:
    """A phase z(t) that rises from 0 to 1 over a duration [s].

    Made by :meth:`linear`, :meth:`minimum_jerk` or :meth:`through`. A ProMP itself knows only
    phases; slower, faster, or starting from rest are different timings of the same one.
    """

    polynomial: "PPoly"
    duration: float

    @staticmethod
    def linear(duration: float) -> "Timing":
        """At even speed."""
        return Timing.through([0.0, positive(duration, "duration")], [0.0, 1.0])

    @staticmethod
    def minimum_jerk(duration: float) -> "Timing":
        """From rest to rest, at the least jerk of the phase: s³(10 - 15s + 6s²), s = t/duration."""
        d = positive(duration, "duration")
        powers = np.array([6.0, -15.0, 10.0, 0.0, 0.0, 0.0]) / d ** np.arange(5.0, -1.0, -1.0)
        return Timing(_polynomial(powers[:, None], np.array([0.0, d])), d)

    @staticmethod
    def through(times: ArrayLike, phases: ArrayLike) -> "Timing":
        """Monotone, once continuously differentiable (PCHIP) through given phases at given times.

        Args:
            times: (k,) strictly increasing from 0 [s], k >= 2.
            phases: (k,) not decreasing, from 0 to 1.

        Raises:
            InvalidRequestError: anything else.
        """
        t, z = finite_array(times, "times", 1), finite_array(phases, "phases", 1)
        if t.size < 2 or t.shape != z.shape:
            raise InvalidRequestError(
                f"times and phases: expected two arrays (k >= 2,), got {t.shape} and {z.shape}"
            )
        if t[0] != 0.0 or (np.diff(t) <= 0.0).any():
            raise InvalidRequestError(f"times must increase from 0, got {t.tolist()}")
        if z[0] != 0.0 or z[-1] != 1.0 or (np.diff(z) < 0.0).any():
            raise InvalidRequestError(f"phases must rise from 0 to 1, got {z.tolist()}")
        from scipy.interpolate import PchipInterpolator

        curve = PchipInterpolator(t, z)
        return Timing(_polynomial(curve.c, curve.x), float(t[-1]))

    def phase(self, times: ArrayLike, derivative: int = 0) -> FloatArray:
        """z, ż or z̈ at times (T,) in [0, duration].

        Raises:
            InvalidRequestError: a time outside.
        """
        t = finite_array(times, "times", 1)
        slack = 1e-9 * self.duration
        outside = (t < -slack) | (t > self.duration + slack)
        if outside.any():
            i = int(np.argmax(outside))
            raise InvalidRequestError(f"times[{i}] is {t[i]}, outside [0, {self.duration}] s")
        values: FloatArray = self.polynomial(np.clip(t, 0.0, self.duration), nu=derivative)
        return np.clip(values, 0.0, 1.0) if derivative == 0 else values


def modulate(
    promp: ProMP, timing: Timing, times: int | ArrayLike
) -> tuple[FloatArray, FloatArray, FloatArray]:
    r"""Mean positions, velocities and accelerations (T, n each) in time.

    :math:`\dot y = \Phi' w\,\dot z` and :math:`\ddot y = \Phi'' w\,\dot z^2 + \Phi' w\,\ddot z`.

    Args:
        promp: the movement.
        timing: its z(t).
        times: (T,) from 0 to the duration [s], or a count of evenly spaced times.

    Raises:
        InvalidRequestError: a time outside.
    """
    if isinstance(times, (int, np.integer)) and not isinstance(times, bool):
        if times < 1:
            raise InvalidRequestError(f"times: a count must be at least 1, got {times}")
        times = np.linspace(0.0, timing.duration, int(times))
    z = timing.phase(times)
    rate, bend = timing.phase(times, 1)[:, None], timing.phase(times, 2)[:, None]
    slope = promp.mean_velocity(z)
    acceleration = promp.mean_acceleration(z) * rate**2 + slope * bend
    return promp.mean_trajectory(z), slope * rate, acceleration


def _polynomial(coefficients: FloatArray, breaks: FloatArray) -> "PPoly":
    from scipy.interpolate import PPoly  # slow to import, and seldom needed

    return PPoly(coefficients, breaks)
