"""``optipromp.timing``: waypoints of any arm within limits at every instant."""

import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.refusals import assert_refused

from optipromp.core.errors import InvalidRequestError
from optipromp.core.trajectory import Trajectory
from optipromp.timing import timed


def largest(curve: Trajectory, rate: float = 4000.0) -> np.ndarray:
    """Largest velocity, acceleration and jerk (3, n), by dense sampling."""
    t = np.arange(0.0, curve.duration, 1.0 / rate)
    _, v, a = curve.sample(t)
    jerk = np.abs(np.diff(a, axis=0)) * rate  # the mean over an interval
    return np.stack([np.abs(v).max(axis=0), np.abs(a).max(axis=0), jerk.max(axis=0)])


def optimum(way: float, v: float, a: float, j: float) -> float:
    """The least time of one joint from rest to rest: jerk ±j, acceleration ±a, speed v."""

    def ramp(speed: float) -> float:
        return speed / a + a / j if speed * j >= a * a else 2.0 * np.sqrt(speed / j)

    if way >= v * ramp(v):
        return 2.0 * ramp(v) + (way - v * ramp(v)) / v
    low, high = 0.0, v
    for _ in range(100):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if middle * ramp(middle) < way else (low, middle)
    return 2.0 * ramp(low)


@given(seed=st.integers(0, 10_000), count=st.integers(2, 12), joints=st.integers(1, 8))
@settings(max_examples=25, deadline=None)
def test_limits_hold_and_waypoints_are_passed(seed: int, count: int, joints: int) -> None:
    rng = np.random.default_rng(seed)
    q = np.cumsum(rng.normal(size=(count, joints)), axis=0)
    v, a, j = (rng.uniform(0.5, 2.0, joints) * size for size in (1.0, 8.0, 100.0))
    curve = timed(q, v, a, j)
    assert (largest(curve) <= np.stack([v, a, j]) * (1.0 + 1e-9)).all()
    rows = [int(np.abs(curve.positions - point).max(axis=1).argmin()) for point in q]
    np.testing.assert_allclose(curve.positions[rows], q, atol=1e-12)
    assert rows == sorted(rows)
    assert not curve.velocities[[0, -1]].any()
    assert (np.abs(curve.velocities[1:-1]).max(axis=1) > 0.0).all()  # it rests nowhere between


@pytest.mark.parametrize(
    ("way", "limits"),
    [(1.0, (2.0, 10.0, 100.0)), (1.0, (1.0, 10.0, 100.0)), (3.0, (1.0, 5.0, 50.0)),
     (0.2, (2.0, 10.0, 100.0)), (2.0, (2.175, 15.0, 7500.0))],
)  # fmt: skip
def test_one_joint_is_near_the_known_optimum(way: float, limits: tuple[float, ...]) -> None:
    best, found = optimum(way, *limits), timed([[0.0], [way]], *limits).duration
    assert best * (1.0 - 1e-9) <= found <= 1.2 * best


def test_it_stops_only_where_it_is_asked_to() -> None:
    q = np.array([[0.0, 0.0], [0.5, 0.3], [1.0, 0.2], [1.4, 0.6]])
    through, resting = timed(q, 1.0, 5.0, 50.0), timed(q, 1.0, 5.0, 50.0, stops=[1, 2])
    for point in q[1:-1]:
        row = int(np.abs(resting.positions - point).max(axis=1).argmin())
        np.testing.assert_allclose(resting.positions[row], point, atol=1e-12)
        assert not resting.velocities[row].any()
        assert not resting.accelerations[row].any()
        row = int(np.abs(through.positions - point).max(axis=1).argmin())
        assert np.abs(through.velocities[row]).max() > 0.2
    assert through.duration < resting.duration
    assert (largest(resting) <= np.array([[1.0], [5.0], [50.0]]) * (1.0 + 1e-9)).all()


def test_many_waypoints_and_no_limit_of_jerk() -> None:
    t = np.linspace(0.0, 6.0, 400)
    curve = timed(np.stack([np.sin(t), np.cos(t)], axis=1), 1.0, 3.0, np.inf)
    assert (largest(curve)[:2] <= np.array([[1.0], [3.0]]) * (1.0 + 1e-9)).all()
    assert 6.0 <= curve.duration < 9.0
    assert curve.joint_names == ("joint1", "joint2")


@pytest.mark.parametrize(
    ("given", "named"),
    [
        ({"waypoints": [[0.0]]}, "waypoints have shape (1, 1): must be (m, n), m >= 2"),
        ({"waypoints": [[0.0], [np.nan]]}, "waypoints[1][0] is nan"),
        ({"waypoints": [[0.0], [1.0], [1.0]]}, "waypoints 1 and 2 are the same"),
        ({"velocity": 0.0}, "velocity is 0.0: must be above 0"),
        ({"jerk": [1.0, 2.0]}, "jerk has shape (2,): must be one or (1,)"),
        ({"stops": [0]}, "stop is 0: must be from 1 to 1"),
        ({"joint_names": ["a", "b"]}, "2 joint names for 1 columns"),
    ],
)
def test_what_cannot_be_timed_is_refused(given: dict[str, object], named: str) -> None:
    usual = {
        "waypoints": [[0.0], [1.0], [2.0]], "velocity": 1.0, "acceleration": 1.0, "jerk": 1.0
    }  # fmt: skip
    assert_refused(InvalidRequestError, named, timed, **usual | given)


def test_it_loads_no_reader_and_no_simulation() -> None:
    code = (
        "import sys; from optipromp.timing import timed; timed([[0.0], [1.0]], 1.0, 1.0, 1.0);"
        "print('optipromp.readers' in sys.modules, 'mujoco' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["False", "False"]
