"""One run of a loop under a condition: open, with two looks, or closed."""

import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from optipromp.core.errors import Code, InvalidRequestError, OptiPrompError
from optipromp.core.planning import PlanOptions
from optipromp.core.planning.task import posed
from optipromp.core.robots.library import NOTHING, UNTRUSTED, Choice
from optipromp.core.scenes.values import suggest
from optipromp.core.trajectory import State
from optipromp.laboratory.experiments.baselines import Answer, attempt
from optipromp.laboratory.experiments.conditions import CONDITIONS, Situation
from optipromp.laboratory.experiments.eyes import NOT_SEEN, situation
from optipromp.laboratory.experiments.runs import ERROR, NO_PLAN, Row, outcome_values
from optipromp.laboratory.experiments.sources import Source, drawn, source_name
from optipromp.laboratory.generate import PANDA, Preset

if TYPE_CHECKING:
    from optipromp.laboratory.simulation import Loop, Run
from collections.abc import Sequence

from optipromp.core.execution.streaming import Stretch
from optipromp.core.judging import extremes
from optipromp.core.robots.model import Robot
from optipromp.core.trajectory import SHORTEST_STEP, Trajectory

LOOPS = "open", "looks", "closed"
"""``open``: the plan in the scene as first seen is executed blind; ``looks``: the arm goes to the
camera point, looks, and executes the plan made there blind; ``closed``: the controller."""

LOOP_PLANNER = "opti-promp"
_BLIND = {
    "plan_status": str(Code.NO_PLAN), "cause": NOT_SEEN, "result": "gave_up",
    "message": "no ripe fruit is seen",
}  # fmt: skip


@dataclass(frozen=True)
class LoopChoice:
    """What the runs of a study of loops share: robot, its arm, risk, version, eyes."""

    robot: str | Path = PANDA
    choice: Choice = NOTHING
    risk: float = PlanOptions.risk
    version: str = ""
    finder: str = ""
    views: int = 1


def check_loops(loops: Iterable[str], conditions: Iterable[str]) -> None:
    """Refuse names that are none."""
    for what, given, valid in (("loop", loops, LOOPS), ("condition", conditions, CONDITIONS)):
        for item in given:
            if item not in valid:
                raise InvalidRequestError(f"{what} is {item!r}: {suggest(item, valid)}")


def run_loops(
    source: Source, seed: int, condition: str, loops: Iterable[str], given: LoopChoice
) -> list[Row]:
    """Run loops on one scene under one condition; each run is a row, also where it raised."""
    scene, redraws = drawn(source, seed, given.robot, given.choice)
    rows, setting = [], None
    for loop in loops:
        try:
            setting = setting or situation(condition, scene, seed, given.finder, given.views)
            values = loop_values(setting, seed, loop, given.risk)
        except OptiPrompError as error:
            values = _broken(str(error.code), error.message)
        except Exception as error:  # the row tells of it, and the study goes on
            values = _broken(ERROR, f"{type(error).__name__}: {error}")
        rows.append(
            Row(
                preset=source_name(source),
                seed=seed,
                planner=LOOP_PLANNER,
                noise_position=0.0,
                noise_angle=0.0,
                pushables=len(scene.pushables),
                redraws=redraws,
                version=given.version,
                loop=loop,
                condition=condition,
                finder=given.finder,
                views=given.views if given.finder else None,
                **values,
            )
        )  # fmt: skip
    return rows


def loop_values(
    setting: Situation, seed: int, loop: str, risk: float = PlanOptions.risk
) -> dict[str, Any]:
    """The values of a row for one run.

    ``setting``: of a condition. ``seed``: of physics and looks; plans have the seed 0 in every
    loop. ``loop``: one of :data:`LOOPS`. ``risk``: of the plan of the open loop.
    """
    if loop == "open":
        return _open_values(setting, seed, risk)
    began = time.perf_counter()
    done = picked(setting, seed, servo=loop == "closed")
    outcome = done.run.outcome
    said = done.stage == "done" or outcome.success
    return {
        **setting.figures,
        **outcome_values(outcome, setting.scene.target),
        "plan_status": str(Code.SUCCESS if said else Code.NO_PLAN),
        "result": done.result,
        **loop_figures(done),
        "simulation_time": time.perf_counter() - began,
    }


def loop_figures(done: "Loop") -> dict[str, Any]:
    """Retreats, looks, times of cycles, innovations and smoothness of a pick; see :class:`Row`."""
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
        "worst_jump": curve.worst_jump,
        "worst_limit": curve.worst_limit,
    }


def picked(setting: Situation, seed: int, servo: bool = True) -> "Loop":
    """A pick in closed loop; without ``servo``, two looks."""
    from optipromp.control.controller import Controller
    from optipromp.laboratory.simulation import Eye, Simulation, closed_loop

    controller = Controller(setting.seen, servo=servo)
    simulation = Simulation(setting.scene, seed, setting.parameters)
    eye = Eye(setting.camera(setting.scene, controller.robot, setting.detector, seed))
    return closed_loop(simulation, controller, eye)


def loop_again(
    row: Row, robot: str = PANDA, risk: float = PlanOptions.risk, source: Source | None = None
) -> "Run | None":
    """A run made once more; see :func:`optipromp.laboratory.experiments.runs.again`."""
    scene, _ = drawn(source or cast(Preset, row.preset), row.seed, robot, UNTRUSTED)
    setting = situation(row.condition, scene, row.seed, row.finder, row.views or 1)
    if row.loop != "open":
        return picked(setting, row.seed, servo=row.loop == "closed").run
    if setting.seen.target is None:
        return None
    made, setting = _planned(setting, risk)
    if made.trajectory is None or made.status != Code.SUCCESS:
        return None
    return _blind(made, setting, row.seed)


def _open_values(setting: Situation, seed: int, risk: float) -> dict[str, Any]:
    if setting.seen.target is None:
        return {**setting.figures, **_BLIND}
    made, setting = _planned(setting, risk)
    values: Mapping[str, Any] = {
        **setting.figures,
        "plan_status": str(made.status),
        "plan_time": made.seconds,
        "predicted_harm": made.harm,
        "predicted_failure": made.failure,
        "tilt": made.tilt,
    }
    if made.trajectory is None or made.status != Code.SUCCESS:
        return {**values, "cause": NO_PLAN, "message": made.message, "result": "refused"}
    began = time.perf_counter()
    outcome = _blind(made, setting, seed).outcome
    harmed = any(cause != "not_picked" for cause in outcome.causes)
    return {
        **values,
        **outcome_values(outcome, setting.scene.target),
        "result": "clean" if outcome.success else "harmed" if harmed else "missed",
        "simulation_time": time.perf_counter() - began,
    }


def _planned(setting: Situation, risk: float) -> tuple[Answer, Situation]:
    """A plan in the scene as first seen, or after one picture more, and that setting."""
    made = attempt(setting.seen, LOOP_PLANNER, risk=risk)
    while made.status != Code.SUCCESS and setting.further is not None:
        further = setting.further()
        if further.seen.target is None:
            break
        setting = further
        made = attempt(setting.seen, LOOP_PLANNER, risk=risk)
    return made, setting


def _blind(made: Answer, setting: Situation, seed: int) -> "Run":
    from optipromp.laboratory.simulation import simulate

    assert made.trajectory is not None
    return simulate(made.trajectory, setting.scene, parameters=setting.parameters, seed=seed)


def _broken(status: str, message: str) -> dict[str, Any]:
    return {"plan_status": status, "cause": ERROR, "message": message, "result": ERROR}


@dataclass(frozen=True)
class Smoothness:
    """How smooth an executed curve is.

    Attributes:
        takeovers: number of stretches that took over.
        jumps: largest jump of a joint's position [rad or m], velocity [rad/s or m/s] and
            acceleration [rad/s² or m/s²] at a takeover.
        shares: largest share of the robot's limits of velocity, acceleration and jerk.
    """

    takeovers: int
    jumps: tuple[float, float, float]
    shares: tuple[float, float, float]

    @property
    def worst_jump(self) -> float:
        """Largest of ``jumps`` in its own unit."""
        return max(self.jumps)

    @property
    def worst_limit(self) -> float:
        """Largest of ``shares``."""
        return max(self.shares)


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
        jumps = np.maximum(jumps, _jumps(before, stretch.at(stretch.begins)))
        part = cut(stretch.curve, end - stretch.begins)
        if part is not None:
            shares = np.maximum(shares, (extremes(part).largest / limits).max(axis=1))
    return Smoothness(len(taken), _three(jumps), _three(shares))


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


def _jumps(before: State, after: State) -> np.ndarray:
    pairs = (
        (before.q, after.q),
        (before.velocity, after.velocity),
        (before.acceleration, after.acceleration),
    )
    return np.array([np.abs(b - a).max() for a, b in pairs])


def _three(values: np.ndarray) -> tuple[float, float, float]:
    a, b, c = (float(value) for value in values)
    return a, b, c
