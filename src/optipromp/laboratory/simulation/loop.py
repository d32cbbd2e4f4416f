"""The closed loop in the simulation: a controller moves the arm by what a camera model sees."""

from __future__ import annotations

import time as wall
from dataclasses import dataclass, field

import numpy as np

from optipromp.control.controller import Controller, LoopStage
from optipromp.control.look import Look
from optipromp.control.tracker import Tracked
from optipromp.core.arrays import FloatArray, IntArray
from optipromp.core.errors import ExecutionError
from optipromp.core.execution.streaming import Stretch
from optipromp.core.planning.legs import Picked
from optipromp.core.trajectory import State
from optipromp.laboratory.simulation.detector import Detector, Eye, Truth
from optipromp.laboratory.simulation.execute import Run, bring
from optipromp.laboratory.simulation.simulation import Simulation

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
        picked: reach, retreat and, in a scene with a place, carry after a reach that succeeded.
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


def closed_loop(
    simulation: Simulation, controller: Controller, eye: Eye, *, wrench: bool = False
) -> Loop:
    """Let the controller pick in the simulation until it ends, and judge what happened.

    After a pick, the retreat of :func:`optipromp.plan_pick` follows, in a scene with a place the
    carry, too, planned from where the arm is by then and executed without looks.

    Args:
        simulation: of the true scene, with its disturbances.
        controller: of the same robot.
        eye: the camera.
        wrench: whether the arm reports the force on its tool.
    """
    began = wall.perf_counter()
    cycle = round(controller.parameters.period / simulation.tick)
    line = _Line()
    cycles, looks, stretches = [], [], []
    state = simulation.state()
    reference = State(state.q)
    for _ in range(round(simulation.parameters.engine.settle / simulation.tick)):
        state = simulation.step(reference)
    begin, gripped = simulation.time, False
    target = None if simulation.scene.target is None else simulation.scene.target.id
    while simulation.time < begin + LONGEST:
        now, fruits = simulation.time, simulation.fruits()
        eye.see(
            now, state.q, Truth(fruits.ids, fruits.positions, fruits.rotations, fruits.stem_ends)
        )
        for look in eye.delivered(now):
            controller.see(look)
            looks.append(look)
        if wrench:
            controller.feel(simulation.wrench()[:3])
        stretch = controller(now, state, reference)
        if controller.holding and not gripped:
            gripped = True
            if target in simulation.held():
                simulation.grip()
        if stretch is not None:
            line.coming.append(stretch)
            stretches.append(stretch)
        tracked = controller.tracker.at(now)
        cycles.append((now, controller.stage, tracked, len(controller.plans)))
        if controller.ended and line.ended(now):
            break
        try:
            for k in range(cycle):
                reference = line.at(now + k * simulation.tick, reference)
                state = simulation.step(reference)
        except ExecutionError:  # the outcome tells of it
            break
    moved = simulation.time
    outcome, rollout, picked = simulation.outcome(), simulation.rollout(moved), None
    if outcome.picked is not None and controller.robot.tool is not None and not gripped:
        set_out = max((e.time for e in controller.events if e.stage is LoopStage.GO), default=0.0)
        q = rollout.reference[rollout.times >= set_out]
        q = np.vstack([q, simulation.reference.q])
        done = rollout, outcome
        rollout, outcome, picked = bring(simulation, controller, q, done)
    run = Run(
        simulation.scene, simulation.robot, simulation.parameters, simulation.seed,
        rollout, outcome, wall.perf_counter() - began,
    )  # fmt: skip
    times, stages, tracks, plans = zip(*cycles, strict=True)
    trace = Trace(
        np.array(times), stages, tuple(looks), tracks, tuple(stretches),
        np.array(plans, dtype=np.int64),
    )  # fmt: skip
    return Loop(run, controller.stage, trace, controller, eye.detector, picked)


@dataclass
class _Line:
    """The stretch that runs, and those that take over later."""

    running: Stretch | None = None
    coming: list[Stretch] = field(default_factory=list)

    def at(self, time: float, before: State) -> State:
        """The reference at a ``time`` [s]; ``before``: that of the tick before."""
        while self.coming and self.coming[0].begins <= time + 1e-9:
            self.running = self.coming.pop(0)
        return before if self.running is None else self.running.at(time)

    def ended(self, time: float) -> bool:
        """Whether the last stretch has come to its end."""
        return not self.coming and (self.running is None or self.running.ended(time))
