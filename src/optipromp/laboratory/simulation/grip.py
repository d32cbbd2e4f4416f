"""The weld with which a tool holds what it has picked."""

from typing import Any

from optipromp.core.robots.model import Robot
from optipromp.core.scenes.scene import Scene
from optipromp.laboratory.simulation.engine import engine

GRIP = "grip"
"""Name of the weld between the tool and the target; it holds from the pick to the release."""


def add_grip(spec: Any, scene: Scene, robot: Robot) -> None:
    """Add the weld, which does not hold yet, after those of the stems; for a scene with a place."""
    mujoco = engine()
    if scene.place is None or robot.tool is None or scene.target is None:
        return
    spec.add_equality(
        name=GRIP, type=mujoco.mjtEq.mjEQ_WELD, objtype=mujoco.mjtObj.mjOBJ_BODY, name1="tool",
        name2=f"fruit:{scene.target.id}", active=False,
    )  # fmt: skip
