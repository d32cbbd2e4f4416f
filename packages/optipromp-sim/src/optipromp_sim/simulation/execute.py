"""``simulate``: a plan is executed. ``closed_loop``: a controller moves the arm by what it sees."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optipromp.core.arrays import FloatArray, IntArray
from optipromp.core.errors import Code, InvalidRequestError, OptiPrompError
from optipromp.core.execution.executor import standing
from optipromp.core.execution.streaming import Line, Stretch
from optipromp.core.planning import Plan, plan
from optipromp.core.planning.leg_tasks import carried
from optipromp.core.planning.legs import Picked
from optipromp.core.planning.result import AFTER, CARRY, REACH, RETREAT
from optipromp.core.planning.task import posed
from optipromp.core.robots.model import Robot
from optipromp.core.scenes.look import Look
from optipromp.core.scenes.scene import Scene, SceneObject
from optipromp.core.shown import Shown
from optipromp.core.trajectory import State, Trajectory
from optipromp.looks.viewer.serving import FRAME_RATE, FRAMES, REST, recording
from optipromp_loop.control.controller import Controller
from optipromp_loop.control.stages import LoopStage
from optipromp_loop.control.tracker import Tracked
from optipromp_sim.simulation.detector import Detector, Eye
from optipromp_sim.simulation.engine import engine
from optipromp_sim.simulation.outcome import Cause, Outcome
from optipromp_sim.simulation.parameters import SimulationParameters
from optipromp_sim.simulation.records import Rollout
from optipromp_sim.simulation.rollouts import Legs, Pick, rollout
from optipromp_sim.simulation.simulation import Simulation
from optipromp_sim.simulation.world import World, build

if TYPE_CHECKING:
    from optipromp.looks.viewer.html import View3D


class Displaced(NamedTuple):
    """An object at its place of a moment."""

    item: SceneObject
    position: FloatArray  # (3,) [m]
    rotation: FloatArray  # (3, 3)
    stem: FloatArray | None  # (k, 3) points, root first [m]


class Moving:
    """The objects of a ``world`` that move."""

    def __init__(self, world: World) -> None:
        self.world, self._data = world, world.data(world.robot.home)
        self._items = {item.id: item for item in world.scene.objects}

    def at(self, state: FloatArray) -> Iterator[Displaced]:
        """The objects where MuJoCo's generalised positions are ``state`` (nq,)."""
        data = self._data
        data.qpos[:] = state
        engine().mj_kinematics(self.world.model, data)
        for fruit in self.world.shown:
            place, turn = np.array(data.xpos[fruit.body]), data.xmat[fruit.body].reshape(3, 3)
            stem = fruit.stem(data) if fruit.built.has_stem else None
            yield Displaced(self._items[fruit.id], place, turn, stem)


@dataclass(frozen=True, eq=False, repr=False)
class Run(Shown):
    """An executed plan.

    Attributes:
        scene: in which the plan was executed.
        robot: with its tool.
        parameters: of the physics.
        seed: of everything random.
        rollout: the records of the run.
        outcome: the judgement of the run.
        seconds: wall time, building the world included.
    """

    scene: Scene
    robot: Robot
    parameters: SimulationParameters
    seed: int
    rollout: Rollout
    outcome: Outcome
    seconds: float

    @property
    def success(self) -> bool:
        """Whether the target alone is in the tool and nothing was harmed."""
        return self.outcome.success

    @property
    def real_time_factor(self) -> float:
        """Simulated time over wall time."""
        return float(self.rollout.times[-1]) / max(self.seconds, 1e-9)

    def _words(self) -> str:
        return f"in {self.scene.name}: {self.outcome.told}, {self.outcome.duration:.2f} s"

    def _table(self) -> Sequence[tuple[str, str]]:
        return [("message", self.outcome.message), *run_rows(self)]

    def show(self) -> View3D:
        """A 3-D view for notebooks: arm, fruits and stems as they moved, to turn and play.

        ``open()`` opens it in a browser. ``save(path)`` writes one HTML file that needs no network.

        Raises:
            InvalidRequestError: viser is not installed.
        """
        from optipromp.looks.viewer.html import View3D

        return View3D(run_page(self))


def simulate(
    plan_or_trajectory: Plan | Picked | Trajectory,
    scene: Scene | None = None,
    *,
    robot: Robot | None = None,
    parameters: SimulationParameters | None = None,
    seed: int = 0,
    record_rate: float = 100.0,
    failed_leg: bool = False,
) -> Run:
    """Execute a plan in the simulation and judge the run.

    Args:
        plan_or_trajectory: what to execute, whatever its status. Of a pick in several legs, all
            legs up to the one that failed; the outcome then says whether the target was placed.
        scene: the true scene; None: the scene of the plan. Another scene than the plan's shows the
            effect of detection errors.
        robot: with its tool; None: that of the plan, or of the scene of a bare trajectory.
        parameters: physical numbers, controller, thresholds.
        seed: of everything random. The same input and seed give the same run to the last bit.
        record_rate: of the rollout's records [Hz].
        failed_leg: of a pick, whether the best trajectory of the leg that failed is executed, too.

    Returns:
        The run. The outcome of a failed run names the cause; only wrong input raises.

    Raises:
        InvalidRequestError: MuJoCo is not installed, no scene for a bare trajectory, joint names
            that are not the robot's, a rate that is not positive.
        InvalidSceneError: something in the scene cannot be built.
    """
    began = time.perf_counter()
    parameters = parameters or SimulationParameters()
    picked = plan_or_trajectory if isinstance(plan_or_trajectory, Picked) else None
    given = plan_or_trajectory.reach if isinstance(plan_or_trajectory, Picked) else (
        plan_or_trajectory
    )  # fmt: skip
    if isinstance(given, Plan):
        trajectory = given.trajectory
        scene, robot = scene or given.scene, robot or given.robot
    else:
        trajectory = given
    if scene is None:
        raise InvalidRequestError("a bare trajectory needs the scene it is to be executed in")
    robot = robot or posed(scene)[0]
    if trajectory.joint_names != robot.joint_names:
        raise InvalidRequestError(
            f"the trajectory moves {', '.join(trajectory.joint_names)}; {robot.name} has "
            f"{', '.join(robot.joint_names)}"
        )
    curves = [trajectory] if picked is None else [trajectory, *_after(picked, failed_leg)]
    motions = [curve.slowed(1.0 / parameters.control.speed) for curve in curves]
    simulation = Simulation(
        scene, seed, parameters, robot=robot, q=motions[0].positions[0], record_rate=record_rate
    )
    pick = Pick(simulation)
    outcome, records = rollout(Legs(*motions), pick), pick.records
    assert records is not None
    if picked is not None:
        outcome = _placed(picked, records, outcome, parameters.thresholds.placed, failed_leg)
    return Run(scene, robot, parameters, seed, records, outcome, time.perf_counter() - began)


def _after(picked: Picked, failed_leg: bool) -> list[Trajectory]:
    """The legs that are executed once the reach has picked the target.

    A leg whose plan failed is executed with ``failed_leg`` only; without it the run ends before.
    """
    legs = (picked.legs.get(name) for name in AFTER)
    return [leg.trajectory for leg in legs if leg is not None and (leg.success or failed_leg)]


def _placed(
    picked: Picked, records: Rollout, outcome: Outcome, limit: float, failed_leg: bool
) -> Outcome:
    """The outcome of a pick whose legs were executed.

    The target is *placed* where its centre is within ``limit`` [m] of its place at the end of the
    carry. Without a place, the pick ends with the retreat.
    """
    placed = None if picked.reach.scene.place is None else False
    done = replace(outcome, placed=placed)
    if placed is not None and not picked.success:
        return _unplaced(done, f"of the plan, {picked.message} ({picked.status})")
    if placed is None and not picked.success and not failed_leg:
        done = replace(done, message=f"{done.message}; the way out failed: {picked.message}")
    if not done.success or placed is None:
        return done
    off = _off(picked, records)
    if off is None:
        return done
    if off > limit:
        message = f"the target ends {1e3 * off:.1f} mm from its place"
        return replace(_unplaced(done, message), message=message, placed_off=off)
    message = f"{outcome.message}; it was brought to its place, {1e3 * off:.1f} mm off"
    return replace(outcome, placed=True, placed_off=off, message=message)


def bring(
    simulation: Simulation, pick: Pick[Outcome], controller: Controller
) -> tuple[Rollout, Outcome, Picked | None]:
    """The carry after a pick in closed loop, planned from where the arm is by then.

    Returns: Records and judgement of the whole, and the pick with this carry; None without one.
    """
    outcome, done, place = pick.judged(), pick.records, controller.scene.place
    assert done is not None
    if place is None or not (outcome.success and controller.holding):
        return done, replace(outcome, placed=None if place is None else False), None
    legs = controller.picks[-1].legs
    scene, robot = carried(legs[RETREAT], place)
    try:
        made = plan(replace(scene, start=pick.reference.q), robot=robot)
    except OptiPrompError as error:
        return done, _unplaced(outcome, f"no way to the place: {error.message}"), None
    p, reach = simulation.parameters, replace(legs[REACH], status=Code.SUCCESS)  # it is executed
    picked = Picked({REACH: reach, CARRY: made})
    ways = (leg.slowed(1.0 / p.control.speed) for leg in _after(picked, False))
    outcome, records = rollout(Legs(*ways), pick), pick.records or done
    outcome = _placed(picked, records, outcome, p.thresholds.placed, False)
    return records, outcome, Picked({**legs, CARRY: made})


def _unplaced(outcome: Outcome, why: str) -> Outcome:
    """The outcome of a pick whose target was not brought to its place."""
    causes = (*outcome.causes, Cause.NOT_PLACED)
    return replace(
        outcome, success=False, cause=causes[0], causes=causes, placed=False,
        message=f"{why}; executed until then: {outcome.message}",
    )  # fmt: skip


def _off(picked: Picked, rollout: Rollout) -> float | None:
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


def run_rows(run: Run) -> list[tuple[str, str]]:
    """Names and values of what happened in a run, for tables."""
    rows, outcome = [], run.outcome
    if outcome.picked is not None:
        at = "" if outcome.swallowed_at is None else f" since {outcome.swallowed_at:.2f} s"
        rows.append(("target taken in", ("yes" if outcome.picked else "no") + at))
    if outcome.target_displacement is not None:
        rows.append(("target moved before", f"{1e3 * outcome.target_displacement:.1f} mm"))
    if outcome.placed is not None:
        at = "" if outcome.placed_off is None else f", {1e3 * outcome.placed_off:.1f} mm off"
        rows.append(("target placed", ("yes" if outcome.placed else "no") + at))
    for id_, force in outcome.peak_force.items():
        words = [f"at most {force:.2f} N"]
        if id_ in outcome.stem_tension:
            words.append(f"stem pulled {outcome.stem_tension[id_]:.2f} N")
        if outcome.stem_force.get(id_, 0.0) > 0.0:
            words.append(f"stem pressed {outcome.stem_force[id_]:.2f} N")
        words.append(f"moved {1e3 * outcome.displacement[id_]:.0f} mm")
        rows.append((id_, ", ".join(words)))
    for what, contacts in (
        ("static", outcome.static_contacts),
        ("cluster", outcome.avoid_contacts + outcome.tool_avoid_contacts),
    ):
        for c in contacts:
            spell = f"{c.peak_force:.2f} N for {c.duration:.2f} s from {c.first:.2f} s"
            rows.append((f"{c.link} on {c.other}", f"{spell} ({what})"))
    if (crop := outcome.crop) is not None:
        decided = f"decided by {', '.join(crop.decided)}; " if crop.decided else ""
        hangs = ", ".join(crop.hangs_on) or "none"
        rows.append(("crop", f"{crop.name}; {decided}guesses that it hangs on: {hangs}"))
    rows.append(("tracking error", f"{1e3 * outcome.tracking_error:.2f} mm"))
    speed = f"{run.real_time_factor:.1f} times as fast as it was"
    rows.append(("motion", f"{outcome.duration:.2f} s, simulated {speed}"))
    return rows


def run_page(run: Run) -> str:
    """The HTML of a run: arm, fruits and stems as they moved."""
    moving = Moving(build(run.scene, run.robot, run.parameters, run.seed))
    times = run.rollout.times
    count = min(max(round(FRAME_RATE * float(times[-1])), 1), FRAMES)
    shown = np.unique(np.linspace(0, len(times) - 1, count + 1).round().astype(int))
    with recording(run.scene, run.robot) as (nodes, record):
        for row, after in zip(shown, [*shown[1:], shown[-1]], strict=True):
            nodes.pose(run.rollout.q[row])
            for moved in moving.at(run.rollout.states[row]):
                nodes.put(*moved)
            record.insert_sleep(float(times[after] - times[row]))
        record.insert_sleep(REST)
        return str(record.as_html())


LONGEST = 90.0  # [s] of a pick, after which it ends: a choice


@dataclass(frozen=True, eq=False)
class Trace:
    """What the controller saw and did, for films and figures."""

    times: FloatArray  # (C,) of the cycles [s]
    stages: tuple[LoopStage, ...]  # C stages
    looks: tuple[Look, ...]  # all looks that reached the controller
    tracks: tuple[Tracked, ...]  # C snapshots of the tracked fruits
    stretches: tuple[Stretch, ...]  # all stretches that took over
    plans: IntArray  # (C,) number of plans that were followed until then


@dataclass(frozen=True, eq=False)
class Loop:
    """A pick in closed loop.

    Attributes:
        run: the records of the arm and the fruits, and the judgement.
        stage: with which the controller ended.
        trace: see :class:`Trace`.
        controller: with its events and its tracker.
        detector: the camera.
        picked: in a scene with a place, the pick with the carry that was executed.
    """

    run: Run
    stage: LoopStage
    trace: Trace
    controller: Controller = field(repr=False)
    detector: Detector = field(repr=False)
    picked: Picked | None = field(default=None, repr=False)

    @property
    def result(self) -> str:
        """``clean``, ``harmed``, ``gave_up`` or ``missed`` (unharmed, not picked or placed)."""
        result = self.run.outcome.result
        return "gave_up" if result == "missed" and self.stage is LoopStage.GAVE_UP else result


def closed_loop(simulation: Simulation, controller: Controller, eye: Eye) -> Loop:
    """Let the controller pick in the simulation until it ends, and judge what happened.

    In a scene with a place the carry follows, planned from where the arm is by then and executed
    without looks.

    Args:
        simulation: of the true scene, with its disturbances.
        controller: of the same robot.
        eye: the camera.
    """
    began = time.perf_counter()
    agent, p = Controlled(controller), simulation.parameters
    pick = Pick(simulation, eye, p.engine.settle, controller.parameters.period)
    rollout(agent, pick)
    records, outcome, picked = bring(simulation, pick, controller)
    run = Run(
        simulation.scene, simulation.robot, p, simulation.seed, records, outcome,
        time.perf_counter() - began,
    )  # fmt: skip
    return Loop(run, controller.stage, agent.trace(), controller, eye.detector, picked)


class Controlled:
    """A controller as an agent, until it has ended; it keeps what it saw and did."""

    def __init__(self, controller: Controller) -> None:
        self.controller = controller
        self._line: Line | None = None
        self._cycles: list[tuple[float, LoopStage, Tracked, int]] = []
        self._looks: list[Look] = []
        self._stretches: list[Stretch] = []

    def __call__(self, pick: Pick[Outcome]) -> list[State] | None:
        """The references of one cycle; see :class:`optipromp_sim.simulation.rollouts.Agent`."""
        controller, now, tick = self.controller, pick.arena.time, pick.arena.tick
        if now >= pick.began + LONGEST:
            return None
        stretch = self.asked(pick, pick.state, pick.reference)
        line = self._line or Line.of(standing(controller.robot, pick.reference), now)
        if stretch is not None:
            line = line.take(stretch, now, anew=controller.lost)
            self._stretches.append(stretch)
        tracked, count = controller.tracker.at(now), len(controller.plans)
        self._cycles.append((now, controller.stage, tracked, count))
        if (controller.ended or controller.lost) and (not self._stretches or line.ended(now)):
            return None
        self._line = line
        return [line.at(now + k * tick) for k in range(pick.ticks)]

    def asked(self, pick: Pick[Outcome], measured: State, reference: State) -> Stretch | None:
        """What the controller gives for what a pick shows and feels; it may take the target.

        For an arm that an executor leads, too: a source of its curves
        (:data:`optipromp.core.execution.streaming.Source`), by the clock of the pick.
        """
        controller, arena = self.controller, pick.arena
        for look in pick.looks:
            controller.see(look)
        self._looks += pick.looks
        controller.feel(arena.time, arena.wrench()[:3])
        stretch = controller(arena.time, measured, reference)
        target = arena.scene.target
        takes = controller.holding and pick.taken is None
        if takes and target is not None and target.id in arena.held():
            pick.take()
        return stretch

    def trace(self) -> Trace:
        """What the controller saw and did so far."""
        times, stages, tracks, plans = zip(*self._cycles, strict=True)
        return Trace(
            np.array(times), stages, tuple(self._looks), tracks, tuple(self._stretches),
            np.array(plans, dtype=np.int64),
        )  # fmt: skip
