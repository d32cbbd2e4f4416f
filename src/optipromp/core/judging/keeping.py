"""The whole way of the tool against the constraints of the scene's path."""

import math

import numpy as np

from optipromp.core.arrays import FloatArray
from optipromp.core.judging.ends import BORDER, tool_poses
from optipromp.core.judging.violation import Violation
from optipromp.core.robots.model import Robot
from optipromp.core.scenes.scene import Scene


def left_path(scene: Scene, robot: Robot, times: FloatArray, q: FloatArray) -> list[Violation]:
    """Violations of the path's constraints, each at its largest amount.

    Args:
        scene: with the constraints, if any.
        robot: with the scene's tool.
        times: (M,) of the checks [s].
        q: (M, n) configurations at the checks.
    """
    out: list[Violation] = []
    if scene.path is None:
        return out
    upright, plane = scene.path.upright, scene.path.plane
    points, frames = tool_poses(robot, q)
    if upright is not None:
        axes = frames @ upright.axis
        across = np.linalg.norm(np.cross(axes, upright.direction), axis=1)
        off = np.arctan2(across, axes @ upright.direction)
        worst = int(np.argmax(off))
        if off[worst] > math.radians(upright.angle) + BORDER:
            text = (
                f"the tool leans {math.degrees(off[worst]):.1f} degrees at {times[worst]:.2f} s "
                f"(path.upright: at most {upright.angle:g})"
            )
            amount = float(off[worst])
            out.append(Violation("upright", text, "", float(times[worst]), amount, "rad"))
    if plane is not None:
        far = np.abs((points - plane.point) @ plane.normal)
        worst = int(np.argmax(far))
        if far[worst] > plane.within + BORDER:
            text = (
                f"the tool is {1e3 * far[worst]:.1f} mm off its plane at {times[worst]:.2f} s "
                f"(path.plane: at most {1e3 * plane.within:g})"
            )
            amount = float(far[worst])
            out.append(Violation("plane", text, "", float(times[worst]), amount, "m"))
    return out
