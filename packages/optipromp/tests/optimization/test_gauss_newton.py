"""The solver: descends, keeps what is fixed, stops in time, and gets where it must."""

from typing import Any

import numpy as np
import pytest

from optipromp.core.budget import Budget, clock
from optipromp.core.geometry import pack
from optipromp.core.optimization.costs.joints import (
    LimitCost,
    SmoothnessCost,
    StepCost,
    VelocityCost,
)
from optipromp.core.optimization.costs.obstacles import ClearanceCost, ObstacleCost
from optipromp.core.optimization.costs.tool import GoalCost
from optipromp.core.optimization.gauss_newton import GaussNewtonOptions, solve
from optipromp.core.optimization.problem import Problem, Surroundings, Value

NOTHING = Surroundings(pack([]), pack([]), 0)
ONE_STAGE = GaussNewtonOptions(stages=(1.0,), iterations=(100,), tolerance=1e-12)


def to_goal(panda: Any, goal: np.ndarray, around: Surroundings = NOTHING) -> Problem:
    limits = LimitCost(1e6, panda.robot.lower, panda.robot.upper)
    return panda.problem(  # type: ignore[no-any-return]
        [SmoothnessCost(1e-5)], [GoalCost(1e6, goal, None), limits], surroundings=around
    )


def test_reaches_a_goal_from_a_standstill(panda: Any) -> None:
    still = np.tile(panda.q[0], (len(panda.q), 1))
    point = panda.robot.tool_pose(panda.q[0])[0] + [0.05, 0.1, -0.08]
    result = solve(to_goal(panda, point), still, ONE_STAGE)
    assert np.linalg.norm(panda.robot.tool_pose(result.q[-1])[0] - point) < 1e-6
    np.testing.assert_array_equal(result.q[0], still[0])
    assert np.abs(np.diff(result.q, axis=0)).max() > 1e-3
    assert result.iterations == len(result.history) - 1
    assert result.message in ("converged", "iteration limit")


def test_never_ends_above_where_it_began(panda: Any) -> None:
    terms = [ObstacleCost("static", 1.0, 0.05, "sum"), VelocityCost(0.1), SmoothnessCost(1e-4)]
    kept = [ClearanceCost("touch", "static", 1e4, 0.02), StepCost(1e4, np.full(7, 0.05))]
    problem = panda.problem(terms, kept, end_fixed=True)
    before = problem.evaluate(panda.q)
    gradient = np.linalg.norm(problem.gradient())
    result = solve(problem, panda.q, ONE_STAGE)
    assert result.value.merit < 0.9 * before.merit
    assert problem.evaluate(result.q).merit == result.value.merit
    assert np.linalg.norm(problem.gradient()) < 1e-3 * gradient
    np.testing.assert_array_equal(result.q[[0, -1]], panda.q[[0, -1]])
    assert result.history[0] == before.costs


def test_cost_and_penalty_make_the_merit_at_any_stiffness(panda: Any) -> None:
    problem = to_goal(panda, np.array([0.3, 0.2, 0.5]))
    soft, stiff = (problem.evaluate(panda.q, scale) for scale in (0.02, 1.0))
    assert soft.cost == stiff.cost
    assert soft.penalty == pytest.approx(stiff.penalty, rel=1e-12)
    for value, scale in ((soft, 0.02), (stiff, 1.0)):
        assert value.merit == pytest.approx(value.cost + scale * value.penalty, rel=1e-12)


@pytest.mark.parametrize(("penalty", "keeps"), [(0.0, True), (0.29, True), (0.31, False)])
def test_a_start_that_nearly_keeps_the_constraints_is_told_from_one_that_does_not(penalty, keeps):
    assert GaussNewtonOptions(kept=0.3).keeps(Value(1.0 + penalty, {}, 1.0, penalty)) is keeps


def test_stops_at_its_deadline_with_what_it_has(panda: Any) -> None:
    problem = to_goal(panda, np.array([0.3, 0.2, 0.5]))
    result = solve(problem, panda.q, ONE_STAGE, Budget(clock() - 1.0))
    assert result.message == "time ran out"
    assert result.iterations == 0
    np.testing.assert_array_equal(result.q, panda.q)


def test_no_step_is_longer_than_allowed(panda: Any) -> None:
    """Its input stays as it is."""
    options, q = GaussNewtonOptions((1.0,), (1,), largest_step=0.01), panda.q.copy()
    result = solve(to_goal(panda, np.array([0.3, 0.2, 0.5])), q, options)
    np.testing.assert_array_equal(q, panda.q)
    assert 0.0 < np.abs(result.q - panda.q).max() <= 0.01 * (1.0 + 1e-12)


def test_a_goal_out_of_reach_ends_finite_and_inside_the_limits(panda: Any) -> None:
    result = solve(to_goal(panda, np.array([30.0, 0.0, 0.0])), panda.q, ONE_STAGE)
    assert np.isfinite(result.q).all()
    assert np.isfinite(result.value.merit)


@pytest.mark.parametrize("end_fixed", [False, True])
def test_three_waypoints_are_enough(panda: Any, end_fixed: bool) -> None:
    q = panda.q[:3]
    kept = [GoalCost(1.0, np.array([0.4, 0.1, 0.5]), None)]
    problem = Problem(
        panda.robot, NOTHING, [VelocityCost(1.0)], kept, 3, cutoff=0.05, end_fixed=end_fixed
    )
    result = solve(problem, q, ONE_STAGE)
    assert result.value.merit < problem.evaluate(q).merit
    np.testing.assert_array_equal(result.q[0], q[0])
    assert np.array_equal(result.q[-1], q[-1]) == end_fixed
