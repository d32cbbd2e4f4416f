"""Distances from the nodes of a grid to the nearest of many points.

Points are grouped in cells, nodes in blocks. The cells that may hold the nearest point are found
once per block. A node measures only cells that can be nearer than its nearest point so far.
"""

import math

import numpy as np

from optipromp.core.arrays import FloatArray, IntArray
from optipromp.core.compiled import compiler, kernel

_NODES = 4  # along an edge of a block
_CELL = 3.0  # [steps of the grid] along an edge of a cell


def to_nearest(
    points: FloatArray,
    origin: FloatArray,
    step: float,
    shape: tuple[int, int, int],
    near: float,
    slack: float,
) -> FloatArray:
    """Distances [m] of the nodes of a grid of shape ``shape`` to the nearest of ``points``.

    ``points``: (N, 3), N >= 1 [m]. ``origin``: (3,) first node [m], no larger than any point.
    ``step``: between nodes [m]. ``shape``: nodes along x, y, z. ``near``: distances up to ``near``
    are exact [m]. ``slack``: a longer distance d is between max(``near``, d / (1 + ``slack``)) and
    d.
    """
    start, ordered = _in_cells(points, origin, _CELL * step)
    low = np.minimum.reduceat(ordered, start[:-1])
    high = np.maximum.reduceat(ordered, start[:-1])
    values = np.empty(shape)
    x, y, z = np.ascontiguousarray(ordered.T)
    _fill(x, y, z, start, low, high, np.array(origin), step, near, slack, values)
    return values


def _in_cells(points: FloatArray, origin: FloatArray, edge: float) -> tuple[IntArray, FloatArray]:
    """Start (C + 1,) of each cell, and the points (N, 3) cell by cell."""
    cell = ((points - origin) / edge).astype(np.int64)
    _, n1, n2 = cell.max(axis=0) + 1
    key = (cell[:, 0] * n1 + cell[:, 1]) * n2 + cell[:, 2]
    order = np.argsort(key, kind="stable")
    first = np.flatnonzero(np.diff(key[order], prepend=-1))
    return np.append(first, len(points)), points[order]


@kernel
def _fill(px, py, pz, start, low, high, origin, step, near, slack, values):
    """:func:`to_nearest` of points cell by cell, whose boxes are ``low`` … ``high`` (C, 3)."""
    n0, n1, n2 = values.shape
    least, near_by = np.empty(len(low)), np.empty(len(low), dtype=np.int64)
    half = 0.5 * step * (_NODES - 1)
    for i in range(0, n0, _NODES):
        for j in range(0, n1, _NODES):
            for k in range(0, n2, _NODES):
                x = origin[0] + step * i + half
                y = origin[1] + step * j + half
                z = origin[2] + step * k + half
                nearest = 0
                for c in range(len(low)):
                    least[c] = math.sqrt(_to_box(low[c], high[c], x, y, z))
                    if least[c] < least[nearest]:
                        nearest = c
                found = _least(px, py, pz, start[nearest], start[nearest + 1], x, y, z, np.inf)
                most = math.sqrt(found) + 2.001 * math.sqrt(3.0) * half
                count = 0
                for c in range(len(low)):
                    if least[c] <= most:
                        near_by[count] = c
                        count += 1
                cells = near_by[:count]
                cells = cells[np.argsort(least[cells])]
                for a in range(i, min(i + _NODES, n0)):
                    for b in range(j, min(j + _NODES, n1)):
                        for c in range(k, min(k + _NODES, n2)):
                            x = origin[0] + step * a
                            y = origin[1] + step * b
                            z = origin[2] + step * c
                            values[a, b, c] = _nearest(
                                px, py, pz, start, low, high, cells, x, y, z, near, slack
                            )


@kernel
def _nearest(px, py, pz, start, low, high, cells, x, y, z, near, slack):
    """Distance of a place to the nearest point in ``cells``, which are sorted by distance."""
    squared = ask = np.inf
    for c in cells:
        if _to_box(low[c], high[c], x, y, z) >= ask:
            continue
        found = _least(px, py, pz, start[c], start[c + 1], x, y, z, squared)
        if found < squared:
            squared = found
            ask = min(squared, max(near * near, squared / (1.0 + slack) ** 2))
    distance = math.sqrt(squared)
    return distance if distance < near else max(near, distance / (1.0 + slack))


@kernel
def _to_box(low, high, x, y, z):
    """Squared distance [m²] of a place to a box."""
    dx = max(low[0] - x, x - high[0], 0.0)
    dy = max(low[1] - y, y - high[1], 0.0)
    dz = max(low[2] - z, z - high[2], 0.0)
    return dx * dx + dy * dy + dz * dz


@compiler(fastmath={"nnan", "nsz"})
def _least(px, py, pz, first, last, x, y, z, least):
    """The smallest of ``least`` and the squared distances of a place to points first … last - 1."""
    for n in range(first, last):
        dx, dy, dz = px[n] - x, py[n] - y, pz[n] - z
        least = min(least, dx * dx + dy * dy + dz * dz)
    return least
