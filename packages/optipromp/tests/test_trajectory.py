"""The trajectory: a curve that is checked once and immutable; its samples; its spline."""

import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import BPoly, make_interp_spline

from optipromp.core.errors import Code, InvalidRequestError
from optipromp.core.robots.turns import Turns
from optipromp.core.trajectory import State, Trajectory, read_trajectory

NAMES = ("a", "b")


def line(waypoints: int = 5) -> np.ndarray:
    return np.linspace([0.0, 1.0], [1.0, -1.0], waypoints)


def any_curve(seed: int, rows: int = 6) -> Trajectory:
    rng = np.random.default_rng(seed)
    times = np.append(0.0, rng.uniform(0.05, 0.5, rows - 1).cumsum())
    return Trajectory(times, *rng.normal(size=(3, rows, 2)), NAMES)


def independent(curve: Trajectory) -> Any:
    """The same curve by SciPy, from positions, velocities and accelerations at the rows."""
    rows = np.stack([curve.positions, curve.velocities, curve.accelerations], axis=1)
    return BPoly.from_derivatives(curve.times, list(rows))


@given(seed=st.integers(0, 10_000))
@settings(max_examples=40, deadline=None)
def test_samples_are_those_of_scipys_quintics(seed: int) -> None:
    curve, rng = any_curve(seed), np.random.default_rng(seed)
    t = np.sort(np.append(rng.uniform(0.0, curve.duration, 50), curve.times))
    wanted = independent(curve)
    for order, values in enumerate(curve.sample(t)):
        expected = wanted.derivative(order)(t) if order else wanted(t)
        np.testing.assert_allclose(values, expected, atol=1e-8 * np.abs(expected).max())


def test_before_and_after_it_stays() -> None:
    curve = Trajectory.through(line(), 0.25, NAMES)
    q, velocity, acceleration = curve.sample([-1.0, 5.0])
    np.testing.assert_array_equal(q, curve.positions[[0, -1]])
    assert not velocity.any()
    assert not acceleration.any()


@given(seed=st.integers(0, 10_000), rate=st.floats(3.0, 2000.0))
@settings(max_examples=40, deadline=None)
def test_rows_at_another_rate_are_the_same_curve(seed: int, rate: float) -> None:
    curve = Trajectory.through(any_curve(seed).positions, any_curve(seed).times, NAMES)
    again = curve.resample(rate)
    assert again.duration == curve.duration
    steps = np.diff(again.times)
    np.testing.assert_allclose(steps[:-1], 1.0 / rate, rtol=1e-6)
    assert steps[-1] <= (1.0 + 1e-5) / rate
    for values, given_ in zip(
        (again.positions, again.velocities, again.accelerations), curve.sample(again.times),
        strict=True,
    ):  # fmt: skip
        np.testing.assert_array_equal(values, given_)
    if rate > 500.0:  # between its rows too
        t = np.linspace(0.0, curve.duration, 777)
        for values, given_ in zip(again.sample(t), curve.sample(t), strict=True):
            np.testing.assert_allclose(values, given_, atol=2e-3 * np.abs(given_).max())


@given(seed=st.integers(0, 10_000), rows=st.integers(2, 60), moving=st.booleans())
@settings(max_examples=40, deadline=None)
def test_through_waypoints_it_is_scipys_spline(seed: int, rows: int, moving: bool) -> None:
    rng = np.random.default_rng(seed)
    times = np.append(0.0, rng.uniform(0.01, 0.3, rows - 1).cumsum())
    q = rng.normal(size=(rows, 2)).cumsum(axis=0)
    first = rng.normal(size=(2, 2)) if moving else np.zeros((2, 2))
    made = Trajectory.through(q, times, NAMES, begin=State(q[0], *first))
    ends = [(1, first[0]), (2, first[1])], [(1, np.zeros(2)), (2, np.zeros(2))]
    wanted = make_interp_spline(times, q, k=5, bc_type=ends)
    for order, values in enumerate((made.velocities, made.accelerations), start=1):
        expected = wanted(times, order)
        np.testing.assert_allclose(values, expected, atol=1e-7 * (1.0 + np.abs(expected).max()))


def test_slowed_beyond_what_times_can_be_it_is_refused() -> None:
    for factor in (1e12, 1e200):
        with pytest.raises(InvalidRequestError, match=r"times\[\d\] is .* must be at most 1e\+09"):
            any_curve(3).slowed(factor)


def test_slowed_it_is_the_same_path() -> None:
    curve = any_curve(1)
    slow, t = curve.slowed(3.0), np.linspace(0.0, curve.duration, 40)
    for k, (now, before) in enumerate(zip(slow.sample(3.0 * t), curve.sample(t), strict=True)):
        np.testing.assert_allclose(now, before / 3.0**k, atol=1e-9)


def test_the_state_at_an_instant() -> None:
    curve = any_curve(2)
    state = curve.at(0.3)
    assert state.moving
    np.testing.assert_array_equal(state.q, curve.sample(0.3)[0][0])
    assert not State(np.zeros(2)).moving
    with pytest.raises(InvalidRequestError, match=r"state\.velocity has shape"):
        State(np.zeros(2), np.zeros(3))
    with pytest.raises(InvalidRequestError, match="must be finite"):
        State(np.array([0.0, np.nan]))


def test_it_keeps_a_copy_and_nobody_can_write_to_it() -> None:
    q = line()
    trajectory = Trajectory.through(q, 0.1, NAMES)
    q[0] = 9.0
    assert trajectory.positions[0, 0] == 0.0
    for name in ("times", "positions", "velocities", "accelerations"):
        with pytest.raises(ValueError, match="read-only"):
            getattr(trajectory, name)[0] = 1.0
    with pytest.raises(AttributeError):
        trajectory.times = q  # type: ignore[misc]


@pytest.mark.parametrize(
    ("positions", "times", "names", "message"),
    [
        (line(1), 0.1, NAMES, "at least 2 waypoints"),
        (np.zeros((0, 2)), 0.1, NAMES, "at least 2 waypoints"),
        (np.zeros(6), 0.1, NAMES, r"shape \(6,\): must be \(k, n\)"),
        (line(), 0.1, ("a",), "1 joint names for 2 columns"),
        (line(), 0.0, NAMES, "dt is 0"),
        (line(), -0.1, NAMES, "dt is -0.1"),
        (line(), np.nan, NAMES, "dt is nan"),
        (line(), np.inf, NAMES, "dt is inf"),
        (line(), np.arange(4.0), NAMES, "4 times for 5 waypoints"),
        (line(), np.arange(1.0, 6.0), NAMES, "times begin at 1"),
        (line(), np.array([0.0, 1.0, 1.0, 2.0, 3.0]), NAMES, "do not grow: 1 s at waypoint 1"),
        (line(), np.array([0.0, 1.0, np.nan, 2.0, 3.0]), NAMES, r"times\[2\] is nan: must be"),
    ],
)
def test_refusals(positions: Any, times: Any, names: Any, message: str) -> None:
    with pytest.raises(InvalidRequestError, match=message) as caught:
        Trajectory.through(positions, times, names)
    assert caught.value.code == Code.INVALID_REQUEST


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("what", ["positions", "velocities", "accelerations"])
def test_a_value_that_is_not_finite_is_named(bad: float, what: str) -> None:
    rows = {name: line() for name in ("positions", "velocities", "accelerations")}
    rows[what][3, 1] = bad
    with pytest.raises(InvalidRequestError, match=rf"{what}\[3, 1\] is .*: must be finite"):
        Trajectory(np.arange(5.0), **rows, joint_names=NAMES)


@pytest.mark.parametrize(
    ("rate", "message"), [(0.0, "positive"), (np.nan, "positive"), (1e9, "10 million")]
)
def test_a_rate_that_makes_no_rows(rate: float, message: str) -> None:
    with pytest.raises(InvalidRequestError, match=message):
        Trajectory.through(line(), 0.1, NAMES).resample(rate)


def of_file(path: Path, times: np.ndarray, q: np.ndarray) -> Trajectory:
    """The trajectory of a CSV of one joint."""
    rows = "".join(f"{t:.12f},{value:.12f}\n" for t, value in zip(times, q, strict=True))
    path.write_text("time,a\n" + rows)
    return read_trajectory(path, ("a",))


@pytest.mark.parametrize("gap", [0.0, 1e-9, 1e-6, 1e-4])
@pytest.mark.parametrize("row", [0, 15, 30])
def test_rows_close_in_time_are_one(gap: float, row: int, tmp_path: Path) -> None:
    """A row that was written twice made a jerk of 3e9 times the limit."""
    times = np.linspace(0.0, 3.0, 31)
    s = times / 3.0
    q = 10 * s**3 - 15 * s**4 + 6 * s**5
    plain = of_file(tmp_path / "a.csv", times, q)
    twice = of_file(
        tmp_path / "b.csv",
        np.insert(times, row + 1, times[row] + gap),
        np.insert(q, row + 1, q[row]),
    )
    at = np.linspace(0.0, 3.0, 301)
    for one, other, most in zip(
        plain.sample(at), twice.sample(at), (1e-4, 1e-3, 0.02), strict=True
    ):
        assert np.abs(one - other).max() < most
    jump = np.insert(q, row + 1, q[row] + 0.01)
    with pytest.raises(InvalidRequestError, match=rf"waypoints {row} and {row + 1} .*a differs"):
        of_file(tmp_path / "c.csv", np.insert(times, row + 1, times[row] + gap), jump)


def test_times_that_look_like_milliseconds_are_told(tmp_path: Path) -> None:
    times = np.linspace(0.0, 3.0, 31)
    with pytest.warns(UserWarning, match="rows are 100 s apart: are times in milliseconds"):
        of_file(tmp_path / "a.csv", 1e3 * times, times)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        of_file(tmp_path / "b.csv", times, times)


@pytest.mark.parametrize("form", ["csv", "npz"])
@pytest.mark.parametrize("low", [-np.pi, 0.0])
def test_a_recording_within_one_turn_is_the_motion_and_a_word_of_it(tmp_path, form, low):
    """Also where rows are far apart: a step of half a turn is one, a whole turn is none."""
    turn, times = 2.0 * np.pi, np.linspace(0.0, 3.0, 31)
    begin = low + turn - 0.28
    true = np.column_stack([begin + 0.3 * times, np.where(times < 1.5, -1.6, 1.6)])
    told = np.column_stack([(true[:, 0] - low) % turn + low, true[:, 1]])
    path = tmp_path / f"t.{form}"
    if form == "csv":
        rows = np.column_stack([times, told])
        np.savetxt(path, rows, delimiter=",", header="time,a,b", comments="", fmt="%.12f")
    else:
        np.savez(path, times=times, positions=told, joint_names=np.array(["a", "b"]))
    turns = Turns(np.array([True, True]), np.full(2, -np.inf), np.full(2, np.inf))
    with pytest.warns(UserWarning, match=r"a steps by a whole turn before row \d+: read as"):
        found = read_trajectory(path, ("a", "b"), turns.as_motion)
    away = np.round((found.positions[0, 0] - begin) / turn) * turn
    np.testing.assert_allclose(found.positions - [away, 0.0], true, atol=1e-9)
    np.testing.assert_allclose(found.velocities[10:20, 0], 0.3, atol=1e-3)
    assert np.abs(np.diff(read_trajectory(path, ("a", "b")).positions[:, 0])).max() > 6.0
