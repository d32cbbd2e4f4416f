"""The contract of an executor, run on the simulated arm; and what the followers refuse."""

import time
from collections.abc import Iterator

import pytest
from tests.execution.arms import PERIOD, Controlled
from tests.execution.streams import quiet

from optipromp.core.errors import InvalidRequestError
from optipromp.core.execution import Executor
from optipromp.core.execution.contract import ExecutorContract
from optipromp.core.planning import plan
from optipromp.core.scenes import load_scene
from optipromp_loop.control import Franky
from optipromp_sim.generate import generate
from optipromp_sim.simulation import SimulatedArm, simulate


class TestSimulatedArm(ExecutorContract):
    """The simulation passes what every executor must."""

    def executor(self) -> Executor:
        self.arm = SimulatedArm(load_scene("scenario-3"))
        return self.arm

    def clock(self) -> float:
        return self.arm.time


def test_a_plan_executed_by_the_arm_ends_as_it_does_in_the_simulation() -> None:
    scene = generate("cluster", 61204)
    arm = SimulatedArm(scene)
    made = plan(scene, start_state=arm.state())
    assert made.success
    assert arm.execute(made.trajectory).finished
    outcome, wanted = arm.outcome(), simulate(made).outcome
    assert outcome.success
    assert (outcome.picked, outcome.cause) == (wanted.picked, wanted.cause)
    for fruit, force in wanted.peak_force.items():
        assert outcome.peak_force[fruit] == pytest.approx(force, rel=0.2, abs=0.1)


def test_what_runs_is_planned_again_from_where_the_arm_was_stopped() -> None:
    scene = generate("cluster", 61204)
    arm = SimulatedArm(scene)
    first = plan(scene)
    done = arm.execute(first.trajectory, lambda now, _: now > 0.5)
    assert not done.finished
    again = plan(scene, start_state=arm.state())
    assert arm.execute(again.trajectory).finished
    assert arm.outcome().success


class InRealTime(Controlled):
    """An arm whose ticks come by the clock, and whose source is asked by a thread of its own."""

    synchronous = False

    def _ticks(self) -> Iterator[float]:
        began = time.perf_counter()
        while True:
            yield time.perf_counter() - began
            time.sleep(PERIOD)


class TestInRealTime(ExecutorContract):
    duration = 0.6

    def executor(self) -> Executor:
        return InRealTime(quiet, late=2.0)  # a machine that runs other tests may let a tick wait


def test_without_the_makers_package_the_refusal_says_what_to_install(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "franky", None)
    with pytest.raises(InvalidRequestError, match="pip install franky-control"):
        Franky("nowhere")
