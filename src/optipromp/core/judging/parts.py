"""The contacts that the judge minds: without pairs that may touch, with the padding of objects."""

import functools
from collections.abc import Collection
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from optipromp.core.arrays import BoolArray, FloatArray
from optipromp.core.robots.model import BodySpheres, Robot
from optipromp.core.scenes.rotations import to_quaternion
from optipromp.core.scenes.scene import Scene, SceneObject, Stem


class BodyPart(NamedTuple):
    """Objects that a scene treats alike, and the robot that must not touch them."""

    robot: Robot  # without links that may touch the objects; its spheres are larger by the padding
    rows: frozenset[int] | None  # indices of the objects in the scene; None: all objects


@functools.lru_cache(maxsize=8)
def parts_of(scene: Scene, robot: Robot) -> tuple[BodyPart, ...]:
    """The parts of a scene. The first has the whole robot, with its pairs of spheres."""
    if scene.touches_alike:
        return (BodyPart(robot, None),)
    groups: dict[tuple[frozenset[str], float], list[int]] = {(frozenset(), 0.0): []}
    for row, item in enumerate(scene.objects):
        key = spared(scene, robot, item), scene.padding_of(item)
        groups.setdefault(key, []).append(row)
    out = []
    for (links, padding), rows in groups.items():
        if not links and not padding:
            out.append(BodyPart(robot, frozenset(rows)))
            continue
        kept = _without(robot, links, padding)
        if len(kept.spheres.radius):
            out.append(BodyPart(kept, frozenset(rows)))
    return tuple(out)


def spared(scene: Scene, robot: Robot, item: SceneObject) -> frozenset[str]:
    """The links that may touch an object and its stem."""
    if not scene.may_touch:
        return frozenset()
    return frozenset(name for name in robot.link_names if scene.may_meet(name, item.id))


def pieces(item: SceneObject, stem: Stem) -> list[SceneObject]:
    """The straight pieces of a ``stem`` of ``item``, as objects that stand."""
    return [
        replace(item, shape=shape, position=middle, orientation=to_quaternion(turn), stem=None,
                motion=None)
        for shape, middle, turn in stem.pieces()
    ]  # fmt: skip


def radii(scene: Scene, robot: Robot, item: SceneObject) -> FloatArray:
    """Radii (B,) of the robot's spheres [m], minus infinity where they may touch an object."""
    radius, links = np.array(robot.spheres.radius), spared(scene, robot, item)
    if links:
        radius[_of(robot, links)] = -np.inf
    return radius


def _of(robot: Robot, links: Collection[str]) -> BoolArray:
    indices = [k for k, name in enumerate(robot.link_names) if name in links]
    return np.isin(robot.spheres.link, indices)


@functools.lru_cache(maxsize=32)
def _without(robot: Robot, links: frozenset[str], padding: float) -> Robot:
    return of_spheres(robot, ~_of(robot, links), padding)


def of_spheres(robot: Robot, kept: BoolArray, padding: float = 0.0) -> Robot:
    """The robot of the spheres ``kept`` (B,), larger by ``padding`` [m], without pairs of them."""
    spheres = BodySpheres._make(part[kept] for part in robot.spheres)
    spheres = spheres._replace(radius=spheres.radius + padding)
    pairs = np.zeros((0, 2), dtype=np.int64)
    return replace(robot, spheres=spheres, self_pairs=pairs, self_slack=np.zeros(0))
