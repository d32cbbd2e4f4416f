"""Costs of a trajectory: the contract of a cost, and the costs of the library.

Each class stands beside its kernel, in one file a family: ``obstacles`` (the body), ``tool`` (the
tool point and its axis), ``joints``. ``docs/add-a-cost-term.md`` shows how to write one in NumPy.
"""

from optipromp.optimization.costs.joints import LimitCost, SmoothnessCost, StepCost, VelocityCost
from optipromp.optimization.costs.obstacles import ClearanceCost, ObstacleCost, SelfCost
from optipromp.optimization.costs.tool import (
    CorridorCost,
    GoalCost,
    LevelCost,
    PushCost,
    UprightCost,
)
from optipromp.optimization.evaluation import Cost, Evaluation

__all__ = [
    "ClearanceCost",
    "CorridorCost",
    "Cost",
    "Evaluation",
    "GoalCost",
    "LevelCost",
    "LimitCost",
    "ObstacleCost",
    "PushCost",
    "SelfCost",
    "SmoothnessCost",
    "StepCost",
    "UprightCost",
    "VelocityCost",
]
