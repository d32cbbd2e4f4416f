"""Robots: description files, kinematics, body spheres, tools."""

from optipromp.core.robots.grippers import FingerGripper as FingerGripper
from optipromp.core.robots.grippers import MeshTool as MeshTool
from optipromp.core.robots.grippers import Scissor as Scissor
from optipromp.core.robots.grippers import Suction as Suction
from optipromp.core.robots.library import Choice as Choice
from optipromp.core.robots.library import load_robot as load_robot
from optipromp.core.robots.library import robot_names as robot_names
from optipromp.core.robots.model import BodySpheres as BodySpheres
from optipromp.core.robots.model import Robot as Robot
from optipromp.core.robots.mounted import Mounted as Mounted
from optipromp.core.robots.resolved import save_robot as save_robot
from optipromp.core.robots.tool_geometry import Solid as Solid
from optipromp.core.robots.tool_geometry import cover_solids as cover_solids
from optipromp.core.robots.tool_geometry import solids_inertia as solids_inertia
from optipromp.core.robots.tool_protocol import Tool as Tool
from optipromp.core.robots.tools import Cup as Cup
from optipromp.core.robots.tools import FrankaHand as FrankaHand
from optipromp.core.robots.tools import with_tool as with_tool
from optipromp.core.robots.tools import without_tool as without_tool
