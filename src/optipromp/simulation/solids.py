"""Shapes of a scene as MuJoCo geoms."""

from typing import Any

import numpy as np

from optipromp.arrays import FloatArray
from optipromp.errors import InvalidSceneError
from optipromp.geometry.shapes import (
    Box,
    Capsule,
    Cone,
    Cylinder,
    Ellipsoid,
    HalfSpace,
    MeshShape,
    PointCloudShape,
    Shape,
    Sphere,
    is_convex,
    mesh_volume,
    round_mesh,
)
from optipromp.robots.tool_protocol import quaternion

CONE_POINTS = 48  # points about a cone that is simulated as a mesh; within 0.2 % of its radius
MOST_PARTS = 3000  # geoms of one mesh or point cloud


def volume(shape: Shape) -> float:
    """[m³]; of a mesh by its signed volume, of a point cloud its bounding box's."""
    match shape:
        case Sphere(radius):
            return 4.0 / 3.0 * np.pi * radius**3
        case Box(size):
            return float(np.prod(size))
        case Cylinder(radius, length):
            return np.pi * radius**2 * length
        case Capsule(radius, length):
            return np.pi * radius**2 * length + 4.0 / 3.0 * np.pi * radius**3
        case Ellipsoid(radii):
            return float(4.0 / 3.0 * np.pi * np.prod(radii))
        case Cone():
            return mesh_volume(round_mesh(shape, CONE_POINTS))
        case MeshShape():
            return mesh_volume(shape)
        case PointCloudShape():
            return float(np.prod(np.ptp(shape.points, axis=0) + 2.0 * shape.radius))
        case HalfSpace():
            return float("inf")
    raise InvalidSceneError(f"unknown shape {type(shape).__name__}")


def add_shape(
    spec: Any, body: Any, shape: Shape, name: str, rotation: FloatArray, position: FloatArray,
    **properties: Any,
) -> list[Any]:  # fmt: skip
    """Add ``shape`` to ``body`` at a pose in the body's frame; returns the geoms.

    ``properties`` are set on every geom. Meshes that are nearly convex become their hull; others,
    and point clouds, become boxes and balls that fill them at the resolution of their distance
    grid.
    """
    import mujoco

    kinds = mujoco.mjtGeom
    pose = {"pos": position, "quat": quaternion(rotation)}

    def add(kind: Any, size: list[float], **further: Any) -> Any:
        return body.add_geom(
            type=kind,
            size=size,
            **{"name": name, **pose, **properties, **further},
        )

    match shape:
        case Sphere(radius):
            return [add(kinds.mjGEOM_SPHERE, [radius, 0.0, 0.0])]
        case Box(size):
            return [add(kinds.mjGEOM_BOX, [edge / 2.0 for edge in size])]
        case Cylinder(radius, length):
            return [add(kinds.mjGEOM_CYLINDER, [radius, length / 2.0, 0.0])]
        case Capsule(radius, length):
            return [add(kinds.mjGEOM_CAPSULE, [radius, length / 2.0, 0.0])]
        case Ellipsoid(radii):
            return [add(kinds.mjGEOM_ELLIPSOID, list(radii))]
        case Cone():
            whole = round_mesh(shape, CONE_POINTS)
            return add_shape(spec, body, whole, name, rotation, position, **properties)
        case HalfSpace():
            return [add(kinds.mjGEOM_PLANE, [2.0, 2.0, 0.1])]
        case MeshShape() if is_convex(shape):
            spec.add_mesh(
                name=f"mesh:{name}",
                uservert=shape.vertices.ravel().tolist(),
                userface=shape.faces.ravel().astype(np.int32).tolist(),
            )
            return [add(kinds.mjGEOM_MESH, [0.0, 0.0, 0.0], meshname=f"mesh:{name}")]
        case MeshShape():
            out = []
            for i, (middle, half) in enumerate(_filling(shape)):
                at = position + rotation @ middle
                out.append(add(kinds.mjGEOM_BOX, list(half), name=f"{name}:{i}", pos=at))
            return out
        case PointCloudShape():
            points, radius = _thinned(shape)
            out = []
            for i, point in enumerate(points):
                at = position + rotation @ point
                ball = [radius, 0.0, 0.0]
                out.append(add(kinds.mjGEOM_SPHERE, ball, name=f"{name}:{i}", pos=at))
            return out
    raise InvalidSceneError(f"unknown shape {type(shape).__name__}")


def _filling(shape: MeshShape) -> list[tuple[FloatArray, FloatArray]]:
    """Boxes (middle, half sizes) that fill a mesh: runs of cells of its distance grid."""
    from optipromp.geometry.grids import distance_grid

    grid = distance_grid(shape)
    inside = grid.values <= 0.0
    pitch, origin = float(grid.spacing), np.asarray(grid.origin)
    boxes: list[tuple[FloatArray, FloatArray]] = []
    for i, j in np.argwhere(inside.any(axis=2)):
        edges = np.flatnonzero(np.diff(np.concatenate([[0], inside[i, j].view(np.int8), [0]])))
        for low, high in edges.reshape(-1, 2):
            middle = origin + pitch * np.array([i, j, 0.5 * (low + high - 1)])
            boxes.append((middle, 0.5 * pitch * np.array([1.0, 1.0, high - low])))
    if not boxes or len(boxes) > MOST_PARTS:
        name = shape.path or "mesh"
        raise InvalidSceneError(
            f"{name}: {len(boxes)} boxes fill it; the simulation takes 1 to {MOST_PARTS} "
            "(thinner than the cells of its distance grid, or too large)"
        )
    return boxes


def _thinned(shape: PointCloudShape) -> tuple[FloatArray, float]:
    """At most :data:`MOST_PARTS` points that stand for all, and the radius that covers them."""
    points, pitch = shape.points, shape.radius / 2.0
    radius = shape.radius
    while len(points) > MOST_PARTS:
        _, first = np.unique(np.floor(shape.points / pitch), axis=0, return_index=True)
        points = shape.points[np.sort(first)]
        radius = shape.radius + pitch * np.sqrt(3.0) / 2.0
        pitch *= 1.3
    return points, radius
