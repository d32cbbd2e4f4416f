"""Surfaces of shapes as faces, and as triangles that shade well.

Faces are quadrilaterals (F, 4, 3) [m], corners anticlockwise seen from outside; a triangle repeats
its last corner.
"""

from itertools import pairwise

import numpy as np

from optipromp.arrays import FloatArray, IntArray, frame_along
from optipromp.geometry import shapes
from optipromp.geometry.shapes import Shape

_LARGEST_FACE = 0.04  # [m] big flat faces are cut so that a painter may sort them by depth
_MOST_PIECES = 100  # that an edge is cut into: a floor of kilometres would fill the memory
_CREASE = 0.77  # cosine of 40 degrees: a sharper edge is shaded as one; a choice
_DIGITS = 7  # of metres: corners nearer than that are one
_MOST_POINTS = 1500  # of a point cloud that are drawn


def shape_faces(
    shape: Shape, position: FloatArray, rotation: FloatArray, cut: float = _LARGEST_FACE
) -> FloatArray:
    """Faces (F, 4, 3) of a shape placed in the world.

    Args:
        shape: the shape in its local frame.
        position: (3,) [m].
        rotation: (3, 3), world from local.
        cut: flat faces are no larger [m], unless an edge has :data:`_MOST_PIECES` of them.
    """
    return np.asarray(_local_faces(shape, cut) @ np.asarray(rotation).T + np.asarray(position))


def sphere(center: FloatArray, radius: float, around: int = 20) -> FloatArray:
    """Faces of a sphere."""
    polar = np.linspace(0.0, np.pi, around // 2 + 1)
    profile = np.column_stack([np.sin(polar), -np.cos(polar)]) * radius
    return np.asarray(revolve(profile, around) + np.asarray(center))


def tube(points: FloatArray, radius: float, around: int = 16) -> FloatArray:
    """Faces of a round bar along a polyline (k, 3), with round joints and ends."""
    parts = [sphere(point, radius, around) for point in points]
    for start, end in pairwise(points):
        length = float(np.linalg.norm(end - start))
        if length > 1e-9:
            profile = np.array([[radius, 0.0], [radius, length]])
            parts.append(revolve(profile, around) @ frame_along((end - start) / length).T + start)
    return np.concatenate(parts)


def _local_faces(shape: Shape, cut: float) -> FloatArray:
    match shape:
        case shapes.Sphere(radius=radius):
            return sphere(np.zeros(3), radius, 28)
        case shapes.Box(size=size):
            return box(np.asarray(size), cut)
        case shapes.Cylinder(radius=radius, length=length):
            steps = np.linspace(-0.5, 0.5, min(int(length / cut), _MOST_PIECES) + 2) * length
            wall = np.column_stack([np.full_like(steps, radius), steps])
            ends = np.array([[0.0, 0.5 * length]])
            return revolve(np.concatenate([-ends, wall, ends]), 24)
        case shapes.Capsule(radius=radius, length=length):
            half = np.array([0.0, 0.0, 0.5 * length])
            return tube(np.stack([-half, half]), radius, 24)
        case shapes.Ellipsoid(radii=radii):
            return np.asarray(sphere(np.zeros(3), 1.0, 28) * np.array(radii))
        case shapes.Cone(radius=radius, tip=tip, length=length):
            slope = np.arcsin((tip - radius) / length)
            low, high = np.linspace(-0.5 * np.pi, slope, 8), np.linspace(slope, 0.5 * np.pi, 8)
            arcs = [
                np.column_stack([r * np.cos(a), r * np.sin(a) + z])
                for r, a, z in ((tip, low, -0.5 * length), (radius, high, 0.5 * length))
            ]
            return revolve(np.concatenate(arcs), 28)
        case shapes.HalfSpace():
            return _grid(2.0, 2.0, cut)
        case shapes.MeshShape(vertices=vertices, faces=faces):
            corners = np.asarray(vertices)[np.asarray(faces)]
            return np.concatenate([corners, corners[:, 2:]], axis=1)
        case shapes.PointCloudShape(points=points, radius=radius):
            shown = np.asarray(points)[:: max(1, len(points) // _MOST_POINTS)]
            return np.concatenate([sphere(point, max(radius, 0.003), 6) for point in shown])


def revolve(profile: FloatArray, around: int) -> FloatArray:
    """Turn a profile of (radius, height) pairs, bottom to top, about z."""
    angle = np.linspace(0.0, 2.0 * np.pi, around + 1)
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    points = np.empty((len(profile), around + 1, 3))
    points[..., :2] = profile[:, None, :1] * ring
    points[..., 2] = profile[:, 1:]
    lower, upper = points[:-1], points[1:]
    faces = np.stack([lower[:, :-1], lower[:, 1:], upper[:, 1:], upper[:, :-1]], axis=2)
    return faces.reshape(-1, 4, 3)


def _grid(width: float, depth: float, cut: float) -> FloatArray:
    """A rectangle in the plane z = 0, facing +z, cut into small faces."""
    across, along = (
        np.linspace(-0.5, 0.5, min(max(int(np.ceil(edge / cut)), 1), _MOST_PIECES) + 1) * edge
        for edge in (width, depth)
    )
    x, y = np.meshgrid(across, along, indexing="ij")
    points = np.stack([x, y, np.zeros_like(x)], axis=-1)
    corners = (points[:-1, :-1], points[1:, :-1], points[1:, 1:], points[:-1, 1:])
    return np.stack(corners, axis=2).reshape(-1, 4, 3)


def box(size: FloatArray, cut: float = np.inf) -> FloatArray:
    """Faces of a box with full edges ``size`` (3,), each no larger than ``cut`` [m]."""
    parts = []
    for axis in range(3):
        first, second = (axis + 1) % 3, (axis + 2) % 3
        face = _grid(size[first], size[second], cut)
        placed = np.empty_like(face)
        placed[..., first], placed[..., second] = face[..., 0], face[..., 1]
        placed[..., axis] = 0.5 * size[axis]
        parts += [placed, -placed]
    return np.concatenate([part if i % 2 == 0 else part[:, ::-1] for i, part in enumerate(parts)])


def triangles(faces: FloatArray) -> tuple[FloatArray, IntArray]:
    """Vertices (V, 3) and rows of them (M, 3) of faces (F, 4, 3), or of triangles (M, 3, 3).

    Corners at one place are one vertex where the surface is round, so that a viewer that averages
    normals shades it smoothly, and several vertices at an edge of more than :data:`_CREASE`.
    Triangles of no area go.
    """
    corners = faces
    if faces.shape[1] == 4:
        corners = np.concatenate([faces[:, [0, 1, 2]], faces[:, [0, 2, 3]]])
    place = np.round(corners, _DIGITS) + 0.0
    normal = np.cross(place[:, 1] - place[:, 0], place[:, 2] - place[:, 0])
    area = np.linalg.norm(normal, axis=1)
    place, normal = place[area > 0.0], normal[area > 0.0]
    if not len(place):
        return np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64)
    _, at = _alike(place.reshape(-1, 3))
    unit = np.repeat(normal / np.linalg.norm(normal, axis=1)[:, None], 3, axis=0)
    count = np.bincount(at)
    order = np.argsort(at, kind="stable")  # corners by place; each meets all others of its place
    one = np.repeat(order, count[at[order]])
    start = np.repeat((np.cumsum(count) - count)[at[order]], count[at[order]])
    step = np.arange(len(one)) - np.repeat(np.cumsum(count[at[order]]) - count[at[order]],
                                           count[at[order]])  # fmt: skip
    other = order[start + step]
    alike = np.einsum("ci,ci->c", unit[one], unit[other]) > _CREASE
    mean = np.zeros_like(unit)
    np.add.at(mean, one[alike], np.repeat(normal, 3, axis=0)[other[alike]])
    mean /= np.linalg.norm(mean, axis=1)[:, None]
    keys = np.column_stack([at, np.round(mean, 2)]) + 0.0
    first, index = _alike(keys)
    return place.reshape(-1, 3)[first], index.reshape(-1, 3).astype(np.int64)


def coarser(corners: FloatArray, cell: float) -> FloatArray:
    """Triangles (M, 3, 3) with corners moved to the mean of their cell of a grid; fewer of them."""
    points = corners.reshape(-1, 3)
    _, cells = _alike(np.floor(points / cell))
    count = np.bincount(cells)
    mean = np.stack([np.bincount(cells, column) for column in points.T], axis=1) / count[:, None]
    a, b, c = (index := cells.reshape(-1, 3)).T
    kept = np.sort(index[(a != b) & (b != c) & (c != a)], axis=1)
    first, _ = _alike(kept)
    return np.asarray(mean[index[(a != b) & (b != c) & (c != a)][np.sort(first)]])


def _alike(rows: FloatArray | IntArray) -> tuple[IntArray, IntArray]:
    """The first of each kind of row (k, d), and the kind (k,) of each, faster than np.unique's."""
    order = np.lexsort(rows.T)
    new = np.ones(len(rows), dtype=np.bool_)
    new[1:] = (np.diff(rows[order], axis=0) != 0).any(axis=1)
    kind = np.empty(len(rows), dtype=np.int64)
    kind[order] = np.cumsum(new) - 1
    return order[new], kind
