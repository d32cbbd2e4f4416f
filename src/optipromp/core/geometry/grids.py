"""Distance grids of meshes and point clouds, cached on disk under a hash of the shape.

The distance is interpolated between nodes. Near a part thinner than a cell, the interpolated
distance can be too large. A grid is therefore refined where samples of the surface show such an
error, and the remaining error is subtracted. The obstacle in the grid exceeds the shape by less
than a cell, and contains all samples of its surface.
"""

from __future__ import annotations

import hashlib
import threading
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from optipromp.core.arrays import FloatArray, IntArray, frozen
from optipromp.core.errors import InvalidRequestError, InvalidSceneError
from optipromp.core.files import cache_folder, npz, read_npz, write_atomically
from optipromp.core.geometry.distances import GRID_PADDING
from optipromp.core.geometry.shapes import FINE, MeshShape, PointCloudShape, Shape

CELLS = 48
"""Cells along the longest side of a mesh, before refinement."""

_VERSION = 3  # part of the cache key: raise it when the same input gives other values
_MESH_NODES = 1_500_000  # at most; 12 MB
_CLOUD_NODES = 200_000  # at most; 1.6 MB
_CLOUD_NEAR = 0.15  # [m] distance to a cloud up to which nodes are exact
_CLOUD_SLACK = 0.1  # [-] largest relative error of longer distances
_THIN = 0.25  # [cells] a larger error shows a part thinner than a cell
_ACROSS = 4  # cells across the shortest side of a mesh, at least
_SAMPLES = 4_000  # of a mesh's surface, about
_KEPT = 32  # grids in memory, at most

_memory: dict[str, DistanceGrid] = {}
_lock = threading.Lock()


@dataclass(frozen=True, eq=False)
class DistanceGrid:
    """Signed distances [m] at the nodes of a regular grid in a shape's local frame.

    ``values``: (n0, n1, n2). ``origin``: (3,) first node [m]. ``spacing``: between neighbouring
    nodes [m].
    """

    values: FloatArray
    origin: FloatArray
    spacing: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "values", frozen(self.values))
        object.__setattr__(self, "origin", frozen(self.origin))


def distance_grid(shape: Shape) -> DistanceGrid:
    """The grid of a shape: from memory, from disk, or built and then stored in both.

    The cache folder is ``OPTIPROMP_CACHE``, else the platform's. A folder that cannot be written is
    no error.
    """
    shape = shape if isinstance(shape, PointCloudShape) else shape.mesh(FINE)
    key = _key(shape)
    with _lock:
        held = _memory.get(key)
    if held is not None:
        return held
    folder = cache_folder()
    file = None if folder is None else folder / "grids" / f"{key}.npz"
    grid = None if file is None else _load(file)
    if grid is None:
        grid = mesh_grid(shape) if isinstance(shape, MeshShape) else cloud_grid(shape)
        if file is not None:
            with suppress(InvalidRequestError):  # the next run builds it again
                write_atomically(file, npz(vars(grid)))
    with _lock:
        while len(_memory) >= _KEPT:
            _memory.pop(next(iter(_memory)))
        _memory[key] = grid
    return grid


def mesh_grid(mesh: MeshShape) -> DistanceGrid:
    """Signed distance grid of a closed mesh.

    The nodes hold exact distances to the triangles, signed by the generalised winding number; the
    mesh may have either orientation. The spacing is the longest side / 48, halved while the
    grid misses a thin part and the finer grid has at most 1.5 million nodes.
    """
    from optipromp.core.geometry.triangles import signed_grid

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
    """Distance grid of a point cloud: the distance to the nearest point less the points' radius.

    A distance beyond :data:`_CLOUD_NEAR` may be too small by the share :data:`_CLOUD_SLACK`: an
    exact distance in the middle of a hollow cloud would need every point. The grid is as fine as
    200,000 nodes allow, but no finer than half the radius.
    """
    from optipromp.core.geometry.nearest import to_nearest

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
    """Refuse a mesh that is not a closed surface with a volume.

    A mesh is closed if as many faces run along every edge in one sense as in the other: then its
    winding number is an integer everywhere. Vertices at one place count as one.
    """
    name = f"mesh {mesh.path}" if mesh.path is not None else "mesh"
    corners = mesh.vertices[mesh.faces]
    area = 0.5 * float(
        np.linalg.norm(
            np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
        ).sum()
    )
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
    samples: FloatArray = np.einsum("sj,fji->fsi", weights, triangles).reshape(-1, 3)
    return samples


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

    found: FloatArray = map_coordinates(values, ((points - origin) / spacing).T, order=1)
    return found


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
