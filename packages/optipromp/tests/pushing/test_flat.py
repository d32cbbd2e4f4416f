"""Convex shapes on a plane."""

import numpy as np
import pytest
from tests.pushing.pushers import PUSHER, SQUARE, line

from optipromp.core.pushing.packs.flat import clear_ahead, shapes

WALL = np.array([[0.03, -0.1], [0.05, -0.1], [0.05, 0.1], [0.03, 0.1]])


def test_room_to_a_wall():
    walls, hand = shapes([WALL]), shapes([PUSHER])
    assert clear_ahead(line((-0.1, 0.0), (0.01, 0.0)), 1, hand, walls, np.inf) == pytest.approx(
        0.02
    )
    assert clear_ahead(line((-0.1, 0.0), (0.04, 0.0)), 1, hand, walls, np.inf) < 0.0


def test_more_room_than_enough_is_enough():
    walls, hand = shapes([WALL]), shapes([PUSHER])
    path = line((-0.1, 0.0), (0.01, 0.0))
    assert clear_ahead(path, 1, hand, walls, 0.015) == 0.015
    assert clear_ahead(path, 1, hand, walls, 0.025) == pytest.approx(0.02)


def test_normals_point_outward_and_are_unit():
    made = shapes([SQUARE, 0.03])
    np.testing.assert_allclose(made.normals[0, :4], [[0, -1], [1, 0], [0, 1], [-1, 0]], atol=1e-15)
    assert made.size.tolist() == [4, 0]
    np.testing.assert_allclose(made.radius, [0.02 * np.sqrt(2.0), 0.03])


def test_too_many_corners_are_refused():
    with pytest.raises(ValueError, match="9 corners"):
        shapes([np.zeros((9, 2))])


def test_what_is_not_convex_or_goes_clockwise_is_refused():
    dented = np.array([[0.0, 0.0], [0.04, 0.0], [0.02, 0.01], [0.0, 0.04]])
    for part in (dented, SQUARE[::-1]):
        with pytest.raises(ValueError, match="convex"):
            shapes([part])
