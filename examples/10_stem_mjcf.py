"""A fruit on an elastic stem in a MuJoCo model of your own (package ``optipromp-sim``).

``stem_mjcf`` gives one fruit on its stem as MJCF. Here it is attached to a world with a floor; it
is pushed with 0.2 N, let go, and swings.
"""

import numpy as np

from optipromp import SceneObject
from optipromp.core.geometry import Sphere
from optipromp.core.scenes import Stem

fruit = SceneObject(
    "berry", "pushable", Sphere(0.018), np.array([0.0, 0.0, 0.5]),
    stem=Stem.along(np.array([0.0, 0.0, 0.5]), np.array([0.0, 0.0, 1.0]), 0.15),
    physical={"mass": 0.02, "stem_stiffness": 2e-3},
)  # fmt: skip

try:
    import mujoco

    from optipromp_sim.simulation import stem_mjcf

    own = mujoco.MjSpec.from_string('<mujoco><option timestep="0.001" integrator="discrete"/>'
        '<worldbody><geom type="plane" size="1 1 1"/></worldbody></mujoco>')  # fmt: skip
    for k in range(3):  # a row of three
        frame = own.worldbody.add_frame(pos=[0.0, 0.1 * k, 0.0])
        own.attach(mujoco.MjSpec.from_string(stem_mjcf(fruit)), prefix=f"{k}/", frame=frame)
    model = own.compile()
    data = mujoco.MjData(model)
    for time in np.arange(0.0, 3.0, model.opt.timestep):
        data.body("1/fruit:berry").xfrc_applied[0] = 0.2 if time < 2.0 else 0.0
        mujoco.mj_step(model, data)
        if round(time / model.opt.timestep) % 500 == 0:
            x = data.body("1/fruit:berry").xpos[0]
            print(f"{time:.1f} s: {1e3 * x:5.1f} mm aside")
except ImportError:
    print("for MuJoCo: install packages/optipromp-sim")
