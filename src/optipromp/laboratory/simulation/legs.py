"""A pick in several legs: the picked fruit is cut off its stem and goes with the tool."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from optipromp.core.planning.legs import REACH, Picked
from optipromp.core.trajectory import Trajectory
from optipromp.laboratory.simulation.outcome import Cause, Outcome
from optipromp.laboratory.simulation.rollout import Rollout
from optipromp.laboratory.simulation.simulation import Simulation


def follow_legs(
    simulation: Simulation, motions: Mapping[str, Trajectory], picked: Picked
) -> tuple[Rollout, Outcome]:
    """Execute the legs of a pick one after the other, and judge the whole.

    After the reach, if it picked the target, the stem of the target is cut and the target is held
    where it is in the tool. A leg is not executed after a reach that did not pick it. The target is
    *placed* where its centre is within ``thresholds.placed`` of its place at the end of the carry.
    """
    rollout, outcome = simulation.follow(motions[REACH])
    if not outcome.success or outcome.picked is False:
        return rollout, replace(outcome, placed=False)
    simulation.grip()
    for name, motion in motions.items():
        if name != REACH:
            rollout, outcome = simulation.follow(motion)
    off = _off(simulation, picked, rollout)
    limit = simulation.parameters.thresholds.placed
    if off is None or not outcome.success:
        return rollout, replace(outcome, placed=False, placed_off=off)
    if off <= limit:
        message = f"{outcome.message}; it was brought to its place, {1e3 * off:.1f} mm off"
        return rollout, replace(outcome, placed=True, placed_off=off, message=message)
    message = f"the target ends {1e3 * off:.1f} mm from its place"
    return rollout, replace(
        outcome, success=False, cause=Cause.NOT_PLACED, causes=(Cause.NOT_PLACED,),
        message=message, placed=False, placed_off=off,
    )  # fmt: skip


def _off(simulation: Simulation, picked: Picked, rollout: Rollout) -> float | None:
    """Distance of the target's centre from its place at the end [m]; None without a carry.

    The place of the centre is that which the last leg plans for: the pose in which the tool took
    the target, carried along.
    """
    target, place = picked.reach.scene.target, picked.reach.scene.place
    if target is None or place is None or len(picked.legs) < 3:
        return None
    (*_, last) = picked.legs.values()
    held = next(one for one in last.scene.attached if one.id == target.id)
    robot, q = picked.reach.robot, last.trajectory.positions[-1]
    _, turns = robot.segment_frames(q)
    tip, _ = robot.tool_pose(q)
    wanted = tip + turns[-1] @ robot.tool_rotation @ held.position
    row = rollout.fruit_ids.index(target.id)
    return float(np.linalg.norm(rollout.fruit_positions[-1, row] - wanted))
