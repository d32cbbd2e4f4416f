"""What changes nothing in the value of a problem: turning, order, place, time, the cutoff."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.optimization.builders import NOTHING, reach

from optipromp.core.geometry import Box, Sphere, pack
from optipromp.core.optimization.costs.joints import SmoothnessCost, VelocityCost
from optipromp.core.optimization.costs.obstacles import ClearanceCost, ObstacleCost
from optipromp.core.optimization.costs.tool import GoalCost
from optipromp.core.optimization.problem import Problem, Surroundings
from optipromp_paper.paper import PushCost

angle = st.floats(-2.5, 2.5)
shift = st.floats(-0.5, 0.5)


def about_z(turn: float) -> np.ndarray:
    c, s = np.cos(turn), np.sin(turn)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def values_of(problem: Problem, q: np.ndarray) -> np.ndarray:
    value = problem.evaluate(q)
    return np.array([value.merit, *value.costs.values()])


def workspace_problem(panda: Any, turn: np.ndarray, order: Any = slice(None)) -> Problem:
    """Terms and constraints of the workspace, all objects turned about the base's axis."""
    shapes = [
        (Sphere(0.05), panda.near_body(3, 50, 0.1), np.eye(3)),
        (Box((0.1, 0.05, 0.2)), panda.near_body(5, 70, 0.12), about_z(0.4)),
        (Sphere(0.02), panda.near_body(2, 24, 0.08), np.eye(3)),
    ]
    shapes = [(s, turn @ p, turn @ r) for s, p, r in shapes][order]
    around = Surroundings(pack(shapes), pack(shapes), 3)
    goal = turn @ panda.robot.tool_pose(panda.q[-1])[0] + turn @ [0.02, 0.01, 0.03]
    frame = np.array([[0.6, 0.8, 0.0], [-0.8, 0.6, 0.0], [0.0, 0.0, 1.0]]) @ turn.T
    return Problem(
        panda.robot, around,
        [
            ObstacleCost("static", 1.0, 0.06, "sum"), ObstacleCost("avoid", 1.0, 0.06, "max"),
            PushCost(1.0, goal, frame, 2, np.array([1.0, 2.0, 0.5])), VelocityCost(0.1),
        ],
        [
            ClearanceCost("touch", "static", 9.0, 0.03),
            GoalCost(7.0, goal, frame[2]),
        ],
        len(panda.q), cutoff=0.1,
    )  # fmt: skip


@settings(max_examples=25, deadline=None)
@given(turn=angle)
def test_turning_the_world_with_the_base_changes_nothing(panda: Any, turn: float) -> None:
    plain = values_of(workspace_problem(panda, np.eye(3)), panda.q)
    assert (plain > 0.0).all()
    turned = panda.q + np.eye(7)[0] * turn
    np.testing.assert_allclose(
        values_of(workspace_problem(panda, about_z(turn)), turned), plain, rtol=1e-8
    )


@settings(max_examples=15, deadline=None)
@given(x=shift, y=shift, z=st.floats(0.0, 1.0), radius=st.floats(0.01, 0.2))
def test_one_more_obstacle_never_lowers_a_cost(panda, x, y, z, radius):
    base = panda.surroundings()
    extra = (Sphere(radius), np.array([x, y, z]), np.eye(3))
    shape = (Sphere(0.05), panda.near_body(3, 50, 0.1), np.eye(3))
    values = []
    for objects in ([shape], [shape, extra]):
        around = Surroundings(pack(objects), base.dynamic, base.shared)
        for reduction in ("sum", "max"):
            terms = [ObstacleCost("static", 1.0, 0.05, reduction)]  # type: ignore[arg-type]
            kept = [ClearanceCost("touch", "static", 5.0, 0.02)]
            values.append(panda.problem(terms, kept, surroundings=around).evaluate(panda.q).merit)
    assert values[2] >= values[0] > 0.0
    assert values[3] >= values[1] > 0.0


@settings(max_examples=25, deadline=None)
@given(offset=st.lists(shift, min_size=7, max_size=7), factor=st.floats(0.1, 3.0))
def test_joint_space_terms_know_no_place_and_scale_with_the_square(panda, offset, factor):
    terms = [VelocityCost(1.0), SmoothnessCost(0.01)]
    problem = panda.problem(terms, surroundings=NOTHING)
    plain = values_of(problem, panda.q)
    moved = panda.q[0] + factor * (panda.q - panda.q[0]) + np.array(offset)
    np.testing.assert_allclose(values_of(problem, moved), factor**2 * plain, rtol=1e-7)


def test_the_obstacle_functional_is_of_the_path_not_of_the_speed(panda: Any) -> None:
    """∫ c ‖x′‖ dt is a line integral: another timing of the same path costs the same."""
    around = panda.surroundings()
    costs = []
    for warp in (lambda z: z, lambda z: z + 0.12 * np.sin(2 * np.pi * z)):
        z = np.linspace(0.0, 1.0, 801)
        term = ObstacleCost("static", 1.0, 0.05, "sum")
        q = reach(panda, warp(z))
        problem = Problem(panda.robot, around, [term], (), len(q), cutoff=0.06)
        costs.append(problem.evaluate(q).merit)
    assert costs[0] > 1e-5
    assert costs[1] == pytest.approx(costs[0], rel=2e-3)


def test_an_evaluation_leaves_its_input_alone_and_repeats(panda: Any) -> None:
    problem = workspace_problem(panda, np.eye(3))
    q = panda.q.copy()
    first = values_of(problem, q), problem.gradient(), problem.curvature().copy()
    np.testing.assert_array_equal(q, panda.q)
    problem.evaluate(q + 0.1)
    again = values_of(problem, q), problem.gradient(), problem.curvature()
    for one, other in zip(first, again, strict=True):
        np.testing.assert_array_equal(one, other)


def test_the_cutoff_is_no_part_of_the_answer(panda, unbanded):
    """Bounding spheres skip what cannot matter: with a huge cutoff nothing is skipped."""
    terms = [ObstacleCost("static", 1.0, 0.05, "sum"), ObstacleCost("avoid", 1.0, 0.05, "max")]
    results = []
    for cutoff in (0.05, 10.0):
        problem = panda.problem(terms, cutoff=cutoff)
        results.append((problem.evaluate(panda.q).merit, problem.gradient().copy()))
    assert results[0][0] == results[1][0] > 0.0
    np.testing.assert_array_equal(results[0][1], results[1][1])
