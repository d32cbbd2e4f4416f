"""Robots: description files, kinematics, body spheres, tools."""

from optipromp.core.robots.grippers import FingerGripper, MeshTool, Scissor, Suction
from optipromp.core.robots.library import Choice, load_robot, robot_names
from optipromp.core.robots.model import BodySpheres, Robot
from optipromp.core.robots.mounted import Mounted
from optipromp.core.robots.resolved import save_robot
from optipromp.core.robots.tool_geometry import Solid, cover_solids, solids_inertia
from optipromp.core.robots.tool_protocol import Tool
from optipromp.core.robots.tools import Cup, FrankaHand, with_tool, without_tool

__all__ = [
    "BodySpheres",
    "Choice",
    "Cup",
    "FingerGripper",
    "FrankaHand",
    "MeshTool",
    "Mounted",
    "Robot",
    "Scissor",
    "Solid",
    "Suction",
    "Tool",
    "cover_solids",
    "load_robot",
    "robot_names",
    "save_robot",
    "solids_inertia",
    "with_tool",
    "without_tool",
]
