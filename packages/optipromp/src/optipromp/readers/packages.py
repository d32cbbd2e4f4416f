"""The search for the files of a robot description, and the expansion of xacro."""

import io
import json
import os
import re
import signal
import subprocess
import sys
import tempfile
from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from optipromp.core.arrays import FloatArray, IntArray
from optipromp.core.errors import InvalidRobotError, installed_by, suggest
from optipromp.core.files import ALLOW_XACRO, LARGEST_TEXT, is_file, is_folder, is_there, read_bytes
from optipromp.core.geometry.loading import face_fault, index_fault
from optipromp.core.parameters import parameter
from optipromp.core.processes import THREADS
from optipromp.core.robots.description import LinkShape, mesh_file, mesh_name
from optipromp.core.robots.library import Argument, folders_of
from optipromp.readers.urdf import LENGTH_LIMIT, UrdfModel

SHOWN = 500  # letters of an error that are shown, chosen


@dataclass(frozen=True)
class Limits:
    """Limits of a process that reads a robot description."""

    time: float = parameter(60.0, "s", "choice", "an arm takes 1 s")
    memory: float = parameter(4e9, "bytes", "choice", "of addresses; MuJoCo and an arm take 0.2e9")
    output: float = parameter(256e6, "bytes", "choice", "as other files, optipromp.core.files")


LIMITS = Limits()


def run_limited(
    program: str, path: Path, given: Mapping[str, Any], limits: Limits = LIMITS
) -> bytes:
    """The output of a function of :mod:`optipromp.readers.programs`, run in a process of its own.

    The process reads JSON from standard input: ``given``, and the keys ``program``, ``path``
    (absolute), ``out`` (the file to write), ``memory`` and ``output`` [bytes]. If it refuses the
    file, it prints why to standard error and exits with 3.
    """
    with tempfile.TemporaryDirectory(prefix="optipromp-") as folder:
        out = Path(folder) / "out"
        told = {
            "program": program,
            "path": str(path.absolute()),
            "out": str(out),
            "memory": int(limits.memory),
            "output": int(limits.output),
        }
        command = [sys.executable, "-P", str(Path(__file__).with_name("programs.py"))]
        try:
            done = subprocess.run(
                command,
                input=json.dumps({**given, **told}).encode(),
                capture_output=True,
                timeout=limits.time,
                env=os.environ | THREADS,
                check=False,
            )
        except subprocess.TimeoutExpired:
            raise InvalidRobotError(
                f"{path}: cannot be read within {limits.time:g} s: endless?"
            ) from None
        except OSError as error:
            raise InvalidRobotError(f"{path}: no process can start to read it: {error}") from None
        if done.returncode == 0 and is_there(out):
            return read_bytes(out, InvalidRobotError, int(limits.output))
    words = " ".join(done.stderr.decode(errors="replace").split())
    if done.returncode < 0:
        words = f"reading it ended with {signal.Signals(-done.returncode).name}: too large?"
    elif done.returncode != 3:
        words = f"reading it ended with {done.returncode}: {words[-SHOWN:]}"
    raise InvalidRobotError(f"{path}: {words[:SHOWN]}")


PREFIX = "package://"

_FOUND_BY_NAME = re.compile(r"\$\(find(?:-pkg-share)?\s+([\w.-]+)\s*\)|package://([\w.-]+)/")
_UNIT = re.compile(rb"""<unit\b[^>]*\bmeter=["']([0-9]+\.?[0-9]*(?:[eE][-+]?[0-9]+)?)["']""")
_COMMENT = re.compile(rb"<!--.*?-->", re.DOTALL)
_UNDECLARED = re.compile(r"Undefined substitution argument (\w+)")
_PACKAGE = re.compile(rb"<package\b[^>]*>.*?<name>\s*([\w.-]+)\s*</name>", re.DOTALL)
MOST_PACKAGES = 1_000  # beside one another, chosen: a workspace has 100
_HEAD = 65536  # [bytes] chosen: begin of a DAE file that holds <asset>, its first element


def package_folders(name: str, urdf: Path, given: Sequence[Path] = ()) -> list[Path]:
    """Existing folders that may be the package ``name``, in the order of search.

    First folders of ``given`` that have the package's name or hold it, then folders above the URDF,
    then those of AMENT_PREFIX_PATH (``share/<name>``) and of ROS_PACKAGE_PATH; last the folders
    there whose ``package.xml`` has the name.
    """
    here = urdf.resolve().parent
    over = [here, *here.parents]
    ament = [Path(part) / "share" for part in folders_of("AMENT_PREFIX_PATH")]
    places = [*given, *over, *ament, *folders_of("ROS_PACKAGE_PATH")]
    folders = [each for place in places for each in (place, place / name) if each.name == name]
    folders += [each for place in places if is_folder(place) for each in _told(place, name)]
    return [each for each in dict.fromkeys(folders) if is_folder(each)]


def _told(place: Path, name: str) -> list[Path]:
    """The folder, or those in it, whose ``package.xml`` has the package's name."""
    found = [place / "package.xml"]
    with suppress(OSError):  # a folder that cannot be listed
        found += sorted(place.glob("*/package.xml"))[:MOST_PACKAGES]
    out = []
    for file in found:
        with suppress(InvalidRobotError):
            text = read_bytes(file, InvalidRobotError, LARGEST_TEXT) if is_file(file) else b""
            if (told := _PACKAGE.search(_COMMENT.sub(b"", text))) and told[1] == name.encode():
                out.append(file.parent)
    return out


def with_meshes_found(
    model: UrdfModel, links: Sequence[str], package_dirs: Sequence[Path]
) -> UrdfModel:
    """``model`` with the ``package://`` meshes of ``links`` as files, and DAE meshes in metres.

    A link with collision geometry that lacks a visual mesh loses its visual geometry.
    """
    for each in package_dirs:
        if not is_folder(each):
            raise InvalidRobotError(f"{each}: no such folder; packages were to be looked for there")

    def found(link: str, shape: LinkShape) -> LinkShape:
        if not shape.mesh.startswith(PREFIX):
            file = model.path.resolve().parent / shape.mesh.removeprefix("file://")
            return _in_metres(shape, file) if shape.mesh else shape
        name, _, rest = shape.mesh.removeprefix(PREFIX).lstrip("/").partition("/")
        folders = package_folders(name, model.path, package_dirs)
        for folder in folders:
            file = (folder / rest).resolve()
            if is_file(file):
                return _in_metres(replace(shape, mesh=str(file)), file)
        seen = f"not in {', '.join(map(str, folders))}" if folders else f"no folder '{name}'"
        raise InvalidRobotError(
            f"{model.path}: link '{link}' mesh '{shape.mesh}': no such file ({seen}); give the "
            f"folder that holds '{name}' as package_dirs= or --package-dir, or put it on "
            "AMENT_PREFIX_PATH or ROS_PACKAGE_PATH, or over the URDF"
        )

    changed = dict(model.links)
    for name in links:
        link = changed[name]
        shapes = tuple(found(name, shape) for shape in link.collisions or link.visuals)
        if link.collisions:
            try:
                visuals = tuple(found(name, shape) for shape in link.visuals)
            except InvalidRobotError:
                visuals = ()
            changed[name] = replace(link, collisions=shapes, visuals=visuals)
        else:
            changed[name] = replace(link, visuals=shapes)
    return replace(model, links=MappingProxyType(changed))


def _in_metres(shape: LinkShape, file: Path) -> LinkShape:
    """``shape`` scaled by the unit in a DAE file, ``<unit meter="0.001"/>``, as in RViz.

    trimesh ignores the unit.
    """
    if file.suffix.lower() != ".dae" or not is_file(file):
        return shape
    with file.open("rb") as content:
        unit = _UNIT.search(content.read(_HEAD))
    metres = float(unit.group(1)) if unit else 1.0
    return replace(shape, size=tuple(metres * scale for scale in shape.size))


def is_xacro(path: Path) -> bool:
    """Whether a file is a xacro: by its suffix, or as a URDF with elements of xacro."""
    suffix = path.suffix.lower()
    if suffix != ".urdf":
        return suffix == ".xacro"
    content = read_bytes(path, InvalidRobotError, LARGEST_TEXT)
    return b"xmlns:xacro" in content and b"<xacro:" in _COMMENT.sub(b"", content)


def expanded(
    path: Path,
    package_dirs: Sequence[Path],
    arguments: Mapping[str, Argument],
    *,
    named_by_user: bool,
) -> tuple[bytes, tuple[Path, ...]]:
    """The URDF of the xacro file at ``path``, and the files that xacro read for it.

    ``arguments``: by name, in place of their defaults.

    xacro runs in a process of its own, within :data:`LIMITS`.
    """
    short = f"xacro {path.name} > {path.name.split('.')[0]}.urdf"
    if not named_by_user and os.environ.get(ALLOW_XACRO) != "1":
        raise InvalidRobotError(
            f"{path}: a xacro file runs code, and it is named by a file: expand it first "
            f"({short}), or name it yourself, or allow it by {ALLOW_XACRO}=1 if you trust it"
        )
    if find_spec("xacro") is None or find_spec("xacrodoc") is None:
        raise InvalidRobotError(
            f"{path}: reading xacro needs xacrodoc ({installed_by('optipromp[xacro]')}); or expand "
            f"it first: {short}"
        )
    text = read_bytes(path, InvalidRobotError, LARGEST_TEXT).decode("utf-8", "replace")
    names = {name for pair in _FOUND_BY_NAME.findall(text) for name in pair if name}
    folders = {name: package_folders(name, path, package_dirs) for name in names}
    given = {
        "package_dirs": [str(folder) for folder in package_dirs],
        "folders": {name: str(some[0]) for name, some in folders.items() if some},
        "args": {  # as xacro writes them: true and false
            name: str(value).lower() if isinstance(value, bool) else str(value)
            for name, value in arguments.items()
        },
    }
    try:
        out = run_limited("expand_xacro", path, given, replace(LIMITS, output=LARGEST_TEXT))
    except InvalidRobotError as error:
        said = error.message.removeprefix(f"{path}: ")
        if missing := _UNDECLARED.search(said):
            said += f": give it, as --robot-arg {missing[1]}:=VALUE or under args in a robot file"
        raise InvalidRobotError(
            f"{path}: xacro cannot expand it: {said}; packages are looked "
            "for in package_dirs= or --package-dir and over the file"
        ) from None
    told = json.loads(out)
    for name in arguments:
        if name not in told["args"]:
            declared = suggest(name, told["args"]) if told["args"] else "the file declares none"
            raise InvalidRobotError(f"{path}: unknown argument {name!r}: {declared}")
    return told["urdf"].encode(), tuple(map(Path, told["files"]))


LARGEST_MESH = 64_000_000  # [bytes] of a mesh file, chosen: an STL of MOST_TRIANGLES has 50 million
MOST_TRIANGLES = 1_000_000  # of all meshes of a robot, chosen: they take 0.7 GB of memory
_POINTER = b"version https://git-lfs.github.com/"
SUFFIXES = (".stl", ".obj", ".ply", ".dae", ".off", ".glb")


def mesh_files(model: UrdfModel, links: Collection[str]) -> list[Path]:
    """The mesh files of the shapes that cover ``links``. Raises as :func:`mesh_file`."""
    found = [
        mesh_file(model.path, link, shape)
        for link in links
        for shape in model.links[link].collisions or model.links[link].visuals
        if shape.kind == "mesh"
    ]
    return list(dict.fromkeys(found))


def triangles(urdf: Path, link: str, shape: LinkShape) -> FloatArray:
    """The triangles (f, 3, 3) of a mesh in its own frame, scaled [m].

    Raises InvalidRobotError, naming the link and the file, when the mesh is missing, cannot be
    read, has no area or is larger than 20 m, or when the extra that reads meshes is not installed.
    """
    where = mesh_name(urdf, link, shape)
    vertices, faces = _load(mesh_file(urdf, link, shape), where)
    if not np.isfinite(vertices).all():
        raise InvalidRobotError(f"{where} is malformed: a vertex is not finite")
    corners: FloatArray = (vertices * np.array(shape.size))[faces]
    extent = float(np.ptp(corners, axis=(0, 1)).max())
    if float(np.abs(corners).max()) > LENGTH_LIMIT:
        raise InvalidRobotError(
            f"{where} spans {extent:g} m and lies beyond 20 m: millimetres? Give it a scale"
        )
    area = np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    if not area.sum() > 1e-12 * max(extent, 1e-12) ** 2:
        raise InvalidRobotError(f"{where} is degenerate: its surface has no area")
    return corners


def _load(path: Path, where: str) -> tuple[FloatArray, IntArray]:
    try:
        import trimesh
    except ImportError as error:
        raise InvalidRobotError(
            f"{where}: reading meshes needs trimesh ({installed_by('optipromp[mesh]')}); or give "
            "the link spheres in a robot file"
        ) from error
    if path.suffix.lower() not in SUFFIXES:
        raise InvalidRobotError(f"{where}: its suffix must be one of {', '.join(SUFFIXES)}")
    try:
        content = read_bytes(path, InvalidRobotError, LARGEST_MESH)
    except InvalidRobotError as error:
        raise InvalidRobotError(f"{where}: {error.message}") from None
    if content.startswith(_POINTER):
        raise InvalidRobotError(
            f"{where}: is a pointer of Git LFS in place of the mesh: fetch it by 'git lfs pull'"
        )
    if fault := index_fault(path.suffix, content):
        raise InvalidRobotError(f"{where}: {fault}")
    kind = path.suffix.lower()[1:]
    try:  # from memory, so that trimesh reads no other file
        mesh: Any = trimesh.load(
            io.BytesIO(content), file_type=kind, force="mesh", skip_materials=True, process=False
        )  # processing would drop vertices that are not finite
        vertices = np.array(mesh.vertices, dtype=np.float64)
        faces = np.array(mesh.faces, dtype=np.int64)
    except Exception as error:  # trimesh's readers raise whatever goes wrong in them
        raise InvalidRobotError(f"{where}: not a mesh that can be read: {error}") from error
    if vertices.ndim != 2 or faces.ndim != 2 or not len(faces):
        raise InvalidRobotError(f"{where}: holds no triangles")
    if fault := face_fault(faces, len(vertices)):
        raise InvalidRobotError(f"{where}: {fault}")
    return vertices, faces
