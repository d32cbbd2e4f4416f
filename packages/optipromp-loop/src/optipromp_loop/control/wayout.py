"""Ways out of the plant for a tool that stopped on its way in."""

import math
from operator import itemgetter

from optipromp.core.arrays import FloatArray
from optipromp.core.planning.leg_tasks import distance_of, full_model, held
from optipromp.core.planning.parameters import BACK
from optipromp.core.planning.result import Plan
from optipromp.core.planning.task import tool_motion
from optipromp.core.planning.ways import back_along, ways
from optipromp.core.pushing.model import Continued, PushModel
from optipromp.core.pushing.path import length
from optipromp.core.pushing.stems.hanging import Hanging, Leaving
from optipromp.core.robots.model import Robot


def ways_out(reach: Plan, q: FloatArray, holding: bool = False) -> list[tuple[FloatArray, float]]:
    """Ways out of the plant, the least harmful first: waypoints (T, n), and harm over what a pick
    may do.

    ``reach``: the plan that was followed. ``q``: (k, n) configurations on it so far. ``holding``:
    whether the tool leaves with its target, else without. Where no model of fruits on stems
    applies, the way back along ``q`` alone, with no harm.
    """
    robot, model = reach.robot, reach.push_model
    distance = length(robot.tool_pose(q)[0])
    if holding:
        model, distance = full_model(reach, held(reach)[1]), distance_of(reach)
    elif isinstance(model, Continued):
        model = model.lead
    return led_back(robot, model, q, distance)


def led_back(
    robot: Robot, model: PushModel | None, q: FloatArray, distance: float
) -> list[tuple[FloatArray, float]]:
    """:func:`ways_out` by a ``distance`` [m], of a motion ``q`` (k, n) whose pushes a ``model``
    predicts."""
    if not isinstance(model, Hanging) or len(q) < 3:
        return [(back_along(q, robot.tool_pose(q)[0], distance), 0.0)]
    proposed = [(way, way.followed(robot, q[-1])) for way in ways(robot, q, distance)]
    found = [(way, one) for way, one in proposed if one is not None]
    out = Leaving(model, *tool_motion(robot, q))
    found.sort(key=lambda item: item[0].harm(out, BACK.screened))
    first, rest = found[: BACK.judged], found[BACK.judged :]
    told = [(one, way.harm(out, out.states) / out.threshold) for way, one in first]
    return [*sorted(told, key=itemgetter(1)), *((one, math.inf) for _, one in rest)]
