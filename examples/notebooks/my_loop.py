"""A picking loop: look, plan, look again; scripts/notebooks.py makes the notebook."""

# %% [markdown]
# # My loop
#
# Look, plan, look again, and keep reaching while the plant sways. The true scene is known to the
# simulation alone: put your arm and your camera in its place.
#
# The same as a script: `python examples/notebooks/my_loop.py` (needs the package `optipromp-sim`).

# %%
from optipromp_loop.control import Controller
from optipromp_sim.generate import generate
from optipromp_sim.simulation import (
    DETECTORS,
    Detector,
    DisturbanceParameters,
    Eye,
    SimulatedArm,
    SimulationParameters,
)

# %% [markdown]
# The scene is what was seen first. The arm is simulated, and so is the wind: the fruits sway by
# 10 mm.

# %%
scene = generate("cluster", 3)
sway = DisturbanceParameters(sway=0.01)  # [m]
arm = SimulatedArm(scene, parameters=SimulationParameters(disturbance=sway))
print(*(f"{item.id}: {item.role}" for item in scene.objects), sep="\n")

# %% [markdown]
# The controller holds a belief of the fruits and a plan. The eye is a camera in the palm: 20 noisy
# pictures a second, 60 ms late.

# %%
controller = Controller(scene)
eye = Eye(Detector(scene, controller.robot, DETECTORS["zero-mean"]))

# %% [markdown]
# 50 times a second the arm asks for the next stretch of its curve. Your camera calls
# `controller.see(look)`, your arm calls `controller(time, measured, reference)`.


# %%
def source(time, measured, reference):
    """What the camera delivers goes to the controller, whose next stretch goes to the arm."""
    eye.see(time, measured.q, arm.simulation.fruits())
    for look in eye.delivered(time):
        controller.see(look)
    if controller.holding:
        arm.simulation.close()
    return controller(time, measured, reference)


followed = arm.follow(source)
print(f"{followed.times[-1]:.1f} s, largest error of a joint {followed.largest_error:.4f} rad")

# %% [markdown]
# What the controller decided, when, and why.

# %%
for decision in controller.events:
    print(f"{decision.time:5.2f} s  {decision.stage:8s} {decision.why}")

# %%
outcome = arm.outcome()
print(outcome.success, "-", outcome.message)

# %%
assert controller.stage == "done"
assert outcome.success
