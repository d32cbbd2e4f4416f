"""The simulation: a scene as a MuJoCo world, the execution of a plan in it, and its outcome.

Needs the extra ``sim``: ``pip install 'optipromp[sim]'``.
"""

from optipromp.simulation.arm_executor import SimulatedArm as SimulatedArm
from optipromp.simulation.execute import Run as Run
from optipromp.simulation.execute import simulate as simulate
from optipromp.simulation.outcome import Cause as Cause
from optipromp.simulation.outcome import Contact as Contact
from optipromp.simulation.outcome import Outcome as Outcome
from optipromp.simulation.parameters import ControlParameters as ControlParameters
from optipromp.simulation.parameters import EngineParameters as EngineParameters
from optipromp.simulation.parameters import FruitParameters as FruitParameters
from optipromp.simulation.parameters import RobotParameters as RobotParameters
from optipromp.simulation.parameters import SimulationParameters as SimulationParameters
from optipromp.simulation.parameters import StemParameters as StemParameters
from optipromp.simulation.parameters import ThingParameters as ThingParameters
from optipromp.simulation.parameters import Thresholds as Thresholds
from optipromp.simulation.parameters import catalogue as catalogue
from optipromp.simulation.rollout import Rollout as Rollout
