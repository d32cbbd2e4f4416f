"""A pick in closed loop by libfranka and a simulated FR3; the fruits are those of our simulation.

The arm of the fruits' simulation follows the measured joints of the FR3, and a camera model looks
into that simulation. The FR3 does not feel the fruits.
"""

from typing import NamedTuple

import numpy as np
import pytest

from optipromp.core.execution.executor import Executed
from optipromp.core.execution.streaming import Stretch
from optipromp.core.planning.task import posed
from optipromp.core.scenes.scene import Scene
from optipromp.core.trajectory import State
from optipromp_loop.control.controller import Controller
from optipromp_loop.control.stages import LoopStage
from optipromp_sim.generate import generate
from optipromp_sim.simulation import DETECTORS, Detector, Eye, Simulation
from optipromp_sim.simulation.detector import Truth
from optipromp_sim.simulation.outcome import Outcome

pytest.importorskip("franky", exc_type=ImportError)
pytest.importorskip("franky_sim", exc_type=ImportError)

from tests.franka.paced import Paced
from tests.franka.server import serving

HOST = "127.0.48.12"


class PacedLoop(Paced):
    """The arm's time stands still while the source works, as a simulation's does."""

    synchronous = True


class Source:
    """A controller that sees fruits among which the arm moves as it is measured."""

    def __init__(self, scene: Scene, seed: int) -> None:
        self.controller = Controller(scene)
        self.simulation = Simulation(scene, seed)
        self.eye = Eye(Detector(scene, self.controller.robot, DETECTORS["zero-mean"], seed))
        self.before = self.simulation.state()
        for _ in range(round(self.simulation.parameters.engine.settle / self.simulation.tick)):
            self.simulation.step(State(self.before.q))
        self.began, self.apart = self.simulation.time, 0.0

    def __call__(self, now: float, measured: State, reference: State) -> Stretch | None:
        simulation, controller, before = self.simulation, self.controller, self.before
        count = round((self.began + now - simulation.time) / simulation.tick)
        for share in np.arange(1, count + 1) / max(count, 1):
            q = before.q + share * (measured.q - before.q)
            velocity = before.velocity + share * (measured.velocity - before.velocity)
            state = simulation.step(State(q, velocity))
            self.apart = max(self.apart, float(np.abs(state.q - q).max()))
        self.before, fruits = measured, simulation.fruits()
        truth = Truth(fruits.ids, fruits.positions, fruits.rotations, fruits.stem_ends)
        self.eye.see(now, measured.q, truth)
        for look in self.eye.delivered(now):
            controller.see(look)
        stretch = controller(now, measured, reference)
        if controller.holding:
            simulation.close()
        return stretch


class Pick(NamedTuple):
    """What was executed, what became of the fruits, the reflexes, and the source."""

    executed: Executed
    outcome: Outcome
    reflexes: list[str]
    source: Source


def pick(seed: int) -> Pick:
    """A pick of a generated cluster."""
    scene = generate("cluster", seed)
    source = Source(scene, seed)
    with (
        serving(HOST, posed(scene)[1].q) as reflexes,
        PacedLoop(HOST, source.controller.robot) as arm,
    ):
        done = arm.follow(source, period=source.controller.parameters.period)
    return Pick(done, source.simulation.outcome(), reflexes, source)


def test_a_fruit_is_picked_by_what_the_camera_sees() -> None:
    done, outcome, reflexes, source = pick(30000)
    print(
        f"{outcome.message} {done.times[-1]:.1f} s, {len(source.controller.plans)} plans, "
        f"joints at most {1e3 * done.largest_error:.1f} mrad from the curve, reflexes {reflexes}"
    )
    assert done.finished, done.reason
    assert (done.refused, done.missed, reflexes) == ((), 0, [])
    assert source.controller.stage is LoopStage.DONE
    assert outcome.success, outcome.message
    assert done.largest_error < 0.01
    assert source.apart < 0.005  # [rad] of the arm among the fruits from the FR3
