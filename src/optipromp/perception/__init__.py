"""Eyes: from a colour picture with depth to fruits with covariances, and to a scene."""

from typing import TYPE_CHECKING

from optipromp.lazy import lazy

if TYPE_CHECKING:
    from optipromp.perception.boards import Board as Board
    from optipromp.perception.calibration import BoardView as BoardView
    from optipromp.perception.calibration import HandEye as HandEye
    from optipromp.perception.calibration import SeenTool as SeenTool
    from optipromp.perception.calibration import by_tool as by_tool
    from optipromp.perception.calibration import hand_eye as hand_eye
    from optipromp.perception.detector import ByDetector as ByDetector
    from optipromp.perception.detector import Detected as Detected
    from optipromp.perception.eyes import Detection as Detection
    from optipromp.perception.eyes import Sighting as Sighting
    from optipromp.perception.eyes import look_at as look_at
    from optipromp.perception.eyes import seen_scene as seen_scene
    from optipromp.perception.finder import Finder as Finder
    from optipromp.perception.finder import Found as Found
    from optipromp.perception.finder import Region as Region
    from optipromp.perception.fusing import FusedFruit as FusedFruit
    from optipromp.perception.fusing import fused as fused
    from optipromp.perception.geometry import ByGeometry as ByGeometry
    from optipromp.perception.network import ByNetwork as ByNetwork
    from optipromp.perception.parameters import EyeParameters as EyeParameters
    from optipromp.perception.parameters import eyes_of as eyes_of
    from optipromp.perception.pictures import CameraModel as CameraModel
    from optipromp.perception.pictures import DepthPicture as DepthPicture
    from optipromp.perception.pictures import load_camera as load_camera
    from optipromp.perception.pictures import load_picture as load_picture
    from optipromp.perception.watcher import Watcher as Watcher

__getattr__, __dir__ = lazy(
    __name__,
    {
        "boards": "Board",
        "calibration": "BoardView HandEye SeenTool by_tool hand_eye",
        "detector": "ByDetector Detected",
        "eyes": "Detection Sighting look_at seen_scene",
        "finder": "Finder Found Region",
        "fusing": "FusedFruit fused",
        "geometry": "ByGeometry",
        "network": "ByNetwork",
        "parameters": "EyeParameters eyes_of",
        "pictures": "CameraModel DepthPicture load_camera load_picture",
        "watcher": "Watcher",
    },
)
