"""Planning: ``plan`` with its three planners, ``plan_many`` and ``judge``."""

from optipromp.planning.options import (
    PLANNERS,
    STRATEGIES,
    PaperOptions,
    Planner,
    PlanOptions,
    Strategy,
)
from optipromp.planning.plan import plan, plan_many, warm_up
from optipromp.planning.result import Plan, Stage, Term, Verdict, judge

__all__ = [
    "PLANNERS",
    "STRATEGIES",
    "PaperOptions",
    "Plan",
    "PlanOptions",
    "Planner",
    "Stage",
    "Strategy",
    "Term",
    "Verdict",
    "judge",
    "plan",
    "plan_many",
    "warm_up",
]
