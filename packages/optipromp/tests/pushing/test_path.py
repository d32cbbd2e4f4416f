"""The tool's path: where it ends, how far it leaves its corners, and that it has no kinks."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from optipromp.core.pushing.path import ROUNDING, STEP, ToolPath, along, evenly, length, through

WINDOW = 2 * int(0.5 * ROUNDING / STEP) + 1  # points in each of the two moving averages
# Mean distance along the arc of the points that are averaged: the sum of two uniform numbers.
SPREAD = STEP * (WINDOW**2 - 1.0) / (3.0 * WINDOW)


@st.composite
def polylines(draw: st.DrawFn) -> np.ndarray:
    """Corners (k, 3) in any direction, hairpins too; the first and last piece are 15 mm or more."""
    count = draw(st.integers(1, 6))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    pieces = rng.normal(size=(count, 3))
    pieces /= np.linalg.norm(pieces, axis=1, keepdims=True)
    if draw(st.booleans()) and count > 1:
        pieces[1] = -pieces[0]  # straight back
    sizes = rng.uniform(0.001, 0.1, count)
    sizes[[0, -1]] = np.maximum(sizes[[0, -1]], 0.015)
    return np.vstack([np.zeros(3), np.cumsum(sizes[:, None] * pieces, axis=0)])


def away(points: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Distance (P,) of points to a polyline."""
    best = np.full(len(points), np.inf)
    for a, b in itertools.pairwise(corners):
        along = np.clip((points - a) @ (b - a) / max((b - a) @ (b - a), 1e-30), 0.0, 1.0)
        best = np.minimum(best, np.linalg.norm(points - a - along[:, None] * (b - a), axis=1))
    return best


@settings(max_examples=200, deadline=None)
@given(polylines())
def test_a_path_keeps_its_ends_and_stays_near_its_corners(corners: np.ndarray) -> None:
    path = through(corners, 0.1)
    np.testing.assert_allclose(path.points[[0, -1]], corners[[0, -1]], rtol=0.0, atol=1e-12)
    assert away(path.points, corners).max() <= SPREAD + 1e-9
    steps = np.linalg.norm(np.diff(path.points, axis=0), axis=1)
    assert steps.max() <= STEP * (1.0 + 1e-9)
    assert path.length == pytest.approx(steps.sum())
    assert path.length <= length(corners) + 1e-12


@settings(max_examples=200, deadline=None)
@given(polylines())
def test_a_path_has_no_kinks(corners: np.ndarray) -> None:
    """Its direction turns little by little, and how fast it turns changes little by little.

    A step of the polyline turns by 2 at most where it is averaged over none. Averaged twice over
    W points the second differences are at most 2 / W of a step, and they change by 4 / W² at most.
    """
    points = through(corners, 0.1).points
    second = np.diff(points, 2, axis=0)
    assert np.linalg.norm(second, axis=1).max(initial=0.0) <= 2.0 / WINDOW * STEP * (1.0 + 1e-6)
    third = np.linalg.norm(np.diff(second, axis=0), axis=1)
    assert third.max(initial=0.0) <= 4.0 / WINDOW**2 * STEP * (1.0 + 1e-6)


@pytest.mark.parametrize("degrees", [10.0, 30.0, 90.0, 150.0])
def test_a_corner_is_cut_by_what_its_angle_asks_for(degrees: float) -> None:
    """By sin(angle / 2) of the spread of the averages: 1 mm of a corner of 30 degrees."""
    turn = np.deg2rad(degrees)
    corner = np.array([0.1, 0.0, 0.0])
    corners = np.array(
        [np.zeros(3), corner, corner + 0.1 * np.array([np.cos(turn), np.sin(turn), 0])]
    )
    points = through(corners, 0.1).points
    cut = np.linalg.norm(points - corner, axis=1).min()
    assert cut == pytest.approx(SPREAD * np.sin(turn / 2.0), rel=0.02)
    if degrees == 30.0:
        assert cut == pytest.approx(0.001, abs=1e-4)
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    assert steps.min() >= np.cos(turn / 2.0) * steps.max() * (1.0 - 1e-6)


def test_corners_that_are_one_make_no_trouble() -> None:
    twice = np.array([[0.0, 0, 0], [0.05, 0, 0], [0.05, 0, 0], [0.05, 0.05, 0]])
    np.testing.assert_allclose(
        through(twice, 0.1).points, through(twice[[0, 1, 3]], 0.1).points, atol=1e-12
    )
    still = through(np.zeros((3, 3)), 0.1)
    np.testing.assert_array_equal(still.points, np.zeros((2, 3)))
    assert still.length == 0.0


@settings(max_examples=100, deadline=None)
@given(polylines(), st.integers(2, 80))
def test_even_points_lie_on_the_corners_at_equal_distances(corners: np.ndarray, count: int) -> None:
    points = evenly(corners, count)
    np.testing.assert_array_equal(points[[0, -1]], corners[[0, -1]])
    assert away(points, corners).max() < 1e-12
    # the same places, by arc length, from an independent interpolation
    gone = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(corners, axis=0), axis=1)))
    assert length(corners) == pytest.approx(gone[-1])
    at = np.linspace(0.0, gone[-1], count)
    wanted = np.stack([np.interp(at, gone, column) for column in corners.T], axis=1)
    np.testing.assert_allclose(points, wanted, atol=1e-9)
    values = along(corners, gone[:, None], count)[:, 0]
    np.testing.assert_allclose(values, at, atol=1e-9)


def test_shares_of_a_path_go_from_its_entry_to_its_goal() -> None:
    path = ToolPath(np.array([[0.0, 0, 0], [1.0, 0, 0], [1.0, 1.0, 0]]), 0.1)
    np.testing.assert_allclose(
        path.at(np.array([0.0, 0.25, 0.5, 1.0])), [[0, 0, 0], [0.5, 0, 0], [1, 0, 0], [1, 1, 0]]
    )
