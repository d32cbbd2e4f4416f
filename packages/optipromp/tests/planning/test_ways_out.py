"""Ways out of the plant: proposals, cheapest first, each with its speed."""

from collections.abc import Iterator
from copy import copy

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from optipromp import plan, plan_pick, simulate
from optipromp.core.budget import clock
from optipromp.core.errors import Code
from optipromp.core.planning import Picked
from optipromp.core.planning.leg_tasks import retreat_model
from optipromp.core.planning.options import DEFAULTS
from optipromp.core.planning.result import REACH, RETREAT, Proposal, cheapest
from optipromp.core.planning.task import tool_motion
from optipromp.core.planning.ways import retreats, ways
from optipromp.core.pushing.model import Prediction, Told
from optipromp.core.pushing.parameters import PUSH
from optipromp.core.pushing.path import length
from optipromp.core.scenes import Scene
from optipromp_sim.generate import generate


@given(st.lists(st.tuples(st.floats(0.0, 1.0), st.floats(0.0, 1.0)), min_size=1, max_size=20))
def test_the_cheapest_comes_first_and_no_work_is_done_that_cannot_be_cheaper(given):
    """Each pair is a bound, and what the rank exceeds the bound by."""
    worked: list[float] = []

    def work(bound: float, more: float) -> Iterator[Proposal[str]]:
        worked.append(bound)
        yield Proposal(bound + more, f"{bound + more!r}")

    proposed = [Proposal[str](a, lambda a=a, b=b: work(a, b)) for a, b in given]  # type: ignore[misc]
    first = float(next(cheapest(proposed)))
    assert first == min(a + b for a, b in given)
    assert all(bound <= first for bound in worked)
    assert [float(one) for one in cheapest(proposed)] == sorted(a + b for a, b in given)


def test_a_motion_is_worked_out_before_its_equals_are_looked_at() -> None:
    seen: list[int] = []

    def proposed(k: int) -> Iterator[Proposal[int]]:
        seen.append(k)
        yield Proposal(0.2, lambda: [Proposal(0.2, k)])

    some = [Proposal[int](0.2, lambda k=k: proposed(k)) for k in range(5)]  # type: ignore[misc]
    assert next(cheapest(some)) == 0
    assert seen == [0]


def test_when_time_is_out_the_motions_that_there_are_come_and_no_work_begins() -> None:
    late = Proposal[int](0.1, lambda: pytest.fail("it is late"))
    assert [*cheapest([Proposal[int](0.5, 5), late], clock() - 1.0)] == [5]
    assert [*cheapest([Proposal[int](0.1, lambda: [Proposal(0.3, 3)])], clock() - 1.0)] == [3]


@pytest.fixture(scope="module")
def hard() -> Scene:
    """Two fruits beside the neck: 0.3.0 planned for seconds and refused the pick."""
    return generate("mixed", 161004)


@pytest.fixture(scope="module")
def slow(hard: Scene) -> Picked:
    return plan_pick(hard)


def test_a_way_out_is_slow_where_it_would_harm_at_full_speed(slow: Picked) -> None:
    assert slow.success, slow.message
    out = slow.legs[RETREAT]
    model, way = out.task.back, tool_motion(out.robot, out.trajectory.positions)
    assert model.speed < 0.6 * PUSH.hanging.speed
    assert model.at(PUSH.hanging.speed).harm(*way, model.states) > out.harm
    times = np.arange(0.0, 0.5, 2e-3)  # [s] while it is among fruits
    points, _ = out.robot.tool_pose(out.trajectory.sample(times)[0])
    speed = np.linalg.norm(np.diff(points, axis=0), axis=1) / 2e-3
    assert speed.max() < 1.1 * model.speed


def test_what_was_refused_is_picked_clean_in_the_simulation(slow: Picked, hard: Scene) -> None:
    outcome = simulate(slow, hard).outcome
    assert outcome.success, outcome.message


def test_one_harm_is_of_the_whole_pick(slow: Picked) -> None:
    reach, out = slow.legs[REACH], slow.legs[RETREAT]
    assert out.harm > reach.harm > 0.0
    assert slow.failure == out.prediction.probability
    model = copy(retreat_model(reach))
    tip, axis = (one[-1:] for one in reach.robot.tool_pose(reach.trajectory.positions))
    rest = np.repeat(tip, 3, 0), np.repeat(axis, 3, 0)
    stays = model.harm(*rest, model.states)
    assert reach.harm <= stays < 0.5 * (reach.harm + out.harm)
    model.way_in = Prediction(2.0, 0.65, lambda: Told("a", "is swallowed"))  # that is the more
    assert str(model.predict(*rest)).startswith("harm is predicted: a is swallowed (harm 2.0")


def test_ways_out_lead_away_from_the_tip_and_the_first_follows_the_reach(slow: Picked) -> None:
    reach = slow.reach
    q = reach.trajectory.positions
    tip, axis = (one[-1] for one in reach.robot.tool_pose(q))
    found = [*ways(reach.robot, q, 0.1)]
    assert len(found) == 2 + 8 * 3 + 8 * 2
    assert (found[0].q[0] == q[-1]).all()
    for way in found:
        assert np.linalg.norm(way.points[0] - tip) < 1e-3
        assert length(way.points) > 0.099
        assert (way.points[-1] - tip) @ axis < -0.07
        made = way.followed(reach.robot, q[-1])
        if made is not None:
            points, _ = reach.robot.tool_pose(made)
            assert np.abs(points - way.points).max() < 2e-3


def test_an_easy_pick_goes_back_along_its_way_in() -> None:
    made = next(cheapest(retreats(plan(generate("tight", 3)), DEFAULTS)))
    assert made[RETREAT].status is Code.SUCCESS
    picked = plan_pick(generate("tight", 3))
    back, way = picked.legs[RETREAT].trajectory.positions, picked.reach.trajectory.positions
    assert np.abs(back[0] - way[-1]).max() == 0.0
    assert np.abs(back - way[::-1][: len(back)]).max() == 0.0  # back along the way in
