"""Distances for the judge: plain NumPy on the scene's shapes, apart from the planner's kernels."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from optipromp.arrays import FloatArray, IntArray
from optipromp.geometry import shapes


def to_shape(shape: Any, points: FloatArray) -> FloatArray:
    """Signed distance [m] of ``points`` (..., 3), in the shape's own frame, to its surface."""
    match shape:
        case shapes.Sphere():
            return np.linalg.norm(points, axis=-1) - shape.radius
        case shapes.Box():
            over = np.abs(points) - 0.5 * np.asarray(shape.size)
            return np.linalg.norm(np.maximum(over, 0), axis=-1) + np.minimum(over.max(axis=-1), 0)
        case shapes.Cylinder():
            over = np.stack(
                [
                    np.hypot(points[..., 0], points[..., 1]) - shape.radius,
                    np.abs(points[..., 2]) - 0.5 * shape.length,
                ],
                axis=-1,
            )
            return np.linalg.norm(np.maximum(over, 0), axis=-1) + np.minimum(over.max(axis=-1), 0)
        case shapes.Capsule():
            half = 0.5 * shape.length
            away = points.copy()
            away[..., 2] -= np.clip(points[..., 2], -half, half)
            return np.linalg.norm(away, axis=-1) - shape.radius
        case shapes.HalfSpace():
            return np.asarray(points[..., 2])
        case shapes.PointCloudShape():
            tree = cKDTree(shape.points)
            return np.asarray(tree.query(points)[0]) - shape.radius
        case shapes.MeshShape():
            return _to_mesh(shape, points)
    raise TypeError(f"no distance for {type(shape).__name__}")


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


@dataclass(frozen=True, eq=False)
class LinkPairs:
    """The sphere pairs that must keep apart, by the two links they belong to.

    Attributes:
        links: the spheres (index arrays) of each link that takes part.
        groups: for each pair of links, their places in ``links`` and the sphere pairs (k, 2).
    """

    links: tuple[IntArray, ...]
    groups: tuple[tuple[int, int, IntArray], ...]


def link_pairs(link: IntArray, pairs: IntArray) -> LinkPairs:
    """Group sphere ``pairs`` (P, 2) by the ``link`` (B,) of each sphere."""
    if not len(pairs):
        return LinkPairs((), ())
    names = np.unique(link[pairs])
    place = {int(name): i for i, name in enumerate(names)}
    keys = link[pairs]
    groups = tuple(
        (place[int(a)], place[int(b)], pairs[(keys[:, 0] == a) & (keys[:, 1] == b)])
        for a, b in np.unique(keys, axis=0)
    )
    return LinkPairs(tuple(np.flatnonzero(link == name) for name in names), groups)


def self_clearance(
    spheres: FloatArray, radius: FloatArray, by_link: LinkPairs
) -> tuple[float | None, tuple[int, int]]:
    """Smallest surface distance over the sphere pairs that must keep apart, and that pair.

    Pairs of links go in order of a lower bound from their bounding spheres, and only the moments
    that could still hold the minimum are measured. ``spheres`` (M, B, 3).
    """
    if not by_link.groups:
        return None, (-1, -1)
    middle = [spheres[:, on].mean(axis=1) for on in by_link.links]
    bound = [
        float(np.max(np.linalg.norm(spheres[0, on] - m[0], axis=1) + radius[on]))
        for on, m in zip(by_link.links, middle, strict=True)
    ]
    first = np.array([g[0] for g in by_link.groups])
    second = np.array([g[1] for g in by_link.groups])
    centers = np.stack(middle)
    apart = np.linalg.norm(centers[first] - centers[second], axis=2)
    lower = apart - (np.array(bound)[first] + np.array(bound)[second])[:, None]  # (G, M)
    least = lower.min(axis=1)
    best, where = np.inf, (-1, -1)
    for g in np.argsort(least):
        if least[g] >= best:
            break
        chosen = by_link.groups[g][2]
        moments = np.flatnonzero(lower[g] < best)
        order = moments[np.argsort(lower[g][moments])]
        reach = radius[chosen[:, 0]] + radius[chosen[:, 1]]
        step = 8
        while len(order) and lower[g][order[0]] < best:
            some, order = order[:step], order[step:]
            between = spheres[some[:, None], chosen[:, 0]] - spheres[some[:, None], chosen[:, 1]]
            d = np.sqrt(np.einsum("...i,...i", between, between)) - reach
            if d.min() < best:
                best = float(d.min())
                i = int(np.argmin(d)) % len(chosen)
                where = (int(chosen[i, 0]), int(chosen[i, 1]))
            step = 64
    return best, where


def core_distance(objects: Iterable[Any], spheres: FloatArray) -> float | None:
    """The paper's M_c: from sphere centres to the core of each obstacle.

    The core of a sphere is its centre, of a bar (box, cylinder, capsule) its long axis; other
    shapes count by their surface. None without obstacles.
    """
    best: float | None = None
    flat = spheres.reshape(-1, 3)
    for thing in objects:
        away = flat - thing.position
        bound = extent(thing.shape)
        if best is not None and np.isfinite(bound):
            away = away[np.einsum("...i,...i", away, away) < (best + bound) ** 2]
            if not len(away):
                continue
        match thing.shape:
            case shapes.Sphere():
                d = np.linalg.norm(away, axis=1)
            case shapes.Box():
                half = 0.5 * np.asarray(thing.shape.size)
                d = _to_axis(away @ thing.rotation, int(np.argmax(half)), float(half.max()))
            case shapes.Cylinder() | shapes.Capsule():
                d = _to_axis(away @ thing.rotation, 2, 0.5 * thing.shape.length)
            case _:
                d = to_shape(thing.shape, away @ thing.rotation)
        best = float(d.min()) if best is None else min(best, float(d.min()))
    return best


def _to_axis(points: FloatArray, axis: int, half: float) -> FloatArray:
    """Distance to the segment of half length ``half`` along a coordinate axis."""
    away = points.copy()
    away[:, axis] -= np.clip(points[:, axis], -half, half)
    return np.linalg.norm(away, axis=1)
