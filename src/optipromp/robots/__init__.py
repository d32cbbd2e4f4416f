"""Robots: description files, kinematics, body spheres, tools."""

from optipromp.robots.library import load_robot, robot_names
from optipromp.robots.model import BodySpheres, Robot
from optipromp.robots.tools import Cup, FrankaHand, Tool, with_tool, without_tool

__all__ = [
    "BodySpheres",
    "Cup",
    "FrankaHand",
    "Robot",
    "Tool",
    "load_robot",
    "robot_names",
    "with_tool",
    "without_tool",
]
