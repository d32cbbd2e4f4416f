"""What stands among the fruits and nobody told, from look to look."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import count, islice

import numpy as np
from scipy.spatial import cKDTree

from optipromp.core.arrays import BoolArray, FloatArray
from optipromp.core.geometry.shapes import PointCloudShape
from optipromp.core.optimization.problem import reach
from optipromp.core.robots.model import Robot
from optipromp.core.scenes.look import Look, unexplained
from optipromp.core.scenes.objects import SceneObject
from optipromp.core.scenes.scene import Scene
from optipromp_loop.control.belief import visible
from optipromp_loop.control.tracker import Tracker

SAME = 0.02  # [m] from a thing, within which what is seen is the thing: a choice
FEWEST = 4  # points of a thing: a choice
NOTHING = np.zeros((0, 4)), None  # hides a thing


@dataclass(frozen=True)
class Solids:
    """A scene as told, things in its base frame that nobody told, and how many have come.

    A thing stays until a look that should show its middle shows nothing of it.
    """

    told: Scene
    items: tuple[SceneObject, ...] = ()
    count: int = 0

    @cached_property
    def scene(self) -> Scene:
        """The scene as told, and the things."""
        return replace(self.told, objects=(*self.told.objects, *self.items))

    def after(self, look: Look, fruits: Tracker, robot: Robot, q: FloatArray) -> Solids:
        """The things after a look with the arm at ``q`` (n,), and ``fruits`` that are tracked;
        itself where nothing came or went."""
        if not (look.solids or self.items):
            return self
        arm = np.column_stack([robot.sphere_centers(q), robot.spheres.radius])
        seen = list(unexplained(look, self.told, fruits.at(look.time).objects(), arm, reach(robot)))
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
            rest = points[_apart(points, kept)]
            if isinstance(item.shape, PointCloudShape) and len(rest) >= FEWEST:
                middle = rest.mean(axis=0)
                shape = PointCloudShape(rest - middle, item.shape.radius)
                new.append(replace(item, shape=shape, position=middle))
            elif len(rest) == len(points):
                new.append(item)
        if not new and len(kept) == len(self.items):
            return self
        taken = {item.id for item in self.told.objects}
        free = (k for k in count(self.count + 1) if f"seen{k}" not in taken)
        numbers = list(islice(free, len(new)))
        named = (replace(item, id=f"seen{k}") for k, item in zip(numbers, new, strict=True))
        return Solids(self.told, (*kept, *named), max(self.count, *numbers, 0))


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
