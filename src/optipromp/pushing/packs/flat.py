"""Convex shapes on a plane, discs and polygons: the depth and the place of their contacts."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from optipromp.arrays import FloatArray, IntArray
from optipromp.compiled import inner, kernel
from optipromp.pushing.parameters import PUSH

CORNERS = 8  # of a polygon at most
FLAT = PUSH.plane.flat


class Shapes(NamedTuple):
    """Convex shapes: discs where ``size`` is 0, else polygons with corners counter-clockwise."""

    corners: FloatArray  # (B, CORNERS, 2) [m]
    normals: FloatArray  # (B, CORNERS, 2) outward, of the side that begins at each corner
    size: IntArray  # (B,) how many corners
    radius: FloatArray  # (B,) [m] of a disc, or of the circle about a polygon's origin
    box: FloatArray  # (B, 4) [m] least u and v, largest u and v


def shapes(parts: Sequence[FloatArray | float]) -> Shapes:
    """Shapes of polygons (k, 2) and of discs given by their radius.

    Raises:
        ValueError: a polygon of more than :data:`CORNERS` corners, or not convex, or clockwise.
    """
    corners, normals = np.zeros((2, len(parts), CORNERS, 2))
    count, radius = np.zeros(len(parts), dtype=np.int64), np.zeros(len(parts))
    box = np.zeros((len(parts), 4))
    for i, part in enumerate(parts):
        if isinstance(part, float | int):
            radius[i], box[i] = part, [-part, -part, part, part]
            continue
        if len(part) > CORNERS:
            raise ValueError(f"a polygon has {len(part)} corners; at most {CORNERS} are taken")
        corners[i, : len(part)], count[i] = part, len(part)
        side = np.roll(part, -1, axis=0) - part
        following = np.roll(side, -1, axis=0)
        if (side[:, 0] * following[:, 1] - side[:, 1] * following[:, 0] < -1e-12).any():
            raise ValueError("a polygon is not convex, or its corners go clockwise")
        side /= np.linalg.norm(side, axis=1, keepdims=True)
        normals[i, : len(part)] = np.column_stack([side[:, 1], -side[:, 0]])
        radius[i] = float(np.linalg.norm(part, axis=1).max())
        box[i] = [*part.min(axis=0), *part.max(axis=0)]
    return Shapes(corners, normals, count, radius, box)


@inner
def placed(shape, i, u, v, turn, corners, normals, b):  # type: ignore[no-untyped-def]
    """Shape ``i`` at a pose: corners and normals (N, CORNERS, 2) of body ``b``, in place."""
    c, s = math.cos(turn), math.sin(turn)
    for k in range(shape.size[i]):
        x, y = shape.corners[i, k, 0], shape.corners[i, k, 1]
        corners[b, k, 0], corners[b, k, 1] = u + c * x - s * y, v + s * x + c * y
        x, y = shape.normals[i, k, 0], shape.normals[i, k, 1]
        normals[b, k, 0], normals[b, k, 1] = c * x - s * y, s * x + c * y


@inner
def bounds(corners, count, b, boxes):  # type: ignore[no-untyped-def]
    """The box (4,) along the axes about polygon ``b``, in place of row b of ``boxes`` (N, 4)."""
    low_u = high_u = corners[b, 0, 0]
    low_v = high_v = corners[b, 0, 1]
    for k in range(1, count):
        u, v = corners[b, k, 0], corners[b, k, 1]
        low_u, high_u = min(low_u, u), max(high_u, u)
        low_v, high_v = min(low_v, v), max(high_v, v)
    boxes[b, 0], boxes[b, 1], boxes[b, 2], boxes[b, 3] = low_u, low_v, high_u, high_v


@inner
def outside(boxes, b, u, v, radius):  # type: ignore[no-untyped-def]
    """Whether a disc is outside box b of ``boxes`` (N, 4), along the axes."""
    return (
        u + radius <= boxes[b, 0]
        or v + radius <= boxes[b, 1]
        or u - radius >= boxes[b, 2]
        or v - radius >= boxes[b, 3]
    )


@inner
def beyond(corners, normals, a, k, b, nb):  # type: ignore[no-untyped-def]
    """How far polygon b (nb corners) is beyond side k of polygon a."""
    x, y, nx, ny = corners[a, k, 0], corners[a, k, 1], normals[a, k, 0], normals[a, k, 1]
    least = math.inf
    for j in range(nb):
        least = min(least, (corners[b, j, 0] - x) * nx + (corners[b, j, 1] - y) * ny)
    return least


@inner
def disc_in_polygon(u, v, radius, corners, normals, b, count, hit):  # type: ignore[no-untyped-def]
    """Contact of a disc and polygon b: depth; ``hit`` = normal from polygon to disc, and where."""
    deepest, side = -math.inf, 0
    for k in range(count):
        out = (u - corners[b, k, 0]) * normals[b, k, 0] + (v - corners[b, k, 1]) * normals[b, k, 1]
        if out > deepest:
            deepest, side = out, k
            if out >= radius:
                return radius - out
    nx, ny = normals[b, side, 0], normals[b, side, 1]
    px, py = u - deepest * nx, v - deepest * ny
    if deepest > 0.0:  # the nearest point of the outline, which may be a corner
        nearest = math.inf
        for k in range(count):
            x0, y0 = corners[b, k, 0], corners[b, k, 1]
            following = k + 1 if k + 1 < count else 0
            ex, ey = corners[b, following, 0] - x0, corners[b, following, 1] - y0
            share = ((u - x0) * ex + (v - y0) * ey) / (ex * ex + ey * ey)
            share = min(1.0, max(0.0, share))
            qx, qy = x0 + share * ex, y0 + share * ey
            away = (u - qx) * (u - qx) + (v - qy) * (v - qy)
            if away < nearest:
                nearest, px, py = away, qx, qy
        deepest = math.sqrt(nearest)
        nx, ny = (u - px) / deepest, (v - py) / deepest
    hit[0], hit[1], hit[2], hit[3] = nx, ny, px, py
    return radius - deepest


@inner
def pressed(corners, normals, a, na, k, b, nb, least, sign, hit):  # type: ignore[no-untyped-def]
    """``hit`` of polygon b on side k of polygon a, beyond which b is by ``least`` (negative)."""
    x, y, nx, ny = corners[a, k, 0], corners[a, k, 1], normals[a, k, 0], normals[a, k, 1]
    ex, ey = -ny, nx
    following = k + 1 if k + 1 < na else 0
    length = (corners[a, following, 0] - x) * ex + (corners[a, following, 1] - y) * ey
    low, high = math.inf, -math.inf
    for j in range(nb):
        du, dv = corners[b, j, 0] - x, corners[b, j, 1] - y
        if du * nx + dv * ny < least + FLAT:
            along = du * ex + dv * ey
            low, high = min(low, along), max(high, along)
    middle = 0.5 * (min(length, max(0.0, low)) + min(length, max(0.0, high)))
    hit[0], hit[1] = sign * nx, sign * ny
    hit[2], hit[3] = x + middle * ex, y + middle * ey


@inner
def polygons(corners, normals, a, na, b, nb, last, p, hit):  # type: ignore[no-untyped-def]
    """Depth of polygons a and b (negative: apart); ``hit``: unit normal from a to b, and where.

    ``last[p]`` is the side that separated them last, and is tried first: sides of a count from 0,
    sides of b from CORNERS.
    """
    k = last[p]
    if k < CORNERS:
        far = beyond(corners, normals, a, k, b, nb)
    else:
        far = beyond(corners, normals, b, k - CORNERS, a, na)
    if far >= 0.0:
        return -far
    one, other, side, facing = -math.inf, -math.inf, 0, 0
    for k in range(na):
        far = beyond(corners, normals, a, k, b, nb)
        if far > one:
            one, side = far, k
            if far >= 0.0:
                last[p] = k
                return -far
    for k in range(nb):
        far = beyond(corners, normals, b, k, a, na)
        if far > other:
            other, facing = far, k
            if far >= 0.0:
                last[p] = CORNERS + k
                return -far
    if other > one:
        pressed(corners, normals, b, nb, facing, a, na, other, -1.0, hit)
        return -other
    pressed(corners, normals, a, na, side, b, nb, one, 1.0, hit)
    return -one


@inner
def contact(  # type: ignore[no-untyped-def]
    corners, normals, size, at, radius, i, j, last, p, hit
):
    """Depth of bodies i and j (negative: apart); ``hit``: unit normal from i to j, and where."""
    na, nb = size[i], size[j]
    if na == 0 and nb == 0:
        du, dv = at[j, 0] - at[i, 0], at[j, 1] - at[i, 1]
        away = max(math.sqrt(du * du + dv * dv), 1e-12)
        hit[0], hit[1] = du / away, dv / away
        hit[2], hit[3] = at[i, 0] + radius[i] * hit[0], at[i, 1] + radius[i] * hit[1]
        return radius[i] + radius[j] - away
    if na == 0:
        depth = disc_in_polygon(at[i, 0], at[i, 1], radius[i], corners, normals, j, nb, hit)
        hit[0], hit[1] = -hit[0], -hit[1]
        return depth
    if nb == 0:
        return disc_in_polygon(at[j, 0], at[j, 1], radius[j], corners, normals, i, na, hit)
    return polygons(corners, normals, i, na, j, nb, last, p, hit)


def room(path: FloatArray, tool: Shapes, walls: Shapes, enough: float = math.inf) -> float:
    """Least distance of the tool from the walls along a path (T, 3) [m]; negative inside them.

    By separating axes: past a corner the result may be less than the distance. A distance beyond
    ``enough`` may be returned as ``enough``.
    """
    return float(clear(np.ascontiguousarray(path, dtype=np.float64), 1, tool, walls, enough))


@kernel
def clear(path, stride, tool, walls, enough):  # type: ignore[no-untyped-def]
    """:func:`room` of every ``stride``-th pose."""
    corners, normals, box = np.empty((2, CORNERS, 2)), np.empty((2, CORNERS, 2)), np.empty((1, 4))
    least = enough
    for h in range(tool.size.shape[0]):
        n = tool.size[h]
        for t in range(0, path.shape[0], stride):
            placed(tool, h, path[t, 0], path[t, 1], path[t, 2], corners, normals, 0)
            bounds(corners, n, 0, box)
            for w in range(walls.size.shape[0]):
                far = max(
                    max(box[0, 0] - walls.box[w, 2], walls.box[w, 0] - box[0, 2]),
                    max(box[0, 1] - walls.box[w, 3], walls.box[w, 1] - box[0, 3]),
                )
                if far >= least:
                    continue
                placed(walls, w, 0.0, 0.0, 0.0, corners, normals, 1)
                m = walls.size[w]
                for k in range(n):
                    far = max(far, beyond(corners, normals, 0, k, 1, m))
                for k in range(m):
                    far = max(far, beyond(corners, normals, 1, k, 0, n))
                least = min(least, far)
    return least
