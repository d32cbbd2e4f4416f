"""The files that an MJCF names, found and checked before MuJoCo reads them."""

import math
from collections.abc import Callable, Iterator
from pathlib import Path

from optipromp.core.errors import InvalidRobotError
from optipromp.core.files import is_file, is_folder, is_there
from optipromp.readers.xml_tree import Node, read_xml

SUFFIXES = (".xml", ".mjcf")
_FOLDERS = ("meshdir", "texturedir", "assetdir")  # attributes of <compiler>: folders of assets
MOST_COPIES = 1_000  # of one element, chosen: Menagerie's robots have none
MOST_HEIGHTS = 1_000_000  # of one height field, chosen


def mjcf_files(path: Path, check: Callable[[Path], Path] = Path) -> list[Path] | None:
    """The MJCF file at ``path`` and every file that it names, directly or through others, sorted.

    A name stands for every file of that name in the folders of assets.

    ``path``: of the MJCF. ``check``: called with each other file before it is read.

    Returns: The files; None if one is not found or an MJCF is no XML.
    """
    trees = dict[Path, Node]()
    new = {path}
    while new:
        try:
            trees |= {file: read_xml(file) for file in new}
        except InvalidRobotError:
            return None
        nodes = [(file, node) for file, tree in trees.items() for node in _nodes(tree)]
        for file, node in nodes:
            _check_counts(file, node)
        inner = {
            n.attributes.get(key, "") for _, n in nodes if n.tag == "compiler" for key in _FOLDERS
        }
        folders = {file.parent / each for file in trees for each in {"", *inner}}
        named = {
            value
            for _, node in nodes
            for key, value in node.attributes.items()
            if key.startswith("file") and value  # a texture has fileright and others
        }
        found = set(trees)
        for name in named:
            places = {folder / part for folder in folders for part in (name, Path(name).name)}
            files = {place for place in places if is_file(place)}
            for place in places - files:
                if is_there(place) and not is_folder(place):
                    raise InvalidRobotError(f"{path}: {place} is a device or pipe; must be a file")
            if not files:
                return None
            found |= {check(file) for file in files}
        new = {file for file in found if file.suffix.lower() in SUFFIXES} - set(trees)
    return sorted(found)


def _check_counts(path: Path, node: Node) -> None:
    """Refuse an element that MuJoCo would expand beyond :data:`MOST_COPIES` or MOST_HEIGHTS."""
    for keys, most in ((("count",), MOST_COPIES), (("nrow", "ncol"), MOST_HEIGHTS)):
        words = [word for key in keys for word in node.attributes.get(key, "").split()]
        asked = math.prod(int(word) for word in words if word.isdecimal())
        if asked > most:
            raise InvalidRobotError(
                f"{path}:{node.line}: <{node.tag}> asks for {asked:.3g} of {' x '.join(keys)}: "
                f"must be at most {most}"
            )


def _nodes(tree: Node) -> Iterator[Node]:
    waiting = [tree]
    while waiting:
        node = waiting.pop()
        yield node
        waiting += node.children
