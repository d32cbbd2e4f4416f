"""A camera of your own feeds the closed loop: pictures in, a picked fruit out.

Nothing is told of the fruits. A camera that stands beside the row calls back with colour and depth
five times a second; the watcher makes looks of them, and the controller picks by these. Here the
camera photographs the simulation. In its place put your camera's callback and the file that
`optipromp calibrate` wrote, and give the watcher a process: the controller must not wait for it.

    camera, _ = load_camera(Path("camera.json"))
    watcher = Watcher(camera, executor=ProcessPoolExecutor(1))
    pipeline.on_frames(lambda rgb, depth, time: watcher(rgb, depth, time))

    python examples/11_your_own_camera.py    (needs the packages optipromp-eyes and -sim)
"""

from optipromp_eyes import Watcher
from optipromp_loop.control import Controller, LoopStage, without_fruits
from optipromp_sim.generate import generate
from optipromp_sim.simulation import LiveCamera, SimulatedArm

PERIOD = 0.2  # [s] of the camera

true = generate("cluster", 3)
arm = SimulatedArm(true)
controller = Controller(without_fruits(true))
pictures = 0

with LiveCamera(arm.simulation, "beside", seed=3) as camera:
    watcher = Watcher(camera.camera, up=true.up)

    def source(time, measured, reference):
        """The camera calls back when its time has come; looks go to the controller."""
        global pictures
        if time >= pictures * PERIOD:
            taken = camera.take()
            watcher(taken.rgb, taken.depth, time)
            pictures += 1
        for look in watcher.looks():
            controller.see(look)
        if controller.holding:
            arm.simulation.close()
        return controller(time, measured, reference)

    arm.follow(source)

for decision in controller.events:
    print(f"{decision.time:5.2f} s  {decision.stage:8s} {decision.why}")
outcome = arm.outcome()
print(f"{pictures} pictures; {outcome.message}")
if not (controller.stage is LoopStage.DONE and outcome.success):
    raise SystemExit(1)
