"""Which paths a cup is led on among fruits on stems: candidates, preferences, the search."""

from functools import partial

import numpy as np
import pytest
from tests.pushing.fruits import TARGET, UP
from tests.pushing.hanging import (
    CAMERA,
    CUP,
    LEANING,
    STRAIGHT,
    UNDER,
    fruit,
    harm,
    judged,
    led,
    model,
    scene,
)

from optipromp.core.geometry import Box, HalfSpace, Sphere, distances, pack
from optipromp.core.pushing.parameters import PUSH
from optipromp.core.pushing.path import through, turning
from optipromp.core.pushing.rules import neighbours, rule_paths
from optipromp.core.pushing.searching import search
from optipromp.core.pushing.stems.hanging import HANGING, PathsPast, rooms_beside
from optipromp.core.robots.library import load_robot
from optipromp.core.robots.tools import with_tool
from optipromp.core.scenes import SceneObject
from optipromp.laboratory.generate import generate


def test_the_room_about_an_upright_tool_is_the_distance_less_its_radius() -> None:
    rng = np.random.default_rng(3)
    up = np.array([0.0, 0.6, 0.8])
    heights, none = np.array([-0.1, 0.0, 0.03]), np.eye(3)
    for count in range(5):
        balls = [(Sphere(0.02), at, none) for at in rng.uniform(-0.2, 0.2, (count, 3))]
        obstacles = pack([*balls, (HalfSpace(), np.array([0.0, 0.0, -0.3]), none)])
        points = rng.uniform(-0.2, 0.2, (12, 3))
        where = (points[:, None] + heights[:, None] * up).reshape(-1, 3)
        room = distances(obstacles, where)[0].reshape(12, -1).min(axis=1) - 0.03
        for most in (0.01, 0.3):
            expected = min(room.min(), most), min(room[-1], most)
            assert rooms_beside(points, heights, up, obstacles, 0.03, most) == pytest.approx(
                expected
            )


def test_candidates_begin_at_the_camera_and_end_at_the_target() -> None:
    a = model(UNDER, fruit("n2", (-0.02, 0.01, -0.14), LEANING))
    rng = np.random.default_rng(0)
    mean, spread = a.candidates.spread(0)
    for x in [*a.candidates.first(), *(mean + spread * rng.standard_normal((20, len(mean))))]:
        path = a.candidates.path(x)
        np.testing.assert_allclose(path.points[[0, -1]], [CAMERA, TARGET], atol=1e-12)
        off = path.points - TARGET
        widest = np.linalg.norm(off[:, :2], axis=1).max()
        assert widest < 0.03 + CUP.radius + HANGING.clearance_most * 0.015
        assert a.candidates.aside(x, path) >= 0.0


def test_the_first_candidate_is_the_rules_path() -> None:
    fruits = UNDER, fruit("n2", (-0.02, 0.01, -0.14), LEANING)
    one = scene(*fruits)
    a = model(*fruits)
    robot = with_tool(load_robot("panda"), CUP)
    (corners, *_) = rule_paths(one, neighbours(one, CUP.gripper_radius), robot, CAMERA)
    rule = through(corners, 0.1).points
    path = a.candidates.path(a.candidates.first()[0]).points
    gap = np.linalg.norm(path[:, None] - rule[None], axis=2).min(axis=1)
    assert gap.max() < 0.006  # the rims' rounded corners are taken in a little earlier


def test_a_path_of_no_harm_is_found_past_a_fruit_on_the_way() -> None:
    a = model(fruit("n1", (0.003, 0.0, -0.08), LEANING))
    found = list(search(a, partial(turning, UP, None), np.random.default_rng(0)))
    assert found[0][0].harm < a.good
    assert min(a.harm(*judged(path), a.states) for path, _ in found) < a.good
    assert harm(a, STRAIGHT, a.states) > 0.9 * PUSH.harm.hopeless


def test_a_path_along_a_wall_is_raised_by_what_it_lacks_in_clearance() -> None:
    a = model(UNDER)
    x = a.candidates.first()[0]
    way = a.candidates.path(x)
    k = len(way.points) // 2
    middle = way.points[k]
    out = np.array([1.0, 0.0, 0.0])
    raised = []
    for gap in (0.05, 0.004, 0.001, -0.001):
        at = middle + (CUP.radius + gap + 0.005) * out
        wall = SceneObject("wall", "static", Box((0.01, 0.2, 0.02)), at)
        raised.append(model(UNDER, wall).candidates.aside(x, way) - a.candidates.aside(x, way))
    assert raised[0] == 0.0
    assert raised[1] <= raised[2] < raised[3]
    assert raised[3] > 0.5


def test_a_detour_counts() -> None:
    a = model(UNDER)
    straight, round_about = STRAIGHT, led((0, 0, -0.25), (0.1, 0, -0.125), (0, 0, 0))
    assert a.candidates.aside(a.candidates.first()[0], straight) == pytest.approx(0.0, abs=1e-9)
    longer = (round_about.length - 0.25) / 0.25
    assert a.candidates.aside(a.candidates.first()[0], round_about) == pytest.approx(0.5 * longer)


@pytest.mark.parametrize("lean", [0.0, 1.0, 2.5])
def test_a_path_on_a_stem_s_side_has_one_on_the_other_side_that_is_preferred(lean: float) -> None:
    """Mirrored at right angles to the lean; nothing is preferred to what passes away from it."""
    stem = (0.06 * np.cos(lean), 0.06 * np.sin(lean), 0.2)
    bench = model(fruit("n1", (0.0, 0.0, -0.08), stem))
    x_g, y_g, z_g = bench.candidates.scene.frame
    lateral = np.array(stem) - np.dot(stem, z_g) * z_g

    def side(x: np.ndarray) -> float:
        points = bench.candidates.path(x).points
        at = points[np.argmax((points - TARGET) @ z_g >= -0.08 - bench.cup.rim)]
        off = at - bench.candidates.neighbours[0].position
        return float((off - (off @ z_g) * z_g) @ lateral)

    angle = np.arctan2(lateral @ y_g, lateral @ x_g)
    for turn in (0.0, 0.7, -1.2):
        wrong, right = (np.array([angle + turn + back, 0.8]) for back in (0.0, np.pi))
        assert side(wrong) > 0.0 > side(right)
        preferred = bench.candidates.rather(wrong, bench.candidates.path(wrong))
        assert len(preferred) == 2
        for x in preferred:
            assert side(x) < 0.0
            assert x[1] == 0.8
            assert not bench.candidates.rather(x, bench.candidates.path(x))
        split = bench.candidates._split
        mirrored = split(preferred[0])[0][0] + split(wrong)[0][0]
        np.testing.assert_allclose(mirrored @ lateral, 0.0, atol=1e-12)
        assert not bench.candidates.rather(right, bench.candidates.path(right))


def test_nothing_is_preferred_where_no_stem_leans() -> None:
    bench = model(UNDER)
    x = bench.candidates.first()[1]
    assert bench.candidates.rather(x, bench.candidates.path(x)) == []
    assert model().candidates.rather(np.zeros(0), model().candidates.path(np.zeros(0))) == []


def test_of_two_harmless_sides_a_plan_takes_the_one_away_from_the_stem(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    from optipromp.core.planning import plan

    crowd = generate("mixed", 43006)
    made = plan(crowd)
    assert made.success
    assert "side of its stem" not in made.message
    monkeypatch.setattr(PathsPast, "rather", lambda *_: [])
    other = plan(crowd)
    assert other.success
    assert "side of its stem" in other.message
    assert made.prediction is not None
    assert other.prediction is not None
    assert made.prediction.harm < other.prediction.harm + HANGING.stem_side
