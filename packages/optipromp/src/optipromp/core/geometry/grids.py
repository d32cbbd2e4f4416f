"""Distance grids of meshes and point clouds, cached on disk under a hash of the shape.

The distance is interpolated between nodes. Near a part thinner than a cell, the interpolated
distance can be too large. A grid is therefore refined where samples of the surface show such an
error, and the remaining error is subtracted. The obstacle in the grid exceeds the shape by less
than a cell, and contains all samples of its surface.

Nodes are filled block by block. The triangles, or the cells of points, that may be the nearest ones
are determined once per block; a node measures only those nearer than its nearest one so far.
"""

from __future__ import annotations

import hashlib
import math
from contextlib import suppress
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path

import numpy as np

from optipromp.core.arrays import FloatArray, IntArray, frozen, lengths
from optipromp.core.compiled import compiler, kernel
from optipromp.core.errors import InvalidRequestError, InvalidSceneError
from optipromp.core.files import cache_folder, npz, read_npz, write_atomically
from optipromp.core.geometry.shapes import FINE, GRID_PADDING, MeshShape, PointCloudShape, Shape

CELLS = 48  # cells along the longest side of a mesh, before refinement

_VERSION = 3  # part of the cache key: raise it when the same input gives other values
_MESH_NODES = 1_500_000  # at most; 12 MB
_CLOUD_NODES = 200_000  # at most; 1.6 MB
_CLOUD_NEAR = 0.15  # [m] distance to a cloud up to which nodes are exact
_CLOUD_SLACK = 0.1  # [-] largest relative error of longer distances
_THIN = 0.25  # [cells] a larger error shows a part thinner than a cell
_ACROSS = 4  # cells across the shortest side of a mesh, at least
_SAMPLES = 4_000  # of a mesh's surface, about
_BLOCK = 4  # nodes along an edge of a block, which shares one list of candidates
_CELL = 3.0  # [steps of the grid] along an edge of a cell
_TINY = 1e-300  # a squared length [m²] or area [m⁴] up to here counts as 0
_KEPT = 32  # grids in memory, at most


@dataclass(frozen=True, eq=False)
class DistanceGrid:
    """Signed distances [m] at the nodes of a regular grid in a shape's local frame. ``values``:
    (n0, n1, n2). ``origin``: (3,) first node [m]. ``spacing``: between neighbouring nodes [m]."""

    values: FloatArray
    origin: FloatArray
    spacing: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "values", frozen(self.values))
        object.__setattr__(self, "origin", frozen(self.origin))


@dataclass(frozen=True)
class _Source:
    """A shape of which a grid is made; alike ones are equal."""

    key: str  # hash of the shape
    shape: MeshShape | PointCloudShape = field(compare=False)


def distance_grid(shape: Shape) -> DistanceGrid:
    """The grid of a shape: from memory, from disk, or built and then stored in both; that of a
    cloud of no file, as a look has, in memory alone. The cache folder is ``OPTIPROMP_CACHE``, else
    the platform's. A folder that cannot be written is no error."""
    shape = shape if isinstance(shape, PointCloudShape) else shape.mesh(FINE)
    return _grid(_Source(_key(shape), shape))


@lru_cache(maxsize=_KEPT)
def _grid(source: _Source) -> DistanceGrid:
    lasts = isinstance(source.shape, MeshShape) or source.shape.path is not None
    folder = cache_folder() if lasts else None
    file = None if folder is None else folder / "grids" / f"{source.key}.npz"
    grid = None if file is None else _load(file)
    if grid is None:
        shape = source.shape
        grid = mesh_grid(shape) if isinstance(shape, MeshShape) else cloud_grid(shape)
        if file is not None:
            with suppress(InvalidRequestError):  # the next run builds it again
                write_atomically(file, npz(vars(grid)))
    return grid


def mesh_grid(mesh: MeshShape) -> DistanceGrid:
    """Signed distance grid of a closed mesh. The nodes hold exact distances to the triangles,
    signed by the generalised winding number; the mesh may have either orientation. The spacing is
    the longest side / 48, halved while the grid misses a thin part and the finer grid has at most
    1.5 million nodes."""
    check_closed(mesh)
    triangles = np.ascontiguousarray(mesh.vertices[mesh.faces])
    lower, upper = triangles.min(axis=(0, 1)), triangles.max(axis=(0, 1))
    samples = _surface_samples(triangles)
    step = float((upper - lower).max()) / CELLS
    while True:
        origin, shape = _layout(lower, upper, step)
        values = signed_grid(triangles, origin, step, shape)
        error = float(_interpolate(values, origin, step, samples).max())
        finer = _layout(lower, upper, 0.5 * step)[1]
        resolved = error <= _THIN * step and float((upper - lower).min()) >= _ACROSS * step
        if resolved or np.prod(finer) > _MESH_NODES:
            return DistanceGrid(values - max(error, 0.0), origin, step)
        step *= 0.5


def cloud_grid(cloud: PointCloudShape) -> DistanceGrid:
    """Distance grid of a point cloud: the distance to the nearest point less the points' radius. A
    distance beyond :data:`_CLOUD_NEAR` may be too small by the share :data:`_CLOUD_SLACK`: an exact
    distance in the middle of a hollow cloud would need every point. The grid is as fine as 200,000
    nodes allow, but no finer than half the radius."""
    lower = cloud.points.min(axis=0) - cloud.radius
    upper = cloud.points.max(axis=0) + cloud.radius
    step = max(0.5 * cloud.radius, float((upper - lower).max()) / 512)
    while np.prod(_layout(lower, upper, step)[1]) > _CLOUD_NODES:
        step *= 1.05
    origin, shape = _layout(lower, upper, step)
    values = to_nearest(cloud.points, origin, step, shape, _CLOUD_NEAR, _CLOUD_SLACK)
    values -= cloud.radius
    error = float(_interpolate(values, origin, step, cloud.points).max()) + cloud.radius
    return DistanceGrid(values - max(error, 0.0), origin, step)


def check_closed(mesh: MeshShape) -> None:
    """Refuse a mesh that is not a closed surface with a volume. A mesh is closed if as many faces
    run along every edge in one sense as in the other: then its winding number is an integer
    everywhere. Vertices at one place count as one."""
    name = f"mesh {mesh.path}" if mesh.path is not None else "mesh"
    corners = mesh.vertices[mesh.faces]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = 0.5 * float(lengths(across).sum())
    extent = float(np.ptp(mesh.vertices, axis=0).max())
    if area <= 1e-12 * extent**2 or extent <= 0.0:
        raise InvalidSceneError(f"{name}: is degenerate: its {len(corners)} faces have no area")
    merged = np.unique(mesh.vertices, axis=0, return_inverse=True)[1].reshape(-1)
    faces = merged[mesh.faces]
    open_edges = _open_edges(faces)
    if open_edges:
        raise InvalidSceneError(
            f"{name}: is not watertight: {open_edges} edges lack a neighbour of matching "
            "orientation; must be a closed surface"
        )
    centered = corners - mesh.vertices.mean(axis=0)
    crossed = np.cross(centered[:, 0], centered[:, 1])
    volume = float((crossed * centered[:, 2]).sum()) / 6.0
    if abs(volume) <= 1e-12 * extent**3:
        raise InvalidSceneError(f"{name}: is degenerate: it encloses no volume")


def _open_edges(faces: IntArray) -> int:
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    edges = edges[edges[:, 0] != edges[:, 1]]
    sense = np.where(edges[:, 0] < edges[:, 1], 1, -1)
    inverse = np.unique(np.sort(edges, axis=1), axis=0, return_inverse=True)[1].reshape(-1)
    return int(np.count_nonzero(np.bincount(inverse, weights=sense)))


def _surface_samples(triangles: FloatArray) -> FloatArray:
    """Points on the triangles (S, 3), none near an edge, where interpolation always errs."""
    each = max(1, _SAMPLES // len(triangles))
    weights = np.random.default_rng(0).dirichlet((1.0, 1.0, 1.0), size=each)
    weights = 0.5 * weights + 0.5 / 3.0
    return np.asarray(np.einsum("sj,fji->fsi", weights, triangles).reshape(-1, 3))


def _layout(
    lower: FloatArray, upper: FloatArray, spacing: float
) -> tuple[FloatArray, tuple[int, int, int]]:
    """First node and node counts of a grid with GRID_PADDING cells around a box."""
    cells = np.ceil((upper - lower) / spacing * (1.0 - 1e-12)).astype(np.int64) + 2 * GRID_PADDING
    origin: FloatArray = 0.5 * (lower + upper) - 0.5 * spacing * cells
    n0, n1, n2 = (int(count) + 1 for count in cells)
    return origin, (n0, n1, n2)


def _interpolate(
    values: FloatArray, origin: FloatArray, spacing: float, points: FloatArray
) -> FloatArray:
    from scipy.ndimage import map_coordinates

    return np.asarray(map_coordinates(values, ((points - origin) / spacing).T, order=1))


def _key(shape: MeshShape | PointCloudShape) -> str:
    digest = hashlib.sha256(f"{type(shape).__name__} {_VERSION}".encode())
    if isinstance(shape, MeshShape):
        parts = (shape.vertices, shape.faces)
    else:
        parts = (shape.points, np.array([shape.radius]))
    for part in parts:
        digest.update(str(part.shape).encode())
        digest.update(np.ascontiguousarray(part).tobytes())
    return digest.hexdigest()


def _load(file: Path) -> DistanceGrid | None:
    """The grid in a cache file; None if the file is missing or unusable."""
    try:
        data = read_npz(file)
        values, origin, spacing = data["values"], data["origin"], float(data["spacing"])
    except (InvalidRequestError, KeyError, TypeError, ValueError):
        return None
    usable = (
        values.ndim == 3
        and values.dtype == np.float64
        and min(values.shape) >= 2
        and origin.shape == (3,)
        and np.isfinite(values).all()
        and spacing > 0.0
    )
    return DistanceGrid(values, origin, spacing) if usable else None


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
    d."""
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
    half = 0.5 * step * (_BLOCK - 1)
    for i in range(0, n0, _BLOCK):
        for j in range(0, n1, _BLOCK):
            for k in range(0, n2, _BLOCK):
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
                for a in range(i, min(i + _BLOCK, n0)):
                    for b in range(j, min(j + _BLOCK, n1)):
                        for c in range(k, min(k + _BLOCK, n2)):
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


@kernel
def _segment_squared(p0, p1, p2, a, e0, e1, e2):
    """Squared distance from p to the segment from a along e."""
    d0, d1, d2 = p0 - a[0], p1 - a[1], p2 - a[2]
    length = e0 * e0 + e1 * e1 + e2 * e2
    t = 0.0
    if length > _TINY:
        t = min(max((d0 * e0 + d1 * e1 + d2 * e2) / length, 0.0), 1.0)
    d0, d1, d2 = d0 - t * e0, d1 - t * e1, d2 - t * e2
    return float(d0 * d0 + d1 * d1 + d2 * d2)


@kernel
def triangle_squared(p0, p1, p2, corners):
    """Squared distance from p to the triangle with ``corners`` (3, 3), which may be degenerate.
    Where the foot of p is inside the triangle, it is the distance to the plane, else to an edge."""
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
def winding_number(p0, p1, p2, triangles):
    """Generalised winding number of triangles (F, 3, 3) about p: the sum of solid angles over 4π.
    Solid angles after van Oosterom and Strackee (1983), their sum after Jacobson et al. (2013)."""
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
def _fill_distances(triangles, centers, radii, origin, spacing, values):
    """Unsigned distances, block by block. ``centers`` (F, 3) and ``radii`` (F,) [m] are of balls
    that hold the triangles. Let c be the centre of a block of radius rho. The triangle nearest to
    any node of the block has a ball no farther from c than D(c) + 2 rho: the other triangles are
    skipped."""
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
def _sign_distances(triangles, origin, spacing, values):
    """Make the distances of nodes inside the surface negative. The winding number changes only
    across the surface. It is equal at two neighbouring nodes unless both are nearer to the surface
    than the step. A margin of 1 % keeps the sign of a node on the surface, which is arbitrary, from
    being passed on. Rows start outside, in the padding."""
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
