"""Distances of the judge to meshes and point clouds, in NumPy, and its view of a scene's things."""

import functools
from collections.abc import Sequence
from typing import Any

import numpy as np

from optipromp.arrays import FloatArray, IntArray
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
    blocks,
)

BLOCK = 32  # things that the sweep first looks at together
CELL = 0.05  # [m] in which things that are near one another are put together


def measured(things: Sequence[Any]) -> tuple[IntArray, FloatArray, FloatArray]:
    """Kinds (K,), sizes (K, 3) and bounds (K,) of shapes, as :class:`Things` holds them.

    The kind of a shape that :mod:`optipromp.sweep` does not measure itself is -1.
    """
    kind, size = np.full(len(things), -1, dtype=np.int64), np.zeros((len(things), 3))
    bound = np.full(len(things), np.inf)
    for rows, own in shapes.of_each_class(things):
        match own[0]:
            case shapes.Sphere():
                kind[rows] = SPHERE
                bound[rows] = size[rows, 0] = [shape.radius for shape in own]
            case shapes.Box():
                kind[rows], size[rows] = BOX, np.array([shape.size for shape in own], float) / 2
                bound[rows] = np.linalg.norm(size[rows], axis=1)
            case shapes.Cylinder() | shapes.Capsule() as first:
                round_ends = isinstance(first, shapes.Capsule)
                kind[rows] = CAPSULE if round_ends else CYLINDER
                radius = np.array([shape.radius for shape in own], float)
                half = 0.5 * np.array([shape.length for shape in own], float)
                size[rows, 0], size[rows, 1] = radius, half
                bound[rows] = radius + half if round_ends else np.hypot(radius, half)
            case shapes.HalfSpace():
                kind[rows] = HALF_SPACE
    return kind, size, bound


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
    """Radius about the shape's origin that holds all of a mesh or point cloud."""
    if isinstance(shape, shapes.PointCloudShape):
        return float(np.linalg.norm(shape.points, axis=1).max() + shape.radius)
    return float(np.linalg.norm(shape.vertices, axis=1).max())


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
    if not np.isfinite(best):
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


@functools.lru_cache(maxsize=4)
def judged_things(scene: Scene) -> tuple[Things, tuple[SceneObject, ...]]:
    """Objects of simple shape as arrays, and the other objects; never the target."""
    role = np.full(len(scene.objects), -1)
    role[scene.rows("static")] = STATIC
    role[scene.rows("avoid")] = AVOID
    role[scene.rows("pushable")] = PUSHABLE
    kind, size, bound = measured([thing.shape for thing in scene.objects])
    rows, rest = (np.flatnonzero((role >= 0) & own) for own in (kind >= 0, kind < 0))
    rows = rows[side_by_side(role[rows], scene.positions[rows], bound[rows])]
    role, position, bound = role[rows], scene.positions[rows], bound[rows]
    block, middle, block_bound = blocks(role, position, bound, BLOCK)
    things = Things(
        rows, kind[rows], role, position, scene.rotations[rows], size[rows], bound, block,
        middle, block_bound,
    )  # fmt: skip
    return things, scene.things(rest)


def side_by_side(role: IntArray, position: FloatArray, bound: FloatArray) -> IntArray:
    """An order (K,) of things in which neighbours are of one role, about one size, and near.

    Along a Z-order curve through cells of :data:`CELL`; the few of a small scene are left as they
    are.
    """
    if len(role) <= BLOCK:
        return np.argsort(role, kind="stable")
    _, exponent = np.frexp(bound)
    exponent = np.where(np.isfinite(bound), np.clip(exponent, -15, 15), 16) + 16
    cell = np.clip(position / CELL + 512.0, 0.0, 1023.0).astype(np.int64)
    key = (role * 64 + exponent) << 30
    for bit in range(10):
        for axis in range(3):
            key |= ((cell[:, axis] >> bit) & 1) << (3 * bit + axis)
    return np.argsort(key, kind="stable")
