"""Kernels in the joints: limits, steps, F_v, smoothness."""

import math

from numba import njit


@njit(cache=True, error_model="numpy", nogil=True)
def limit_penalty(q, lower, upper, weight, gradient, band):  # type: ignore[no-untyped-def]
    """½ Σ weight·(excess over the joint limits)²."""
    total = 0.0
    for t in range(q.shape[0]):
        for j in range(q.shape[1]):
            over = 0.0
            if q[t, j] > upper[j]:
                over = q[t, j] - upper[j]
            elif q[t, j] < lower[j]:
                over = q[t, j] - lower[j]
            if over != 0.0:
                total += 0.5 * weight * over * over
                gradient[t, j] += weight * over
                band[t, 0, j] += weight
    return total


@njit(cache=True, error_model="numpy", nogil=True)
def step_penalty(q, largest, weight, gradient, band):  # type: ignore[no-untyped-def]
    """½ Σ weight·max(0, |q_{t+1} − q_t| − largest)², ``largest`` (n,) [rad or m]."""
    total = 0.0
    for t in range(q.shape[0] - 1):
        for j in range(q.shape[1]):
            step = q[t + 1, j] - q[t, j]
            over = abs(step) - largest[j]
            if over <= 0.0:
                continue
            total += 0.5 * weight * over * over
            push = math.copysign(weight * over, step)
            gradient[t + 1, j] += push
            gradient[t, j] -= push
            band[t, 0, j] += weight
            band[t + 1, 0, j] += weight
            band[t, 1, j] -= weight
    return total


@njit(cache=True, error_model="numpy", nogil=True)
def velocity_functional(q, dt, weight, gradient, band):  # type: ignore[no-untyped-def]
    """F_v = ∫ ξ̇ᵀ ξ̇ dt with the velocity of each interval."""
    total = 0.0
    for t in range(q.shape[0] - 1):
        for j in range(q.shape[1]):
            step = q[t + 1, j] - q[t, j]
            total += step * step / dt
            push = 2.0 * weight * step / dt
            gradient[t + 1, j] += push
            gradient[t, j] -= push
            k = 2.0 * weight / dt
            band[t, 0, j] += k
            band[t + 1, 0, j] += k
            band[t, 1, j] -= k
    return total


@njit(cache=True, error_model="numpy", nogil=True)
def smoothness(q, dt, weight, gradient, band):  # type: ignore[no-untyped-def]
    """½ ∫ ‖ξ̈‖² dt, the trajectory at rest before its first and after its last knot."""
    n_knots, n = q.shape
    total = 0.0
    k = weight / dt**3
    for t in range(n_knots):
        before, after = max(t - 1, 0), min(t + 1, n_knots - 1)
        ends = before == t or after == t
        for j in range(n):
            e = q[before, j] - 2.0 * q[t, j] + q[after, j]
            total += 0.5 * e * e / dt**3
            gradient[before, j] += k * e
            gradient[t, j] -= 2.0 * k * e
            gradient[after, j] += k * e
            if ends:
                low = min(before, t)
                band[low, 0, j] += k
                if after == t:
                    band[t, 0, j] += k
                else:
                    band[after, 0, j] += k
                band[low, 1, j] -= k
            else:
                band[before, 0, j] += k
                band[t, 0, j] += 4.0 * k
                band[after, 0, j] += k
                band[before, 1, j] -= 2.0 * k
                band[t, 1, j] -= 2.0 * k
                band[before, 2, j] += k
    return total
