"""Which pushables stand in the way, and in which order the tool meets them (method §4, 1 and 2)."""

import math

import numpy as np

from optipromp.scenes.scene import Scene, SceneObject

SEARCH_RADIUS = 0.2  # [m]
PLANE_FACTOR = 1.5  # D_plane = PLANE_FACTOR · R_gripper
UNSURE = 2.0  # deviations of a detection by which a pushable may be farther from the approach line


def neighbours(
    scene: Scene,
    gripper_radius: float,
    *,
    search_radius: float = SEARCH_RADIUS,
    plane_factor: float = PLANE_FACTOR,
) -> tuple[SceneObject, ...]:
    """Pushables before the target along z_g and near the approach line, first met first.

    Args:
        scene: with a target; a scene with a goal in its place has no neighbours.
        gripper_radius: R_gripper [m].
        search_radius: how far from the target a neighbour may be [m].
        plane_factor: D_plane in gripper radii, the largest distance from the approach line.

    Where target or pushable carry a covariance, the largest distance from the approach line grows
    by :data:`UNSURE` deviations of their distance.

    Returns:
        The neighbours by position along z_g; ties by nearness to the target.
    """
    target = scene.target
    if target is None:
        return ()
    x_g, y_g, z_g = scene.frame
    found = []
    for thing in scene.things(scene.around(target.position, search_radius, "pushable")):
        off = thing.position - target.position
        along = float(off @ z_g)
        aside = math.hypot(off @ x_g, off @ y_g)
        distance = math.hypot(*off)
        doubt = math.sqrt(detection_variance(target) + detection_variance(thing))
        wide = plane_factor * gripper_radius + UNSURE * doubt
        if along < 0.0 and distance <= search_radius and aside <= wide:
            found.append((along, distance, thing.id, thing))
    return tuple(thing for *_, thing in sorted(found, key=lambda f: f[:3]))


def detection_variance(thing: SceneObject) -> float:
    """Mean variance of an object's detected position [m²]; 0 where the scene gives none."""
    return 0.0 if thing.covariance is None else float(np.trace(thing.covariance)) / 3.0
