"""The judge: checks any trajectory, with code that shares nothing with the planners."""

from optipromp.judging.clearance import Overlap as Overlap
from optipromp.judging.clearance import clearances as clearances
from optipromp.judging.clearance import pushed_away as pushed_away
from optipromp.judging.clearance import swept as swept
from optipromp.judging.curve import Extremes as Extremes
from optipromp.judging.curve import extremes as extremes
from optipromp.judging.entered import struck as struck
from optipromp.judging.entered import touching as touching
from optipromp.judging.kinematics import centers as centers
from optipromp.judging.kinematics import refined as refined
from optipromp.judging.near import nearest_static as nearest_static
from optipromp.judging.speed import too_fast as too_fast
from optipromp.judging.validator import AXIS_TOLERANCE as AXIS_TOLERANCE
from optipromp.judging.validator import GOAL_TOLERANCE as GOAL_TOLERANCE
from optipromp.judging.validator import JUDGE as JUDGE
from optipromp.judging.validator import RATES as RATES
from optipromp.judging.validator import ROUNDING as ROUNDING
from optipromp.judging.validator import Judgement as Judgement
from optipromp.judging.validator import Metrics as Metrics
from optipromp.judging.validator import Violation as Violation
from optipromp.judging.validator import judge as judge
from optipromp.judging.validator import paper_violations as paper_violations
