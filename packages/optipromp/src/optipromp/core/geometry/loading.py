"""Meshes and point clouds from files."""

from __future__ import annotations

import contextlib
import io
import re
import warnings
from pathlib import Path
from typing import Any

import numpy as np

from optipromp.core.arrays import BoolArray, FloatArray, IntArray
from optipromp.core.errors import InvalidSceneError, installed_by
from optipromp.core.files import read_bytes, read_npz
from optipromp.core.geometry.grids import check_closed
from optipromp.core.geometry.shapes import MeshShape, PointCloudShape

_MESH_SUFFIXES = (".stl", ".obj", ".ply")
_VERTEX = re.compile(rb"^[ \t]*v[ \t]", re.M)  # of an OBJ
_FACE = re.compile(rb"^[ \t]*f[ \t]+([^\r\n#]*)", re.M)
_REST = re.compile(rb"/\S*")  # of a corner: texture and normal
_BELOW = re.compile(rb"<p>[^<]*?(-\d+)")  # of a DAE: a negative index
_CLOUD_SUFFIXES = (".npy", ".npz", ".csv", ".xyz", ".txt", ".ply")


def load_mesh(path: Path, scale: float = 1.0) -> MeshShape:
    """Load a closed mesh from STL, OBJ or PLY.

    Args:
        path: the file.
        scale: from the file's unit to metres.

    Raises:
        InvalidSceneError: the file is missing or malformed, the mesh has no area or is not closed,
            or trimesh is not installed.
    """
    content = _content(path, "mesh", _MESH_SUFFIXES)
    loaded = _trimesh_load(path, content, "mesh")
    parts = list(loaded.geometry.values()) if hasattr(loaded, "geometry") else [loaded]
    if not parts or not all(hasattr(part, "faces") and len(part.faces) for part in parts):
        raise InvalidSceneError(f"mesh {path}: holds no faces: must be a closed surface")
    for part in parts:
        if fault := face_fault(part.faces, len(part.vertices)):
            raise InvalidSceneError(f"mesh {path}: {fault}")
        part.process()
    if hasattr(loaded, "to_mesh"):
        loaded = loaded.to_mesh()
    vertices = scale * np.asarray(loaded.vertices, dtype=np.float64)
    mesh = MeshShape(vertices, np.asarray(loaded.faces, dtype=np.int64), path, scale)
    check_closed(mesh)
    return mesh


def index_fault(suffix: str, content: bytes) -> str:
    """The first wrong index of a face in an OBJ or a DAE, in words; empty without one.

    trimesh takes an index 0 of an OBJ, or a negative one of a DAE, for another.
    """
    if suffix.lower() == ".dae" and (wrong := _BELOW.search(content)):
        return f"an index of a face is {wrong.group(1).decode()}: must be 0 or more"
    if suffix.lower() != ".obj":
        return ""
    count = len(_VERTEX.findall(content))
    lines = [_REST.sub(b"", line) for line in _FACE.findall(content.replace(b"\\\n", b" "))]
    try:
        index = np.array(b" ".join(lines).split(), dtype=np.int64)
    except ValueError:  # trimesh tells
        return ""
    row = np.repeat(np.arange(len(lines)), [len(line.split()) for line in lines])
    bad = (index == 0) | (index > count) | (index < -count)
    return _named(row + 1, index, bad, f"must be 1 to {count}")


def face_fault(faces: IntArray, count: int) -> str:
    """The first of ``faces`` (F, 3) with an index outside 0 to ``count`` - 1, in words."""
    index = np.asarray(faces)
    bad = ((index < 0) | (index >= count)).reshape(-1)
    row = np.repeat(np.arange(len(index)), index.shape[1])
    return _named(row, index.reshape(-1), bad, f"must be 0 to {count - 1}")


def _named(row: IntArray, index: IntArray, bad: BoolArray, right: str) -> str:
    k = int(np.argmax(bad)) if bad.any() else -1
    return "" if k < 0 else f"face {row[k]} names vertex {index[k]}: {right}"


def load_cloud(path: Path, radius: float, scale: float = 1.0) -> PointCloudShape:
    """Load a point cloud; columns past the third (colours, normals) are ignored.

    Args:
        path: ``.npy`` (N, 3), ``.npz`` (key ``points``, or its only array), ``.csv`` (commas),
            ``.xyz`` or ``.txt`` (blanks), with at most one line of headings, or ``.ply``.
        radius: of every point [m].
        scale: from the file's unit to metres.

    Raises:
        InvalidSceneError: the file is missing, malformed or empty.
    """
    content = _content(path, "point cloud", _CLOUD_SUFFIXES)
    suffix = path.suffix.lower()
    if suffix == ".ply":
        loaded = _trimesh_load(path, content, "point cloud")
        points = np.asarray(getattr(loaded, "vertices", np.zeros((0, 3))), dtype=np.float64)
    elif suffix in (".npy", ".npz"):
        points = _numpy_points(path, content)
    else:
        points = _text_points(path, content, "," if suffix == ".csv" else None)
    if points.ndim != 2 or points.shape[1] < 3 or not len(points):
        raise InvalidSceneError(
            f"point cloud {path}: holds an array of shape {points.shape}: must be (N, 3), N >= 1"
        )
    if (empty := int((points[:, :3] == 0.0).all(axis=1).sum())) > 1:
        told = "are (0, 0, 0), as pixels without depth are: leave them out"
        warnings.warn(f"point cloud {path}: {empty} of {len(points)} points {told}", stacklevel=2)
    return PointCloudShape(scale * points[:, :3], radius, path, scale)


def _content(path: Path, what: str, suffixes: tuple[str, ...]) -> bytes:
    if path.suffix.lower() not in suffixes:
        raise InvalidSceneError(f"{what} {path}: suffix must be one of {', '.join(suffixes)}")
    try:
        content = read_bytes(path, InvalidSceneError)
    except InvalidSceneError as error:
        raise InvalidSceneError(f"{what} {error.message}") from None
    if not content:
        raise InvalidSceneError(f"{what} {path}: is empty")
    return content


def _trimesh_load(path: Path, content: bytes, what: str) -> Any:
    """The content of a file as a trimesh object; trimesh reads no other file."""
    try:
        import trimesh
    except ImportError:
        raise InvalidSceneError(
            f"{what} {path}: reading it needs trimesh: {installed_by('optipromp[mesh]')}"
        ) from None
    if what == "mesh" and (fault := index_fault(path.suffix, content)):
        raise InvalidSceneError(f"mesh {path}: {fault}")
    try:
        kind, whole = path.suffix.lower()[1:], what != "mesh"  # a mesh is checked as it stands
        return trimesh.load(io.BytesIO(content), file_type=kind, skip_materials=True, process=whole)
    except Exception as error:  # its readers raise anything on malformed files
        raise _unreadable(what, path, error) from None


def _numpy_points(path: Path, content: bytes) -> FloatArray:
    try:
        if path.suffix.lower() == ".npz":
            arrays = read_npz(path, InvalidSceneError)
            if "points" not in arrays and len(arrays) != 1:
                found = ", ".join(arrays) or "none"
                raise ValueError(f"arrays are {found}: must have 'points'")
            data = arrays.get("points", next(iter(arrays.values())))
        else:
            data = np.load(io.BytesIO(content), allow_pickle=False)
        return np.asarray(data, dtype=np.float64)
    except Exception as error:
        raise _unreadable("point cloud", path, error) from None


def _unreadable(what: str, path: Path, error: Exception) -> InvalidSceneError:
    reason = " ".join(str(error).split())[:120] or type(error).__name__
    return InvalidSceneError(f"{what} {path}: cannot be read: {reason}")


def _text_points(path: Path, content: bytes, delimiter: str | None) -> FloatArray:
    try:
        lines = content.decode("utf-8-sig").splitlines()
    except UnicodeDecodeError:
        raise InvalidSceneError(f"point cloud {path}: is no text in UTF-8") from None
    rows: list[list[float]] = []
    for number, line in enumerate(lines, start=1):
        text = line.split("#", 1)[0].strip()
        if not text:
            continue
        row: list[float] = []
        with contextlib.suppress(ValueError):
            row = [float(entry) for entry in text.split(delimiter)[:3]]
        if len(row) == 3:
            rows.append(row)
        elif number > 1:  # the first line may hold headings
            raise InvalidSceneError(
                f"point cloud {path}: line {number}: must begin with three numbers"
            )
    return np.array(rows, dtype=np.float64).reshape(-1, 3)
