"""SRDF files, as far as they tell arms: groups and end effectors."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from optipromp.errors import InvalidRobotError
from optipromp.readers.xml_tree import Node, read_xml


@dataclass(frozen=True)
class Group:
    """A group as the file gives it; names that the URDF does not have are kept."""

    name: str
    joints: tuple[str, ...]
    links: tuple[str, ...]
    chains: tuple[tuple[str, str], ...]  # base link, tip link
    groups: tuple[str, ...]


@dataclass(frozen=True)
class EndEffector:
    """``group`` of the hand, the link that it hangs on, and the arm's group where given."""

    name: str
    parent_link: str
    group: str
    parent_group: str


@dataclass(frozen=True)
class Srdf:
    """A whole file; ``groups`` by name, in file order."""

    path: Path
    robot: str
    groups: Mapping[str, Group]
    end_effectors: tuple[EndEffector, ...]


def read_srdf(path: Path) -> Srdf:
    """Read the SRDF file at ``path``.

    Raises InvalidRobotError, naming the file, the line, the field and what would be right.
    """
    root = read_xml(path)
    if root.tag != "robot":
        raise InvalidRobotError(
            f"{path}:{root.line}: the root element is <{root.tag}>; an SRDF starts with <robot>"
        )
    groups: dict[str, Group] = {}
    hands = []
    for node in root.children:
        if node.tag == "group":
            group = _group(path, node)
            if group.name in groups:
                raise InvalidRobotError(
                    f"{path}:{node.line}: group '{group.name}' is defined twice; names must differ"
                )
            groups[group.name] = group
        elif node.tag == "end_effector":
            hands.append(
                EndEffector(
                    _given(path, node, "name"),
                    _given(path, node, "parent_link"),
                    _given(path, node, "group"),
                    node.attributes.get("parent_group", ""),
                )
            )
    return Srdf(path, root.attributes.get("name", ""), groups, tuple(hands))


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
