"""The step API of the simulation: the same physics as ``simulate``, seen from inside."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from optipromp.core.errors import ExecutionError, InvalidRequestError
from optipromp.core.scenes.scene import Scene
from optipromp.core.trajectory import State, Trajectory
from optipromp_sim.simulation import SimulatedArm, Simulation, simulate
from optipromp_sim.simulation.records import Rollout

Bench = Any  # of conftest.py

SAME = ("times", "q", "velocity", "torque", "states", "fruit_positions", "fruit_force", "contacts")


def pair(bench: Bench) -> Scene:
    return bench.scene(
        bench.fruit("ripe", (0.0, 0.0, 0.5)),
        bench.fruit("green", (0.06, 0.0, 0.5), role="pushable"),
    )


def push(bench: Bench) -> Trajectory:
    """Under the fruits, through both of them, to beside them."""
    return bench.line((-0.1, 0.0, 0.5), (0.1, 0.0, 0.5), seconds=1.0)


def stepped(simulation: Simulation, motion: Trajectory, count: int | None = None) -> None:
    """Feed the samples of a motion, then its end at rest for ``control.hold``."""
    tick, hold = simulation.tick, simulation.parameters.control.hold
    moving = round(motion.duration / tick)
    at = np.arange(moving + round(hold / tick))
    q, velocity, acceleration = motion.sample(at * tick)
    still = at > moving
    velocity[still], acceleration[still] = 0.0, 0.0
    for row in range(count or len(at)):
        simulation.step(State(q[row], velocity[row], acceleration[row]))


def assert_same(one: Rollout, other: Rollout) -> None:
    for name in SAME:
        assert getattr(one, name).tobytes() == getattr(other, name).tobytes(), name


def test_steps_are_the_run_of_simulate_to_the_last_bit(bench: Bench) -> None:
    scene, motion = pair(bench), push(bench)
    run = simulate(motion, scene, seed=3)
    simulation = Simulation(scene, 3, q=motion.positions[0])
    assert simulation.tick == 1.0 / simulation.parameters.control.rate
    stepped(simulation, motion)
    assert_same(simulation.rollout(), run.rollout)
    assert max(run.outcome.peak_force.values()) > 0.05  # it pushed


def test_a_reset_gives_the_same_again_and_another_seed_another_world(bench: Bench) -> None:
    scene, motion = pair(bench), push(bench)
    simulation = Simulation(scene, q=motion.positions[0])
    stepped(simulation, motion, 600)
    first = simulation.rollout()
    begin = simulation.reset()
    assert simulation.time == 0.0
    np.testing.assert_array_equal(begin.q, motion.positions[0])
    stepped(simulation, motion, 600)
    assert_same(simulation.rollout(), first)
    simulation.reset(seed=5)
    other = simulation.fruits().stem_ends[0]
    simulation.reset(seed=0)
    assert np.abs(other - simulation.fruits().stem_ends[0]).max() > 1e-4  # another bow
    assert simulation.reset(q=np.array([0.1, 0.2, 0.3])).q.tolist() == [0.1, 0.2, 0.3]
    elsewhere = Simulation(scene, 5, q=motion.positions[0]).fruits().stem_ends[0]
    np.testing.assert_array_equal(elsewhere, other)


def test_the_state_follows_the_reference(bench: Bench) -> None:
    motion = bench.line((0.3, 0.0, 0.3), (0.4, 0.1, 0.3), seconds=1.0)
    simulation = Simulation(pair(bench), q=motion.positions[0])
    for k in range(500):
        state = simulation.step(motion.at(k * simulation.tick))
    wanted = motion.at(simulation.time)
    np.testing.assert_allclose(state.q, wanted.q, atol=2e-3)
    np.testing.assert_allclose(state.velocity, wanted.velocity, atol=0.02)
    np.testing.assert_array_equal(state.acceleration, motion.at(0.499).acceleration)
    assert simulation.time == pytest.approx(0.5)


def test_fruits_are_where_the_scene_has_them_and_move_as_pushed(bench: Bench) -> None:
    scene, motion = pair(bench), push(bench)
    simulation = Simulation(scene, q=motion.positions[0])
    now = simulation.fruits()
    assert now.ids == ("ripe", "green")
    assert now.roles == ("target", "pushable")
    for k, item in enumerate(scene.objects):
        np.testing.assert_array_equal(now.positions[k], item.position)
        np.testing.assert_allclose(now.stem_ends[k][0], item.stem.root, atol=1e-12)
        np.testing.assert_allclose(now.stem_ends[k][-1], item.position + [0, 0, 0.015], atol=1e-12)
    np.testing.assert_array_equal(now.rotations, np.tile(np.eye(3), (2, 1, 1)))
    assert now.attached.all()
    pieces = [np.linalg.norm(np.diff(ends, axis=0), axis=1) for ends in now.stem_ends]
    before = []
    stepped(simulation, motion, 500)
    while not simulation.fruits().velocities[0].any() or len(before) < 2:
        before.append(simulation.fruits().positions)
        simulation.step(motion.at(simulation.time))
    later = simulation.fruits()
    moved = (later.positions - before[-1]) / simulation.tick
    np.testing.assert_allclose(moved, later.velocities, atol=1e-6)  # semi-implicit Euler
    assert np.linalg.norm(later.positions[0] - now.positions[0]) > 5e-3
    for k, ends in enumerate(later.stem_ends):  # pieces keep their lengths, the root its place
        np.testing.assert_allclose(np.linalg.norm(np.diff(ends, axis=0), axis=1), pieces[k])
        np.testing.assert_allclose(ends[0], now.stem_ends[k][0], atol=1e-12)
        mouth = later.positions[k] + later.rotations[k] @ [0.0, 0.0, 0.015]
        np.testing.assert_allclose(ends[-1], mouth, atol=1e-3)


def test_the_wrench_is_the_sum_of_the_forces_on_the_tool(bench: Bench) -> None:
    motion = push(bench)
    simulation = Simulation(pair(bench), q=motion.positions[0])
    assert not simulation.wrench().any()
    largest = 0.0
    for k in range(700):
        state = simulation.step(motion.at(k * simulation.tick))
        touches = [t for t in simulation.contacts() if "tool:tool" in (t.first, t.second)]
        on_tool = [t.force if t.second.startswith("tool:") else -t.force for t in touches]
        point = simulation.robot.tool_pose(state.q)[0]
        lever = [np.cross(t.point - point, f) for t, f in zip(touches, on_tool, strict=True)]
        wrench = simulation.wrench()
        np.testing.assert_allclose(wrench[:3], np.sum(on_tool, axis=0) if touches else 0.0)
        np.testing.assert_allclose(wrench[3:], np.sum(lever, axis=0) if touches else 0.0)
        largest = max(largest, -wrench[0])
    assert largest > 0.05  # the tool goes along x, and is held back


def test_it_is_judged_and_a_break_is_told(bench: Bench) -> None:
    simulation = Simulation(pair(bench), q=np.array([0.5, 0.5, -0.5]))
    outcome = simulation.outcome()
    assert outcome.picked is False
    assert simulation.time == pytest.approx(simulation.parameters.control.hold)
    assert not simulation.broken
    simulation.data.xfrc_applied[simulation.world.fruits[0].body, 0] = np.nan
    for _ in range(2):
        with pytest.raises(ExecutionError, match=r"broke down: .* at 0\.50\d s"):
            simulation.step(simulation.reference)
    assert simulation.broken
    assert simulation.outcome().warnings
    simulation.reset()
    assert not simulation.broken
    with pytest.raises(InvalidRequestError, match="record_rate"):
        Simulation(pair(bench), record_rate=0.0)


def test_an_arm_gives_access_to_its_simulation(bench: Bench) -> None:
    motion = bench.line((0.3, 0.0, 0.3), (0.4, 0.1, 0.3), seconds=0.5)
    scene = replace(pair(bench), start=motion.positions[0])
    arm, seen = SimulatedArm(scene), list[float]()
    assert arm.execute(motion, lambda now, _: seen.append(arm.simulation.time - now)).finished
    np.testing.assert_allclose(seen, 0.0, atol=1e-9)
    assert arm.simulation.time == arm.time
    np.testing.assert_array_equal(arm.simulation.reference.q, motion.at(motion.duration).q)


def test_a_slower_controller_takes_longer_steps(bench: Bench) -> None:
    parameters = bench.parameters(control={"rate": 250.0})
    simulation = Simulation(pair(bench), 0, parameters)
    assert simulation.tick == pytest.approx(0.004)
    simulation.step(simulation.reference)
    assert simulation.time == pytest.approx(0.004)
