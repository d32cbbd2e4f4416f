"""A pick in several legs: the picked fruit is cut off its stem and goes with the tool."""

from dataclasses import replace

import numpy as np

from optipromp.control.controller import Controller
from optipromp.control.driver import way_back
from optipromp.control.plant import scene_of, target_row
from optipromp.core.arrays import FloatArray
from optipromp.core.errors import Code, OptiPrompError
from optipromp.core.planning import Plan
from optipromp.core.planning.legs import AFTER, CARRY, Picked, after
from optipromp.core.planning.task import resolve
from optipromp.core.trajectory import State
from optipromp.laboratory.simulation.outcome import Cause, Outcome
from optipromp.laboratory.simulation.rollout import Rollout
from optipromp.laboratory.simulation.simulation import Simulation


def follow_legs(
    simulation: Simulation, picked: Picked, failed_leg: bool = False
) -> tuple[Rollout, Outcome]:
    """Execute the legs of a pick one after the other, and judge the whole; see :func:`go_on`."""
    slower = 1.0 / simulation.parameters.control.speed
    done = simulation.follow(picked.reach.trajectory.slowed(slower))
    return go_on(simulation, picked, *done, failed_leg)


def go_on(
    simulation: Simulation, picked: Picked, rollout: Rollout, outcome: Outcome,
    failed_leg: bool = False,
) -> tuple[Rollout, Outcome]:  # fmt: skip
    """Execute the legs after an executed reach, of which records and judgement are given.

    If the reach picked the target, the stem of the target is cut and the target is held where it is
    in the tool. No leg is executed after a reach that did not pick it. A leg whose plan failed is
    executed with ``failed_leg`` only; without it the run ends before that leg. The target is
    *placed* where its centre is within ``thresholds.placed`` of its place at the end of the carry.
    """
    slower, done = 1.0 / simulation.parameters.control.speed, replace(outcome, placed=False)
    if outcome.success and outcome.picked is not False:
        simulation.grip()
        for name in AFTER:
            leg = picked.legs.get(name)
            if leg is not None and (leg.success or failed_leg):
                rollout, outcome = simulation.follow(leg.trajectory.slowed(slower))
        done = replace(outcome, placed=False)
    if not picked.success:
        return rollout, _unplaced(done, f"of the plan, {picked.message} ({picked.status})")
    if not done.success:
        return rollout, done
    off, limit = _off(simulation, picked, rollout), simulation.parameters.thresholds.placed
    if off is None:
        return rollout, done
    if off > limit:
        message = f"the target ends {1e3 * off:.1f} mm from its place"
        return rollout, replace(_unplaced(done, message), message=message, placed_off=off)
    message = f"{outcome.message}; it was brought to its place, {1e3 * off:.1f} mm off"
    return rollout, replace(outcome, placed=True, placed_off=off, message=message)


def bring(
    simulation: Simulation, controller: Controller, q: FloatArray, done: tuple[Rollout, Outcome]
) -> tuple[Rollout, Outcome, Picked | None]:
    """Retreat and carry after a reach in closed loop, in the scene as it is tracked by then.

    Args:
        simulation: at the end of the reach.
        controller: at the end of the reach.
        q: (k, n) commanded configurations of the reach from its last plan on.
        done: records and judgement of the reach.

    Returns:
        Records and judgement of the whole, and the pick; None where the reach did not succeed.
    """
    rollout, outcome = done
    if not (outcome.success and controller.plans):
        return rollout, replace(outcome, placed=False), None
    made, robot = controller.plans[-1], controller.robot
    tracked = controller.tracker.at(simulation.time)
    seen = target_row(tracked) is not None
    scene = scene_of(controller.scene, tracked) if seen else made.scene
    curve = way_back(robot, q, controller.parameters.retreat_speed)
    task = replace(resolve(scene, robot, State(curve.positions[0])), risk=made.risk)
    reach: Plan = replace(
        made, task=task, status=Code.SUCCESS, message="executed in closed loop", trajectory=curve,
        initial=curve, followed=curve, first=0,
    )  # fmt: skip
    try:
        picked = after(reach)
    except OptiPrompError as error:
        return rollout, _unplaced(outcome, f"no way to the place: {error.message}"), None
    return *go_on(simulation, picked, rollout, outcome), picked


def _unplaced(outcome: Outcome, why: str) -> Outcome:
    """The outcome of a pick whose target was not brought to its place."""
    causes = (*outcome.causes, Cause.NOT_PLACED)
    return replace(
        outcome, success=False, cause=causes[0], causes=causes, placed=False,
        message=f"{why}; executed until then: {outcome.message}",
    )  # fmt: skip


def _off(simulation: Simulation, picked: Picked, rollout: Rollout) -> float | None:
    """Distance of the target's centre from its place at the end [m]; None without a carry.

    The place of the centre is that which the last leg plans for: the pose in which the tool took
    the target, carried along.
    """
    target, place = picked.reach.scene.target, picked.reach.scene.place
    if target is None or place is None or CARRY not in picked.legs:
        return None
    (*_, last) = picked.legs.values()
    held = next(one for one in last.scene.attached if one.id == target.id)
    robot, q = picked.reach.robot, last.trajectory.positions[-1]
    _, turns = robot.segment_frames(q)
    tip, _ = robot.tool_pose(q)
    wanted = tip + turns[-1] @ robot.tool_rotation @ held.position
    row = rollout.fruit_ids.index(target.id)
    return float(np.linalg.norm(rollout.fruit_positions[-1, row] - wanted))
