"""The judge: checks any trajectory, with code that shares nothing with the planners."""

from optipromp.core.judging.clearance import Overlap as Overlap
from optipromp.core.judging.clearance import clearances as clearances
from optipromp.core.judging.clearance import nearest_static as nearest_static
from optipromp.core.judging.clearance import pushed_away as pushed_away
from optipromp.core.judging.clearance import swept as swept
from optipromp.core.judging.curve import extremes as extremes
from optipromp.core.judging.ends import GOAL_TOLERANCE as GOAL_TOLERANCE
from optipromp.core.judging.ends import Violation as Violation
from optipromp.core.judging.ends import left_path as left_path
from optipromp.core.judging.kinematics import centers as centers
from optipromp.core.judging.kinematics import refined as refined
from optipromp.core.judging.speed import too_fast as too_fast
from optipromp.core.judging.validator import RATES as RATES
from optipromp.core.judging.validator import ROUNDING as ROUNDING
from optipromp.core.judging.validator import STATIC_MARGIN as STATIC_MARGIN
from optipromp.core.judging.validator import Judgement as Judgement
from optipromp.core.judging.validator import Metrics as Metrics
from optipromp.core.judging.validator import judge as judge
from optipromp.core.judging.validator import struck as struck
from optipromp.core.judging.validator import touching as touching
