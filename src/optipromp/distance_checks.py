"""Distances of the judge to meshes and point clouds, in NumPy, and its view of a scene's things."""

import functools
from typing import Any

import numpy as np

from optipromp.arrays import FloatArray
from optipromp.geometry import shapes
from optipromp.scenes.scene import Scene, SceneObject
from optipromp.sweep import (
    AVOID,
    BOX,
    CAPSULE,
    CYLINDER,
    HALF_SPACE,
    PUSHABLE,
    SPHERE,
    STATIC,
    Things,
)


def is_simple(shape: Any) -> bool:
    """Whether :mod:`optipromp.sweep` measures this shape itself."""
    return not isinstance(shape, (shapes.MeshShape, shapes.PointCloudShape))


def simple(shape: Any) -> tuple[int, tuple[float, float, float]]:
    """Kind and sizes of a simple shape, as :class:`optipromp.sweep.Things` holds them."""
    match shape:
        case shapes.Sphere():
            return SPHERE, (shape.radius, 0.0, 0.0)
        case shapes.Box():
            x, y, z = (0.5 * float(side) for side in shape.size)
            return BOX, (x, y, z)
        case shapes.Cylinder():
            return CYLINDER, (shape.radius, 0.5 * shape.length, 0.0)
        case shapes.Capsule():
            return CAPSULE, (shape.radius, 0.5 * shape.length, 0.0)
        case shapes.HalfSpace():
            return HALF_SPACE, (0.0, 0.0, 0.0)
    raise TypeError(f"{type(shape).__name__} is not simple")


def to_shape(shape: Any, points: FloatArray) -> FloatArray:
    """Signed distance [m] of ``points`` (..., 3), in the shape's own frame, to its surface."""
    match shape:
        case shapes.PointCloudShape():
            return np.asarray(_tree(shape).query(points)[0]) - shape.radius
        case shapes.MeshShape():
            return _to_mesh(shape, points)
    raise TypeError(f"no distance for {type(shape).__name__}")


@functools.lru_cache(maxsize=4)
def _tree(cloud: shapes.PointCloudShape) -> Any:
    from scipy.spatial import cKDTree  # slow to import, and seldom needed

    return cKDTree(cloud.points)


def _to_mesh(shape: Any, points: FloatArray) -> FloatArray:
    """Distance to the triangles by projection, its sign by the solid angle they span."""
    corners = np.asarray(shape.vertices)[np.asarray(shape.faces)]
    flat = points.reshape(-1, 3)
    out = np.empty(len(flat))
    for low in range(0, len(flat), 256):
        p = flat[low : low + 256, None, :]
        a, b, c = corners[:, 0] - p, corners[:, 1] - p, corners[:, 2] - p
        la, lb, lc = (np.linalg.norm(v, axis=-1) for v in (a, b, c))
        triple = np.einsum("...i,...i", a, np.cross(b, c))
        below = (
            la * lb * lc
            + np.einsum("...i,...i", a, b) * lc
            + np.einsum("...i,...i", b, c) * la
            + np.einsum("...i,...i", c, a) * lb
        )
        winding = 2.0 * np.arctan2(triple, below).sum(axis=1) / (4.0 * np.pi)
        normal = np.cross(b - a, c - a)
        area = np.einsum("...i,...i", normal, normal)
        height = np.einsum("...i,...i", a, normal) / area
        foot = height[..., None] * normal
        inside = np.ones(height.shape, dtype=bool)
        nearest = np.full(height.shape, np.inf)
        for first, second in ((a, b), (b, c), (c, a)):
            edge = second - first
            inside &= np.einsum("...i,...i", np.cross(edge, foot - first), normal) >= 0
            share = -np.einsum("...i,...i", first, edge) / np.einsum("...i,...i", edge, edge)
            on_edge = first + np.clip(share, 0, 1)[..., None] * edge
            nearest = np.minimum(nearest, np.linalg.norm(on_edge, axis=-1))
        nearest = np.where(inside, np.linalg.norm(foot, axis=-1), nearest).min(axis=1)
        out[low : low + 256] = np.where(np.abs(winding) > 0.5, -nearest, nearest)
    return out.reshape(points.shape[:-1])


def extent(shape: Any) -> float:
    """Radius about the shape's origin that holds all of it; infinite for a half-space."""
    match shape:
        case shapes.Sphere():
            return float(shape.radius)
        case shapes.Box():
            return float(np.linalg.norm(0.5 * np.asarray(shape.size)))
        case shapes.Cylinder():
            return float(np.hypot(shape.radius, 0.5 * shape.length))
        case shapes.Capsule():
            return float(shape.radius + 0.5 * shape.length)
        case shapes.PointCloudShape():
            return float(np.linalg.norm(shape.points, axis=1).max() + shape.radius)
        case shapes.MeshShape():
            return float(np.linalg.norm(shape.vertices, axis=1).max())
    return np.inf


def closest(
    shape: Any,
    position: FloatArray,
    rotation: FloatArray,
    spheres: FloatArray,
    radius: FloatArray,
    best: float,
) -> tuple[float | None, int]:
    """Smallest surface distance of moving spheres (M, B, 3) to one obstacle, and which sphere.

    None when it is certain, from bounding spheres alone, that it is neither below ``best`` nor a
    contact.
    """
    bound = extent(shape)
    away = spheres - position
    lower = np.sqrt(np.einsum("...i,...i", away, away)) - radius - bound
    mask = lower < max(best, 0.0)
    if np.isfinite(bound) and not np.isfinite(best):
        # the sphere nearest by bounding spheres gives a first upper bound
        least = np.unravel_index(np.argmin(lower), lower.shape)
        first = float(to_shape(shape, away[least] @ rotation)) - radius[least[1]]
        mask = lower <= first + 1e-9
    if not mask.any():
        return None, -1
    index = np.nonzero(mask)
    d = to_shape(shape, away[index] @ rotation) - radius[index[1]]
    i = int(np.argmin(d))
    return float(d[i]), int(index[1][i])


@functools.lru_cache(maxsize=16)
def judged_things(scene: Scene) -> tuple[tuple[SceneObject, ...], Things, tuple[SceneObject, ...]]:
    """Objects of simple shape, the same as arrays, and the other objects; never the target."""
    roles = {"static": STATIC, "avoid": AVOID, "pushable": PUSHABLE}
    plain: list[SceneObject] = []
    rest: list[SceneObject] = []
    for thing in scene.objects:
        if thing.role != "target":
            (plain if is_simple(thing.shape) else rest).append(thing)
    measures = [simple(thing.shape) for thing in plain]
    place = [thing.position for thing in plain] or [np.zeros(0)]
    turn = [thing.rotation for thing in plain] or [np.zeros((0, 3))]
    return (
        tuple(plain),
        Things(
            kind=np.array([kind for kind, _ in measures], dtype=np.int64),
            role=np.array([roles[thing.role] for thing in plain], dtype=np.int64),
            position=np.concatenate(place).astype(float).reshape(-1, 3),
            rotation=np.concatenate(turn).astype(float).reshape(-1, 3, 3),
            size=np.array([size for _, size in measures], dtype=float).reshape(-1, 3),
            bound=np.array([extent(thing.shape) for thing in plain], dtype=float),
        ),
        tuple(rest),
    )
