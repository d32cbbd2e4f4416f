"""Posed shapes as arrays for the distance kernels, and cells that list those near a place."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from optipromp.core.arrays import BoolArray, FloatArray, IntArray, frozen, lengths, read_only
from optipromp.core.compiled import kernel
from optipromp.core.errors import InvalidSceneError
from optipromp.core.geometry.shapes import GRID, Shape, alike

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


NO_CELLS = Cells(0.0, 0.0, 0.0, 0, frozen([0, 0], np.int64), frozen([], np.int32))
"""Every obstacle is near every place."""


def make_cells(position: FloatArray, bound: FloatArray, reach: float, half: float) -> Cells:
    """Cells over the bounding balls of K obstacles.

    ``position``: (K, 3) centres [m]. ``bound``: (K,) radii [m]; infinite for a half-space.
    ``reach``: largest distance at which an obstacle matters [m]. ``half``: half the edge of the
    cube [m], which should hold all places that are looked up.
    """
    if len(bound) < FEWEST:
        return NO_CELLS
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


Measures: TypeAlias = tuple[IntArray, FloatArray, FloatArray]


class Obstacles(NamedTuple):
    """K posed shapes; a point maps as ``x_world = rotation[k] @ x_local + position[k]``.

    All arrays are read-only and C-contiguous: :func:`pack` builds them, so that kernels are
    compiled for one set of array types.
    """

    kind: IntArray
    """(K,) of :class:`optipromp.core.geometry.shapes.Measure`, as ``size`` and ``bound``."""
    position: FloatArray
    """(K, 3) [m]."""
    rotation: FloatArray
    """(K, 3, 3)."""
    size: FloatArray
    """(K, 3) [m]."""
    bound: FloatArray
    """(K,) [m] radius about ``position`` of a bounding ball; inf for a half-space."""
    grid: IntArray
    """(K,) index into the grid arrays, -1 for a shape without a grid."""
    grid_values: FloatArray
    """(N,) [m] signed distances of all grids, flat, each in C order."""
    grid_start: IntArray
    """(G,) first value of each grid."""
    grid_shape: IntArray
    """(G, 3) nodes along local x, y, z."""
    grid_origin: FloatArray
    """(G, 3) [m] first node in the shape's local frame."""
    grid_spacing: FloatArray
    """(G,) [m] distance between neighbouring nodes."""
    cells: Cells
    """Lists of the obstacles near each place."""


_EACH = Obstacles._fields[:6]  # arrays with a row for each obstacle


def pack(
    items: Sequence[tuple[Shape, ArrayLike, ArrayLike]], *, reach: float = 0.0, within: float = 0.0
) -> Obstacles:
    """Pack posed shapes for the kernels.

    Args:
        items: ``(shape, position (3,) [m], rotation (3, 3))``; may be empty.
        reach: largest distance at which kernels look for obstacles [m]. Above 0, many obstacles are
            sorted into cells, so that obstacles farther away cost nothing.
        within: largest coordinate of a place where kernels look for obstacles [m].

    Returns:
        The obstacles, in the order of ``items``. Shapes without a kernel get a distance grid (see
        :mod:`optipromp.core.geometry.grids`), which items of one shape object share.

    Raises:
        InvalidSceneError: a pose is not finite, a matrix is no rotation, or a mesh is degenerate.
    """
    shapes = [shape for shape, _, _ in items]
    position = np.array([at for _, at, _ in items], dtype=np.float64).reshape(-1, 3)
    rotation = np.array([turn for _, _, turn in items], dtype=np.float64).reshape(-1, 3, 3)
    _check_poses(position, rotation)
    return packed_shapes(shapes, position, rotation, measures(shapes), reach=reach, within=within)


def packed_shapes(
    shapes: Sequence[Shape], position: FloatArray, rotation: FloatArray, measured: Measures, *,
    reach: float = 0.0, within: float = 0.0,
) -> Obstacles:  # fmt: skip
    """:func:`pack` for poses (K, 3), (K, 3, 3) and measures that are arrays, checked already."""
    kind, size, bound = measured
    grid, grids = np.full(len(kind), -1, dtype=np.int64), _NO_GRIDS
    if own := [shapes[k] for k in np.flatnonzero(kind == GRID).tolist()]:
        shaped = list({id(shape): shape for shape in own}.values())
        place = {id(shape): k for k, shape in enumerate(shaped)}
        grid[kind == GRID] = [place[id(shape)] for shape in own]
        grids = _pack_grids(shaped)
    for array in (kind, position, rotation, size, bound, grid):
        array.setflags(write=False)
    cells = make_cells(position, bound, reach, within) if reach > 0.0 else NO_CELLS
    return Obstacles(kind, position, rotation, size, bound, grid, *grids, cells)


def measures(shapes: Sequence[Shape]) -> Measures:
    """``kind`` (K,), ``size`` (K, 3) and ``bound`` (K,) of shapes, see :class:`Obstacles`."""
    count = len(shapes)
    kind, size, bound = np.empty(count, np.int64), np.empty((count, 3)), np.empty(count)
    for k, one in alike(shapes):
        kind[k], (size[k, 0], size[k, 1], size[k, 2]), bound[k], *_ = one.measure
    return read_only(kind), read_only(size), read_only(bound)


def near(obstacles: Obstacles, center: FloatArray, reach: float) -> Obstacles:
    """The obstacles whose bounding balls come within ``reach`` [m] of ``center`` (3,); no cells."""
    off = obstacles.position - center
    keep = lengths(off) - obstacles.bound <= reach
    return selected(obstacles, slice(None) if keep.all() else keep)


def selected(obstacles: Obstacles, which: slice | BoolArray) -> Obstacles:
    """Some of the obstacles, without cells."""
    kept = {name: read_only(getattr(obstacles, name)[which]) for name in _EACH}
    return obstacles._replace(**kept, cells=NO_CELLS)


def appended(obstacles: Obstacles, simple: Obstacles) -> Obstacles:
    """The obstacles followed by ``simple`` ones, none of which has a grid; without cells."""
    both = {
        name: read_only(np.concatenate([getattr(obstacles, name), getattr(simple, name)]))
        for name in _EACH
    }
    return obstacles._replace(**both, cells=NO_CELLS)


def _check_poses(position: FloatArray, rotation: FloatArray) -> None:
    if np.isfinite(position).all() and (rotation == np.eye(3)).all():
        return  # the usual case: none is turned
    for name, values in (("position", position), ("rotation", rotation)):
        bad = np.argwhere(~np.isfinite(values))
        if bad.size:
            where = "".join(f"[{i}]" for i in bad[0][1:])
            raise InvalidSceneError(f"obstacle {bad[0][0]}: {name}{where} must be finite")
    error = np.abs(rotation @ rotation.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2))
    wrong = np.flatnonzero((error > 1e-6) | (np.linalg.det(rotation) < 0.0))
    if wrong.size:
        index = wrong[0]
        raise InvalidSceneError(
            f"obstacle {index}: rotation is no rotation matrix (R Rᵀ off the identity by "
            f"{error[index]:.2g}, determinant {np.linalg.det(rotation[index]):.3g})"
        )


def _pack_grids(
    shapes: Sequence[Shape],
) -> tuple[FloatArray, IntArray, IntArray, FloatArray, FloatArray]:
    from optipromp.core.geometry.grids import distance_grid

    grids = [distance_grid(shape) for shape in shapes]
    ends = np.cumsum([0, *(grid.values.size for grid in grids)], dtype=np.int64)
    return (
        read_only(np.concatenate([grid.values.ravel() for grid in grids])),
        read_only(ends[:-1]),
        read_only(np.array([grid.values.shape for grid in grids], dtype=np.int64)),
        read_only(np.array([grid.origin for grid in grids], dtype=np.float64)),
        read_only(np.array([grid.spacing for grid in grids], dtype=np.float64)),
    )


_NO_GRIDS = (
    read_only(np.zeros(0)), read_only(np.zeros(0, np.int64)), read_only(np.zeros((0, 3), np.int64)),
    read_only(np.zeros((0, 3))), read_only(np.zeros(0)),
)  # fmt: skip
