"""Where an arm was, by its joint states; and positions that are whole turns apart."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from optipromp.core.errors import InvalidRequestError
from optipromp.core.robots.kernels import PRISMATIC
from optipromp.core.robots.library import load_robot
from optipromp.core.robots.measured import Measured
from optipromp.core.robots.turns import TURN, Turns

JOINTS = ("shoulder", "elbow", "wrist", "roll")
# a joint without limits, one of less than a turn, one of two turns to both sides, a slide
LOWER, UPPER = np.array([-np.inf, -2.0, -TURN, -9.0]), np.array([np.inf, 2.0, TURN, 9.0])
TURNS = Turns(np.array([True, False, True, False]), LOWER, UPPER)
RATES = np.array([0.9, 0.2, 0.7, 0.4])  # [rad/s or m/s]


def reported(q: np.ndarray, low: float = -np.pi) -> np.ndarray:
    """As encoders report the joints that may turn: from ``low`` on, within one turn."""
    return np.where(TURNS.may, (q - low) % TURN + low, q)


def moved(times: np.ndarray) -> np.ndarray:
    return np.array([3.0, 0.1, -3.0, 1.0]) + RATES * np.atleast_1d(times)[:, None]


def arm(**named: object) -> Measured:
    return Measured(JOINTS, TURNS, **named)  # type: ignore[arg-type]


@given(
    st.lists(st.floats(-3.0, 3.0), min_size=1, max_size=40),
    st.sampled_from([-np.pi, 0.0, -1.0]),
    st.floats(-50.0, 50.0),
)
def test_what_is_wound_up_and_unwound_is_the_same_but_for_whole_turns(steps, low, begin):
    q = np.zeros((len(steps) + 1, 4))
    q[:, 0] = begin + np.append(0.0, np.cumsum(steps))
    told = reported(q, low)
    found = TURNS.unwound(told)
    np.testing.assert_allclose(np.diff(found, axis=0), np.diff(q, axis=0), atol=1e-9)
    np.testing.assert_allclose(np.sin(found - q), 0.0, atol=1e-9)
    np.testing.assert_allclose(reported(found, low) - told, 0.0, atol=TURN + 1e-9)
    assert np.array_equal(TURNS.unwound(found), found)


@given(st.lists(st.floats(-6.0, 6.0), min_size=8, max_size=8))
def test_a_turn_is_taken_out_only_of_joints_that_may_and_within_their_limits(values):
    q, other = np.array(values[:4]), np.array(values[4:])
    away, on = TURNS.apart(q, other), TURNS.onto(q, other)
    assert np.array_equal(away, on - other)
    assert np.array_equal(on[~TURNS.may], q[~TURNS.may])
    assert abs(away[0]) <= np.pi + 1e-9
    assert LOWER[2] - 0.05 <= on[2] <= UPPER[2] + 0.05
    turns = (on - q) / TURN
    np.testing.assert_allclose(turns, np.round(turns), atol=1e-9)


def test_robots_say_which_of_their_joints_may_turn() -> None:
    """A UR's joints have a turn of room to either side, a Panda's have less than one in all."""
    robot = load_robot("panda")
    assert not robot.turns.may.any()
    lower, upper = robot.lower.copy(), robot.upper.copy()
    lower[:3], upper[:3] = (-np.inf, -TURN, 0.0), (np.inf, TURN, 6.0)
    wide = replace(robot, lower=lower, upper=upper)
    assert np.flatnonzero(wide.turns.may).tolist() == [0, 1]
    assert np.flatnonzero(wide.turns.endless).tolist() == [0]
    kin = wide.kinematics
    for k, half in ((0, [1]), (1, [0])):  # what follows it makes half a turn, or slides
        ratio = np.where(kin.dof == k, 0.5, kin.multiplier)
        slides = np.where(kin.dof == k, PRISMATIC, kin.kind)
        for other in (kin._replace(multiplier=ratio), kin._replace(kind=slides)):
            assert np.flatnonzero(replace(wide, kinematics=other).turns.may).tolist() == half
    assert np.abs(wide.apart(wide.home + TURN, wide.home))[0] < 1e-9


@given(
    st.permutations(range(4)),
    st.integers(1, 4),
    st.sampled_from(["", "fr3_"]),
    st.sampled_from([-np.pi, 0.0]),
)
def test_an_arm_of_several_drivers_is_where_that_of_one_is(order, count, before, low):
    """In any order of joints and drivers, and however the encoders count."""
    whole, parts = arm(), arm()
    groups = [order[k::count] for k in range(count)]
    for time in np.arange(0.0, 2.0, 0.05):
        whole.heard(time, JOINTS, moved(time)[0])
        for k, group in enumerate(groups):
            at = time + 0.007 * k
            names = [before + JOINTS[column] for column in group]
            parts.heard(at, [*names, "finger"], [*reported(moved(at)[0], low)[group], 0.04])
    for time in (0.1, 0.713, 1.3):
        true = moved(time)[0]
        np.testing.assert_allclose(TURNS.apart(parts.at(time), true), 0.0, atol=1e-9)
        np.testing.assert_allclose(whole.at(time), true, atol=1e-9)
    found = parts.newest
    np.testing.assert_allclose(TURNS.apart(found[1].q, moved(found[0])[0]), 0.0, atol=1e-9)


def test_across_a_gap_and_outside_of_what_was_heard_nobody_knows() -> None:
    one = arm()
    with pytest.raises(InvalidRequestError, match="joint states must come first"):
        one.at(0.0)
    assert one.newest is None
    for time in (0.0, 0.1, 0.2, 0.5, 0.6):
        one.heard(time, JOINTS, moved(time)[0])
    np.testing.assert_allclose(one.at(0.15), moved(0.15)[0])
    np.testing.assert_allclose(one.at(0.75), moved(0.6)[0])
    for edge in (0.2, 0.5):  # a state is known, whatever is beside it
        np.testing.assert_array_equal(one.at(edge), moved(edge)[0])
    for time, words in (
        (0.35, r"no joint states came for 0\.300 s around then, must be 0\.2 s"),
        (0.9, r"0\.300 s after the newest joint states: must be 0\.2 s"),
        (-0.3, "joint states must come first"),
    ):
        with pytest.raises(InvalidRequestError, match=words):
            one.at(time)


def test_a_driver_that_falls_silent_makes_the_arm_old() -> None:
    one = arm(kept=2.0)
    for k in range(100):
        time = 0.02 * k
        one.heard(time, JOINTS[:2], moved(time)[0, :2])
        if k < 50:
            one.heard(time, JOINTS[2:], moved(time)[0, 2:])
    with pytest.raises(InvalidRequestError, match=r"1\.000 s after the newest joint states"):
        one.at(1.98)
    for k in range(100, 200):
        one.heard(0.02 * k, JOINTS[:2], moved(0.02 * k)[0, :2])
    assert (one.newest, one.silent) == (None, "no joint states of wrist, roll")


def test_where_the_clock_was_set_back_a_recording_has_two_parts_and_no_word_of_both() -> None:
    one = arm()
    for k in range(200):
        time = 0.02 * k
        one.heard(time - 2.0 * (k >= 100), JOINTS, moved(time)[0])
    with pytest.warns(UserWarning, match="the time runs back by 1.98 at row 100"):
        first, second = one.series()
    np.testing.assert_allclose(second.q - first.q, np.tile(2.0 * RATES, (100, 1)), atol=1e-9)
    with pytest.raises(InvalidRequestError, match="the clock of joint_states was set back"):
        one.at(1.0)


def test_of_a_clock_that_was_set_back_the_live_states_are_the_new_ones() -> None:
    one = arm(kept=2.0)
    for k in range(200):
        time = 0.02 * k
        one.heard(time - 2.0 * (k >= 100), JOINTS, moved(time)[0])
        one.heard(time - 2.0 * (k >= 100) - 0.01, JOINTS, moved(9.9)[0])  # overtaken, by another
    np.testing.assert_allclose(one.at(1.0), moved(3.0)[0], atol=1e-9)


def test_with_a_prefix_only_its_joints_are_read_and_two_arms_want_one() -> None:
    left, right = ([side + name for name in JOINTS] for side in ("left_", "right_"))
    one, both = arm(prefix="right_"), arm()
    one.heard(0.0, [*left, *right], [*np.zeros(4), *moved(0.0)[0]])
    with pytest.raises(
        InvalidRequestError, match=r"joint right_shoulder, .* is missing; it names l"
    ):
        one.heard(0.1, left, np.zeros(4))
    with pytest.raises(InvalidRequestError, match=r"joint right_shoulder, .* is missing"):
        one.heard(0.1, JOINTS, np.zeros(4))
    assert one.newest[0] == 0.0
    np.testing.assert_array_equal(one.newest[1].q, moved(0.0)[0])
    both.heard(0.0, left, np.zeros(4))
    assert both.newest is not None
    for tell in (lambda: both.heard(0.1, right, np.ones(4)), lambda: both.at(0.1)):
        with pytest.raises(InvalidRequestError, match="each of the prefixes left_, right_"):
            tell()
    assert both.newest is None


def test_wrong_values_are_refused_by_name() -> None:
    one = arm()
    for names, q, v, words in (
        (JOINTS, [0.0, np.nan, 0.0, 0.0], [], "joint_states: elbow is nan: must be finite"),
        (JOINTS, np.zeros(4), [0.0, 0.0, np.inf, 0.0], "wrist is of velocity inf"),
        (JOINTS, np.zeros(3), [], "3 positions for 4 names: must be as many"),
        (JOINTS, np.zeros(4), [0.0], "1 velocities for 4 names: must be as many, or none"),
        (("wrist", "wrist"), np.zeros(2), [], "wrist is named twice"),
        (("finger",), [0.0], [], "joint shoulder, elbow, wrist, roll is missing; it names finger"),
        ((), [0.0], [], "name is empty"),
    ):
        with pytest.raises(InvalidRequestError, match=words):
            one.heard(0.0, names, q, v)
    assert one.newest is None
    one.heard(0.0, JOINTS, np.zeros(4), [0.0, 0.3, 0.0, 0.005])
    assert one.newest[1].velocity.tolist() == [0.0, 0.3, 0.0, 0.005]


@pytest.mark.parametrize("low", [-np.pi, 0.0])
def test_the_newest_of_live_states_go_on_past_the_end_of_an_encoder(low: float) -> None:
    """Where the next turn is beyond a limit, a step of a whole turn is no motion either."""
    one, newest, between = arm(kept=1.0), [], []
    for time in np.arange(0.0, 6.0, 0.02):
        one.heard(time, JOINTS, reported(moved(time)[0], low))
        newest.append(one.newest[1].q)
        between.append(TURNS.apart(one.at(time - 0.01 * (time > 0.0)), moved(time - 0.01)[0]))
    steps = np.diff(newest, axis=0) - 0.02 * RATES
    np.testing.assert_allclose(steps[:, [0, 1, 3]], 0.0, atol=1e-9)
    np.testing.assert_allclose(np.sin(0.5 * steps[:, 2]), 0.0, atol=1e-9)
    assert np.all(np.abs(newest) <= UPPER + 0.05)
    np.testing.assert_allclose(np.sin(0.5 * np.array(between[1:])), 0.0, atol=1e-9)
