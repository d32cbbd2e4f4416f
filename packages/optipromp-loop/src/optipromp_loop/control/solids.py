"""What stands among the fruits and nobody told, from look to look."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from optipromp.core.arrays import BoolArray, FloatArray
from optipromp.core.geometry.shapes import PointCloudShape
from optipromp.core.scenes.look import Look
from optipromp.core.scenes.objects import SceneObject
from optipromp_loop.control.belief import visible

SAME = 0.02  # [m] from a thing, within which what is seen is the thing: a choice
FEWEST = 4  # points of a thing: a choice
NOTHING = np.zeros((0, 4)), None  # hides a thing


@dataclass(frozen=True)
class Solids:
    """Things in the base frame, and how many have come.

    A thing stays until a look that should show its middle shows nothing of it.
    """

    items: tuple[SceneObject, ...] = ()
    count: int = 0

    def after(self, look: Look, seen: Sequence[SceneObject]) -> Solids:
        """The things after a look that shows some; itself where nothing came or went."""
        middles = np.array([item.position for item in self.items]).reshape(-1, 3)
        shows = visible(look, middles, np.zeros(len(middles)), np.inf, NOTHING).tolist()
        kept = [
            item
            for item, shown in zip(self.items, shows, strict=True)
            if not shown or not _apart(_points(item), seen).all()
        ]
        new = []
        for item in seen:
            points = _points(item)
            free = points[_apart(points, kept)]
            if isinstance(item.shape, PointCloudShape) and len(free) >= FEWEST:
                middle = free.mean(axis=0)
                shape = PointCloudShape(free - middle, item.shape.radius)
                new.append(replace(item, shape=shape, position=middle))
            elif len(free) == len(points):
                new.append(item)
        if not new and len(kept) == len(self.items):
            return self
        named = (replace(item, id=f"seen{self.count + k}") for k, item in enumerate(new, 1))
        return Solids((*kept, *named), self.count + len(new))


def _points(item: SceneObject) -> FloatArray:
    """Points (N, 3) of an object in the base frame [m]."""
    shape = item.shape
    points = shape.points if isinstance(shape, PointCloudShape) else shape.surface().reshape(-1, 3)
    return np.asarray(item.position + points @ item.rotation.T)


def _apart(points: FloatArray, items: Iterable[SceneObject]) -> BoolArray:
    """Whether points (N, 3) are at none of some things."""
    others = [_points(item) for item in items]
    if not others:
        return np.ones(len(points), dtype=bool)
    away, _ = cKDTree(np.concatenate(others)).query(points, distance_upper_bound=SAME)
    return np.asarray(away >= SAME)
