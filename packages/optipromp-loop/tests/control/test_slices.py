"""Work in slices: the same result however it is cut, and nothing runs in between."""

import threading
import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from optipromp.core.budget import Budget, clock, step
from optipromp.core.planning import plan
from optipromp_loop.control.slices import Sliced

STEPS = 23


def counted(done: list[int], steps: int = STEPS) -> float:
    """A sum whose rounding depends on the order of its parts; ``done`` grows by each step."""
    total = 0.0
    for k in range(steps):
        total = total * 1.1 + 1.0 / (k + 3)
        done.append(k)
        step()
    return total


@settings(max_examples=25, deadline=None)
@given(st.lists(st.integers(1, 9), min_size=1, max_size=STEPS))
def test_any_slices_give_the_same_result(slices: list[int]) -> None:
    done: list[int] = []
    work, lent = Sliced(lambda: counted(done)), 0
    for size in slices:
        over = work.lend(size)
        lent += size
        assert len(done) == min(lent, STEPS)
        assert over == (lent > STEPS)
        if over:
            break
    assert work.lend()
    assert work.lend(1)  # what is done stays done
    assert work.result() == counted([])


def test_nothing_runs_while_nothing_is_lent() -> None:
    done: list[int] = []
    work = Sliced(lambda: counted(done, 1000))
    time.sleep(0.01)
    assert not done
    for k in range(1, 6):
        assert not work.lend(3)
        assert len(done) == 3 * k
        time.sleep(0.01)
        assert len(done) == 3 * k
    assert not work.lend(seconds=0.0)
    assert len(done) == 16  # one step at least
    work.drop()
    assert len(done) == 16


def test_a_slice_of_time_ends_with_the_first_step_after_it() -> None:
    done: list[int] = []

    def slow() -> None:
        for k in range(8):
            time.sleep(0.01)
            done.append(k)
            step()

    work = Sliced(slow)
    assert not work.lend(seconds=0.025)
    assert 1 <= len(done) <= 3
    assert work.lend()
    assert len(done) == 8


def test_the_time_between_slices_does_not_count() -> None:
    def timed() -> float:
        began = clock()
        step()
        step()
        return clock() - began

    work = Sliced(timed)
    for _ in range(2):
        assert not work.lend(1)
        time.sleep(0.1)
    assert work.lend(1)
    assert work.result() < 0.05


def test_an_error_is_raised_where_the_result_is_read() -> None:
    def fails() -> None:
        step()
        raise ZeroDivisionError("in the second slice")

    work = Sliced(fails)
    assert not work.lend(1)
    assert work.lend(1)
    for _ in range(2):
        with pytest.raises(ZeroDivisionError, match="in the second slice"):
            work.result()


def test_work_that_is_dropped_ends_its_thread_and_leaves_what_it_holds() -> None:
    left, before = list[str](), threading.active_count()

    def held() -> None:
        try:
            while True:
                try:
                    Budget().spent()  # a step of a search, which waits there
                except Exception:  # a search that goes on after errors
                    left.append("caught")
        finally:
            left.append("left")

    work = Sliced(held)
    assert not work.lend(5)
    assert threading.active_count() == before + 1
    work.drop()
    assert threading.active_count() == before
    assert left == ["left"]
    assert work.done
    never = Sliced(held)
    never.drop()
    assert never.lend()
    assert left == ["left"]


@pytest.mark.parametrize("steps", [1, 7])
def test_a_plan_made_in_slices_is_the_plan(steps: int) -> None:
    whole, work, slices = plan("scenario-3", seed=3), Sliced(lambda: plan("scenario-3", seed=3)), 0
    while not work.lend(steps):
        slices += 1
        plan("scenario-1", seed=1) if slices == 2 else None  # another search in between
    made = work.result()
    assert slices >= 3
    assert made.status == whole.status
    for one, other in zip(made.trajectory.rows(), whole.trajectory.rows(), strict=True):
        assert np.array_equal(one, other)
    assert np.array_equal(made.trajectory.times, whole.trajectory.times)


def test_a_heavy_step_counts_by_its_weight() -> None:
    done: list[int] = []

    def works() -> None:
        for weight in (1, 3, 1, 1, 9, 1):
            done.append(weight)
            step(weight)

    work, lent = Sliced(works), list[int]()
    while not work.lend(4):
        lent.append(len(done))
    assert lent == [2, 5]
    assert len(done) == 6
