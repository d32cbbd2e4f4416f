"""Contacts with objects that move: their distances at the times of the motion.

The checks are so dense that between two of them neither body nor object moves far; half of what
they may come nearer between two checks is taken off each distance.
"""

from collections.abc import Iterator

import numpy as np

from optipromp.core.arrays import BoolArray, FloatArray, IntArray, lengths
from optipromp.core.compiled import inner
from optipromp.core.geometry.shapes import GRID
from optipromp.core.judging.clearance import CONFIGURATIONS, Overlap
from optipromp.core.judging.curve import along
from optipromp.core.judging.distances import measured, nearest, to_surface
from optipromp.core.judging.kinematics import MOST_CHECKS, centers
from optipromp.core.judging.parts import pieces, radii
from optipromp.core.robots.model import Robot
from optipromp.core.scenes.scene import Scene, SceneObject
from optipromp.core.trajectory import Trajectory

APART = 0.004  # [m] that an object moves between two checks, at most: a choice
BY_TOOL = "clearance_avoid_tool"


def _asked(
    item: SceneObject, distal: BoolArray
) -> Iterator[tuple[list[SceneObject], str, BoolArray, str]]:
    """What an object's role asks for; every stem is to be avoided by the arm (B_d).

    Parts as objects that stand, their name, the spheres (B,) that are measured against them, and
    the metric of the distance, "" for none.
    """
    metric = f"clearance_{item.role}"
    yield [item], item.id, ~distal if item.role != "static" else np.ones_like(distal), metric
    if item.role == "avoid":
        yield [item], item.id, distal, BY_TOOL
    if item.stem is not None:
        stems = [piece for one in item.stem.likely() for piece in pieces(item, one)]
        yield stems, f"the stem of {item.id}", ~distal, ""


def met(
    scene: Scene, robot: Robot, trajectory: Trajectory, rows: IntArray
) -> tuple[dict[str, float], list[Overlap]]:
    """Smallest distances to objects that move [m], by the name of the metric, and the contacts.

    Which links must not touch an object depends on its role, as for those that stand. Pairs that
    may touch are left out; the padding of an object is taken off its distances. ``rows`` (T,) are
    indices of the waypoints among the checks of objects that stand: there are no fewer checks here.
    """
    least, found = dict[str, float](), list[Overlap]()
    parts, steps = np.diff(rows), np.diff(trajectory.times)
    distal = np.asarray(robot.spheres.distal, dtype=np.bool_)
    for item, course in scene.movers if len(distal) else ():
        asked = np.ceil(course.fastest * steps / APART)
        share = min(1.0, MOST_CHECKS / max(float(asked.sum()), 1.0))
        times, q, _ = along(trajectory, np.maximum(parts, asked * share).astype(np.int64))
        radius, places = radii(scene, robot, item) + scene.padding_of(item), course.at(times)
        for objects, name, counted, metric in _asked(item, distal):
            own = np.where(counted, radius, -np.inf)
            if np.isneginf(own).all():
                continue
            gap, sphere, at = min(
                _nearest(part, robot, own, places + (part.position - item.position), np.array(q))
                for part in objects
            )
            if metric:
                least[metric] = min(least.get(metric, np.inf), float(gap))
            if gap < 0.0 and metric != BY_TOOL:  # which is allowed
                link = str(robot.link_names[robot.spheres.link[sphere]])
                found.append(Overlap(link, name, item.role, -gap, float(times[at])))
    return least, found


def _nearest(
    item: SceneObject, robot: Robot, radius: FloatArray, places: FloatArray, q: FloatArray
) -> tuple[float, int, int]:
    """Smallest distance [m] at the checks, with the index of the sphere and that of the check.

    ``radius`` (B,) of the robot's spheres; minus infinity leaves a sphere out. ``places`` (M, 3) of
    the object at the checks [m].
    """
    (kind,), size, _ = measured([item.shape])
    counted = np.flatnonzero(np.isfinite(radius))
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
