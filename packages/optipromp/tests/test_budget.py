"""A budget's steps and time."""

import math
import threading
import time

import pytest
from numba import njit

from optipromp.core.budget import Budget, between_steps, clock, step


def test_so_many_steps_and_no_more() -> None:
    budget = Budget(steps=3)
    assert [budget.spent() for _ in range(5)] == [False, False, False, True, True]
    assert budget.cut
    assert budget.ending == "effort ran out"


def test_without_limits_it_is_never_spent() -> None:
    budget = Budget()
    assert not any(budget.spent() for _ in range(1000))
    assert not budget.cut
    assert budget.used == 1000


def test_time_leaves_room_for_two_more_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    now = [100.0]
    monkeypatch.setattr(time, "perf_counter", lambda: now[0])
    budget, said = Budget(deadline=clock() + 1.0), []
    for taken in (0.0, 0.25, 0.1, 0.1, 0.1, 0.1):
        now[0] += taken
        said.append(budget.spent())
    assert said == [False, False, False, False, True, True]
    assert budget.ending == "time ran out"
    assert Budget(deadline=clock() - 1.0).spent()
    assert not Budget(deadline=math.inf).spent()


def test_the_clock_stands_still_while_its_thread_compiles() -> None:
    """And in no other thread."""

    @njit
    def within(x: float) -> float:
        return 2.0 * x

    @njit
    def outer(x: float) -> float:
        return within(x) + 1.0

    passed = []

    def compiles() -> None:
        clocks = clock(), time.perf_counter()
        assert outer(1.0) == 3.0
        passed.extend((clock() - clocks[0], time.perf_counter() - clocks[1]))

    before = time.perf_counter() - clock()
    thread = threading.Thread(target=compiles)
    thread.start()
    thread.join()
    ours, real = passed
    assert real > 0.02
    assert 0.0 <= ours < 0.3 * real
    assert time.perf_counter() - clock() == pytest.approx(before, abs=1e-3)


def test_a_thread_waits_at_its_own_steps_only() -> None:
    """What is set for one thread is called at its steps, and at no other thread's."""
    ours, theirs = [], []

    def works() -> None:
        between_steps(lambda weight: theirs.append((weight, threading.get_ident())))
        for weight in (1, 4, 2):
            step(weight)

    between_steps(lambda weight: ours.append((weight, threading.get_ident())))
    try:
        step()
        thread = threading.Thread(target=works)
        thread.start()
        thread.join()
        assert [weight for weight, _ in theirs] == [1, 4, 2]
        assert len({where for _, where in theirs + ours}) == 2
        assert ours == [(1, threading.get_ident())]
        Budget().spent()
        assert len(ours) == 2
    finally:
        between_steps(None)
    step()
    Budget().spent()
    assert len(ours) == 2


def test_an_error_at_a_step_ends_the_work() -> None:
    def drop(_: int) -> None:
        raise KeyboardInterrupt

    between_steps(drop)
    try:
        with pytest.raises(KeyboardInterrupt):
            Budget().spent()
    finally:
        between_steps(None)
    assert not Budget().spent()
