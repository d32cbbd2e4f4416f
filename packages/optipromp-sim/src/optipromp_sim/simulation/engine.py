"""MuJoCo, imported when it is first needed."""

import os
import sys
from dataclasses import dataclass
from enum import IntFlag
from functools import lru_cache
from typing import Any, Literal

import numpy as np

from optipromp.core.arrays import FloatArray, frozen
from optipromp.core.errors import InvalidRequestError, InvalidSceneError, installed_by
from optipromp.core.geometry import shapes
from optipromp.core.robots.tool_protocol import quaternion


def engine() -> Any:
    """The ``mujoco`` module; it renders off screen by EGL unless ``MUJOCO_GL`` says otherwise."""
    if sys.platform.startswith("linux"):
        os.environ.setdefault("MUJOCO_GL", "egl")
    try:
        import mujoco
    except ImportError:
        raise InvalidRequestError(
            f"the simulation needs MuJoCo: {installed_by('optipromp-sim')}"
        ) from None
    return mujoco


EntityKind = Literal["link", "tool", "fruit", "thing", "stem", "static", "avoid"]


@dataclass(frozen=True)
class Entity:
    """A robot link, the tool, a fruit, a stem or an object: its contacts are counted together."""

    kind: EntityKind  # of the entity
    name: str  # of the link, or the object's id (a stem's is its fruit's)
    distal: bool = False  # whether it is the last link or the tool, which are not in B_d

    @property
    def label(self) -> str:
        """Unique among the entities of a world."""
        return f"{self.kind}:{self.name}"


class Layer(IntFlag):
    """Bits of MuJoCo's contype."""

    ROBOT = 1
    FRUIT = 2
    STEM = 4
    STATIC = 8
    AVOID = 16


NOBODY = -1  # Index of an entity that no contact is counted for: the floor's


_NONE, _MOVERS = Layer(0), Layer.ROBOT | Layer.FRUIT
_MEETS: dict[EntityKind | Literal["foot", "floor"], tuple[Layer, Layer]] = {
    "link": (Layer.ROBOT, _NONE), "tool": (Layer.ROBOT, _NONE),
    "fruit": (Layer.FRUIT, _MOVERS), "thing": (Layer.FRUIT, _MOVERS),
    "foot": (_NONE, Layer.STATIC), "floor": (_NONE, Layer.FRUIT), "stem": (Layer.STEM, _MOVERS),
    "static": (Layer.STATIC, _MOVERS), "avoid": (Layer.AVOID, _MOVERS),
}  # fmt: skip
"""``contype`` and ``conaffinity`` by kind.

The robot touches everything but itself. Fruits touch everything. Stems touch the robot and fruits,
but neither each other nor static objects. The foot of a can touches only the object that it stands
on, the floor only fruits that have fallen.
"""


def layers(kind: EntityKind | Literal["foot", "floor"]) -> dict[str, int]:
    """``contype`` and ``conaffinity`` of a kind."""
    return dict(zip(("contype", "conaffinity"), map(int, _MEETS[kind]), strict=True))


GEOMS = {  # MuJoCo's geoms of the same sizes, by the kinds of shapes
    shapes.SPHERE: "mjGEOM_SPHERE",
    shapes.BOX: "mjGEOM_BOX",
    shapes.CYLINDER: "mjGEOM_CYLINDER",
    shapes.CAPSULE: "mjGEOM_CAPSULE",
    shapes.ELLIPSOID: "mjGEOM_ELLIPSOID",
}
MOST_PARTS = 3000  # geoms of one mesh or point cloud: a choice
CACHED = 64  # shapes whose meshes and centres of mass are remembered: more than a scene has


def add_shape(
    spec: Any, body: Any, shape: shapes.Shape, name: str, rotation: FloatArray,
    position: FloatArray, **properties: Any,
) -> list[Any]:  # fmt: skip
    """Add ``shape`` to ``body`` at a pose in the body's frame; returns the geoms.

    A shape that MuJoCo lacks becomes its mesh: the convex hull where that is nearly the same, else
    boxes that fill it at the resolution of its distance grid. A point cloud becomes balls.
    ``properties`` are set on every geom.
    """
    import mujoco

    kinds = mujoco.mjtGeom
    pose = {"pos": position, "quat": quaternion(rotation)}

    def add(kind: Any, size: list[float], **further: Any) -> Any:
        values = {"name": name, **pose, **properties, **further}
        return body.add_geom(type=kind, size=size, **values)

    kind, (a, b, c), *_ = shape.measure
    if kind == shapes.HALF_SPACE:
        return [add(kinds.mjGEOM_PLANE, [2.0, 2.0, 0.1])]
    if kind in GEOMS:
        return [add(getattr(kinds, GEOMS[kind]), [a, b, c])]
    if isinstance(shape, shapes.PointCloudShape):
        points, radius = _thinned(shape)
        parts = [(kinds.mjGEOM_SPHERE, [radius, 0.0, 0.0], point) for point in points]
    else:
        mesh, convex = _solid(shape)
        if convex:
            spec.add_mesh(
                name=f"mesh:{name}",
                uservert=mesh.vertices.ravel().tolist(),
                userface=mesh.faces.ravel().astype(np.int32).tolist(),
            )
            return [add(kinds.mjGEOM_MESH, [0.0, 0.0, 0.0], meshname=f"mesh:{name}")]
        parts = [(kinds.mjGEOM_BOX, list(half), middle) for middle, half in _filling(mesh)]
    return [
        add(part, size, name=f"{name}:{i}", pos=position + rotation @ at)
        for i, (part, size, at) in enumerate(parts)
    ]


@lru_cache(CACHED)
def _solid(shape: shapes.Shape) -> tuple[shapes.MeshShape, bool]:
    """The mesh of a shape, and whether its convex hull is nearly the same."""
    mesh = shape.mesh(shapes.FINE)
    return mesh, shapes.is_convex(mesh)


@lru_cache(CACHED)
def mass_center(shape: shapes.Shape) -> FloatArray:
    """Centre of mass (3,) of a body with the geoms of ``shape``, in the shape's frame [m]."""
    if shape.measure.kind in GEOMS:
        return frozen(np.zeros(3))
    spec = engine().MjSpec()
    body = spec.worldbody.add_body(name="body")
    for geom in add_shape(spec, body, shape, "shape", np.eye(3), np.zeros(3)):
        geom.mass = 1.0
    return frozen(spec.compile().body("body").ipos)


def _filling(shape: shapes.MeshShape) -> list[tuple[FloatArray, FloatArray]]:
    """Boxes (middle, half sizes) that fill a mesh: runs of cells of its distance grid."""
    from optipromp.core.geometry.grids import distance_grid

    grid = distance_grid(shape)
    inside = grid.values <= 0.0
    pitch, origin = float(grid.spacing), np.asarray(grid.origin)
    boxes: list[tuple[FloatArray, FloatArray]] = []
    for i, j in np.argwhere(inside.any(axis=2)):
        edges = np.flatnonzero(np.diff(np.concatenate([[0], inside[i, j].view(np.int8), [0]])))
        for low, high in edges.reshape(-1, 2):
            middle = origin + pitch * np.array([i, j, 0.5 * (low + high - 1)])
            boxes.append((middle, 0.5 * pitch * np.array([1.0, 1.0, high - low])))
    if not boxes or len(boxes) > MOST_PARTS:
        name = shape.path or "mesh"
        raise InvalidSceneError(
            f"{name}: {len(boxes)} boxes fill it; the simulation takes 1 to {MOST_PARTS} "
            "(thinner than the cells of its distance grid, or too large)"
        )
    return boxes


def _thinned(shape: shapes.PointCloudShape) -> tuple[FloatArray, float]:
    """At most :data:`MOST_PARTS` points of a cloud, and the radius at which they cover all [m]."""
    points, pitch = shape.points, shape.radius / 2.0
    radius = shape.radius
    while len(points) > MOST_PARTS:
        _, first = np.unique(np.floor(shape.points / pitch), axis=0, return_index=True)
        points = shape.points[np.sort(first)]
        radius = shape.radius + pitch * np.sqrt(3.0) / 2.0
        pitch *= 1.3
    return points, radius
