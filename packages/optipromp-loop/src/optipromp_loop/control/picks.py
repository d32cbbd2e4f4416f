"""The committed pick: approach, way in and way out, as ``plan_pick`` makes them; and its future.

A pick is made from where the arm stands, first by the approach that was chosen before, then by the
others. Underway it is predicted anew from what is believed by then, to the end of its way out.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from optipromp.core.arrays import FloatArray
from optipromp.core.errors import OptiPrompError
from optipromp.core.planning import Picked, Plan, plan
from optipromp.core.planning.leg_tasks import full_model, held
from optipromp.core.planning.legs import led_out, plan_whole
from optipromp.core.planning.options import DEFAULTS
from optipromp.core.planning.result import REACH, RETREAT
from optipromp.core.planning.task import resolve, spaced
from optipromp.core.planning.timing import among_fruits, paced
from optipromp.core.planning.verdict import deciding
from optipromp.core.planning.ways import ways_out
from optipromp.core.pushing.stems.hanging import Leaving
from optipromp.core.robots.model import Robot
from optipromp.core.scenes.scene import Approach, Scene
from optipromp.core.trajectory import State, Trajectory
from optipromp_loop.control.driver import Displacement


def excess(legs: Picked) -> float:
    """The harm of a pick over what a success may do; infinite where a leg is not valid."""
    worst = 0.0
    for leg in deciding(legs.legs).values():
        if not leg.valid:
            return math.inf
        if leg.prediction is not None:
            worst = max(worst, leg.prediction.harm / leg.prediction.threshold)
    return worst


def committed(
    scene: Scene, robot: Robot, seed: int, kept: Approach | None = None
) -> Picked | OptiPrompError:
    """The pick in a scene whose start is where the arm stands; or why there is none.

    ``kept``: the approach to try first. A pick that fails is returned too.
    """
    scenes = [scene]
    if kept is not None and kept is not scene.approach:
        scenes.insert(0, replace(scene, approach=replace(kept, cone=0.0, aside=0.0)))
    try:
        for one in scenes:
            made = plan_whole(one, robot=robot, seed=seed, unhurried=True)
            found = made if isinstance(made, Picked) else Picked({REACH: made})
            if found.success:
                break
    except OptiPrompError as error:
        return error
    return found


def to_camera_point(reach: Plan) -> Trajectory | None:
    """The motion of a reach until its approach begins, at rest there; None: it begins there."""
    if reach.first < 2:
        return None
    q = reach.trajectory.positions[: reach.first + 1]
    return paced(reach.task, replace(DEFAULTS, unhurried=True), q, None, None)


def foreseen(pick: Picked, scene: Scene, shift: Displacement) -> float:
    """The harm of a pick that is followed in a plant that differs, over what a success may do.

    The tool's motion is predicted to the end of the way out, moved with the fruits.

    Args:
        pick: that is followed.
        scene: with the fruits where they hang by now; its target is where the pick has it.
        shift: of the fruits against those of the pick.
    """
    reach, legs = pick.reach, pick.legs
    task = resolve(scene, reach.robot, State(reach.trajectory.positions[0]))
    task = replace(task, risk=reach.risk, seed=reach.seed)
    now = replace(reach, task=task)

    def moved(curve: Trajectory, first: int) -> tuple[FloatArray, FloatArray]:
        points, axes = reach.robot.tool_pose(curve.positions[first:])
        return points + shift.at(points, np.zeros(len(points))), axes

    model = task.push_model(reach.trajectory.positions[-1])
    if model is None:
        return 0.0
    points, axes = moved(reach.trajectory, reach.first)
    if reach.task.underway.pushed is not None:  # before this reach was planned
        begun, turned = reach.task.underway.pushed
        points, axes = np.vstack([begun, points]), np.vstack([turned, axes])
    harm = model.harm(*spaced(points, axes), model.states)
    full = full_model(now, held(now)[1]) if RETREAT in legs else None
    if full is None:
        return harm / model.threshold
    out = legs[RETREAT].trajectory
    leaving = Leaving(full, *spaced(points, axes), harm)
    leaving = leaving.at(among_fruits(reach.robot, out, scene.pushables))
    return leaving.harm(*spaced(*moved(out, 0)), leaving.states) / leaving.threshold


class Choice(NamedTuple):
    """What a comparison found beside going on.

    Attributes:
        pick: another pick from where the arm will be; or why there is none.
        excess: its harm over what a success may do.
        leaving: that of leaving now, without the target.
    """

    pick: Picked | OptiPrompError
    excess: float
    leaving: float


def compared(pick: Picked, scene: Scene, at: float, passed: FloatArray) -> Choice:
    """One search for another pick underway, with its way out, and the harm of leaving now.

    Args:
        pick: that is followed.
        scene: with the fruits where they hang by now.
        at: time in the pick's reach at which another would take over [s].
        passed: (k, n) configurations of the approach so far.
    """
    reach = pick.reach
    leaving = min(harm for _, harm in ways_out(reach, passed))
    try:
        made = plan(
            scene, robot=reach.robot, seed=reach.seed, unhurried=True, previous=reach, at=at,
            unpushed=True,
        )  # fmt: skip
    except OptiPrompError as error:
        return Choice(error, math.inf, leaving)
    found = Picked(led_out(made) if RETREAT in pick.legs and made.valid else {REACH: made})
    return Choice(found, excess(found), leaving)
