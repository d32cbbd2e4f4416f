"""The robot and its tool as MuJoCo bodies."""

import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from optipromp.core.arrays import FloatArray, IntArray, all_finite, frozen
from optipromp.core.robots.grippers import Suction
from optipromp.core.robots.model import Robot
from optipromp.core.robots.mounted import Load, loads_of, unmounted, without_loads
from optipromp.core.robots.tool_geometry import Part, Solid, solids_inertia
from optipromp.core.robots.tool_protocol import Tool, quaternion
from optipromp.core.robots.tools import TOOL_LINK, WALL
from optipromp_sim.simulation.engine import Entity, add_shape, engine, layers
from optipromp_sim.simulation.parameters import SimulationParameters

GUARD = "tool:guard"
FLAT = 1e-6  # share of a moment by which files round it above the sum of the others
EVEN = 1e-9  # share of a moment that is added so that MuJoCo sees no such excess
LIP_MASS = 0.01  # [kg] of the cup of a suction gripper that yields: a guess
WEIGHTLESS = 1e-9  # [kg], [kg m²] of a load without mass: MuJoCo wants some
LEAST_MASS, LEAST_INERTIA = 0.05, 1e-5  # of a link without spheres [kg], [kg m²]: choices
ARM_COLOUR = (0.78, 0.79, 0.80, 1.0)
BASE_COLOUR = (0.55, 0.57, 0.60, 1.0)
COLOURS: dict[Part, tuple[float, float, float, float]] = {  # of the solids of a tool
    "mouth": (0.15, 0.55, 0.75, 0.55),
    "neck": (0.25, 0.30, 0.35, 1.0),
    "palm": (0.90, 0.90, 0.91, 1.0),
    "finger": (0.30, 0.32, 0.35, 1.0),
    "load": (0.80, 0.35, 0.25, 1.0),
}


@dataclass(frozen=True, eq=False)
class Drives:
    """The values of the S moving segments: ``multiplier`` · q[``dof``] + ``offset``."""

    dof: IntArray  # (S,)
    multiplier: FloatArray  # (S,)
    offset: FloatArray  # (S,)
    torque: FloatArray  # (S,) limit [N m or N], may be infinite
    first: IntArray  # (n,) first segment that each joint drives

    def segments(self, q: FloatArray, *, rates: bool = False) -> FloatArray:
        """Segment values (..., S) of joint values (..., n); ``rates`` get no offset."""
        values: FloatArray = q[..., self.dof] * self.multiplier
        return values if rates else values + self.offset

    def joints(self, values: FloatArray, *, rates: bool = False) -> FloatArray:
        """Joint values (..., n) of segment values (..., S); ``rates`` have no offset."""
        shifted = values if rates else values - self.offset
        out: FloatArray = (shifted / self.multiplier)[..., self.first]
        return out


def drives(robot: Robot) -> Drives:
    """The drives of a robot; torques are unlimited where it states no limit."""
    kin = robot.kinematics
    torque = np.full(robot.n_segments, np.inf)
    if robot.dynamics is not None:
        torque = robot.dynamics.effort
    first = [int(np.flatnonzero(kin.dof == j)[0]) for j in range(robot.n_joints)]
    return Drives(
        frozen(kin.dof, np.int64),
        frozen(kin.multiplier),
        frozen(kin.offset),
        frozen(torque),
        frozen(first, np.int64),
    )


def link_entities(robot: Robot) -> tuple[Entity, ...]:
    """The entity of each link, in the order of ``robot.link_names``."""
    last = robot.n_segments - 1
    out = []
    for index, name in enumerate(robot.link_names):
        mine = robot.spheres.link == index
        distal = bool(robot.spheres.distal[mine].any()) or bool(
            (robot.spheres.segment[mine] == last).any()
        )
        held = index >= robot.n_own_links  # the tool, or what it holds
        out.append(Entity("tool" if held else "link", name, distal))
    return tuple(out)


def add_robot(spec: Any, robot: Robot, parameters: SimulationParameters, first: int) -> None:
    """Add base, links and tool. Geoms carry the entity ``first + link`` in their user data."""
    mujoco = engine()
    kin, body = robot.kinematics, spec.worldbody
    _add_spheres(body, robot, -1, parameters, first)
    for s in range(robot.n_segments):
        body = body.add_body(
            name=f"segment:{s}", pos=kin.translation[s], quat=quaternion(kin.rotation[s])
        )
        slides = kin.kind[s] == 1
        joint = body.add_joint(
            name=f"joint:{s}",
            type=mujoco.mjtJoint.mjJNT_SLIDE if slides else mujoco.mjtJoint.mjJNT_HINGE,
            axis=kin.axis[s],
            armature=parameters.robot.armature,
            frictionloss=parameters.robot.joint_friction,
        )
        joint.damping[0] = parameters.robot.joint_damping
        ends = np.sort(
            kin.multiplier[s] * np.array([robot.lower[kin.dof[s]], robot.upper[kin.dof[s]]])
            + kin.offset[s]
        )
        if np.isfinite(ends).all():
            joint.limited = mujoco.mjtLimited.mjLIMITED_TRUE
            joint.range = ends
        _set_inertia(body, robot, s, parameters.robot.link_density)
        _add_spheres(body, robot, s, parameters, first)
    if robot.tool is not None:
        _add_tool(spec, body, robot, parameters, first + robot.link_names.index(TOOL_LINK))


def _surface(parameters: SimulationParameters, friction: float, entity: int) -> dict[str, Any]:
    return {
        "friction": [friction, 0.005, 1e-4],
        "solref": [parameters.thing.contact_time, 1.0],
        "condim": 3,
        "userdata": [float(entity)],
    }


def _add_spheres(
    body: Any, robot: Robot, segment: int, parameters: SimulationParameters, first: int
) -> None:
    mujoco = engine()
    spheres = robot.spheres
    for b in np.flatnonzero((spheres.segment == segment) & (spheres.link < robot.n_own_links)):
        link = int(spheres.link[b])
        body.add_geom(
            name=f"body:{b}",
            type=mujoco.mjtGeom.mjGEOM_SPHERE,
            size=[spheres.radius[b], 0.0, 0.0],
            pos=spheres.center[b],
            rgba=BASE_COLOUR if segment < 0 else ARM_COLOUR,
            **layers("link"),
            **_surface(parameters, parameters.robot.tool_friction, first + link),
        )


def _set_inertia(body: Any, robot: Robot, segment: int, density: float) -> None:
    """Set the inertia that the robot states, else that of balls at the places of its spheres.

    The balls are taken too where no body can have the stated inertia. Their mass is the stated one,
    else their volume times the ``density`` [kg/m³].
    """
    spheres = robot.spheres
    mine = (spheres.segment == segment) & (spheres.link < robot.n_own_links)
    radius, center = spheres.radius[mine], spheres.center[mine]
    volume = 4.0 / 3.0 * np.pi * radius**3
    mass = 0.0
    if (given := robot.dynamics) is not None:
        mass = float(given.mass[segment])
        if (inertia := _stated(robot, segment)) is not None:
            _explicit(body, mass, given.center[segment], inertia)
            return
    if mass == 0.0:  # spheres overlap by about half
        mass = max(0.5 * density * float(volume.sum()), LEAST_MASS)
    inertia, middle = LEAST_INERTIA * np.eye(3), np.zeros(3)
    if len(volume):
        share = volume / volume.sum() * mass
        middle = share @ center / mass
        for m, r, c in zip(share, radius, center - middle, strict=True):
            inertia = inertia + m * ((0.4 * r**2 + c @ c) * np.eye(3) - np.outer(c, c))
    _explicit(body, mass, middle, inertia)


def _stated(robot: Robot, segment: int) -> FloatArray | None:
    """The stated inertia (3, 3) of a segment; None where there is none, or one that no body has.

    No principal moment of a body exceeds the sum of the other two. Where one does by rounding, all
    three are raised.
    """
    assert robot.dynamics is not None
    inertia = robot.dynamics.inertia[segment]
    low, middle, high = np.linalg.eigvalsh(inertia) if all_finite(inertia) else [np.nan] * 3
    over = high - low - middle
    if low > 0.0 and over <= FLAT * high:
        return np.asarray(inertia + 2.0 * max(over + EVEN * high, 0.0) * np.eye(3))
    if inertia.any():
        warnings.warn(
            f"robot {robot.name}, segment {segment}: no body has the inertia that is stated, of "
            f"moments {low:.3g}, {middle:.3g} and {high:.3g} kg m^2; that of its mass, where its "
            "spheres are, is taken",
            stacklevel=4,
        )
    return None


def _explicit(body: Any, mass: float, middle: FloatArray, inertia: FloatArray) -> None:
    body.explicitinertial = True
    body.mass, body.ipos = mass, middle
    i = inertia
    body.fullinertia = [i[0, 0], i[1, 1], i[2, 2], i[0, 1], i[0, 2], i[1, 2]]


def _add_tool(
    spec: Any, body: Any, robot: Robot, parameters: SimulationParameters, entity: int
) -> None:
    """Add the tool: a body on the flange, made of the tool's solids."""
    tool, given, last = robot.tool, parameters.robot, len(robot.link_names) - 1
    assert tool is not None
    held = body.add_body(
        name="tool", pos=robot.flange_translation, quat=quaternion(robot.flange_rotation)
    )
    mass = given.hand_mass if tool.fingers else given.tool_mass
    _explicit(held, mass, *tool.inertia(mass))
    surface = {**layers("tool"), **_surface(parameters, given.tool_friction, entity)}
    yields = isinstance(unmounted(tool), Suction)
    rigid = [one for one in without_loads(tool).solids() if not (yields and one.part == "mouth")]
    _add_solids(spec, held, rigid, surface)
    if yields:
        _add_lip(spec, held, tool, surface)
    for load in loads_of(tool):
        own = float(entity + robot.link_names.index(load.id) - last)
        _add_load(spec, held, load, {**surface, "userdata": [own]})
    if given.guard_until > 0.0:
        held.add_geom(
            name=GUARD,
            type=engine().mjtGeom.mjGEOM_CYLINDER,
            size=[tool.mouth[1], 0.5 * WALL, 0.0],
            quat=quaternion(tool.rotation),
            pos=tool.point + (tool.depth + 0.5 * WALL) * tool.rotation[:, 2],
            rgba=COLOURS["neck"],
            **surface,
        )


def _add_lip(spec: Any, held: Any, tool: Tool, surface: dict[str, Any]) -> None:
    """Add the cup of a suction gripper: a body that slides back along the axis, as a spring."""
    cup = unmounted(tool)
    assert isinstance(cup, Suction)
    solids = [one for one in without_loads(tool).solids() if one.part == "mouth"]
    lip = held.add_body(name="tool:lip")
    _explicit(lip, LIP_MASS, *solids_inertia(solids, LIP_MASS))
    joint = lip.add_joint(
        name="tool:lip", type=engine().mjtJoint.mjJNT_SLIDE, axis=tool.rotation[:, 2],
        limited=engine().mjtLimited.mjLIMITED_TRUE, range=[-cup.height, 0.0],
    )  # fmt: skip
    joint.stiffness[0] = cup.stiffness
    joint.damping[0] = 2.0 * math.sqrt(cup.stiffness * LIP_MASS)  # critical
    _add_solids(spec, lip, solids, surface)


def _add_solids(spec: Any, body: Any, solids: Sequence[Solid], surface: dict[str, Any]) -> None:
    for solid in solids:
        add_shape(
            spec, body, solid.shape, f"tool:{solid.name}", np.eye(3), solid.position,
            quat=solid.orientation, rgba=COLOURS[solid.part], **surface,
        )  # fmt: skip


def _add_load(spec: Any, tool: Any, load: Load, surface: dict[str, Any]) -> None:
    """Add a load of the tool: a body that is fixed to the tool's body, with the load's mass."""
    body = tool.add_body(name=held_body(load.id))
    if load.mass > 0.0:
        _explicit(body, load.mass, *solids_inertia(load.solids, load.mass))
    else:
        _explicit(body, WEIGHTLESS, np.zeros(3), WEIGHTLESS * np.eye(3))
    _add_solids(spec, body, load.solids, surface)


def held_body(id_: str) -> str:
    """The name of the body of a load."""
    return f"attached:{id_}"
