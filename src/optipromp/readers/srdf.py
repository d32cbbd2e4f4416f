"""SRDF files: where they are, the groups and end effectors that tell arms, links that may touch."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from optipromp.core.errors import InvalidRobotError
from optipromp.readers.urdf import UrdfModel
from optipromp.readers.xml_tree import Node, read_xml

_FOLDERS = (".", "srdf", "config", "../srdf", "../config")  # beside the URDF's own


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


def srdf_files(urdf: Path) -> list[Path]:
    """Every SRDF beside the URDF, or in a folder srdf or config there."""
    folders = {(urdf.resolve().parent / name).resolve() for name in _FOLDERS}
    return sorted(file for folder in folders for file in folder.glob("*.srdf"))


def srdf_beside(model: UrdfModel) -> Path | None:
    """The SRDF of the robot's name, of :func:`srdf_files`.

    Of several, the one whose file name is the longest that the URDF's begins with. None where
    there is none, or where none of several is named so. Raises InvalidRobotError for one that
    has the name and cannot be read.
    """
    found = srdf_files(model.path)
    named = [file for file in found if model.path.stem.startswith(file.stem)]
    own = [file for file in found if _robot(file, strict=file in named) == model.name]
    named = [file for file in named if file in own]
    if named:
        return max(named, key=lambda file: len(file.stem))
    return own[0] if len(own) == 1 else None


def _robot(path: Path, strict: bool) -> str:
    """The robot that an SRDF is for; empty for one that cannot be read, unless ``strict``."""
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
