"""Pairs of links that an SRDF says may touch."""

from pathlib import Path

from optipromp.errors import InvalidRobotError
from optipromp.readers.urdf import UrdfModel
from optipromp.readers.xml_tree import read_xml

_FOLDERS = (".", "srdf", "config", "../srdf", "../config")  # beside the URDF's own


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
