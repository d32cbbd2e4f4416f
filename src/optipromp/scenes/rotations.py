"""Quaternions (wxyz) and rotation matrices."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from optipromp.arrays import FloatArray, frozen
from optipromp.errors import InvalidSceneError

_TOLERANCE = 1e-3


def from_quaternion(wxyz: Sequence[float]) -> FloatArray:
    """Rotation matrix (3, 3) of a unit quaternion; normalised where within 1e-3 of unit length.

    Raises:
        InvalidSceneError: the length is farther off.
    """
    length = math.hypot(*wxyz)
    if abs(length - 1.0) > _TOLERANCE:
        raise InvalidSceneError(
            f"orientation {list(wxyz)} has length {length:.6g}: "
            "must be a unit quaternion w, x, y, z"
        )
    w, x, y, z = (value / length for value in wxyz)
    return frozen(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def to_quaternion(rotation: FloatArray) -> FloatArray:
    """Unit quaternion (4,) w, x, y, z with w >= 0 of a rotation matrix (3, 3).

    The eigenvector of the largest eigenvalue of Bar-Itzhack's symmetric matrix (J. Guidance 2000):
    no branches, and no loss of digits anywhere.
    """
    (a, b, c), (d, e, f), (g, h, i) = rotation
    matrix = np.array(
        [
            [a + e + i, h - f, c - g, d - b],
            [h - f, a - e - i, b + d, c + g],
            [c - g, b + d, e - a - i, f + h],
            [d - b, c + g, f + h, i - a - e],
        ]
    )
    quaternion = np.linalg.eigh(matrix)[1][:, -1]
    return frozen(-quaternion if quaternion[0] < 0.0 else quaternion)
