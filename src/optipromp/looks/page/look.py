"""The first place of a window's camera."""

from typing import Any

import numpy as np

from optipromp.core.arrays import FloatArray
from optipromp.core.scenes.scene import Scene

# choices for the eye
UPWARDS = 0.7  # cosine to the vertical of an approach above which the camera is beyond the target
DISTANCE, FARTHER = 0.95, 1.15  # [m] of the camera from its focus; on a narrow screen
PAIR = 0.7  # [m] more distance for two scenes side by side
LOOK_AHEAD, LOOK_ASIDE, LOOK_BELOW = 0.10, 0.08, 0.40  # [m] from the target to the focus
CAMERA_LOWEST = 0.15  # [m] height of the camera over the base, at least
NARROW = 640  # [pixel] width of a screen below which the panel is under the picture


def look(camera: Any, scene: Scene, beside: FloatArray | None = None) -> None:
    """Point a camera at the target: from beyond it, or from the robot's side of a shelf.

    Args:
        camera: of a client of viser.
        scene: with the target; without one, the camera points at the mean of its objects.
        beside: (3,) offset of the same scene, where it is shown a second time [m].
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
    if camera.image_width < NARROW:  # the panel covers the lower half
        focus, distance = middle - LOOK_BELOW * up, FARTHER
    else:
        focus = middle - LOOK_AHEAD * z - LOOK_ASIDE * np.cross(away, up)  # it covers the right
        distance = DISTANCE
    if beside is not None:
        focus, distance = focus + 0.35 * beside, distance + PAIR
    place = focus + distance * away
    place = place + max(CAMERA_LOWEST - float(place @ up), 0.0) * up
    camera.up_direction = (0.0, 0.0, 1.0)
    camera.position = scene.base @ place
    camera.look_at = scene.base @ focus
