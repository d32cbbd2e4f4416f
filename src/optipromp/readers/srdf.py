"""SRDF files: how they are found, groups, end effectors, and links that may touch."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from optipromp.core.errors import InvalidRobotError
from optipromp.readers.urdf import UrdfModel
from optipromp.readers.xml_tree import Node, read_xml

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
class EndEffector:
    """A hand: its ``group``, the link that carries it, and the arm's group or ''."""

    name: str
    parent_link: str
    group: str
    parent_group: str


@dataclass(frozen=True)
class Srdf:
    """The content of an SRDF; ``groups`` by name, in file order."""

    path: Path
    robot: str
    groups: Mapping[str, Group]
    end_effectors: tuple[EndEffector, ...]


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


def disabled_pairs(path: Path, model: UrdfModel) -> list[tuple[str, str]]:
    """The pairs of links of ``model`` whose collisions the SRDF disables."""
    pairs = [
        (node.attributes.get("link1", ""), node.attributes.get("link2", ""))
        for node in read_xml(path).children
        if node.tag == "disable_collisions"
    ]
    return [(a, b) for a, b in pairs if a in model.links and b in model.links]
