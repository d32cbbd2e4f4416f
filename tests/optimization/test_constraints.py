"""What constraints cost: nothing where they are kept, by hand where they are broken."""

from typing import Any

import numpy as np
import pytest

from optipromp.optimization.constraints import (
    ClearanceConstraint,
    CorridorConstraint,
    DriftConstraint,
    FunnelConstraint,
    GoalConstraint,
    LimitConstraint,
    SelfConstraint,
    StepConstraint,
    ToolStepConstraint,
    UprightConstraint,
)
from optipromp.optimization.terms import Term

UP = np.array([0.0, 0.0, 1.0])
SATISFIED = (
    "touch", "avoid", "self", "drift", "funnel", "corridor", "upright", "goal", "goal without axis",
    "limits", "step", "tool step",
)  # fmt: skip


def from_line(tools: np.ndarray) -> np.ndarray:
    """Distance of tool points from the upright line through the last of them."""
    return np.asarray(np.hypot(*(tools - tools[-1])[:, :2].T))


def satisfied(panda: Any) -> dict[str, Term]:
    """Every constraint, kept by the case's trajectory with room to spare."""
    robot, q = panda.robot, panda.q
    tools, axes = robot.tool_pose(q)
    distances = panda.problem(cutoff=1.0)
    distances.evaluate(q)
    e = distances.evaluation
    aside = tools[:, None] + 0.2 * np.array([1.0, 0.0, 0.0])
    return {
        "touch": ClearanceConstraint("touch", "static", 9.0, e.static.distance.min() - 1e-9),
        "avoid": ClearanceConstraint("avoid", "dynamic", 9.0, e.dynamic.distance.min() - 1e-9),
        "self": SelfConstraint(9.0, 0.0),
        "drift": DriftConstraint(
            9.0, aside.reshape(-1, 3), np.tile([-1.0, 0.0, 0.0], (len(tools), 1)),
            np.array([0.0, 0.0, 1.0]), np.tile([-9.0, 9.0], (len(tools), 1)),
            np.full(len(tools), -2.0), 0,
        ),
        "funnel": FunnelConstraint(
            9.0, tools[-1], UP, 9.0, float(from_line(tools).max()) + 1e-12, 1.0, 0
        ),
        "corridor": CorridorConstraint(9.0, tools + 0.019, np.eye(3), 0.02, 0),
        "upright": UprightConstraint(
            9.0, axes[0], float(np.linalg.norm(axes - axes[0], axis=1).max()) + 1e-9, 0
        ),
        "goal": GoalConstraint(9.0, tools[-1], axes[-1]),
        "goal without axis": GoalConstraint(9.0, tools[-1], None),
        "limits": LimitConstraint(9.0, q.min(axis=0), q.max(axis=0)),
        "step": StepConstraint(9.0, np.abs(np.diff(q, axis=0)).max(axis=0) + 1e-12),
        "tool step": ToolStepConstraint(
            9.0, float(np.linalg.norm(np.diff(tools, axis=0), axis=1).max()) + 1e-9, 0
        ),
    }  # fmt: skip


@pytest.mark.parametrize("name", SATISFIED)
def test_a_constraint_that_is_kept_costs_nothing(name: str, panda: Any) -> None:
    problem = panda.problem(constraints=[satisfied(panda)[name]], cutoff=1.0)
    value = problem.evaluate(panda.q).merit
    exact = not name.startswith("goal")  # an equality: zero to the square of rounding
    assert value == 0.0 if exact else value < 1e-28
    gradient = np.abs(problem.gradient()).max()
    assert gradient == 0.0 if exact else gradient < 1e-13
    if exact:
        assert not problem.curvature().any()


@pytest.mark.parametrize("name", [n for n in SATISFIED if not n.startswith("goal")])
def test_and_one_broken_by_a_little_costs_a_little(name: str, panda: Any) -> None:
    """The other side of the same threshold: the test above is not satisfied by a dead term."""
    term: Any = satisfied(panda)[name]
    little = 1e-3
    match name:
        case "touch" | "avoid":
            term.margin += little
        case "self":
            problem = panda.problem(cutoff=1.0)
            problem.evaluate(panda.q)
            robot = panda.robot
            x, pairs = robot.sphere_centers(panda.q), robot.self_pairs
            apart = np.linalg.norm(x[:, pairs[:, 0]] - x[:, pairs[:, 1]], axis=2)
            term.margin = float((apart - robot.spheres.radius[pairs].sum(axis=1)).min()) + little
        case "drift":
            tools = panda.robot.tool_pose(panda.q)[0]
            shares = (tools[:, None] - term.centers) @ np.array([-1.0, 0.0, 0.0])
            term.offset = np.full(len(tools), shares.min() + little)
        case "funnel":
            term.width -= little
        case "corridor" | "upright":
            term.tolerance -= 2 * little
        case "limits":
            term.upper = term.upper - little
        case "step" | "tool step":
            term.largest = term.largest - little
    value = panda.problem(constraints=[term], cutoff=1.0).evaluate(panda.q).merit
    assert 0.0 < value < 9.0 * len(panda.q) ** 2 * (3 * little) ** 2


def test_between_its_walls_a_corridor_has_a_share_of_their_curvature_and_no_force(
    panda: Any,
) -> None:
    tools = panda.robot.tool_pose(panda.q)[0]

    def seen(tolerance: float, within: float) -> tuple[float, float, np.ndarray]:
        term = CorridorConstraint(9.0, tools + 0.019, np.eye(3), tolerance, 0, within)
        problem = panda.problem(constraints=[term])
        value = problem.evaluate(panda.q).merit
        return value, float(np.abs(problem.gradient()).max()), problem.curvature().copy()

    value, gradient, between = seen(0.02, 0.25)
    assert value == gradient == 0.0
    walls = seen(0.018, 0.25)[2]
    np.testing.assert_allclose(between, 0.25 * walls, rtol=1e-12)
    np.testing.assert_array_equal(walls, seen(0.018, 0.0)[2])
    assert not seen(0.02, 0.0)[2].any()


def test_a_knot_is_asked_to_drift_no_more_than_it_may_be(panda: Any) -> None:
    tools = panda.robot.tool_pose(panda.q)[0]
    up, lateral = np.array([0.0, 0.0, 1.0]), np.array([[0.0, 1.0, 0.0]])
    knot, weight = len(tools) - 1, 1e4

    def value(most: float, height: float) -> float:
        caps = np.full((len(tools), 1), most)
        term = DriftConstraint(
            weight, tools[None, knot] - height * up, lateral, up, np.array([[-0.035, 0.015]]),
            np.array([0.05]), knot, slope=4.0, most=caps,
        )  # fmt: skip
        return float(panda.problem(constraints=[term]).evaluate(panda.q).merit)

    for height in (0.0, 0.02):  # inside the window, and 5 mm over it: 20 mm less is asked for
        asked = 0.05 - 4.0 * max(0.0, height - 0.015)
        assert value(1.0, height) == pytest.approx(0.5 * weight * asked**2)
        assert value(0.02, height) == pytest.approx(0.5 * weight * 0.02**2)
        assert value(0.0, height) == 0.0


@pytest.mark.parametrize("edge", [-0.035, 0.015])
def test_drift_is_continuous_where_a_knot_enters_the_window(panda: Any, edge: float) -> None:
    tools = panda.robot.tool_pose(panda.q)[0]
    up, lateral = np.array([0.0, 0.0, 1.0]), np.array([0.0, 1.0, 0.0])
    knot, offset, weight = len(tools) - 1, 0.05, 1e4

    def value(height: float) -> float:
        center = tools[knot] - height * up
        term = DriftConstraint(
            weight, center[None], lateral[None], up, np.array([[-0.035, 0.015]]),
            np.array([offset]), knot, slope=4.0,
        )  # fmt: skip
        return float(panda.problem(constraints=[term]).evaluate(panda.q).merit)

    values = [value(edge + s * 1e-7) for s in (-1.0, 0.0, 1.0)]
    assert values[1] == pytest.approx(0.5 * weight * offset**2)
    assert np.ptp(values) < 1e-4 * values[1]
    inside, outside = (0.005, -0.005) if edge < 0 else (-0.005, 0.005)
    assert value(edge + inside) == pytest.approx(values[1])
    assert value(edge + outside) == pytest.approx(0.5 * weight * (offset - 4.0 * 0.005) ** 2)
    assert value(edge + 2.6 * outside) == 0.0


def test_the_funnel_opens_below_the_goal_and_no_wider_than_it_may(panda: Any) -> None:
    """½ w (ρ − width)², by hand: at the goal's height, in the cone, and where it is widest."""
    tools = panda.robot.tool_pose(panda.q)[0]
    knot, weight, aside = len(tools) - 1, 100.0, np.array([0.06, 0.08, 0.0])
    for height, width in ((0.0, 0.01), (0.02, 0.01), (-0.02, 0.01), (-0.03, 0.03), (-0.5, 0.05)):
        goal = tools[knot] - aside - height * UP
        term = FunnelConstraint(weight, goal, UP, 0.02, 0.01, 0.05, knot, slope=2.0)
        value = panda.problem(constraints=[term]).evaluate(panda.q).merit
        assert value == pytest.approx(0.5 * weight * (0.1 - width) ** 2), height
    on_the_line = FunnelConstraint(weight, tools[knot], UP, 0.02, 0.0, 0.0, knot)
    problem = panda.problem(constraints=[on_the_line])
    assert problem.evaluate(panda.q).merit == 0.0
    assert not problem.gradient().any()
