"""Eyes: from a colour picture with depth to fruits with covariances, and to a scene."""

from typing import TYPE_CHECKING

from optipromp.lazy import lazy

if TYPE_CHECKING:
    from optipromp_eyes.calibration import Board as Board
    from optipromp_eyes.calibration import BoardView as BoardView
    from optipromp_eyes.calibration import HandEye as HandEye
    from optipromp_eyes.calibration import SeenTool as SeenTool
    from optipromp_eyes.calibration import by_tool as by_tool
    from optipromp_eyes.calibration import hand_eye as hand_eye
    from optipromp_eyes.detector import ByDetector as ByDetector
    from optipromp_eyes.detector import Detected as Detected
    from optipromp_eyes.eyes import Detection as Detection
    from optipromp_eyes.eyes import Sighting as Sighting
    from optipromp_eyes.eyes import look_at as look_at
    from optipromp_eyes.eyes import seen_scene as seen_scene
    from optipromp_eyes.finder import Finder as Finder
    from optipromp_eyes.finder import Found as Found
    from optipromp_eyes.finder import Region as Region
    from optipromp_eyes.fusing import FusedFruit as FusedFruit
    from optipromp_eyes.fusing import fused as fused
    from optipromp_eyes.geometry import ByGeometry as ByGeometry
    from optipromp_eyes.network import ByNetwork as ByNetwork
    from optipromp_eyes.parameters import EyeParameters as EyeParameters
    from optipromp_eyes.parameters import eyes_of as eyes_of
    from optipromp_eyes.pictures import CameraModel as CameraModel
    from optipromp_eyes.pictures import DepthPicture as DepthPicture
    from optipromp_eyes.pictures import load_camera as load_camera
    from optipromp_eyes.pictures import load_picture as load_picture
    from optipromp_eyes.watcher import Watcher as Watcher

__getattr__, __dir__ = lazy(
    __name__,
    {
        "calibration": "Board BoardView HandEye SeenTool by_tool hand_eye",
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
