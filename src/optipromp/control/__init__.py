"""The closed loop: looks are tracked, and the arm's curve is planned again while it moves."""

from optipromp.control.controller import Controller as Controller
from optipromp.control.controller import Decision as Decision
from optipromp.control.controller import LoopStage as LoopStage
from optipromp.control.driver import without_fruits as without_fruits
from optipromp.control.franka import Franky as Franky
from optipromp.control.franka import PandaPy as PandaPy
from optipromp.control.look import Look as Look
from optipromp.control.parameters import LoopParameters as LoopParameters
from optipromp.control.tracker import Innovations as Innovations
from optipromp.control.tracker import Tracked as Tracked
from optipromp.control.tracker import Tracker as Tracker
from optipromp.control.tracks import TrackerParameters as TrackerParameters
