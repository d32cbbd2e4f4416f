"""Exact distances to triangles and the generalised winding number, at the nodes of a grid."""

from __future__ import annotations

import math

import numpy as np

from optipromp.core.arrays import FloatArray
from optipromp.core.compiled import kernel

_BLOCK = 4  # nodes along an edge of a block, which shares one list of candidate triangles
_TINY = 1e-300  # a squared length [m²] or area [m⁴] up to here counts as 0


@kernel
def _segment_squared(
    p0: float, p1: float, p2: float, a: FloatArray, e0: float, e1: float, e2: float
) -> float:
    """Squared distance from p to the segment from a along e."""
    d0, d1, d2 = p0 - a[0], p1 - a[1], p2 - a[2]
    length = e0 * e0 + e1 * e1 + e2 * e2
    t = 0.0
    if length > _TINY:
        t = min(max((d0 * e0 + d1 * e1 + d2 * e2) / length, 0.0), 1.0)
    d0, d1, d2 = d0 - t * e0, d1 - t * e1, d2 - t * e2
    return float(d0 * d0 + d1 * d1 + d2 * d2)


@kernel
def triangle_squared(p0: float, p1: float, p2: float, corners: FloatArray) -> float:
    """Squared distance from p to the triangle with ``corners`` (3, 3), which may be degenerate.

    Where the foot of p is inside the triangle, it is the distance to the plane, else to an edge.
    """
    a, b, c = corners[0], corners[1], corners[2]
    u0, u1, u2 = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    v0, v1, v2 = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    n0, n1, n2 = u1 * v2 - u2 * v1, u2 * v0 - u0 * v2, u0 * v1 - u1 * v0
    square = n0 * n0 + n1 * n1 + n2 * n2
    if square > _TINY:
        d0, d1, d2 = p0 - a[0], p1 - a[1], p2 - a[2]
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
    return float(min(best, _segment_squared(p0, p1, p2, b, v0 - u0, v1 - u1, v2 - u2)))


@kernel
def winding_number(p0: float, p1: float, p2: float, triangles: FloatArray) -> float:
    """Generalised winding number of triangles (F, 3, 3) about p: the sum of solid angles over 4π.

    Solid angles after van Oosterom and Strackee (1983), their sum after Jacobson et al. (2013).
    """
    total = 0.0
    for f in range(triangles.shape[0]):
        t = triangles[f]
        a0, a1, a2 = t[0, 0] - p0, t[0, 1] - p1, t[0, 2] - p2
        b0, b1, b2 = t[1, 0] - p0, t[1, 1] - p1, t[1, 2] - p2
        c0, c1, c2 = t[2, 0] - p0, t[2, 1] - p1, t[2, 2] - p2
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
    """Unsigned distances, block by block.

    ``centers`` (F, 3) and ``radii`` (F,) [m] are of balls that hold the triangles. Let c be the
    centre of a block of radius rho. The triangle nearest to any node of the block has a ball no
    farther from c than D(c) + 2 rho: the other triangles are skipped.
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
                    d0, d1, d2 = c0 - centers[f, 0], c1 - centers[f, 1], c2 - centers[f, 2]
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
    """Make the distances of nodes inside the surface negative.

    The winding number changes only across the surface. It is equal at two neighbouring nodes unless
    both are nearer to the surface than the step. A margin of 1 % keeps the sign of a node on the
    surface, which is arbitrary, from being passed on. Rows start outside, in the padding.
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

    ``triangles``: (F, 3, 3) corners [m] of a closed surface. ``origin``: (3,) first node [m]; the
    grid's border must lie outside the surface. ``spacing``: between neighbouring nodes [m].
    ``shape``: nodes along x, y, z.

    Returns: Distances of shape ``shape``, negative inside, exact up to rounding.
    """
    values = np.empty(shape)
    centers = triangles.mean(axis=1)
    radii = np.linalg.norm(triangles - centers[:, None], axis=2).max(axis=1)
    _fill_distances(triangles, centers, radii, origin, spacing, values)
    _sign_distances(triangles, origin, spacing, values)
    return values
