"""Messages of ROS 2 in and out, and bags of them, without ROS (extra ``ros``).

>>> from optipromp import load_scene
>>> from optipromp.ros import planning_scene, read_planning_scene
>>> scene = load_scene("scenario-3")
>>> read_planning_scene(planning_scene(scene), like=scene).target.id
'ripe'
"""

from optipromp.ros.bags import Recorded, is_bag, read_bag, write_bag
from optipromp.ros.live import LiveScene, read_planning_scene
from optipromp.ros.recordings import Cut, CutParameters, Recording, load_recording
from optipromp.ros.scenes import collision_object, planning_scene, read_collision_object
from optipromp.ros.service import PlanAnswer, answer
from optipromp.ros.trajectories import (
    display_trajectory,
    joint_trajectory,
    read_trajectories,
    read_trajectory,
    robot_trajectory,
)
from optipromp.ros.types import Message, from_bytes, message, to_bytes, typestore

__all__ = [
    "Cut",
    "CutParameters",
    "LiveScene",
    "Message",
    "PlanAnswer",
    "Recorded",
    "Recording",
    "answer",
    "collision_object",
    "display_trajectory",
    "from_bytes",
    "is_bag",
    "joint_trajectory",
    "load_recording",
    "message",
    "planning_scene",
    "read_bag",
    "read_collision_object",
    "read_planning_scene",
    "read_trajectories",
    "read_trajectory",
    "robot_trajectory",
    "to_bytes",
    "typestore",
    "write_bag",
]
