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
from optipromp.core.planning.legs import led_out, plan_whole, takes
from optipromp.core.planning.options import DEFAULTS
from optipromp.core.planning.result import REACH, RETREAT
from optipromp.core.planning.task import resolve, spaced
from optipromp.core.planning.timing import among_fruits, paced
from optipromp.core.planning.verdict import deciding
from optipromp.core.pushing.stems.hanging import Leaving
from optipromp.core.robots.model import Robot
from optipromp.core.scenes.scene import Scene
from optipromp.core.trajectory import State, Trajectory
from optipromp_loop.control.courses import Displacement
from optipromp_loop.control.wayout import ways_out


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
    scene: Scene, robot: Robot, seed: int, before: Picked | None = None, budget: float = 1.0
) -> Picked | OptiPrompError:
    """The pick in a scene whose start is where the arm stands; or why there is none.

    ``before``: a pick whose approach, and in it whose tool path, is tried first; ``budget``: the
    most harm with which it is kept, over what a success may do. A pick that fails is returned too.
    """
    try:
        if before is not None:
            reach = before.reach
            seen = replace(scene, approach=reach.scene.approach)
            found = _continued(
                before, seen, float(reach.trajectory.times[reach.first]), scene.start
            )
            if found.success or (before.success and excess(found) <= budget):
                return found
        made = plan_whole(scene, robot=robot, seed=seed, unhurried=True)
    except OptiPrompError as error:
        return error
    return made if isinstance(made, Picked) else Picked({REACH: made})


def _continued(before: Picked, scene: Scene, at: float, start: FloatArray | None = None) -> Picked:
    """The pick that goes on from a time ``at`` of a reach [s]: by its path, or by another one.

    ``start``: (n,) where the arm stands by then; None: it is in motion on its curve.
    """
    reach = before.reach
    made = plan(
        scene, robot=reach.robot, seed=reach.seed, unhurried=True, previous=reach, at=at,
        start_state=None if start is None else State(start), unpushed=True,
    )  # fmt: skip
    leaves = RETREAT in before.legs or takes(scene, reach.robot)
    return Picked(led_out(made) if leaves and made.valid else {REACH: made})


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
    way_in = model.predict(*spaced(points, axes))
    full = full_model(now, held(now)[1]) if RETREAT in legs else None
    if full is None:
        return way_in.harm / model.threshold
    out = legs[RETREAT].trajectory
    leaving = Leaving(full, *spaced(points, axes), way_in)
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
        found = _continued(pick, scene, at)
    except OptiPrompError as error:
        return Choice(error, math.inf, leaving)
    return Choice(found, excess(found), leaving)
