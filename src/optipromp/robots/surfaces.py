"""The surfaces of links, coarsely: whether it is the links that touch, or only their covers."""

import numpy as np

from optipromp.arrays import BoolArray, FloatArray

CELL = 0.003  # [m] chosen: edge of the cells of a surface
STEP = 0.7  # [cells] longest side of the pieces whose corners mark cells
NEAR = CELL * (1.5 * np.sqrt(3.0) + 2.0 * STEP / np.sqrt(3.0))
"""Surfaces that touch have cells whose middles are no farther apart than this [m]: of either, half
a diagonal from a corner that marks it, and that corner within its piece of the contact. Another
half is because the other's middle is rounded to a cell."""


def surface(triangles: FloatArray) -> FloatArray:
    """The middles (k, 3) of the cells that triangles (f, 3, 3) pass through [m]."""
    from optipromp.robots.fit import cut  # with SciPy's image functions, which load slowly

    corners = cut(triangles, STEP * CELL).reshape(-1, 3)
    low = corners.min(axis=0)
    cells = np.floor((corners - low) / CELL).astype(np.int64)
    shape = tuple(cells.max(axis=0) + 1)
    codes = np.unique(np.ravel_multi_index(tuple(cells.T), shape))
    return np.asarray(low + (np.column_stack(np.unravel_index(codes, shape)) + 0.5) * CELL)


def of_box(size: FloatArray) -> FloatArray:
    """Points (k, 3) of the surface of a box of full sizes (3,), at most :data:`CELL` apart."""
    ticks = [np.linspace(-0.5 * s, 0.5 * s, int(np.ceil(s / CELL)) + 1) for s in size]
    faces = []
    for axis in range(3):
        for end in (0, -1):
            on_face = [tick[[end]] if k == axis else tick for k, tick in enumerate(ticks)]
            faces.append(np.stack(np.meshgrid(*on_face, indexing="ij"), axis=-1).reshape(-1, 3))
    return np.concatenate(faces)


def of_rod(radius: float, length: float, round_ends: float) -> FloatArray:
    """The same of a cylinder along z; its ends bulge by ``round_ends``: 0, or the radius."""
    bend = np.linspace(0.0, 0.5 * np.pi, int(np.ceil(1.6 * radius / CELL)) + 2)
    end = np.column_stack([radius * np.sin(bend), 0.5 * length + round_ends * np.cos(bend)])
    side = np.linspace(-0.5, 0.5, int(np.ceil(length / CELL)) + 1) * length
    along = np.column_stack([np.full(len(side), radius), side])
    rings = []
    for r, z in np.concatenate([end, along, end * [1.0, -1.0]]):
        turn = np.linspace(0.0, 2.0 * np.pi, int(np.ceil(2.0 * np.pi * r / CELL)) + 1)
        rings.append(np.column_stack([r * np.cos(turn), r * np.sin(turn), np.full(len(turn), z)]))
    return np.concatenate(rings)


class Neighbourhood:
    """The cells as near as :data:`NEAR` to a surface (k, 3), in the frame of its link's segment."""

    def __init__(self, points: FloatArray) -> None:
        from scipy.ndimage import distance_transform_edt

        self.low = points.min(axis=0) - 1.5 * NEAR
        size = np.ceil((points.max(axis=0) + 1.5 * NEAR - self.low) / CELL).astype(np.int64)
        away = np.ones(tuple(size), dtype=bool)
        away[tuple(np.floor((points - self.low) / CELL).astype(np.int64).T)] = False
        self.cells = CELL * distance_transform_edt(away) <= NEAR
        self.last = size - 1

    def touched(self, points: FloatArray, turns: FloatArray, shifts: FloatArray) -> BoolArray:
        """Whether another surface (k, 3) is in it, at poses (m, 3, 3) and (m, 3) in its frame.

        Of links whose surfaces are apart neither is taken to be inside the other.
        """
        out = np.zeros(len(shifts), dtype=bool)
        for k, (turn, shift) in enumerate(zip(turns, shifts, strict=True)):
            cells = np.floor((points @ turn.T + (shift - self.low)) / CELL).astype(np.int64)
            inside = cells[((cells >= 0) & (cells <= self.last)).all(axis=1)]
            out[k] = self.cells[tuple(inside.T)].any()
        return out
