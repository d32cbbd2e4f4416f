"""Messages of ROS 2 in and out, and bags of them, without ROS (extra ``ros``).

>>> from optipromp import load_scene
>>> from optipromp.ros import planning_scene, read_planning_scene
>>> scene = load_scene("scenario-3")
>>> read_planning_scene(planning_scene(scene), like=scene).target.id
'ripe'
"""

from optipromp.ros.scenes import collision_object, planning_scene, read_collision_object
from optipromp.ros.types import Message, from_bytes, message, to_bytes, typestore
from optipromp.ros.world import World, read_planning_scene

__all__ = [
    "Message",
    "World",
    "collision_object",
    "from_bytes",
    "message",
    "planning_scene",
    "read_collision_object",
    "read_planning_scene",
    "to_bytes",
    "typestore",
]
