"""What MuJoCo read of an MJCF file, kept on disk under the hash of every file that it may read."""

import hashlib
import json
import math
import os
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from types import MappingProxyType

from pydantic import TypeAdapter, ValidationError

from optipromp.errors import InvalidRequestError, InvalidRobotError
from optipromp.files import (
    LARGEST_TEXT,
    cache_folder,
    is_file,
    is_folder,
    is_there,
    read_bytes,
    write_atomically,
)
from optipromp.robots.urdf import UrdfJoint, UrdfLink, UrdfModel
from optipromp.robots.xml_tree import Node, read_xml

SUFFIXES = (".xml", ".mjcf")
_MJCF_VERSION = 2  # part of the cache key: raise it when the same files give another model
_FOLDERS = ("meshdir", "texturedir", "assetdir")  # of a <compiler>: where assets are
MOST_COPIES = 1_000  # that one element asks for, chosen: Menagerie's robots ask for none
MOST_HEIGHTS = 1_000_000  # of a height field, chosen


@dataclass(frozen=True)
class _Kept:
    """A model but for its path: its name, the root, links and joints."""

    name: str
    root: str
    links: dict[str, UrdfLink]
    joints: dict[str, UrdfJoint]


def kept_mjcf(path: Path, read: Callable[[], UrdfModel]) -> UrdfModel:
    """The model of the MJCF file at ``path``: kept from an earlier time, or read now and kept.

    It is read anew where it, MuJoCo, or a file that it names has changed, where one of those is not
    found, and where one of its meshes is no longer in the cache.
    """
    file = _cache_file(path)
    if file is None:
        return read()
    kind = TypeAdapter(_Kept)
    with suppress(InvalidRequestError, ValidationError):
        kept = kind.validate_json(read_bytes(file, InvalidRequestError, LARGEST_TEXT))
        shapes = [s for each in kept.links.values() for s in (*each.collisions, *each.visuals)]
        if all(is_file(Path(shape.mesh)) for shape in shapes if shape.kind == "mesh"):
            links, joints = MappingProxyType(kept.links), MappingProxyType(kept.joints)
            return UrdfModel(kept.name, path, kept.root, links, joints)
    model = read()
    kept = _Kept(model.name, model.root, dict(model.links), dict(model.joints))
    with suppress(InvalidRequestError):  # the next run reads it again
        write_atomically(file, json.dumps(kind.dump_python(kept)).encode())
    return model


def mjcf_files(path: Path, check: Callable[[Path], Path] = Path) -> list[Path] | None:
    """The MJCF file at ``path`` and every file that it and those name, sorted.

    Of a name that may mean several files, as it does beside several folders of assets, all are
    there. None where a name means no file that is found, or a file cannot be read as XML.

    ``check`` is called with each but the first before it is read.

    Raises InvalidRobotError where a name means a device or pipe, and where an element asks for more
    than MOST_COPIES copies or MOST_HEIGHTS heights.
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
            places = {each / own for each in folders for own in (name, Path(name).name)}
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
    """Refuse an element that MuJoCo would make too much of."""
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


def _cache_file(path: Path) -> Path | None:
    """The file that holds the model of these files; None without a cache, or where one is missing
    or cannot be read: MuJoCo says what is wrong."""
    folder, files = cache_folder(), mjcf_files(path)
    if folder is None or files is None:
        return None
    try:
        digest = hashlib.sha256(f"{_MJCF_VERSION} {version('mujoco')} {path.name}".encode())
        for file in files:
            content = read_bytes(file, InvalidRequestError)
            name = os.path.relpath(file, path.parent)
            digest.update(f" {name} {len(content)} ".encode())
            digest.update(content)
    except (InvalidRequestError, PackageNotFoundError, ValueError):
        return None
    return folder / "mjcf" / f"{digest.hexdigest()}.json"
