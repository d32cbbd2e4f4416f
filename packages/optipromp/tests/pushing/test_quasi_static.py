"""The quasi-static model on pushes whose end is known, and on random heaps."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.pushing.pushers import PUSHER, SQUARE, line

from optipromp.core.pushing.packs.flat import shapes
from optipromp.core.pushing.packs.quasi_static import Bench, push_once
from optipromp.core.pushing.parameters import PUSH
from optipromp.core.robots.tools import FrankaHand

NONE = shapes([])


def bench(objects, hand, friction, lever, walls=NONE):
    return Bench(objects, 1.0 / friction, lever**2, walls, hand, np.zeros(3), -np.inf)


def pushed(path, objects, state, walls=NONE, slip=0.4, friction=None, tool=PUSHER, **further):
    objects = shapes(objects)
    count = len(objects.size)
    friction = np.ones(count) if friction is None else np.array(friction)
    state = np.array([[*row, 0.0] if len(row) == 2 else row for row in state], dtype=float)
    lever = 0.5 * objects.radius
    return push_once(
        bench(objects, shapes([tool]), friction, lever, walls), path, state, slip, **further
    )


def test_what_is_not_touched_stays():
    result = pushed(line((-0.2, 0.0), (-0.1, 0.0)), [0.03, SQUARE], [(0, 0), (0.1, 0.1)])
    np.testing.assert_array_equal(result.state, [[0, 0, 0], [0.1, 0.1, 0]])
    assert result.force == 0.0
    assert result.done == 1.0


@pytest.mark.parametrize("obj", [0.02, SQUARE])
def test_a_push_through_the_centre_goes_straight(obj):
    result = pushed(line((-0.1, 0.0), (0.05, 0.0)), [obj], [(0.0, 0.0)])
    np.testing.assert_allclose(result.state, [[0.07, 0.0, 0.0]], atol=2 * PUSH.plane.settled)


def test_a_push_beside_the_centre_turns_a_box_away():
    finger = PUSHER * [1.0, 0.1]
    path = line((-0.1, 0.015), (0.0, 0.015))
    result = pushed(path, [SQUARE], [(0.0, 0.0)], tool=finger)
    u, v, turn = result.state[0]
    assert turn < -0.2  # pushed above its centre along +u it turns clockwise
    assert 0.0 < u < 0.02 + PUSH.plane.settled
    assert v < 0.01
    mirrored = pushed(path * [1, -1, 1], [SQUARE], [(0.0, 0.0)], tool=finger)
    np.testing.assert_allclose(mirrored.state[0], [u, -v, -turn], atol=2e-3)


def test_a_disc_met_off_centre_goes_aside():
    r"""Without friction at the contact it follows :math:`dv/du = (v/r)\sqrt{1 - v^2/r^2}`."""
    corner = np.array([[-0.03, -0.03], [0.0, 0.0], [-0.03, 0.03]])
    path = line((-0.1, 0.0), (0.0, 0.0), 0.0005)
    result = pushed(path, [0.02], [(0.0, 0.005)], tool=corner, slip=0.0)
    v, du = 0.005, 1e-6
    for _ in range(round(np.sqrt(0.02**2 - v**2) / du)):
        v += du * v / 0.02 * np.sqrt(1.0 - (v / 0.02) ** 2)
    assert result.state[0, 1] == pytest.approx(v, abs=1e-3)
    held = pushed(path, [0.02], [(0.0, 0.005)], tool=corner, slip=0.4)
    assert 0.005 < held.state[0, 1] < result.state[0, 1]


def test_a_row_moves_together_and_its_friction_adds_up():
    row = [(0.0, 0.0), (0.04, 0.0), (0.08, 0.0)]
    result = pushed(line((-0.1, 0.0), (0.02, 0.0)), [0.02] * 3, row, friction=[1.0, 2.0, 3.0])
    np.testing.assert_allclose(result.state[:, 0], [0.04, 0.08, 0.12], atol=6 * PUSH.plane.settled)
    assert result.force >= 0.8 * 6.0


def test_a_wall_jams():
    wall = shapes([np.array([[0.03, -0.1], [0.05, -0.1], [0.05, 0.1], [0.03, 0.1]])])
    result = pushed(line((-0.1, 0.0), (0.0, 0.0)), [0.02], [(0.0, 0.0)], wall)
    assert result.done < 1.0
    assert result.jam > 1e-3
    assert result.force > 10.0


def test_it_stops_where_the_first_object_may_go_no_farther():
    result = pushed(line((-0.1, 0.0), (0.05, 0.0)), [0.02], [(0.0, 0.0)], most=0.01)
    assert result.done < 1.0
    assert 0.01 < result.state[0, 0] < 0.013


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10_000))
def test_nothing_ends_inside_anything(seed):
    rng = np.random.default_rng(seed)
    radii = rng.uniform(0.015, 0.03, 5)
    centers: list[np.ndarray] = []
    for radius in radii:
        for _ in range(200):
            at = rng.uniform([0.0, -0.12], [0.2, 0.12])
            if all(
                np.linalg.norm(at - c) > radius + r
                for c, r in zip(centers, radii[: len(centers)], strict=True)
            ):
                break
        centers.append(at)
    result = pushed(
        line((-0.06, rng.uniform(-0.08, 0.08)), (0.1, rng.uniform(-0.08, 0.08))),
        [float(r) for r in radii], centers,
    )  # fmt: skip
    at = result.state[:, :2]
    for i in range(5):
        for j in range(i):
            gap = np.linalg.norm(at[i] - at[j]) - radii[i] - radii[j]
            if np.linalg.norm(np.array(centers[i]) - centers[j]) > radii[i] + radii[j]:
                assert gap > -max(result.jam, PUSH.plane.settled) - PUSH.plane.flat


def test_a_disc_goes_round_the_corner_of_a_pad():
    """At a finger's outer corner the normal is from the corner to the disc's centre."""
    hand, radius = shapes(list(FrankaHand().outline())), 0.026
    corner = np.array([0.0095, -0.0552])
    disc = corner + radius * np.array([0.76, -0.65])
    path = line((0.0, 0.0), (0.034, -0.015), 0.003)
    for count in range(2, len(path) + 1):
        among = bench(shapes([radius]), hand, np.ones(1), np.full(1, radius))
        result = push_once(among, path[:count], np.array([[*disc, 0.0]]), 0.4)
        off = result.state[0, :2] - (path[count - 1, :2] + corner)
        assert np.linalg.norm(off) == pytest.approx(radius, abs=2.0 * PUSH.plane.settled), count


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_nothing_goes_through_a_pad(sign):
    """A box beside a finger's pad is pushed by it (a finger is no convex shape, its parts are)."""
    hand = shapes(list(FrankaHand().outline()))
    path = line((0.0, 0.0), (0.0, sign * 0.03))
    state = np.array([[0.02, sign * 0.08, 0.0]])
    among = bench(shapes([SQUARE]), hand, np.ones(1), np.full(1, 0.02))
    result = push_once(among, path, state, 0.4)
    assert sign * result.state[0, 1] > 0.03 + 0.0552 + 0.02 - 5e-3


def test_what_comes_near_later_is_met_too():
    """Pairs are looked up anew as objects move: a far disc is met by one that is pushed to it."""
    gap = 3.0 * PUSH.plane.ahead
    row = [(0.02, 0.0), (0.06 + gap, 0.0)]
    result = pushed(line((-0.05, 0.0), (0.02 + gap, 0.0)), [0.02, 0.02], row)
    at = 0.02 + gap + 0.02
    np.testing.assert_allclose(result.state[:, 0], [at, at + 0.04], atol=4 * PUSH.plane.settled)
