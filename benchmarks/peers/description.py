"""Our robot as URDF and SRDF, with its body spheres: the form that other planners read."""

from collections.abc import Iterable, Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from optipromp.core.arrays import FloatArray
from optipromp.core.geometry.shapes import Box, Cylinder, Sphere
from optipromp.core.robots.model import Robot
from optipromp.core.scenes.scene import Scene, SceneObject

TIP = "tip"  # link at the tool point, z along the tool axis
BASE = "base"
GROUP = "arm"


def link_names(robot: Robot) -> list[str]:
    """Links that carry spheres."""
    return [robot.link_names[i] for i in np.unique(robot.spheres.link)]


def distal_links(robot: Robot) -> list[str]:
    """Those of the last link and the tool, which may push and brush."""
    distal = np.asarray(robot.spheres.distal, dtype=bool)
    return [robot.link_names[i] for i in np.unique(np.asarray(robot.spheres.link)[distal])]


def exempt_pairs(robot: Robot) -> list[tuple[str, str]]:
    """Pairs of links whose touching is no fault (neighbours, and those that always do)."""
    names = link_names(robot)
    link = np.asarray(robot.spheres.link)
    kept = {frozenset(robot.link_names[i] for i in pair) for pair in link[robot.self_pairs]}
    return [
        (a, b) for i, a in enumerate(names) for b in names[i + 1 :] if frozenset((a, b)) not in kept
    ]


def tool_rotation(robot: Robot) -> FloatArray:
    """A rotation (3, 3) whose z is the tool axis, in the last segment's frame."""
    z = np.asarray(robot.tool_axis)
    x = np.cross([0.0, 1.0, 0.0], z)
    if np.linalg.norm(x) < 1e-6:
        x = np.cross([1.0, 0.0, 0.0], z)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z], axis=1)


def urdf(robot: Robot, objects: Sequence[SceneObject] = ()) -> str:
    """A chain of revolute joints; every link with spheres hangs on its segment by a fixed joint.

    ``objects`` are links fixed to the base, so that an SRDF can say what they may touch.

    Raises:
        ValueError: a prismatic or mimic joint, or an object that URDF has no shape for.
    """
    kin = robot.kinematics
    if kin.kind.any() or not np.array_equal(kin.dof, np.arange(len(kin.kind))):
        raise ValueError("only chains of revolute joints are written")
    parts = [_link(BASE)]
    for s, name in enumerate(robot.joint_names):
        parts.append(_link(f"segment{s}"))
        limits = (
            (
                f'lower="{robot.lower[s]!r}" upper="{robot.upper[s]!r}" '
                f'velocity="{robot.velocity[s]!r}" effort="100"'
            )
            .replace("np.float64(", "")
            .replace(")", "")
        )
        inner = f'<axis xyz="{_text(kin.axis[s])}"/><limit {limits}/>'
        parent = f"segment{s - 1}" if s else BASE
        parts.append(
            _joint(
                name, "revolute", parent, f"segment{s}", kin.translation[s], kin.rotation[s], inner
            )
        )
    spheres = robot.spheres
    for index in np.unique(spheres.link):
        name = robot.link_names[index]
        own = np.flatnonzero(np.asarray(spheres.link) == index)
        balls = ((spheres.center[i], float(spheres.radius[i])) for i in own)
        parent = BASE if spheres.segment[own[0]] < 0 else f"segment{spheres.segment[own[0]]}"
        parts += [
            _link(name, balls),
            _joint(f"hold_{name}", "fixed", parent, name, np.zeros(3), np.eye(3)),
        ]
    last = f"segment{len(kin.kind) - 1}"
    parts += [_link(TIP)]
    parts.append(_joint("hold_tip", "fixed", last, TIP, robot.tool_point, tool_rotation(robot)))
    for obj in objects:
        name = object_name(obj)
        parts += [
            _link(name, shape=_shape(obj)),
            _joint(f"hold_{name}", "fixed", BASE, name, obj.position, obj.rotation),
        ]
    body = "\n".join(parts)
    return f'<?xml version="1.0"?>\n<robot name="{robot.name}">\n{body}\n</robot>\n'


def srdf(robot: Robot, objects: Sequence[SceneObject] = (), extra: str = "") -> str:
    """Which pairs of links are not checked; ``extra`` goes in as it is.

    What only B_d keeps away from (avoid objects and pushables) is not checked with the last link
    and the tool, nor any object with another or with what does not move.
    """
    pairs = exempt_pairs(robot)
    names = [object_name(obj) for obj in objects]
    fixed = np.unique(np.asarray(robot.spheres.link)[np.asarray(robot.spheres.segment) < 0])
    for i, obj in enumerate(objects):
        free = [*names[i + 1 :], *(robot.link_names[k] for k in fixed)]
        if obj.role != "static":
            free += distal_links(robot)
        pairs += [(names[i], other) for other in free]
    lines = [f'<disable_collisions link1="{a}" link2="{b}" reason="Adjacent"/>' for a, b in pairs]
    group = f'<group name="{GROUP}"><chain base_link="{BASE}" tip_link="{TIP}"/></group>'
    body = "\n".join([group, *lines, extra])
    return f'<?xml version="1.0"?>\n<robot name="{robot.name}" version="1.0.0">\n{body}\n</robot>\n'


def obstacles(scene: Scene) -> list[SceneObject]:
    """Everything in the scene but the target."""
    return [obj for obj in scene.objects if obj.role != "target"]


def object_name(obj: SceneObject) -> str:
    """Name of an object's link."""
    return f"object_{obj.id}"


def _shape(obj: SceneObject) -> str:
    match obj.shape:
        case Sphere(radius):
            inner = f'<sphere radius="{radius:.9g}"/>'
        case Box(size):
            inner = f'<box size="{_text(np.asarray(size))}"/>'
        case Cylinder(radius, length):
            inner = f'<cylinder radius="{radius:.9g}" length="{length:.9g}"/>'
        case _:
            raise ValueError(f"{obj.id}: URDF has no {type(obj.shape).__name__}")
    return f"<collision><geometry>{inner}</geometry></collision>"


def _link(name: str, balls: Iterable[tuple[FloatArray, float]] = (), shape: str = "") -> str:
    shapes = "".join(
        f'<collision><origin xyz="{_text(at)}"/><geometry><sphere radius="{radius:.9g}"/>'
        "</geometry></collision>"
        for at, radius in balls
    )
    inertia = '<inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/>'
    mass = f'<inertial><mass value="1"/>{inertia}</inertial>'
    return f'<link name="{name}">{mass}{shapes}{shape}</link>'


def _joint(
    name: str,
    kind: str,
    parent: str,
    child: str,
    at: FloatArray,
    rotation: FloatArray,
    inner: str = "",
) -> str:
    rpy = Rotation.from_matrix(rotation).as_euler("xyz")
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{_text(at)}" rpy="{_text(rpy)}"/>{inner}</joint>'
    )


def _text(values: FloatArray) -> str:
    return " ".join(f"{float(v):.17g}" for v in values)
