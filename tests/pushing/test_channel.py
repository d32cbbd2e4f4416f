"""Ways of a hand through packs: found, sound in the model, and where things are displaced."""

from dataclasses import replace

import numpy as np
import pytest

from optipromp.geometry.shapes import Box, Cylinder
from optipromp.pushing import channel, trials
from optipromp.pushing.plane import LOW, MOST, UNSURE, plane, ploughs
from optipromp.pushing.quasi_static import push
from optipromp.robots.tools import Cup, FrankaHand
from optipromp.scenes.generate import generate, perceived
from optipromp.scenes.scene import Approach, Scene, SceneObject, Stem

HAND = FrankaHand()
TARGET = np.array([0.65, 0.0, 0.52])
LEVEL = Approach(np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0]))


def shelf(*packs: SceneObject, approach: Approach = LEVEL) -> Scene:
    can = SceneObject("can", "target", Cylinder(0.028, 0.12), TARGET)
    board = SceneObject("board", "static", Box((0.3, 0.6, 0.02)), TARGET - [0.0, 0.0, 0.07])
    wall = SceneObject("wall", "static", Box((0.3, 0.02, 0.3)), TARGET + [0.0, 0.31, 0.08])
    return Scene("shelf", "panda", (can, board, wall, *packs), approach=approach)


def pack(off, size=(0.05, 0.05, 0.14)):
    at = TARGET + [*off, 0.5 * size[2] - 0.06]
    return SceneObject("n1", "pushable", Box(size), at)


def played(scene, way):
    """Where the model says everything ends."""
    board = plane(scene, HAND)
    flat = (way.corners - TARGET) @ scene.frame[[2, 1]].T
    path, hand = trials.stepped(flat, trials.STEP), board.bench(HAND).hand
    return board, push(
        path, hand, board.things, board.state, board.friction, board.lever, board.walls, 0.4
    )


def test_what_a_hand_goes_through():
    scene = shelf(pack((-0.1, 0.0)))
    assert ploughs(scene, HAND)
    assert not ploughs(scene, Cup(0.03))
    assert not ploughs(scene, None)
    assert not ploughs(shelf(), HAND)
    assert not ploughs(shelf(pack((-0.1, 0.0)), approach=Approach()), HAND)
    still = pack((-0.1, 0.0))
    stem = Stem(np.array([still.position, still.position + [0.0, 0.0, 0.2]]))
    hung = replace(still, stem=stem)
    assert not ploughs(shelf(hung), HAND)


def test_what_stands_far_away_is_not_on_the_plane():
    rng = np.random.default_rng(0)
    one = pack((-0.1, 0.03), (0.04, 0.06, 0.14))
    heights = rng.uniform(-0.03, 0.03, 300)
    far = [
        replace(one, id=f"far-{i}", position=TARGET + [1.5 + 0.01 * i, rng.normal(), z])
        for i, z in enumerate(heights)
    ]
    walls = [replace(thing, id=f"{thing.id}-wall", role="static") for thing in far]
    alone, among = (plane(shelf(one, *more), HAND) for more in ((), (*far, *walls)))
    np.testing.assert_array_equal(among.state, alone.state)
    assert len(among.walls.size) == len(alone.walls.size) == 1
    assert (among.edge, among.entry, among.drop) == (alone.edge, alone.entry, alone.drop)
    near = [
        replace(one, id=f"near-{i}", position=TARGET + [0.0, 0.1 + 0.002 * i, 0.0])
        for i in range(300)
    ]
    crowded = plane(shelf(*near[::-1]), HAND)
    assert len(crowded.state) == 1 + MOST
    np.testing.assert_allclose(np.sort(crowded.state[1:, 1]), 0.1 + 0.002 * np.arange(MOST))


def test_late_there_is_a_way_and_little_is_tried_for_it(monkeypatch):
    tried = []
    cost = channel.cost
    monkeypatch.setattr(channel, "cost", lambda *a: tried.append(a) or cost(*a))
    scene = shelf(pack((-0.1, 0.0)))
    found = channel.ways(scene, HAND, np.random.default_rng(0), deadline=0.0)
    late = len(tried)
    assert len(found) == 1
    tried.clear()
    channel.ways(scene, HAND, np.random.default_rng(0))
    assert 10 * late < len(tried)


def test_the_plane_is_what_stands_there():
    bench = plane(shelf(pack((-0.1, 0.03), (0.04, 0.06, 0.14))), HAND)
    np.testing.assert_allclose(bench.state, [[0, 0, 0], [-0.1, 0.03, 0]], atol=1e-12)
    assert bench.things.size.tolist() == [0, 4]
    np.testing.assert_allclose(bench.things.box[1], [-0.02, -0.03, 0.02, 0.03])
    assert bench.walls.size.tolist() == [4]
    np.testing.assert_allclose(bench.walls.box[0], [-0.15, 0.30, 0.15, 0.32])
    assert bench.edge == pytest.approx(-0.15)
    assert bench.entry < -0.15 - (HAND.tip - HAND.reach)
    weight = 600.0 * 9.81 * 0.04 * 0.06 * 0.14
    assert bench.friction[1] == pytest.approx(0.4 * weight)
    assert bench.deviation.tolist() == [UNSURE] * 2


def test_a_pack_on_the_line_goes_aside_and_the_target_stays():
    scene = shelf(pack((-0.1, 0.0)))
    best, *_ = channel.ways(scene, HAND, np.random.default_rng(0), 2)
    assert best.cost < 3.0
    np.testing.assert_allclose(best.corners[-1], TARGET, atol=1e-12)
    # low until it is there: the hand's cover spheres just over the board
    low = TARGET[2] - 0.06 + HAND.spheres()[:, 3].max() + LOW
    np.testing.assert_allclose(best.corners[:-1, 2], low, atol=1e-9)
    board, result = played(scene, best)
    assert np.linalg.norm(result.state[0, :2]) < 5e-3
    assert abs(result.state[1, 1]) > HAND.gripper_radius
    assert result.done == 1.0
    assert result.state[1, 0] > board.edge


def test_the_same_draws_give_the_same_ways():
    scene = shelf(pack((-0.1, 0.01)))
    one, other = (channel.ways(scene, HAND, np.random.default_rng(5), 1)[0] for _ in range(2))
    np.testing.assert_array_equal(one.corners, other.corners)


@pytest.mark.parametrize("seed", [1, 3])
def test_generated_shelves(seed):
    scene = generate("shelf", seed)
    assert ploughs(scene, HAND)
    way, *_ = channel.ways(scene, HAND, np.random.default_rng(0), 1)
    assert way.cost < 3.0


def test_detected_things_are_as_unsure_as_their_detection():
    scene = perceived(generate("shelf", 1), np.random.default_rng(0), 0.006, 0.0)
    np.testing.assert_allclose(plane(scene, HAND).deviation, 0.006)


def test_the_outline_holds_the_boxes():
    hand = plane(shelf(pack((-0.1, 0.0))), HAND).bench(HAND).hand
    assert hand.size.tolist() == [4, 5, 4, 5, 4]  # palm, and base and pad of either finger
    kinds = ("palm", "left", "left", "right", "right")
    for name, center, half, turn in HAND.boxes():
        if turn == 0.0:
            reach = abs(center[1]) + half[1]
            outer = max(
                np.abs(part[:, 1]).max()
                for part, kind in zip(HAND.outline(), kinds, strict=True)
                if name.startswith(kind)
            )
            assert reach <= outer + 1e-9
