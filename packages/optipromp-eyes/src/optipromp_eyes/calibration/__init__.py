"""Where a camera is: boards, views of them, and the pose of the camera that these tell."""

from optipromp_eyes.calibration.boards import Board as Board
from optipromp_eyes.calibration.fitting import HandEye as HandEye
from optipromp_eyes.calibration.fitting import Residual as Residual
from optipromp_eyes.calibration.handeye import by_tool as by_tool
from optipromp_eyes.calibration.handeye import hand_eye as hand_eye
from optipromp_eyes.calibration.views import BoardView as BoardView
from optipromp_eyes.calibration.views import SeenTool as SeenTool
from optipromp_eyes.calibration.views import read_seen_tool as read_seen_tool
from optipromp_eyes.calibration.views import read_views as read_views
