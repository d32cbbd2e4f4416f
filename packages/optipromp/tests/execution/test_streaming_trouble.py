"""A motion of replaced curves in trouble, and sources that are asked by a thread of their own."""

import threading
import time
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
    no_number,
    once,
    throws,
)
from tests.execution.streams import WHOLE, between, giving, quiet, rest

from optipromp.core.execution import Executed
from optipromp.core.execution.executor import Stretch
from optipromp.core.execution.streaming import AskingApart
from optipromp.core.trajectory import State


class Apart(Controlled):
    """The same arm; a thread asks its source, and a tick takes 0.2 ms of real time."""

    synchronous = False

    def command(self, reference: State) -> None:
        time.sleep(2e-4)
        super().command(reference)


def test_none_that_is_answered_after_the_end_to_a_question_before_it_ends_nothing() -> None:
    """The source works from 2.4 s to 2.6 s on a question, while the curve ends."""
    back, given = between(State(WHOLE.positions[-1]), State(PANDA.home), 2.0), list[float]()

    def source(now: float, _: State, __: State) -> Stretch | None:
        if not given:
            given.append(now)
            return Stretch(WHOLE, 0.5)
        if now >= 2.4 and len(given) == 1:
            given.append(now)
            while arm.now < 2.6:
                time.sleep(1e-3)
            return None
        if now >= 2.5 and len(given) == 2:
            given.append(now)
            time.sleep(0.01)  # some ticks pass between the two answers
            return Stretch(back, now + 0.3)
        return None

    arm = Apart(quiet)
    done = arm.follow(source)
    assert (done.finished, done.refused) == (True, ())
    assert len(given) == 3
    np.testing.assert_allclose(done.reference[-1], PANDA.home, atol=1e-9)


@pytest.mark.parametrize("kind", [Controlled, Apart])
@pytest.mark.parametrize(
    ("effect", "told"),
    [
        (throws(ArithmeticError("lost\nit")), "ArithmeticError: lost"),
        (lambda _: WHOLE, "TypeError: it returned a Trajectory, not a Stretch"),
        (throws(StopIteration()), "StopIteration"),
    ],
)
def test_a_source_that_fails(kind: type[Controlled], effect: Any, told: str) -> None:
    given = giving((0.0, Stretch(WHOLE, 0.1)))

    def source(now: float, *states: State) -> Any:
        return effect(arm) if now > 1.0 else given(now, *states)

    arm = kind(quiet)
    error = in_trouble(arm.follow, source)
    assert f"s the source failed ({told}" in error.message
    assert error.message.endswith("the arm came to rest")
    assert isinstance(error.executed, Executed)
    assert 1.0 < error.executed.times[-1] < 1.5
    assert_at_rest(arm)


@pytest.mark.parametrize("kind", [Controlled, Apart])
def test_an_interruption_of_a_source_is_passed_on_at_rest(kind: type[Controlled]) -> None:
    given = giving((0.0, Stretch(WHOLE, 0.1)))

    def source(now: float, *states: State) -> Stretch | None:
        if now > 1.0:
            raise KeyboardInterrupt
        return given(now, *states)

    arm = kind(quiet)
    with pytest.raises(KeyboardInterrupt):
        arm.follow(source)
    assert_at_rest(arm)


@pytest.mark.parametrize("often", [once, always])
def test_a_state_that_cannot_be_read_in_motion(often: Any) -> None:
    arm, asked = Controlled(often("state", 1.0, no_number)), list[float]()
    given = giving((0.0, Stretch(WHOLE, 0.0)))

    def source(now: float, *states: State) -> Stretch | None:
        asked.append(now)
        return given(now, *states)

    error = in_trouble(arm.follow, source)
    assert "the state could not be read (InvalidRequestError: state.q[0] is nan" in error.message
    assert error.message.endswith("the arm came to rest")
    assert max(asked) <= 1.01  # a source leads no arm that cannot be seen
    assert_at_rest(arm)
    arm.spoil = quiet
    there = Stretch(between(arm.asked[-1], State(PANDA.home), 2.0), 0.0)
    assert arm.follow(giving((0.0, there))).finished  # it can be used again


def test_an_abort_from_another_thread_before_and_in_motion() -> None:
    for begins, still in ((5.0, True), (0.0, False)):
        arm = Controlled(quiet)

        def watch(now: float, _: State, arm: Controlled = arm) -> None:
            if now > 1.0:
                thread = threading.Thread(target=arm.abort)
                thread.start()
                thread.join()

        done = arm.follow(giving((0.0, Stretch(WHOLE, begins))), watch=watch)
        assert done.reason == "it was aborted"
        if still:
            assert np.abs(arm.asked[-1].q - PANDA.home).max() == 0.0
        else:
            assert_at_rest(arm)


def sources() -> list[str]:
    return [one.name for one in threading.enumerate() if one.name == "source of curves"]


def test_a_slow_source_of_its_own_thread_delays_no_tick() -> None:
    """It takes 60 ms of real time, in which some hundred ticks pass; nothing is left running."""
    names = set[str]()
    slow = giving((0.0, Stretch(WHOLE, 0.5)), (0.6, Stretch(rest(1.0, 0.1), 1.5)))

    def source(now: float, *states: State) -> Stretch | None:
        names.add(threading.current_thread().name)
        found = slow(now, *states)
        if found is not None:
            time.sleep(0.06)
        return found

    arm = Apart(quiet)
    done = arm.follow(source)
    assert (done.finished, done.refused, done.missed) == (True, (), 0)
    assert names == {"source of curves"}
    np.testing.assert_allclose(arm.asked[-1].q, WHOLE.positions[-1] + 0.1, atol=1e-9)
    assert len(arm.at) > 3400  # a tick each ms to the end at 3.5 s
    assert np.diff(arm.at[1:]).max() < 1.5 * PERIOD
    assert sources() == []


def test_no_thread_is_left_when_a_source_outlives_the_motion() -> None:
    entered = threading.Event()

    def source(*_: Any) -> Stretch | None:
        entered.set()
        time.sleep(0.2)
        return Stretch(WHOLE, 0.0)

    arm = Apart(quiet)
    done = arm.follow(source, watch=lambda *_: entered.is_set())
    assert not done.finished
    assert sources() == []


def test_a_source_apart_is_asked_the_newest_question() -> None:
    go, seen, at_rest = threading.Semaphore(0), list[float](), State(PANDA.home)

    def source(now: float, _: State, __: State) -> None:
        seen.append(now)
        go.acquire()

    asking = AskingApart(source, lambda _: "")
    asking.ask((0.0, at_rest, at_rest))
    while not seen:
        time.sleep(1e-3)
    for now in (0.1, 0.2, 0.3):
        asking.ask((now, at_rest, at_rest))
    assert list(asking.answers()) == []
    go.release()
    while len(seen) < 2:
        time.sleep(1e-3)
    assert [one.asked for one in asking.answers()] == [0.0]
    asking.ask((0.4, at_rest, at_rest))
    threading.Timer(0.2, go.release, [2]).start()
    asking.close()  # 0.4 waits, and is never asked
    assert seen == [0.0, 0.3]
