"""The simulation: a scene as a MuJoCo world, the execution of a plan in it, and its outcome.

Needs the extra ``sim``: ``pip install 'optipromp[sim]'``.
"""

from optipromp.simulation.arm_executor import SimulatedArm
from optipromp.simulation.execute import Run, simulate
from optipromp.simulation.outcome import Cause, Contact, Outcome
from optipromp.simulation.parameters import (
    ControlParameters,
    EngineParameters,
    FruitParameters,
    RobotParameters,
    SimulationParameters,
    StemParameters,
    ThingParameters,
    Thresholds,
    catalogue,
)
from optipromp.simulation.rollout import Rollout

__all__ = [
    "Cause",
    "Contact",
    "ControlParameters",
    "EngineParameters",
    "FruitParameters",
    "Outcome",
    "RobotParameters",
    "Rollout",
    "Run",
    "SimulatedArm",
    "SimulationParameters",
    "StemParameters",
    "ThingParameters",
    "Thresholds",
    "catalogue",
    "simulate",
]
