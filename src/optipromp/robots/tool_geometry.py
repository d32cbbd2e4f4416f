"""The spheres that cover a tool's solids, and the inertia of the solids."""

from collections.abc import Sequence

import numpy as np

from optipromp.arrays import FloatArray
from optipromp.geometry.shapes import Box, Cylinder, MeshShape
from optipromp.robots.meshes import box_axes
from optipromp.robots.spheres import cover_box
from optipromp.robots.tool_protocol import Solid

EXCESS = 0.004  # [m] that a sphere may reach beyond a box, as beyond a cup; a choice
MOST = 60  # spheres of a tool: as many as the Panda has; a choice


def cover_solids(solids: Sequence[Solid]) -> FloatArray:
    """Spheres (k, 4) that cover solids, in the frame that these stand in [m].

    Each solid is cut into cells of a grid over its box, and each cell lies in a sphere; cells that
    a round or pointed solid does not meet are left out. With cells of half edges h, a sphere
    reaches at most ‖h‖ - min h beyond a box, and 2 ‖h‖ beyond another solid. The cells are as fine
    as :data:`MOST` spheres allow, or one cell per solid; never finer than a reach of
    :data:`EXCESS` beyond a box.
    """
    excess = EXCESS
    while True:
        cover = np.concatenate([_cover(solid, excess) for solid in solids])
        if len(cover) <= max(MOST, len(solids)):
            return cover
        excess *= 1.25


def solids_inertia(solids: Sequence[Solid], mass: float) -> tuple[FloatArray, FloatArray]:
    """Centre (3,) [m] and inertia about it (3, 3) [kg m²] of a mass that the solids share.

    By the volumes of their boxes, each with the inertia of a box, m/3 (‖h‖² I - diag h²) for half
    edges h.
    """
    boxes = [_box(solid) for solid in solids]
    volume = np.array([np.prod(half) for _, half, _ in boxes])
    share = mass * volume / volume.sum()
    centers = np.array([center for center, _, _ in boxes])
    middle = share @ centers / mass
    total = np.zeros((3, 3))
    for m, (center, half, axes) in zip(share, boxes, strict=True):
        own = m / 3.0 * axes @ np.diag(half @ half - half**2) @ axes.T
        away = center - middle
        total += own + m * (away @ away * np.eye(3) - np.outer(away, away))
    return middle, total


def _box(solid: Solid) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Centre (3,), half edges (3,) [m] and axes (3, 3), as columns, of a box about a solid."""
    match solid.shape:
        case Box(size):
            center, half, axes = np.zeros(3), 0.5 * np.array(size), np.eye(3)
        case Cylinder(radius, length):
            center, half, axes = np.zeros(3), np.array([radius, radius, 0.5 * length]), np.eye(3)
        case MeshShape(vertices=vertices):
            axes = box_axes(vertices).T
            local = vertices @ axes
            low, high = local.min(axis=0), local.max(axis=0)
            center, half = axes @ (0.5 * (low + high)), 0.5 * (high - low)
    turned = solid.rotation
    return solid.position + turned @ center, half, turned @ axes


def _cover(solid: Solid, excess: float) -> FloatArray:
    center, half, axes = _box(solid)
    grid = cover_box(2.0 * half, excess)
    centers = center + grid[:, :3] @ axes.T
    if not isinstance(solid.shape, Box):
        own = (centers - solid.position) @ solid.rotation
        met = _beyond(solid.shape, own) <= grid[:, 3]
        centers, grid = centers[met], grid[met]
    return np.column_stack([centers, grid[:, 3]])


def _beyond(shape: Cylinder | MeshShape, points: FloatArray) -> FloatArray:
    """Lower bound (k,) of the distance of points (k, 3) from a convex shape, in its frame [m]."""
    if isinstance(shape, Cylinder):
        across, along = np.hypot(points[:, 0], points[:, 1]), np.abs(points[:, 2])
        return np.maximum(across - shape.radius, along - 0.5 * shape.length)
    from scipy.spatial import ConvexHull

    faces = ConvexHull(shape.vertices).equations
    return np.asarray((points @ faces[:, :3].T + faces[:, 3]).max(axis=1))
