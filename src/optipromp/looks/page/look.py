"""Where the camera of a window stands at first."""

from typing import Any

import numpy as np

from optipromp.core.arrays import FloatArray
from optipromp.core.scenes.scene import Scene

UPWARDS = 0.7  # cosine; an approach steeper than that is looked at from beyond the target
DISTANCE, FARTHER, PAIR = 0.95, 1.15, 0.7  # [m] of the camera; on a narrow screen; more for a pair
LOOK_AHEAD, LOOK_ASIDE, LOOK_BELOW = 0.10, 0.08, 0.40  # [m] from the target to what is looked at
CAMERA_LOWEST = 0.15  # [m] of the camera above the base: not under the floor
NARROW = 640  # [pixel] width of a screen on which the panel is below


def look(camera: Any, scene: Scene, beside: FloatArray | None = None) -> None:
    """Point a camera at the target: from beyond it, or from the robot's side of a shelf.

    Args:
        camera: of a client of viser.
        scene: whose target is looked at; without one, the middle of its objects.
        beside: (3,) from it to the same scene once more, if that is shown too [m].
    """
    up, (_, y, z) = scene.up, scene.frame
    middle = np.zeros(3)
    if len(scene.objects):
        middle = scene.positions.mean(axis=0) if scene.target is None else scene.target.position
    out = middle - (middle @ up) * up
    out = out / max(float(np.linalg.norm(out)), 1e-6)
    steep = z @ up > UPWARDS
    away = 0.8 * out + 0.5 * y - 0.12 * up if steep else -0.7 * z + 0.5 * y + 0.6 * up
    away = away / np.linalg.norm(away)
    if camera.image_width < NARROW:  # the panel covers the lower half there
        focus, distance = middle - LOOK_BELOW * up, FARTHER
    else:
        focus = middle - LOOK_AHEAD * z - LOOK_ASIDE * np.cross(away, up)  # and the right here
        distance = DISTANCE
    if beside is not None:
        focus, distance = focus + 0.35 * beside, distance + PAIR
    place = focus + distance * away
    place = place + max(CAMERA_LOWEST - float(place @ up), 0.0) * up
    camera.up_direction = (0.0, 0.0, 1.0)
    camera.position = scene.base @ place
    camera.look_at = scene.base @ focus
