"""Other views: configurations from which a camera on the tool sees what it does not see now."""

import math

import numpy as np

from optipromp.core.arrays import FloatArray, frame_along, rotation
from optipromp.core.robots import ik
from optipromp.core.robots.model import Robot
from optipromp_loop.control.parameters import LoopParameters

_STEPS = 8  # of a turn, each at most 7 degrees: inverse kinematics stays on its branch
_MISS = 1e-6  # [m] error above which a configuration is none


def views(robot: Robot, q: FloatArray, parameters: LoopParameters) -> list[FloatArray]:
    """Configurations (n,) from which a camera on the tool sees what it does not see from ``q``.

    The tool point stays. The tool axis turns by each of ``parameters.views`` [degrees], to four
    sides each; what the arm does not reach is left out.
    """
    point, axis = robot.tool_pose(q)
    across = frame_along(axis)[:, :2].T
    found = []
    for angle in parameters.views:
        for side in (across[0], across[1], -across[0], -across[1]):
            part = np.linspace(0.0, math.radians(angle), _STEPS + 1)[1:]
            axes = np.array([rotation(side, one) @ axis for one in part])
            path, errors = ik.track(robot, np.tile(point, (_STEPS, 1)), axes, q)
            if errors.max() <= _MISS:
                found.append(path[-1])
    return found
