"""The meshes of links: files found, read and checked."""

import io
from collections.abc import Collection
from pathlib import Path
from typing import Any

import numpy as np

from optipromp.core.arrays import FloatArray, IntArray
from optipromp.core.errors import InvalidRobotError, installed_by
from optipromp.core.files import read_bytes
from optipromp.core.geometry.loading import face_fault, index_fault
from optipromp.core.robots.description import LinkShape, mesh_file, mesh_name
from optipromp.readers.urdf import LENGTH_LIMIT, UrdfModel

LARGEST_MESH = 64_000_000  # [bytes] of a mesh file, chosen: an STL of MOST_TRIANGLES has 50 million
MOST_TRIANGLES = 1_000_000  # of all meshes of a robot, chosen: they take 0.7 GB of memory
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
            f"{where}: reading meshes needs trimesh ({installed_by('mesh')}); or give the "
            "link spheres in a robot file"
        ) from error
    if path.suffix.lower() not in SUFFIXES:
        raise InvalidRobotError(f"{where}: its suffix must be one of {', '.join(SUFFIXES)}")
    try:
        content = read_bytes(path, InvalidRobotError, LARGEST_MESH)
    except InvalidRobotError as error:
        raise InvalidRobotError(f"{where}: {error.message}") from None
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
