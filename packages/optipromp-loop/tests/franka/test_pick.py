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
from optipromp_sim.simulation.execute import Controlled
from optipromp_sim.simulation.outcome import Outcome
from optipromp_sim.simulation.parameters import EngineParameters
from optipromp_sim.simulation.rollouts import Pick

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
        eye = Eye(Detector(scene, self.controller.robot, DETECTORS["zero-mean"], seed))
        self.pick: Pick[Outcome] = Pick(Simulation(scene, seed), eye, EngineParameters().settle)
        self.agent, self.before, self.apart = Controlled(self.controller), self.pick.state, 0.0

    def __call__(self, now: float, measured: State, reference: State) -> Stretch | None:
        pick, before = self.pick, self.before
        count = round((now - pick.time) / pick.arena.tick)
        if count:
            pick.lead([
                State(
                    before.q + share * (measured.q - before.q),
                    before.velocity + share * (measured.velocity - before.velocity),
                )
                for share in np.arange(1, count + 1) / count
            ])  # fmt: skip
        self.apart = max(self.apart, float(np.abs(pick.state.q - measured.q).max()))
        self.before = measured
        stretch = self.agent.asked(pick, measured, reference)
        return stretch and Stretch(stretch.curve, stretch.begins - pick.began)


class Picked(NamedTuple):
    """What was executed, what became of the fruits, the reflexes, and the source."""

    executed: Executed
    outcome: Outcome
    reflexes: list[str]
    source: Source


def pick(seed: int) -> Picked:
    """A pick of a generated cluster."""
    scene = generate("cluster", seed)
    source = Source(scene, seed)
    with (
        serving(HOST, posed(scene)[1].q) as reflexes,
        PacedLoop(HOST, source.controller.robot) as arm,
    ):
        done = arm.follow(source, period=source.controller.parameters.period)
    return Picked(done, source.pick.judged(), reflexes, source)


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
