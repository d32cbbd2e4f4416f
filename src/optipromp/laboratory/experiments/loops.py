"""Loops: what a pick is when it looks, and how smooth the executed curve was."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from optipromp.control.controller import Controller
from optipromp.core.arrays import FloatArray
from optipromp.core.execution.streaming import Stretch
from optipromp.core.judging import extremes
from optipromp.core.planning.task import posed
from optipromp.core.robots.model import Robot
from optipromp.core.trajectory import SHORTEST_STEP, State, Trajectory
from optipromp.laboratory.experiments.situations import Situation
from optipromp.laboratory.simulation import Eye, Loop, Simulation, closed_loop

LOOPS = "open", "looks", "closed"
"""``open``: the plan in the scene as first seen is executed blind; ``looks``: the arm goes to the
camera point, looks, and executes the plan made there blind; ``closed``: the controller."""
LOOP_PLANNER = "opti-promp"


def loop_figures(done: Loop) -> dict[str, Any]:
    """Retreats, looks, times of cycles, innovations and smoothness of a pick; see
    :data:`optipromp.laboratory.experiments.rows.STUDY`."""
    controller = done.controller
    cycles = np.array(controller.cycles)
    start = State(posed(controller.scene, controller.robot)[1].q)
    curve = executed(
        done.trace.stretches, controller.robot, start, float(done.run.outcome.duration)
    )
    nis = controller.tracker.statistics.consistent()[0]
    return {
        "retreats": sum(event.stage == "retreat" for event in controller.events),
        "looks": len(done.trace.looks),
        "cycle_median": float(np.median(cycles)),
        "cycle_p99": float(np.quantile(cycles, 0.99)),
        "nis": nis if np.isfinite(nis) else None,
        "worst_jump": float(curve.jumps.max()),
        "worst_limit": float(curve.shares.max()),
    }


def picked(setting: Situation, seed: int, servo: bool = True) -> Loop:
    """A pick in closed loop; without ``servo``, two looks."""
    leave = servo and setting.seen.place is None
    controller = Controller(setting.seen, servo=servo, leave=leave)
    simulation = Simulation(setting.scene, seed, setting.parameters)
    eye = Eye(setting.camera(setting.scene, controller.robot, setting.detector, seed))
    return closed_loop(simulation, controller, eye)


class Smoothness(NamedTuple):
    """How smooth an executed curve is."""

    jumps: FloatArray  # (3,) largest of a joint's position, velocity, acceleration at a takeover
    shares: FloatArray  # (3,) largest, of the robot's limits of velocity, acceleration and jerk


def executed(
    stretches: Sequence[Stretch], robot: Robot, start: State, until: float = np.inf
) -> Smoothness:
    """The jumps and the rates of the parts of stretches that were executed.

    A stretch runs from its begin until the next begins, by the executor's times.

    ``stretches``: in the order in which they took over. ``robot``: whose limits hold. ``start``: of
    the arm before the first stretch. ``until``: executor's time at which the run ended [s].
    """
    jumps, shares = np.zeros(3), np.zeros(3)
    limits = np.stack([robot.velocity, robot.acceleration, robot.jerk])
    taken = [stretch for stretch in stretches if stretch.begins < until]
    ends = [*(one.begins for one in taken[1:]), until][: len(taken)]
    for k, (stretch, end) in enumerate(zip(taken, ends, strict=True)):
        before = start if k == 0 else taken[k - 1].at(stretch.begins)
        both = (vars(state).values() for state in (before, stretch.at(stretch.begins)))
        jumps = np.maximum(jumps, [np.abs(b - a).max() for a, b in zip(*both, strict=True)])
        part = cut(stretch.curve, end - stretch.begins)
        if part is not None:
            shares = np.maximum(shares, (extremes(part).largest / limits).max(axis=1))
    return Smoothness(jumps, shares)


def cut(curve: Trajectory, length: float) -> Trajectory | None:
    """The first ``length`` seconds of a curve, exactly; None where nothing is left."""
    if length >= curve.duration:
        return curve
    if length < 2.0 * SHORTEST_STEP:
        return None
    times = curve.times[curve.times < length - SHORTEST_STEP]
    kept = len(times)
    q, v, a = (
        np.concatenate([whole[:kept], end])
        for whole, end in zip(curve.rows(), curve.sample(length), strict=True)
    )
    return Trajectory(np.append(times, length), q, v, a, curve.joint_names)
