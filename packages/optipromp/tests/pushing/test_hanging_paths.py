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
from optipromp.core.pushing.stems.hanging import HANGING, rooms_beside
from optipromp.core.robots.library import load_robot
from optipromp.core.robots.tools import with_tool
from optipromp.core.scenes import SceneObject


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
