"""The model of the push of a hand among packs on a board: what it predicts, and what it finds."""

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest

from optipromp.core.budget import Budget, clock
from optipromp.core.geometry.shapes import Box, Cylinder
from optipromp.core.pushing.packs.standing import STANDING, Standing, applies, plane
from optipromp.core.pushing.path import ToolPath, through, turning
from optipromp.core.pushing.searching import search
from optipromp.core.robots.tools import Cup, FrankaHand
from optipromp.core.scenes.scene import Approach, Scene, SceneObject, Stem
from optipromp_sim.generate import Noise, generate, perceived

HAND = FrankaHand()
TARGET = np.array([0.65, 0.0, 0.52])
LEVEL = Approach(np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0]))
STRAIGHT = ((-0.26, 0.0), (0.0, 0.0))


def shelf(*packs: SceneObject, approach: Approach = LEVEL) -> Scene:
    can = SceneObject("can", "target", Cylinder(0.028, 0.12), TARGET)
    board = SceneObject("board", "static", Box((0.3, 0.6, 0.02)), TARGET - [0.0, 0.0, 0.07])
    wall = SceneObject("wall", "static", Box((0.3, 0.02, 0.3)), TARGET + [0.0, 0.31, 0.08])
    return Scene("shelf", "panda", (can, board, wall, *packs), approach=approach)


def pack(off: Any, size: Any = (0.05, 0.05, 0.14), name: str = "n1") -> SceneObject:
    at = TARGET + [*off, 0.5 * size[2] - 0.06]
    return SceneObject(name, "pushable", Box(size), at)


def led(*corners: Any) -> ToolPath:
    """The tool led through (u, v) from the target: along the approach and along y_g."""
    return through(TARGET + np.array([[u, v, 0.0] for u, v in corners]), 0.015)


def judged(path: ToolPath) -> tuple[np.ndarray, np.ndarray]:
    return path.points, np.tile([1.0, 0.0, 0.0], (len(path.points), 1))


def harm(model: Standing, path: ToolPath, states: int = 1) -> float:
    return model.harm(*judged(path), states)


# --- harm of known paths -----------------------------------------------------------------------


def test_what_is_not_touched_is_not_harmed() -> None:
    """What is left is a thousandth for each step of the way, and the room to the wall."""
    model = Standing(shelf(pack((0.0, 0.2))), HAND)
    way = led(*STRAIGHT)
    assert harm(model, way) == pytest.approx(1e-3 * 66, abs=2e-3)
    prediction = model.predict(*judged(way))
    assert not prediction.harmful
    assert (prediction.object, prediction.cause) == ("", "nothing is harmed")


def test_a_pack_that_ends_between_the_fingers_is_named() -> None:
    """It stands before the target, and the hand comes straight: both are taken."""
    small = pack((-0.075, 0.0), (0.03, 0.03, 0.14))
    model = Standing(shelf(small, pack((0.0, 0.2), name="n2")), HAND)
    prediction = model.predict(*judged(led(*STRAIGHT)))
    assert prediction.harmful
    assert (prediction.object, prediction.cause) == ("n1", "ends between the fingers")


def test_a_pack_over_the_front_of_the_board_is_named() -> None:
    """It stands on the edge: in the worst state its middle is over it."""
    model = Standing(shelf(pack((-0.152, 0.15)), pack((0.0, 0.2), name="n2")), HAND)
    assert model.bench.edge == pytest.approx(-0.15)
    model._places[:, 0] = 0.0  # the target is known exactly
    path = judged(led(*STRAIGHT))
    assert model.predict(*path).harm > model.good
    assert model.cause(*path) == ("n1", "is pushed off the board")


def test_a_pack_that_is_pressed_against_a_wall_is_named() -> None:
    model = Standing(shelf(pack((-0.08, 0.25))), HAND)
    way = ((-0.26, 0.1), (-0.07, 0.12), (-0.07, 0.2), (-0.07, 0.12), (-0.26, 0.1), (-0.2, 0.0))
    prediction = model.predict(*judged(led(*way, (0.0, 0.0))))
    assert prediction.harmful
    assert (prediction.object, prediction.cause) == ("n1", "is jammed")


def test_a_hand_that_comes_too_near_to_a_wall_is_told() -> None:
    model = Standing(shelf(pack((0.0, -0.2))), HAND)
    side = 0.30 - max(part[:, 1].max() for part in HAND.outline()) - 0.008  # the wall is at 0.30
    way = led((-0.26, 0.0), (-0.2, side), (-0.09, side), (-0.09, 0.0), (0.0, 0.0))
    assert model.predict(*judged(way)).harm > model.good
    model._places[:, 0] = 0.0  # the target is known exactly
    assert model.predict(*judged(way)).object == ""
    assert model.cause(*judged(way))[1] == "the hand comes within 8 mm of a wall"


def test_packs_that_are_pushed_hard_are_named() -> None:
    """Large ones, side by side, that the hand moves all at once."""
    large = (0.12, 0.12, 0.5)
    packs = pack((-0.06, -0.12), large), pack((-0.06, -0.24), large, "n2")
    model = Standing(shelf(*packs), HAND)
    way = led((-0.26, 0.0), (-0.05, 0.0), (-0.05, -0.07), (-0.05, 0.0), (0.0, 0.0))
    prediction = model.predict(*judged(way))
    assert prediction.harmful
    assert prediction.object == "n1"
    assert prediction.cause.startswith("is pushed with ")


def test_a_target_that_is_pushed_is_named() -> None:
    model = Standing(shelf(pack((0.0, 0.2))), HAND)
    way = led((-0.26, 0.0), (-0.1, -0.12), (0.0, -0.12), (0.0, -0.03), (0.0, 0.0))
    prediction = model.predict(*judged(way))
    assert prediction.harmful
    assert prediction.object == "can"
    assert prediction.cause.startswith("is pushed by ")


def test_above_the_limit_a_harm_is_above_it_and_below_it_exact() -> None:
    model = Standing(shelf(pack((-0.1, 0.01)), pack((-0.05, -0.08), name="n2")), HAND)
    rng = np.random.default_rng(0)
    for _ in range(15):
        x = model.candidates.spread(0)[0] + model.candidates.spread(0)[1] * rng.standard_normal(7)
        way = model.candidates.path(x)
        whole = model.harm(*judged(way), 4)
        assert model.harm(*judged(way), 4, whole * 1.001) == whole
        assert model.harm(*judged(way), 4, 0.5 * whole) > 0.5 * whole


# --- states ------------------------------------------------------------------------------------


def test_states_are_sampled_round_the_perceived_one() -> None:
    scene = perceived(generate("shelf", 1), np.random.default_rng(0), Noise(0.006))
    model = Standing(scene, HAND)
    np.testing.assert_allclose(model.board.spread, 0.006)
    places = model._places
    assert places.shape == (1 + STANDING.samples, len(model.board.state), 3)
    np.testing.assert_array_equal(places[0], model.board.state)
    off = places[1:, :, :2] - places[0, :, :2]
    assert 0.8 < off.std() / 0.006 < 1.2
    np.testing.assert_array_equal(places[1:, :, 2], np.tile(places[0, :, 2], (STANDING.samples, 1)))
    assert model._slips[0] == 0.4
    assert 0.16 <= model._slips.min() < model._slips.max() <= 0.56
    np.testing.assert_array_equal(Standing(scene, HAND)._places, places)
    assert not np.array_equal(Standing(scene, HAND, seed=1)._places, places)


def test_a_harm_is_the_mean_over_the_states() -> None:
    model = Standing(shelf(pack((-0.1, 0.0))), HAND)
    way = led((-0.26, 0.0), (-0.12, -0.09), (-0.05, -0.05), (0.0, 0.0))
    places, slips = model._places.copy(), model._slips.copy()
    each = []
    for n in range(5):
        model._places, model._slips = places[n : n + 1], slips[n : n + 1]
        each.append(harm(model, way))
    model._places, model._slips = places, slips
    assert np.std(each) > 0.0
    assert harm(model, way, 5) == pytest.approx(np.mean(each))


# --- which paths -------------------------------------------------------------------------------


def test_a_pack_on_the_line_goes_aside_and_the_target_stays() -> None:
    scene = shelf(pack((-0.1, 0.0)))
    model = Standing(scene, HAND)
    assert harm(model, led(*STRAIGHT), model.states) > model.threshold
    *_, (best, _) = search(model, partial(turning, scene.frame[2], None), np.random.default_rng(0))
    assert best.harm < model.threshold
    assert best.harm == model.harm(*judged(best), model.states)
    np.testing.assert_allclose(best.points[-1], TARGET, atol=1e-12)
    # low until it is there: the hand's cover spheres just over the board
    low = TARGET[2] - 0.06 + HAND.spheres()[:, 3].max() + STANDING.low
    assert low < TARGET[2]
    np.testing.assert_allclose(best.points[0, 2], low, atol=1e-9)
    assert (best.points[:, 2] >= low - 1e-9).all()
    off = best.points[:, 0] < TARGET[0] - 0.02
    np.testing.assert_allclose(best.points[off, 2], low, atol=1e-9)


def test_late_there_is_a_path_and_little_is_tried_for_it(monkeypatch: pytest.MonkeyPatch) -> None:
    tried: list[int] = []
    original = Standing.harm

    def counted(self: Standing, *a: Any) -> float:
        tried.append(1)
        return original(self, *a)

    monkeypatch.setattr(Standing, "harm", counted)
    scene = shelf(pack((-0.1, 0.0)))
    model = Standing(scene, HAND)
    model.good = 0.0  # so that it goes on
    up = scene.frame[2]
    late_by = Budget(clock() - 1.0)
    found = list(search(model, partial(turning, up, None), np.random.default_rng(0), late_by))
    late = len(tried)
    assert len(found) == 1
    tried.clear()
    list(search(model, partial(turning, up, None), np.random.default_rng(0)))
    assert late <= 2  # one candidate, on one state and then on all
    assert len(tried) > 1000


# --- where it applies --------------------------------------------------------------------------


def test_what_a_tool_goes_through() -> None:
    scene = shelf(pack((-0.1, 0.0)))
    assert applies(scene, HAND)
    assert applies(scene, Cup(0.03))
    assert not applies(scene, None)
    assert not applies(shelf(), HAND)
    assert not applies(shelf(pack((-0.1, 0.0)), approach=Approach()), HAND)
    still = pack((-0.1, 0.0))
    stem = Stem(np.array([still.position, still.position + [0.0, 0.0, 0.2]]))
    hung = replace(still, stem=stem)
    assert not applies(shelf(hung), HAND)
    assert applies(shelf(hung, replace(still, id="other")), HAND)  # it knows what stands


def test_what_stands_far_away_is_not_on_the_plane() -> None:
    rng = np.random.default_rng(0)
    one = pack((-0.1, 0.03), (0.04, 0.06, 0.14))
    heights = rng.uniform(-0.03, 0.03, 300)
    far = [
        replace(one, id=f"far-{i}", position=TARGET + [1.5 + 0.01 * i, rng.normal(), z])
        for i, z in enumerate(heights)
    ]
    walls = [replace(obj, id=f"{obj.id}-wall", role="static") for obj in far]
    alone, among = (plane(shelf(one, *more), HAND) for more in ((), (*far, *walls)))
    np.testing.assert_array_equal(among.state, alone.state)
    assert len(among.bench.walls.size) == len(alone.bench.walls.size) == 1
    assert (among.bench.edge, among.entry, among.drop) == (
        alone.bench.edge,
        alone.entry,
        alone.drop,
    )
    near = [
        replace(one, id=f"near-{i}", position=TARGET + [0.0, 0.1 + 0.002 * i, 0.0])
        for i in range(300)
    ]
    crowded = plane(shelf(*near[::-1]), HAND)
    assert len(crowded.state) == 1 + STANDING.most
    np.testing.assert_allclose(
        np.sort(crowded.state[1:, 1]), 0.1 + 0.002 * np.arange(STANDING.most)
    )


def test_the_plane_is_what_stands_there() -> None:
    board = plane(shelf(pack((-0.1, 0.03), (0.04, 0.06, 0.14))), HAND)
    np.testing.assert_allclose(board.state, [[0, 0, 0], [-0.1, 0.03, 0]], atol=1e-12)
    assert board.bench.objects.size.tolist() == [0, 4]
    np.testing.assert_allclose(board.bench.objects.box[1], [-0.02, -0.03, 0.02, 0.03])
    assert board.bench.walls.size.tolist() == [4]
    np.testing.assert_allclose(board.bench.walls.box[0], [-0.15, 0.30, 0.15, 0.32])
    assert board.bench.edge == pytest.approx(-0.15)
    assert board.entry < -0.15 - (HAND.tip - HAND.reach)
    weight = 600.0 * 9.81 * 0.04 * 0.06 * 0.14
    assert 1.0 / board.bench.yields[1] == pytest.approx(0.4 * weight)
    assert board.spread.tolist() == [STANDING.unsure] * 2
