"""Signed distances and their gradients: the inner loop of every clearance in the library.

Distances are Euclidean, negative inside, and exact for primitives. Gradients are finite everywhere.
At a kink of the distance (a sphere's centre, a capsule's axis, the medial planes of a box) the
gradient is one of the one-sided limits.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from optipromp.core.arrays import FloatArray
from optipromp.core.compiled import called, inlined, inner
from optipromp.core.errors import InvalidRequestError
from optipromp.core.geometry import shapes
from optipromp.core.geometry.obstacles import Obstacles

_NEWTON = 30  # steps to the nearest point of an ellipsoid, at most; 3 to 8 suffice
_TINY = 1e-300  # [m²] squared lengths up to here count as 0: below 2e-308 numbers lose digits


@called
def signed_distance(
    obstacles: Obstacles, k: int, x0: float, x1: float, x2: float, gradient: FloatArray
) -> float:
    """Signed distance [m] from a world point to obstacle ``k``; the gradient is written in place.

    ``obstacles``: from :func:`optipromp.core.geometry.obstacles.pack`. ``k``: index of the
    obstacle, 0 <= k < K (not checked). ``x0``, ``x1``, ``x2``: world coordinates of the point [m].
    ``gradient``: (3,) dD/dx in the world frame, written in place; of unit length for primitives.

    Returns: D: above 0 outside, 0 on the surface, below 0 inside.
    """
    distance, gradient[0], gradient[1], gradient[2] = distance_and_gradient(
        obstacles, k, x0, x1, x2
    )
    return float(distance)


@inlined
def distance_and_gradient(obstacles, k, x0, x1, x2):
    """:func:`signed_distance` that returns the gradient, which then stays in registers."""
    kind = obstacles.kind[k]
    position = obstacles.position
    d0, d1, d2 = x0 - position[k, 0], x1 - position[k, 1], x2 - position[k, 2]
    size = obstacles.size
    if kind == shapes.SPHERE:
        squared = d0 * d0 + d1 * d1 + d2 * d2
        length = math.sqrt(squared)
        if squared > _TINY:
            inverse = 1.0 / length
            return length - size[k, 0], d0 * inverse, d1 * inverse, d2 * inverse
        return length - size[k, 0], 0.0, 0.0, 1.0

    rotation = obstacles.rotation
    if kind == shapes.HALF_SPACE:
        n0, n1, n2 = rotation[k, 0, 2], rotation[k, 1, 2], rotation[k, 2, 2]
        return d0 * n0 + d1 * n1 + d2 * n2, n0, n1, n2

    l0 = rotation[k, 0, 0] * d0 + rotation[k, 1, 0] * d1 + rotation[k, 2, 0] * d2
    l1 = rotation[k, 0, 1] * d0 + rotation[k, 1, 1] * d1 + rotation[k, 2, 1] * d2
    l2 = rotation[k, 0, 2] * d0 + rotation[k, 1, 2] * d1 + rotation[k, 2, 2] * d2
    if kind == shapes.BOX:
        distance, g0, g1, g2 = _box(l0, l1, l2, size[k, 0], size[k, 1], size[k, 2])
    elif kind == shapes.CAPSULE:
        distance, g0, g1, g2 = _capsule(l0, l1, l2, size[k, 0], size[k, 1])
    elif kind == shapes.CYLINDER:
        distance, g0, g1, g2 = _cylinder(l0, l1, l2, size[k, 0], size[k, 1])
    elif kind == shapes.ELLIPSOID:
        distance, g0, g1, g2 = _ellipsoid(l0, l1, l2, size[k, 0], size[k, 1], size[k, 2])
    elif kind == shapes.CONE:
        distance, g0, g1, g2 = _cone(l0, l1, l2, size[k, 0], size[k, 1], size[k, 2])
    else:
        distance, g0, g1, g2 = _grid(obstacles, obstacles.grid[k], l0, l1, l2)
    return (
        distance,
        rotation[k, 0, 0] * g0 + rotation[k, 0, 1] * g1 + rotation[k, 0, 2] * g2,
        rotation[k, 1, 0] * g0 + rotation[k, 1, 1] * g1 + rotation[k, 1, 2] * g2,
        rotation[k, 2, 0] * g0 + rotation[k, 2, 1] * g1 + rotation[k, 2, 2] * g2,
    )


@inlined
def _box(l0, l1, l2, h0, h1, h2):
    s0, s1, s2 = math.copysign(1.0, l0), math.copysign(1.0, l1), math.copysign(1.0, l2)
    e0, e1, e2 = abs(l0) - h0, abs(l1) - h1, abs(l2) - h2
    o0, o1, o2 = max(e0, 0.0), max(e1, 0.0), max(e2, 0.0)
    outside = o0 * o0 + o1 * o1 + o2 * o2
    if outside > _TINY:
        distance = math.sqrt(outside)
        inverse = 1.0 / distance
        return distance, s0 * o0 * inverse, s1 * o1 * inverse, s2 * o2 * inverse
    if e0 >= e1 and e0 >= e2:
        return e0, s0, 0.0, 0.0
    if e1 >= e2:
        return e1, 0.0, s1, 0.0
    return e2, 0.0, 0.0, s2


@inlined
def _capsule(l0, l1, l2, radius, half):
    z = l2 - min(max(l2, -half), half)
    squared = l0 * l0 + l1 * l1 + z * z
    if squared > _TINY:
        length = math.sqrt(squared)
        inverse = 1.0 / length
        return length - radius, l0 * inverse, l1 * inverse, z * inverse
    return -radius, 1.0, 0.0, 0.0


@inlined
def _cylinder(l0, l1, l2, radius, half):
    squared = l0 * l0 + l1 * l1
    if squared > _TINY:
        rho = math.sqrt(squared)
        u0, u1 = l0 / rho, l1 / rho
    else:
        rho, u0, u1 = 0.0, 1.0, 0.0
    side = math.copysign(1.0, l2)
    radial, axial = rho - radius, abs(l2) - half
    if radial > 0.0 and axial > 0.0:
        squared = radial * radial + axial * axial
        if squared > _TINY:
            distance = math.sqrt(squared)
            a = radial / distance
            return distance, a * u0, a * u1, side * axial / distance
    if radial >= axial:
        return radial, u0, u1, 0.0
    return axial, 0.0, 0.0, side


@inner
def _ellipsoid(l0, l1, l2, e0, e1, e2):
    """The nearest point is q_i = e_i² l_i / (t + e_i²), where t is the root of Σ (q_i / e_i)² = 1.

    Newton's steps on 1 / sqrt(Σ) - 1, which is concave, approach the root from below. The unknown
    ``over`` is t less its pole: its digits are not lost where t is close to the pole.
    """
    least = min(e0, e1, e2)
    small = 1e-13 * least  # on a plane of symmetry the root would be the pole
    p0, p1, p2 = max(abs(l0), small), max(abs(l1), small), max(abs(l2), small)
    s0, s1, s2 = e0 * e0, e1 * e1, e2 * e2
    r0, r1, r2 = s0 - least * least, s1 - least * least, s2 - least * least
    over = max(e0 * p0 - r0, e1 * p1 - r1, e2 * p2 - r2)
    u0, u1, u2 = 0.0, 0.0, 0.0
    for _ in range(_NEWTON):
        u0, u1, u2 = e0 * p0 / (over + r0), e1 * p1 / (over + r1), e2 * p2 / (over + r2)
        total = u0 * u0 + u1 * u1 + u2 * u2
        slope = u0 * u0 / (over + r0) + u1 * u1 / (over + r1) + u2 * u2 / (over + r2)
        step = total * (math.sqrt(total) - 1.0) / slope
        over += step
        if abs(step) <= 1e-15 * over:
            break
    n0, n1, n2 = u0 / e0, u1 / e1, u2 / e2
    inverse = 1.0 / math.sqrt(n0 * n0 + n1 * n1 + n2 * n2)
    n0, n1, n2 = n0 * inverse, n1 * inverse, n2 * inverse
    distance = (p0 - e0 * u0) * n0 + (p1 - e1 * u1) * n1 + (p2 - e2 * u2) * n2
    return distance, math.copysign(n0, l0), math.copysign(n1, l1), math.copysign(n2, l2)


@inner
def _cone(l0, l1, l2, radius, half, tip):
    """A cone's section with a half-plane through its axis is two discs joined by a tangent."""
    squared = l0 * l0 + l1 * l1
    rho, u0, u1 = 0.0, 1.0, 0.0
    if squared > _TINY:
        rho = math.sqrt(squared)
        u0, u1 = l0 / rho, l1 / rho
    height = l2 + half  # above the tip's centre
    sine = (tip - radius) / (2.0 * half)
    cosine = math.sqrt(1.0 - sine * sine)
    along = cosine * height - sine * rho
    if 0.0 <= along <= 2.0 * half * cosine:
        return cosine * rho + sine * height - tip, cosine * u0, cosine * u1, sine
    if along > 0.0:
        height, tip = height - 2.0 * half, radius
    away = math.sqrt(rho * rho + height * height)
    if away * away > _TINY:
        return away - tip, rho / away * u0, rho / away * u1, height / away
    return -tip, 0.0, 0.0, 1.0


@inner
def _grid(obstacles, g, l0, l1, l2):
    """Trilinear interpolation in the grid; outside, the larger of two lower bounds of the distance.

    Let c be the point of the grid's box nearest to l, and v(c) the value there. Every surface point
    s satisfies (l - c)·(c - s) >= 0, so D(l) >= sqrt(|l - c|² + v(c)²). The second bound is the
    distance to the box shrunk by GRID_PADDING cells, which still holds the shape.
    """
    origin = obstacles.grid_origin
    spacing = obstacles.grid_spacing[g]
    nodes = obstacles.grid_shape
    n0, n1, n2 = nodes[g, 0], nodes[g, 1], nodes[g, 2]
    p0, p1, p2 = l0 - origin[g, 0], l1 - origin[g, 1], l2 - origin[g, 2]
    c0 = min(max(p0, 0.0), (n0 - 1) * spacing)
    c1 = min(max(p1, 0.0), (n1 - 1) * spacing)
    c2 = min(max(p2, 0.0), (n2 - 1) * spacing)
    inverse = 1.0 / spacing
    i0 = min(int(c0 * inverse), n0 - 2)
    i1 = min(int(c1 * inverse), n1 - 2)
    i2 = min(int(c2 * inverse), n2 - 2)
    a0, a1, a2 = c0 * inverse - i0, c1 * inverse - i1, c2 * inverse - i2

    values = obstacles.grid_values
    at = obstacles.grid_start[g] + (i0 * n1 + i1) * n2 + i2
    step1, step0 = n2, n1 * n2
    v000, v001 = values[at], values[at + 1]
    v010, v011 = values[at + step1], values[at + step1 + 1]
    v100, v101 = values[at + step0], values[at + step0 + 1]
    v110, v111 = values[at + step0 + step1], values[at + step0 + step1 + 1]
    v00, v01 = v000 + a2 * (v001 - v000), v010 + a2 * (v011 - v010)
    v10, v11 = v100 + a2 * (v101 - v100), v110 + a2 * (v111 - v110)
    v0, v1 = v00 + a1 * (v01 - v00), v10 + a1 * (v11 - v10)
    value = v0 + a0 * (v1 - v0)
    w00, w01 = v001 - v000, v011 - v010
    w10, w11 = v101 - v100, v111 - v110
    w0, w1 = w00 + a1 * (w01 - w00), w10 + a1 * (w11 - w10)
    g0 = (v1 - v0) * inverse
    g1 = ((v01 - v00) + a0 * ((v11 - v10) - (v01 - v00))) * inverse
    g2 = (w0 + a0 * (w1 - w0)) * inverse

    o0, o1, o2 = p0 - c0, p1 - c1, p2 - c2
    squared = o0 * o0 + o1 * o1 + o2 * o2
    if squared <= _TINY:
        return value, g0, g1, g2
    bound = math.sqrt(squared + value * value)
    pad = shapes.GRID_PADDING * spacing
    m0, m1, m2 = 0.5 * (n0 - 1) * spacing, 0.5 * (n1 - 1) * spacing, 0.5 * (n2 - 1) * spacing
    inner, b0, b1, b2 = _box(p0 - m0, p1 - m1, p2 - m2, m0 - pad, m1 - pad, m2 - pad)
    if inner >= bound:
        return inner, b0, b1, b2
    if o0 != 0.0:
        g0 = 0.0
    if o1 != 0.0:
        g1 = 0.0
    if o2 != 0.0:
        g2 = 0.0
    scale = 1.0 / bound
    return bound, (o0 + value * g0) * scale, (o1 + value * g1) * scale, (o2 + value * g2) * scale


@called
def _distances(obstacles, points, distance, gradient):
    for n in range(points.shape[0]):
        for k in range(obstacles.kind.shape[0]):
            distance[n, k] = signed_distance(
                obstacles, k, points[n, 0], points[n, 1], points[n, 2], gradient[n, k]
            )


def distances(obstacles: Obstacles, points: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Signed distances of N world points to K obstacles.

    Args:
        obstacles: from :func:`optipromp.core.geometry.obstacles.pack`.
        points: (N, 3) [m], finite.

    Returns:
        D (N, K) [m] and its gradient (N, K, 3).

    Raises:
        InvalidRequestError: ``points`` has another shape or is not finite.
    """
    array = np.array(points, dtype=np.float64, order="C")
    if array.ndim != 2 or array.shape[1] != 3:
        raise InvalidRequestError(f"points have shape {array.shape}: must be (N, 3)")
    bad = np.flatnonzero(~np.isfinite(array).all(axis=1))
    if bad.size:
        raise InvalidRequestError(f"points[{bad[0]}] is {array[bad[0]].tolist()}: must be finite")
    count = len(obstacles.kind)
    distance = np.empty((len(array), count))
    gradient = np.empty((len(array), count, 3))
    _distances(obstacles, array, distance, gradient)
    return distance, gradient
