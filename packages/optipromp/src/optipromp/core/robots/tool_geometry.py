"""The solids of a tool, and their cover, inertia and outline."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from optipromp.core.arrays import FloatArray
from optipromp.core.geometry.shapes import BOX, CYLINDER, GRID, Shape, box_axes

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


EXCESS = 0.004  # [m] that a sphere may reach beyond a box, chosen: as beyond a cup
MOST = 60  # spheres of a tool, chosen: as many as the Panda has
MOST_CORNERS = 8  # of a polygon, which the push models allow
Part = Literal["mouth", "neck", "palm", "finger", "load"]


@dataclass(frozen=True, eq=False)
class Solid:
    """One convex solid of a tool, in the flange frame.

    Attributes:
        name: unique within the tool.
        shape: convex, of finite size.
        position: (3,) of the shape's frame [m].
        orientation: of the shape's frame, a unit quaternion w, x, y, z.
        part: kind of part, which determines its colour in pictures.
    """

    name: str
    shape: Shape
    position: FloatArray
    orientation: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)
    part: Part = "palm"

    @property
    def rotation(self) -> FloatArray:
        """(3, 3) from the shape's frame to the flange frame."""
        from scipy.spatial.transform import Rotation

        w, x, y, z = self.orientation
        return np.asarray(Rotation.from_quat([x, y, z, w]).as_matrix())

    @property
    def corners(self) -> FloatArray:
        """Corners (N, 3) [m]; points of the surface if the solid is round."""
        return np.asarray(self.position + self.shape.mesh().vertices @ self.rotation.T)


def cover_solids(solids: Sequence[Solid]) -> FloatArray:
    """Spheres (k, 4) [m] that cover solids, in the flange frame.

    A sphere encloses each cell of a grid over the box of a solid; cells that a round or pointed
    solid does not meet are left out. With half edges h of a cell, a sphere reaches at most
    ‖h‖ - min h beyond a box, and 2 ‖h‖ beyond another solid. The cells are as fine as :data:`MOST`
    spheres allow, at least one per solid, until spheres reach at most :data:`EXCESS` beyond a box.
    """
    excess = EXCESS
    while True:
        cover = np.concatenate([_cover(solid, excess) for solid in solids])
        if len(cover) <= max(MOST, len(solids)):
            return cover
        excess *= 1.25


def solids_inertia(solids: Sequence[Solid], mass: float) -> tuple[FloatArray, FloatArray]:
    """Centre of mass (3,) [m] and inertia about it (3, 3) [kg m²] of solids of total ``mass`` [kg].

    The mass is shared by the volumes of the boxes of the solids. The inertia of a box of half edges
    h is m/3 (‖h‖² I - diag h²).
    """
    boxes = [_box(solid) for solid in solids]
    volume = np.array([np.prod(half) for _, half, _ in boxes])
    share = mass * volume / volume.sum()
    centers = np.array([center for center, _, _ in boxes])
    middle = share @ centers / mass
    total = np.zeros((3, 3))
    for m, (center, half, axes) in zip(share, boxes, strict=True):
        own = m / 3.0 * axes @ np.diag(half @ half - half**2) @ axes.T
        away = center - middle
        total += own + m * (away @ away * np.eye(3) - np.outer(away, away))
    return middle, total


def _box(solid: Solid) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Centre (3,), half edges (3,) [m] and axes (3, 3), as columns, of a box about a solid."""
    measure = solid.shape.measure
    center, half, axes = np.zeros(3), np.array(measure.half), np.eye(3)
    if measure.kind == GRID:
        vertices = solid.shape.mesh().vertices
        axes = box_axes(vertices).T
        local = vertices @ axes
        low, high = local.min(axis=0), local.max(axis=0)
        center, half = axes @ (0.5 * (low + high)), 0.5 * (high - low)
    turned = solid.rotation
    return solid.position + turned @ center, half, turned @ axes


def _cover(solid: Solid, excess: float) -> FloatArray:
    """Spheres (k, 4) around the cells of a solid; see :func:`cover_solids`."""
    center, half, axes = _box(solid)
    grid = cover_box(2.0 * half, excess)
    centers = center + grid[:, :3] @ axes.T
    if solid.shape.measure.kind != BOX:
        own = (centers - solid.position) @ solid.rotation
        met = _beyond(solid.shape, own) <= grid[:, 3]
        centers, grid = centers[met], grid[met]
    return np.column_stack([centers, grid[:, 3]])


def _beyond(shape: Shape, points: FloatArray) -> FloatArray:
    """Lower bound (k,) of the distance of points (k, 3) from a convex shape, in its frame [m].

    By planes that are parallel to the faces of its mesh. The extents of a cylinder are those of its
    mesh, with 24 points around: by a share of 1 - cos(π / 24) too small.
    """
    from scipy.spatial import ConvexHull

    normals = np.unique(ConvexHull(shape.mesh().vertices).equations[:, :3], axis=0)
    measure, inside = shape.measure, 1.0 - math.cos(math.pi / 24.0)
    slack = inside * measure.half[0] if measure.kind == CYLINDER else 0.0
    return np.asarray((points @ normals.T - shape.support(normals)).max(axis=1) - slack)


def swept_polygons(corners: FloatArray) -> list[FloatArray]:
    """The volume that a solid sweeps as it turns about z, seen along x, as convex polygons."""
    low, high, inner, outer = profile(corners)
    sides = [(-outer, outer)] if inner == 0.0 else [(inner, outer), (-outer, -inner)]
    parts = [strip(low, high, a, b) for a, b in sides]
    if inner == 0.0:
        x, y, u = corners.T
        across = np.hypot(x, y)
        whole = hull(np.column_stack([np.tile(u, 2), np.append(across, -across)]))
        parts = [whole] if len(whole) <= MOST_CORNERS else parts
    return parts


def strip(low: float, high: float, a: float, b: float) -> FloatArray:
    """Corners (4, 2) of a rectangle: ``low`` to ``high`` along the tool axis, a to b across it."""
    return np.array([[low, a], [high, a], [high, b], [low, b]])


def profile(corners: FloatArray) -> tuple[float, float, float, float]:
    """Least and largest height of a convex solid along z; its least and largest distance from z.

    ``corners``: (N, 3) in tool axes [m].
    """
    x, y, u = corners.T
    outer = float(np.hypot(x, y).max())
    return float(u.min()), float(u.max()), _from_origin(hull(corners[:, :2])), outer


def _from_origin(polygon: FloatArray) -> float:
    """Distance of the origin from a convex polygon (k, 2), counter-clockwise; 0 within."""
    side = np.roll(polygon, -1, axis=0) - polygon
    if (polygon[:, 0] * side[:, 1] - polygon[:, 1] * side[:, 0] >= 0.0).all():
        return 0.0
    share = np.clip(-np.sum(polygon * side, axis=1) / np.sum(side**2, axis=1), 0.0, 1.0)
    return float(np.linalg.norm(polygon + share[:, None] * side, axis=1).min())


def hull(points: FloatArray) -> FloatArray:
    """Convex hull (k, 2), counter-clockwise, of points (m, 2)."""
    from scipy.spatial import ConvexHull

    return np.asarray(points[ConvexHull(points).vertices])
