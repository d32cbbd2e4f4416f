"""Planning: ``plan``, planners as values, ``plan_many``, ``plan_sequence`` and ``judge``."""

from optipromp.planning.many import plan_many as plan_many
from optipromp.planning.options import STRATEGIES as STRATEGIES
from optipromp.planning.options import PaperOptions as PaperOptions
from optipromp.planning.options import PlanOptions as PlanOptions
from optipromp.planning.options import Strategy as Strategy
from optipromp.planning.plan import plan as plan
from optipromp.planning.plan import warm_up as warm_up
from optipromp.planning.planner import Planner as Planner
from optipromp.planning.planner import planner_names as planner_names
from optipromp.planning.planner import register as register
from optipromp.planning.planners import PLANNERS as PLANNERS
from optipromp.planning.planners import ConditionedProMP as ConditionedProMP
from optipromp.planning.planners import IProMP as IProMP
from optipromp.planning.planners import OptiProMP as OptiProMP
from optipromp.planning.result import Failed as Failed
from optipromp.planning.result import Plan as Plan
from optipromp.planning.result import Planned as Planned
from optipromp.planning.result import Stage as Stage
from optipromp.planning.result import Term as Term
from optipromp.planning.sequence import PickSequence as PickSequence
from optipromp.planning.sequence import plan_sequence as plan_sequence
from optipromp.planning.verdict import Verdict as Verdict
from optipromp.planning.verdict import judge as judge
from optipromp.planning.verdict import verdict_of as verdict_of
