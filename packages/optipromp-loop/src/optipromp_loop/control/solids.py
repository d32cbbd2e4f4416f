"""What stands among the fruits and nobody told, from look to look."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import count, islice

import numpy as np
from scipy.spatial import cKDTree

from optipromp.core.arrays import BoolArray, FloatArray, lengths
from optipromp.core.geometry.shapes import PointCloudShape
from optipromp.core.optimization.problem import reach
from optipromp.core.robots.model import Robot
from optipromp.core.scenes.look import (
    BESIDE,
    FEWEST,
    Look,
    clouded,
    points_of,
    unexplained,
    with_hidden,
)
from optipromp.core.scenes.objects import SceneObject
from optipromp.core.scenes.scene import Scene
from optipromp_loop.control.tracker import Tracker

SAME = 0.02  # [m] from a thing, within which what is seen is the thing: a choice
STIRRED = 0.03  # [m] from a fruit that the tool moves, within which what is seen is it: a choice


@dataclass(frozen=True)
class Solids:
    """A scene as told, things in its base frame that nobody told, and how many have come.

    A thing has what nobody saw behind it, and stays until looks show all but :data:`FEWEST` of its
    points free.
    """

    told: Scene
    items: tuple[SceneObject, ...] = ()
    count: int = 0

    @cached_property
    def scene(self) -> Scene:
        """The scene as told, and the things."""
        return replace(self.told, objects=(*self.told.objects, *self.items))

    def after(
        self, look: Look, tracker: Tracker, robot: Robot, q: FloatArray, *, among: bool = False
    ) -> Solids:
        """The things after a look with the arm at ``q`` (n,), and fruits that are tracked;
        itself where nothing came or went.

        ``among``: whether the tool moves fruits, so that more about each is of it.
        """
        if not (look.solids or self.items):
            return self
        fruits = tracker.at(look.time).objects()
        arm = np.column_stack([robot.sphere_centers(q), robot.spheres.radius])
        given = self.told, fruits, arm, reach(robot), STIRRED if among else BESIDE
        seen, kept, new = list(unexplained(look, *given)), list[SceneObject](), list[SceneObject]()
        shown = [item.transformed(look.camera) for item in look.solids]
        for item in self.items:
            points = points_of(item)
            stays = points[~_free(look, points, [*shown, *fruits]) | ~_apart(points, seen)]
            if len(stays) == len(points):
                kept.append(item)
            elif len(stays) >= FEWEST:
                kept.append(clouded(item, stays) if _is_cloud(item) else item)
        for item in seen:
            points = points_of(item)
            rest = points[_apart(points, kept)]
            if _is_cloud(item) and len(rest) >= FEWEST:
                new.append(clouded(item, rest))
            elif len(rest) == len(points):
                new.append(item)
        if not new and all(one is other for one, other in zip(kept, self.items, strict=False)):
            return self if len(kept) == len(self.items) else replace(self, items=tuple(kept))
        taken = {item.id for item in self.told.objects}
        free = (k for k in count(self.count + 1) if f"seen{k}" not in taken)
        numbers = list(islice(free, len(new)))
        whole = zip(numbers, with_hidden(new, look, *given), strict=True)
        named = (replace(item, id=f"seen{k}") for k, item in whole)
        return Solids(self.told, (*kept, *named), max(self.count, *numbers, 0))


def _is_cloud(item: SceneObject) -> bool:
    return isinstance(item.shape, PointCloudShape)


def _apart(points: FloatArray, items: Iterable[SceneObject]) -> BoolArray:
    """Whether points (N, 3) are at none of some things."""
    others = [points_of(item) for item in items]
    if not others:
        return np.ones(len(points), dtype=bool)
    away, _ = cKDTree(np.concatenate(others)).query(points, distance_upper_bound=SAME)
    return np.asarray(away >= SAME)


def _free(look: Look, points: FloatArray, shown: Sequence[SceneObject]) -> BoolArray:
    """Whether a look shows that nothing is at points (N, 3): they are in its view, and nothing that
    it shows is before them, or at them."""
    eye, forward = look.camera.position, look.camera.rotation[:, 2]
    away = lengths(points - eye)
    ways = (points - eye) / np.maximum(away, 1e-9)[:, None]
    out = (ways @ forward >= np.cos(0.5 * look.view)) & (away >= look.near) & (away <= look.far)
    if shown:
        there = np.concatenate([points_of(item) for item in shown]) - eye
        far = lengths(there)
        angle, which = cKDTree(there / far[:, None]).query(ways)
        out &= (angle * away > SAME) | (far[which] > away + SAME)
    return np.asarray(out)
