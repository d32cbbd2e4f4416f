"""Planning: ``plan`` with its three planners, ``plan_many``, ``plan_sequence`` and ``judge``."""

from optipromp.planning.many import plan_many
from optipromp.planning.options import (
    PLANNERS,
    STRATEGIES,
    PaperOptions,
    Planner,
    PlanOptions,
    Strategy,
)
from optipromp.planning.plan import plan, warm_up
from optipromp.planning.result import Plan, Stage, Term, Verdict, judge
from optipromp.planning.sequence import PickSequence, plan_sequence

__all__ = [
    "PLANNERS",
    "STRATEGIES",
    "PaperOptions",
    "PickSequence",
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
    "plan_sequence",
    "warm_up",
]
