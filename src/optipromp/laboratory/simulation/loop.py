"""The closed loop in the simulation: a controller moves the arm by what a camera model sees."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from optipromp.control.controller import Controller, Stage
from optipromp.control.look import Look
from optipromp.core.arrays import FloatArray
from optipromp.core.execution.streaming import Stretch
from optipromp.core.trajectory import State
from optipromp.laboratory.simulation.detector import Eye, Truth
from optipromp.laboratory.simulation.outcome import Outcome
from optipromp.laboratory.simulation.simulation import Simulation

LONGEST = 60.0  # [s] of a pick, after which it ends: a choice
HOLD = 0.1  # [s] at the target before the judgement, beside the controller's own: a choice


@dataclass(frozen=True, eq=False)
class Trace:
    """What the controller saw and did, for films and figures.

    Attributes:
        times: (C,) of the cycles [s].
        stages: C stages.
        looks: all looks that reached the controller.
        tracks: C snapshots of the tracked fruits.
        stretches: all stretches that took over.
    """

    times: FloatArray
    stages: tuple[Stage, ...]
    looks: tuple[Look, ...]
    tracks: tuple[Any, ...]
    stretches: tuple[Stretch, ...]


@dataclass(frozen=True, eq=False)
class Loop:
    """A pick in closed loop.

    Attributes:
        outcome: the judgement of the run.
        stage: with which the controller ended.
        trace: see :class:`Trace`.
        controller: with its events and its tracker.
    """

    outcome: Outcome
    stage: Stage
    trace: Trace
    controller: Controller = field(repr=False)


def closed_loop(simulation: Simulation, controller: Controller, eye: Eye) -> Loop:
    """Let the controller pick in the simulation until it ends."""
    period = round(controller.parameters.period / simulation.tick)
    running: Stretch | None = None
    coming: list[Stretch] = []
    times, stages, looks, tracks, stretches = [], [], [], [], []
    state, reference = simulation.state(), State(simulation.state().q)
    while not simulation.broken and simulation.time < LONGEST:
        now = simulation.time
        fruits = simulation.fruits()
        truth = Truth(fruits.ids, fruits.positions, fruits.rotations, fruits.stem_ends)
        eye.see(now, state.q, truth)
        for look in eye.delivered(now):
            controller.see(look)
            looks.append(look)
        stretch = controller(now, state, reference)
        if stretch is not None:
            coming.append(stretch)
            stretches.append(stretch)
        times.append(now)
        stages.append(controller.stage)
        tracks.append(controller.tracker.at(now))
        if controller.ended and not coming and (
            running is None or now > running.begins + running.curve.duration
        ):
            break
        for k in range(period):
            at = now + k * simulation.tick
            while coming and coming[0].begins <= at + 1e-9:
                running = coming.pop(0)
            if running is not None:
                reference = running.curve.at(at - running.begins)
            state = simulation.step(reference)
    outcome = simulation.outcome()
    trace = Trace(np.array(times), tuple(stages), tuple(looks), tuple(tracks), tuple(stretches))
    return Loop(outcome, controller.stage, trace, controller)
