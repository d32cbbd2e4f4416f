"""Stems that are bowed as they grew, and fruits that overlap as they were seen."""

import numpy as np
import pytest
from tests.simulation.test_physics import STRAIGHT

from optipromp.core.errors import InvalidRequestError
from optipromp.core.planning.task import resolve
from optipromp.core.scenes.scene import Stem
from optipromp.laboratory.simulation import SimulationParameters, simulate
from optipromp.laboratory.simulation.fruits import bows
from optipromp.laboratory.simulation.world import build


def risen(bench, stem, push):
    """How far a fruit on a plumb stem of 0.2 m rises within a second under a push [m]."""
    run = bench.execution(
        bench.scene(bench.fruit("ripe", (0.0, 0.0, 0.5), length=0.2)), bench.parameters(stem=stem)
    )
    run.data.xfrc_applied[run.world.fruits[0].body, 2] = push
    rollout, _ = run.run()
    return rollout.fruit_positions[-1, 0, 2] - rollout.fruit_positions[0, 0, 2]


def test_a_stem_that_is_pressed_from_below_bends_and_is_no_strut(bench):
    """A perfectly straight chain bears 4 N, a bowed one gives way under 0.3 N."""
    assert risen(bench, STRAIGHT, 4.0) < 1e-3
    assert risen(bench, {}, 0.3) > 0.01


def test_a_bowed_stem_holds_its_fruit_where_it_was_seen(bench):
    run = bench.execution(bench.scene(bench.fruit("ripe", (0.0, 0.0, 0.5), length=0.2)))
    rollout, _ = run.run()
    moved = np.linalg.norm(rollout.fruit_positions[:, 0] - rollout.fruit_positions[0, 0], axis=1)
    assert moved.max() < 2e-4


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


def test_the_chain_of_a_stem_follows_its_bow_and_keeps_its_ends(bench):
    fruit = bench.fruit("ripe", (0.0, 0.0, 0.5), length=0.2)
    scene = bench.scene(fruit)
    world = build(scene, resolve(scene).robot, bench.parameters(stem={"bow_least": 0.05}), 3)
    (built,) = world.fruits
    off = np.linalg.norm(built.built.nodes[:, :2], axis=1)
    assert off[0] == off[-1] == 0.0
    assert off.max() == pytest.approx(0.05 * 0.2, rel=0.05)


def test_a_stem_with_a_form_of_its_own_is_not_bowed(bench):
    fruit = bench.fruit("ripe", (0.0, 0.0, 0.5))
    points = np.array([[0.0, 0.0, 0.5], [0.01, 0.0, 0.58], [0.0, 0.0, 0.65]])
    bent = type(fruit)("ripe", "target", fruit.shape, fruit.position, stem=Stem(points))
    assert bows([bent], SimulationParameters().stem, 0) == {}


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
