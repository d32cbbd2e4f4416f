"""The judge's view of passing: on which side the tool goes past each pushable, and how far off.

A part of :mod:`optipromp.metrics`, and like it apart from the planner: positions of the tool go in,
the figures M_p and y_g·S_n and what is wrong come out.
"""

import math

import numpy as np

from optipromp.arrays import FloatArray
from optipromp.scenes.scene import Scene, SceneObject

DECIDED = np.sin(np.deg2rad(1.0))  # a stem leans to a side when this share of it is lateral


def passing(
    scene: Scene,
    tips: FloatArray,
    rims: FloatArray,
    gripper_radius: float,
    violations: list[str],
) -> tuple[dict[str, float | None], dict[str, float | None]]:
    """M_p at the knot where the tool passes each pushable (the last passage), and y_g·S_n.

    Neither the tool point nor the rim (T, 3), which decides where a fruit ends, may pass a pushable
    on the side of its stem. Of a pushable so close under the target that the rim takes in the one
    while the tool point passes the other, the rim alone is asked.
    """
    m_p: dict[str, float | None] = {}
    projection: dict[str, float | None] = {}
    lateral, up = scene.frame[1], scene.frame[2]
    for thing in scene.pushables:
        passed = _last_passage(tips - thing.position, up)
        m_p[thing.id] = None if passed is None else float(passed @ lateral)
        if thing.stem is None:
            projection[thing.id] = None
            continue
        stem = thing.stem.points[1] - thing.stem.points[0]
        projection[thing.id] = float(lateral @ stem)
        flat = stem - (stem @ up) * up
        if math.hypot(*flat) < DECIDED * math.hypot(*stem):
            continue
        rim = _last_passage(rims - thing.position, up)
        close = _closely_under(scene, thing, float((rims[-1] - tips[-1]) @ up))
        for at in (rim,) if close else (passed, rim):
            if at is None:
                continue
            near = math.hypot(*at) < thing.radius + 2.0 * gripper_radius
            if (near or _in_the_way(scene, thing, gripper_radius)) and float(at @ flat) > 0.0:
                violations.append(f"the tool passes {thing.id} on the side of its stem")
                break
    return m_p, projection


def _closely_under(scene: Scene, thing: SceneObject, depth: float) -> bool:
    """Whether the rim, ``depth`` over the tool point, takes in the target as that passes it."""
    if scene.target is None:
        return False
    below = float((scene.target.position - thing.position) @ scene.frame[2])
    return below < depth + scene.target.radius + thing.radius


def _last_passage(off: FloatArray, up: FloatArray) -> FloatArray | None:
    """Where a path ``off`` (T, 3) is, at the knot nearest its last crossing of the level plane."""
    height = off @ up
    side = np.sign(height)
    (crossings,) = (side[:-1] != side[1:]).nonzero()
    if not len(crossings):
        return None
    before = int(crossings[-1])
    knot = before if abs(height[before]) <= abs(height[before + 1]) else before + 1
    return np.asarray(off[knot] - height[knot] * up)


def _in_the_way(scene: Scene, thing: SceneObject, gripper_radius: float) -> bool:
    """Whether a straight approach would push this pushable (method §4, 1)."""
    if scene.target is None:
        return False
    off = thing.position - scene.target.position
    along = float(off @ scene.frame[2])
    aside = math.hypot(*(off - along * scene.frame[2]))
    return -0.2 <= along < 0.0 and aside <= 1.5 * gripper_radius
