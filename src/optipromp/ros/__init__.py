"""Messages of ROS 2 in and out, and bags of them, without ROS (extra ``ros``).

>>> from optipromp import load_scene
>>> from optipromp.ros import planning_scene, read_planning_scene
>>> scene = load_scene("scenario-3")
>>> read_planning_scene(planning_scene(scene), like=scene).target.id
'ripe'
"""

from typing import TYPE_CHECKING

from optipromp.core.files import is_bag as is_bag
from optipromp.lazy import lazy

if TYPE_CHECKING:
    from optipromp.ros.guard import GuardFilter as GuardFilter
    from optipromp.ros.live import DetectionParameters as DetectionParameters
    from optipromp.ros.live import LiveScene as LiveScene
    from optipromp.ros.live import read_detections as read_detections
    from optipromp.ros.live import read_planning_scene as read_planning_scene
    from optipromp.ros.loop import PickLoop as PickLoop
    from optipromp.ros.loop import PlanAnswer as PlanAnswer
    from optipromp.ros.loop import answer as answer
    from optipromp.ros.pictures import BagPicture as BagPicture
    from optipromp.ros.pictures import bag_pictures as bag_pictures
    from optipromp.ros.recordings import Cut as Cut
    from optipromp.ros.recordings import CutParameters as CutParameters
    from optipromp.ros.recordings import Recording as Recording
    from optipromp.ros.recordings import load_recording as load_recording
    from optipromp.ros.scenes import collision_object as collision_object
    from optipromp.ros.scenes import planning_scene as planning_scene
    from optipromp.ros.scenes import read_collision_object as read_collision_object
    from optipromp.ros.trajectories import display_trajectory as display_trajectory
    from optipromp.ros.trajectories import joint_trajectory as joint_trajectory
    from optipromp.ros.trajectories import read_trajectories as read_trajectories
    from optipromp.ros.trajectories import read_trajectory as read_trajectory
    from optipromp.ros.trajectories import robot_trajectory as robot_trajectory
    from optipromp.ros.trajectories import stretch_trajectory as stretch_trajectory
    from optipromp.ros.types import Message as Message
    from optipromp.ros.types import Recorded as Recorded
    from optipromp.ros.types import from_bytes as from_bytes
    from optipromp.ros.types import message as message
    from optipromp.ros.types import read_bag as read_bag
    from optipromp.ros.types import to_bytes as to_bytes
    from optipromp.ros.types import typestore as typestore
    from optipromp.ros.types import write_bag as write_bag

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
