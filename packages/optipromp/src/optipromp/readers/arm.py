"""The arm of a robot: its joints and its flange.

The caller's choice precedes the groups of an SRDF, and these precede a rule. The rule drops
grippers and fingers, wheels, heads and sensors, holds joints that carry more than the arm (a
torso), and takes the longest remaining chain. If several are alike, an error lists them.
"""

from collections.abc import Mapping, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import dataclass, replace
from pathlib import Path

from optipromp.core.errors import InvalidRobotError, suggest
from optipromp.core.robots.description import Arm
from optipromp.core.robots.model import Robot
from optipromp.readers.chain import (
    CENTRE,
    FLANGE,
    HEAD,
    LEG,
    PALM,
    SENSOR,
    TORSO,
    WHEEL,
    Tree,
    words_of,
)
from optipromp.readers.elements import Node, read_xml
from optipromp.readers.urdf import UrdfJoint, UrdfModel

_FOLDERS = (".", "srdf", "config", "../srdf", "../config")  # relative to the URDF's folder


@dataclass(frozen=True)
class Group:
    """A group as in the file, also with names that the URDF does not have."""

    name: str
    joints: tuple[str, ...]
    links: tuple[str, ...]
    chains: tuple[tuple[str, str], ...]  # base link, tip link
    groups: tuple[str, ...]


@dataclass(frozen=True)
class Srdf:
    """The content of an SRDF; ``groups`` by name, in file order.

    ``hands``: of each end effector the link that carries it, and its group. ``disabled``: pairs of
    links whose collisions are disabled. ``passive``: joints that nothing drives.
    """

    path: Path
    groups: Mapping[str, Group]
    hands: tuple[tuple[str, str], ...]
    disabled: tuple[tuple[str, str], ...]
    passive: tuple[str, ...]


def read_srdf(path: Path) -> Srdf:
    """Read the SRDF file at ``path``.

    Raises InvalidRobotError, which names the file, the line, the field and what would be right.
    """
    root = read_xml(path)
    if root.tag != "robot":
        raise InvalidRobotError(
            f"{path}:{root.line}: the root element is <{root.tag}>; an SRDF starts with <robot>"
        )
    groups: dict[str, Group] = {}
    hands, disabled, passive = [], [], []
    for node in root.children:
        if node.tag == "group":
            group = _group(path, node)
            if group.name in groups:
                raise InvalidRobotError(
                    f"{path}:{node.line}: group '{group.name}' is defined twice; names must differ"
                )
            groups[group.name] = group
        elif node.tag == "end_effector":
            _, link, of = (_given(path, node, key) for key in ("name", "parent_link", "group"))
            hands.append((link, of))
        elif node.tag == "disable_collisions":
            disabled.append((node.attributes.get("link1", ""), node.attributes.get("link2", "")))
        elif node.tag == "passive_joint":
            passive.append(_given(path, node, "name"))
    return Srdf(path, groups, tuple(hands), tuple(disabled), tuple(passive))


def _group(path: Path, node: Node) -> Group:
    def names(tag: str) -> tuple[str, ...]:
        return tuple(_given(path, child, "name") for child in node.children if child.tag == tag)

    chains = tuple(
        (_given(path, child, "base_link"), _given(path, child, "tip_link"))
        for child in node.children
        if child.tag == "chain"
    )
    name = _given(path, node, "name")
    return Group(name, names("joint"), names("link"), chains, names("group"))


def _given(path: Path, node: Node, key: str) -> str:
    value = node.attributes.get(key, "").strip()
    if not value:
        raise InvalidRobotError(f'{path}:{node.line}: <{node.tag}> needs {key}="..."')
    return value


def srdf_files(urdf: Path) -> list[Path]:
    """Every SRDF beside the URDF, or in a folder srdf or config there."""
    folders = {(urdf.resolve().parent / name).resolve() for name in _FOLDERS}
    return sorted(file for folder in folders for file in folder.glob("*.srdf"))


def srdf_beside(model: UrdfModel) -> Path | None:
    """The SRDF among :func:`srdf_files` that is for a robot of the model's name.

    Of several, the SRDF with the longest file name that is a prefix of the URDF's file name. None
    if there is no SRDF, or if none of several has such a file name. Raises InvalidRobotError if an
    SRDF with such a file name cannot be read.
    """
    found = srdf_files(model.path)
    named = [file for file in found if model.path.stem.startswith(file.stem)]
    of_robot = [file for file in found if _robot(file, strict=file in named) == model.name]
    named = [file for file in named if file in of_robot]
    if named:
        return max(named, key=lambda file: len(file.stem))
    return of_robot[0] if len(of_robot) == 1 else None


def _robot(path: Path, strict: bool) -> str:
    """The robot's name in an SRDF; if it cannot be read, raises if ``strict``, else empty."""
    try:
        return read_xml(path).attributes.get("name", "")
    except InvalidRobotError:
        if strict:
            raise
        return ""


_NO_DIGITS = str.maketrans("", "", "0123456789")
NO_ARM = HEAD | TORSO | PALM | LEG  # words in the names of groups that are no arm, or several


def choose_arm(
    model: UrdfModel,
    tip: str | None = None,
    base: str | None = None,
    srdf: Srdf | None = None,
    name: str | None = None,
) -> Arm:
    """The arm of ``model``.

    ``tip``: the flange link; None: the choice of the SRDF or the rule. ``base``: the link that the
    arm begins at; joints before it are held. None: beyond the links that carry more than the arm.
    ``name``: a group of the SRDF, or a part of the name of the arm's group, its tip or all its
    joints.
    """
    tree = Tree(model)
    for key, link in (("tip", tip), ("base", base)):
        if link is not None and link not in model.links:
            known = ", ".join(list(model.links)[:20])
            what = "flange link" if key == "tip" else "base link"
            raise InvalidRobotError(f"{model.path}: no {what} '{link}'; links: {known}")
    if name is not None and (tip is not None or base is not None):
        raise InvalidRobotError(f"{model.path}: arm {name!r} goes without a tip and a base")
    if tip is not None:
        last = [joint for joint in tree.path(tip) if joint.kind != "fixed"][-1:]
        if base is None and last:
            dropped = tree.hands | tree.followers | tree.named(WHEEL)
            base = _beginning(tree, last[0], frozenset(model.joints) - dropped)
        arm = _made(tree, tip, base, "as given")
        return replace(arm, others=_other_ends(tree, arm))
    found: list[Arm] = []
    if srdf is not None and base is None:
        found = _of_groups(tree, srdf)
    if name is not None:
        found = _named(tree, srdf, name, [*found, *_by_rule(tree, base)])
    if not found:
        found = _by_rule(tree, base)
    alike = [arm for arm in found if len(arm.joints) >= len(found[0].joints) - 1]
    if len({arm.joints for arm in alike}) > 1:
        listed = "; ".join(map(str, alike))
        raise InvalidRobotError(
            f"{model.path}: {len(alike)} arms are alike; choose one by its tip (tip= or --tip, or "
            f"'flange:' in a robot file) or its name (arm= or --arm): {listed}"
        )
    first = found[0]
    more = [str(arm) for arm in found[1:] if (arm.tip, arm.joints) != (first.tip, first.joints)]
    others = tuple(dict.fromkeys([*more, *_other_ends(tree, first)]))
    chains = {} if srdf is None else {name: _of_group(tree, srdf, name) for name in srdf.groups}
    groups = {name: one.joints for name, one in chains.items() if one is not None}
    return replace(first, others=others, groups=groups)


def _named(tree: Tree, srdf: Srdf | None, name: str, arms: Sequence[Arm]) -> list[Arm]:
    """The arm of the group with this name, else all arms that it is a part of the name of."""
    groups = {} if srdf is None else {key: _of_group(tree, srdf, key) for key in srdf.groups}
    chains = {key: arm for key, arm in groups.items() if arm is not None}
    if name in chains:
        return [chains[name]]
    called = {key: arm for key, arm in chains.items() if not words_of(key) & NO_ARM}
    part = name.casefold()
    said = list(called.items())
    said += [(each, arm) for arm in arms for each in (arm.tip, _shared(arm.joints))]
    found = {arm.joints: arm for text, arm in reversed(said) if part in text.casefold()}
    if not found:
        valid = dict.fromkeys([*called, *(arm.tip for arm in arms)])
        raise InvalidRobotError(f"{tree.model.path}: no arm '{name}': {suggest(name, valid)}")
    return sorted(found.values(), key=lambda arm: -len(arm.joints))


def _shared(names: Sequence[str]) -> str:
    """The words that all of some names have."""
    return " ".join(sorted(frozenset.intersection(*map(words_of, names)))) if names else ""


def _made(tree: Tree, tip: str, base: str | None, why: str) -> Arm:
    start = tree.model.root if base is None else base
    before = [tree.model.root, *(joint.child for joint in tree.path(tip))]
    if start not in before:
        raise InvalidRobotError(
            f"{tree.model.path}: base link '{base}' is not between the root and the tip "
            f"'{tip}'; that path is {', '.join(before)}"
        )
    joints = tuple(joint.name for joint in tree.path(tip, base) if joint.kind != "fixed")
    return Arm(start, tip, joints, _carried(tree, tip), why)


def _carried(tree: Tree, tip: str) -> tuple[str, ...]:
    """Links of the tool: beyond the flange, and fingers on the body that has the flange."""
    body = tree.body(tip)
    beyond = []
    for _, part in tree.rigid(body):
        carries = any(joint.name in tree.hands for joint in tree.below[part])
        after = tip in {joint.parent for joint in tree.path(part)}
        of_tool = not words_of(part) & SENSOR and (words_of(part) & PALM or after or carries)
        if of_tool and part not in (tip, body):
            beyond.append(part)
    moving = [each.child for joint in tree.onward(body) for each in tree.subtree(joint)]
    parts = [part for link in moving for _, part in tree.rigid(link)]
    return tuple(dict.fromkeys([*beyond, *parts]))


def _other_ends(tree: Tree, arm: Arm) -> tuple[str, ...]:
    """Descriptions of the tool frames of the last body, by name, that could be the tip instead."""
    last = [part for _, part in tree.rigid(tree.body(arm.tip))]
    return tuple(
        f"tip '{part}' (same joints)"
        for part in last
        if part != arm.tip and words_of(part) & (CENTRE | FLANGE) and not words_of(part) & SENSOR
    )


def _flange_of(tree: Tree, last: str, plain: bool = False) -> str:
    """The flange of an arm whose last joint carries the link ``last``.

    In this order: a link named tool0, flange or attachment (a site of an MJCF); an empty frame for
    a hand; the tool frame of a body that is a hand; the farthest link fixed to ``last``, without
    sensors and (unless ``plain``) hands.
    """
    sensors = frozenset(part for _, part in tree.rigid(last)[1:] if words_of(part) & SENSOR)
    if plain:
        return max(tree.rigid(last, sensors), key=lambda part: part[0])[1]
    palms = frozenset(
        part
        for _, part in tree.rigid(last)[1:]
        if any(joint.name in tree.hands for joint in tree.below[part]) or words_of(part) & PALM
    )
    for name in ("tool0", "flange", "attachment"):
        for _, part in tree.rigid(last, sensors):
            if name in words_of(part):
                return part
    for _, part in tree.rigid(last, sensors)[1:]:
        bare = tree.is_hollow(part) and not tree.onward(part)  # and carries no moving joint
        if "hand" in words_of(part) and not words_of(part) & CENTRE and bare:
            return part
    is_hand = words_of(last) & PALM or any(joint.name in tree.hands for joint in tree.below[last])
    parts = tree.rigid(last, sensors if is_hand else sensors | palms)
    if is_hand:
        parts = [(depth, part) for depth, part in parts if words_of(part) & CENTRE] or parts[:1]
    return max(parts, key=lambda part: part[0])[1]


# -- the rule --------------------------------------------------------------------------------


def _by_rule(tree: Tree, base: str | None) -> list[Arm]:
    """Candidates, longest first."""
    inside = tree.model.joints if base is None else _beyond(tree, base)
    movable = [j for j in tree.model.joints.values() if j.kind != "fixed" and j.name in inside]
    heads = tree.named(HEAD)
    dropped = tree.hands | tree.followers | tree.named(WHEEL) | heads
    usable = {joint.name for joint in movable if joint.name not in dropped}
    why = "the longest chain without hands, wheels, heads and sensors"
    alone = not usable
    if alone:  # a hand, or a pan-tilt unit, by itself
        usable = {joint.name for joint in movable if joint.name not in tree.followers}
        why, heads = "the longest chain", frozenset()
    passed: set[str] = set()  # links with a usable joint beyond
    ends = []
    for joint in reversed(tree.outward):
        if joint.name in usable and joint.child not in passed:
            ends.append(joint)
        if joint.name in usable or joint.child in passed:
            passed.add(joint.parent)
    ends.reverse()
    if not ends:
        root = tree.model.root if base is None else base
        return [_made(tree, max(tree.rigid(root))[1], base, why)]
    arms = []
    for end in ends:
        begin = _beginning(tree, end, usable | heads) if base is None else base
        arms.append(_made(tree, _flange_of(tree, end.child, alone), begin, why))
    without_legs = [
        arm
        for arm in arms
        if len(arm.joints) > 1 and not any(words_of(name) & LEG for name in (*arm.joints, arm.tip))
    ]
    return sorted(without_legs or arms, key=lambda arm: -len(arm.joints))


def linkages(model: UrdfModel, robot: Robot) -> str:
    """A warning of joints that look like bars of a linkage beside the arm; empty: of none."""
    tree, held = Tree(model), set(robot.held_joints)
    bars = [
        joint.name
        for name in robot.joint_names
        for joint in tree.onward(tree.body(model.joints[name].parent))
        if joint.name in held and tree.is_linkage(joint, model.joints[name])
    ]
    if not bars:
        return ""
    return (
        f"{model.path}: joint {', '.join(bars)} and what it carries look like bars of a linkage "
        "beside the arm: held at rest, though the arm may move it; give its links no spheres in a "
        "robot file and the arm's links larger ones"
    )


def _beyond(tree: Tree, base: str) -> set[str]:
    return {
        name
        for name, joint in tree.model.joints.items()
        if base in (joint.parent, *(above.parent for above in tree.path(joint.parent)))
    }


def _beginning(tree: Tree, end: UrdfJoint, usable: AbstractSet[str]) -> str:
    """The link where the arm begins: beyond the last body with another arm, a leg or a head.

    No arm begins at a body with more joints before it than beyond it, nor at a body with a head if
    the joints before and beyond it differ in digits of their names only: that body is a link of the
    arm. The joints of a driving base are no part of an arm.
    """
    path = tree.movable(end.child)
    for k in range(len(path) - 1, 0, -1):
        beside = [
            joint
            for joint in tree.onward(tree.body(path[k].parent))
            if joint.name in usable and joint != path[k] and not tree.is_linkage(joint, path[k])
        ]
        heads = [joint for joint in beside if words_of(joint.name) & HEAD]
        limbs = any(tree.reach(joint) > 1 for joint in beside if joint not in heads)
        series = len({joint.name.translate(_NO_DIGITS) for joint in path[k - 1 : k + 1]}) == 1
        if k < len(path) - k and (limbs or (heads and not series)):
            return path[k].parent
    driving = tree.driving(path)
    return path[driving].parent if 0 < driving < len(path) - 1 else tree.model.root


# -- groups of an SRDF -----------------------------------------------------------------------


def _of_groups(tree: Tree, srdf: Srdf) -> list[Arm]:
    """The arms among the groups, longest first; none if no group is a chain of joints."""
    found: dict[str, Arm] = {}
    for name in srdf.groups:
        arm = _of_group(tree, srdf, name)
        if arm is not None and ("arm" in words_of(name) or not words_of(name) & NO_ARM):
            found[name] = arm
    found = {k: arm for k, arm in found.items() if not words_of(k) & NO_ARM} or found
    arms = []
    for name, arm in found.items():  # of nested groups the smaller, if it has half the joints
        others = [set(other.joints) for key, other in found.items() if key != name]
        mine = set(arm.joints)
        if any(o < mine and 2 * len(o) >= len(mine) for o in others):
            continue
        if any(mine < o and 2 * len(mine) < len(o) for o in others):
            continue
        arms.append(arm)
    return sorted(arms, key=lambda arm: -len(arm.joints))


def _of_group(tree: Tree, srdf: Srdf, name: str) -> Arm | None:
    joints, tips = _members(tree, srdf, name, ())
    moving = [
        joint
        for joint in tree.model.joints.values()
        if joint.name in joints and joint.kind != "fixed" and joint.name not in tree.followers
    ]
    if len(moving) < 2:
        return None
    moving.sort(key=lambda joint: len(tree.path(joint.child)))
    explicit = set(srdf.groups[name].joints)
    while moving[-1].name in tree.hands and moving[-1].name not in explicit:
        moving.pop()  # a chain that runs into the gripper
        if len(moving) < 2:
            return None
    last = moving[-1].child
    path = [joint.name for joint in tree.movable(last)]
    first = path.index(moving[0].name) if moving[0].name in path else len(path)
    if set(path[first:]) != {joint.name for joint in moving}:
        return None  # not a chain
    ends = [part for _, part in tree.rigid(last)]
    for link, group in srdf.hands:
        carriers = {j.name for j in tree.movable(link)}
        if group == name and not carriers & {joint.name for joint in moving}:
            return None  # the group of a hand
        if link in ends and not tips:
            tips = (link,)
    tip = next((link for link in tips if link in ends), None) or _flange_of(tree, last)
    why = f"group '{name}' of {srdf.path.name}"
    return _made(tree, tip, moving[0].parent, why)


def _members(
    tree: Tree, srdf: Srdf, name: str, trail: Sequence[str]
) -> tuple[set[str], tuple[str, ...]]:
    """Joints of a group with its subgroups, and the tips of its chains."""
    if name in trail:
        raise InvalidRobotError(
            f"{srdf.path}: group '{name}' holds itself: {', '.join([*trail, name])}"
        )
    group = srdf.groups[name]
    joints, tips = set(group.joints), tuple(tip for _, tip in group.chains)
    joints |= {tree.above[link].name for link in group.links if link in tree.above}
    for base, tip in group.chains:
        if tip not in tree.model.links:
            continue
        joints |= {joint.name for joint in tree.path(tip, base)}
    for part in group.groups:
        if part not in srdf.groups:
            continue
        more, ends = _members(tree, srdf, part, (*trail, name))
        joints |= more
        tips += ends
    return joints, tips
