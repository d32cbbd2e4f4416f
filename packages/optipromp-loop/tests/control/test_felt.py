"""What the arm feels at the end of a pick: the target's weight, nothing, or a stem that pulls."""

from dataclasses import replace

import numpy as np
import pytest

from optipromp.core.errors import InvalidRequestError
from optipromp_loop.control import Controller, LoopStage
from optipromp_loop.control.felt import Felt
from optipromp_loop.control.parameters import CONTROL
from optipromp_sim.generate import generate
from optipromp_sim.simulation import DETECTORS, Detector, Eye, Simulation
from optipromp_sim.simulation.execute import Controlled
from optipromp_sim.simulation.rollouts import Pick, rollout

FINE = replace(CONTROL, weight_error=0.02)  # [N] of a sensor in the wrist
UP = np.array([0.0, 0.0, 1.0])
DRIFT = np.array([0.3, -0.1, 0.4])  # [N] that the arm feels of nothing


class Careless(Pick):
    """A gripper that never closes."""

    def take(self) -> None:
        self.taken = self.point()


@pytest.mark.parametrize(("kind", "stage"), [(Pick, "done"), (Careless, "gave_up")])
def test_a_pick_is_done_where_the_tool_feels_the_weight_of_its_target(kind, stage) -> None:
    scene = generate("cluster", 3)
    controller, simulation = Controller(scene, parameters=FINE), Simulation(scene)
    eye = Eye(Detector(scene, controller.robot, DETECTORS["zero-mean"]))
    pick = kind(simulation, eye, simulation.parameters.engine.settle)
    rollout(Controlled(controller), pick)
    assert controller.stage == LoopStage(stage), controller.events
    inside = scene.target.id in simulation.held()
    assert inside == (stage == "done")
    assert ("by its weight" in controller.events[-1].why) == inside


@pytest.mark.parametrize(
    ("load", "told"),
    [([0.0, 0.0, -1.4], ""), ([0.0, 0.0, 0.0], "empty"), ([0.2, 0.1, -0.3], "empty"),
     ([0.0, 0.0, 2.5], "3.9 N"), ([3.0, 0.0, -1.4], "3.0 N"), ([0.4, 0.3, -1.0], "")],
)  # fmt: skip
def test_a_load_is_the_target_or_nothing_or_a_stem(load, told) -> None:
    felt = Felt(UP, CONTROL)
    for k in range(100):
        felt.feel(0.02 * k, DRIFT if k < 50 else DRIFT + load)
    felt.stands_empty(0.98, 0.0)
    assert felt.tells(1.4)
    assert not felt.tells(0.2)
    mean = felt.mean(1.98, 1.0)
    assert told in felt.against(mean, 1.4)
    assert bool(told) == bool(felt.against(mean, 1.4))


def test_an_arm_that_moved_or_hears_nothing_is_not_asked() -> None:
    felt = Felt(UP, CONTROL)
    felt.feel(0.0, DRIFT)
    assert felt.mean(1.0, 0.0) is None
    assert felt.mean(0.1, 0.05) is None
    assert not felt.tells(100.0)
    with pytest.raises(InvalidRequestError, match="force"):
        felt.feel(0.0, np.array([np.nan, 0.0, 0.0]))
