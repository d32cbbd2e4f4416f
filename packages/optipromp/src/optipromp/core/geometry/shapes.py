"""Shapes of a scene, each in its own local frame, in metres.

A shape has no pose: an object of a scene (or an item of
:func:`optipromp.core.geometry.obstacles.pack`) adds position and rotation.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, fields
from functools import cached_property, lru_cache
from itertools import chain
from operator import attrgetter
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
from annotated_types import Ge, Le, Unit

from optipromp.core.arrays import FloatArray, IntArray, frozen
from optipromp.core.errors import InvalidSceneError
from optipromp.core.geometry import faces
from optipromp.core.values import Array, Validated

FARTHEST = 1e6  # [m, rad] largest number in a scene; products of larger ones overflow
LEAST = 1e-7  # [m] least size of a shape, chosen: corners within a nanometre count as one

SPHERE, BOX, CYLINDER, CAPSULE, HALF_SPACE, GRID, ELLIPSOID, CONE = range(8)

GRID_PADDING = 3  # least cells between a grid's border and the bounding box of the shape
FEW = 24  # shapes; fewer are read one by one as fast
ROUND = 28  # faces around a drawn ball
FINE = 48  # points around a round shape whose mesh is measured, weighed or simulated
MOST_POINTS = 1500  # drawn of a point cloud
RAYS = 72  # directions about an outline, a multiple of 4: its radius is exact to 0.1 %
_LEVEL = np.array([[math.cos(k), math.sin(k), 0.0] for k in np.arange(RAYS) * 2.0 * np.pi / RAYS])
CONVEX = 0.02  # [-] share of the hull's volume that a convex mesh may lack


Rows = Annotated[FloatArray, Array(None, 3, most=FARTHEST)]
Size = Annotated[float, Ge(LEAST), Le(FARTHEST), Unit("m; is the scale right? 0.001: millimetres")]


class Measure(NamedTuple):
    """Kind and sizes of a shape for distance kernels and cells."""

    kind: int  # one of SPHERE, BOX, CYLINDER, CAPSULE, HALF_SPACE, GRID, ELLIPSOID, CONE
    # by kind. sphere: r, 0, 0; box: half edges; cylinder, capsule: r, half length, 0; ellipsoid:
    # radii; cone: r, half length, r of the tip; else zeros [m]
    size: tuple[float, float, float]
    bound: float  # radius [m] of a ball about the origin that holds the shape; inf for a half-space
    # half edges [m] of a box about the origin, along the axes, that holds the shape
    half: tuple[float, float, float]
    # [m³]; of a point cloud the volume of its bounding box; None: the mesh's volume
    volume: float | None = None


NO_SIZE = 0.0, 0.0, 0.0


_hypot: Any = np.frompyfunc(math.hypot, 3, 1)  # of numbers, or of arrays
_most: Any = np.frompyfunc(max, 3, 1)


class Shape(ABC):
    """A solid in its local frame: the interface between shapes and the library. A shape of a user
    defines :meth:`mesh`. Distance grid, bounds, volume, the balls of a fruit that hangs, picture,
    message and body in the simulation follow from the mesh."""

    @abstractmethod
    def mesh(self, around: int = 24) -> MeshShape:
        """A closed mesh of the surface; of a round one inscribed, with ``around`` points around."""

    @cached_property
    def measure(self) -> Measure:
        """Kind, sizes and bounds; a shape without a kernel is measured on a grid."""
        return self._measured()

    @property
    def volume(self) -> float:
        """See :class:`Measure` [m³]."""
        known = self.measure.volume
        if known is not None:
            return known
        with suppress(TypeError):  # a class without a hash is measured each time
            hash(self)
            return _volume(self)
        return _volume.__wrapped__(self)

    @cached_property
    def _hull(self) -> FloatArray:
        """Corners (V, 3) of the convex hull of the mesh [m]."""
        points = self.mesh(FINE).vertices
        return np.asarray(points[np.unique(hull_faces(points))])

    def support(self, directions: FloatArray) -> FloatArray:
        """Largest extents (...) from the origin along unit vectors ``directions`` (..., 3) [m]."""
        match self:
            case Sphere(radius=r):
                return np.full(directions.shape[:-1], r)
            case Capsule(radius=r, length=length):
                return np.asarray(r + 0.5 * length * np.abs(directions[..., 2]))
            case Cone(radius=r, tip=tip, length=length):
                up = 0.5 * length * directions[..., 2]
                return np.maximum(r + up, tip - up)
            case Ellipsoid(radii=radii):
                return np.asarray(np.sqrt(directions**2 @ np.square(radii)))
            case PointCloudShape(points=points, radius=r):
                return np.asarray((directions @ points.T).max(axis=-1) + r)
        return np.asarray((directions @ self._hull.T).max(axis=-1))

    def surface(self, cut: float = np.inf) -> FloatArray:
        """Faces (F, 4, 3) of the surface [m], see :mod:`optipromp.core.geometry.faces`. Flat faces
        have edges up to ``cut`` [m], or longer ones where an edge has too many pieces."""
        mesh = self.mesh()
        corners = mesh.vertices[mesh.faces]
        return np.concatenate([corners, corners[:, 2:]], axis=1)

    def _measured(self) -> Measure:
        vertices = self.mesh(FINE).vertices
        x, y, z = np.abs(vertices).max(axis=0).tolist()
        return Measure(GRID, NO_SIZE, float(np.sqrt((vertices**2).sum(axis=1).max())), (x, y, z))


@dataclass(frozen=True)
class Primitive(Shape, Validated, error=InvalidSceneError):
    """A shape given by sizes above 0, each a number or three numbers along x, y, z."""

    def __init_subclass__(cls) -> None:
        super().__init_subclass__(label=f"{cls.__name__.lower()} ")

    @classmethod
    def _limited(cls, name: str, hint: Any) -> Any:
        return {float: Size, tuple[float, float, float]: tuple[Size, Size, Size]}.get(hint, hint)

    def mesh(self, around: int = 24) -> MeshShape:
        """The convex hull of the corners of its faces, whatever ``around``."""
        points = np.unique(self.surface().reshape(-1, 3).round(12), axis=0)
        return MeshShape(points, hull_faces(points))


@dataclass(frozen=True)
class Sphere(Primitive):
    """A ball of ``radius`` [m] about the local origin."""

    radius: float

    def _measured(self) -> Measure:
        r = self.radius
        return Measure(SPHERE, (r, 0.0, 0.0), r, (r, r, r), 4.0 / 3.0 * np.pi * r**3)

    def surface(self, cut: float = np.inf) -> FloatArray:
        return faces.sphere(np.zeros(3), self.radius, ROUND)


@dataclass(frozen=True)
class Box(Primitive):
    """A box centred at the local origin; ``size`` holds its full edge lengths along x, y, z [m]."""

    size: tuple[float, float, float]

    def _measured(self) -> Measure:
        x, y, z = self.size
        half = 0.5 * x, 0.5 * y, 0.5 * z
        return Measure(BOX, half, 0.5 * _hypot(x, y, z), half, x * y * z)

    def surface(self, cut: float = np.inf) -> FloatArray:
        return faces.box(np.array(self.size), cut)


@dataclass(frozen=True)
class Cylinder(Primitive):
    """A solid cylinder along local z, centred at the origin; ``radius``, full ``length`` [m]."""

    radius: float
    length: float

    def _measured(self) -> Measure:
        r, half = self.radius, 0.5 * self.length
        volume = np.pi * r**2 * self.length
        return Measure(CYLINDER, (r, half, 0.0), _hypot(r, half, 0.0), (r, r, half), volume)

    def surface(self, cut: float = np.inf) -> FloatArray:
        pieces = min(int(self.length / cut), faces.MOST_PIECES)
        steps = np.linspace(-0.5, 0.5, pieces + 2) * self.length
        wall = np.column_stack([np.full_like(steps, self.radius), steps])
        ends = np.array([[0.0, 0.5 * self.length]])
        return faces.revolve(np.concatenate([-ends, wall, ends]), 24)


@dataclass(frozen=True)
class Capsule(Primitive):
    """A capsule along local z, centred; ``length`` [m] is the distance between sphere centres."""

    radius: float
    length: float

    def _measured(self) -> Measure:
        r, half = self.radius, 0.5 * self.length
        volume = np.pi * r**2 * self.length + 4.0 / 3.0 * np.pi * r**3
        return Measure(CAPSULE, (r, half, 0.0), r + half, (r, r, r + half), volume)

    def surface(self, cut: float = np.inf) -> FloatArray:
        half = np.array([0.0, 0.0, 0.5 * self.length])
        return faces.tube(np.stack([-half, half]), self.radius, 24)


@dataclass(frozen=True)
class Ellipsoid(Primitive):
    """An ellipsoid about the local origin; ``radii`` along local x, y, z [m]."""

    radii: tuple[float, float, float]

    def _measured(self) -> Measure:
        x, y, z = self.radii
        volume = 4.0 / 3.0 * np.pi * (x * y * z)
        return Measure(ELLIPSOID, self.radii, _most(x, y, z), self.radii, volume)

    def surface(self, cut: float = np.inf) -> FloatArray:
        return np.asarray(faces.sphere(np.zeros(3), 1.0, ROUND) * np.array(self.radii))

    def mesh(self, around: int = 24) -> MeshShape:
        """The convex hull of the surface points with evenly spread normals."""
        axes, normals = np.array(self.radii), _normals(around)
        points = axes**2 * normals / np.linalg.norm(axes * normals, axis=1)[:, None]
        return MeshShape(points, hull_faces(points))


@dataclass(frozen=True)
class Cone(Primitive):
    """A cone with round ends along local z, centred: the hull of two balls, like many berries.

    Args:
        radius: of the ball at the shoulder, at +z [m].
        tip: radius of the ball at the tip, at -z [m].
        length: distance between the balls' centres [m], above the difference of the radii.
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

    def _measured(self) -> Measure:
        half, wide = 0.5 * self.length, _most(self.radius, self.tip, 0.0)
        return Measure(CONE, (self.radius, half, self.tip), wide + half, (wide, wide, wide + half))

    def surface(self, cut: float = np.inf) -> FloatArray:
        slope, half = np.arcsin((self.tip - self.radius) / self.length), 0.5 * self.length
        low, high = np.linspace(-0.5 * np.pi, slope, 8), np.linspace(slope, 0.5 * np.pi, 8)
        arcs = [
            np.column_stack([r * np.cos(a), r * np.sin(a) + z])
            for r, a, z in ((self.tip, low, -half), (self.radius, high, half))
        ]
        return faces.revolve(np.concatenate(arcs), ROUND)

    def mesh(self, around: int = 24) -> MeshShape:
        """The convex hull of the surface points with evenly spread normals."""
        normals, half = _normals(around), np.array([0.0, 0.0, 0.5 * self.length])
        shoulder, low = self.radius * normals + half, self.tip * normals - half
        farther = (shoulder * normals).sum(axis=1) >= (low * normals).sum(axis=1)
        points = np.where(farther[:, None], shoulder, low)
        return MeshShape(points, hull_faces(points))


@dataclass(frozen=True)
class HalfSpace(Primitive):
    """All points with local z <= 0; the outward normal is local z."""

    def _measured(self) -> Measure:
        return Measure(HALF_SPACE, NO_SIZE, math.inf, (math.inf, math.inf, math.inf), math.inf)

    def surface(self, cut: float = np.inf) -> FloatArray:
        """A patch of the plane."""
        return faces.rectangle_faces(2.0, 2.0, cut)


PRIMITIVES: dict[str, Any] = {
    "sphere": Sphere, "box": Box, "cylinder": Cylinder, "capsule": Capsule,
    "ellipsoid": Ellipsoid, "cone": Cone, "half_space": HalfSpace,
}  # fmt: skip
"""Shapes without a file, by their names in scene files."""


def alike(shapes: Sequence[Shape]) -> list[tuple[Any, Shape]]:
    """The shapes with their rows; many :data:`PRIMITIVES` of a class are one shape, whose rows are
    an array (k,) and whose sizes are arrays (k,) or (3, k)."""
    if len(shapes) < FEW:
        return [*enumerate(shapes)]
    parts: list[tuple[Any, Shape]] = []
    which = [*map(type, shapes)]
    for kind in set(which):
        rows = [k for k, each in enumerate(which) if each is kind]
        own = [shapes[k] for k in rows]
        if kind in PRIMITIVES.values():
            one: Any = object.__new__(kind)
            for size in fields(kind):
                values: Any = [*map(attrgetter(size.name), own)]
                if isinstance(values[0], tuple):  # NumPy reads tuples at half the speed
                    values = np.fromiter(chain.from_iterable(values), float).reshape(-1, 3).T
                vars(one)[size.name] = np.asarray(values)
            parts.append((np.array(rows), one))
        else:
            parts += zip(rows, own, strict=True)
    return parts


@dataclass(frozen=True, eq=False)
class MeshShape(Shape, Validated, error=InvalidSceneError):
    """A closed triangle mesh.

    Args:
        vertices: (V, 3) vertex positions [m], local frame.
        faces: (F, 3) vertex indices.
        path: the file it was read from, if any (used in messages and when saving a scene).
        scale: the factor from the file's unit to metres, already applied to ``vertices``.
    """

    vertices: Rows
    faces: IntArray
    path: Path | None = None
    scale: float = 1.0

    def __post_init__(self) -> None:
        name = f"mesh {self.path}" if self.path is not None else "mesh"
        super().__post_init__(f"{name}: ")
        vertices, faces = self.vertices, frozen(self.faces, np.int64)
        if len(vertices) < 4:
            raise InvalidSceneError(
                f"{name}: vertices has {len(vertices)} rows: must have 4 or more"
            )
        if faces.ndim != 2 or faces.shape[1] != 3 or len(faces) < 4:
            raise InvalidSceneError(
                f"{name}: faces have shape {faces.shape}: must be (F, 3), F >= 4"
            )
        if faces.min() < 0 or faces.max() >= len(vertices):
            raise InvalidSceneError(
                f"{name}: face indices span {faces.min()} to {faces.max()}: "
                f"must lie in 0 to {len(vertices) - 1}"
            )
        object.__setattr__(self, "faces", faces)

    def mesh(self, around: int = 24) -> MeshShape:
        """Itself."""
        return self


@dataclass(frozen=True, eq=False)
class PointCloudShape(Shape, Validated, error=InvalidSceneError):
    """Points, each the centre of a ball of ``radius`` [m].

    Args:
        points: (N, 3) positions [m], local frame.
        radius: radius given to every point [m].
        path: the file it was read from, if any.
        scale: the factor from the file's unit to metres, already applied to ``points``.
    """

    points: Rows
    radius: Size
    path: Path | None = None
    scale: float = 1.0

    def __post_init__(self) -> None:
        name = f"point cloud {self.path}" if self.path is not None else "point cloud"
        super().__post_init__(f"{name}: ")
        if not len(self.points):
            raise InvalidSceneError(f"{name}: points has no rows: must have 1 or more")

    def _measured(self) -> Measure:
        bound = float(np.sqrt((self.points**2).sum(axis=1).max())) + self.radius
        x, y, z = (np.abs(self.points).max(axis=0) + self.radius).tolist()
        volume = float(np.prod(np.ptp(self.points, axis=0) + 2.0 * self.radius))
        return Measure(GRID, NO_SIZE, bound, (x, y, z), volume)

    def surface(self, cut: float = np.inf) -> FloatArray:
        """A ball at each point, or at every k-th of too many points."""
        shown = self.points[:: max(1, len(self.points) // MOST_POINTS)]
        ball = faces.sphere(np.zeros(3), max(self.radius, 0.003), 6)
        return (shown[:, None, None] + ball).reshape(-1, 4, 3)

    def mesh(self, around: int = 24) -> MeshShape:
        """Refused: the surface between the points is unknown."""
        raise InvalidSceneError("a point cloud has no mesh")


def outlines(shape: Shape, axes: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Circles round the outlines of a shape across unit vectors ``axes`` (M, 3).

    Returns: Radii (M,) of the circles and their middles (M, 3), and the extents (M,) of the
    shape against the axes, all from the shape's origin [m]. A circle is the smallest one where
    the outline is symmetric: of solids of revolution, of ellipsoids, of boxes.
    """
    mirror = axes + np.copysign([0.0, 0.0, 1.0], axes)  # takes the level rays across the axis
    share = axes @ _LEVEL.T / np.abs(mirror[:, 2:])
    rays = _LEVEL - share[..., None] * mirror[:, None]
    far, half, rows = shape.support(rays), RAYS // 2, np.arange(len(axes))
    widest = (far + np.roll(far, half, axis=1)).argmax(axis=1)
    middle = np.zeros((len(axes), 3))
    for k in (widest, (widest + half // 2) % RAYS):  # two directions at right angles
        off = 0.5 * (far[rows, k] - far[rows, (k + half) % RAYS])
        middle += off[:, None] * rays[rows, k]
    radius = (far - (rays @ middle[..., None])[..., 0]).max(axis=1)
    return radius, middle, shape.support(-axes)


def mesh_volume(mesh: MeshShape) -> float:
    """Volume of a closed mesh, by its signed tetrahedra about the origin [m³]."""
    a, b, c = (mesh.vertices[mesh.faces[:, i]] for i in range(3))
    return float(abs(np.einsum("ij,ij->i", a, np.cross(b, c)).sum()) / 6.0)


@lru_cache(maxsize=256)  # each look has fruits of its own, of the same shapes
def _volume(shape: Shape) -> float:
    return mesh_volume(shape.mesh(FINE))


def _normals(around: int) -> FloatArray:
    """Unit vectors (N, 3): ``around`` about z at each of half as many heights, and the poles."""
    polar, turn = np.meshgrid(
        np.linspace(0.0, np.pi, around // 2 + 1)[1:-1],
        np.linspace(0.0, 2.0 * np.pi, around, endpoint=False),
        indexing="ij",
    )
    flat = np.sin(polar)
    rings = np.stack([flat * np.cos(turn), flat * np.sin(turn), np.cos(polar)], axis=-1)
    return np.concatenate([rings.reshape(-1, 3), [[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]]])


def hull_faces(points: FloatArray) -> IntArray:
    """Triangles (F, 3) of the convex hull of points (N, 3), anticlockwise seen from outside."""
    from scipy.spatial import ConvexHull

    hull = ConvexHull(points)
    a, b, c = (points[hull.simplices[:, k]] for k in range(3))
    inward = np.einsum("fi,fi->f", np.cross(b - a, c - a), hull.equations[:, :3]) < 0.0
    return np.asarray(np.where(inward[:, None], hull.simplices[:, ::-1], hull.simplices))


def is_convex(mesh: MeshShape) -> bool:
    """Whether a closed mesh lacks less than the share :data:`CONVEX` of its hull's volume."""
    from scipy.spatial import ConvexHull

    return mesh_volume(mesh) > (1.0 - CONVEX) * float(ConvexHull(mesh.vertices).volume)


def parted(mesh: MeshShape) -> list[MeshShape]:
    """The connected pieces of a mesh, each with its own vertices; those within 1e-9 m are one."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    _, merged = np.unique(mesh.vertices.round(9), axis=0, return_inverse=True)
    joined = merged.reshape(-1)[mesh.faces]
    rows, columns = joined[:, [0, 1]].ravel(), joined[:, [1, 2]].ravel()
    size = int(joined.max()) + 1
    graph = coo_array((np.ones(len(rows)), (rows, columns)), shape=(size, size))
    _, label = connected_components(graph, directed=False)
    of_face, out = label[joined[:, 0]], []
    for value in np.unique(of_face):
        used, own = np.unique(mesh.faces[of_face == value], return_inverse=True)
        out.append(MeshShape(mesh.vertices[used], own.reshape(-1, 3)))
    return out


def box_axes(points: FloatArray) -> FloatArray:
    """Axes (3, 3), as rows, of a box around ``points`` (m, 3), longest side first. The box is along
    the axes of the frame or along the principal axes, whichever is smaller."""
    principal = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2]
    if len(principal) < 3:
        principal = np.eye(3)
    best = min((np.eye(3), principal), key=lambda axes: float(np.prod(_extent(points, axes))))
    order = np.argsort(-_extent(points, best), kind="stable")
    return np.asarray(best[order])


def _extent(points: FloatArray, axes: FloatArray) -> FloatArray:
    """Sizes (3,) of the box of ``points`` along ``axes``; 1e-6 m larger, so that none is 0."""
    return np.asarray(np.ptp(points @ axes.T, axis=0) + 1e-6)
