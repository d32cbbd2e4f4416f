"""The pieces and boxes of a mesh."""

import numpy as np

from optipromp.core.arrays import FloatArray, IntArray
from optipromp.core.geometry.shapes import MeshShape


def pieces(vertices: FloatArray, faces: IntArray) -> list[IntArray]:
    """The faces (f, 3) of each connected piece; vertices within 1e-9 m are merged."""
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


def parted(mesh: MeshShape) -> list[MeshShape]:
    """The connected pieces of a mesh, each with its own vertices."""
    out = []
    for faces in pieces(mesh.vertices, mesh.faces):
        used, own = np.unique(faces, return_inverse=True)
        out.append(MeshShape(mesh.vertices[used], own.reshape(-1, 3)))
    return out


def box_axes(points: FloatArray) -> FloatArray:
    """Axes (3, 3), as rows, of a box around ``points`` (m, 3), longest side first.

    The box is along the axes of the frame or along the principal axes, whichever is smaller.
    """
    principal = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2]
    if len(principal) < 3:
        principal = np.eye(3)
    best = min((np.eye(3), principal), key=lambda axes: float(np.prod(_extent(points, axes))))
    order = np.argsort(-_extent(points, best), kind="stable")
    frame: FloatArray = best[order]
    return frame


def _extent(points: FloatArray, axes: FloatArray) -> FloatArray:
    """Sizes (3,) of the box of ``points`` along ``axes``; 1e-6 m larger, so that none is 0."""
    return np.asarray(np.ptp(points @ axes.T, axis=0) + 1e-6)
