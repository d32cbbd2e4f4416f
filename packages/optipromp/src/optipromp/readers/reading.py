"""The robot of a URDF, xacro, MJCF or robot file, from the cache if it was resolved before.

The cache folder holds resolved robot files. The name of each is the hash of its sources: the
content of the files, the caller's choice, and the version of the readers.
"""

import hashlib
import os
import warnings
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple, NoReturn

from optipromp.core.errors import InvalidRequestError, InvalidRobotError, suggest
from optipromp.core.files import cache_folder, is_file, read_bytes, write_atomically
from optipromp.core.robots.description import meshes_found
from optipromp.core.robots.library import Check, Choice
from optipromp.core.robots.model import Robot
from optipromp.core.robots.resolved import SUFFIX, read_resolved, resolved
from optipromp.readers.arm import srdf_files
from optipromp.readers.mjcf import is_mjcf, mjcf_files, read_mjcf
from optipromp.readers.packages import expanded, is_xacro, mesh_files, with_meshes_found
from optipromp.readers.robot_file import GROWTH, SLIDE, TURN, RobotFile, read_robot_file
from optipromp.readers.urdf import UrdfModel, check_mimics, read_urdf

_VERSION = 5  # of the readers: raise it when the same files give another robot
_HELD = 16  # robots in memory, chosen

Stamps = tuple[tuple[Path, tuple[int, int] | None], ...]
_held: dict[tuple[Path, str, Check], tuple["_Found", Stamps, Robot]] = {}


class _Found(NamedTuple):
    """The sources of a robot: the robot file, the description, and the files beside it.

    ``model`` is None for an MJCF, which only MuJoCo reads. ``files``: whose content determines the
    robot; None if unknown. ``groups``: the SRDF of the caller or of the robot file. Of a xacro,
    ``sources`` are the files that xacro read, and ``environment`` its environment variables.
    """

    entry: RobotFile
    urdf: Path
    model: UrdfModel | None
    files: list[Path] | None
    groups: Path | None
    sources: tuple[Path, ...] = ()
    environment: Mapping[str, str] | None = None

    def beside(self) -> list[Path]:
        """The SRDF that was named, else every SRDF that may be the robot's."""
        return srdf_files(self.urdf) if self.groups is None else [self.groups]


def read_description(path: Path, choice: Choice, check: Check) -> Robot:
    """The robot of a description at ``path``; see :func:`optipromp.core.robots.load_robot`.

    Files that have not changed since this process read them are not read again.

    ``check``: called with each file that the description names before it is read.
    """
    key = path.absolute(), repr(choice), check
    if held := _held.get(key):
        found, stamps, robot = held
        same = found.environment in (None, dict(os.environ))
        if same and stamps == _stamps(path, found) and _whole(robot, found):
            return robot
    found = _find(path, choice, check)
    stamps = _stamps(path, found)
    robot = _resolved(found, path, choice)
    if found.entry.acceleration is None:
        told = f"{path.name} states no limits of acceleration: {TURN:g} rad/s² and {SLIDE:g} m/s²"
        told += f" are assumed, and {GROWTH:g} times as much jerk in a second; a robot file may"
        told += " state others (acceleration: [...]), or 'acceleration: none'"
        warnings.warn(told, stacklevel=2)
    for words in robot.told:
        warnings.warn(f"{found.urdf}{words}", stacklevel=2)
    if found.files is not None:
        while len(_held) >= _HELD:
            _held.pop(next(iter(_held)), None)
        _held[key] = found, stamps, robot
    return robot


def _find(path: Path, choice: Choice, check: Check) -> _Found:
    """The sources of the robot at ``path``, with every file that they name found and checked."""
    entry = RobotFile(format=1, name=path.stem, urdf=path.name)
    bare = path.suffix.lower() not in (".yaml", ".yml")
    if not bare:
        entry = read_robot_file(path)
    for name in (entry.urdf, *([entry.srdf] if entry.srdf else []), *entry.package_dirs):
        check(path.parent / name)
    folders = [*choice.package_dirs, *(path.parent / each for each in entry.package_dirs)]
    package_dirs = [Path(folder) for folder in folders]
    urdf, groups = path.parent / entry.urdf, None if choice.srdf is None else Path(choice.srdf)
    if groups is None and entry.srdf is not None:
        groups = path.parent / entry.srdf
    arguments = {**entry.args, **choice.args}
    is_a_xacro = is_xacro(urdf)
    if arguments and not is_a_xacro:
        raise InvalidRobotError(f"{urdf}: takes no args ({', '.join(arguments)}): it is no xacro")
    if is_mjcf(urdf):
        if entry.scale != 1.0:
            raise InvalidRobotError(f"{path}: scale is for URDFs; {entry.urdf} is an MJCF")
        named = mjcf_files(urdf, check)
        if named is None and choice.untrusted:
            told = f"{path}: {entry.urdf} names a file that is not there or is no XML"
            raise InvalidRobotError(f"{told}: must be there, inside the scene's folder")
        return _Found(entry, urdf, None, named, groups)
    content, sources, environment = None, tuple[Path, ...](), None
    if is_a_xacro:
        by_user = urdf == path and not choice.untrusted
        content, sources = expanded(urdf, package_dirs, arguments, named_by_user=by_user)
        environment = dict(os.environ)
    model = _coupled(read_urdf(urdf, entry.scale, content), entry, path)
    covered = [link for link in model.links if link not in entry.spheres]
    model = with_meshes_found(model, covered, package_dirs)
    for link in model.links.values():
        for file in meshes_found(urdf, link.name, (*link.collisions, *link.visuals)):
            check(file)
    if bare:
        entry = entry.model_copy(update={"name": model.name})
    return _Found(entry, urdf, model, mesh_files(model, covered), groups, sources, environment)


def _coupled(model: UrdfModel, entry: RobotFile, path: Path) -> UrdfModel:
    """The model with the couplings that the robot file states."""

    def refuse(what: str) -> NoReturn:
        raise InvalidRobotError(f"{path}: mimic: {what}")

    joints = dict(model.joints)
    movable = [joint.name for joint in joints.values() if joint.kind != "fixed"]
    for name, mimic in entry.mimic.items():
        if name not in movable:
            refuse(f"{name!r}: {suggest(name, movable)}")
        joints[name] = replace(joints[name], mimic=mimic)
    check_mimics(joints, refuse)
    return replace(model, joints=MappingProxyType(joints))


def _stamps(path: Path, found: _Found) -> Stamps:
    """Time and size of each file; None for one that is not there."""
    out = dict[Path, tuple[int, int] | None]()
    for file in (path, found.urdf, *found.sources, *(found.files or ()), *found.beside()):
        out[file] = None
        with suppress(OSError):
            status = file.stat()
            out[file] = status.st_mtime_ns, status.st_size
    return tuple(out.items())


def _resolved(found: _Found, path: Path, choice: Choice) -> Robot:
    """The robot from the cache, else built and written there."""
    cached = _cache_file(found, choice)
    if cached is not None:
        with suppress(InvalidRobotError):
            robot = read_resolved(cached)
            geometry = tuple(link._replace(urdf=found.urdf) for link in robot.geometry)
            if _whole(robot, found):
                return replace(robot, geometry=geometry)
    entry, model = found.entry, found.model
    if model is None:
        model = _coupled(read_mjcf(found.urdf), found.entry, path)
        if found.urdf == path:
            entry = entry.model_copy(update={"name": model.name})
    from optipromp.readers.building import build  # SciPy and the kernels of covers load slowly

    robot = build(entry, model, path, choice, found.groups)
    if cached is not None:
        with suppress(InvalidRequestError):  # the next run builds it again
            write_atomically(cached, resolved(robot, cached.parent))
    return robot


def _whole(robot: Robot, found: _Found) -> bool:
    """Whether the meshes that MuJoCo compiled from an MJCF are still in the cache."""
    shapes = [shape for link in robot.geometry for shape in (*link.shapes, *link.looks)]
    return found.model is not None or all(is_file(Path(s.mesh)) for s in shapes if s.mesh)


def _cache_file(found: _Found, choice: Choice) -> Path | None:
    """The robot's file in the cache; None without a cache or if a source cannot be read, which the
    reader of that source reports."""
    folder = cache_folder()
    if folder is None or found.files is None:
        return None
    model, entry = found.model, found.entry.model_copy(update={"urdf": ""})
    chosen = repr((choice.tip, choice.base, sorted(choice.hold.items())))
    chosen += "" if choice.arm is None else f" {choice.arm}"
    digest = hashlib.sha256(f"{_VERSION} {entry!r} {chosen} {found.groups is None}".encode())
    try:
        if model is None:
            digest.update(f"{version('mujoco')} {found.urdf.name}".encode())
        else:
            links, joints = dict(model.links), dict(model.joints)
            digest.update(f"{model.name} {model.root} {links} {joints}".encode())
        for file in (*found.files, *found.beside()):
            content = read_bytes(file, InvalidRequestError)
            name = os.path.relpath(file, found.urdf.parent)
            digest.update(f" {name} {len(content)} ".encode())
            digest.update(content)
    except (InvalidRequestError, PackageNotFoundError, ValueError):
        return None
    return folder / "robots" / f"{digest.hexdigest()}{SUFFIX}"
