"""Checks of the links and joints of a URDF: they are one tree, and mimics are no ring."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from graphlib import CycleError, TopologicalSorter
from typing import TYPE_CHECKING, NoReturn

if TYPE_CHECKING:
    from optipromp.readers.urdf import UrdfJoint, UrdfLink

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
    before, after = set[str](), set[str]()
    for moving in joints.values():
        if moving.kind == "fixed":
            continue
        link = moving.parent
        while link in above:
            link, name = above[link].parent, above[link].name
            if name in names:
                before.add(name)
    for name in before:
        link = joints[name].parent
        while link in above:
            if above[link].kind != "fixed":
                after.add(name)
            link = above[link].parent
    return before - after


def _quoted(names: list[str]) -> str:
    shown = ", ".join(f"'{name}'" for name in names[:5])
    return shown + (", ..." if len(names) > 5 else "")
