"""Which moving link comes nearest to a static object."""

import functools
from dataclasses import replace

import numpy as np

from optipromp.core.arrays import FloatArray
from optipromp.core.judging.advancement import advance
from optipromp.core.judging.clearance import Overlap
from optipromp.core.judging.distances import STATIC, STEM, names_of, nearest, objects_of
from optipromp.core.judging.kinematics import body_of, centers
from optipromp.core.judging.parts import parts_of
from optipromp.core.robots.model import BodySpheres, Robot
from optipromp.core.scenes.scene import Scene


def nearest_static(
    scene: Scene, robot: Robot, q: FloatArray, times: FloatArray | None = None
) -> Overlap | None:
    """The moving link that comes nearest to a static object over configurations ``q`` (M, n).

    The depth is minus the distance [m]: negative where link and object are apart. Links of a fixed
    base do not count: no motion changes their distance. None where no object is static or no link
    moves.
    """
    q, unused = np.array(q, dtype=np.float64, order="C"), np.empty((len(q), 3))
    found: list[tuple[float, int, int, tuple[str, str]]] = []
    for part in parts_of(scene, robot):
        mine, (objects, rest) = _moving(part.robot), objects_of(scene, part.rows)
        if not scene.static or not len(mine.spheres.radius):
            continue
        body, count = body_of(mine), len(objects.kind)
        depth, deepest = np.full(count, np.inf), np.zeros((2, count), dtype=np.int64)
        advance(
            body, objects, q, unused, unused, np.full(STEM + 1, np.inf), np.full(1, np.inf), depth,
            deepest, np.full(4, np.inf),
        )  # fmt: skip
        depth[objects.role != STATIC] = np.inf
        if count and np.isfinite(depth.min()):
            k = int(np.argmin(depth))
            (named,) = names_of(scene, objects.rows[k : k + 1])
            link = int(mine.spheres.link[body.original[deepest[0, k]]])
            found.append((float(depth[k]), link, int(deepest[1, k]), named))
        radius = np.array(mine.spheres.radius)
        for item in rest:
            if item.role == "static":
                d, sphere, at = nearest(item, centers(mine, q), radius, np.inf)
                found.append((d, int(mine.spheres.link[sphere]), at, (item.id, item.role)))
    if not found:
        return None
    d, which, at, named = min(found)
    time = None if times is None else float(times[at])
    return Overlap(str(robot.link_names[which]), *named, -d, time)


@functools.lru_cache(maxsize=16)
def _moving(robot: Robot) -> Robot:
    """The robot without the spheres of its fixed base, and without pairs of spheres."""
    moving = np.asarray(robot.spheres.segment) >= 0
    spheres = BodySpheres._make(part[moving] for part in robot.spheres)
    pairs = np.zeros((0, 2), dtype=np.int64)
    return replace(robot, spheres=spheres, self_pairs=pairs, self_slack=np.zeros(0))
