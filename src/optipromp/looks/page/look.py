"""The first place of a window's camera: it frames what is to be picked, its neighbours, the tool.

The controls hide a part of the picture (on the right; on a narrow screen, below). The camera stands
as near as it can while everything framed is in the free part.
"""

from typing import Any

import numpy as np

from optipromp.core.arrays import FloatArray
from optipromp.core.scenes.scene import Scene

# choices for the eye
UPWARDS = 0.7  # cosine to the vertical of an approach above which the camera is beyond the target
NEAREST = 0.30  # [m] from the camera to the nearest thing framed, at least
TOOL = 0.07  # [m] radius of the ball around the tool point that is framed
CAMERA_LOWEST = 0.15  # [m] height of the camera over the base, at least
MARGIN = 0.10  # share of half the picture that is kept free at each edge
RAISED, RAISES = 0.15, 12  # step by which a camera too low is turned up, and most steps
PANEL = 400  # [pixel] of the width that the controls hide at the right
NARROW = 576  # [pixel] width of a screen up to which they are below: viser's 36 em
SHEET = 0.50  # share of the height that they hide then, see :mod:`optipromp.looks.page.panel`


def look(
    camera: Any, scene: Scene, tool: FloatArray | None = None, beside: FloatArray | None = None
) -> None:
    """Frame target, pushables, tool: from beyond the target, or from the robot's side of a shelf.

    ``camera``: of a client of viser. ``scene``: of the target and the pushables; without any, all
    its objects are framed. ``tool``: (3,) tool point in the base frame [m]; None: only the objects
    are framed. ``beside``: (3,) offset of the same scene, where it is shown a second time [m].
    """
    centres, radii = balls(scene, tool)
    if beside is not None:
        centres, radii = np.concatenate([centres, centres + beside]), np.tile(radii, 2)
    edges = free(camera.image_width, camera.image_height, camera.fov)
    away = direction(scene)
    for _ in range(RAISES):
        place, focus = framed(centres, radii, away, scene.up, edges)
        if place @ scene.up >= CAMERA_LOWEST:
            break
        away = away + RAISED * scene.up
        away = away / np.linalg.norm(away)
    camera.up_direction = (0.0, 0.0, 1.0)
    camera.position = scene.base @ place
    camera.look_at = scene.base @ focus


def balls(scene: Scene, tool: FloatArray | None = None) -> tuple[FloatArray, FloatArray]:
    """Centres (k, 3) and radii (k,) [m] framed: target, pushables, nodes of a truss, tool."""
    items = [item for item in scene.objects if item.role in ("target", "pushable")]
    items = items or [item for item in scene.objects if np.isfinite(item.radius)]
    found = [(item.position, float(item.radius)) for item in items]
    stems = [item.stem for item in items if item.stem is not None]
    found += [(stem.root, stem.radius) for stem in stems if stem.parent is not None]
    if tool is not None:
        found.append((np.asarray(tool), TOOL))
    found = found or [(np.zeros(3), 0.5)]  # [m] an empty scene: around the base
    return np.array([centre for centre, _ in found]), np.array([radius for _, radius in found])


def direction(scene: Scene) -> FloatArray:
    """The unit vector (3,) from the cluster to the camera, in the base frame."""
    up, (_, y, z) = scene.up, scene.frame
    middle = balls(scene)[0].mean(axis=0) if scene.target is None else scene.target.position
    out = middle - (middle @ up) * up
    out = out / max(float(np.linalg.norm(out)), 1e-6)
    steep = z @ up > UPWARDS
    away = 0.8 * out + 0.5 * y - 0.12 * up if steep else -0.7 * z + 0.5 * y + 0.6 * up
    return np.asarray(away / np.linalg.norm(away))


def free(width: int, height: int, fov: float) -> FloatArray:
    """Edges (2, 2) of the free part of a picture, right and up: tangents of angles to the axis.

    ``width``, ``height``: of the picture [pixel]. ``fov``: angle of the whole height [rad].
    """
    low, high = np.array([-1.0, -1.0]), np.array([1.0, 1.0])
    if width <= NARROW:
        low[1] += 2.0 * SHEET
    else:
        high[0] -= 2.0 * PANEL / width
    half = np.tan(0.5 * fov) * np.array([width / height, 1.0])
    return np.asarray(np.stack([low + MARGIN, high - MARGIN], axis=1) * half[:, None])


def framed(
    centres: FloatArray, radii: FloatArray, away: FloatArray, up: FloatArray, edges: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Position (3,) of the camera, and its focus (3,) on its axis, that frame balls.

    A ball is in the picture if its centre is at least its radius from the four planes through the
    camera and the edges. These conditions are linear in the camera's position, so the nearest
    position along ``away`` is exact.

    ``centres``, ``radii``: (k, 3) and (k,) of the balls [m]. ``away``: (3,) unit vector from the
    balls to the camera. ``up``: (3,) unit vector that is upright in the picture. ``edges``: (2, 2)
    of :func:`free`.
    """
    forward = -away
    right = np.cross(forward, up)
    right = right / np.linalg.norm(right)
    axes = np.stack([right, np.cross(right, forward)])
    along, depth = centres @ axes.T, centres @ forward
    slant = np.sqrt(1.0 + edges**2)
    most = (along - edges[:, 0] * depth[:, None] - slant[:, 0] * radii[:, None]).min(axis=0)
    least = (along - edges[:, 1] * depth[:, None] + slant[:, 1] * radii[:, None]).max(axis=0)
    near = float((depth - radii).min()) - NEAREST
    at = min(float(((most - least) / (edges[:, 1] - edges[:, 0])).min()), near)
    aside = 0.5 * (most + edges[:, 0] * at + least + edges[:, 1] * at)
    place = aside @ axes + at * forward
    return np.asarray(place), np.asarray(place + (float(depth.mean()) - at) * forward)
