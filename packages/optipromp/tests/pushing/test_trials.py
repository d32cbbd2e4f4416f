"""Costs of ways: what a way does that it should not, and giving up early."""

import numpy as np
import pytest

from optipromp.core.pushing.packs import standing
from optipromp.core.pushing.packs.standing import plane
from optipromp.core.pushing.parameters import PUSH
from optipromp.core.pushing.path import stepped
from optipromp.core.robots.tools import FrankaHand
from optipromp_sim.generate import generate

HAND = FrankaHand()


@pytest.fixture(scope="module")
def tried():
    board = plane(generate("shelf", 1), HAND)
    rng = np.random.default_rng(0)
    states = np.tile(board.state, (8, 1, 1))
    states[1:, :, :2] += 0.006 * rng.standard_normal((7, len(board.state), 2))
    return board, board.bench, states, np.full(8, 0.4)


def ways(board, count=40):
    rng = np.random.default_rng(1)
    for _ in range(count):
        along, aside = rng.uniform(board.entry, 0.0, 3), rng.normal(0.0, 0.05, 3)
        middle = np.column_stack([along, aside, np.zeros(3)])
        yield np.vstack([[board.entry, 0.0, 0.0], middle, np.zeros(3)])


def test_steps_are_equal_and_meet_the_ends():
    corners = np.array([[-0.2, 0.05, 0.0], [-0.1, -0.02, 0.0], [-0.1, -0.02, 0.0], [0.0, 0.0, 0.0]])
    path = stepped(corners, PUSH.pack.step)
    np.testing.assert_array_equal(path[[0, -1]], corners[[0, -1]])
    steps = np.linalg.norm(np.diff(path, axis=0), axis=1)
    assert steps.max() <= 0.004 + 1e-12
    assert np.quantile(steps, 0.9) == pytest.approx(steps.max())  # a corner is cut in one step


def test_a_limit_changes_no_cost_below_it(tried):
    board, *rest = tried
    told, so_far = 0, np.random.default_rng(2).uniform(0.0, 50.0, 8)
    for way in ways(board):
        whole = standing.cost_of(rest[0], way, *rest[1:], np.zeros(8), np.inf)
        assert standing.cost_of(rest[0], way, *rest[1:], so_far, whole * 1.001) == whole
        less = standing.cost_of(rest[0], way, *rest[1:], so_far, whole * 0.5)
        assert less > whole * 0.5
        told += less == np.inf
    assert told > 20  # most are given up before the last trial


def test_a_jam_costs_more_the_earlier_it_comes(tried):
    board, bench, states, slips = tried
    side = float(board.bench.walls.box[:, 3].max())  # the outer side of a wall
    straight = np.array([[board.entry, 0.0, 0.0], [0.0, 0.0, 0.0]])
    early = np.insert(straight, 1, [board.entry + 0.03, side, 0.0], axis=0)
    costs = [
        standing.cost_of(bench, way, states[:1], slips[:1], np.zeros(1), np.inf)
        for way in (early, straight)
    ]
    assert costs[0] > PUSH.pack.worst
    assert costs[0] > costs[1]
