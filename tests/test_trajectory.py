"""The trajectory: validated once, immutable after; its derivatives; the shortest timing."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from optipromp.errors import Code, InvalidRequestError
from optipromp.trajectory import Trajectory, shortest_dt

NAMES = ("a", "b")


def line(waypoints: int = 5) -> np.ndarray:
    return np.linspace([0.0, 1.0], [1.0, -1.0], waypoints)


def test_what_it_says_of_itself() -> None:
    trajectory = Trajectory(line(), 0.25, NAMES)
    assert trajectory.n_waypoints == 5
    assert trajectory.duration == 1.0
    np.testing.assert_allclose(trajectory.times, [0.0, 0.25, 0.5, 0.75, 1.0])
    np.testing.assert_allclose(trajectory.velocities, np.tile([1.0, -2.0], (4, 1)))
    expected = np.zeros((5, 2))
    expected[0], expected[-1] = [4.0, -8.0], [-4.0, 8.0]  # from rest and to rest in one interval
    np.testing.assert_allclose(trajectory.accelerations, expected, atol=1e-12)


def test_accelerations_are_second_differences_from_rest() -> None:
    rng = np.random.default_rng(0)
    q, dt = rng.normal(size=(9, 2)), 0.1
    velocities = np.vstack([np.zeros(2), np.diff(q, axis=0) / dt, np.zeros(2)])
    expected = np.diff(velocities, axis=0) / dt
    np.testing.assert_allclose(Trajectory(q, dt, NAMES).accelerations, expected, atol=1e-9)


def test_it_keeps_a_copy_and_nobody_can_write_to_it() -> None:
    q = line()
    trajectory = Trajectory(q, 0.1, NAMES)
    q[0] = 9.0
    assert trajectory.positions[0, 0] == 0.0
    with pytest.raises(ValueError, match="read-only"):
        trajectory.positions[0, 0] = 1.0
    with pytest.raises(AttributeError):
        trajectory.dt = 1.0  # type: ignore[misc]
    slower = trajectory.with_dt(0.2)
    assert (trajectory.dt, slower.dt) == (0.1, 0.2)
    np.testing.assert_array_equal(slower.positions, trajectory.positions)
    assert slower.joint_names == NAMES


@pytest.mark.parametrize(
    ("positions", "dt", "names", "message"),
    [
        (line(2), 0.1, NAMES, "at least 3 waypoints"),
        (np.zeros((0, 2)), 0.1, NAMES, "at least 3 waypoints"),
        (np.zeros(6), 0.1, NAMES, "at least 3 waypoints"),
        (line(), 0.1, ("a",), "1 joint names for 2 columns"),
        (line(), 0.0, NAMES, "dt is 0"),
        (line(), -0.1, NAMES, "dt is -0.1"),
        (line(), np.nan, NAMES, "dt is nan"),
        (line(), np.inf, NAMES, "dt is inf"),
    ],
)
def test_refusals(positions: Any, dt: float, names: Any, message: str) -> None:
    with pytest.raises(InvalidRequestError, match=message) as caught:
        Trajectory(positions, dt, names)
    assert caught.value.code == Code.INVALID_REQUEST


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_a_value_that_is_not_finite_is_named(bad: float) -> None:
    q = line()
    q[3, 1] = bad
    with pytest.raises(InvalidRequestError, match="waypoint 3, joint 1"):
        Trajectory(q, 0.1, NAMES)


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 10_000), velocity=st.floats(0.1, 5.0), acceleration=st.floats(0.1, 20.0))
def test_the_shortest_timing_uses_a_limit_up_and_none_beyond(
    seed: int, velocity: float, acceleration: float
) -> None:
    q = np.random.default_rng(seed).normal(size=(7, 3)).cumsum(axis=0)
    limits = velocity * np.array([1.0, 2.0, np.inf]), acceleration * np.array([1.0, np.inf, 3.0])
    dt = shortest_dt(q, *limits)
    trajectory = Trajectory(q, dt, ("a", "b", "c"))
    used = max(
        np.max(np.abs(trajectory.velocities) / limits[0]),
        np.max(np.abs(trajectory.accelerations) / limits[1]),
    )
    assert used == pytest.approx(1.0, rel=1e-9)


def test_a_trajectory_that_stands_still_has_some_timing() -> None:
    assert shortest_dt(np.ones((4, 2)), np.ones(2), np.ones(2)) == 1e-3
    assert shortest_dt(line(), np.full(2, np.inf), np.full(2, np.inf)) == 1e-3
