"""Costs in the joints: limits, steps, F_v, smoothness."""

import math
from dataclasses import dataclass

import numpy as np

from optipromp.core.arrays import FloatArray
from optipromp.core.compiled import called
from optipromp.core.optimization.evaluation import Cost, Evaluation


@dataclass(frozen=True, eq=False)
class LimitCost(Cost):
    """Constraint 4: every waypoint is between ``lower`` and ``upper`` (n,) [rad or m]."""

    weight: float
    lower: FloatArray
    upper: FloatArray
    name = "limits"

    def add(self, e: Evaluation, scale: float) -> float:
        return e.in_joints(limit_penalty, scale, self.lower, self.upper)


@called
def limit_penalty(q, lower, upper, scale, gradient, band):
    """½ Σ (excess over the joint limits)²."""
    total = 0.0
    for t in range(q.shape[0]):
        for j in range(q.shape[1]):
            if lower[j] <= q[t, j] <= upper[j]:
                continue
            over = q[t, j] - (upper[j] if q[t, j] > upper[j] else lower[j])
            total += 0.5 * over * over
            gradient[t, j] += scale * over
            band[t, 0, j] += scale
    return total


@dataclass(frozen=True, eq=False)
class StepCost(Cost):
    """No joint moves more than ``largest`` (n,) between waypoints [rad or m]."""

    weight: float
    largest: FloatArray
    name = "step"

    def add(self, e: Evaluation, scale: float) -> float:
        return e.in_joints(step_penalty, scale, self.largest)


@dataclass(frozen=True, eq=False)
class VelocityCost(Cost):
    r""":math:`F_v=\int\dot\xi^\top\dot\xi\,dt`: a penalty on every step."""

    weight: float
    name = "velocity"

    def add(self, e: Evaluation, scale: float) -> float:
        k = 2.0 / e.dt
        return k * e.in_joints(step_penalty, k * scale, np.zeros(e.q.shape[1]))


@called
def step_penalty(q, largest, scale, gradient, band):
    """½ Σ max(0, |q_{t+1} − q_t| − largest)²."""
    total = 0.0
    for t in range(q.shape[0] - 1):
        for j in range(q.shape[1]):
            step = q[t + 1, j] - q[t, j]
            over = abs(step) - largest[j]
            if over < 0.0:
                continue
            total += 0.5 * over * over
            push = math.copysign(scale * over, step)
            gradient[t + 1, j] += push
            gradient[t, j] -= push
            band[t, 0, j] += scale
            band[t + 1, 0, j] += scale
            band[t, 1, j] -= scale
    return total


@dataclass(frozen=True, eq=False)
class SmoothnessCost(Cost):
    r""":math:`\tfrac12\int\lVert\ddot\xi\rVert^2dt`: CHOMP's metric A as a cost."""

    weight: float
    name = "smoothness"

    def add(self, e: Evaluation, scale: float) -> float:
        return e.in_joints(smoothness, scale, e.dt)


@called
def smoothness(q, dt, scale, gradient, band):
    """½ ∫ ‖ξ̈‖² dt; before its first and after its last waypoint the trajectory is at rest."""
    n_waypoints, total, k = q.shape[0], 0.0, scale / dt**3
    for t in range(n_waypoints):
        before, after = max(t - 1, 0), min(t + 1, n_waypoints - 1)
        rows = ((before, 1.0), (t, -2.0), (after, 1.0))
        for j in range(q.shape[1]):
            e = q[before, j] - 2.0 * q[t, j] + q[after, j]
            total += 0.5 * e * e / dt**3
            for a, share in rows:
                gradient[a, j] += k * share * e
                for b, other in rows:
                    if b >= a:
                        band[a, b - a, j] += k * share * other
    return total
