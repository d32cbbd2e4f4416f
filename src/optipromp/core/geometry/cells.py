"""The broad phase: a grid of cells that lists the obstacles near a place."""

import math
from typing import NamedTuple

import numpy as np

from optipromp.core.arrays import FloatArray, IntArray, read_only
from optipromp.core.compiled import kernel

FEWEST = 24  # obstacles; with fewer, measuring them all is as fast
_EDGE = 0.12  # [m] of a cell at least, about the size of a link: a choice
_MOST = 40  # cells along an edge of the cube: 64,000 lists


class Cells(NamedTuple):
    """A cube of cells about the origin, each with the obstacles near it, in ascending order.

    The list of a cell holds the obstacles whose bounding balls come within ``reach`` of the cell.
    The last list is for places outside the cube and holds all obstacles.
    """

    reach: float  # [m] 0: there are no cells
    half: float  # [m] half an edge of the cube
    inverse: float  # [1/m] of a cell's edge
    along: int  # cells along an edge of the cube
    start: IntArray  # (along³ + 2,) where each list begins in ``member``
    member: IntArray  # (E,) int32


def no_cells() -> Cells:
    """No cells: every obstacle is near every place."""
    start, member = np.zeros(2, np.int64), np.zeros(0, np.int32)
    return Cells(0.0, 0.0, 0.0, 0, read_only(start), read_only(member))


def make_cells(position: FloatArray, bound: FloatArray, reach: float, half: float) -> Cells:
    """Cells over the bounding balls of K obstacles.

    ``position``: (K, 3) centres [m]. ``bound``: (K,) radii [m]; infinite for a half-space.
    ``reach``: largest distance at which an obstacle matters [m]. ``half``: half the edge of the
    cube [m], which should hold all places that are looked up.
    """
    if len(bound) < FEWEST:
        return no_cells()
    count = min(max(int(np.ceil(2.0 * half / _EDGE)), 1), _MOST)
    edge = 2.0 * half / count
    start = np.zeros(count**3 + 2, dtype=np.int64)
    _fill(position, bound, reach, half, edge, count, start, np.empty(0, dtype=np.int32), False)
    start[-1] = len(bound)
    np.cumsum(start, out=start)
    member = np.empty(start[-1], dtype=np.int32)
    member[start[-2] :] = np.arange(len(bound))
    _fill(position, bound, reach, half, edge, count, start[:-1].copy(), member, True)
    return Cells(reach, half, 1.0 / edge, count, read_only(start), read_only(member))


@kernel
def _fill(position, bound, reach, half, edge, count, start, member, write):
    """Count the obstacles of cell i in ``start[i + 1]``, or write them from ``start[i]`` on."""
    low, high = np.empty(3, dtype=np.int64), np.empty(3, dtype=np.int64)
    for k in range(bound.shape[0]):
        far = bound[k] + reach
        inside = True
        for i in range(3):
            low[i], high[i] = 0, count - 1
            if far < np.inf:
                first = np.floor((position[k, i] - far + half) / edge)
                last = np.floor((position[k, i] + far + half) / edge)
                inside = inside and last >= 0.0 and first < count
                low[i], high[i] = int(max(first, 0.0)), int(min(last, count - 1.0))
        if not inside:
            continue
        for i in range(low[0], high[0] + 1):
            x0 = _outside(position[k, 0] + half, i * edge, edge)
            for j in range(low[1], high[1] + 1):
                x1 = _outside(position[k, 1] + half, j * edge, edge)
                for m in range(low[2], high[2] + 1):
                    x2 = _outside(position[k, 2] + half, m * edge, edge)
                    if x0 * x0 + x1 * x1 + x2 * x2 > far * far:
                        continue
                    cell = (i * count + j) * count + m
                    if write:
                        member[start[cell]] = k
                        start[cell] += 1
                    else:
                        start[cell + 1] += 1


@kernel
def _outside(x, low, edge):
    """Distance of x from [low, low + edge], less 1e-9 m so that rounding loses no obstacle."""
    return max(max(low - x, x - low - edge) - 1e-9, 0.0)


@kernel
def cell_at(cells, x, y, z):
    """Index of the list of obstacles near a place."""
    n = cells.along
    i = math.floor((x + cells.half) * cells.inverse)
    j = math.floor((y + cells.half) * cells.inverse)
    k = math.floor((z + cells.half) * cells.inverse)
    if i < 0 or j < 0 or k < 0 or i >= n or j >= n or k >= n:
        return n * n * n
    return (i * n + j) * n + k
