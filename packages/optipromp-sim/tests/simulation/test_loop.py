"""Picks in closed loop in the physics: what is picked, how smoothly, and what is left alone."""

import numpy as np
import pytest
from tests.control.benches import in_order

from optipromp.core.execution.streaming import Stretch
from optipromp.core.planning.task import posed
from optipromp.core.trajectory import State
from optipromp_loop.control.controller import Controller
from optipromp_loop.control.stages import LoopStage
from optipromp_sim.generate import Preset, generate
from optipromp_sim.simulation import Detector, Eye, Loop, SimulatedArm
from optipromp_sim.situations import CONDITIONS, Situation, executed, picked


def situation(name: str, seed: int, preset: Preset = "cluster") -> Situation:
    return CONDITIONS[name](generate(preset, seed), seed)


@pytest.fixture(scope="session")
def noisy_pick() -> Loop:
    """A pick with zero-mean errors of the first scene and of all looks."""
    return picked(situation("zero-mean", 101), 101)


def assert_sound(loop: Loop) -> None:
    """Legal stages, no jump, and limits that are kept."""
    controller = loop.controller
    assert in_order(event.stage for event in controller.events)
    start = State(posed(controller.scene, controller.robot)[1].q)
    until = float(loop.run.outcome.duration)
    curve = executed(loop.trace.stretches, controller.robot, start, until)
    assert len(loop.trace.stretches) > 10
    assert curve.jumps.max() <= 1e-6
    assert curve.shares.max() <= 1.0


@pytest.mark.parametrize(("preset", "seed"), [("cluster", 100), ("vine", 10), ("trusses", 1)])
def test_fruits_seen_exactly_are_picked(preset: Preset, seed: int) -> None:
    loop = picked(situation("none", seed, preset), seed)
    assert_sound(loop)
    assert (loop.result, loop.stage) == ("clean", LoopStage.DONE)
    stages = [event.stage for event in loop.controller.events]
    assert stages == ["travel", "observe", "push", "take", "leave", "done"]


def test_the_tool_leaves_swaying_fruits_with_the_target() -> None:
    loop = picked(situation("sway", 173_010), 173_010)
    assert_sound(loop)
    assert (loop.result, loop.stage) == ("clean", LoopStage.DONE)
    out = [event.time for event in loop.controller.events if event.stage is LoopStage.LEAVE][-1]
    run, robot = loop.run.rollout, loop.controller.robot
    tips, _ = robot.tool_pose(run.reference)
    late = run.times >= out
    target = run.fruit_positions[late, run.fruit_ids.index("ripe")]
    assert np.linalg.norm(tips[late][-1] - tips[late][0]) > 0.08
    held = np.linalg.norm(target - tips[late], axis=1)
    assert np.ptp(held) < 0.01


def test_fruits_seen_with_errors_are_picked(noisy_pick: Loop) -> None:
    assert_sound(noisy_pick)
    assert (noisy_pick.result, noisy_pick.stage) == ("clean", LoopStage.DONE)


def test_the_same_seed_gives_the_same_pick_to_the_bit(noisy_pick: Loop) -> None:
    again = picked(situation("zero-mean", 101), 101)
    assert again.controller.events == noisy_pick.controller.events
    for one, other in zip(again.controller.plans, noisy_pick.controller.plans, strict=True):
        assert all(map(np.array_equal, one.trajectory.rows(), other.trajectory.rows()))
    assert repr(again.run.outcome) == repr(noisy_pick.run.outcome)
    for name, values in noisy_pick.run.rollout.arrays().items():
        np.testing.assert_array_equal(again.run.rollout.arrays()[name], values)


def test_a_neighbour_that_was_missed_is_seen_and_the_pick_is_clean() -> None:
    given = situation("missed", 100)
    (missed,) = {o.id for o in given.scene.objects} - {o.id for o in given.seen.objects}
    loop = picked(given, 100)
    assert_sound(loop)
    assert (loop.result, loop.stage) == ("clean", LoopStage.DONE)
    goes = [event.time for event in loop.controller.events if event.stage is LoopStage.PUSH]
    row = int(np.searchsorted(loop.trace.times, goes[0]))  # from the camera point
    found, true = loop.trace.tracks[row], loop.run.rollout
    place = true.fruit_positions[np.searchsorted(true.times, goes[0]), true.fruit_ids.index(missed)]
    assert np.linalg.norm(found.positions[found.confirmed] - place, axis=1).min() < 0.01
    assert loop.trace.tracks[0].ids == ("ripe",)
    assert loop.controller.plans[1].scene.pushables


@pytest.mark.slow
@pytest.mark.parametrize(
    ("condition", "reason"),
    [
        ("near", ""),
        ("frozen", "the camera's picture stands still while the camera moves"),
        ("early", "ms early, by the pictures; they are corrected"),
    ],
)
def test_a_fault_of_the_camera_harms_nothing(condition: str, reason: str) -> None:
    loop = picked(situation(condition, 170_000), 170_000)
    assert_sound(loop)
    assert (loop.result, loop.stage) == ("clean", LoopStage.DONE)
    assert any(reason in event.why for event in loop.controller.history)


@pytest.mark.slow
def test_a_target_whose_stem_breaks_ends_the_pick() -> None:
    loop = picked(situation("breaks", 170_001), 170_001)
    assert_sound(loop)
    assert (loop.result, loop.stage) == ("gave_up", LoopStage.GAVE_UP)
    assert loop.controller.events[-1].why == "the target falls: its stem broke"
    assert not loop.run.rollout.attached[-1, loop.run.rollout.fruit_ids.index("ripe")]
    assert not loop.run.outcome.torn


def test_an_executor_follows_the_controller() -> None:
    """The contract of executors: no stretch is refused or comes too late."""
    given = situation("zero-mean", 101)
    arm = SimulatedArm(given.scene, parameters=given.parameters, seed=101)
    controller = Controller(given.seen, robot=arm.robot)
    eye = Eye(Detector(given.scene, arm.robot, given.detector, 101))

    def source(now: float, measured: State, reference: State) -> Stretch | None:
        eye.see(now, measured.q, arm.simulation.fruits())
        for look in eye.delivered(now):
            controller.see(look)
        if controller.holding:
            arm.simulation.close()
        return controller(now, measured, reference)

    done = arm.follow(source, period=controller.parameters.period)
    assert done.finished, done.reason
    assert (done.refused, done.missed) == ((), 0)
    assert controller.stage is LoopStage.DONE
    assert arm.outcome().success
