"""Planning: ``plan``, planners as values, ``plan_many``, ``plan_sequence`` and ``judge``."""

from optipromp.core.planning.conditioned import ConditionedProMP as ConditionedProMP
from optipromp.core.planning.conditioned import IProMP as IProMP
from optipromp.core.planning.legs import Picked as Picked
from optipromp.core.planning.legs import plan_pick as plan_pick
from optipromp.core.planning.options import PlanOptions as PlanOptions
from optipromp.core.planning.plan import plan as plan
from optipromp.core.planning.planners import PLANNERS as PLANNERS
from optipromp.core.planning.planners import OptiProMP as OptiProMP
from optipromp.core.planning.planners import Planner as Planner
from optipromp.core.planning.planners import planner_names as planner_names
from optipromp.core.planning.planners import register as register
from optipromp.core.planning.result import Failed as Failed
from optipromp.core.planning.result import Plan as Plan
from optipromp.core.planning.result import Planned as Planned
from optipromp.core.planning.result import Stage as Stage
from optipromp.core.planning.result import Term as Term
from optipromp.core.planning.sequence import PickSequence as PickSequence
from optipromp.core.planning.sequence import plan_many as plan_many
from optipromp.core.planning.sequence import plan_sequence as plan_sequence
from optipromp.core.planning.verdict import Verdict as Verdict
from optipromp.core.planning.verdict import judge as judge
from optipromp.core.planning.verdict import verdict_of as verdict_of
from optipromp.core.planning.warming import warm_up as warm_up

for _kind in (ConditionedProMP, IProMP, OptiProMP):
    register(_kind.name, _kind)
