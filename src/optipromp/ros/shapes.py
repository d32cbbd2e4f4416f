"""Shapes as the primitives, meshes and planes of a ``moveit_msgs/CollisionObject``, and back."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from optipromp.core.arrays import FloatArray
from optipromp.core.errors import InvalidSceneError
from optipromp.core.geometry.grids import check_closed
from optipromp.core.geometry.shapes import (
    Box,
    Capsule,
    Cylinder,
    HalfSpace,
    MeshShape,
    PointCloudShape,
    Shape,
    Sphere,
)
from optipromp.core.scenes.pose import Pose
from optipromp.core.scenes.rotations import IDENTITY
from optipromp.ros.types import Message, message

Placed = tuple[Shape, Pose]
"""A shape and its pose in the frame of its object."""

_BOX, _SPHERE, _CYLINDER = 1, 2, 3  # types of shape_msgs/SolidPrimitive
_SIZES = {_BOX: 3, _SPHERE: 1, _CYLINDER: 2}
_REFUSED = {4: "a cone", 5: "a prism"}
_SAME = 1e-6  # [m] two spheres and a cylinder that differ from a capsule by less are a capsule


def pose_message(pose: Pose) -> Message:
    """``geometry_msgs/Pose`` of a pose."""
    w, x, y, z = pose.orientation
    return message(
        "geometry_msgs/msg/Pose",
        position=xyz("geometry_msgs/msg/Point", pose.position),
        orientation=message("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w),
    )


def xyz(name: str, vector: FloatArray) -> Message:
    """A message with fields x, y and z of a vector (3,)."""
    return message(name, x=vector[0], y=vector[1], z=vector[2])


def vector(item: Message) -> FloatArray:
    """(3,) of a message with fields x, y and z."""
    return np.array([item.x, item.y, item.z])


def quaternion(item: Message) -> FloatArray:
    """(4,) w, x, y, z of a ``geometry_msgs/Quaternion``; as in MoveIt, zeros do not turn."""
    wxyz = np.array([item.w, item.x, item.y, item.z])
    return wxyz if wxyz.any() else IDENTITY


def read_pose(item: Message) -> Pose:
    """The pose of a ``geometry_msgs/Pose``."""
    return Pose(vector(item.position), quaternion(item.orientation))


def geometry(shape: Shape) -> dict[str, Any]:
    """The fields of a ``CollisionObject`` that state a shape in the object's frame.

    A capsule becomes a cylinder and two spheres, a point cloud one sphere for each point. A shape
    without a primitive of MoveIt (an ellipsoid, a cone) becomes its mesh.
    """
    here = np.zeros(3)
    solids: list[tuple[int, Sequence[float], FloatArray]]
    match shape:
        case HalfSpace():
            plane = message("shape_msgs/msg/Plane", coef=(0.0, 0.0, 1.0, 0.0))
            return {"planes": [plane], "plane_poses": [pose_message(Pose())]}
        case Sphere(radius):
            solids = [(_SPHERE, (radius,), here)]
        case Box(size):
            solids = [(_BOX, size, here)]
        case Cylinder(radius, length):
            solids = [(_CYLINDER, (length, radius), here)]
        case Capsule(radius, length):
            end = np.array([0.0, 0.0, 0.5 * length])
            solids = [(_CYLINDER, (length, radius), here)]
            solids += [(_SPHERE, (radius,), end), (_SPHERE, (radius,), -end)]
        case PointCloudShape():
            solids = [(_SPHERE, (shape.radius,), point) for point in shape.points]
        case _:
            return {"meshes": [_mesh(shape.mesh())], "mesh_poses": [pose_message(Pose())]}
    return {
        "primitives": [
            message("shape_msgs/msg/SolidPrimitive", type=kind, dimensions=sizes)
            for kind, sizes, _ in solids
        ],
        "primitive_poses": [pose_message(Pose(place)) for _, _, place in solids],
    }


def read_geometry(item: Message) -> list[Placed]:
    """The shapes of a ``CollisionObject`` in its frame; the inverse of :func:`geometry`."""
    solids = _placed(item.primitives, item.primitive_poses, "primitive")
    parts: list[Placed] = [(_solid(solid, k), where) for k, (solid, where) in enumerate(solids)]
    united = _capsule(parts) or _cloud(parts)
    parts = [united] if united else parts
    for mesh, where in _placed(item.meshes, item.mesh_poses, "mesh"):
        parts.append((_read_mesh(mesh), where))
    for plane, where in _placed(item.planes, item.plane_poses, "plane"):
        parts.append((HalfSpace(), where @ _half_space(plane)))
    if not parts:
        raise InvalidSceneError("it has no shape: must have a primitive, a mesh or a plane")
    return parts


def _placed(
    shapes: Sequence[Message], poses: Sequence[Message], what: str
) -> list[tuple[Message, Pose]]:
    """Each shape with its pose in the object's frame; a missing pose is the identity."""
    if len(poses) > len(shapes):
        raise InvalidSceneError(
            f"{len(poses)} {what}_poses for {len(shapes)} shapes: must be one for each"
        )
    given = [read_pose(where) for where in poses]
    given += [Pose()] * (len(shapes) - len(poses))
    return list(zip(shapes, given, strict=True))


def _solid(item: Message, index: int) -> Shape:
    where = f"primitives[{index}]"
    if item.type not in _SIZES:
        kind = _REFUSED.get(item.type, f"of type {item.type}")
        raise InvalidSceneError(f"{where} is {kind}: must be a box (1), sphere (2) or cylinder (3)")
    sizes = [float(size) for size in item.dimensions]
    if len(sizes) != _SIZES[item.type]:
        raise InvalidSceneError(
            f"{where}.dimensions has {len(sizes)} entries: must have {_SIZES[item.type]}"
        )
    match item.type:
        case 1:
            return Box((sizes[0], sizes[1], sizes[2]))
        case 2:
            return Sphere(sizes[0])
    return Cylinder(sizes[1], sizes[0])


def _capsule(parts: Sequence[Placed]) -> Placed | None:
    """The capsule of a cylinder and two spheres; None where the parts are not a capsule."""
    if [type(shape) for shape, _ in parts] != [Cylinder, Sphere, Sphere]:
        return None
    (rod, where), *balls = parts
    assert isinstance(rod, Cylinder)
    ends = [where.inverse() @ ball.position for _, ball in balls]
    height = 0.5 * rod.length * (1.0 if ends[0][2] > 0.0 else -1.0)
    off = [np.abs(end - (0.0, 0.0, s * height)).max() for s, end in zip((1, -1), ends, strict=True)]
    off += [abs(ball.radius - rod.radius) for ball, _ in balls if isinstance(ball, Sphere)]
    return None if max(off) > _SAME else (Capsule(rod.radius, rod.length), where)


def _cloud(parts: Sequence[Placed]) -> Placed | None:
    """The point cloud of several spheres of one radius; None where the parts are not such."""
    radii = {shape.radius for shape, _ in parts if isinstance(shape, Sphere)}
    if len(parts) < 2 or len(radii) != 1 or not all(isinstance(p[0], Sphere) for p in parts):
        return None
    points = np.array([where.position for _, where in parts])
    return PointCloudShape(points, radii.pop()), Pose()


def _mesh(shape: MeshShape) -> Message:
    return message(
        "shape_msgs/msg/Mesh",
        triangles=[
            message("shape_msgs/msg/MeshTriangle", vertex_indices=face) for face in shape.faces
        ],
        vertices=[xyz("geometry_msgs/msg/Point", vertex) for vertex in shape.vertices],
    )


def _read_mesh(item: Message) -> MeshShape:
    vertices = np.array([vector(vertex) for vertex in item.vertices]).reshape(-1, 3)
    faces = np.array([face.vertex_indices for face in item.triangles], dtype=np.int64)
    mesh = MeshShape(vertices, faces.reshape(-1, 3))
    check_closed(mesh)
    return mesh


def _half_space(plane: Message) -> Pose:
    """The frame of a half-space: at a point of the plane, z along its normal (a, b, c)."""
    normal, distance = np.array(plane.coef[:3], dtype=np.float64), float(plane.coef[3])
    length = math.hypot(*normal)
    if not (math.isfinite(length) and length > 0.0):
        raise InvalidSceneError(f"plane {list(plane.coef)} has no normal: must be a, b, c, d")
    z = normal / length
    other = np.eye(3)[int(np.abs(z).argmin())]
    x = np.cross(np.cross(z, other), z) if abs(z[2]) < 1.0 else np.array([1.0, 0.0, 0.0])
    x /= math.hypot(*x)
    return Pose(-distance / length * z, np.stack([x, np.cross(z, x), z], axis=1))
