"""URDF files, read strictly: links, joints, geometry.

The reader refuses a malformed or ambiguous file, and repairs nothing but the length of a joint
axis.
"""

import math
import re
import warnings
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from types import MappingProxyType
from typing import Literal, NamedTuple, NoReturn

from optipromp.core.errors import LONGEST_NAME, InvalidRobotError, is_name, printable
from optipromp.core.robots.description import LinkShape, Vector
from optipromp.readers.elements import Node, read_xml

JointKind = Literal["revolute", "continuous", "prismatic", "fixed"]

JOINT_KINDS: tuple[JointKind, ...] = ("revolute", "continuous", "prismatic", "fixed")
LENGTH_LIMIT = 20.0  # [m] chosen: a larger length is a number in millimetres
SMALLEST = 1e-9  # [m] chosen: least size of a solid; hulls of tiny solids cannot be found
MOST_LINKS = 10_000  # chosen: they take 8 s
FAR_LENGTH = 10.0  # [m] chosen: a joint farther from its parent causes a warning
ASIDE = 0.3  # [m] chosen: a mesh that is solid farther from where it is shown causes a warning
ANGLE_LIMIT = 4.0 * math.pi  # [rad] chosen: a larger angle is a number in degrees

_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?")


@dataclass(frozen=True)
class UrdfInertial:
    """Mass [kg] of a link, pose of its centre of mass [m, rad], and ``tensor`` of inertia about it.

    ``tensor``: xx, xy, xz, yy, yz, zz [kg m²]; None if the file has none.
    """

    mass: float
    xyz: Vector
    rpy: Vector
    tensor: tuple[float, ...] | None


@dataclass(frozen=True)
class UrdfLink:
    """A link, its geometry, and its inertia if the file has one."""

    name: str
    collisions: tuple[LinkShape, ...]
    visuals: tuple[LinkShape, ...]
    inertial: UrdfInertial | None = None


@dataclass(frozen=True)
class UrdfMimic:
    """position = multiplier * position of ``joint`` + offset [rad or m]."""

    joint: str
    multiplier: float = 1.0
    offset: float = 0.0


@dataclass(frozen=True)
class UrdfJoint:
    """A joint; ``axis`` has unit length; a continuous joint has infinite limits.

    ``velocity`` and ``effort`` are infinite if the file has none, or 0. ``fault``: the reason why
    the joint can be held but not moved, or empty. ``remark``: a warning if the joint moves, where
    no other velocity limits are stated. ``told``: a warning if the joint moves.
    """

    name: str
    kind: JointKind
    parent: str
    child: str
    xyz: Vector
    rpy: Vector
    axis: Vector
    lower: float
    upper: float
    velocity: float
    mimic: UrdfMimic | None
    effort: float = math.inf
    fault: str = ""
    remark: str = ""
    told: str = ""


@dataclass(frozen=True)
class UrdfModel:
    """The content of a URDF; ``joints`` and ``links`` by name, in file order; ``told`` warns."""

    name: str
    path: Path
    root: str
    links: Mapping[str, UrdfLink]
    joints: Mapping[str, UrdfJoint]
    told: str = ""


def read_urdf(path: Path, scale: float = 1.0, content: bytes | None = None) -> UrdfModel:
    """Read the URDF file at ``path``; its lengths are multiplied by ``scale``.

    ``content`` is read in place of the file's content: an expanded xacro file.

    Raises InvalidRobotError, which names the file, the line or the link or joint, the value and
    what would be right.
    """
    return _Reader(path, scale).read(read_xml(path, content))


class Kept(NamedTuple):
    """A range that a joint's controller keeps, of its velocity or else of its position."""

    what: str  # keeps it, in words
    low: float  # [rad or m, or by second]
    high: float
    speed: bool = False


def within(
    ends: tuple[float, float], velocity: float, kept: Iterable[Kept]
) -> tuple[tuple[float, float], float, str]:
    """Position limits and velocity limit within all that is kept, and a warning where they change.

    Two zeros are no range, one that leaves nothing is not kept, and neither is one of several turns
    of a joint without limits.
    """
    limits, told = {False: ends, True: (-velocity, velocity)}, []
    for what, low, high, speed in kept:
        now = limits[speed]
        inner, free = (max(now[0], low), min(now[1], high)), not speed and now[1] == math.inf
        if inner == now or low == high == 0.0 or (free and max(-low, high) > ANGLE_LIMIT):
            continue
        given, of = f"[{now[0]:g}, {now[1]:g}]", "velocities" if speed else "limits"
        if inner[0] >= inner[1]:
            told.append(f"{what} keeps [{low:g}, {high:g}], nothing of its {of} {given}: not read")
            continue
        told.append(f"{what} narrows its {of} to [{inner[0]:g}, {inner[1]:g}] from {given}")
        limits[speed] = inner
    return limits[False], min(limits[True][1], -limits[True][0]), "; ".join(told)


class _Reader:
    """The state of reading one file."""

    def __init__(self, path: Path, scale: float) -> None:
        self.path = path
        self.scale = scale
        self.free: dict[str, Node] = {}  # planar and floating joints
        self.commanded: dict[str, list[Node]] = {}  # interfaces of <ros2_control> by joint

    def refuse(self, what: str, node: Node | None = None) -> NoReturn:
        raise InvalidRobotError(self.at(what, node))

    def at(self, what: str, node: Node | None) -> str:
        """``what`` after the file and the line; empty if ``what`` is empty."""
        where = f"{self.path}:{node.line}" if node is not None else str(self.path)
        return what and f"{where}: {what}"

    def read(self, root: Node) -> UrdfModel:
        if root.tag != "robot":
            self.refuse(f"the root element is <{root.tag}>; a URDF starts with <robot>", root)
        links: dict[str, UrdfLink] = {}
        joints: dict[str, UrdfJoint] = {}
        systems = [node for node in root.children if node.tag == "ros2_control"]
        for driven in (each for node in systems for each in node.children if each.tag == "joint"):
            stated = [each for each in driven.children if each.tag == "command_interface"]
            self.commanded.setdefault(driven.attributes.get("name", ""), []).extend(stated)
        for node in root.children:
            if node.tag == "link":
                link = self.link(node)
                if link.name in links:
                    self.refuse(f"link '{link.name}' is defined twice; names must differ", node)
                links[link.name] = link
            elif node.tag == "joint":
                joint = self.joint(node)
                if joint.name in joints:
                    self.refuse(f"joint '{joint.name}' is defined twice; names must differ", node)
                joints[joint.name] = joint
        if len(links) > MOST_LINKS:
            self.refuse(f"{len(links)} links: must be at most {MOST_LINKS}", root)
        if not links:
            self.refuse("no <link> in it; a robot has at least a base link and one joint", root)
        top = check_tree(links, joints, self.refuse)
        check_mimics(joints, self.refuse)
        self.hold_bases(joints)
        name = root.attributes.get("name", self.path.stem)
        return UrdfModel(name, self.path, top, MappingProxyType(links), MappingProxyType(joints))

    # -- elements ----------------------------------------------------------------------------

    def link(self, node: Node) -> UrdfLink:
        name = self.name(node)
        found: dict[str, list[LinkShape]] = {"collision": [], "visual": []}
        for child in node.children:
            if child.tag == "visual" and _is_point(child):
                continue  # it shows nothing
            if child.tag in found:
                found[child.tag].append(self.geometry(child, f"link '{name}' <{child.tag}>"))
        collisions, visuals = tuple(found["collision"]), tuple(found["visual"])
        for mesh in {shape.mesh for shape in collisions if shape.mesh}:
            solid, shown = ([x.xyz for x in on if x.mesh == mesh] for on in (collisions, visuals))
            away = max(min((math.dist(a, b) for b in shown), default=0.0) for a in solid)
            if away > ASIDE:
                told = f"link '{name}': {mesh} is solid {away:.3g} m off where it is shown: are"
                warnings.warn(self.at(f"{told} xyz and rpy exchanged?", node), stacklevel=2)
        return UrdfLink(name, collisions, visuals, self.inertial(node, f"link '{name}' <inertial>"))

    def inertial(self, node: Node, owner: str) -> UrdfInertial | None:
        holder = self.only(node, "inertial", owner)
        mass = None if holder is None else self.only(holder, "mass", owner)
        if holder is None or mass is None:
            return None
        value = self.numbers(mass, "value", 1, owner)[0]
        if value < 0.0:
            self.refuse(f"{owner} mass is {value:g} kg; it must not be negative", mass)
        found, tensor = self.only(holder, "inertia", owner), None
        if found is not None:
            keys = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
            values = (self.numbers(found, key, 1, owner, (0.0,))[0] for key in keys)
            tensor = tuple(self.scale**2 * value for value in values)
        return UrdfInertial(value, *self.origin(holder, owner), tensor)

    def geometry(self, node: Node, owner: str) -> LinkShape:
        xyz, rpy = self.origin(node, owner)
        holder = self.only(node, "geometry", owner)
        if holder is None or len(holder.children) != 1:
            self.refuse(f"{owner} needs one <geometry> that holds one shape", holder or node)
        shape = holder.children[0]
        what = f"{owner} <{shape.tag}>"
        if shape.tag not in ("box", "capsule", "cylinder", "mesh", "sphere"):
            self.refuse(
                f"{what} is not a known shape; known: box, capsule, cylinder, mesh, sphere", shape
            )
        if shape.tag == "sphere":
            return LinkShape("sphere", (self.size(shape, "radius", what),), xyz, rpy)
        if shape.tag in ("cylinder", "capsule"):
            size = (self.size(shape, "radius", what), self.size(shape, "length", what))
            return LinkShape("cylinder" if shape.tag == "cylinder" else "capsule", size, xyz, rpy)
        if shape.tag == "box":
            return LinkShape("box", self.vector(shape, "size", what, positive=True), xyz, rpy)
        file = shape.attributes.get("filename", "").strip()
        if not file:
            self.refuse(f"{what} has no filename", shape)
        given = self.numbers(shape, "scale", 3, what, default=(1.0, 1.0, 1.0))
        if min(abs(s) for s in given) == 0.0:
            self.refuse(f"{what} scale is {given}; it must not be zero", shape)
        return LinkShape("mesh", tuple(s * self.scale for s in given), xyz, rpy, file)

    def joint(self, node: Node) -> UrdfJoint:
        name = self.name(node)
        owner = f"joint '{name}'"
        stated = node.attributes.get("type", "")
        kind = next((k for k in JOINT_KINDS if k == stated), None)
        if stated in ("planar", "floating"):
            self.free[name], kind = node, "fixed"
        if kind is None:
            self.refuse_kind(owner, node)
        parent, child = (self.end(node, tag, owner) for tag in ("parent", "child"))
        xyz, rpy = self.origin(node, owner)
        if (away := math.hypot(*xyz)) > FAR_LENGTH:
            words = f"{owner} stands {away:.3g} m from its parent: millimetres? then write scale:"
            warnings.warn(self.at(f"{words} 0.001 in a robot file", node), stacklevel=2)
        axis = self.axis(node, owner) if kind != "fixed" else (1.0, 0.0, 0.0)
        lower, upper, velocity, effort, fault = self.limits(node, kind, owner)
        mimic = self.mimic(node, owner) if kind != "fixed" else None
        limit, remark = self.only(node, "limit", owner), ""
        if kind != "fixed" and limit is not None and math.isinf(velocity):
            words = f"{owner} has the velocity limit {limit.attributes.get('velocity')}, which"
            words += " would hold it: taken as none; give one in a robot file (velocity)"
            remark = self.at(words, limit) if "velocity" in limit.attributes else ""
        ends, velocity, told = within((lower, upper), velocity, self.kept(node, kind, owner))
        if kind == "continuous" and math.isfinite(ends[0]):
            kind = "revolute"
        return UrdfJoint(
            name, kind, parent, child, xyz, rpy, axis, *ends, velocity, mimic, effort,
            fault, remark, self.at(told, node),
        )  # fmt: skip

    def kept(self, node: Node, kind: JointKind, owner: str) -> Iterator[Kept]:
        """The ranges that the controllers of a joint keep."""
        unit = self.scale if kind == "prismatic" else 1.0

        def ends(holder: Node, what: str, low: str, high: str) -> Kept:
            (least,) = self.numbers(holder, low, 1, what, (-math.inf,))
            (most,) = self.numbers(holder, high, 1, what, (math.inf,))
            return Kept(what, unit * least, unit * most)

        soft = self.only(node, "safety_controller", owner)
        if soft is not None and kind not in ("continuous", "fixed"):
            keys = "soft_lower_limit", "soft_upper_limit"
            yield ends(soft, f"{owner} <safety_controller>", *keys)
        for each in self.commanded.get(node.attributes["name"].strip(), ()):
            params = [of for of in each.children if of.tag == "param"]
            stated = {of.attributes.get("name", ""): "".join(of.text) for of in params}
            if (quantity := each.attributes.get("name")) not in ("position", "velocity"):
                continue
            what, given = f"{owner} <ros2_control>", Node("param", stated, each.line)
            found = ends(given, what, "min", "max")
            if quantity == "velocity":
                most = min((abs(end) for end in found[1:3] if end), default=math.inf)
                found = Kept(what, -most, most, speed=True)
            if kind != "fixed":
                yield found

    def refuse_kind(self, owner: str, node: Node, why: str = "") -> NoReturn:
        given = node.attributes.get("type", "")
        kinds = ", ".join(JOINT_KINDS)
        self.refuse(f"{owner} has type '{given}'; it must be one of {kinds}{why}", node)

    def hold_bases(self, joints: Mapping[str, UrdfJoint]) -> None:
        """Warn of planar and floating joints under arms, which are fixed; refuse all others."""
        under = bases(joints, self.free) if self.free else set()
        for name, node in self.free.items():
            if name not in under:
                why = "; only what an arm stands on may be planar or floating"
                self.refuse_kind(f"joint '{name}'", node, why)
            told = f"joint '{name}' is {node.attributes['type']}: taken as fixed, at zero"
            warnings.warn(self.at(told, node), stacklevel=2)

    def end(self, node: Node, tag: str, owner: str) -> str:
        found = self.only(node, tag, owner)
        link = found.attributes.get("link", "").strip() if found is not None else ""
        if not link:
            self.refuse(f'{owner} needs a <{tag} link="..."/>', found or node)
        return link

    def axis(self, node: Node, owner: str) -> Vector:
        found = self.only(node, "axis", owner)
        if found is None:
            return (1.0, 0.0, 0.0)  # the URDF standard's default
        axis = self.numbers(found, "xyz", 3, f"{owner} <axis>")
        largest = max(abs(a) for a in axis)
        if largest < 1e-9:
            self.refuse(f"{owner} has the zero axis {axis}; give a direction such as 0 0 1", found)
        # scaled first, so that a huge axis does not overflow
        x, y, z = (a / largest for a in axis)
        length = math.sqrt(x * x + y * y + z * z)
        return (x / length, y / length, z / length)

    def limits(
        self, node: Node, kind: JointKind, owner: str
    ) -> tuple[float, float, float, float, str]:
        """Lower, upper, velocity and effort limit, and the ``fault`` of :class:`UrdfJoint`."""
        if kind == "fixed":
            return 0.0, 0.0, math.inf, math.inf, ""
        found, what, fault = self.only(node, "limit", owner), f"{owner} <limit>", ""
        velocity = effort = math.inf
        if found is not None and "velocity" in found.attributes:
            velocity = self.numbers(found, "velocity", 1, what)[0] or math.inf
            if velocity < 0.0:
                fault = f"{what} velocity is {velocity:g}; give a positive one, or none"
        if found is not None and "effort" in found.attributes:
            effort = self.numbers(found, "effort", 1, what)[0] or math.inf
        unit = self.scale if kind == "prismatic" else 1.0
        if kind == "continuous":
            return -math.inf, math.inf, velocity, effort, self.at(fault, found or node)
        if found is None or not {"lower", "upper"} & set(found.attributes):
            right = "use type continuous if it turns freely" if kind == "revolute" else "in metres"
            fault = f"{owner} is {kind} and has no limits; give lower and upper ({right})"
            return -math.inf, math.inf, velocity * unit, effort, self.at(fault, node)
        lower = unit * self.numbers(found, "lower", 1, what, default=(0.0,))[0]
        upper = unit * self.numbers(found, "upper", 1, what, default=(0.0,))[0]
        if lower > upper:
            self.refuse(f"{what} lower {lower:g} is above upper {upper:g}", found)
        reach = max(abs(lower), abs(upper))
        if kind == "revolute" and reach > ANGLE_LIMIT:
            self.refuse(
                f"{what} reaches {reach:g} rad, beyond 4 pi: degrees? Radians needed", found
            )
        if kind == "prismatic" and reach > LENGTH_LIMIT:
            self.refuse(f"{what} reaches {reach:g} m, beyond 20 m: millimetres?", found)
        return lower, upper, velocity * unit, effort, self.at(fault, found)

    def mimic(self, node: Node, owner: str) -> UrdfMimic | None:
        found = self.only(node, "mimic", owner)
        if found is None:
            return None
        leader = found.attributes.get("joint", "").strip()
        if not leader:
            self.refuse(f"{owner} <mimic> names no joint", found)
        what = f"{owner} <mimic>"
        multiplier = self.numbers(found, "multiplier", 1, what, default=(1.0,))[0]
        offset = self.numbers(found, "offset", 1, what, default=(0.0,))[0]
        return UrdfMimic(leader, multiplier, offset)

    # -- values ------------------------------------------------------------------------------

    def name(self, node: Node) -> str:
        name = node.attributes.get("name", "").strip()
        if not name:
            self.refuse(f"a <{node.tag}> has no name", node)
        if not is_name(name):
            self.refuse(
                f"name '{printable(name)[:60]}' of a <{node.tag}>; it must have no control "
                f"characters and at most {LONGEST_NAME} letters",
                node,
            )
        return name

    def only(self, node: Node, tag: str, owner: str) -> Node | None:
        found = [child for child in node.children if child.tag == tag]
        if len(found) > 1:
            self.refuse(f"{owner} has {len(found)} <{tag}>; at most one is allowed", found[1])
        return found[0] if found else None

    def origin(self, node: Node, owner: str) -> tuple[Vector, Vector]:
        found = self.only(node, "origin", owner)
        if found is None:
            return (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
        xyz = self.vector(found, "xyz", f"{owner} <origin>", default=(0.0, 0.0, 0.0))
        given = self.numbers(found, "rpy", 3, f"{owner} <origin>", default=(0.0, 0.0, 0.0))
        rpy = (given[0], given[1], given[2])
        if max(abs(angle) for angle in rpy) > ANGLE_LIMIT:
            self.refuse(f"{owner} <origin> rpy {rpy} goes beyond 4 pi: degrees?", found)
        return xyz, rpy

    def size(self, node: Node, key: str, owner: str) -> float:
        value = self.numbers(node, key, 1, owner)[0] * self.scale
        if value < SMALLEST:
            self.refuse(f"{owner} {key} is {value:g} m; it must be positive, 1 nm at least", node)
        if value > LENGTH_LIMIT:
            self.refuse(f"{owner} {key} is {value:g} m, beyond 20 m: millimetres?", node)
        return value

    def vector(
        self,
        node: Node,
        key: str,
        owner: str,
        default: Vector | None = None,
        positive: bool = False,
    ) -> Vector:
        x, y, z = (self.scale * v for v in self.numbers(node, key, 3, owner, default))
        if positive and min(x, y, z) < SMALLEST:
            told = f"{owner} {key} is {x:g} {y:g} {z:g}; each must be positive, 1 nm at least"
            self.refuse(told, node)
        norm = math.hypot(x, y, z)
        if norm > LENGTH_LIMIT:
            self.refuse(
                f"{owner} {key} is {x:g} {y:g} {z:g}, {norm:g} m long, beyond 20 m: millimetres?",
                node,
            )
        return (x, y, z)

    def numbers(
        self, node: Node, key: str, count: int, owner: str, default: tuple[float, ...] | None = None
    ) -> tuple[float, ...]:
        text = node.attributes.get(key)
        if text is None:
            if default is None:
                self.refuse(f"{owner} has no {key}", node)
            return default
        words = text.split()
        if len(words) != count:
            self.refuse(f'{owner} {key}="{text}" has {len(words)} numbers; it needs {count}', node)
        for word in words:
            if not _NUMBER.fullmatch(word) or not math.isfinite(float(word)):
                self.refuse(
                    f'{owner} {key}="{text}": "{word}" is not a finite number '
                    "(digits with a decimal point)",
                    node,
                )
        return tuple(float(word) for word in words)


_SIZES = "size", "radius", "length", "scale"


def _is_point(node: Node) -> bool:
    """Whether an element holds a shape with a size of zero."""
    shapes = (shape for each in node.children if each.tag == "geometry" for shape in each.children)
    words = (word for s in shapes for key in _SIZES for word in s.attributes.get(key, "").split())
    return any(_NUMBER.fullmatch(word) and float(word) == 0.0 for word in words)


Refuse = Callable[[str], NoReturn]


def check_tree(
    links: Mapping[str, UrdfLink], joints: Mapping[str, UrdfJoint], refuse: Refuse
) -> str:
    """The root link of the tree; refused if links and joints are not one tree."""
    parent_joint: dict[str, UrdfJoint] = {}
    for joint in joints.values():
        for role, link in (("parent", joint.parent), ("child", joint.child)):
            if link not in links:
                refuse(f"joint '{joint.name}' has the {role} link '{link}', which is not defined")
        if joint.child in parent_joint:
            refuse(
                f"link '{joint.child}' has two parents: joints "
                f"'{parent_joint[joint.child].name}' and '{joint.name}'; a tree has one"
            )
        parent_joint[joint.child] = joint
    roots = [link for link in links if link not in parent_joint]
    if not roots:
        refuse(f"cycle: every link has a parent, link '{next(iter(links))}' among them")
    if len(roots) > 1:
        refuse(f"{len(roots)} roots: links {_quoted(roots)}; a robot has one")
    above = {child: {joint.parent} for child, joint in parent_joint.items()}
    try:  # with one root and one parent per link, links that the root does not reach are a cycle
        TopologicalSorter(above).prepare()
    except CycleError as cycle:
        lost = _quoted(cycle.args[1][1:])
        refuse(f"cycle: links {lost} hang on one another, not on the root")
    return roots[0]


def check_mimics(joints: Mapping[str, UrdfJoint], refuse: Refuse) -> None:
    """Refuse a mimic that does not lead, over any number of mimics, to an independent joint."""
    leaders = {name: joint.mimic.joint for name, joint in joints.items() if joint.mimic}
    for name, leader in leaders.items():
        if leader not in joints:
            refuse(f"joint '{name}' mimics '{leader}', which is not defined")
        if joints[leader].kind == "fixed":
            refuse(f"joint '{name}' mimics '{leader}', which is fixed")
    try:
        TopologicalSorter({name: {leader} for name, leader in leaders.items()}).prepare()
    except CycleError as cycle:
        ring = cycle.args[1][:0:-1]  # each mimics the next
        what = "mimics itself" if len(ring) == 1 else "is in a ring of mimics"
        refuse(f"joint '{ring[0]}' {what}: {_quoted(ring)}")


def bases(joints: Mapping[str, UrdfJoint], names: Collection[str]) -> set[str]:
    """The fixed joints among ``names`` with moving joints after them, and none before them."""
    above = {joint.child: joint for joint in joints.values()}

    def path(link: str) -> Iterator[UrdfJoint]:
        while link in above:
            yield above[link]
            link = above[link].parent

    moving = [joint for joint in joints.values() if joint.kind != "fixed"]
    before = {each.name for joint in moving for each in path(joint.parent)}
    still = {name: path(joints[name].parent) for name in before & set(names)}
    return {name for name, up in still.items() if all(joint.kind == "fixed" for joint in up)}


def _quoted(names: list[str]) -> str:
    shown = ", ".join(f"'{name}'" for name in names[:5])
    return shown + (", ..." if len(names) > 5 else "")
