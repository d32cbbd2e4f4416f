"""Contacts with objects that move: their distances at the times of the motion.

The checks are so dense that between two of them neither body nor object moves far; half of what
they may come nearer between two checks is taken off each distance.
"""

import numpy as np

from optipromp.core.arrays import FloatArray, IntArray, lengths
from optipromp.core.compiled import inner
from optipromp.core.geometry.shapes import GRID
from optipromp.core.judging.clearance import CONFIGURATIONS, Overlap
from optipromp.core.judging.curve import along
from optipromp.core.judging.distances import measured, nearest, to_surface
from optipromp.core.judging.kinematics import MOST_CHECKS, centers
from optipromp.core.judging.parts import radii
from optipromp.core.robots.model import Robot
from optipromp.core.scenes.scene import Scene, SceneObject
from optipromp.core.trajectory import Trajectory

APART = 0.004  # [m] that an object moves between two checks, at most: a choice


def met(
    scene: Scene, robot: Robot, trajectory: Trajectory, rows: IntArray
) -> tuple[float | None, list[Overlap]]:
    """Smallest distance of any body sphere to an object that moves [m], and the contacts.

    Pairs that may touch are left out; the padding of an object is taken off its distances.
    ``rows`` (T,) are indices of the waypoints among the checks of objects that stand: there are no
    fewer checks here. None where nothing moves that is minded.
    """
    movers = [item for item in scene.objects if item.motion is not None]
    if not movers or not len(robot.spheres.radius):
        return None, []
    parts, steps = np.diff(rows), np.diff(trajectory.times)
    least, found = np.inf, []
    for item in movers:
        assert item.motion is not None
        asked = np.ceil(item.motion.fastest * steps / APART)
        share = min(1.0, MOST_CHECKS / max(float(asked.sum()), 1.0))
        times, q, _ = along(trajectory, np.maximum(parts, asked * share).astype(np.int64))
        radius = radii(scene, robot, item) + scene.padding_of(item)
        if np.isneginf(radius).all():
            continue
        gap, sphere, at = _nearest(item, robot, radius, times, np.array(q))
        least = min(least, gap)
        if gap < 0.0:
            link = str(robot.link_names[robot.spheres.link[sphere]])
            found.append(Overlap(link, item.id, item.role, -gap, float(times[at])))
    return (float(least) if np.isfinite(least) else None), found


def _nearest(
    item: SceneObject, robot: Robot, radius: FloatArray, times: FloatArray, q: FloatArray
) -> tuple[float, int, int]:
    """Smallest distance [m] at the checks, with the index of the sphere and that of the check.

    ``radius`` (B,) of the robot's spheres; minus infinity leaves a sphere out.
    """
    assert item.motion is not None
    (kind,), size, _ = measured([item.shape])
    places, counted = item.motion.at(times), np.flatnonzero(np.isfinite(radius))
    radius = radius[counted]
    best = np.inf, 0, 0
    for start in range(0, len(q), CONFIGURATIONS):
        part = slice(start, start + CONFIGURATIONS)
        spheres = centers(robot, q[part])[:, counted]
        relative = spheres - places[part, None]
        step = np.zeros(len(relative))
        if len(relative) > 1:
            step[1:] = (
                lengths(np.diff(relative, axis=0).reshape(-1, 3))
                .reshape(len(relative) - 1, -1)
                .max(axis=1)
            )
        if kind == GRID:
            gap, sphere, at = nearest(item, relative + item.position, radius, np.inf)
            gap -= 0.5 * float(step.max())
        else:
            out = np.array([np.inf, 0.0, 0.0])
            closest(kind, size[0], relative @ item.rotation, radius, 0.5 * step, out)
            gap, sphere, at = float(out[0]), int(out[1]), int(out[2])
        if gap < best[0]:
            best = gap, int(counted[sphere]), start + at
    return best


@inner
def closest(kind, size, spheres, radius, nearer, out):
    """Write distance, sphere and row of the closest of spheres (M, B, 3) to ``out`` (3,).

    The spheres are in the frame of the shape. ``nearer`` (M,) is taken off each distance [m].
    """
    for m in range(spheres.shape[0]):
        for b in range(radius.shape[0]):
            x, y, z = spheres[m, b, 0], spheres[m, b, 1], spheres[m, b, 2]
            d = to_surface(kind, size[0], size[1], size[2], x, y, z) - radius[b] - nearer[m]
            if d < out[0]:
                out[0], out[1], out[2] = d, b, m
