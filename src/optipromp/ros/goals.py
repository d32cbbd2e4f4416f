"""Goals of ``moveit_msgs/Constraints``: joints, or a pose of the tool or the flange."""

import math
from collections.abc import Sequence

import numpy as np

from optipromp.core.arrays import FloatArray
from optipromp.core.errors import InvalidRequestError
from optipromp.core.scenes.pose import Pose
from optipromp.core.scenes.rotations import to_quaternion
from optipromp.core.scenes.scene import JointGoal, PoseGoal, RegionGoal
from optipromp.core.trajectory_files import columns
from optipromp.ros.live import LiveScene, in_base
from optipromp.ros.shapes import quaternion, vector
from optipromp.ros.types import Message

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

    ``constraints``: ``moveit_msgs/Constraints``, one at most. ``world``: with the robot and its
    frames. ``prefix``: of joint and link names in ROS.
    """
    robot = world.robot
    if not constraints:
        return None
    if len(constraints) > 1:
        raise InvalidRequestError(
            f"goal_constraints has {len(constraints)} entries: must have one at most"
        )
    (goal,) = constraints
    joints, places, turns = (
        goal.joint_constraints,
        goal.position_constraints,
        goal.orientation_constraints,
    )
    if goal.visibility_constraints:
        raise InvalidRequestError("goal_constraints[0].visibility_constraints: must be empty")
    if joints and not places and not turns:
        order = columns([one.joint_name for one in joints], robot.joint_names, "joint_constraints")
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
    rotation = (turned @ Pose(orientation=quaternion(turn.orientation))).rotation
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
