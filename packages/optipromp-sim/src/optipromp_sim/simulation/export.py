"""The simulation's world as a MuJoCo file (MJCF) that needs nothing of this library.

MJCF states two things that the library's runs do in Python:

- Joint controllers: a position servo for each joint, with the stiffness and damping of the computed
  torque at the start, and gravity compensation of arm and tool, as real arms have it.
- Stems in balance in the scene's pose. The runs apply the torques that hold them; in the file, each
  joint's spring has the rest pose at which it gives that torque.

In the file stems do not tear, and the servos follow a motion with a lag.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from optipromp.core.arrays import FloatArray, frame_along
from optipromp.core.errors import InvalidSceneError
from optipromp.core.robots.model import Robot
from optipromp.core.robots.mounted import loads_of
from optipromp.core.scenes.pose import unit
from optipromp.core.scenes.rotations import product, to_quaternion
from optipromp.core.scenes.scene import Scene, SceneObject
from optipromp_sim.simulation.arm import held_body
from optipromp_sim.simulation.engine import engine
from optipromp_sim.simulation.fruits import BuiltFruit, add_fruit
from optipromp_sim.simulation.parameters import DisturbanceParameters, SimulationParameters
from optipromp_sim.simulation.world import World, build

__all__ = ["START", "TOOL_POINT", "mjcf", "stem_mjcf"]

START = "start"
"""Name of the keyframe with the robot at the start and the fruits in the scene's pose."""

TOOL_POINT = "tool_point"  # Name of the site at the tool point, whose z axis is the tool axis

_FACING = np.array([0.0, 1.0, 0.0, 0.0])  # half a turn about x: MuJoCo's cameras look along -z


def mjcf(
    scene: Scene,
    robot: Robot,
    start: FloatArray,
    parameters: SimulationParameters | None = None,
    seed: int = 0,
) -> str:
    """A MuJoCo model of a scene and a robot with its tool, with actuators, as XML.

    Joints and actuators have the names of the robot's joints; an actuator's control is the wanted
    joint value. The keyframe :data:`START` holds the state to begin with. Everything is in the
    robot's base frame; gravity follows ``scene.base``. Meshes are written into the text. Objects
    that move are where they are at time 0: stems have fixed roots, the others are mocap bodies.

    Args:
        scene: robot and objects.
        robot: the scene's, with its tool.
        start: (n,) configuration of the keyframe.
        parameters: physical numbers; disturbances are left out.
        seed: of the fruits of real neighbouring clusters.

    Raises:
        InvalidSceneError: a shape that cannot be built.
        InvalidRequestError: MuJoCo is not installed.
    """
    calm = replace(parameters or SimulationParameters(), disturbance=DisturbanceParameters())
    hung = ("pushable", "avoid") if calm.thing.avoid_as == "fruits" else ("pushable",)
    still = scene.standing({item.id: 0.0 for item, _ in scene.movers if item.role in hung})
    world = build(still, robot, calm, seed)
    spec, q = world.spec, robot.check_configuration(start)
    joints = _name_joints(spec, world)
    held = [held_body(load.id) for load in loads_of(robot.tool)]
    tool = ["tool", *held] if robot.tool is not None else []
    for body in [*tool, *(f"segment:{s}" for s in range(len(joints)))]:
        spec.body(body).gravcomp = 1.0
    _add_actuators(spec, world, joints, q)
    bends = {name: bend for fruit in world.fruits for name, bend in relaxed(spec, fruit.built)}
    _add_marks(spec, scene, robot)
    values = world.drives.segments(q)
    _add_start(spec, bends, values, values[world.drives.first].tolist())
    text: str = spec.to_xml()
    return text


def _name_joints(spec: Any, world: World) -> list[str]:
    """Name the driven joints as the robot does, and couple the others to them; the S names."""
    mujoco, drives = engine(), world.drives
    names = [f"joint:{s}" for s in range(world.robot.n_segments)]
    for joint, first in enumerate(drives.first):
        names[first] = world.robot.joint_names[joint]
        spec.joint(f"joint:{first}").name = names[first]
    for s, joint in enumerate(drives.dof):
        leader = drives.first[joint]
        if s != leader:
            ratio = drives.multiplier[s] / drives.multiplier[leader]
            shift = drives.offset[s] - ratio * drives.offset[leader]
            tie = spec.add_equality(
                name=f"{names[s]} follows {names[leader]}",
                type=mujoco.mjtEq.mjEQ_JOINT,
                objtype=mujoco.mjtObj.mjOBJ_JOINT,
                name1=names[s],
                name2=names[leader],
                active=True,
            )
            tie.data[:2] = [shift, ratio]
    return names


def _add_actuators(spec: Any, world: World, joints: list[str], q: FloatArray) -> None:
    """Add a position servo to each joint: kp = ω² M_jj, kv = 2ζω M_jj, inertia M at ``q`` (n,)."""
    mujoco, data, control = engine(), world.data(q), world.parameters.control
    count = world.model.nv
    inertia = np.empty((count, count))
    mujoco.mj_fullM(world.model, data, inertia)
    for first in world.drives.first:
        mass, torque = float(inertia[first, first]), float(world.drives.torque[first])
        actuator = spec.add_actuator(
            name=joints[first], target=joints[first], trntype=mujoco.mjtTrn.mjTRN_JOINT
        )
        actuator.set_to_position(
            kp=control.frequency**2 * mass,
            kv=2.0 * control.damping_ratio * control.frequency * mass,
        )
        if np.isfinite(torque):
            actuator.forcelimited = mujoco.mjtLimited.mjLIMITED_TRUE
            actuator.forcerange = [-torque, torque]
        joint = spec.joint(joints[first])
        if joint.limited == mujoco.mjtLimited.mjLIMITED_TRUE:
            actuator.ctrllimited = mujoco.mjtLimited.mjLIMITED_TRUE
            actuator.ctrlrange = joint.range


def relaxed(spec: Any, built: BuiltFruit) -> list[tuple[str, FloatArray]]:
    """Turn the rest pose of a stem so that its springs carry it; joints and their bends (4,).

    The spring of a ball joint of stiffness k, bent by the rotation vector r, gives the torque -k r.
    The torque τ that holds the stem in the scene's pose needs the bend -τ / k there, so the rest
    frame is turned back by that bend.
    """
    out: list[tuple[str, FloatArray]] = []
    if not built.has_stem:
        return out
    for k, torque in enumerate(built.grown):
        joint = spec.joint(f"bend:{built.key}:{k}")
        turn = Rotation.from_rotvec(-torque / joint.stiffness[0])
        bend = turn.as_quat(scalar_first=True)
        spec.body(f"stem:{built.key}:{k}").quat = bend * [1.0, -1.0, -1.0, -1.0]
        out.append((joint.name, bend))
    weld = spec.equality(f"weld:{built.key}")  # states the stem's end in its last piece
    weld.data[3:10] = [*(built.nodes[-1] - built.nodes[-2]), *spec.body(f"fruit:{built.key}").quat]
    return out


def _add_marks(spec: Any, scene: Scene, robot: Robot) -> None:
    """Add the tool point as a site, and the scene's camera."""
    last = spec.body(f"segment:{robot.n_segments - 1}")
    last.add_site(
        name=TOOL_POINT,
        pos=robot.tool_point,
        quat=to_quaternion(frame_along(robot.tool_axis)),
        size=[0.003, 0.0, 0.0],
    )
    if scene.camera is not None:
        spec.worldbody.add_camera(
            name="camera",
            pos=scene.camera.position,
            quat=product(scene.camera.orientation, _FACING),
        )


def _add_start(
    spec: Any, bends: Mapping[str, FloatArray], values: Sequence[float] | FloatArray = (),
    ctrl: Sequence[float] = (),
) -> None:  # fmt: skip
    """Add the keyframe: joints' ``values`` first, stems bent by ``bends``, and the actuators'."""
    model = spec.compile()
    qpos = np.array(model.qpos0)
    qpos[: len(values)] = values
    for name, bend in bends.items():
        at = int(model.joint(name).qposadr[0])
        qpos[at : at + 4] = bend
    spec.add_key(name=START, qpos=qpos.tolist(), ctrl=list(ctrl))
    spec.compile()


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
    ms and its integrator ``discrete`` (MuJoCo 3.13 or later): others let stiff stems shake. Geoms
    collide with all others. A stem that leans or is bent has the keyframe ``start``, which holds
    the pose of ``fruit``. Begin with it: in MuJoCo's own initial state the springs are at rest.

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
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_DISCRETE
    bends = dict(relaxed(spec, add_fruit(spec, fruit, calm, 0, 1, up)))
    for geom in spec.geoms:
        geom.contype = geom.conaffinity = 1
        geom.userdata = []
    spec.compile()
    if any(np.abs(bend[1:]).max() > STRAIGHT for bend in bends.values()):
        _add_start(spec, bends)
    text: str = spec.to_xml()
    return text
