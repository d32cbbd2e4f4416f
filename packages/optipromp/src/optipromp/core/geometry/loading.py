"""Meshes and point clouds from files."""

from __future__ import annotations

import io
import re
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

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
_AXIS = re.compile(r"([xyz])(?![a-z0-9])", re.I)  # at the begin of a column's name
_ROW = re.compile(r"at row (\d+)")  # in an error of NumPy
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
    _check_scale(scale, f"mesh {path}")
    loaded = _trimesh_load(path, content, "mesh")
    parts = list(loaded.geometry.values()) if hasattr(loaded, "geometry") else [loaded]
    if not parts or not all(hasattr(part, "faces") and len(part.faces) for part in parts):
        raise InvalidSceneError(f"mesh {path}: holds no faces: must be a closed surface")
    for part in parts:
        if fault := face_fault(part.faces, len(part.vertices)):
            raise InvalidSceneError(f"mesh {path}: {fault}")
        try:
            part.process()
        except Exception as error:  # numbers too large for trimesh
            raise _unreadable("mesh", path, error) from None
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
    except (ValueError, OverflowError):  # trimesh tells
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
    """Load a point cloud: its columns ``x``, ``y`` and ``z``, or without names the first three.

    Args:
        path: ``.npy`` (N, 3 or more), ``.npz`` (key ``points``, or its only array), ``.csv``,
            ``.xyz`` or ``.txt`` (semicolons, commas or blanks), which may begin with a line that
            names the columns, or ``.ply``.
        radius: of every point [m].
        scale: from the file's unit to metres, above 0.

    Raises:
        InvalidSceneError: the file is missing, malformed or empty, or :func:`points_of` refuses it.
    """
    content, what = _content(path, "point cloud", _CLOUD_SUFFIXES), f"point cloud {path}"
    _check_scale(scale, what)
    suffix = path.suffix.lower()
    if suffix == ".ply":
        loaded = _trimesh_load(path, content, "point cloud")
        points = points_of(getattr(loaded, "vertices", np.zeros((0, 3))), what)
    elif suffix in (".npy", ".npz"):
        points = points_of(_numpy_table(path, content), what)
    else:
        table, names = _text_table(path, content)
        points = points_of(table, what, names)
    if (empty := int((points == 0.0).all(axis=1).sum())) > 1:
        told = "are (0, 0, 0), as pixels without depth are: leave them out"
        warnings.warn(f"{what}: {empty} of {len(points)} points {told}", stacklevel=2)
    return PointCloudShape(scale * points, radius, path, scale)


def points_of(table: NDArray[Any], what: str, names: Sequence[str] = ()) -> FloatArray:
    """The points (N, 3) of a table (N, 3 or more): by its columns' names, else its first columns.

    Raises:
        InvalidSceneError: names without x, y and z; a table (3, N); a first column that counts the
            rows; points that are all the same.
    """
    if named := names or table.dtype.names or ():
        axes = [found.group(1).lower() if (found := _AXIS.match(name)) else "" for name in named]
        if not all(axes.count(each) == 1 for each in "xyz"):
            told = ", ".join(named)[:99]
            raise InvalidSceneError(f"{what}: columns {told}: must have x, y and z, each once")
        at = [axes.index(each) for each in "xyz"]
        columns = [table[:, k] if names else table[named[k]].ravel() for k in at]
        table = np.stack(columns, axis=1)
    if table.ndim != 2 or table.shape[1] < 3 or not len(table) or len(table) < table.shape[1] > 3:
        turned = ": is it transposed?" if table.ndim == 2 < len(table) < table.shape[1] else ""
        raise InvalidSceneError(
            f"{what}: holds an array of shape {table.shape}: must be (N, 3), N >= 1{turned}"
        )
    points = np.asarray(table[:, :3], dtype=np.float64)
    if len(points) > 1 and (points == points[0]).all():
        raise InvalidSceneError(f"{what}: its {len(points)} points are all the same")
    if not named and len(points) > 3 and (np.diff(points[:, 0]) == 1.0).all():
        raise InvalidSceneError(f"{what}: its first column counts the rows: must be x, y, z")
    return points


def _check_scale(scale: float, what: str) -> None:
    if not 0.0 < scale < np.inf:
        raise InvalidSceneError(f"{what}: scale is {scale:g}: must be finite and above 0")


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


def _numpy_table(path: Path, content: bytes) -> NDArray[Any]:
    try:
        if path.suffix.lower() == ".npz":
            arrays = read_npz(path, InvalidSceneError)
            if "points" not in arrays and len(arrays) != 1:
                found = ", ".join(arrays) or "none"
                raise ValueError(f"arrays are {found}: must have 'points'")
            data = arrays.get("points", next(iter(arrays.values())))
        else:
            data = np.load(io.BytesIO(content), allow_pickle=False)
        return np.asarray(data, dtype=None if data.dtype.names else np.float64)
    except Exception as error:
        raise _unreadable("point cloud", path, error) from None


def _unreadable(what: str, path: Path, error: Exception) -> InvalidSceneError:
    reason = " ".join(str(error).split())[:120] or type(error).__name__
    return InvalidSceneError(f"{what} {path}: cannot be read: {reason}")


def _text_table(path: Path, content: bytes) -> tuple[FloatArray, list[str]]:
    """The numbers of a text, and the names of its columns, if its first line has them."""
    try:
        lines = [line for line in content.decode("utf-8-sig").splitlines() if line.strip()]
        first = lines[0].strip() if lines else ""
        mark = next((mark for mark in ";," if mark in first), None)
        words = [word.strip("\"' ") for word in first.strip("#/ \t").split(mark)]
        axes = [k for k, word in enumerate(words) if _AXIS.match(word)]
        if first[:1] in "#/" and len(axes) != 3:  # a comment may begin with anything
            axes = []
        rows = lines[1:] if axes or first.isdigit() else lines  # first a count of the points
        if not any(row.split("#", 1)[0].strip() for row in rows):
            return np.zeros((0, 3)), []
        table = np.loadtxt(rows, delimiter=mark, ndmin=2, usecols=axes or None)
        return table, [words[k] for k in axes]
    except ValueError as error:  # in whose words there may be a line of any file
        found = _ROW.search(str(error))
        row = "a row" if found is None else f"row {int(found[1]) + ('convert' in str(error))}"
        raise InvalidSceneError(
            f"point cloud {path}: {row} is not as it must be: UTF-8, three numbers or more, as "
            "many as the others"
        ) from None
