"""A pick in closed loop among swaying fruits, made once."""

import functools

from optipromp_loop.control.controller import Controller
from optipromp_sim.generate import generate
from optipromp_sim.simulation import (
    DETECTORS,
    Detector,
    Eye,
    Loop,
    Simulation,
    SimulationParameters,
    closed_loop,
)

SWAY = 0.01  # [m]


@functools.cache
def swaying() -> Loop:
    """One pick of a cluster that sways."""
    scene = generate("cluster", 105)
    given = SimulationParameters().changed(disturbance={"sway": SWAY})
    controller = Controller(scene)
    eye = Eye(Detector(scene, controller.robot, DETECTORS["zero-mean"], 105))
    return closed_loop(Simulation(scene, 105, given), controller, eye)
