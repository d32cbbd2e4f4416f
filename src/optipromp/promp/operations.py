"""Combining primitives (Paraschos et al., 2013, section 2.3), and moving them in time."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from optipromp.arrays import FloatArray, read_only
from optipromp.errors import InvalidRequestError
from optipromp.promp.checks import finite_array, phase_array, positive
from optipromp.promp.gaussian import product
from optipromp.promp.model import ProMP, trusted

if TYPE_CHECKING:
    from scipy.interpolate import PPoly


@dataclass(frozen=True, eq=False)
class Marginals:
    """A Gaussian for each phase: what co-activation with changing activations gives.

    Attributes:
        phases: (T,).
        mean: (T, n).
        covariance: (T, n, n).
    """

    phases: FloatArray
    mean: FloatArray
    covariance: FloatArray

    @property
    def standard_deviation(self) -> FloatArray:
        """Standard deviation of each joint at each phase (T, n)."""
        variance = np.einsum("tjj->tj", self.covariance)
        result: FloatArray = np.sqrt(np.maximum(variance, 0.0))
        return result


def coactivate(promps: Sequence[ProMP], activations: ArrayLike | None = None) -> ProMP:
    r"""Several primitives at once, each as far as it is certain; again a ProMP.

    .. math:: p(w) \propto \prod_i p_i(w)^{\alpha_i}: \quad
              \Sigma = \Big(\sum_i \alpha_i\Sigma_i^{-1}\Big)^{-1}, \quad
              \mu = \Sigma\sum_i\alpha_i\Sigma_i^{-1}\mu_i

    computed without an inverse of any Σ_i, so primitives conditioned exactly are welcome.

    Args:
        promps: on the same basis and joints.
        activations: α (m,), each >= 0, not all 0; by default all 1.

    Raises:
        InvalidRequestError: different bases or joints, bad activations, or two primitives that
            are certain of different values.
    """
    _check_alike(promps, same_basis=True)
    alpha = _activations(activations, (len(promps),))
    moments = [(promp.weights, promp.covariance) for promp in promps]
    return trusted(promps[0], *_power_product(moments, alpha, "coactivate"))


def coactivate_marginals(
    promps: Sequence[ProMP], activations: ArrayLike, phases: int | ArrayLike
) -> Marginals:
    r"""Several primitives with activations that change along the phase.

    At each phase on its own, :math:`p(y_t) \propto \prod_i N(y_t; \mu_{i,t}, \Sigma_{i,t})^
    {\alpha_{i,t}}`. Bases may differ.

    Args:
        promps: m primitives of the same joints.
        activations: (m, T), each >= 0, not all 0 at any phase.
        phases: (T,) in [0, 1], or a count.

    Raises:
        InvalidRequestError: different joints, bad activations, or two primitives that are certain
            of different values at a phase where both are active.
    """
    _check_alike(promps, same_basis=False)
    z = phase_array(phases)
    alpha = _activations(activations, (len(promps), z.size))
    each = [promp.marginals(z) for promp in promps]
    at = [
        _power_product([(m[t], c[t]) for m, c in each], alpha[:, t], "coactivate_marginals")
        for t in range(z.size)
    ]
    mean, covariance = (np.array(part) for part in zip(*at, strict=True))
    return Marginals(read_only(z.copy()), read_only(mean), read_only(covariance))


def blend(
    first: ProMP,
    second: ProMP,
    phases: int | ArrayLike,
    at: float = 0.5,
    width: float = 0.2,
) -> Marginals:
    r"""From one primitive to another: co-activation that moves over smoothly.

    The second's activation rises from 0 to 1 over ``width`` of the phase about ``at`` as
    :math:`s^3(10 - 15s + 6s^2)`; the first's is what is missing to 1.

    Args:
        first: followed before the change.
        second: followed after it.
        phases: (T,) in [0, 1], or a count.
        at: phase of the middle of the change.
        width: > 0, in phase.

    Raises:
        InvalidRequestError: as :func:`coactivate_marginals`, or ``at``, ``width`` out of range.
    """
    z = phase_array(phases)
    middle = float(phase_array(float(at))[0])
    s = np.clip((z - middle) / positive(width, "width") + 0.5, 0.0, 1.0)
    rise = s**3 * (10.0 - 15.0 * s + 6.0 * s**2)
    return coactivate_marginals((first, second), np.stack([1.0 - rise, rise]), z)


def _power_product(
    moments: Sequence[tuple[FloatArray, FloatArray]], powers: FloatArray, name: str
) -> tuple[FloatArray, FloatArray]:
    """Normalised product of Gaussians to powers, of which those of 0 are left out."""
    active = [(m, c / power) for (m, c), power in zip(moments, powers, strict=True) if power > 0.0]
    return reduce(lambda one, other: product(one, other, name), active)


def _activations(activations: ArrayLike | None, shape: tuple[int, ...]) -> FloatArray:
    alpha = np.ones(shape) if activations is None else finite_array(activations, "activations")
    if alpha.shape != shape:
        raise InvalidRequestError(f"activations: expected shape {shape}, got {alpha.shape}")
    if (alpha < 0.0).any() or not (alpha.max(axis=0) > 0.0).all():
        raise InvalidRequestError("activations must be at least 0, and not all 0 at once")
    return alpha


def _check_alike(promps: Sequence[ProMP], same_basis: bool) -> None:
    if not promps:
        raise InvalidRequestError("expected at least one ProMP")
    for i, promp in enumerate(promps):
        if promp.joint_names != promps[0].joint_names:
            raise InvalidRequestError(
                f"ProMP {i} moves {', '.join(promp.joint_names)}; the first "
                f"{', '.join(promps[0].joint_names)}"
            )
        if same_basis and promp.basis != promps[0].basis:
            raise InvalidRequestError(f"ProMP {i} has {promp.basis}; the first {promps[0].basis}")


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
