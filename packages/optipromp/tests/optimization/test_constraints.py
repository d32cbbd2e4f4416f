"""What constraints cost: nothing where they are kept, by hand where they are broken."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from optipromp.core.optimization.costs import Cost
from optipromp.core.optimization.costs.joints import LimitCost, StepCost
from optipromp.core.optimization.costs.obstacles import ClearanceCost, SelfCost
from optipromp.core.optimization.costs.tool import CorridorCost, GoalCost, LevelCost, UprightCost

UP = np.array([0.0, 0.0, 1.0])
SATISFIED = (
    "touch", "avoid", "self", "corridor", "upright", "goal", "goal without axis",
    "limits", "step", "level",
)  # fmt: skip
EQUALITIES = ("goal", "goal without axis", "level")  # zero to the square of rounding


def satisfied(panda: Any) -> dict[str, Cost]:
    """Every constraint, kept by the case's trajectory with room to spare."""
    robot, q = panda.robot, panda.q
    tools, axes = robot.tool_pose(q)
    distances = panda.problem(cutoff=1.0)
    distances.evaluate(q)
    e = distances.evaluation
    pair = (0, e.tool - 1)
    across = np.cross(e.points[-1, pair[0]] - e.points[-1, pair[1]], UP)
    return {
        "touch": ClearanceCost("touch", "static", 9.0, e.static.distance.min() - 1e-9),
        "avoid": ClearanceCost("avoid", "dynamic", 9.0, e.dynamic.distance.min() - 1e-9),
        "self": SelfCost(9.0, 0.0),
        "corridor": CorridorCost(9.0, tools + 0.019, np.eye(3), 0.02, 0),
        "upright": UprightCost(
            9.0, axes[:1], float(np.linalg.norm(axes - axes[0], axis=1).max()) + 1e-9, 0
        ),
        "goal": GoalCost(9.0, tools[-1], axes[-1]),
        "goal without axis": GoalCost(9.0, tools[-1], None),
        "limits": LimitCost(9.0, q.min(axis=0), q.max(axis=0)),
        "step": StepCost(9.0, np.abs(np.diff(q, axis=0)).max(axis=0) + 1e-12),
        "level": LevelCost(9.0, pair, across / np.linalg.norm(across), len(q) - 1),
    }  # fmt: skip


@pytest.mark.parametrize("name", SATISFIED)
def test_a_constraint_that_is_kept_costs_nothing(name: str, panda: Any) -> None:
    problem = panda.problem(constraints=[satisfied(panda)[name]], cutoff=1.0)
    value = problem.evaluate(panda.q).merit
    exact = name not in EQUALITIES
    assert value == 0.0 if exact else value < 1e-28
    gradient = np.abs(problem.gradient()).max()
    assert gradient == 0.0 if exact else gradient < 1e-13
    if exact:
        assert not problem.curvature().any()


@pytest.mark.parametrize("name", [n for n in SATISFIED if n not in EQUALITIES])
def test_and_one_broken_by_a_little_costs_a_little(name: str, panda: Any) -> None:
    """The other side of the same threshold: the test above is not satisfied by a dead term."""
    term: Any = satisfied(panda)[name]
    little = 1e-3
    match name:
        case "touch" | "avoid":
            change = {"margin": term.margin + little}
        case "self":
            problem = panda.problem(cutoff=1.0)
            problem.evaluate(panda.q)
            change = {"margin": float(panda.robot.self_gaps(panda.q).min()) + little}
        case "corridor" | "upright":
            change = {"tolerance": term.tolerance - 2 * little}
        case "limits":
            change = {"upper": term.upper - little}
        case "step":
            change = {"largest": term.largest - little}
    term = replace(term, **change)
    value = panda.problem(constraints=[term], cutoff=1.0).evaluate(panda.q).merit
    assert 0.0 < value < 9.0 * len(panda.q) ** 2 * (3 * little) ** 2


def test_between_its_walls_a_corridor_has_a_share_of_their_curvature_and_no_force(panda):
    tools = panda.robot.tool_pose(panda.q)[0]

    def seen(tolerance: float, within: float) -> tuple[float, float, np.ndarray]:
        term = CorridorCost(9.0, tools + 0.019, np.eye(3), tolerance, 0, within)
        problem = panda.problem(constraints=[term])
        value = problem.evaluate(panda.q).merit
        return value, float(np.abs(problem.gradient()).max()), problem.curvature().copy()

    value, gradient, between = seen(0.02, 0.25)
    assert value == gradient == 0.0
    walls = seen(0.018, 0.25)[2]
    np.testing.assert_allclose(between, 0.25 * walls, rtol=1e-12)
    np.testing.assert_array_equal(walls, seen(0.018, 0.0)[2])
    assert not seen(0.02, 0.0)[2].any()
