"""A budget's steps and time."""

import math
import time

import pytest

from optipromp.budget import Budget


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
    budget, said = Budget(deadline=101.0), []
    for step in (0.0, 0.25, 0.1, 0.1, 0.1, 0.1):
        now[0] += step
        said.append(budget.spent())
    assert said == [False, False, False, False, True, True]
    assert budget.ending == "time ran out"
    assert Budget(deadline=99.0).spent()
    assert not Budget(deadline=math.inf).spent()
