"""Spheres over the mesh of a link: each connected piece cut into slabs, each slab covered."""

from pathlib import Path
from typing import Any

import numpy as np

from optipromp.arrays import FloatArray, IntArray
from optipromp.errors import InvalidRobotError
from optipromp.robots.spheres import MAX_SPHERES, allowance, cover_box
from optipromp.robots.urdf import LENGTH_LIMIT, UrdfGeometry, UrdfModel

MAX_PIECES = 12  # a mesh of more pieces is covered as one
MAX_SLABS = 16


def cover_mesh(model: UrdfModel, link: str, shape: UrdfGeometry) -> FloatArray:
    """Spheres (k, 4) that cover the solid whose surface the mesh is (its slabs' convex hulls).

    Raises InvalidRobotError, naming the link and the file, when the mesh is missing, cannot be
    read, has no area or is larger than 20 m, or when the extra that reads meshes is not installed.
    """
    where = f"{model.path}: link '{link}' mesh '{shape.mesh}'"
    vertices, faces = _load(_resolve(model.path, shape.mesh, where), where)
    if not np.isfinite(vertices).all():
        raise InvalidRobotError(f"{where} is malformed: a vertex is not finite")
    vertices = vertices * np.array(shape.size)
    corners = vertices[faces]
    area = np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    extent = float(np.ptp(vertices, axis=0).max())
    if not area.sum() > 1e-12 * max(extent, 1e-12) ** 2:
        raise InvalidRobotError(f"{where} is degenerate: its surface has no area")
    if float(np.abs(corners).max()) > LENGTH_LIMIT:
        raise InvalidRobotError(
            f"{where} spans {extent:g} m and lies beyond 20 m: millimetres? Give it a scale"
        )
    parts = pieces(vertices, faces)
    if len(parts) > MAX_PIECES:
        parts = [faces]
    return np.concatenate([_cover_piece(vertices, piece) for piece in parts])


def _resolve(urdf: Path, name: str, where: str) -> Path:
    """The file that ``name`` means, relative to the URDF's folder or the package's folder."""
    folder = urdf.resolve().parent
    if name.startswith("package://"):
        package, _, rest = name.removeprefix("package://").partition("/")
        candidates = [up / package / rest for up in (folder, *folder.parents)]
        candidates += [up / rest for up in (folder, *folder.parents) if up.name == package]
    else:
        candidates = [folder / name.removeprefix("file://")]
    for candidate in candidates:
        if candidate.is_file():
            return candidate
    raise InvalidRobotError(f"{where}: no such file, looked for {candidates[0]}")


def _load(path: Path, where: str) -> tuple[FloatArray, IntArray]:
    try:
        import trimesh
    except ImportError as error:
        raise InvalidRobotError(
            f"{where}: reading meshes needs trimesh (pip install 'optipromp[mesh]'); or give the "
            "link spheres in a robot file"
        ) from error
    try:
        mesh: Any = trimesh.load(str(path), force="mesh")
        vertices = np.array(mesh.vertices, dtype=np.float64)
        faces = np.array(mesh.faces, dtype=np.int64)
    except Exception as error:  # trimesh's readers raise whatever goes wrong in them
        raise InvalidRobotError(f"{where}: not a mesh that can be read: {error}") from error
    if vertices.ndim != 2 or faces.ndim != 2 or not len(faces):
        raise InvalidRobotError(f"{where}: holds no triangles")
    return vertices, faces


def pieces(vertices: FloatArray, faces: IntArray) -> list[IntArray]:
    """The faces of each connected piece; vertices at one place are one."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    _, merged = np.unique(vertices.round(9), axis=0, return_inverse=True)
    joined = merged.reshape(-1)[faces]
    rows, columns = joined[:, [0, 1]].ravel(), joined[:, [1, 2]].ravel()
    size = int(joined.max()) + 1
    graph = coo_array((np.ones(len(rows)), (rows, columns)), shape=(size, size))
    _, label = connected_components(graph, directed=False)
    of_face = label[joined[:, 0]]
    return [faces[of_face == value] for value in np.unique(of_face)]


def _cover_piece(vertices: FloatArray, faces: IntArray) -> FloatArray:
    points = vertices[np.unique(faces)]
    frame = box_axes(points)
    local = vertices @ frame.T
    used = local[np.unique(faces)]
    low, high = used.min(axis=0), used.max(axis=0)
    size = high - low
    count = int(np.clip(round(float(2.0 * size[0] / max(size[1], 1e-9))), 1, MAX_SLABS))
    cuts = np.linspace(low[0], high[0], count + 1)
    edges = np.unique(np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1), axis=0)
    a, b = local[edges[:, 0]], local[edges[:, 1]]
    crossings = []
    for cut in cuts:
        side = (a[:, 0] - cut) * (b[:, 0] - cut) < 0.0
        share = (cut - a[side, 0]) / (b[side, 0] - a[side, 0])
        crossings.append(a[side] + share[:, None] * (b[side] - a[side]))
    covers = []
    for i in range(count):
        inside = used[(used[:, 0] >= cuts[i]) & (used[:, 0] <= cuts[i + 1])]
        # the convex hull of these points contains the slab of the solid
        slab = np.concatenate([inside, crossings[i], crossings[i + 1]])
        if len(slab):
            covers.append(_cover_slab(slab, max(MAX_SPHERES // count, 2)))
    cover = np.concatenate(covers)
    return np.column_stack([cover[:, :3] @ frame, cover[:, 3] * (1.0 + 1e-9)])


def _cover_slab(points: FloatArray, most: int) -> FloatArray:
    """Spheres over the convex hull of ``points``: one where that is close, else a grid of ``most``.

    Slabs lie along x: a sphere is judged by how far it reaches beyond them in y and z.
    """
    low, high = points.min(axis=0), points.max(axis=0)
    middle, size = (low + high) / 2.0, high - low
    half_width = float(size[1:].min()) / 2.0
    radius = float(np.linalg.norm(points - middle, axis=1).max())
    if radius - half_width <= max(0.015, 0.3 * half_width):
        return np.array([[*middle, radius]])
    grid = cover_box(size, allowance(half_width), most)
    if float(grid[0, 3]) >= radius:
        return np.array([[*middle, radius]])
    grid[:, :3] += middle
    return grid


def box_axes(points: FloatArray) -> FloatArray:
    """Rows: axes of the smaller of two boxes around ``points``, along the world's or the principal.

    Longest side first.
    """
    principal = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2]
    if len(principal) < 3:
        principal = np.eye(3)
    best = min((np.eye(3), principal), key=lambda axes: float(np.prod(_extent(points, axes))))
    order = np.argsort(-_extent(points, best), kind="stable")
    frame: FloatArray = best[order]
    return frame


def _extent(points: FloatArray, axes: FloatArray) -> FloatArray:
    return np.asarray(np.ptp(points @ axes.T, axis=0) + 1e-6)
