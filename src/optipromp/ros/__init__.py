"""Messages of ROS 2 in and out, and bags of them, without ROS (extra ``ros``).

>>> from optipromp import load_scene
>>> from optipromp.ros import planning_scene, read_planning_scene
>>> scene = load_scene("scenario-3")
>>> read_planning_scene(planning_scene(scene), like=scene).target.id
'ripe'
"""

from optipromp.ros.bags import Recorded, is_bag, read_bag, write_bag
from optipromp.ros.recordings import Cut, CutParameters, Recording, load_recording
from optipromp.ros.scenes import collision_object, planning_scene, read_collision_object
from optipromp.ros.types import Message, from_bytes, message, to_bytes, typestore
from optipromp.ros.world import World, read_planning_scene

__all__ = [
    "Cut",
    "CutParameters",
    "Message",
    "Recorded",
    "Recording",
    "World",
    "collision_object",
    "from_bytes",
    "is_bag",
    "load_recording",
    "message",
    "planning_scene",
    "read_bag",
    "read_collision_object",
    "read_planning_scene",
    "to_bytes",
    "typestore",
    "write_bag",
]
