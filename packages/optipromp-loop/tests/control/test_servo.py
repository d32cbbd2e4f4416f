"""A path that moves with the plant: where it leads, how smoothly, and that it does not drift."""

import itertools
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from optipromp.core.arrays import FloatArray
from optipromp.core.planning import plan
from optipromp.core.trajectory import State
from optipromp_loop.control.courses import Course, Displacement, Route, follow
from optipromp_loop.control.parameters import CONTROL
from optipromp_sim.generate import generate
from optipromp_sim.situations import executed

PERIOD = CONTROL.period
Common = Callable[[FloatArray], FloatArray]
Seen = Callable[[float], Displacement]  # what is foreseen at a time [s]


@pytest.fixture(scope="module")
def route() -> Route:
    made = plan(generate("cluster", 0), unhurried=True)  # as the loop plans
    assert made.success
    return Route.of(made)


def common(route: Route, moves: Common) -> Displacement:
    """All fruits of the route's scene displaced by ``moves`` (M,) -> (M, 3)."""
    places = np.array([o.position for o in route.scene.objects if o.role != "static"])
    return Displacement(places, lambda t: np.tile(moves(t)[:, None], (1, len(places), 1)))


def sines(*frequencies: float, size: float = 0.02) -> Common:
    """Sines whose amplitudes sum to ``size`` [m], horizontal, each in a direction of its own."""
    turns = np.arange(len(frequencies)) * 1.3
    ways = np.stack([np.cos(turns), np.sin(turns), 0.0 * turns], 1) * size / len(frequencies)
    rates = 2.0 * np.pi * np.array(frequencies)
    return lambda t: np.sin(np.asarray(t)[:, None] * rates + turns) @ ways


@dataclass
class Followed:
    """Courses that took over from one another, each after a period, and the last."""

    courses: list[Course] = field(default_factory=list)
    failed: int = 0
    jump: float = 0.0
    shares: FloatArray = field(default_factory=lambda: np.zeros(3))

    @classmethod
    def along(cls, route: Route, moved: Seen, until: float) -> "Followed":
        """Follow a route from its begin, anew every period, until a phase [s]."""
        out, begin, phase = cls(), route.trajectory.at(0.0), 0.0
        state = begin
        for k in itertools.count():
            now = PERIOD * k
            course = follow(route, phase, state, now, moved(now))
            out.failed += course is None
            course = course or out.courses[-1]
            out.courses.append(course)
            state, phase = course.at(now + PERIOD), course.phase_at(now + PERIOD)
            if phase >= until:
                break
        found = executed(out.courses, route.robot, begin, now + PERIOD)
        out.jump, out.shares = float(found.jumps.max()), found.shares
        return out

    def away(self, route: Route, moves: Common) -> FloatArray:
        """(K,) distances of the tool from the moved path, in the middle of each period [m]."""
        found = []
        for k, course in enumerate(self.courses):
            now = PERIOD * (k + 0.5)
            phase = min(course.phase_at(now), route.duration)
            point, _ = route.robot.tool_pose(course.at(now).q)
            planned, _ = route.robot.tool_pose(route.trajectory.at(phase).q)
            weight = np.interp(phase, route.trajectory.times, route.weight)
            wanted = planned + weight * moves(np.array([now]))[0]
            found.append(float(np.linalg.norm(point - wanted)))
        return np.array(found)


@pytest.mark.parametrize("frequencies", [(0.5,), (0.5, 0.9, 1.6)])
def test_the_tool_follows_a_plant_that_sways(route: Route, frequencies: Any) -> None:
    moves = sines(*frequencies)
    done = Followed.along(route, lambda _: common(route, moves), route.duration + 0.3)
    assert done.away(route, moves).max() < 1e-3
    assert done.jump <= 1e-9
    assert done.shares.max() <= 1.0
    assert done.failed <= 0.02 * len(done.courses)
    still = Followed([Course(route.trajectory, 0.0, 0.0, 1.0)] * len(done.courses))
    assert still.away(route, moves).max() > 0.01  # the plan alone is far from there


def test_the_tool_keeps_to_a_path_that_is_moved_anew_at_each_look(route: Route) -> None:
    """At each look the plant that sways is seen with errors of 3 mm."""
    moves, rng = sines(0.9), np.random.default_rng(5)

    def seen(_: float) -> Displacement:
        error = rng.normal(0.0, 0.003, 3)
        return common(route, lambda t: moves(t) + error)

    away = Followed.along(route, seen, route.duration).away(route, moves)
    assert len(away) > 100
    assert away.max() < 0.01
    assert away.mean() < 0.005


def test_a_plan_followed_a_hundred_times_does_not_drift(route: Route) -> None:
    still = common(route, lambda t: np.zeros((len(t), 3)))
    done = Followed.along(route, lambda _: still, 100 * PERIOD)
    assert (len(done.courses), done.failed) == (100, 0)
    last = done.courses[-1]
    end, _ = route.robot.tool_pose(route.trajectory.positions[-1])
    for late in (route.duration * 1.01, last.begins + last.curve.duration):
        point, _ = route.robot.tool_pose(last.at(late).q)
        assert np.linalg.norm(point - end) < 5e-5
    assert last.rate == 1.0
    assert last.phase == pytest.approx(last.begins)
    assert done.jump <= 1e-9
    assert done.away(route, lambda t: np.zeros((len(t), 3))).max() < 5e-4


def test_a_plant_that_jumps_is_met_again_within_the_limits(route: Route) -> None:
    """20 mm at once: the tool comes onto the moved path, by no jump."""
    at = route.approach + 0.5

    def moves(times: FloatArray) -> FloatArray:
        return np.where(times > at, 0.02, 0.0)[:, None] * np.array([0.6, 0.8, 0.0])

    def unforeseen(now: float) -> Displacement:
        return common(route, lambda t: moves(np.full(len(t), now)))

    done = Followed.along(route, unforeseen, at + 2.0)
    assert done.jump <= 1e-9
    assert done.shares.max() <= 1.0
    assert done.away(route, moves)[-1] < 1e-3


def test_there_is_no_course_onto_a_path_out_of_reach_or_from_a_state_too_fast(route: Route) -> None:
    for size, found in ((0.01, True), (1.5, False)):
        moved = common(route, lambda t, s=size: np.tile([s, 0.0, 0.0], (len(t), 1)))
        assert (follow(route, 0.0, route.trajectory.at(0.0), 0.0, moved) is not None) == found
    begin = State(route.trajectory.positions[0], 2.0 * route.robot.velocity)  # too fast
    still = common(route, lambda t: np.zeros((len(t), 3)))
    assert follow(route, 0.0, begin, 0.0, still) is None


def test_a_course_ends_at_rest_and_a_route_is_weighed_by_its_approach(route: Route) -> None:
    moved = common(route, sines(0.8))
    course = follow(route, 1.0, route.trajectory.at(1.0), 5.0, moved)
    last = course.at(5.0 + course.curve.duration)
    assert np.abs(last.velocity).max() < 1e-9
    assert course.phase_at(5.0) == 1.0
    assert course.phase_at(4.0) == 1.0
    assert course.phase_at(6.0) == pytest.approx(1.0 + 1.0 / course.rate)
    assert route.weight[0] == 0.0
    approach = route.trajectory.times >= route.approach
    assert (route.weight[approach] == 1.0).all()
    assert (np.diff(route.weight) >= 0.0).all()
    back = Route.along(route.robot, route.trajectory, route.scene)
    assert (back.weight == 1.0).all()
    assert back.approach == 0.0


# --- displacement of the plant ------------------------------------------------------------------

SIZES = st.floats(-1.0, 1.0, width=32)


@settings(max_examples=50, deadline=None)
@given(st.integers(1, 5).flatmap(lambda f: st.tuples(
    arrays(float, (f, 3), elements=SIZES), arrays(float, (f, 3), elements=SIZES),
    arrays(float, (4, 3), elements=st.floats(-30.0, 30.0, width=32)),
)))  # fmt: skip
def test_a_displacement_is_a_mean_of_those_of_fruits(given):
    places, moved, points = given
    field = Displacement(places, lambda t: np.tile(moved, (len(t), 1, 1)))
    found = field.at(points, np.zeros(4))
    assert (found >= moved.min(axis=0) - 1e-12).all()
    assert (found <= moved.max(axis=0) + 1e-12).all()


def test_a_displacement_at_a_fruit_is_that_of_the_fruit() -> None:
    places = np.array([[0.0, 0.0, 0.0], [0.5, 0.0, 0.0]])
    moved = np.array([[0.01, 0.0, 0.0], [0.0, -0.02, 0.005]])
    field = Displacement(places, lambda t: moved * np.asarray(t)[:, None, None])
    assert field.at(places, np.array([1.0, 2.0])) == pytest.approx(moved * [[1.0], [2.0]])
    middle = field.at(np.array([[0.25, 0.3, 0.0]]), np.array([1.0]))
    assert middle[0] == pytest.approx(moved.mean(axis=0))
    one = Displacement(places[:1], lambda t: np.tile(moved[:1], (len(t), 1, 1)))
    far = np.array([[9.0, 9.0, 9.0], [0.0, 0.0, 0.0]])
    assert one.at(far, np.zeros(2)) == pytest.approx(moved[[0, 0]])
    none = Displacement(np.zeros((0, 3)), lambda t: np.zeros((len(t), 0, 3)))
    assert (none.at(far, np.zeros(2)) == 0.0).all()
