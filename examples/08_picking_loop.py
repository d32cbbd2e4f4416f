"""A picking loop: look, plan, look again, and keep reaching while the plant sways.

The true scene is known to the simulation alone. A camera in the palm takes 20 noisy pictures a
second, 60 ms late; a tracker makes fruits of them, and the controller hands the arm a stretch of a
curve, 50 times a second, that replaces the running one. Any executor takes the controller in place
of the simulated arm, and any camera that makes looks takes the place of the eye.

    python examples/08_picking_loop.py    (needs the package optipromp-sim)
"""

from optipromp_loop.control import Controller, LoopStage
from optipromp_sim.generate import generate
from optipromp_sim.simulation import (
    DETECTORS,
    Detector,
    DisturbanceParameters,
    Eye,
    SimulatedArm,
    SimulationParameters,
)

scene = generate("cluster", 2)
sway = DisturbanceParameters(sway=0.01)  # [m]
arm = SimulatedArm(scene, parameters=SimulationParameters(disturbance=sway))
controller = Controller(scene)
eye = Eye(Detector(scene, controller.robot, DETECTORS["zero-mean"]))


def source(time, measured, reference):
    """What the camera delivers goes to the controller, whose next stretch goes to the arm."""
    eye.see(time, measured.q, arm.simulation.fruits())
    for look in eye.delivered(time):
        controller.see(look)
    if controller.holding:
        arm.simulation.close()
    return controller(time, measured, reference)


arm.follow(source)
for decision in controller.events:
    print(f"{decision.time:5.2f} s  {decision.stage:8s} {decision.why}")
outcome = arm.outcome()
print(outcome.message)
if not (controller.stage is LoopStage.DONE and outcome.success):
    raise SystemExit(1)
