"""Objects from which the body keeps other distances: padded ones, and those that it may touch.

The *room* (L, K) of L links and K objects is the distance that a link keeps from an object beyond
contact [m]: the padding, or minus infinity where the two may touch.
"""

import functools
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from optipromp.core.arrays import BoolArray, FloatArray, IntArray, read_only
from optipromp.core.geometry.obstacles import Obstacles
from optipromp.core.optimization.evaluation import BodyPoints
from optipromp.core.optimization.problem import Special
from optipromp.core.robots.model import Robot
from optipromp.core.scenes.scene import Scene


def rooms(scene: Scene, robot: Robot, rows: IntArray) -> FloatArray:
    """The room (L, K) of the links with spheres from the objects in ``rows`` (K,)."""
    links = [robot.link_names[k] for k in np.unique(robot.spheres.link)]
    out = np.zeros((len(links), len(rows)))
    for column, item in enumerate(scene.objects_at(rows)):
        out[:, column] = scene.padding_of(item)
        if scene.may_touch:
            spared = [scene.may_meet(name, item.id) for name in links]
            out[spared, column] = -np.inf
    return out


def is_special(scene: Scene, robot: Robot, rows: IntArray) -> BoolArray:
    """Which of the objects in ``rows`` (K,) have a room that is not 0."""
    if scene.touches_alike:
        return np.zeros(len(rows), dtype=np.bool_)
    return np.asarray(rooms(scene, robot, rows).any(axis=0))


def specials(
    scene: Scene, robot: Robot, body: BodyPoints, static: IntArray, dynamic: tuple[IntArray, int]
) -> Iterator[Special]:
    """The special obstacles of the optimisation, by rooms that are alike.

    ``scene``: of the objects. ``robot``: of the links. ``body``: of the robot. ``static``: rows of
    special static objects. ``dynamic``: rows of special objects to avoid and then to push, and the
    number of the first.
    """
    sizes = np.diff(body.link_start)
    for name, rows, shared in (("static", static, len(static)), ("dynamic", *dynamic)):
        room = rooms(scene, robot, rows)
        for column in np.unique(room, axis=1).T:
            mine = (room == column[:, None]).all(axis=0)
            yield Special(
                name, scene.packed(rows[mine]), int(mine[:shared].sum()),
                read_only(body.radius + np.repeat(column, sizes)),
                read_only(body.link_bound + column),
            )  # fmt: skip


class RoomApart(NamedTuple):
    """All special obstacles: static ones, then those to avoid, then those to push.

    ``room`` (L, K) is minus infinity also between the last link or the tool and all that is not
    static.
    """

    obstacles: Obstacles
    room: FloatArray


@functools.lru_cache(maxsize=4)
def apart(scene: Scene, robot: Robot, far: float) -> RoomApart:
    """The special obstacles within ``far`` [m] of the base, for the search of ways."""
    found = [scene.around(np.zeros(3), far, role) for role in ("static", "avoid", "pushable")]
    kept = [rows[is_special(scene, robot, rows)] for rows in found]
    rows = np.concatenate(kept)
    room = rooms(scene, robot, rows)
    links = np.unique(robot.spheres.link)
    distal = np.isin(links, robot.spheres.link[robot.spheres.distal])
    role = np.repeat(np.arange(3), [len(one) for one in kept])
    room[np.ix_(distal, role > 0)] = -np.inf
    return RoomApart(scene.packed(rows), np.ascontiguousarray(room))
