"""The simulation: a scene as a MuJoCo world, the execution of a plan in it, and its outcome.

Needs the extra ``sim``: ``pip install -e '.[sim]'`` in the clone.
"""

from optipromp.laboratory.simulation.detector import DETECTORS as DETECTORS
from optipromp.laboratory.simulation.detector import Detector as Detector
from optipromp.laboratory.simulation.detector import DetectorParameters as DetectorParameters
from optipromp.laboratory.simulation.detector import Eye as Eye
from optipromp.laboratory.simulation.execute import Loop as Loop
from optipromp.laboratory.simulation.execute import Run as Run
from optipromp.laboratory.simulation.execute import closed_loop as closed_loop
from optipromp.laboratory.simulation.execute import simulate as simulate
from optipromp.laboratory.simulation.export import stem_mjcf as stem_mjcf
from optipromp.laboratory.simulation.outcome import Cause as Cause
from optipromp.laboratory.simulation.outcome import Contact as Contact
from optipromp.laboratory.simulation.outcome import Outcome as Outcome
from optipromp.laboratory.simulation.parameters import ControlParameters as ControlParameters
from optipromp.laboratory.simulation.parameters import (
    DisturbanceParameters as DisturbanceParameters,
)
from optipromp.laboratory.simulation.parameters import EngineParameters as EngineParameters
from optipromp.laboratory.simulation.parameters import FruitParameters as FruitParameters
from optipromp.laboratory.simulation.parameters import RobotParameters as RobotParameters
from optipromp.laboratory.simulation.parameters import SimulationParameters as SimulationParameters
from optipromp.laboratory.simulation.parameters import StemParameters as StemParameters
from optipromp.laboratory.simulation.parameters import ThingParameters as ThingParameters
from optipromp.laboratory.simulation.parameters import Thresholds as Thresholds
from optipromp.laboratory.simulation.parameters import catalogue as catalogue
from optipromp.laboratory.simulation.photograph import LiveCamera as LiveCamera
from optipromp.laboratory.simulation.rollout import Rollout as Rollout
from optipromp.laboratory.simulation.simulation import FruitStates as FruitStates
from optipromp.laboratory.simulation.simulation import SimulatedArm as SimulatedArm
from optipromp.laboratory.simulation.simulation import Simulation as Simulation
from optipromp.laboratory.simulation.simulation import Touch as Touch
