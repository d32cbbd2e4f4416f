"""Costs where there is nothing to do, and at points where their formulas are singular."""

from typing import Any

import numpy as np
import pytest
from tests.optimization.builders import EMPTY

from optipromp.core.geometry import Box, Sphere, pack
from optipromp.core.optimization.costs.obstacles import (
    ClearanceCost,
    ObstacleCost,
    obstacle_functional,
    self_penalty,
)
from optipromp.core.optimization.costs.tool import GoalCost, UprightCost
from optipromp.core.optimization.problem import Surroundings
from optipromp_paper.paper import PushCost


def test_an_arm_that_stands_in_an_obstacle_has_a_finite_gradient(panda: Any) -> None:
    """‖dx/dt‖ is 0 and has no direction."""
    still = np.tile(panda.q[3], (len(panda.q), 1))
    for reduction in ("sum", "max"):
        costs = [
            ObstacleCost("static", 1.0, 0.05, reduction),  # type: ignore[arg-type]
            ObstacleCost("avoid", 1.0, 0.05, reduction),  # type: ignore[arg-type]
        ]
        problem = panda.problem(costs)
        assert problem.evaluate(still).merit == 0.0
        assert not problem.gradient().any()


@pytest.mark.parametrize("away", [0.0, 1e-300, 1e-12])
def test_coincident_points_are_finite(panda: Any, away: float) -> None:
    """Obstacles centred exactly on body spheres; a zero gradient of D would be a stuck solver."""
    center = panda.robot.sphere_centers(panda.q[3])[-1] + away
    around = Surroundings(
        pack([(Sphere(0.03), center, np.eye(3)), (Box((0.1, 0.1, 0.1)), center, np.eye(3))]),
        EMPTY, 0,
    )  # fmt: skip
    costs = [ObstacleCost("static", 1.0, 0.01, "sum")]
    kept = [ClearanceCost("touch", "static", 10.0, 0.01)]
    problem = panda.problem(costs, kept, surroundings=around)
    assert np.isfinite(problem.evaluate(panda.q).merit)
    gradient = problem.gradient()
    assert np.isfinite(gradient).all()
    assert np.abs(gradient[3]).max() > 1e-3
    assert np.isfinite(problem.curvature()).all()


def test_a_surface_that_touches_exactly_costs_half_epsilon() -> None:
    """D = 0 to the last bit, on hand-made points."""
    points = np.zeros((3, 3, 3))
    points[:, 0, 1] = [-0.5, 0.0, 0.5]  # one body sphere passing by, tool points unused
    distance = np.array([[1.0], [0.0], [1.0]])
    normal = np.zeros((3, 1, 3))
    normal[1, 0, 0] = 1.0
    for use_max in (False, True):
        force, stiffness = np.zeros((3, 3, 3)), np.zeros((3, 3, 6))
        value = obstacle_functional(
            points, 1, distance, normal, np.ones(1, dtype=np.bool_), 0.02, 0.5, use_max, 1.0,
            force, stiffness,
        )  # fmt: skip
        assert value == pytest.approx(0.5 * 0.01 * 1.0)
        np.testing.assert_allclose(force[1, 0], [-0.5, 0.0, 0.0], atol=1e-15)
        np.testing.assert_allclose(force[2, 0], [0.0, 0.005, 0.0], atol=1e-15)
        assert np.isfinite(stiffness).all()


def test_the_reciprocal_push_is_finite_on_the_line_itself(panda: Any) -> None:
    tools = panda.robot.tool_pose(panda.q)[0]
    frame = np.eye(3)
    goal = tools[4].copy()
    term = PushCost(1.0, goal, frame, 4, np.ones(3), "reciprocal", 1e-4)
    problem = panda.problem([term])
    problem.evaluate(panda.q)
    e = problem.evaluation
    assert np.isfinite(problem.gradient()).all()
    assert e.force[4, e.tool, 1] == 0.0  # y is 0 exactly: no way is downhill
    assert term.add(e, 0.0) > 1e4


def test_two_spheres_at_one_place_are_finite() -> None:
    points = np.zeros((1, 6, 3))  # two spheres, tool point and tip, two bounding centres
    radius = np.array([0.1, 0.2])
    groups, pairs = np.array([[0, 1, 0, 1]]), np.array([[0, 1]])
    force, stiffness = np.zeros((1, 4, 3)), np.zeros((1, 4, 6))
    value = np.zeros(1)
    slack = np.zeros(1)
    self_penalty(points, radius, groups, pairs, slack, radius, 0.01, 4.0, force, stiffness, value)
    assert value == pytest.approx(0.5 * 0.31**2)
    assert np.isfinite(force).all()
    assert np.isfinite(stiffness).all()


def test_an_axis_that_points_the_wrong_way_is_finite(panda: Any) -> None:
    _, axes = panda.robot.tool_pose(panda.q)
    for axis in (axes[3], -axes[3]):
        costs = [UprightCost(5.0, axis[None], 0.0, 0), GoalCost(5.0, np.zeros(3), axis)]
        problem = panda.problem(constraints=costs)
        assert np.isfinite(problem.evaluate(panda.q).merit)
        assert np.isfinite(problem.gradient()).all()
        assert np.isfinite(problem.curvature()).all()
