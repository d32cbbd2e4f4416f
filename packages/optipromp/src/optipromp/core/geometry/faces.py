"""Faces of round and flat surfaces.

Faces are quadrilaterals (F, 4, 3) [m], corners anticlockwise seen from outside; a triangle repeats
its last corner.
"""

from itertools import pairwise

import numpy as np

from optipromp.core.arrays import FloatArray, frame_along

MOST_PIECES = 100  # of an edge: the faces of a floor of kilometres would fill the memory


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


def revolve(profile: FloatArray, around: int) -> FloatArray:
    """Faces of a profile (k, 2) of radius and height, bottom to top, revolved about z."""
    angle = np.linspace(0.0, 2.0 * np.pi, around + 1)
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    points = np.empty((len(profile), around + 1, 3))
    points[..., :2] = profile[:, None, :1] * ring
    points[..., 2] = profile[:, 1:]
    lower, upper = points[:-1], points[1:]
    faces = np.stack([lower[:, :-1], lower[:, 1:], upper[:, 1:], upper[:, :-1]], axis=2)
    return faces.reshape(-1, 4, 3)


def rectangle_faces(width: float, depth: float, cut: float = np.inf) -> FloatArray:
    """A rectangle in the plane z = 0, facing +z, in faces with edges up to ``cut`` [m]."""
    across, along = (
        np.linspace(-0.5, 0.5, min(max(int(np.ceil(edge / cut)), 1), MOST_PIECES) + 1) * edge
        for edge in (width, depth)
    )
    x, y = np.meshgrid(across, along, indexing="ij")
    points = np.stack([x, y, np.zeros_like(x)], axis=-1)
    corners = (points[:-1, :-1], points[1:, :-1], points[1:, 1:], points[:-1, 1:])
    return np.stack(corners, axis=2).reshape(-1, 4, 3)


def box(size: FloatArray, cut: float = np.inf) -> FloatArray:
    """Faces of a box with full edges ``size`` (3,) [m], in faces with edges up to ``cut`` [m]."""
    parts = []
    for axis in range(3):
        first, second = (axis + 1) % 3, (axis + 2) % 3
        face = rectangle_faces(size[first], size[second], cut)
        placed = np.empty_like(face)
        placed[..., first], placed[..., second] = face[..., 0], face[..., 1]
        placed[..., axis] = 0.5 * size[axis]
        parts += [placed, -placed]
    return np.concatenate([part if i % 2 == 0 else part[:, ::-1] for i, part in enumerate(parts)])
