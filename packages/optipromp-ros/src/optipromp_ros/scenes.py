"""Scenes as ``moveit_msgs/PlanningScene`` and ``moveit_msgs/CollisionObject``, and back.

The convention (see ``docs/ros.md``): the id of an object begins with its role (``target/ripe``,
``pushable/n1``, ``avoid/n2``; any other object is static). The points of a stem are the origins of
the subframes ``stem_0`` (at the fruit) to the root. The subframe ``approach`` of the target states
the approach: its z axis is the direction, its y axis the lateral. Quantities that MoveIt has no
field for are JSON in ``type.db``, where ``type.key`` is ``optipromp``.
"""

import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from optipromp.core.arrays import FloatArray, frame_along
from optipromp.core.errors import InvalidSceneError
from optipromp.core.geometry import shapes
from optipromp.core.geometry.grids import check_closed
from optipromp.core.planning.task import posed
from optipromp.core.robots.description import LinkGeometry
from optipromp.core.robots.model import Robot
from optipromp.core.scenes.pose import Pose
from optipromp.core.scenes.rotations import unit_quaternion
from optipromp.core.scenes.scene import ROLES, STEM_RADIUS, Approach, Role, Scene, SceneObject, Stem
from optipromp_ros.trajectories import robot_state
from optipromp_ros.types import Message, constants, message

Placed = tuple[shapes.Shape, Pose]  # A shape and its pose in the frame of its object

_BOX, _SPHERE, _CYLINDER = 1, 2, 3  # types of shape_msgs/SolidPrimitive
_SOLIDS: dict[int, tuple[int, Callable[..., shapes.Shape]]] = {  # number of sizes, and the shape
    _BOX: (3, lambda *sizes: shapes.Box(sizes)),
    _SPHERE: (1, shapes.Sphere),
    _CYLINDER: (2, lambda length, radius: shapes.Cylinder(radius, length)),
}
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


def read_quaternion(item: Message) -> FloatArray:
    """(4,) w, x, y, z of a ``geometry_msgs/Quaternion``.

    Raises:
        InvalidSceneError: it is no unit quaternion. Zeros are none: nobody said how it is turned.
    """
    return unit_quaternion(np.array([item.w, item.x, item.y, item.z]))


def read_pose(item: Message) -> Pose:
    """The pose of a ``geometry_msgs/Pose``."""
    return Pose(vector(item.position), read_quaternion(item.orientation))


def links_of(robot: Robot) -> dict[str, LinkGeometry]:
    """The links that a robot's joints place, by name."""
    return {link.link: link for link in robot.geometry if link.rigid}


def place_of(link: LinkGeometry) -> Pose:
    """The pose of a link on its segment."""
    return Pose(link.translation, link.rotation)


def root_of(robot: Robot) -> str:
    """The link whose frame is the base frame."""
    still = [link for link in links_of(robot).values() if link.segment < 0]
    here = (link.link for link in still if place_of(link).is_identity)
    return next(here, robot.link_names[0])


def geometry(shape: shapes.Shape) -> dict[str, Any]:
    """The fields of a ``CollisionObject`` that state a shape in the object's frame.

    A capsule becomes a cylinder and two spheres, a point cloud one sphere for each point. A shape
    without a primitive of MoveIt (an ellipsoid, a cone) becomes its mesh.
    """
    here = np.zeros(3)
    solids: list[tuple[int, Sequence[float], FloatArray]]
    match shape:
        case shapes.HalfSpace():
            plane = message("shape_msgs/msg/Plane", coef=(0.0, 0.0, 1.0, 0.0))
            return {"planes": [plane], "plane_poses": [pose_message(Pose())]}
        case shapes.Sphere(radius):
            solids = [(_SPHERE, (radius,), here)]
        case shapes.Box(size):
            solids = [(_BOX, size, here)]
        case shapes.Cylinder(radius, length):
            solids = [(_CYLINDER, (length, radius), here)]
        case shapes.Capsule(radius, length):
            end = np.array([0.0, 0.0, 0.5 * length])
            solids = [(_CYLINDER, (length, radius), here)]
            solids += [(_SPHERE, (radius,), end), (_SPHERE, (radius,), -end)]
        case shapes.PointCloudShape():
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
        parts.append((shapes.HalfSpace(), where @ _half_space(plane)))
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


def _solid(item: Message, index: int) -> shapes.Shape:
    where = f"primitives[{index}]"
    if item.type not in _SOLIDS:
        kind = _REFUSED.get(item.type, f"of type {item.type}")
        raise InvalidSceneError(f"{where} is {kind}: must be a box (1), sphere (2) or cylinder (3)")
    sizes, (count, shape) = [float(size) for size in item.dimensions], _SOLIDS[item.type]
    if len(sizes) != count:
        raise InvalidSceneError(f"{where}.dimensions has {len(sizes)} entries: must have {count}")
    return shape(*sizes)


def _capsule(parts: Sequence[Placed]) -> Placed | None:
    """The capsule of a cylinder and two spheres; None where the parts are not a capsule."""
    if [type(shape) for shape, _ in parts] != [shapes.Cylinder, shapes.Sphere, shapes.Sphere]:
        return None
    (rod, where), *balls = parts
    assert isinstance(rod, shapes.Cylinder)
    ends = [where.inverse() @ ball.position for _, ball in balls]
    height = 0.5 * rod.length * (1.0 if ends[0][2] > 0.0 else -1.0)
    off = [np.abs(end - (0.0, 0.0, s * height)).max() for s, end in zip((1, -1), ends, strict=True)]
    off += [abs(ball.radius - rod.radius) for ball, _ in balls if isinstance(ball, shapes.Sphere)]
    return None if max(off) > _SAME else (shapes.Capsule(rod.radius, rod.length), where)


def _cloud(parts: Sequence[Placed]) -> Placed | None:
    """The point cloud of several spheres of one radius; None where the parts are not such."""
    radii = {shape.radius for shape, _ in parts if isinstance(shape, shapes.Sphere)}
    if len(parts) < 2 or len(radii) != 1 or not all(isinstance(p[0], shapes.Sphere) for p in parts):
        return None
    points = np.array([where.position for _, where in parts])
    return shapes.PointCloudShape(points, radii.pop()), Pose()


def _mesh(shape: shapes.MeshShape) -> Message:
    return message(
        "shape_msgs/msg/Mesh",
        triangles=[
            message("shape_msgs/msg/MeshTriangle", vertex_indices=face) for face in shape.faces
        ],
        vertices=[xyz("geometry_msgs/msg/Point", vertex) for vertex in shape.vertices],
    )


def _read_mesh(item: Message) -> shapes.MeshShape:
    vertices = np.array([vector(vertex) for vertex in item.vertices]).reshape(-1, 3)
    faces = np.array([face.vertex_indices for face in item.triangles], dtype=np.int64)
    mesh = shapes.MeshShape(vertices, faces.reshape(-1, 3))
    check_closed(mesh)
    return mesh


def _half_space(plane: Message) -> Pose:
    """The frame of a half-space: at a point of the plane, z along its normal (a, b, c)."""
    normal, distance = np.array(plane.coef[:3], dtype=np.float64), float(plane.coef[3])
    length = math.hypot(*normal)
    if not (math.isfinite(length) and length > 0.0):
        raise InvalidSceneError(f"plane {list(plane.coef)} has no normal: must be a, b, c, d")
    z = normal / length
    return Pose(-distance / length * z, np.eye(3) if z[2] == 1.0 else frame_along(z))


KEY = "optipromp"
COLLISION_OBJECT = "moveit_msgs/msg/CollisionObject"
# colour of each role: red, green and blue from 0 to 1
COLORS: Mapping[Role, tuple[float, float, float]] = {
    "target": (0.85, 0.15, 0.15),
    "pushable": (0.35, 0.70, 0.25),
    "avoid": (0.95, 0.65, 0.15),
    "static": (0.60, 0.60, 0.60),
}


def object_id(item: SceneObject) -> str:
    """The id of an object in messages: its role, a slash and its id; of a static one, its id."""
    plain = item.role == "static" and item.id.partition("/")[0] not in ROLES
    return item.id if plain else f"{item.role}/{item.id}"


def collision_object(
    item: SceneObject, frame: str = "", approach: Approach | None = None
) -> Message:
    """A ``moveit_msgs/CollisionObject`` that adds an object.

    Args:
        item: any object; a mesh is written with its vertices, not with its file.
        frame: name of the robot's base frame, in which positions are stated.
        approach: of the scene, for its target.
    """
    here = Pose(item.position, item.orientation)
    points = () if item.stem is None else item.stem.points
    frames = {f"stem_{k}": Pose(point, item.orientation) for k, point in enumerate(points)}
    further: dict[str, Any] = {}
    if item.stem is not None and item.stem.radius != STEM_RADIUS:
        further["stem_radius"] = item.stem.radius
    if item.stem is not None and item.stem.parent is not None:
        further["stem_parent"] = item.stem.parent
    if item.covariance is not None:
        further["covariance"] = item.covariance.tolist()
    if item.physical:
        further["physical"] = dict(item.physical)
    if approach is not None:
        frames["approach"] = Pose(item.position, approach.frame.T)
        further["camera_distance"] = approach.camera_distance
    kind = {"key": KEY, "db": json.dumps(further)} if further else {}
    return message(
        COLLISION_OBJECT,
        header=message("std_msgs/msg/Header", frame_id=frame),
        pose=pose_message(here),
        id=object_id(item),
        type=message("object_recognition_msgs/msg/ObjectType", **kind),
        subframe_names=list(frames),
        subframe_poses=[pose_message(here.inverse() @ place) for place in frames.values()],
        operation=constants(COLLISION_OBJECT)["ADD"],
        **geometry(item.shape),
    )


def read_collision_object(item: Message) -> tuple[SceneObject, ...]:
    """The objects that a ``moveit_msgs/CollisionObject`` adds.

    A message adds one object, but a static object or one to avoid may have several shapes: each
    shape is then an object ``id[0]``, ``id[1]``, ... As in MoveIt, where the pose of the object is
    left out, the pose of its only shape takes its place.

    Raises:
        InvalidSceneError: a wrong value; the message names object, field and valid values.
    """
    try:
        return read_held(item).items
    except InvalidSceneError as error:
        raise InvalidSceneError(f"collision object {item.id!r}: {error.message}") from None


@dataclass(frozen=True, eq=False)
class Held:
    """The objects of one message, and the pose that moves all of them."""

    pose: Pose  # of the message's object
    items: tuple[SceneObject, ...]  # an object for each of its shapes
    approach: Approach | None = None  # to the object, where the message states one

    def transformed(self, pose: Pose) -> "Held":
        """The same objects in another frame, in which their present frame has the ``pose``."""
        items = tuple(item.transformed(pose) for item in self.items)
        approach = self.approach and self.approach.transformed(pose)
        return Held(pose @ self.pose, items, approach)

    def at(self, pose: Pose) -> "Held":
        """The objects and their stems moved to another pose; the approach stays."""
        return replace(self.transformed(pose @ self.pose.inverse()), approach=self.approach)


def read_held(item: Message) -> Held:
    """As :func:`read_collision_object`, with the pose of the message and the approach.

    Raises:
        InvalidSceneError: a wrong value; the message names field and valid values.
    """
    role: Role = next((each for each in ROLES if item.id.startswith(f"{each}/")), "static")
    name = item.id.removeprefix(f"{role}/")
    here = read_pose(item.pose)
    parts = read_geometry(item)
    if len(parts) == 1 and here.is_identity:
        shape, here = parts[0]
        parts = [(shape, Pose())]
    frames = _frames(item)
    points = [here @ frames[f"stem_{k}"].position for k in range(_count(frames))]
    further = _further(item)
    if len(parts) > 1 and (role in ("target", "pushable") or points):
        raise InvalidSceneError(
            f"it has {len(parts)} shapes: a {role} {'with a stem ' if points else ''}must have one "
            "(one mesh, or one object for each shape)"
        )
    stem = None
    if points:
        radius = further.get("stem_radius", STEM_RADIUS)
        stem = Stem(np.array(points), radius, further.get("stem_parent"))
    placed = [(shape, here @ local) for shape, local in parts]
    items = tuple(
        SceneObject(
            name if len(parts) == 1 else f"{name}[{k}]", role, shape, where.position,
            where.orientation, stem, further.get("covariance"), further.get("physical", {}),
        )
        for k, (shape, where) in enumerate(placed)
    )  # fmt: skip
    approach = None
    if role == "target" and "approach" in frames:
        axes = (here @ frames["approach"]).rotation
        distance = further.get("camera_distance", Approach().camera_distance)
        approach = Approach(axes[:, 2], axes[:, 1], distance)
    return Held(here, items, approach)


def _frames(item: Message) -> dict[str, Pose]:
    """Poses of the subframes by name, in the object's frame."""
    names, poses = item.subframe_names, item.subframe_poses
    if len(names) != len(poses):
        raise InvalidSceneError(
            f"{len(poses)} subframe_poses for {len(names)} subframe_names: must be as many"
        )
    return {name: read_pose(where) for name, where in zip(names, poses, strict=True)}


def _count(frames: Mapping[str, object]) -> int:
    """Number of points of the stem."""
    given = {name for name in frames if name.startswith("stem_")}
    wanted = {f"stem_{k}" for k in range(len(given))}
    if given != wanted or len(given) == 1:
        raise InvalidSceneError(
            f"subframes {', '.join(sorted(given))}: a stem must have stem_0 at the fruit, stem_1 "
            "and so on to the root"
        )
    return len(given)


# the quantities in ``type.db``, each with the function that makes it from JSON
_FURTHER: Mapping[str, Callable[[Any], Any]] = {
    "stem_radius": float,
    "stem_parent": str,
    "covariance": lambda rows: np.array(rows, dtype=np.float64),
    "physical": lambda given: {str(name): float(number) for name, number in given.items()},
    "camera_distance": float,
}


def _no_number(name: str) -> None:
    raise ValueError(f"{name} is no finite number")


def _further(item: Message) -> dict[str, Any]:
    """The quantities in ``type.db``; none where ``type.key`` is not :data:`KEY`."""
    if item.type.key != KEY:
        return {}
    try:
        found = json.loads(item.type.db, parse_constant=_no_number)
        return {name: _FURTHER[name](value) for name, value in found.items()}
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
        raise InvalidSceneError(
            f"type.db is {item.type.db[:80]!r}: must be JSON with stem_radius (number), "
            "stem_parent (text), covariance (3 rows of 3), physical (numbers by name) or "
            f"camera_distance (number) ({error})"
        ) from None


def planning_scene(scene: Scene, prefix: str = "") -> Message:
    """A ``moveit_msgs/PlanningScene`` of a scene: its objects with colours, and its start.

    The message cannot hold the tool, options, or a goal without a target.

    Args:
        scene: any scene.
        prefix: of joint and link names in ROS (``fr3_``).

    Raises:
        InvalidRobotError: the scene's robot cannot be loaded.
    """
    robot, state = posed(scene)
    frame = prefix + root_of(robot)
    adding, colors = [], []
    for item in scene.objects:
        approach = scene.approach if item.role == "target" else None
        adding.append(collision_object(item, frame, approach))
        r, g, b = COLORS[item.role]
        colour = message("std_msgs/msg/ColorRGBA", r=r, g=g, b=b, a=1.0)
        colors.append(message("moveit_msgs/msg/ObjectColor", id=object_id(item), color=colour))
    return message(
        "moveit_msgs/msg/PlanningScene",
        name=scene.name,
        robot_state=robot_state(state, robot.joint_names, prefix, frame),
        robot_model_name=robot.name,
        object_colors=colors,
        world=message("moveit_msgs/msg/PlanningSceneWorld", collision_objects=adding),
    )
