"""Where the hand and the tool of an arm are, as poses."""

from optipromp.core.arrays import FloatArray, frame_along
from optipromp.core.robots.model import Robot
from optipromp.core.scenes.pose import Pose


def flange_of(robot: Robot, q: FloatArray) -> Pose:
    """The hand in the base frame at joint positions ``q`` (n,)."""
    origins, rotations = robot.segment_frames(q)
    turn = rotations[-1]
    at = origins[-1] + turn @ robot.flange_translation
    return Pose(at, turn @ robot.flange_rotation)


def tool_frame(robot: Robot, q: FloatArray) -> Pose:
    """The tool axes at the tool point, in the base frame, at ``q`` (n,)."""
    origins, rotations = robot.segment_frames(q)
    turn, axes = rotations[-1], frame_along(robot.tool_axis)
    if robot.tool is not None:
        axes = robot.flange_rotation @ robot.tool.rotation
    return Pose(origins[-1] + turn @ robot.tool_point, turn @ axes)
