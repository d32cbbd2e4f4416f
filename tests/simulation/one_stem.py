"""A fruit on its stem, alone in plain MuJoCo."""

import mujoco
import numpy as np

from optipromp_sim.simulation import stem_mjcf


def loaded(fruit, parameters=None):
    """Model and data of a fruit in its scene's pose."""
    model = mujoco.MjModel.from_xml_string(stem_mjcf(fruit, parameters))
    data = mujoco.MjData(model)
    if model.nkey:
        mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_forward(model, data)
    return model, data


def tracked(model, data, seconds, force=(0.0, 0.0, 0.0)):
    """Places (N, 3) of the fruit ``b``, a step a row, under a force [N] at its middle."""
    place, out = data.qpos[model.joint("free:b").qposadr[0] :][:3], []
    data.body("fruit:b").xfrc_applied[:3] = force
    for _ in range(round(seconds / model.opt.timestep)):
        mujoco.mj_step(model, data)
        out.append(place.copy())
    return np.array(out)
