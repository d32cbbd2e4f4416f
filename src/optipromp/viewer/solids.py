"""Objects of a scene as shaded faces, for a picture.

A solid is an array of quadrilaterals (F, 4, 3) in the world frame [m], corners anticlockwise seen
from outside; a triangle repeats its last corner.
"""

from itertools import pairwise

import numpy as np

from optipromp.arrays import FloatArray
from optipromp.geometry.shapes import (
    Box,
    Capsule,
    Cylinder,
    HalfSpace,
    MeshShape,
    PointCloudShape,
    Shape,
    Sphere,
)

_LARGEST_FACE = 0.04  # [m] big flat faces are cut so that sorting by depth works
_MOST_POINTS = 1500  # of a point cloud that are drawn


def shape_faces(shape: Shape, position: FloatArray, rotation: FloatArray) -> FloatArray:
    """Faces (F, 4, 3) of a shape placed in the world.

    Args:
        shape: the shape in its local frame.
        position: (3,) [m].
        rotation: (3, 3), world from local.
    """
    return np.asarray(_local_faces(shape) @ np.asarray(rotation).T + np.asarray(position))


def sphere(center: FloatArray, radius: float, around: int = 20) -> FloatArray:
    """Faces of a sphere."""
    polar = np.linspace(0.0, np.pi, around // 2 + 1)
    profile = np.column_stack([np.sin(polar), -np.cos(polar)]) * radius
    return np.asarray(_revolve(profile, around) + np.asarray(center))


def tube(points: FloatArray, radius: float, around: int = 16) -> FloatArray:
    """Faces of a round bar along a polyline (k, 3), with round joints and ends."""
    parts = [sphere(point, radius, around) for point in points]
    for start, end in pairwise(points):
        length = float(np.linalg.norm(end - start))
        if length > 1e-9:
            profile = np.array([[radius, 0.0], [radius, length]])
            parts.append(_revolve(profile, around) @ frame_along((end - start) / length).T + start)
    return np.concatenate(parts)


def frame_along(axis: FloatArray) -> FloatArray:
    """A rotation (3, 3) whose third column is the unit vector ``axis``."""
    helper = np.eye(3)[int(np.argmin(np.abs(axis)))]
    x = np.cross(helper, axis)
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(axis, x), axis])


def _local_faces(shape: Shape) -> FloatArray:
    match shape:
        case Sphere(radius=radius):
            return sphere(np.zeros(3), radius, 28)
        case Box(size=size):
            return _box(np.asarray(size))
        case Cylinder(radius=radius, length=length):
            steps = np.linspace(-0.5, 0.5, max(2, int(length / _LARGEST_FACE) + 2)) * length
            wall = np.column_stack([np.full_like(steps, radius), steps])
            ends = np.array([[0.0, 0.5 * length]])
            return _revolve(np.concatenate([-ends, wall, ends]), 24)
        case Capsule(radius=radius, length=length):
            half = np.array([0.0, 0.0, 0.5 * length])
            return tube(np.stack([-half, half]), radius, 24)
        case HalfSpace():
            return _grid(2.0, 2.0)
        case MeshShape(vertices=vertices, faces=faces):
            corners = np.asarray(vertices)[np.asarray(faces)]
            return np.concatenate([corners, corners[:, 2:]], axis=1)
        case PointCloudShape(points=points, radius=radius):
            shown = np.asarray(points)[:: max(1, len(points) // _MOST_POINTS)]
            return np.concatenate([sphere(point, max(radius, 0.003), 6) for point in shown])


def _revolve(profile: FloatArray, around: int) -> FloatArray:
    """Turn a profile of (radius, height) pairs, bottom to top, about z."""
    angle = np.linspace(0.0, 2.0 * np.pi, around + 1)
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    points = np.empty((len(profile), around + 1, 3))
    points[..., :2] = profile[:, None, :1] * ring
    points[..., 2] = profile[:, 1:]
    lower, upper = points[:-1], points[1:]
    faces = np.stack([lower[:, :-1], lower[:, 1:], upper[:, 1:], upper[:, :-1]], axis=2)
    return faces.reshape(-1, 4, 3)


def _grid(width: float, depth: float) -> FloatArray:
    """A rectangle in the plane z = 0, facing +z, cut into small faces."""
    across = np.linspace(-0.5, 0.5, int(np.ceil(width / _LARGEST_FACE)) + 1) * width
    along = np.linspace(-0.5, 0.5, int(np.ceil(depth / _LARGEST_FACE)) + 1) * depth
    x, y = np.meshgrid(across, along, indexing="ij")
    points = np.stack([x, y, np.zeros_like(x)], axis=-1)
    corners = (points[:-1, :-1], points[1:, :-1], points[1:, 1:], points[:-1, 1:])
    return np.stack(corners, axis=2).reshape(-1, 4, 3)


def _box(size: FloatArray) -> FloatArray:
    parts = []
    for axis in range(3):
        first, second = (axis + 1) % 3, (axis + 2) % 3
        face = _grid(size[first], size[second])
        placed = np.empty_like(face)
        placed[..., first], placed[..., second] = face[..., 0], face[..., 1]
        placed[..., axis] = 0.5 * size[axis]
        parts += [placed, -placed]
    return np.concatenate([part if i % 2 == 0 else part[:, ::-1] for i, part in enumerate(parts)])
