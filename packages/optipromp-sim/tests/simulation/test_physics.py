"""The simulation against what is known of hanging, bending, breaking and standing objects."""

from dataclasses import replace

import numpy as np
import pytest

from optipromp.core.errors import InvalidRequestError
from optipromp.core.geometry.shapes import Box, Cylinder, Sphere
from optipromp.core.planning.task import resolve
from optipromp.core.robots import Robot, load_robot
from optipromp.core.scenes.io import load_scene
from optipromp.core.scenes.scene import SceneObject, Stem
from optipromp_sim.simulation import Cause, SimulationParameters, simulate
from optipromp_sim.simulation.fruits import bows
from optipromp_sim.simulation.world import FLOOR_DEPTH, build

WEIGHT = 950.0 * 4.0 / 3.0 * np.pi * 0.015**3 * 9.81


STRAIGHT = {"bow_least": 0.0, "bow_most": 0.0}


@pytest.mark.parametrize("length", [0.10, 0.28])
def test_a_stem_bends_as_a_beam(bench, length):
    """Static tip deflection F (L³ - r³) / 3EI (the fruit itself is stiff), within 5 %."""
    stiffness, force = 2e-3, 0.002
    scene = bench.scene(
        bench.fruit("ripe", (0.0, 0.0, 0.5), length=length, stem_stiffness=stiffness)
    )
    parameters = bench.parameters(
        engine={"gravity": 0.0}, stem={"damping_time": 0.3}, control={"hold": 4.0}
    )
    run = bench.execution(scene, parameters)
    body = run.world.fruits[0].body
    run.data.xfrc_applied[body, 0] = force
    rollout = run.run()
    expected = force * (length**3 - 0.015**3) / (3.0 * stiffness)
    deflection = rollout.fruit_positions[-1, 0, 0] - rollout.fruit_positions[0, 0, 0]
    assert deflection == pytest.approx(expected, rel=0.05)


def test_a_fruit_swings_like_a_pendulum(bench):
    """A slack stem: the period of a point mass on a thread, within 3 %."""
    length = 0.25
    scene = bench.scene(bench.fruit("ripe", (0.0, 0.0, 0.5), length=length, stem_stiffness=1e-7))
    parameters = bench.parameters(
        stem={"swing_damping": 0.0, "armature": 1e-7, **STRAIGHT}, control={"hold": 4.0}
    )
    run = bench.execution(scene, parameters)
    free = run.world.fruits[0]
    run.data.qvel[free.spin] = 0.02
    # every joint alike, so that stem and fruit start together
    rollout = run.run()
    x = rollout.fruit_positions[:, 0, 0] - rollout.fruit_positions[:, 0, 0].mean()
    ups = np.flatnonzero((x[:-1] < 0) & (x[1:] >= 0))
    period = np.diff(rollout.times[ups]).mean()
    assert period == pytest.approx(2.0 * np.pi * np.sqrt(length / 9.81), rel=0.03)


def test_a_cup_moved_straight_up_swallows_a_hanging_fruit_and_one_aside_nothing(bench):
    scene = bench.scene(bench.fruit("ripe", (0.0, 0.0, 0.5)))
    beside = simulate(bench.line((0.1, 0.0, 0.3), (0.1, 0.0, 0.5)), scene)
    assert beside.outcome.cause is Cause.NOT_PICKED
    run = simulate(bench.line((0.0, 0.0, 0.3), (0.0, 0.0, 0.5)), scene)
    assert run.success, run.outcome.message
    assert run.outcome.picked
    assert run.outcome.swallowed_at is not None
    assert run.outcome.target_displacement < 1e-3
    assert run.outcome.tracking_error < 1e-3


@pytest.mark.parametrize(("until", "picked"), [(0.5, True), (9.0, False)])
def test_a_guard_keeps_fruit_out_until_it_opens(bench, until, picked):
    scene = bench.scene(bench.fruit("ripe", (0.0, 0.0, 0.5)))
    guarded = bench.parameters(robot={"guard_until": until})
    way = bench.line((0.0, 0.0, 0.3), (0.0, 0.0, 0.5))
    outcome = simulate(way, scene, parameters=guarded).outcome
    assert outcome.picked is picked
    assert (outcome.peak_force["ripe"] > 0.5) is not picked


def test_a_fruit_below_the_target_is_swallowed_too(bench):
    scene = bench.scene(
        bench.fruit("ripe", (0.0, 0.0, 0.5)),
        bench.fruit("n1", (0.012, 0.0, 0.42), lean=(0.03, 0.0), length=0.2, role="pushable"),
    )
    run = simulate(bench.line((0.0, 0.0, 0.3), (0.0, 0.0, 0.5)), scene)
    assert run.outcome.cause is Cause.SWALLOWED_OTHER
    assert run.outcome.swallowed_others == ("n1",)


def test_what_falls_comes_to_rest_on_a_floor_whose_touch_counts_for_nothing(bench):
    loose = SceneObject("loose", "pushable", Sphere(0.015), np.array([0.1, 0.0, 0.6]))
    scene = bench.scene(bench.fruit("ripe", (0.0, 0.0, 0.3)), loose)
    run = simulate(bench.line((0.5, 0.5, -0.3), (0.5, 0.5, -0.3), 3.0, 10), scene)
    heights = run.rollout.fruit_positions[:, run.rollout.fruit_ids.index("loose"), 2]
    late = heights[run.rollout.times > 2.0]
    np.testing.assert_allclose(late, 0.015 - FLOOR_DEPTH, atol=2e-3)
    assert run.outcome.peak_force["loose"] == 0.0
    assert not len(run.rollout.contacts)
    assert run.outcome.causes == (Cause.NOT_PICKED,)


@pytest.mark.parametrize(("pull", "torn"), [(4.5, False), (5.2, True)])
def test_a_stem_tears_at_its_threshold(bench, pull, torn):
    scene = bench.scene(bench.fruit("ripe", (0.0, 0.0, 0.5)))
    run = bench.execution(scene, bench.parameters(stem=STRAIGHT))
    run.data.xfrc_applied[run.world.fruits[0].body, 2] = -(pull - WEIGHT)
    rollout = run.run()
    assert bool(rollout.torn_at) is torn
    assert bool(rollout.attached[-1, 0]) is not torn
    if not torn:
        assert rollout.tension["ripe"] == pytest.approx(pull, rel=0.15)  # a step overshoots
    else:
        assert rollout.fruit_positions[-1, 0, 2] < 0.0


def test_a_can_stands_on_its_shelf_and_is_pushed_along_it(bench):
    shelf = SceneObject("shelf", "static", Box((0.1, 0.2, 0.02)), np.array([0.0, 0.0, 0.49]))
    can = SceneObject("can", "pushable", Cylinder(0.03, 0.10), np.array([-0.03, 0.0, 0.55]))
    scene = bench.scene(bench.fruit("ripe", (0.0, 0.4, 0.9)), can, shelf)
    run = simulate(bench.still((-0.4, -0.4, 0.2)), scene)
    assert run.outcome.displacement["can"] < 1e-3
    assert run.outcome.stem_tension.keys() == {"ripe"}
    push = simulate(bench.line((-0.2, 0.0, 0.53), (-0.075, 0.0, 0.53)), scene)
    assert push.outcome.static_contacts == ()
    moved = push.rollout.fruit_positions[-1, 1] - push.rollout.fruit_positions[0, 1]
    assert moved[0] == pytest.approx(0.015, abs=2e-3)
    assert abs(moved[2]) < 1e-3
    assert push.outcome.peak_force["can"] > 0.5


def test_pressing_a_static_object_is_a_static_contact(bench):
    wall = SceneObject("wall", "static", Box((0.2, 0.2, 0.02)), np.array([0.0, 0.0, 0.45]))
    scene = bench.scene(bench.fruit("ripe", (0.0, 0.0, 0.6)), wall)
    run = simulate(bench.line((0.0, 0.0, 0.3), (0.0, 0.0, 0.5)), scene)
    assert run.outcome.cause is Cause.STATIC_CONTACT
    (contact,) = run.outcome.static_contacts
    assert (contact.link, contact.other) == ("tool", "wall")
    assert contact.peak_force > 1.0
    assert contact.duration > 0.1


def test_a_pressed_stem_is_caught(bench):
    """The cup's rim is driven sideways against a short stem, above its fruit."""
    scene = bench.scene(bench.fruit("ripe", (0.0, 0.0, 0.5), length=0.06, abscission_force=100.0))
    limits = bench.parameters(thresholds={"stem_force": 0.1, "stem_time": 0.01})
    way = bench.line((0.10, 0.0, 0.52), (-0.10, 0.0, 0.52), 1.0)
    outcome = simulate(way, scene, parameters=limits).outcome
    assert outcome.stem_force["ripe"] > 0.1
    assert "ripe" in outcome.stem_caught


def with_inertia(*moments: float) -> Robot:
    """The Panda with these principal moments of its third segment [kg m²]."""
    robot = load_robot("panda")
    tensors = np.array(robot.dynamics.inertia)
    turn = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    tensors[2] = turn @ np.diag(moments) @ turn.T
    return replace(robot, dynamics=robot.dynamics._replace(inertia=tensors))


def test_the_inertia_that_a_robot_states_is_simulated():
    """A flat body's too: its largest moment is the sum of the others, but for rounding."""
    for moments in ((0.01, 0.02, 0.025), (0.01, 0.02, 0.03)):
        model = build(load_scene("scenario-1"), with_inertia(*moments)).model
        body = model.body("segment:2").id
        assert sorted(model.body_inertia[body]) == pytest.approx(moments, rel=1e-6)


@pytest.mark.parametrize(
    "moments", [(0.01, 0.02, 0.05), (-0.01, 0.02, 0.02), (0.0, 0.0, 0.01), (0.1, 0.2, np.inf)]
)
def test_an_inertia_that_no_body_has_is_replaced(moments):
    """As files of real robots have it, an xArm6's for one. The mass stays."""
    with pytest.warns(UserWarning, match="segment 2: no body has the inertia that is stated"):
        model = build(load_scene("scenario-1"), with_inertia(*moments)).model
    body, robot = model.body("segment:2").id, load_robot("panda")
    assert model.body_mass[body] == pytest.approx(robot.dynamics.mass[2])
    low, middle, high = sorted(model.body_inertia[body])
    assert 0.0 < low <= high < low + middle


def test_what_mujoco_refuses_is_told():
    robot = load_robot("panda")
    mass = np.array(robot.dynamics.mass)
    mass[2] = 1e-300
    thin = replace(robot, dynamics=robot.dynamics._replace(mass=mass))
    with pytest.raises(InvalidRequestError, match=r"MuJoCo cannot build the scene: .*mass"):
        build(load_scene("scenario-1"), thin)


def risen(bench, stem, push):
    """How far a fruit on a plumb stem of 0.2 m rises within a second under a push [m]."""
    run = bench.execution(
        bench.scene(bench.fruit("ripe", (0.0, 0.0, 0.5), length=0.2)), bench.parameters(stem=stem)
    )
    run.data.xfrc_applied[run.world.fruits[0].body, 2] = push
    rollout = run.run()
    return rollout.fruit_positions[-1, 0, 2] - rollout.fruit_positions[0, 0, 2]


def test_a_stem_that_is_pressed_from_below_bends_and_is_no_strut(bench):
    """A perfectly straight chain bears 4 N, a bowed one gives way under 0.3 N."""
    assert risen(bench, STRAIGHT, 4.0) < 1e-3
    assert risen(bench, {}, 0.3) > 0.01


def test_bows_are_drawn_within_their_range_and_are_the_same_for_a_seed(bench):
    fruits = [bench.fruit(f"n{k}", (0.1 * k, 0.0, 0.5), lean=(0.02, 0.0)) for k in range(40)]
    stem = SimulationParameters().stem
    drawn = bows(fruits, stem, 7)
    for fruit in fruits:
        vector = fruit.stem.vector
        share = np.linalg.norm(drawn[fruit.id]) / np.linalg.norm(vector)
        assert stem.bow_least <= share <= stem.bow_most
        assert abs(drawn[fruit.id] @ vector) < 1e-12
    again, other = bows(fruits, stem, 7), bows(fruits, stem, 8)
    for name, bow in drawn.items():
        np.testing.assert_array_equal(bow, again[name])
        assert np.linalg.norm(bow - other[name]) > 1e-5
    points = np.array([[0.0, 0.0, 0.5], [0.01, 0.0, 0.58], [0.0, 0.0, 0.65]])
    assert bows([replace(fruits[0], stem=Stem(points))], stem, 0) == {}  # of a form of its own


def test_the_chain_of_a_stem_follows_its_bow_and_keeps_its_ends(bench):
    fruit = bench.fruit("ripe", (0.0, 0.0, 0.5), length=0.2)
    scene = bench.scene(fruit)
    world = build(scene, resolve(scene).robot, bench.parameters(stem={"bow_least": 0.05}), 3)
    (built,) = world.fruits
    off = np.linalg.norm(built.built.nodes[:, :2], axis=1)
    assert off[0] == off[-1] == 0.0
    assert off.max() == pytest.approx(0.05 * 0.2, rel=0.05)


@pytest.mark.parametrize("stem", [{"bow_least": -0.1}, {"bow_least": 0.06}, {"bow_most": 0.3}])
def test_a_bow_that_no_stem_has_is_refused(bench, stem):
    with pytest.raises(InvalidRequestError, match="bow_least"):
        bench.parameters(stem=stem)


def test_fruits_that_overlap_as_seen_are_pushed_apart_and_told_of(bench):
    one = bench.fruit("ripe", (0.0, 0.0, 0.5))
    two = bench.fruit("n1", (0.02, 0.0, 0.5), role="pushable")
    far = bench.fruit("n2", (0.2, 0.0, 0.5), role="pushable")
    scene = bench.scene(one, two, far)
    world = build(scene, resolve(scene).robot)
    assert world.overlapping == ()
    assert set(world.parted) == {"ripe", "n1"}
    places = {item.id: item.position for item in world.scene.objects}
    assert np.linalg.norm(places["ripe"] - places["n1"]) == pytest.approx(0.03, abs=1e-4)
    np.testing.assert_array_equal(places["n2"], far.position)
    outcome = simulate(bench.line((0.02, 0.0, 0.3), (0.02, 0.0, 0.46)), scene).outcome
    assert outcome.parted == dict(world.parted)
    assert "pushed apart" in outcome.message
