"""The broad phase forgets no obstacle that matters."""

import numpy as np
import pytest

from optipromp.core.geometry import Box, Capsule, HalfSpace, Obstacles, Sphere, distances, pack
from optipromp.core.geometry.obstacles import FEWEST, cell_at
from optipromp.core.optimization.evaluation import BodyPoints, Evaluation
from optipromp.core.robots.library import load_robot

REACH, WITHIN = 0.15, 1.3


def clutter(count: int, seed: int, **cells: float) -> Obstacles:
    rng = np.random.default_rng(seed)
    shapes = [Sphere(0.02), Box((0.1, 0.02, 0.3)), Capsule(0.01, 0.2), Sphere(0.3)]
    items = [
        (shapes[int(rng.integers(4))], rng.uniform(-1.6, 1.6, 3), np.eye(3)) for _ in range(count)
    ]
    items.insert(count // 2, (HalfSpace(), np.array([0.0, 0.0, -0.5]), np.eye(3)))
    return pack(items, **cells)


@pytest.mark.parametrize("seed", range(3))
def test_every_obstacle_within_reach_is_in_the_list_of_the_place(seed: int) -> None:
    obstacles = clutter(200, seed, reach=REACH, within=WITHIN)
    cells = obstacles.cells
    rng = np.random.default_rng(seed)
    corners = (np.floor(rng.uniform(-10, 10, (200, 3))) / cells.inverse).clip(-WITHIN, WITHIN)
    points = np.vstack([rng.uniform(-1.5, 1.5, (2000, 3)), corners, np.full((1, 3), 1e9)])
    near = distances(obstacles, points)[0] <= REACH
    for point, wanted in zip(points, near, strict=True):
        cell = cell_at(cells, *point)
        listed = cells.member[cells.start[cell] : cells.start[cell + 1]]
        assert (np.diff(listed) > 0).all()
        assert set(np.flatnonzero(wanted)) <= set(listed.tolist())


def test_few_obstacles_and_those_without_a_reach_have_no_cells() -> None:
    assert clutter(FEWEST - 2, 0, reach=REACH, within=WITHIN).cells.reach == 0.0
    assert clutter(200, 0).cells.reach == 0.0


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("cutoff", [0.013, 0.06, 0.5])
def test_the_field_is_the_same_with_cells_and_without(seed: int, cutoff: float) -> None:
    robot = load_robot("panda")
    body = BodyPoints(robot)
    rng = np.random.default_rng(seed)
    e = Evaluation(robot, body, 40, 1.0)
    e.move_to(rng.uniform(robot.lower, robot.upper, (40, 7)))
    reach = 0.061 + float(robot.spheres.radius.max())
    found = []
    for cells in ({}, {"reach": reach, "within": WITHIN}):
        obstacles = clutter(300, seed, **cells)
        e.static.measure(e, obstacles, 120, cutoff)
        found.append((e.static.distance.copy(), e.static.normal.copy()))
    assert (found[0][0] < cutoff).any()
    for one, other in zip(*found, strict=True):
        np.testing.assert_array_equal(one, other)
