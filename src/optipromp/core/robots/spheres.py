"""Spheres that cover a capsule, a box or a cylinder.

A cover is an array (k, 4) of centres and radii [m] in the frame of the shape. ``bulge`` [m] is the
distance by which the spheres may reach beyond the shape.
"""

import math

import numpy as np

from optipromp.core.arrays import FloatArray

MAX_SPHERES = 40  # per box or cylinder, chosen
_SLACK = 1.0 + 1e-9  # factor of the radii, against rounding of points on the surface


def cover_capsule(start: FloatArray, end: FloatArray, radius: float, bulge: float) -> FloatArray:
    r"""The fewest equal spheres in a row that cover a capsule, at most ``bulge`` beyond it.

    With k spheres of radius r + e, the outer ones e inside the ends, neighbours d apart cover the
    side when (r + e)² = r² + (d/2)²: a quadratic for e.
    """
    start, end = np.asarray(start, float), np.asarray(end, float)
    length = float(np.linalg.norm(end - start))
    if length < 1e-12:
        return np.array([[*start, radius * _SLACK]])
    excess, count = length / 2.0, 1
    while excess > bulge and count < 200:
        count += 1
        m = float((count - 1) ** 2)
        b, c = 2.0 * radius * m + length, length * length / 4.0
        # (m - 1) e² + b e = c, in the form that also holds for m = 1
        excess = 2.0 * c / (b + math.sqrt(b * b + 4.0 * (m - 1.0) * c))
    share = np.linspace(excess, length - excess, count) / length if count > 1 else np.array([0.5])
    centers = start + share[:, None] * (end - start)
    return np.column_stack([centers, np.full(count, (radius + excess) * _SLACK)])


def cover_box(size: FloatArray, bulge: float) -> FloatArray:
    """A grid of spheres, one around each cell, that covers a box of full sizes ``size`` (3,).

    The smallest grid that reaches at most ``bulge`` beyond the box; if none of at most
    :data:`MAX_SPHERES` spheres does, the tightest of them.
    """
    size = np.asarray(size, float)
    best = (math.inf, _GRIDS[0])
    for counts in _GRIDS:
        half = size / (2.0 * np.array(counts))
        excess = float(np.linalg.norm(half) - half.min())
        if excess < best[0] - 1e-12:
            best = (excess, counts)
        if excess <= bulge:
            break
    return _grid(size, best[1])


def cover_cylinder(radius: float, length: float, bulge: float) -> FloatArray:
    """Spheres that cover a cylinder along z: a row, or a grid if it is flat."""
    if length < 2.0 * radius:
        size = np.array([2.0 * radius, 2.0 * radius, length])
        grid = cover_box(size, bulge)
        half = size / (2.0 * np.array([len(np.unique(grid[:, i].round(12))) for i in range(3)]))
        nearest = np.maximum(np.abs(grid[:, :2]) - half[:2], 0.0)
        grid = grid[np.hypot(nearest[:, 0], nearest[:, 1]) < radius]
        if len(grid) > 1:
            return grid
    count = 1
    while math.hypot(radius, length / (2 * count)) - radius > bulge and count < MAX_SPHERES:
        count += 1
    half_step = length / (2.0 * count)
    z = -length / 2.0 + half_step * (2.0 * np.arange(count) + 1.0)
    out = np.zeros((count, 4))
    out[:, 2], out[:, 3] = z, math.hypot(radius, half_step) * _SLACK
    return out


def _grid(size: FloatArray, counts: tuple[int, int, int]) -> FloatArray:
    """Spheres (k, 4) around the cells of a box of full sizes ``size`` (3,)."""
    cell = size / np.array(counts)
    axes = [(np.arange(n) + 0.5) * c - s / 2.0 for n, c, s in zip(counts, cell, size, strict=True)]
    centers = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    radius = float(np.linalg.norm(cell)) / 2.0 * _SLACK
    return np.column_stack([centers, np.full(len(centers), radius)])


_GRIDS = sorted(
    (
        (i, j, k)
        for i in range(1, MAX_SPHERES + 1)
        for j in range(1, MAX_SPHERES // i + 1)
        for k in range(1, MAX_SPHERES // (i * j) + 1)
    ),
    key=lambda counts: (math.prod(counts), counts),
)
