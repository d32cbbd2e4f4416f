"""Costs of a trajectory: the contract of a cost, and the costs of the library.

Each class stands beside its kernel. There is a file for each family: ``obstacles`` (the body),
``tool`` (the tool point and its axis), ``joints``. ``docs/extend.md`` shows how to write a
cost in NumPy.
"""

from optipromp.core.optimization.costs.joints import LimitCost as LimitCost
from optipromp.core.optimization.costs.joints import SmoothnessCost as SmoothnessCost
from optipromp.core.optimization.costs.joints import StepCost as StepCost
from optipromp.core.optimization.costs.joints import VelocityCost as VelocityCost
from optipromp.core.optimization.costs.obstacles import ClearanceCost as ClearanceCost
from optipromp.core.optimization.costs.obstacles import ObstacleCost as ObstacleCost
from optipromp.core.optimization.costs.obstacles import SelfCost as SelfCost
from optipromp.core.optimization.costs.tool import CorridorCost as CorridorCost
from optipromp.core.optimization.costs.tool import GoalCost as GoalCost
from optipromp.core.optimization.costs.tool import LevelCost as LevelCost
from optipromp.core.optimization.costs.tool import UprightCost as UprightCost
from optipromp.core.optimization.evaluation import Cost as Cost
from optipromp.core.optimization.evaluation import Evaluation as Evaluation
