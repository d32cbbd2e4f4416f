"""Covariant gradient descent: downhill, smooth, with fixed ends, within the limits."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.optimization.builders import EMPTY

from optipromp.core.budget import Budget
from optipromp.core.geometry import Sphere, pack
from optipromp.core.optimization.costs.joints import SmoothnessCost
from optipromp.core.optimization.costs.obstacles import ObstacleCost
from optipromp.core.optimization.problem import Problem, Surroundings
from optipromp.core.planning import plan
from optipromp_paper import obstacles as covariant
from optipromp_paper.obstacles import descend

WAYPOINTS = 40


def reach(robot: Any, waypoints: int = WAYPOINTS) -> np.ndarray:
    """From the home configuration, at rest at both ends."""
    z = np.linspace(0.0, 1.0, waypoints)[:, None]
    turn = np.array([0.8, 0.3, -0.5, 0.4, 0.3, 0.4, 0.0])
    return np.asarray(robot.home + turn * z**3 * (10.0 - 15.0 * z + 6.0 * z**2))


def chomp(robot: Any, waypoints: int = WAYPOINTS, ends: bool = True) -> Problem:
    """A ball in the way of the tool, beside its middle."""
    at = robot.sphere_centers(reach(robot, waypoints)[waypoints // 2])[-1]
    ball = pack([(Sphere(0.06), at + [0.03, -0.05, 0.02], np.eye(3))])
    costs = [ObstacleCost("static", 1.0, 0.03, "sum"), SmoothnessCost(1e-5)]
    around = Surroundings(ball, EMPTY, 0)
    return Problem(robot, around, costs, (), waypoints, cutoff=0.031, end_fixed=ends)


def metric(waypoints: int) -> np.ndarray:
    """A of the inner waypoints from second differences, at rest before and after."""
    dt = 1.0 / (waypoints - 1)
    full = np.zeros((waypoints, waypoints))
    for t in range(waypoints):
        row = np.zeros(waypoints)
        row[max(t - 1, 0)] += 1.0
        row[t] -= 2.0
        row[min(t + 1, waypoints - 1)] += 1.0
        full += np.outer(row, row) / dt**3
    return full[1:-1, 1:-1]


def test_the_step_is_the_inverse_metric_of_the_gradient(panda: Any) -> None:
    """Against a dense solve; zero at both ends, which it leaves and meets with no slope."""
    problem, q = chomp(panda.robot), reach(panda.robot)
    problem.evaluate(q)
    gradient = problem.gradient()
    step = covariant._solved(problem, covariant._factor(problem), gradient)
    expected = np.linalg.solve(metric(WAYPOINTS), gradient[1:-1])
    np.testing.assert_allclose(step[1:-1], expected, rtol=1e-6, atol=1e-9 * np.abs(expected).max())
    assert not step[[0, -1]].any()
    largest = np.abs(step).max()
    assert np.abs(step[[1, -2]]).max() < 0.02 * largest


def test_the_slope_along_the_step_is_what_differences_say(panda: Any) -> None:
    problem, q = chomp(panda.robot), reach(panda.robot)
    problem.evaluate(q)
    gradient = problem.gradient().copy()
    step = covariant._solved(problem, covariant._factor(problem), gradient)
    small = 1e-7 / np.abs(step).max()
    low, high = (problem.evaluate(q + s * small * step).merit for s in (-1.0, 1.0))
    slope = float(np.sum(gradient * step))
    assert slope > 0.0
    assert (high - low) / (2.0 * small) == pytest.approx(slope, rel=1e-4)


def test_every_step_lowers_the_objective_and_no_end_moves(panda: Any) -> None:
    problem, q = chomp(panda.robot), reach(panda.robot)
    before = problem.evaluate(q)
    result = descend(problem, q, Budget())
    totals = [one["static"] + 1e-5 * one["smoothness"] for one in result.history]
    assert totals[0] == pytest.approx(before.merit)
    assert (np.diff(totals) < 0.0).all()
    assert len(totals) == result.iterations + 1 > 5
    assert result.value.merit == pytest.approx(problem.evaluate(result.q).merit)
    assert result.value.costs["static"] < 0.2 * before.costs["static"]
    np.testing.assert_array_equal(result.q[[0, -1]], q[[0, -1]])
    bend = np.abs(np.diff(result.q, 2, axis=0)).max()
    assert bend < 3.0 * np.abs(np.diff(q, 2, axis=0)).max()


def test_a_free_end_moves(panda: Any) -> None:
    problem, q = chomp(panda.robot, ends=False), reach(panda.robot)
    result = descend(problem, q, Budget(), iterations=20)
    np.testing.assert_array_equal(result.q[0], q[0])
    assert not np.array_equal(result.q[-1], q[-1])


def test_where_nothing_is_downhill_it_ends_at_once(panda: Any) -> None:
    """A straight rest: no obstacle, nothing to smooth."""
    q = np.tile(panda.robot.home, (WAYPOINTS, 1))
    problem = chomp(panda.robot)
    result = descend(problem, q, Budget())
    assert problem.evaluate(q).costs["static"] == 0.0
    assert result.iterations == 0
    np.testing.assert_array_equal(result.q, q)


@given(st.integers(0, 10**6), st.sampled_from([5, 12, WAYPOINTS]))
@settings(max_examples=20, deadline=None)
def test_what_is_beyond_a_limit_is_drawn_in(panda: Any, seed: int, waypoints: int) -> None:
    """Smoothly; the ends stay, and what is within all limits is not touched."""
    rng, robot = np.random.default_rng(seed), panda.robot
    q = reach(robot, waypoints)
    problem = chomp(robot, waypoints)
    factor = covariant._factor(problem)
    np.testing.assert_array_equal(covariant.within_limits(problem, factor, q), q)
    joint = int(rng.integers(7))
    bump = np.sin(np.linspace(0.0, np.pi, waypoints)) ** 2
    q[:, joint] += bump * (robot.upper[joint] + rng.uniform(0.01, 0.5) - q[:, joint]).max()
    out = covariant.within_limits(problem, factor, q)
    assert (out <= robot.upper).all()
    assert (out >= robot.lower).all()
    np.testing.assert_array_equal(out[[0, -1]], q[[0, -1]])


def test_the_planner_stops_where_its_effort_ends() -> None:
    whole, cut = (plan("scenario-3", planner="chomp", effort=effort) for effort in (10**6, 3))
    assert not np.array_equal(whole.trajectory.positions, cut.trajectory.positions)
    assert "effort ran out" in cut.message or "was cut after" in cut.message
