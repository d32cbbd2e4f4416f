"""Robots: description files, kinematics, body spheres, tools."""

from optipromp.robots.grippers import FingerGripper, Scissor
from optipromp.robots.library import Choice, load_robot, robot_names
from optipromp.robots.mesh_tool import MeshTool
from optipromp.robots.model import BodySpheres, Robot
from optipromp.robots.resolved import save_robot
from optipromp.robots.tool_geometry import Solid, cover_solids, solids_inertia
from optipromp.robots.tool_protocol import Tool
from optipromp.robots.tools import Cup, FrankaHand, with_tool, without_tool

__all__ = [
    "BodySpheres",
    "Choice",
    "Cup",
    "FingerGripper",
    "FrankaHand",
    "MeshTool",
    "Robot",
    "Scissor",
    "Solid",
    "Tool",
    "cover_solids",
    "load_robot",
    "robot_names",
    "save_robot",
    "solids_inertia",
    "with_tool",
    "without_tool",
]
