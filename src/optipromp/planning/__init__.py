"""Planning: one way in, for all three planners."""

from optipromp.planning.many import plan_many
from optipromp.planning.options import PLANNERS, STRATEGIES, Planner, PlanOptions, Strategy
from optipromp.planning.plan import Plan, Term, plan, warm_up
from optipromp.planning.stages import Stage

__all__ = [
    "PLANNERS",
    "STRATEGIES",
    "Plan",
    "PlanOptions",
    "Planner",
    "Stage",
    "Strategy",
    "Term",
    "plan",
    "plan_many",
    "warm_up",
]
