"""Exact distances to triangles and the generalised winding number, on the nodes of a grid."""

from __future__ import annotations

import math

import numpy as np

from optipromp.core.arrays import FloatArray
from optipromp.core.compiled import kernel

_BLOCK = 4  # nodes along the edge of a block that shares one list of candidate triangles
_TINY = 1e-300


@kernel
def _segment_squared(
    p0: float, p1: float, p2: float, a: FloatArray, e0: float, e1: float, e2: float
) -> float:
    """Squared distance from p to the segment from a along e."""
    d0 = p0 - a[0]
    d1 = p1 - a[1]
    d2 = p2 - a[2]
    length = e0 * e0 + e1 * e1 + e2 * e2
    t = 0.0
    if length > _TINY:
        t = min(max((d0 * e0 + d1 * e1 + d2 * e2) / length, 0.0), 1.0)
    d0 -= t * e0
    d1 -= t * e1
    d2 -= t * e2
    return float(d0 * d0 + d1 * d1 + d2 * d2)


@kernel
def triangle_squared(p0: float, p1: float, p2: float, corners: FloatArray) -> float:
    """Squared distance from p to the triangle with ``corners`` (3, 3), degenerate ones included.

    Over the triangle's inside it is the distance to the plane, elsewhere that to the nearest edge.
    """
    a = corners[0]
    u0 = corners[1, 0] - a[0]
    u1 = corners[1, 1] - a[1]
    u2 = corners[1, 2] - a[2]
    v0 = corners[2, 0] - a[0]
    v1 = corners[2, 1] - a[1]
    v2 = corners[2, 2] - a[2]
    n0 = u1 * v2 - u2 * v1
    n1 = u2 * v0 - u0 * v2
    n2 = u0 * v1 - u1 * v0
    square = n0 * n0 + n1 * n1 + n2 * n2
    if square > _TINY:
        d0 = p0 - a[0]
        d1 = p1 - a[1]
        d2 = p2 - a[2]
        # barycentric coordinates of the foot of p: (d x v)·n / |n|², (u x d)·n / |n|²
        s = (
            (d1 * v2 - d2 * v1) * n0 + (d2 * v0 - d0 * v2) * n1 + (d0 * v1 - d1 * v0) * n2
        ) / square
        t = (
            (u1 * d2 - u2 * d1) * n0 + (u2 * d0 - u0 * d2) * n1 + (u0 * d1 - u1 * d0) * n2
        ) / square
        if s >= 0.0 and t >= 0.0 and s + t <= 1.0:
            height = d0 * n0 + d1 * n1 + d2 * n2
            return float(height * height / square)
    best = _segment_squared(p0, p1, p2, a, u0, u1, u2)
    best = min(best, _segment_squared(p0, p1, p2, a, v0, v1, v2))
    return float(min(best, _segment_squared(p0, p1, p2, corners[1], v0 - u0, v1 - u1, v2 - u2)))


@kernel
def winding_number(p0: float, p1: float, p2: float, triangles: FloatArray) -> float:
    """Generalised winding number of a triangle soup (F, 3, 3) about p: sum of solid angles / 4π.

    Solid angles after van Oosterom and Strackee (1983); Jacobson et al. (2013) for the sum.
    """
    total = 0.0
    for f in range(triangles.shape[0]):
        a0 = triangles[f, 0, 0] - p0
        a1 = triangles[f, 0, 1] - p1
        a2 = triangles[f, 0, 2] - p2
        b0 = triangles[f, 1, 0] - p0
        b1 = triangles[f, 1, 1] - p1
        b2 = triangles[f, 1, 2] - p2
        c0 = triangles[f, 2, 0] - p0
        c1 = triangles[f, 2, 1] - p1
        c2 = triangles[f, 2, 2] - p2
        a = math.sqrt(a0 * a0 + a1 * a1 + a2 * a2)
        b = math.sqrt(b0 * b0 + b1 * b1 + b2 * b2)
        c = math.sqrt(c0 * c0 + c1 * c1 + c2 * c2)
        volume = a0 * (b1 * c2 - b2 * c1) + a1 * (b2 * c0 - b0 * c2) + a2 * (b0 * c1 - b1 * c0)
        bottom = (
            a * b * c
            + (a0 * b0 + a1 * b1 + a2 * b2) * c
            + (b0 * c0 + b1 * c1 + b2 * c2) * a
            + (c0 * a0 + c1 * a1 + c2 * a2) * b
        )
        total += 2.0 * math.atan2(volume, bottom)
    return total / (4.0 * math.pi)


@kernel
def _fill_distances(
    triangles: FloatArray,
    centers: FloatArray,
    radii: FloatArray,
    origin: FloatArray,
    spacing: float,
    values: FloatArray,
) -> None:
    """Unsigned distances, block by block; ``centers`` and ``radii`` are of balls that hold them.

    With c a block's centre, rho its radius, every node's nearest triangle has a bounding ball no
    farther from c than D(c) + 2 rho: the rest are left out for the whole block.
    """
    count = triangles.shape[0]
    nearest = np.empty(count)
    candidates = np.empty(count, dtype=np.int64)
    rho = 0.5 * math.sqrt(3.0) * (_BLOCK - 1) * spacing
    n0, n1, n2 = values.shape
    for i0 in range(0, n0, _BLOCK):
        for i1 in range(0, n1, _BLOCK):
            for i2 in range(0, n2, _BLOCK):
                c0 = origin[0] + (i0 + 0.5 * (_BLOCK - 1)) * spacing
                c1 = origin[1] + (i1 + 0.5 * (_BLOCK - 1)) * spacing
                c2 = origin[2] + (i2 + 0.5 * (_BLOCK - 1)) * spacing
                upper = np.inf
                for f in range(count):
                    d0 = c0 - centers[f, 0]
                    d1 = c1 - centers[f, 1]
                    d2 = c2 - centers[f, 2]
                    away = math.sqrt(d0 * d0 + d1 * d1 + d2 * d2)
                    nearest[f] = away - radii[f]
                    upper = min(upper, away)  # the centroid lies on the triangle
                for f in range(count):
                    if nearest[f] < upper:
                        upper = min(upper, math.sqrt(triangle_squared(c0, c1, c2, triangles[f])))
                limit = (upper + 2.0 * rho) * (1.0 + 1e-9)
                kept = 0
                for f in range(count):
                    if nearest[f] <= limit:
                        candidates[kept] = f
                        kept += 1
                for j0 in range(i0, min(i0 + _BLOCK, n0)):
                    for j1 in range(i1, min(i1 + _BLOCK, n1)):
                        for j2 in range(i2, min(i2 + _BLOCK, n2)):
                            p0 = origin[0] + j0 * spacing
                            p1 = origin[1] + j1 * spacing
                            p2 = origin[2] + j2 * spacing
                            best = (upper + rho) ** 2 * (1.0 + 1e-9)
                            root = math.sqrt(best)
                            for k in range(kept):
                                f = candidates[k]
                                d0 = p0 - centers[f, 0]
                                d1 = p1 - centers[f, 1]
                                d2 = p2 - centers[f, 2]
                                reach = root + radii[f]
                                if d0 * d0 + d1 * d1 + d2 * d2 <= reach * reach:
                                    squared = triangle_squared(p0, p1, p2, triangles[f])
                                    if squared < best:
                                        best = squared
                                        root = math.sqrt(best)
                            values[j0, j1, j2] = root


@kernel
def _sign_distances(
    triangles: FloatArray, origin: FloatArray, spacing: float, values: FloatArray
) -> None:
    """Turn distances inside negative.

    The winding number changes only across the surface: from one node to the next it stays, unless
    both are nearer to the surface than the step (and a hundredth, so that the sign of a node on
    the surface itself, which is arbitrary, is never carried on). Rows start outside, in the
    padding.
    """
    near = 1.01 * spacing
    n0, n1, n2 = values.shape
    for i0 in range(n0):
        for i1 in range(n1):
            sign = 1.0
            for i2 in range(1, n2):
                if abs(values[i0, i1, i2 - 1]) <= near and values[i0, i1, i2] <= near:
                    winding = winding_number(
                        origin[0] + i0 * spacing,
                        origin[1] + i1 * spacing,
                        origin[2] + i2 * spacing,
                        triangles,
                    )
                    sign = -1.0 if abs(winding) > 0.5 else 1.0
                values[i0, i1, i2] *= sign


def signed_grid(
    triangles: FloatArray, origin: FloatArray, spacing: float, shape: tuple[int, int, int]
) -> FloatArray:
    """Signed distances [m] to a closed surface at the nodes of a grid.

    Args:
        triangles: (F, 3, 3) corners [m] of a closed surface.
        origin: (3,) first node [m]; the grid's border must lie outside the surface.
        spacing: between neighbouring nodes [m].
        shape: nodes along x, y, z.

    Returns:
        ``shape`` distances, negative inside: exact but for rounding.
    """
    values = np.empty(shape)
    centers = triangles.mean(axis=1)
    radii = np.linalg.norm(triangles - centers[:, None], axis=2).max(axis=1)
    _fill_distances(triangles, centers, radii, origin, spacing, values)
    _sign_distances(triangles, origin, spacing, values)
    return values
