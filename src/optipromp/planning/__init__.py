"""Planning: ``plan`` with its three planners, ``plan_many`` and ``judge``."""

from optipromp.planning.many import plan_many
from optipromp.planning.options import PLANNERS, STRATEGIES, Planner, PlanOptions, Strategy
from optipromp.planning.paper_options import PaperOptions
from optipromp.planning.plan import plan, warm_up
from optipromp.planning.result import Plan, Stage, Term
from optipromp.planning.verdict import Verdict, judge

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
