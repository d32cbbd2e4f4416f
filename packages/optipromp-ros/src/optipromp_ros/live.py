"""A scene that messages change; of a ``moveit_msgs/PlanningScene``; goals of ``Constraints``."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any, cast, get_args

import numpy as np

from optipromp.core.arrays import FloatArray
from optipromp.core.errors import InvalidRequestError, InvalidSceneError
from optipromp.core.geometry.shapes import Ellipsoid, Shape, Sphere
from optipromp.core.parameters import Checked, parameter
from optipromp.core.planning.task import posed
from optipromp.core.robots.library import UNTRUSTED, load_arm
from optipromp.core.robots.model import Robot
from optipromp.core.scenes.look import Look
from optipromp.core.scenes.objects import Role, SceneObject, Stem
from optipromp.core.scenes.pose import Pose
from optipromp.core.scenes.rotations import to_quaternion
from optipromp.core.scenes.scene import Goal, JointGoal, PoseGoal, RegionGoal, Scene
from optipromp.core.trajectory import joint_columns
from optipromp_ros.scenes import Held, object_id, read_held, read_pose, read_quaternion, vector
from optipromp_ros.trajectories import NANO, joint_positions, nanoseconds
from optipromp_ros.types import Message, constants

WORLD = "world"  # Name of the frame in which the scene's ``base`` is the pose of the robot's base


def read_planning_scene(item: Message, like: Scene | None = None, prefix: str = "") -> Scene:
    """The scene of a ``moveit_msgs/PlanningScene``.

    Args:
        item: a whole scene; or a difference, which changes the objects of ``like``.
        like: the robot, tool and options, and what the message lacks (start, approach, goal). None:
            the robot is ``robot_model_name`` with its own tool.
        prefix: of joint and link names in ROS.

    Raises:
        InvalidSceneError: a wrong value; the message names object, field and valid values.
        InvalidRequestError: joints that are not the robot's.
        InvalidRobotError: the robot cannot be loaded.
    """
    if like is not None:
        return LiveScene.of(like, prefix).heard(item).scene()
    robot = load_arm(item.robot_model_name, choice=UNTRUSTED)[0]
    stated = {
        "name": item.name or "planning scene",
        "robot": item.robot_model_name,
        "choice": UNTRUSTED,
    }
    return LiveScene(stated, robot, frames_of(robot, prefix)).heard(item).scene()


def frames_of(robot: Robot, prefix: str = "", base: Pose | None = None) -> dict[str, Pose]:
    """The frames of messages by name: their poses in the base frame.

    The base frame has the name of the robot's first link after the ``prefix``, and the empty name.
    ``world`` is the frame in which the base has the pose ``base`` (None: the base frame).
    """
    world = Pose() if base is None else base.inverse()
    return {"": Pose(), prefix + robot.link_names[0]: Pose(), WORLD: world}


@dataclass(frozen=True, eq=False)
class LiveScene:
    """A scene as the messages so far state it; every message gives a new one.

    Attributes:
        stated: fields of the :class:`optipromp.core.scenes.Scene`, except its objects.
        robot: with its tool.
        frames: the frames of messages by name: their poses in the base frame.
        held: the objects of each message by its id, oldest first.
    """

    stated: Mapping[str, Any]
    robot: Robot
    frames: Mapping[str, Pose]
    held: Mapping[str, Held] = field(default_factory=dict)

    @classmethod
    def of(cls, scene: Scene, prefix: str = "") -> "LiveScene":
        """The world of a scene; ``prefix`` is that of joint and link names in ROS."""
        robot = posed(scene)[0]
        held = {object_id(o): Held(Pose(o.position, o.orientation), (o,)) for o in scene.objects}
        return cls(vars(scene), robot, frames_of(robot, prefix, scene.base), held)

    @property
    def joints(self) -> tuple[str, ...]:
        """The robot's joints, n names."""
        return self.robot.joint_names

    def scene(self, goal: Goal | None = None) -> Scene:
        """The scene.

        Args:
            goal: in place of the target, which then becomes an object to avoid.

        Raises:
            InvalidSceneError: no target and no goal, two targets, an id that two roles have.
        """
        objects = tuple(item for held in self.held.values() for item in held.items)
        names = {item.name for item in fields(Scene)} - {"objects"}
        known = {name: self.stated[name] for name in names & self.stated.keys()}
        if goal is not None:
            known |= {"goal": goal, "waypoints": None}
            objects = tuple(
                replace(item, role="avoid") if item.role == "target" else item for item in objects
            )
        elif any(item.role == "target" for item in objects):
            known |= {"goal": None, "waypoints": None}
        return Scene(objects=objects, **known)

    def heard(self, item: Message) -> "LiveScene":
        """The world after a ``PlanningScene``, a ``CollisionObject`` or a ``JointState``.

        Raises:
            InvalidSceneError: a wrong value; the message names object and field.
            InvalidRequestError: joints that are not the robot's; another type of message.
        """
        match item.__msgtype__.rpartition("/")[2]:
            case "PlanningScene":
                return self._heard_scene(item)
            case "CollisionObject":
                return self._heard_object(item)
            case "JointState":
                return self.at(joint_positions(item, self.joints, "joint_state"))
        raise InvalidRequestError(
            f"a {item.__msgtype__} says nothing of a scene: must be a PlanningScene, a "
            "CollisionObject or a JointState"
        )

    def at(self, start: FloatArray) -> "LiveScene":
        """The world with the robot at ``start`` (n,)."""
        return replace(self, stated={**self.stated, "start": start})

    def _heard_scene(self, item: Message) -> "LiveScene":
        _refuse_unread(item)
        world = self if item.is_diff else replace(self, held={})
        for part in item.world.collision_objects:
            world = world._heard_object(part)
        state = item.robot_state.joint_state
        if state.name:
            q = joint_positions(state, self.joints, "robot_state.joint_state")
            world = world.at(q)
        if item.name:
            world = replace(world, stated={**world.stated, "name": item.name})
        return world

    def _heard_object(self, item: Message) -> "LiveScene":
        what = f"collision object {item.id!r}"
        try:
            frame = in_base(item.header, self.frames)
        except InvalidRequestError as error:
            raise InvalidSceneError(f"{what}: {error.message}") from None
        kinds = constants(item.__msgtype__)
        operation = item.operation
        held, stated = dict(self.held), dict(self.stated)
        if operation in (kinds["REMOVE"], kinds["MOVE"]) and item.id and item.id not in held:
            raise InvalidSceneError(f"{what} is not there: must be added first")
        if operation == kinds["REMOVE"]:
            held = {name: old for name, old in held.items() if item.id and name != item.id}
        elif operation == kinds["MOVE"]:
            held[item.id] = held[item.id].at(frame @ read_pose(item.pose))
        elif operation == kinds["ADD"]:
            held[item.id] = read_held(item).transformed(frame)
            if held[item.id].approach is not None:
                stated["approach"] = held[item.id].approach
        else:
            raise InvalidSceneError(
                f"{what}: operation is {operation}: must be ADD (0), REMOVE (1) or MOVE (3)"
            )
        return replace(self, held=held, stated=stated)


def in_base(header: Message, frames: Mapping[str, Pose]) -> Pose:
    """The pose in the base frame of the frame that a header names."""
    if header.frame_id in frames:
        return frames[header.frame_id]
    raise InvalidRequestError(
        f"header.frame_id is {header.frame_id!r}: must be {' or '.join(map(repr, frames))}"
    )


def _refuse_unread(item: Message) -> None:
    """Refuse a planning scene with obstacles in a form that is not supported."""
    attached = item.robot_state.attached_collision_objects
    if attached:
        raise InvalidSceneError(
            f"robot_state.attached_collision_objects[0] is {attached[0].object.id!r}: must be "
            "none; what the robot holds is its tool"
        )
    size = len(item.world.octomap.octomap.data)
    if size:
        raise InvalidSceneError(
            f"world.octomap holds {size} bytes: must be empty; give collision objects"
        )
    for what, links, usual in (
        ("padding", item.link_padding, 0.0),
        ("scale", item.link_scale, 1.0),
    ):
        for link in links:
            if (value := getattr(link, what)) != usual:
                raise InvalidSceneError(
                    f"link_{what} of {link.link_name!r} is {value:g}: must be {usual:g}; "
                    "the options of a plan have its clearances"
                )


TOOL = "tool"
"""Name of the frame at the tool point: z along the tool axis, y along the opening of fingers."""


def read_goal(
    constraints: Sequence[Message], world: LiveScene, prefix: str = ""
) -> JointGoal | PoseGoal | RegionGoal | None:
    """The goal of ``goal_constraints``; None where there are none.

    Joint constraints state a configuration. One position and one orientation constraint state a
    pose of the frame ``tool``, or of the robot's last link (its flange). The goal is the tool point
    and the orientation of the tool of that pose. With an ``absolute_z_axis_tolerance`` of π or more
    about the tool axis, the turn about the axis is free. The other tolerances are ignored.

    ``constraints``: ``moveit_msgs/Constraints``, one at most.
    """
    robot = world.robot
    if not constraints:
        return None
    if len(constraints) > 1:
        raise InvalidRequestError(
            f"goal_constraints has {len(constraints)} entries: must have one at most"
        )
    (goal,) = constraints
    kinds = "joint", "position", "orientation"
    joints, places, turns = (getattr(goal, f"{kind}_constraints") for kind in kinds)
    if goal.visibility_constraints:
        raise InvalidRequestError("goal_constraints[0].visibility_constraints: must be empty")
    if joints and not places and not turns:
        names = [one.joint_name for one in joints]
        order = joint_columns(names, robot.joint_names, "joint_constraints")
        return JointGoal(np.array([one.position for one in joints])[order])
    if joints or len(places) != 1 or len(turns) != 1:
        raise InvalidRequestError(
            f"goal_constraints[0] has {len(joints)} joint, {len(places)} position and {len(turns)} "
            "orientation constraints: must have one for each joint, or one position and one "
            "orientation constraint"
        )
    return _pose_goal(places[0], turns[0], world, prefix)


def _pose_goal(
    place: Message, turn: Message, world: LiveScene, prefix: str
) -> PoseGoal | RegionGoal:
    robot = world.robot
    flange = prefix + [name for name in robot.link_names if name != TOOL][-1]
    for what, item in (("position", place), ("orientation", turn)):
        if item.link_name not in (TOOL, flange) or item.link_name != place.link_name:
            raise InvalidRequestError(
                f"{what} constraint: link_name is {item.link_name!r}: both constraints must name "
                f"{TOOL!r} (at the tool point, z along its axis) or {flange!r}"
            )
    poses = place.constraint_region.primitive_poses
    if len(poses) != 1 or place.constraint_region.meshes:
        raise InvalidRequestError(
            f"position constraint: constraint_region has {len(poses)} primitive_poses: must have "
            "one, and no meshes"
        )
    at, turned = in_base(place.header, world.frames), in_base(turn.header, world.frames)
    rotation = (turned @ Pose(orientation=read_quaternion(turn.orientation))).rotation
    origin = at @ vector(poses[0].position) - rotation @ vector(place.target_point_offset)
    if place.link_name == TOOL:
        point, frame = origin, rotation
    else:
        segment: FloatArray = rotation @ robot.flange_rotation.T
        point = origin + segment @ (robot.tool_point - robot.flange_translation)
        frame = segment @ robot.tool_rotation
    free = turn.absolute_z_axis_tolerance >= math.pi  # about z of the link that is named
    if free and rotation[:, 2] @ frame[:, 2] > 1.0 - 1e-9:  # rounding
        return PoseGoal(point, frame[:, 2])
    return RegionGoal(point, orientation=to_quaternion(frame))


DETECTIONS = "vision_msgs/msg/Detection3DArray"
ROUND = 1.2  # [1] longest over shortest side of the box of a ball: a choice


@dataclass(frozen=True)
class DetectionParameters(Checked):
    """What the classes of a detector mean, and what its messages do not tell.

    Raises:
        InvalidRequestError: a role that is no fruit's, or a class of ``stems`` without a role.
    """

    # by class: target, pushable or avoid; detections of other classes are left out
    roles: Mapping[str, str] = parameter(
        {"ripe": "target", "unripe": "pushable"}, "", "choice", "of the objects of each class"
    )
    # whose box has its z axis along the stem, fruit to root
    stems: tuple[str, ...] = parameter((), "", "choice", "classes that have stems")
    stem_length: float = parameter(0.15, "m", "guess", "of these stems")
    sigma: float = parameter(0.005, "m", "choice", "of a coordinate where the covariance is zero")
    least_score: float = parameter(0.0, "1", "choice", "detections with a lower score are left out")
    view: float = parameter(1.2, "rad", "choice", "full opening angle of the camera's cone of view")
    near: float = parameter(0.0, "m", "choice", "from the camera: nearer, it measures nothing")
    far: float = parameter(math.inf, "m or inf", "choice", "likewise, farther")

    def __post_init__(self) -> None:
        super().__post_init__()
        for name, role in self.roles.items():
            if role not in get_args(Role) or role == "static":
                raise InvalidRequestError(
                    f"role of class {name!r} is {role!r}: must be target, pushable or avoid"
                )
        for name in self.stems:
            if name not in self.roles:
                raise InvalidRequestError(
                    f"class {name!r} has stems and no role: must be one of {', '.join(self.roles)}"
                )


def read_detections(
    item: Message,
    frames: Mapping[str, Pose],
    parameters: DetectionParameters | None = None,
    *,
    time: float | None = None,
) -> Look:
    """The look of a ``vision_msgs/Detection3DArray``.

    Read of each detection are the class of its best hypothesis with the covariance of the
    position, the pose and the size of its box, and its id. A box whose sides are nearly equal is a
    ball, another an ellipsoid.

    Args:
        item: the message; ``header.frame_id`` is the frame of the camera, z forward.
        frames: poses of frames in the robot's base frame at the time of the exposure, by name.
        parameters: see :class:`DetectionParameters`.
        time: of the exposure [s]; None: ``header.stamp`` in seconds.

    Raises:
        InvalidRequestError: an unknown frame, or a detection in another frame; another type.
        InvalidSceneError: a wrong value; the message names the detection.
    """
    if item.__msgtype__ != DETECTIONS:
        raise InvalidRequestError(f"a {item.__msgtype__} is no look: must be a {DETECTIONS}")
    given = parameters or DetectionParameters()
    camera = in_base(item.header, frames)
    found = []
    for k, one in enumerate(item.detections):
        frame = one.header.frame_id
        if frame not in ("", item.header.frame_id):
            raise InvalidRequestError(
                f"detections[{k}].header.frame_id is {frame!r}: must be that of all, "
                f"{item.header.frame_id!r}"
            )
        read = _read(one, k, given)
        if read is not None:
            found.append(read)
    at = nanoseconds(item.header.stamp) / NANO if time is None else time
    return Look(at, camera, tuple(found), given.view, given.near, given.far)


def _read(one: Message, k: int, given: DetectionParameters) -> SceneObject | None:
    best = max(one.results, key=lambda result: float(result.hypothesis.score), default=None)
    if best is None or best.hypothesis.score < given.least_score:
        return None
    name = best.hypothesis.class_id
    role = given.roles.get(name)
    if role is None:
        return None
    pose = read_pose(one.bbox.center)
    covariance = np.array(best.pose.covariance, dtype=np.float64)
    if covariance.size != 36:
        raise InvalidRequestError(f"detections[{k}] has a covariance of {covariance.size}, not 36")
    covariance = covariance.reshape(6, 6)[:3, :3]
    if not covariance.any():
        covariance = given.sigma**2 * np.eye(3)
    stem = None
    if name in given.stems:
        stem = Stem.along(pose.position, pose.rotation[:, 2], given.stem_length)
    shape = _shape(vector(one.bbox.size), k)
    name, place = one.id or f"detection{k}", (pose.position, pose.orientation)
    return SceneObject(name, cast(Role, role), shape, *place, stem=stem, covariance=covariance)


def _shape(size: FloatArray, k: int) -> Shape:
    if not (np.isfinite(size).all() and size.min() > 0.0):
        raise InvalidRequestError(f"detections[{k}].bbox.size is {size}: must be above 0 [m]")
    if size.max() <= ROUND * size.min():
        return Sphere(0.5 * float(size.mean()))
    x, y, z = (0.5 * size).tolist()
    return Ellipsoid((x, y, z))
