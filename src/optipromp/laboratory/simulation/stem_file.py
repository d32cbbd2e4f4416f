"""One fruit on its stem as a MuJoCo file (MJCF), to be included in a model of one's own."""

from dataclasses import replace

import numpy as np

from optipromp.core.arrays import FloatArray
from optipromp.core.errors import InvalidSceneError
from optipromp.core.scenes.scene import SceneObject
from optipromp.core.scenes.values import unit
from optipromp.laboratory.simulation.engine import engine
from optipromp.laboratory.simulation.export import START, relaxed
from optipromp.laboratory.simulation.fruits import add_fruit
from optipromp.laboratory.simulation.parameters import DisturbanceParameters, SimulationParameters

__all__ = ["stem_mjcf"]

UP = np.array([0.0, 0.0, 1.0])
STRAIGHT = 1e-9  # half an angle [rad] of a joint that is not bent


def stem_mjcf(
    fruit: SceneObject, parameters: SimulationParameters | None = None, up: FloatArray = UP
) -> str:
    """A MuJoCo model of one fruit on its elastic stem, as XML.

    The stem is a chain of ball joints from its root, whose springs have the stiffness EI / l over
    the length l that bends at the joint. In the pose of ``fruit`` the springs carry the fruit. A
    weld holds the fruit at the stem's end. A straight stem stays straight here; it has no bow.

    Bodies are ``stem:ID:0`` and on from the root, and ``fruit:ID``, which has a free joint; ID is
    the fruit's id. Joints are ``bend:ID:0`` and on, and the weld is ``weld:ID``. A model of one's
    own attaches the file (``mjSpec.attach``) or includes it, and takes its time step of at most 2
    ms and its integrator ``implicitfast``. Geoms collide with all others. A stem that leans or is
    bent has the keyframe ``start``, which holds the pose of ``fruit``. Begin with it: in MuJoCo's
    own initial state the springs are at rest.

    Args:
        fruit: with its stem. Of ``physical``, mass, density, friction and stem_stiffness count.
        parameters: physical numbers of what ``fruit`` does not state; None: the defaults.
        up: (3,) opposite to gravity, of any length above 0.

    Raises:
        InvalidSceneError: an object without a stem, with a stem that grows from another, or of a
            shape that cannot be built.
        InvalidRequestError: MuJoCo is not installed.
    """
    if fruit.stem is None or fruit.stem.parent is not None:
        wrong = "no stem" if fruit.stem is None else "a stem that grows from another"
        raise InvalidSceneError(f"object {fruit.id!r} has {wrong}: must hang on a stem of its own")
    mujoco, up = engine(), unit("up", up)
    calm = replace(parameters or SimulationParameters(), disturbance=DisturbanceParameters())
    spec = mujoco.MjSpec()
    spec.modelname, spec.compiler.degree = fruit.id, False
    spec.option.timestep = calm.engine.timestep
    spec.option.gravity = -calm.engine.gravity * up
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    bends = dict(relaxed(spec, add_fruit(spec, fruit, calm, 0, 1, up)))
    for geom in spec.geoms:
        geom.contype = geom.conaffinity = 1
        geom.userdata = []
    model = spec.compile()
    if any(np.abs(bend[1:]).max() > STRAIGHT for bend in bends.values()):
        qpos = np.array(model.qpos0)
        for name, bend in bends.items():
            at = int(model.joint(name).qposadr[0])
            qpos[at : at + 4] = bend
        spec.add_key(name=START, qpos=qpos.tolist())
        spec.compile()
    text: str = spec.to_xml()
    return text
