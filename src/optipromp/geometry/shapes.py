"""Shapes of a scene, each in its own local frame, in metres.

A shape has no pose: an object of a scene (or an item of
:func:`optipromp.geometry.obstacles.pack`) adds position and rotation.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from optipromp.arrays import FloatArray, IntArray, frozen
from optipromp.errors import InvalidSceneError

FARTHEST = 1e6
"""Size of a number of a scene, at most [m, rad]; what is derived from it does not overflow."""

CONVEX = 0.02  # share of its hull's volume that a mesh may lack and still count as convex


def _positive(shape: str, name: str, value: float) -> float:
    number = float(value)
    if not 0.0 < number <= FARTHEST:
        raise InvalidSceneError(
            f"{shape} {name} is {number:g}: must be finite and above 0 [m], at most {FARTHEST:g}"
        )
    return number


class _Solid:
    """A shape given by sizes above 0: numbers, or three of them along x, y, z."""

    def __post_init__(self) -> None:
        shape = type(self).__name__.lower()
        for item in fields(self):  # type: ignore[arg-type]
            name, given = item.name, getattr(self, item.name)
            if item.type == "float":
                object.__setattr__(self, name, _positive(shape, name, given))
                continue
            sizes = tuple(float(size) for size in given)
            if len(sizes) != 3:
                raise InvalidSceneError(f"{shape} {name} has {len(sizes)} entries: must have 3 [m]")
            for index, size in enumerate(sizes):
                _positive(shape, f"{name}[{index}]", size)
            object.__setattr__(self, name, sizes)


@dataclass(frozen=True)
class Sphere(_Solid):
    """A ball of ``radius`` [m] about the local origin."""

    radius: float


@dataclass(frozen=True)
class Box(_Solid):
    """A box centred at the local origin; ``size`` holds its full edge lengths along x, y, z [m]."""

    size: tuple[float, float, float]


@dataclass(frozen=True)
class Cylinder(_Solid):
    """A solid cylinder along local z, centred at the origin; ``radius``, full ``length`` [m]."""

    radius: float
    length: float


@dataclass(frozen=True)
class Capsule(_Solid):
    """A capsule along local z, centred; ``length`` [m] is the distance between sphere centres."""

    radius: float
    length: float


@dataclass(frozen=True)
class Ellipsoid(_Solid):
    """An ellipsoid about the local origin; ``radii`` along local x, y, z [m]."""

    radii: tuple[float, float, float]


@dataclass(frozen=True)
class Cone(_Solid):
    """A cone with round ends along local z, centred: the hull of two balls, as many berries are.

    Args:
        radius: of the ball at its shoulder, at +z [m].
        tip: radius of the ball at its tip, at -z [m].
        length: distance between the balls' centres; more than their radii differ by [m].
    """

    radius: float
    tip: float
    length: float

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.length <= abs(self.radius - self.tip):
            raise InvalidSceneError(
                f"cone length is {self.length:g}: must be above {abs(self.radius - self.tip):g}, "
                "the difference of its radii [m]; else one ball holds the other"
            )


@dataclass(frozen=True)
class HalfSpace:
    """All points with local z <= 0; the outward normal is local z."""


@dataclass(frozen=True, eq=False)
class MeshShape:
    """A closed triangle mesh.

    Args:
        vertices: (V, 3) vertex positions [m], local frame.
        faces: (F, 3) vertex indices.
        path: the file it was read from, if any (used in messages and when saving a scene).
        scale: the factor from the file's unit to metres, already applied to ``vertices``.
    """

    vertices: FloatArray
    faces: IntArray
    path: Path | None = None
    scale: float = field(default=1.0)

    def __post_init__(self) -> None:
        name = f"mesh {self.path}" if self.path is not None else "mesh"
        vertices = frozen(self.vertices)
        faces = frozen(self.faces, np.int64)
        _rows_of_three(name, "vertices", vertices, "V", 4)
        if faces.ndim != 2 or faces.shape[1] != 3 or len(faces) < 4:
            raise InvalidSceneError(
                f"{name}: faces have shape {faces.shape}: must be (F, 3), F >= 4"
            )
        if faces.min() < 0 or faces.max() >= len(vertices):
            raise InvalidSceneError(
                f"{name}: face indices span {faces.min()} to {faces.max()}: "
                f"must lie in 0 to {len(vertices) - 1}"
            )
        object.__setattr__(self, "vertices", vertices)
        object.__setattr__(self, "faces", faces)


@dataclass(frozen=True, eq=False)
class PointCloudShape:
    """Points, each the centre of a ball of ``radius`` [m].

    Args:
        points: (N, 3) positions [m], local frame.
        radius: radius given to every point [m].
        path: the file it was read from, if any.
        scale: the factor from the file's unit to metres, already applied to ``points``.
    """

    points: FloatArray
    radius: float
    path: Path | None = None
    scale: float = field(default=1.0)

    def __post_init__(self) -> None:
        name = f"point cloud {self.path}" if self.path is not None else "point cloud"
        points = frozen(self.points)
        _rows_of_three(name, "points", points, "N", 1)
        object.__setattr__(self, "radius", _positive(name, "radius", self.radius))
        object.__setattr__(self, "points", points)


def _rows_of_three(name: str, what: str, values: FloatArray, letter: str, least: int) -> None:
    if values.ndim != 2 or values.shape[1] != 3 or len(values) < least:
        raise InvalidSceneError(
            f"{name}: {what} have shape {values.shape}: must be ({letter}, 3), {letter} >= {least}"
        )
    bad = np.flatnonzero(~(np.abs(values) <= FARTHEST).all(axis=1))
    if bad.size:
        row, one = values[bad[0]].tolist(), {"vertices": "vertex", "points": "point"}[what]
        raise InvalidSceneError(
            f"{name}: {one} {bad[0]} is {row}: must be finite, at most {FARTHEST:g}"
        )


Shape: TypeAlias = (
    Sphere | Box | Cylinder | Capsule | Ellipsoid | Cone | HalfSpace | MeshShape | PointCloudShape
)


def bounding_radius(shape: Shape) -> float:
    """Radius [m] of a ball about the local origin that holds the shape; inf for a half-space."""
    match shape:
        case Sphere(radius):
            return radius
        case Box(size):
            return 0.5 * math.hypot(*size)
        case Cylinder(radius, length):
            return math.hypot(radius, 0.5 * length)
        case Capsule(radius, length):
            return radius + 0.5 * length
        case Ellipsoid(radii):
            return max(radii)
        case Cone(radius, tip, length):
            return max(radius, tip) + 0.5 * length
        case MeshShape():
            return float(np.sqrt((shape.vertices**2).sum(axis=1).max()))
        case PointCloudShape():
            return float(np.sqrt((shape.points**2).sum(axis=1).max())) + shape.radius
        case HalfSpace():
            return math.inf
    raise InvalidSceneError(f"unknown shape {type(shape).__name__}")


def mesh_volume(mesh: MeshShape) -> float:
    """Volume of a closed mesh, by its signed tetrahedra about the origin [m³]."""
    a, b, c = (mesh.vertices[mesh.faces[:, i]] for i in range(3))
    return float(abs(np.einsum("ij,ij->i", a, np.cross(b, c)).sum()) / 6.0)


def round_mesh(shape: Ellipsoid | Cone, around: int = 24) -> MeshShape:
    """A mesh inscribed in a round shape: the points of its surface of evenly spread normals."""
    polar, turn = np.meshgrid(
        np.linspace(0.0, np.pi, around // 2 + 1)[1:-1],
        np.linspace(0.0, 2.0 * np.pi, around, endpoint=False), indexing="ij",
    )  # fmt: skip
    flat = np.sin(polar)
    rings = np.stack([flat * np.cos(turn), flat * np.sin(turn), np.cos(polar)], axis=-1)
    normals = np.concatenate([rings.reshape(-1, 3), [[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]]])
    if isinstance(shape, Ellipsoid):
        axes = np.array(shape.radii)
        points = axes**2 * normals / np.linalg.norm(axes * normals, axis=1)[:, None]
    else:
        half = np.array([0.0, 0.0, 0.5 * shape.length])
        shoulder, low = shape.radius * normals + half, shape.tip * normals - half
        farther = (shoulder * normals).sum(axis=1) >= (low * normals).sum(axis=1)
        points = np.where(farther[:, None], shoulder, low)
    return MeshShape(points, hull_faces(points))


def hull_faces(points: FloatArray) -> IntArray:
    """Triangles (F, 3) of the convex hull of points (N, 3), anticlockwise seen from outside."""
    from scipy.spatial import ConvexHull

    hull = ConvexHull(points)
    a, b, c = (points[hull.simplices[:, k]] for k in range(3))
    inward = np.einsum("fi,fi->f", np.cross(b - a, c - a), hull.equations[:, :3]) < 0.0
    return np.asarray(np.where(inward[:, None], hull.simplices[:, ::-1], hull.simplices))


def is_convex(mesh: MeshShape) -> bool:
    """Whether a closed mesh fills its convex hull, but for the share :data:`CONVEX`."""
    from scipy.spatial import ConvexHull

    hull = float(ConvexHull(mesh.vertices).volume)
    return mesh_volume(mesh) > (1.0 - CONVEX) * hull


def of_each_class(shapes: Sequence[Shape]) -> Iterator[tuple[IntArray, Sequence[Any]]]:
    """Places (k,) and shapes of every class that there is."""
    classes = list(map(type, shapes))
    for cls in dict.fromkeys(classes):
        rows = np.array([k for k, own in enumerate(classes) if own is cls], dtype=np.int64)
        yield rows, shapes if len(rows) == len(shapes) else [shapes[k] for k in rows.tolist()]
