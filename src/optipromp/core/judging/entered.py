"""Penetration of the tool or the last link into the target, a pushable or a stem.

Tool and last link may touch all of these during a motion. No motion may begin inside of one.
"""

from collections.abc import Mapping
from itertools import product

import numpy as np

from optipromp.core.arrays import FloatArray, lengths
from optipromp.core.geometry.shapes import GRID
from optipromp.core.judging.clearance import Overlap, enter, swept
from optipromp.core.judging.distances import Objects, measured, nearest
from optipromp.core.judging.kinematics import centers
from optipromp.core.judging.parts import pieces
from optipromp.core.robots.model import Robot
from optipromp.core.scenes.scene import Scene, SceneObject

BRUSHED = 0.005  # [m] depth that does not count: spheres stand out of a cup's wall by 4.5 mm


def touching(scene: Scene, robot: Robot, q: FloatArray, *, begun: bool = False) -> list[Overlap]:
    """Contacts that no motion may begin with, at ``q`` (n,).

    A motion that continues one that ran (``begun``) may begin inside of targets and pushables.
    Objects that move are where they are at time 0.
    """
    scene = scene.standing({item.id: 0.0 for item, _ in scene.movers})
    _, contacts, points, axes = swept(scene, robot, q[None])
    return [*contacts, *([] if begun else entered(scene, robot, q, points[0], axes[0]))]


def entered(
    scene: Scene, robot: Robot, q: FloatArray, point: FloatArray, axis: FloatArray
) -> list[Overlap]:
    """Penetrations of the tool or the last link into the target or a pushable.

    An object in the tool's mouth, or before the mouth, does not touch the tool. Depths up to
    :data:`BRUSHED` do not count.

    ``scene``: with the objects. ``robot``: with the scene's tool. ``q``: (n,) configuration.
    ``point``, ``axis``: (3,) tool point [m] and tool axis at ``q``.
    """
    distal = np.flatnonzero(robot.spheres.distal)
    if not len(distal):
        return []
    spheres, radius = centers(robot, q[None])[:, distal], np.asarray(robot.spheres.radius)[distal]
    middle = spheres[0].mean(axis=0)
    reach = float((lengths(spheres[0] - middle) + radius).max())
    rows = np.concatenate([scene.rows("target"), scene.rows("pushable")])
    near = lengths(scene.positions[rows] - middle) < scene.bounds[rows] + reach
    link, out = np.asarray(robot.spheres.link)[distal], []
    for item in scene.objects_at(rows[near]):
        for one in np.unique(link):
            if one == link.max() and _in_mouth(robot, item, point, axis):
                continue
            if scene.may_meet(str(robot.link_names[one]), item.id):
                continue
            depth = _depth(item, spheres[:, link == one], radius[link == one])
            if depth > BRUSHED:
                out.append(Overlap(str(robot.link_names[one]), item.id, item.role, depth, 0.0))
    return out


def struck(
    scene: Scene, robot: Robot, q: FloatArray, by: Mapping[str, FloatArray]
) -> Overlap | None:
    """The deepest penetration of the tool or the last link into a target, a pushable or a stem.

    It is the deepest over configurations ``q`` (M, n); None where none exceeds :data:`BRUSHED`.
    ``by``: displacements (M, 3) or more from its place of each object that moves, by id [m].
    """
    distal = np.flatnonzero(robot.spheres.distal)
    if not len(distal):
        return None
    spheres, radius = centers(robot, q)[:, distal], np.asarray(robot.spheres.radius)[distal]
    link, found = np.asarray(robot.spheres.link)[distal], list[Overlap]()
    rows = np.concatenate([scene.rows("target"), scene.rows("pushable")])
    for item, one in product(scene.objects_at(rows), np.unique(link)):
        name, mine = str(robot.link_names[one]), (spheres[:, link == one], radius[link == one])
        if scene.may_meet(name, item.id):
            continue
        if item.id in by:
            mine = mine[0] - by[item.id][: len(q), None], mine[1]
        found.append(Overlap(name, item.id, item.role, _depth(item, *mine)))
        for piece in () if item.stem is None else pieces(item, item.stem):
            told = f"the stem of {item.id}"
            found.append(Overlap(name, told, item.role, _depth(piece, *mine)))
    deepest = max(found, key=lambda overlap: overlap.depth, default=None)
    return None if deepest is None or deepest.depth <= BRUSHED else deepest


def _in_mouth(robot: Robot, item: SceneObject, point: FloatArray, axis: FloatArray) -> bool:
    """Whether an object is in the tool's mouth or before it.

    The smallest half size of the object decides whether it fits.
    """
    tool = robot.tool
    if tool is None:
        return False
    off = item.position - point
    height = float(off @ axis)
    aside = float(np.linalg.norm(off - height * axis))
    _, size, _ = measured([item.shape])
    thin = float(size.min(where=size > 0.0, initial=np.inf)) if size.any() else 0.0
    return height > tool.front - tool.reach and aside + thin < tool.mouth[0] + BRUSHED


def _depth(item: SceneObject, spheres: FloatArray, radius: FloatArray) -> float:
    """Largest depth [m] of spheres (M, B, 3) in an object; at most 0 where none touches it."""
    kind, size, bound = measured([item.shape])
    if kind[0] == GRID:
        return -nearest(item, spheres, radius, 0.0)[0]
    none, found = np.zeros(1, dtype=np.int64), np.zeros(3)
    alone = Objects(
        none, kind, none, np.array([item.position]), np.array([item.rotation]), size, bound, none,
        np.zeros((0, 3)), np.zeros(0),
    )  # fmt: skip
    enter(alone, 0, spheres, radius, np.ones(len(radius), dtype=np.bool_), found)
    return float(found[0])
