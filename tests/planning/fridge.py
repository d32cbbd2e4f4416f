"""An xArm7 before a fridge: a bottle behind two cups."""

from pathlib import Path

import numpy as np

from optipromp.core.geometry import Box, Cylinder
from optipromp.core.scenes import Approach, Scene, SceneObject, ToolSpec

FRONT, BACK, BOARD, WIDTH, ROOM, WALL = 0.52, 0.85, 0.40, 0.50, 0.36, 0.02  # [m] choices


def fridge(robot: str | Path) -> Scene:
    """A shelf of a fridge with an open door: a bottle behind two cups."""
    middle, deep = 0.5 * (FRONT + BACK), BACK - FRONT

    def wall(name: str, size: tuple[float, float, float], *at: float) -> SceneObject:
        return SceneObject(name, "static", Box(size), np.array(at))

    def stood(name: str, role: str, radius: float, tall: float, x: float, y: float) -> SceneObject:
        at = np.array([x, y, BOARD + 0.5 * tall])
        return SceneObject(name, role, Cylinder(radius, tall), at)  # type: ignore[arg-type]

    objects = (
        stood("bottle", "target", 0.032, 0.22, 0.70, 0.02),
        stood("cup1", "pushable", 0.038, 0.10, 0.60, -0.03),
        stood("cup2", "pushable", 0.038, 0.10, 0.61, 0.06),
        wall("shelf", (deep, WIDTH, WALL), middle, 0.0, BOARD - 0.5 * WALL),
        wall("ceiling", (deep, WIDTH, WALL), middle, 0.0, BOARD + ROOM + 0.5 * WALL),
        wall("back", (WALL, WIDTH, ROOM), BACK + 0.5 * WALL, 0.0, BOARD + 0.5 * ROOM),
        wall("left", (deep, WALL, ROOM), middle, 0.5 * (WIDTH + WALL), BOARD + 0.5 * ROOM),
        wall("right", (deep, WALL, ROOM), middle, -0.5 * (WIDTH + WALL), BOARD + 0.5 * ROOM),
        wall("door", (WALL, 0.45, 0.9), FRONT - 0.25, 0.62, BOARD),
    )
    level = Approach(np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0]))
    return Scene(
        name="fridge", robot=robot, tool=ToolSpec("franka_hand"), objects=objects, approach=level
    )
