"""Surroundings and a motion that the tests of the functionals share."""

from typing import Any

import numpy as np

from optipromp.core.geometry import pack
from optipromp.core.optimization.problem import Surroundings

EMPTY = pack([])
NOTHING = Surroundings(EMPTY, EMPTY, 0)


def reach(panda: Any, z: np.ndarray) -> np.ndarray:
    """A smooth motion of the Panda as a function of time in [0, 1]."""
    home = panda.robot.home
    a = np.array([0.5, -0.3, 0.4, 0.35, -0.4, 0.3, 0.2])
    b = np.array([0.2, 0.25, -0.3, 0.1, 0.3, -0.2, 0.4])
    z = np.asarray(z)[..., None]
    return np.asarray(home + a * z + b * np.sin(2.2 * z))
