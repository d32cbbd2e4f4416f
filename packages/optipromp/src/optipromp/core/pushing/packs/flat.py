"""Convex shapes on a plane, discs and polygons: depth and position of their contacts.

A contact is written to ``hit`` (4,): the unit normal from the first body to the second, and the
point of contact (u, v) [m].
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from optipromp.core.arrays import FloatArray, IntArray
from optipromp.core.compiled import inlined, inner, kernel
from optipromp.core.pushing.parameters import PUSH

CORNERS = 8  # largest number of corners of a polygon; a turned box has six
PLANE = PUSH.plane


class Shapes(NamedTuple):
    """Convex shapes: discs where ``size`` is 0, else polygons with corners counter-clockwise."""

    corners: FloatArray  # (B, CORNERS, 2) [m]
    normals: FloatArray  # (B, CORNERS, 2) outward, of the side that begins at each corner
    size: IntArray  # (B,) number of corners
    radius: FloatArray  # (B,) [m] of a disc, or of the circle about a polygon's origin
    box: FloatArray  # (B, 4) [m] least u and v, largest u and v


def shapes(parts: Sequence[FloatArray | float]) -> Shapes:
    """Shapes of polygons (k, 2) and of discs given by their radius."""
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


class Bodies(NamedTuple):
    """N shapes at their poses: first the objects, then the bodies that do not yield."""

    objects: int  # number of objects
    corners: FloatArray  # (N, CORNERS, 2) [m], as in :class:`Shapes`
    normals: FloatArray  # (N, CORNERS, 2)
    size: IntArray  # (N,)
    radius: FloatArray  # (N,) [m]
    at: FloatArray  # (N, 2) origins [m]
    boxes: FloatArray  # (N, 4) of bodies that do not yield: least u and v, largest u and v [m]


@inlined
def place(shape, i, u, v, turn, bodies, b):
    """Place shape ``i`` at a pose, as body ``b``, without its box."""
    bodies.at[b, 0], bodies.at[b, 1] = u, v
    if shape.size[i] == 0:
        return
    c, s = math.cos(turn), math.sin(turn)
    for k in range(shape.size[i]):
        x, y = shape.corners[i, k, 0], shape.corners[i, k, 1]
        bodies.corners[b, k, 0] = u + c * x - s * y
        bodies.corners[b, k, 1] = v + s * x + c * y
        x, y = shape.normals[i, k, 0], shape.normals[i, k, 1]
        bodies.normals[b, k, 0], bodies.normals[b, k, 1] = c * x - s * y, s * x + c * y


@inner
def enclose(bodies, b):
    """Set the box of polygon ``b``."""
    low_u = high_u = bodies.corners[b, 0, 0]
    low_v = high_v = bodies.corners[b, 0, 1]
    for k in range(1, bodies.size[b]):
        u, v = bodies.corners[b, k, 0], bodies.corners[b, k, 1]
        low_u, high_u = min(low_u, u), max(high_u, u)
        low_v, high_v = min(low_v, v), max(high_v, v)
    boxes = bodies.boxes
    boxes[b, 0], boxes[b, 1], boxes[b, 2], boxes[b, 3] = low_u, low_v, high_u, high_v


@inlined
def apart(bodies, i, j, gap):
    """Whether body i and object j are surely farther apart than ``gap``: by circles, or i's box."""
    u, v, reach = bodies.at[j, 0], bodies.at[j, 1], bodies.radius[j] + gap
    if i < bodies.objects:
        du, dv, reach = u - bodies.at[i, 0], v - bodies.at[i, 1], reach + bodies.radius[i]
        return bool(du * du + dv * dv > reach * reach)
    low_u, low_v = bodies.boxes[i, 0], bodies.boxes[i, 1]
    high_u, high_v = bodies.boxes[i, 2], bodies.boxes[i, 3]
    return bool(
        u + reach <= low_u or v + reach <= low_v or u - reach >= high_u or v - reach >= high_v
    )


@inlined
def beyond(bodies, a, k, b):
    """Distance of polygon b from the line of side k of polygon a; negative inside [m]."""
    corners, normals = bodies.corners, bodies.normals
    x, y, nx, ny = corners[a, k, 0], corners[a, k, 1], normals[a, k, 0], normals[a, k, 1]
    least = math.inf
    for j in range(bodies.size[b]):
        least = min(least, (corners[b, j, 0] - x) * nx + (corners[b, j, 1] - y) * ny)
    return least


@inner
def disc_in_polygon(bodies, disc, b, hit):
    """Depth of a disc in polygon b [m]; ``hit`` is from the polygon to the disc."""
    u, v, radius = bodies.at[disc, 0], bodies.at[disc, 1], bodies.radius[disc]
    corners, normals, count = bodies.corners, bodies.normals, bodies.size[b]
    deepest, side = -math.inf, 0
    for k in range(count):
        out = (u - corners[b, k, 0]) * normals[b, k, 0] + (v - corners[b, k, 1]) * normals[b, k, 1]
        if out > deepest:
            deepest, side = out, k
            if out >= radius:
                return float(radius - out)
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
    return float(radius - deepest)


@inner
def pressed(bodies, a, k, b, least, hit):
    """``hit`` of polygon b on side k of polygon a; ``least`` is their :func:`beyond`."""
    corners, normals = bodies.corners, bodies.normals
    x, y, nx, ny = corners[a, k, 0], corners[a, k, 1], normals[a, k, 0], normals[a, k, 1]
    ex, ey = -ny, nx
    following = k + 1 if k + 1 < bodies.size[a] else 0
    length = (corners[a, following, 0] - x) * ex + (corners[a, following, 1] - y) * ey
    low, high = math.inf, -math.inf
    for j in range(bodies.size[b]):
        du, dv = corners[b, j, 0] - x, corners[b, j, 1] - y
        if du * nx + dv * ny < least + PLANE.flat:
            along = du * ex + dv * ey
            low, high = min(low, along), max(high, along)
    middle = 0.5 * (min(length, max(0.0, low)) + min(length, max(0.0, high)))
    hit[0], hit[1], hit[2], hit[3] = nx, ny, x + middle * ex, y + middle * ey


@inlined
def polygons(bodies, a, b, pairs, p, hit):
    """Depth of polygons a and b (negative: apart) [m], and ``hit``; by separating axes.

    ``pairs[p, 2]`` is the side that separated the polygons last, which is tried first: sides of a
    count from 0, sides of b from CORNERS.
    """
    k = pairs[p, 2]
    far = beyond(bodies, a, k, b) if k < CORNERS else beyond(bodies, b, k - CORNERS, a)
    if far >= 0.0:
        return -far
    one, other, side, facing = -math.inf, -math.inf, 0, 0
    for k in range(bodies.size[a]):
        far = beyond(bodies, a, k, b)
        if far > one:
            one, side = far, k
            if far >= 0.0:
                pairs[p, 2] = k
                return -far
    for k in range(bodies.size[b]):
        far = beyond(bodies, b, k, a)
        if far > other:
            other, facing = far, k
            if far >= 0.0:
                pairs[p, 2] = CORNERS + k
                return -far
    if other > one:
        pressed(bodies, b, facing, a, other, hit)
        hit[0], hit[1] = -hit[0], -hit[1]
        return -other
    pressed(bodies, a, side, b, one, hit)
    return -one


@inlined
def contact(bodies, i, j, pairs, p, hit):
    """Depth of bodies i and j (negative: apart) [m], and ``hit``; see :func:`polygons`."""
    at, radius = bodies.at, bodies.radius
    if bodies.size[i] > 0 and bodies.size[j] > 0:
        return polygons(bodies, i, j, pairs, p, hit)
    if bodies.size[i] > 0:
        return disc_in_polygon(bodies, j, i, hit)
    if bodies.size[j] > 0:
        depth = disc_in_polygon(bodies, i, j, hit)
        hit[0], hit[1] = -hit[0], -hit[1]
        return depth
    du, dv = at[j, 0] - at[i, 0], at[j, 1] - at[i, 1]
    away = max(math.sqrt(du * du + dv * dv), 1e-12)
    hit[0], hit[1] = du / away, dv / away
    hit[2], hit[3] = at[i, 0] + radius[i] * hit[0], at[i, 1] + radius[i] * hit[1]
    return float(radius[i] + radius[j] - away)


@kernel
def clear_ahead(path, stride, tool, walls, enough):
    """Least distance of the tool from the walls at every ``stride``-th pose of a path (T, 3) [m].

    The distance is negative inside a wall, and at most ``enough``. By separating axes: past a
    corner it may be underestimated.
    """
    bodies = Bodies(
        0, np.empty((2, CORNERS, 2)), np.empty((2, CORNERS, 2)), np.empty(2, dtype=np.int64),
        np.empty(2), np.empty((2, 2)), np.empty((2, 4)),
    )  # fmt: skip
    box, least = bodies.boxes, enough
    for h in range(len(tool.size)):
        bodies.size[0] = tool.size[h]
        for t in range(0, len(path), stride):
            place(tool, h, path[t, 0], path[t, 1], path[t, 2], bodies, 0)
            enclose(bodies, 0)
            for w in range(len(walls.size)):
                far = max(
                    max(box[0, 0] - walls.box[w, 2], walls.box[w, 0] - box[0, 2]),
                    max(box[0, 1] - walls.box[w, 3], walls.box[w, 1] - box[0, 3]),
                )
                if far >= least:
                    continue
                place(walls, w, 0.0, 0.0, 0.0, bodies, 1)
                bodies.size[1] = walls.size[w]
                for k in range(tool.size[h]):
                    far = max(far, beyond(bodies, 0, k, 1))
                for k in range(walls.size[w]):
                    far = max(far, beyond(bodies, 1, k, 0))
                least = min(least, far)
    return least
