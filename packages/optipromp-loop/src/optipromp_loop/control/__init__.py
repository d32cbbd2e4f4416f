"""The closed loop: looks are tracked, and the arm's curve is planned again while it moves."""

from optipromp.core.scenes.look import Look as Look
from optipromp_loop.control.controller import Controller as Controller
from optipromp_loop.control.controller import Decision as Decision
from optipromp_loop.control.franka import Franky as Franky
from optipromp_loop.control.parameters import LoopParameters as LoopParameters
from optipromp_loop.control.plant import without_fruits as without_fruits
from optipromp_loop.control.stages import LoopStage as LoopStage
from optipromp_loop.control.tracker import Innovations as Innovations
from optipromp_loop.control.tracker import Tracked as Tracked
from optipromp_loop.control.tracker import Tracker as Tracker
from optipromp_loop.control.tracks import TrackerParameters as TrackerParameters
