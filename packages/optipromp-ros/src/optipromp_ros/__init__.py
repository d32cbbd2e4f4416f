"""Messages of ROS 2 in and out, and bags of them, without ROS.

>>> from optipromp import load_scene
>>> from optipromp_ros import planning_scene, read_planning_scene
>>> scene = load_scene("scenario-3")
>>> read_planning_scene(planning_scene(scene), like=scene).target.id
'ripe'
"""

from typing import TYPE_CHECKING

from optipromp.core.files import is_bag as is_bag
from optipromp.lazy import lazy

if TYPE_CHECKING:
    from optipromp_ros.guard import GuardFilter as GuardFilter
    from optipromp_ros.live import DetectionParameters as DetectionParameters
    from optipromp_ros.live import LiveScene as LiveScene
    from optipromp_ros.live import read_detections as read_detections
    from optipromp_ros.live import read_planning_scene as read_planning_scene
    from optipromp_ros.loop import PickLoop as PickLoop
    from optipromp_ros.loop import PlanAnswer as PlanAnswer
    from optipromp_ros.loop import answer as answer
    from optipromp_ros.pictures import BagPicture as BagPicture
    from optipromp_ros.pictures import bag_pictures as bag_pictures
    from optipromp_ros.recordings import Cut as Cut
    from optipromp_ros.recordings import CutParameters as CutParameters
    from optipromp_ros.recordings import Recording as Recording
    from optipromp_ros.recordings import load_recording as load_recording
    from optipromp_ros.scenes import collision_object as collision_object
    from optipromp_ros.scenes import planning_scene as planning_scene
    from optipromp_ros.scenes import read_collision_object as read_collision_object
    from optipromp_ros.trajectories import display_trajectory as display_trajectory
    from optipromp_ros.trajectories import joint_trajectory as joint_trajectory
    from optipromp_ros.trajectories import read_trajectories as read_trajectories
    from optipromp_ros.trajectories import read_trajectory as read_trajectory
    from optipromp_ros.trajectories import robot_trajectory as robot_trajectory
    from optipromp_ros.trajectories import stretch_trajectory as stretch_trajectory
    from optipromp_ros.types import Message as Message
    from optipromp_ros.types import Recorded as Recorded
    from optipromp_ros.types import from_bytes as from_bytes
    from optipromp_ros.types import message as message
    from optipromp_ros.types import read_bag as read_bag
    from optipromp_ros.types import to_bytes as to_bytes
    from optipromp_ros.types import typestore as typestore
    from optipromp_ros.types import write_bag as write_bag

__getattr__, __dir__ = lazy(
    __name__,
    {
        "guard": "GuardFilter",
        "live": "DetectionParameters LiveScene read_detections read_planning_scene",
        "loop": "PickLoop PlanAnswer answer",
        "pictures": "BagPicture bag_pictures",
        "recordings": "Cut CutParameters Recording load_recording",
        "scenes": "collision_object planning_scene read_collision_object",
        "trajectories": (
            "display_trajectory joint_trajectory read_trajectories read_trajectory "
            "robot_trajectory stretch_trajectory"
        ),
        "types": "Message Recorded from_bytes message read_bag to_bytes typestore write_bag",
    },
)
