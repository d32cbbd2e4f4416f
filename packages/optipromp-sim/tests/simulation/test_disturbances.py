"""Disturbances: each does to the world what its parameter says, and nothing by default."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from optipromp.core.arrays import FloatArray
from optipromp.core.errors import InvalidRequestError
from optipromp.core.planning.task import resolve
from optipromp.core.scenes.io import load_scene
from optipromp.core.scenes.scene import Scene, SceneObject
from optipromp_sim.generate import generate
from optipromp_sim.simulation import DisturbanceParameters, Simulation, SimulationParameters
from optipromp_sim.simulation.disturbances import JUMP_TIME, root_motion
from optipromp_sim.simulation.export import mjcf
from optipromp_sim.simulation.world import build

Bench = Any  # of conftest.py
UP = np.array([0.0, 0.0, 1.0])
FAR = np.array([0.5, 0.5, -0.5])  # [m] of the gantry from the fruits


def disturbance(**values: Any) -> SimulationParameters:
    return SimulationParameters().changed(disturbance=values)


def alone(bench: Bench, **physical: float) -> Scene:
    return bench.scene(bench.fruit("ripe", (0.0, 0.0, 0.5), length=0.15, **physical))


def run(simulation: Simulation, seconds: float) -> FloatArray:
    """(K, F, 3) displacements of the fruits from the scene's places, at every 5 ms [m]."""
    rest = np.array([o.position for o in simulation.scene.objects if o.stem is not None])
    out = []
    for k in range(round(seconds / simulation.tick)):
        if k % 5 == 0:
            out.append(simulation.fruits().positions - rest)
        simulation.step(simulation.reference)
    return np.array(out)


@pytest.mark.parametrize("sway_of", ["gutter", "roots"])
def test_roots_move_smoothly_alike_or_each_by_itself(sway_of: str) -> None:
    given = DisturbanceParameters(sway=0.02, sway_of=sway_of, gust=0.6, jump=0.01, jump_at=1.0)
    ball = [(np.zeros(3), 0.01)], [(np.array([0.03, 0, 0]), 0.02)], [(np.array([0, 1, 0]), 0.02)]
    motion, h = root_motion(given, 4, UP, ball), 1e-5
    for t in (0.0, 0.7, 1.01, 1.07, 1.14, 3.3):
        now, after, before = (motion.position(t + by) for by in (0.0, h, -h))
        rate, gain = (after - before) / (2.0 * h), (after - 2.0 * now + before) / h**2
        assert np.abs(rate).max() < 0.5  # [m/s] of a jump by 10 mm in 0.15 s, and of the sway
        assert np.abs(gain).max() < 10.0  # [m/s²]
    assert np.ptp(motion.position(0.3), axis=0).any() == (sway_of == "roots")
    begin = np.array([fruits[0][0] for fruits in ball]) + motion.position(0.0)
    assert np.linalg.norm(begin[1] - begin[0]) > 0.03 - 1e-9


def test_a_sway_is_horizontal_as_large_as_said_and_of_its_frequencies() -> None:
    at = np.arange(0.0, 300.0, 0.05)
    one = DisturbanceParameters(sway=0.02, sway_modes=1, sway_frequency=0.5, sway_fastest=0.5)
    for given, least in ((one, 0.0199), (replace(one, sway_modes=3, sway_fastest=1.6), 0.018)):
        motion = root_motion(given, 1, UP, [[(np.zeros(3), 0.01)]])
        moved = np.array([motion.position(t)[0] for t in at])
        assert not moved[:, 2].any()
        assert least < np.linalg.norm(moved, axis=1).max() <= 0.02 + 1e-9
        hertz = motion.rates / (2.0 * np.pi)
        assert (hertz >= 0.5 - 1e-9).all()
        assert (hertz <= given.sway_fastest + 1e-9).all()
    windy = root_motion(replace(one, gust=0.8), 1, UP, [[(np.zeros(3), 0.01)]])
    calm = root_motion(one, 1, UP, [[(np.zeros(3), 0.01)]])
    share = np.array([np.linalg.norm(windy.position(t)) for t in at])
    whole = np.array([np.linalg.norm(calm.position(t)) for t in at])
    share = share[whole > 0.01] / whole[whole > 0.01]
    assert 0.2 - 1e-9 <= share.min() < 0.5
    assert 0.7 < share.max() <= 1.0 + 1e-9


def test_without_a_disturbance_the_model_is_as_ever(bench: Bench) -> None:
    world = build(alone(bench), resolve(alone(bench)).robot)
    assert world.motion is None
    assert world.roots == ()
    assert world.miscalibration.is_identity
    shifted = build(alone(bench), world.robot, disturbance(shift=0.01))
    assert shifted.model.nv == world.model.nv  # nothing moves: there are no carriages
    moving = build(alone(bench), world.robot, disturbance(jump=0.01))
    assert moving.model.nv == world.model.nv + 3
    assert moving.model.stat.meaninertia == pytest.approx(world.model.stat.meaninertia, rel=1e-9)


HERTZ = 1.6  # of the fruit on its stem in the next test
MASS = 950.0 * 4.0 / 3.0 * np.pi * 0.015**3  # [kg] of a fruit of 15 mm


@pytest.mark.parametrize("hertz", [0.4, 1.6, 2.4])
def test_a_fruit_follows_its_root_as_a_driven_oscillator(bench: Bench, hertz: float) -> None:
    r"""The gain is :math:`κ / (κ - m ω^2)` with :math:`κ = k (1 + i ω τ)`.

    k is that of a beam whose last 15 mm, the fruit, are stiff; a quarter of the stem's mass swings
    with the fruit. There is no gravity.
    """
    given = disturbance(sway=0.01, sway_modes=1, sway_frequency=hertz, sway_fastest=hertz)
    still = {"swing_damping": 0.0, "bow_least": 0.0, "bow_most": 0.0}
    given = given.changed(stem=still, engine={"gravity": 0.0})
    stem = 1000.0 * np.pi / 4.0 * given.stem.diameter**2 * 0.135
    mass, omega, tau = MASS + 0.24 * stem, 2.0 * np.pi * hertz, given.stem.damping_time
    k = mass * (2.0 * np.pi * HERTZ) ** 2
    scene = alone(bench, stem_stiffness=k * (0.15**3 - 0.015**3) / 3.0)
    simulation = Simulation(scene, 2, given, q=FAR)
    motion = simulation.world.motion
    run(simulation, 3.0)  # until the begin is forgotten
    begin = simulation.time
    fruit = run(simulation, 5.0)[:, 0]  # whole periods
    times = begin + 0.005 * np.arange(len(fruit))
    wave = np.exp(-1j * omega * times)
    root = wave @ np.array([motion.position(t)[0] for t in times])
    gain = np.vdot(root, wave @ fruit) / np.vdot(root, root).real
    elastic = k * (1.0 + 1j * omega * tau)
    wanted = elastic / (elastic - mass * omega**2)
    assert abs(gain - wanted) < 0.06 * abs(wanted)
    assert (abs(gain) > 1.7) == (hertz == HERTZ)


def test_roots_follow_their_motion_and_fruits_begin_with_it(bench: Bench) -> None:
    scene = generate("truss", 9100)
    simulation = Simulation(scene, 3, disturbance(sway=0.02, sway_of="roots", gust=0.5))
    motion, world = simulation.world.motion, simulation.world
    rooted = [o for o in scene.objects if o.stem is not None and o.stem.parent is None]
    assert len(world.roots) == len(rooted) < len(world.fruits)  # stems of a truss move with it
    now = simulation.fruits()
    by = {world.fruits[k].id: row for row, root in enumerate(world.roots) for k in root.fruits}
    assert set(by) == set(now.ids)
    for k, name in enumerate(now.ids):
        item = next(o for o in scene.objects if o.id == name)
        wanted = motion.position(0.0)[by[name]]
        np.testing.assert_allclose(now.positions[k] - item.position, wanted, atol=1e-12)
        rate = (motion.position(1e-5) - motion.position(-1e-5))[by[name]] / 2e-5
        np.testing.assert_allclose(now.velocities[k], rate, atol=2e-3)
    first = now.stem_ends
    for _ in range(500):
        simulation.step(simulation.reference)
    now = simulation.fruits()
    for k, name in enumerate(now.ids):
        if name in {o.id for o in rooted}:
            moved = motion.position(simulation.time) - motion.position(0.0)
            went = now.stem_ends[k][0] - first[k][0]
            np.testing.assert_allclose(went, moved[by[name]], atol=1e-6)
    assert np.abs(motion.position(simulation.time) - motion.position(0.0)).max() > 2e-3


def test_torn_and_held_fruits_are_told_apart_on_moving_roots(bench: Bench) -> None:
    scene = bench.scene(
        bench.fruit("ripe", (0.0, 0.0, 0.5)), bench.fruit("green", (0.1, 0.0, 0.5), role="pushable")
    )
    simulation = Simulation(scene, 1, disturbance(sway=0.01), q=FAR)
    data, world = simulation.data, simulation.world
    run(simulation, 0.3)
    assert simulation.fruits().attached.all()
    data.xfrc_applied[world.fruits[0].body, 2] = -8.0  # [N] beyond the 5 N of an abscission
    run(simulation, 0.2)
    assert simulation.fruits().attached.tolist() == [False, True]
    assert set(simulation.rollout().torn_at) == {"ripe"}
    assert simulation.rollout().tension["green"] == pytest.approx(9.81 * MASS, rel=0.1)


def test_a_shift_stands_aside_and_below_from_the_beginning(bench: Bench) -> None:
    scene = alone(bench)
    simulation = Simulation(scene, 3, disturbance(shift=0.015, lower=0.01), q=FAR)
    now = simulation.fruits()
    by = now.positions[0] - scene.target.position
    assert np.linalg.norm(by[:2]) == pytest.approx(0.015)
    assert by[2] == pytest.approx(-0.01)
    unmoved = Simulation(scene, 3, q=FAR).fruits().stem_ends[0]
    np.testing.assert_allclose(now.stem_ends[0] - unmoved, np.tile(by, (len(unmoved), 1)))
    again = Simulation(scene, 3, disturbance(shift=0.015), q=FAR).fruits().positions[0]
    other = Simulation(scene, 4, disturbance(shift=0.015), q=FAR).fruits().positions[0]
    np.testing.assert_allclose(again[:2], now.positions[0, :2], atol=1e-12)
    assert np.linalg.norm(again - other) > 1e-3
    assert np.linalg.norm(run(simulation, 0.5)[-1, 0] - by) < 1e-3  # and hangs there


def test_a_jump_displaces_the_roots_in_motion(bench: Bench) -> None:
    simulation = Simulation(alone(bench), 3, disturbance(jump=0.01, jump_at=0.5), q=FAR)
    begin = simulation.fruits().stem_ends[0][0]
    moved = run(simulation, 5.0)[:, 0]
    assert np.linalg.norm(moved[:100], axis=1).max() < 5e-4
    settled = moved[-200:].mean(axis=0)
    assert np.linalg.norm(settled[:2]) == pytest.approx(0.01, rel=0.1)
    root = simulation.fruits().stem_ends[0][0] - begin
    assert np.linalg.norm(root[:2]) == pytest.approx(0.01, abs=1e-6)
    motion = simulation.world.motion
    np.testing.assert_array_equal(motion.position(0.5), 0.0)
    assert np.linalg.norm(motion.position(0.5 + JUMP_TIME)) == pytest.approx(0.01)


def test_a_miscalibrated_arm_finds_the_whole_world_elsewhere(bench: Bench) -> None:
    board = SceneObject("board", "static", bench.fruit("x", (0, 0, 0)).shape, np.ones(3))
    scene = replace(alone(bench), objects=(*alone(bench).objects, board))
    simulation = Simulation(scene, 3, disturbance(arm_offset=0.005, arm_turn=1.0), q=FAR)
    pose = simulation.world.miscalibration
    assert np.linalg.norm(pose.position) == pytest.approx(0.005)
    assert np.degrees(np.arccos((np.trace(pose.rotation) - 1.0) / 2.0)) == pytest.approx(1.0)
    now = simulation.fruits()
    np.testing.assert_allclose(now.positions[0], pose @ scene.target.position, atol=1e-12)
    unmoved = Simulation(scene, 3, q=FAR).fruits().stem_ends[0]  # bowed
    np.testing.assert_allclose(now.stem_ends[0], pose @ unmoved, atol=1e-12)
    np.testing.assert_allclose(simulation.data.geom("static:board").xpos, pose @ np.ones(3))
    gravity = simulation.world.model.opt.gravity
    np.testing.assert_allclose(gravity, pose.rotation @ [0.0, 0.0, -9.81], atol=1e-9)
    np.testing.assert_array_equal(simulation.state().q, FAR)
    begin = now.positions[0]
    run(simulation, 0.5)
    assert np.linalg.norm(simulation.fruits().positions[0] - begin) < 1e-3  # it hangs plumb


def test_commands_arrive_late(bench: Bench) -> None:
    late = 0.02
    prompt = Simulation(alone(bench), q=FAR)
    slow = Simulation(alone(bench), 0, disturbance(command_delay=late), q=FAR)
    steps = round(late / prompt.tick)
    motion = bench.line(FAR + [0.0, 0.0, 0.13], FAR + [0.1, 0.0, 0.13], seconds=0.5)
    there = []
    for k in range(500):
        there.append(prompt.step(motion.at(k * prompt.tick)).q)
        state = slow.step(motion.at(k * prompt.tick))
        if k >= steps:
            np.testing.assert_allclose(state.q, there[k - steps], atol=2e-6)
    assert np.abs(there[-1] - state.q).max() > 1e-6


def test_impossible_disturbances_are_refused() -> None:
    for wrong in (
        {"sway": -0.01},
        {"sway_frequency": 0.0},
        {"sway_frequency": 2.0},
        {"gust": 1.5},
        {"sway_of": "leaves"},
        {"sway_modes": 0},
    ):
        with pytest.raises(InvalidRequestError, match=next(iter(wrong))):
            disturbance(**wrong)


def test_an_exported_scene_is_the_believed_one(bench: Bench) -> None:
    scene, robot = alone(bench), resolve(alone(bench)).robot
    windy = mjcf(scene, robot, FAR, disturbance(sway=0.01, shift=0.01, arm_turn=1.0))
    assert windy == mjcf(scene, robot, FAR)


def test_neighbouring_clusters_of_real_fruits_sway_too() -> None:
    given = disturbance(sway=0.02).changed(thing={"avoid_as": "fruits"})
    scene = load_scene("scenario-3")
    simulation = Simulation(scene, 3, given)
    world, motion = simulation.world, simulation.world.motion
    assert len(world.roots) == len(world.fruits) == 3 + 2 * 6
    before = np.array([simulation.data.qpos[f.position : f.position + 3] for f in world.fruits])
    rest = np.array([world.model.body_pos[f.body] for f in world.fruits])
    np.testing.assert_allclose(before - rest, motion.position(0.0), atol=1e-12)
    for _ in range(200):
        simulation.step(simulation.reference)
    rollout = simulation.rollout()
    assert (rollout.fruit_ids, rollout.warnings) == (("ripe", "n1", "n2"), ())
