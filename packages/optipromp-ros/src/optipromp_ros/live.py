"""A scene that messages change; of a ``moveit_msgs/PlanningScene``; goals of ``Constraints``."""

import math
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, fields, replace
from typing import Any, cast, get_args

import numpy as np

from optipromp.core.arrays import FloatArray
from optipromp.core.errors import (
    InvalidRequestError,
    InvalidSceneError,
    OptiPrompError,
    StartInvalidError,
)
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
from optipromp_ros.arm_state import ArmState
from optipromp_ros.frames import TOOL, Frames, known_frames
from optipromp_ros.scenes import (
    COLLISION_OBJECT,
    Held,
    links_of,
    object_id,
    read_held,
    read_pose,
    read_quaternion,
    vector,
)
from optipromp_ros.trajectories import NANO, joint_motion, nanoseconds
from optipromp_ros.types import Message, constants


def read_planning_scene(item: Message, like: Scene | None = None, prefix: str = "") -> Scene:
    """The scene of a ``moveit_msgs/PlanningScene``.

    Args:
        item: a whole scene; or a difference, which changes the objects of ``like``.
        like: the robot, tool and options, and what the message lacks (start, approach, goal). None:
            the robot is ``robot_model_name`` with its own tool.
        prefix: of joint and link names in ROS.

    Raises:
        InvalidSceneError: a wrong value; the message names object, field and valid values. Or
            joints that are not the robot's.
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
    return LiveScene(stated, robot, ArmState.of(robot, prefix), {}, prefix).heard(item).scene()


@dataclass(frozen=True, eq=False)
class LiveScene:
    """A scene as the messages so far state it; every message gives a new one.

    Attributes:
        stated: fields of the :class:`optipromp.core.scenes.Scene`, except its objects.
        robot: with its tool.
        arm: its joint states.
        held: the objects of each message by its id, oldest first.
        prefix: of joint and link names in ROS.
        unknown: what was not understood, by id, and why. It is there until it is mended or removed.
    """

    stated: Mapping[str, Any]
    robot: Robot
    arm: ArmState
    held: Mapping[str, Held] = field(default_factory=dict)
    prefix: str = ""
    unknown: Mapping[str, str] = field(default_factory=dict)

    @classmethod
    def of(cls, scene: Scene, prefix: str = "") -> "LiveScene":
        """The world of a scene; ``prefix`` is that of joint and link names in ROS."""
        robot = posed(scene)[0]
        held = {object_id(o): Held(Pose(o.position, o.orientation), (o,)) for o in scene.objects}
        return cls(vars(scene), robot, ArmState.of(robot, prefix), held, prefix)

    def scene(self, goal: tuple[Goal, ...] | None = None) -> Scene:
        """The scene.

        Args:
            goal: in place of the target, which then becomes an object to avoid; one of them.

        Raises:
            InvalidSceneError: no target and no goal, two targets, an id that two roles have; or a
                message was not understood.
        """
        if self.unknown:
            told = "; ".join(self.unknown.values())
            raise InvalidSceneError(
                f"not understood: {told}. Send it again as it must be, or remove it"
            )
        objects = tuple(item for held in self.held.values() for item in held.items)
        names = {item.name for item in fields(Scene)} - {"objects"}
        known = {name: self.stated[name] for name in names & self.stated.keys()}
        if goal is not None:
            known |= {"goal": goal if len(goal) > 1 else goal[0], "waypoints": None}
            objects = tuple(
                replace(item, role="avoid") if item.role == "target" else item for item in objects
            )
        elif any(item.role == "target" for item in objects):
            known |= {"goal": None, "waypoints": None}
        elif known.get("goal") is None:
            raise InvalidSceneError("no target: no id begins with 'target/', no goal is stated")
        return Scene(objects=objects, **known)

    def heard(self, item: Message, now: int | None = None) -> "LiveScene":
        """The world after a ``PlanningScene``, a ``CollisionObject`` or a ``JointState``.

        What cannot be understood of a scene or an object is in :attr:`unknown`, of joint states in
        :attr:`arm`.

        Args:
            item: the message.
            now: when it came, by the clock of the stamps [ns]; None: recorded.

        Raises:
            InvalidSceneError: an object is removed that is not there.
            InvalidRequestError: joint states of no joint of the arm; another type of message.
        """
        match item.__msgtype__.rpartition("/")[2]:
            case "PlanningScene":
                return self._heard_scene(item, now)
            case "CollisionObject":
                gone = item.operation == constants(item.__msgtype__)["REMOVE"] and item.id
                if gone and not {item.id} & (self.held.keys() | self.unknown.keys()):
                    raise InvalidSceneError(
                        f"collision object {item.id!r} is not there: must be added first"
                    )
                return self._heard_object(item, self.frames(now))
            case "JointState":
                arm = self.arm.heard(item, now)
                return replace(self.at(arm.newest[1].q) if arm.newest else self, arm=arm)
        raise InvalidRequestError(
            f"a {item.__msgtype__} says nothing of a scene: must be a PlanningScene, a "
            "CollisionObject or a JointState"
        )

    def frames(self, now: int | None, q: FloatArray | None = None) -> dict[str, Pose]:
        """The frames of messages with the arm at ``q`` (n,); None: where it stands at ``now``."""
        with suppress(StartInvalidError):
            q = self.arm.at_rest(now).q if q is None else q
        return known_frames(self.robot, self.prefix, self.stated.get("base"), q)

    def at(self, start: FloatArray) -> "LiveScene":
        """The world with the robot at ``start`` (n,)."""
        known = self.marked(_START, "")
        return replace(known, stated={**self.stated, "start": start})

    def marked(self, what: str, why: str) -> "LiveScene":
        """The world where ``what`` was not understood; empty ``why``: it was, or is gone."""
        unknown = {name: old for name, old in self.unknown.items() if name != what}
        return replace(self, unknown={**unknown, what: why} if why else unknown)

    def _heard_scene(self, item: Message, now: int | None) -> "LiveScene":
        world, q = self if item.is_diff else replace(self, held={}, unknown={}), None
        for what, why in _unread(item):
            world = world.marked(what, why)
        state = item.robot_state.joint_state
        if state.name or len(state.position):
            try:
                q = joint_motion(state, self.robot.joint_names, _START, self.prefix).q
                world = world.at(q)
            except InvalidRequestError as error:
                world = world.marked(_START, error.message)
        frames = self.frames(now, q)
        for part in item.world.collision_objects:
            world = world._heard_object(part, frames)
        if item.name:
            world = replace(world, stated={**world.stated, "name": item.name})
        return world

    def _heard_object(self, item: Message, frames: Mapping[str, Pose]) -> "LiveScene":
        """The world after an object, which is unknown if its message is not understood."""
        kinds, held = constants(item.__msgtype__), dict(self.held)
        if item.operation == kinds["REMOVE"]:
            if not item.id:
                other = {k: why for k, why in self.unknown.items() if k.startswith(_NO_OBJECTS)}
                return replace(self, held={}, unknown=other)
            held.pop(item.id, None)
            return replace(self.marked(item.id, ""), held=held)
        moved, stated = item.operation == kinds["MOVE"], dict(self.stated)
        try:
            if moved and item.id not in held:
                raise InvalidSceneError("it is not there: must be added first")
            if not moved and item.operation != kinds["ADD"]:
                raise InvalidSceneError(
                    f"operation is {item.operation}: must be ADD (0), REMOVE (1) or MOVE (3)"
                )
            frame = in_base(item.header, frames)
            if moved:
                held[item.id] = held[item.id].at(frame @ read_pose(item.pose))
            else:
                held[item.id] = read_held(item).transformed(frame)
                if held[item.id].approach is not None:
                    stated["approach"] = held[item.id].approach
        except OptiPrompError as error:
            if not moved:
                held.pop(item.id, None)  # of another shape: a motion does not mend it
            elif item.id in self.unknown and item.id not in held:
                return self
            why = f"collision object {item.id!r}: {error.message}"
            return replace(self.marked(item.id, why), held=held)
        return replace(self.marked(item.id, ""), held=held, stated=stated)


_START = "robot_state.joint_state"
_NO_OBJECTS = "robot_state.", "world.octomap", "link_", "message "  # begins of what else may be


def in_base(header: Message, frames: Mapping[str, Pose]) -> Pose:
    """The pose in the base frame of the frame that a header names."""
    return frames.get(header.frame_id) or Frames().find(header.frame_id, frames)


def _unread(item: Message) -> Iterator[tuple[str, str]]:
    """What of a planning scene is in a form that is not supported, and why; empty: it is gone."""
    remove = constants(COLLISION_OBJECT)["REMOVE"]
    for held in item.robot_state.attached_collision_objects:
        name, what = held.object.id, f"robot_state.attached_collision_objects {held.object.id!r}"
        if held.object.operation != remove:
            yield what, f"{what}: must be none; what the robot holds is its tool"
            continue
        yield what, ""
        yield name, f"collision object {name!r}: it was detached: must be added where it is now"
    size = len(item.world.octomap.octomap.data)
    if size:
        what = "world.octomap"
        yield what, f"{what} holds {size} bytes: must be empty; give collision objects"
    for field_, usual in (("padding", 0.0), ("scale", 1.0)):
        for link in getattr(item, f"link_{field_}"):
            what, value = f"link_{field_} of {link.link_name!r}", getattr(link, field_)
            told = f"{what} is {value:g}: must be {usual:g}; a plan's options have its clearances"
            yield what, "" if value == usual else told


def read_goal(constraints: Sequence[Message], world: LiveScene) -> tuple[Goal, ...] | None:
    """The goals of ``goal_constraints``, one of which is to be reached; None where there are none.

    Joint constraints state a configuration; joints without one stay where they are at the start.
    A position constraint states a point of the frame ``tool``, and with an orientation constraint
    a pose of it or of a link that moves with it, as the flange. The goal is the tool point and the
    orientation of the tool of that pose. With an ``absolute_z_axis_tolerance`` of π or more about
    the tool axis, the turn about the axis is free. The other tolerances are ignored.

    ``constraints``: ``moveit_msgs/Constraints``.

    Raises:
        InvalidRequestError: a goal of another form, or a wrong value.
    """
    try:
        return tuple(_goal(k, one, world) for k, one in enumerate(constraints)) or None
    except InvalidSceneError as error:
        raise InvalidRequestError(f"goal_constraints: {error.message}") from None


def _goal(k: int, goal: Message, world: LiveScene) -> Goal:
    kinds = "joint", "position", "orientation"
    joints, places, turns = (getattr(goal, f"{kind}_constraints") for kind in kinds)
    if goal.visibility_constraints:
        raise InvalidRequestError(f"goal_constraints[{k}].visibility_constraints: must be empty")
    if joints and not places and not turns:
        return _joint_goal(joints, world)
    if joints or len(places) != 1 or len(turns) > 1:
        raise InvalidRequestError(
            f"goal_constraints[{k}] has {len(joints)} joint, {len(places)} position and "
            f"{len(turns)} orientation constraints: must have joint constraints alone, or one "
            "position constraint with at most one orientation constraint"
        )
    return _pose_goal(places[0], turns[0] if turns else None, world)


def _joint_goal(joints: Sequence[Message], world: LiveScene) -> JointGoal:
    own = [world.prefix + name for name in world.robot.joint_names]
    names = [one.joint_name for one in joints]
    wanted, start = np.array([one.position for one in joints]), world.stated.get("start")
    if set(names) < set(own) and len(set(names)) == len(names) and start is not None:
        q = np.array(start, dtype=np.float64)
        q[[own.index(name) for name in names]] = wanted
        return JointGoal(q)
    return JointGoal(wanted[joint_columns(names, own, "joint_constraints")])


def _pose_goal(place: Message, turn: Message | None, world: LiveScene) -> PoseGoal | RegionGoal:
    robot, frames = world.robot, world.frames(None, world.stated.get("start"))
    last = robot.n_segments - 1
    links = {world.prefix + k: link for k, link in links_of(robot).items() if link.segment == last}
    for what, item in (("position", place), ("orientation", turn)):
        if item and (item.link_name not in (TOOL, *links) or item.link_name != place.link_name):
            raise InvalidRequestError(
                f"{what} constraint: link_name is {item.link_name!r}: both constraints must name "
                f"{TOOL!r} (at the tool point, z along its axis) or {' or '.join(map(repr, links))}"
            )
    poses = place.constraint_region.primitive_poses
    if len(poses) != 1 or place.constraint_region.meshes:
        raise InvalidRequestError(
            f"position constraint: constraint_region has {len(poses)} primitive_poses: must have "
            "one, and no meshes"
        )
    at, offset = in_base(place.header, frames), vector(place.target_point_offset)
    origin = at @ vector(poses[0].position)
    if turn is None:
        if place.link_name != TOOL or offset.any():
            raise InvalidRequestError(
                f"position constraint of {place.link_name!r} with target_point_offset "
                f"{offset.tolist()}: without an orientation constraint it must be of {TOOL!r}, "
                "without an offset"
            )
        return RegionGoal(origin)
    turned = in_base(turn.header, frames)
    rotation = (turned @ Pose(orientation=read_quaternion(turn.orientation))).rotation
    point, frame = origin - rotation @ offset, rotation
    if place.link_name != TOOL:
        link = links[place.link_name]
        segment: FloatArray = rotation @ link.rotation.T
        point = point + segment @ (robot.tool_point - link.translation)
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


def meaning(given: Sequence[str]) -> DetectionParameters:
    """Classes with their roles, each as ``CLASS=ROLE`` or ``CLASS=ROLE:stem``; none: the usual.

    Raises:
        InvalidRequestError: a text of another form, or a role that is no fruit's.
    """
    roles, stems = dict[str, str](), list[str]()
    for text in given:
        name, equals, rest = text.rpartition("=")
        role, colon, stem = rest.partition(":")
        if not name or not equals or (colon and stem != "stem"):
            raise InvalidRequestError(f"--role is {text!r}: must be CLASS=ROLE or CLASS=ROLE:stem")
        roles[name] = role
        stems += [name] if stem else []
    return DetectionParameters(roles=roles, stems=tuple(stems)) if roles else DetectionParameters()


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
        warnings.warn(f"class {name!r} is left out: it has no --role {name}=ROLE", stacklevel=4)
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
