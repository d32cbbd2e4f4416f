"""A picking loop: look, plan, look again, and keep reaching while the plant sways.

The true scene is known to the simulation alone. A camera in the palm takes 20 noisy pictures a
second, 60 ms late; a tracker makes fruits of them, and the controller hands the arm a stretch of a
curve, 50 times a second, that replaces the running one. Any executor takes the controller in place
of the simulated arm, and any camera that makes looks takes the place of the eye.

    python examples/08_picking_loop.py    (needs the extra sim)
"""

from optipromp.control import Controller, LoopStage
from optipromp.core.execution.running import standing
from optipromp.core.execution.streaming import Stretch
from optipromp.laboratory.generate import generate
from optipromp.laboratory.simulation import (
    DETECTORS,
    Detector,
    DisturbanceParameters,
    Eye,
    SimulatedArm,
    SimulationParameters,
)
from optipromp.laboratory.simulation.detector import Truth

scene = generate("cluster", 3)
sway = DisturbanceParameters(sway=0.01)  # [m]
arm = SimulatedArm(scene, parameters=SimulationParameters(disturbance=sway))
controller = Controller(scene)
eye = Eye(Detector(scene, controller.robot, DETECTORS["zero-mean"]))


last = None  # the stretch that runs


def source(time, measured, reference):
    """The next stretch of the curve, after a look at what the camera delivers."""
    global last
    fruits = arm.simulation.fruits()
    truth = Truth(fruits.ids, fruits.positions, fruits.rotations, fruits.stem_ends)
    eye.see(time, measured.q, truth)
    for look in eye.delivered(time):
        controller.see(look)
    stretch = controller(time, measured, reference)
    if stretch is None and not controller.ended and (last is None or last.ended(time)):
        stretch = Stretch(standing(arm.robot, reference), time)  # else the arm takes it as the end
    last = stretch or last
    return stretch


done = arm.follow(source)
for decision in controller.events:
    print(f"{decision.time:5.2f} s  {decision.stage:8s} {decision.why}")
outcome = arm.outcome()
print(outcome.message)
if not (controller.stage is LoopStage.DONE and outcome.success):
    raise SystemExit(1)
