"""Every cost and constraint, in small problems."""

from typing import Any

import numpy as np

from optipromp.core.optimization.costs import Cost
from optipromp.core.optimization.costs.joints import (
    LimitCost,
    SmoothnessCost,
    StepCost,
    VelocityCost,
)
from optipromp.core.optimization.costs.obstacles import ClearanceCost, ObstacleCost, SelfCost
from optipromp.core.optimization.costs.tool import CorridorCost, GoalCost, LevelCost, UprightCost
from optipromp_paper.paper import PushCost

FRAME = np.array([[0.6, 0.8, 0.0], [-0.8, 0.6, 0.0], [0.0, 0.0, 1.0]])


def terms(case: Any) -> dict[str, Cost]:
    """Each functional, set up so that it is active on the case's trajectory."""
    tools, _ = case.robot.tool_pose(case.q)
    goal = tools[-1] + [0.03, -0.02, 0.05]
    weights = np.array([1.0, 0.5, 2.0])
    return {
        "static sum": ObstacleCost("static", 1.3, 0.03, "sum"),
        "static max": ObstacleCost("static", 1.3, 0.03, "max"),
        "avoid sum": ObstacleCost("avoid", 0.7, 0.05, "sum"),
        "avoid max": ObstacleCost("avoid", 0.7, 0.05, "max"),
        "tool avoid sum": ObstacleCost("tool avoid", 0.7, 0.08, "sum"),
        "push quadratic": PushCost(1.1, goal, FRAME, 2, weights),
        "push reciprocal": PushCost(1.1, goal, FRAME, 2, weights, "reciprocal", 1e-2),
        "velocity": VelocityCost(0.9),
        "smoothness": SmoothnessCost(0.01),
    }


def constraints(case: Any) -> dict[str, Cost]:
    """Each constraint, set up so that the case's trajectory breaks it."""
    robot, q = case.robot, case.q
    tools, axes = robot.tool_pose(q)
    proximal = ~np.asarray(case.problem().evaluation.body.distal)
    low, high = q.min(axis=0), q.max(axis=0)
    inner = 0.2 * (high - low)
    return {
        "touch": ClearanceCost("touch", "static", 40.0, 0.02),
        "avoid": ClearanceCost("avoid", "dynamic", 50.0, 0.05, proximal),
        "self": SelfCost(30.0, 0.25),
        "corridor": CorridorCost(60.0, tools[::-1] + 0.05, FRAME[[0, 2]], 0.01, 1),
        "wide corridor": CorridorCost(60.0, tools[::-1] + 0.05, FRAME, 0.06, 1, 0.1),
        "upright": UprightCost(20.0, -axes[:1], 0.1, 2),
        "upright on the way": UprightCost(20.0, -axes[::-1], 0.1, 2),
        "goal": GoalCost(70.0, tools[-1] + 0.1, FRAME[0]),
        "goal without axis": GoalCost(70.0, tools[-1] + 0.1, None),
        "limits": LimitCost(25.0, low + inner, high - inner),
        "step": StepCost(35.0, 0.3 * np.abs(np.diff(q, axis=0)).max(axis=0)),
        "level": LevelCost(65.0, (0, len(proximal) - 1), FRAME[0], 1),
    }


TERMS = (
    "static sum", "static max", "avoid sum", "avoid max", "tool avoid sum", "push quadratic",
    "push reciprocal", "velocity", "smoothness",
)  # fmt: skip


CONSTRAINTS = (
    "touch", "avoid", "self", "corridor", "upright", "goal", "goal without axis",
    "limits", "step", "level", "wide corridor",
)  # fmt: skip
