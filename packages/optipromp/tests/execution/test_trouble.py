"""An executor in trouble: no reference jumps, the arm comes to rest, every error is typed."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from tests.execution.arms import (
    PANDA,
    PERIOD,
    Controlled,
    always,
    assert_at_rest,
    in_trouble,
    late,
    no_number,
    once,
    step,
    throws,
)

from optipromp.core.errors import InvalidRequestError
from optipromp.core.execution import Executed, Guard
from optipromp.core.trajectory import State, Trajectory


@pytest.mark.parametrize("by", [0.005, 0.03, 0.09])
def test_a_tick_that_is_a_little_late_slows_the_motion(by: float) -> None:
    arm = Controlled(once("tick", 1.0, late(by)))
    done = arm.execute(step())
    assert done.finished
    q = np.array([one.q for one in arm.asked])
    most = min(by + PERIOD, arm.guard.advance)
    assert np.abs(np.diff(q, axis=0)).max() < 0.6 * 1.875 / 2.0 * most * 1.01
    lost = max(by + PERIOD - arm.guard.advance, 0.0)
    assert arm.at[-1] == pytest.approx(2.0 + lost, abs=2.1 * PERIOD)
    wanted, _, _ = step().sample(done.times)
    np.testing.assert_allclose(done.reference, wanted, atol=1e-12)


@pytest.mark.parametrize("by", [0.2, 2.0, 10.0])
def test_a_tick_that_is_very_late_ends_the_motion(by: float) -> None:
    arm = Controlled(once("tick", 1.0, late(by)))
    done = arm.execute(step())
    assert not done.finished
    assert f"a tick came {by + PERIOD:.3g} s after the last" in done.reason
    assert_at_rest(arm)


def test_after_a_late_tick_the_arm_is_stopped_where_it_is() -> None:
    """It has come to rest meanwhile, a little ahead of what it was asked for."""
    there = list[State]()

    def effect(arm: Controlled) -> None:
        arm.now += 1.0
        there.append(State(arm.asked[-1].q + 0.01))

    spoil = once("tick", 1.0, effect)
    arm = Controlled(lambda arm, what: spoil(arm, what) or (there[-1] if there else None))
    assert not arm.execute(step()).finished
    np.testing.assert_allclose(arm.asked[-1].q, there[-1].q, atol=1e-9)


def test_one_reading_that_is_far_off_moves_no_reference_far() -> None:
    far = State(np.array(PANDA.home) + 3.0, np.full(7, 50.0))
    arm = Controlled(once("state", 1.0, lambda _: far))
    done = arm.execute(step())
    assert "from the curve at 1.00" in done.reason
    q = np.array([one.q for one in arm.asked])
    assert np.abs(np.diff(q, axis=0)).max() < arm.guard.tracking + 2.61 * PERIOD
    assert not arm.asked[-1].velocity.any()
    assert (np.abs(np.diff(q, axis=0)) > 0.02).any(axis=1).sum() <= 1


@pytest.mark.parametrize("often", [once, always])
@pytest.mark.parametrize(
    ("effect", "told"),
    [
        (no_number, "InvalidRequestError: state.q[0] is nan"),
        (throws(OSError("no route\nto host")), "OSError: no route"),
        (lambda _: State(np.zeros(3)), "ValueError: 3 joints, where panda has 7"),
        (lambda _: "nowhere", "AttributeError"),
    ],
)
def test_a_state_that_cannot_be_read_in_motion(often: Any, effect: Any, told: str) -> None:
    arm = Controlled(often("state", 1.0, effect))
    error = in_trouble(arm.execute, step())
    assert error.message.startswith("at 1.0")
    assert f"the state could not be read ({told}" in error.message
    assert error.message.endswith("the arm came to rest")
    assert isinstance(error.executed, Executed)
    assert 0.9 < error.executed.times[-1] < 1.2
    assert not error.executed.finished
    assert_at_rest(arm)
    arm.spoil = lambda *_: None
    begin = arm.asked[-1].q
    back = Trajectory.through(np.tile(begin, (3, 1)), 0.1, PANDA.joint_names)
    assert arm.execute(back).finished  # it can be used again


def test_what_watches_fails() -> None:
    def watch(now: float, _: State) -> bool:
        return bool(1.0 / (0.0 if now > 1.0 else 1.0) > 2.0)

    arm = Controlled(lambda *_: None)
    error = in_trouble(arm.execute, step(), watch)
    assert "watch failed (ZeroDivisionError" in error.message
    assert isinstance(error.__cause__, ZeroDivisionError)
    assert_at_rest(arm)


def test_an_interruption_is_passed_on_at_rest() -> None:
    def watch(now: float, _: State) -> bool:
        if now > 1.0:
            raise KeyboardInterrupt
        return False

    arm = Controlled(lambda *_: None)
    with pytest.raises(KeyboardInterrupt):
        arm.execute(step(), watch)
    assert_at_rest(arm)


def test_a_command_that_fails_once_and_one_that_fails_for_ever() -> None:
    arm = Controlled(once("command", 1.0, throws(RuntimeError("full"))))
    error = in_trouble(arm.execute, step())
    assert "a reference could not be commanded (RuntimeError: full)" in error.message
    assert error.message.endswith("the arm came to rest")
    assert_at_rest(arm)
    error = in_trouble(
        Controlled(always("command", 1.0, throws(RuntimeError("gone")))).execute, step()
    )
    assert error.message.endswith("the arm could not be brought to rest")


def test_control_that_is_lost() -> None:
    def lose(arm: Controlled) -> None:
        arm.lost = True

    done = Controlled(once("tick", 1.0, lose)).execute(step())
    assert (done.finished, done.reason) == (False, "control of the arm was lost")
    error = in_trouble(
        Controlled(once("tick", 1.0, throws(RuntimeError("reflex")))).execute, step()
    )
    assert "control was lost (RuntimeError: reflex)" in error.message
    assert error.message.endswith("could not be brought to rest")
    error = in_trouble(Controlled(always("tick", -1.0, lose)).execute, step())
    assert error.message == "the controller gave no tick; the arm has not moved"


@pytest.mark.parametrize("effect", [no_number, throws(OSError()), lambda _: State(np.zeros(3))])
def test_a_state_that_cannot_be_read_before_the_motion(effect: Any) -> None:
    arm = Controlled(always("state", -1.0, effect))
    assert in_trouble(arm.execute, step()).message.endswith("the arm has not moved")
    assert len(arm.asked) == 1


def test_what_is_no_curve_and_guards_that_never_end() -> None:
    arm = Controlled(lambda *_: None)
    with pytest.raises(InvalidRequestError, match="the curve is a list, not a Trajectory"):
        arm.execute([PANDA.home])  # type: ignore[arg-type]
    for name in ("advance", "record"):
        with pytest.raises(InvalidRequestError, match=f"Guard.{name} is 0"):
            Guard(**{name: 0.0})


@pytest.mark.parametrize(("jump", "finished"), [(0.0, True), (0.3, False)])
@pytest.mark.parametrize("limit", [np.inf, 2.0 * np.pi], ids=["without limits", "a turn each way"])
def test_an_encoder_that_passes_its_end_is_no_trouble_and_a_jump_is(limit, jump, finished):
    turn, low = 2.0 * np.pi, PANDA.home + 0.3 - 2.0 * np.pi

    def reported(arm: Controlled, what: str) -> State | None:
        q = arm.asked[-1].q + jump * (arm.now > 1.5)
        return State((q - low) % turn + low) if what == "state" else None

    arm, edge = Controlled(reported), np.full(7, limit)
    arm.robot = replace(PANDA, lower=-edge, upper=edge)
    done = arm.execute(step())
    assert done.finished == finished, done.reason
    assert np.abs(np.diff([one.q for one in arm.asked], axis=0)).max() < 0.11
