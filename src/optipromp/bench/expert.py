"""The planner as a policy of ``optipromp/Pick-v0``: actions that follow a plan's path."""

from collections.abc import Callable

import numpy as np

from optipromp.bench.env import SPEED
from optipromp.core.arrays import FloatArray, lengths
from optipromp.core.planning import Plan
from optipromp.core.planning.task import tool_motion

STEP = 0.02  # [s] of a plan between two points of its path
SEARCH = 15  # points ahead among which the nearest is taken: a choice
AHEAD = 5  # points by which the tool aims ahead: a choice

Expert = Callable[[FloatArray], FloatArray]
"""The action (3,) for a tool point (3,) in the base frame."""


def follower(made: Plan) -> Expert:
    """The actions that bring the tool to a plan's path and on along it.

    The place on the path is that of the nearest point ahead, so a disturbed tool is not late.
    """
    times = np.arange(0.0, made.trajectory.duration, STEP)
    points, _ = tool_motion(made.robot, made.trajectory.sample(times)[0])
    frame, at = made.scene.frame, 0

    def action(point: FloatArray) -> FloatArray:
        nonlocal at
        at += int(np.argmin(lengths(points[at : at + SEARCH] - point)))
        then = min(at + AHEAD, len(points) - 1)
        velocity = (points[then] - point) / (AHEAD * STEP)
        return np.asarray(np.clip(frame @ velocity / SPEED, -1.0, 1.0))

    return action
