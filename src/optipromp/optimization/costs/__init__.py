"""Costs of a trajectory: the contract of a cost, and the costs of the library.

Each class stands beside its kernel, in one file a family: ``obstacles`` (the body), ``tool`` (the
tool point and its axis), ``joints``. ``docs/add-a-cost-term.md`` shows how to write one in NumPy.
"""

from optipromp.optimization.costs.joints import LimitCost as LimitCost
from optipromp.optimization.costs.joints import SmoothnessCost as SmoothnessCost
from optipromp.optimization.costs.joints import StepCost as StepCost
from optipromp.optimization.costs.joints import VelocityCost as VelocityCost
from optipromp.optimization.costs.obstacles import ClearanceCost as ClearanceCost
from optipromp.optimization.costs.obstacles import ObstacleCost as ObstacleCost
from optipromp.optimization.costs.obstacles import SelfCost as SelfCost
from optipromp.optimization.costs.tool import CorridorCost as CorridorCost
from optipromp.optimization.costs.tool import GoalCost as GoalCost
from optipromp.optimization.costs.tool import LevelCost as LevelCost
from optipromp.optimization.costs.tool import PushCost as PushCost
from optipromp.optimization.costs.tool import UprightCost as UprightCost
from optipromp.optimization.evaluation import Cost as Cost
from optipromp.optimization.evaluation import Evaluation as Evaluation
