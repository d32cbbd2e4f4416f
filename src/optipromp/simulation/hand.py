"""The open Franka hand as a MuJoCo body, and what is between its fingers."""

from typing import Any

import numpy as np

from optipromp.arrays import BoolArray, FloatArray
from optipromp.robots.tools import PADS, FrankaHand
from optipromp.simulation.engine import engine
from optipromp.simulation.solids import quaternion

PALM_COLOUR = (0.90, 0.90, 0.91, 1.0)
FINGER_COLOUR = (0.30, 0.32, 0.35, 1.0)


def add_hand(body: Any, hand: FrankaHand, mass: float, **surface: Any) -> None:
    """Add palm and open fingers to ``body``, whose frame is the flange's.

    Args:
        body: of the tool.
        hand: which opening it has.
        mass: of all of it, as if in the palm [kg].
        surface: properties of every geom.
    """
    mujoco = engine()
    turned = hand.rotation
    boxes = hand.boxes()
    _, middle, half, _ = boxes[0]
    a, b, c = (half**2).tolist()
    inertia = turned @ np.diag(mass / 3.0 * np.array([b + c, a + c, a + b])) @ turned.T
    i = inertia
    body.explicitinertial = True
    body.mass, body.ipos = mass, turned @ middle
    body.fullinertia = [i[0, 0], i[1, 1], i[2, 2], i[0, 1], i[0, 2], i[1, 2]]
    for name, center, edges, turn in boxes:
        c, s = np.cos(turn), np.sin(turn)
        about = np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])
        body.add_geom(
            name=f"hand:{name}", type=mujoco.mjtGeom.mjGEOM_BOX, size=edges, pos=turned @ center,
            quat=quaternion(turned @ about),
            rgba=PALM_COLOUR if name == "palm" else FINGER_COLOUR, **surface,
        )  # fmt: skip


def between_fingers(hand: FrankaHand, local: FloatArray) -> BoolArray:
    """Whether points are between the open fingers, where closing them takes hold.

    That is: across, between the pads; in height, no farther from their middle than the pads are
    high; along the hand, from the palm to the finger tips.

    Args:
        hand: which opening it has.
        local: (R, 3) in the hand's axes, from the tool point [m].

    Returns:
        (R,).
    """
    x, y, z = local.T
    inside: BoolArray = (
        (np.abs(y) < hand.gripper_radius)
        & (np.abs(x) <= PADS[3])
        & (z > hand.front - hand.reach)
        & (z <= hand.tip - hand.reach)
    )
    return inside
