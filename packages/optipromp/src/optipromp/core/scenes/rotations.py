"""Quaternions (wxyz) and rotation matrices."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from optipromp.core.arrays import FloatArray, frozen
from optipromp.core.errors import InvalidSceneError
from optipromp.core.values import array

IDENTITY = frozen([1.0, 0.0, 0.0, 0.0])  # the quaternion of the identity

_TOLERANCE = 1e-3  # [-] chosen: largest error of a length or of an orthogonality
_NORMALISED = 4e-16  # [-] largest rounding error of the length of a normalised quaternion
_EYE = frozen(np.eye(3))


def unit_quaternion(values: ArrayLike) -> FloatArray:
    """Unit quaternion (4,) of a quaternion ``w, x, y, z`` or of a rotation matrix (3, 3).

    A quaternion of a length within 1e-3 of 1 is normalised and keeps its sign. A normalised
    quaternion is returned unchanged, to the bit.
    """
    if values is IDENTITY:
        return IDENTITY
    if np.shape(values) == (3, 3):
        matrix = array("orientation", values, 3, 3, error=InvalidSceneError)
        off = float(np.abs(matrix @ matrix.T - _EYE).max())
        if off > _TOLERANCE or np.linalg.det(matrix) < 0.0:
            raise InvalidSceneError(
                f"orientation {matrix.tolist()} is no rotation: its columns must be unit vectors "
                "across each other and right-handed (determinant 1)"
            )
        return to_quaternion(matrix)
    quaternion = array("orientation", values, 4, error=InvalidSceneError)
    length = math.hypot(*quaternion)
    if abs(length - 1.0) > _TOLERANCE:
        raise InvalidSceneError(
            f"orientation {quaternion.tolist()} has length {length:.6g}: "
            "must be a unit quaternion w, x, y, z"
        )
    return quaternion if abs(length - 1.0) <= _NORMALISED else frozen(quaternion / length)


def from_quaternion(wxyz: Sequence[float] | FloatArray) -> FloatArray:
    """Rotation matrices (..., 3, 3) of a unit quaternion (4,) w, x, y, z, or of several (N, 4)."""
    if wxyz is IDENTITY:
        return _EYE
    w, x, y, z = np.transpose(wxyz) if np.ndim(wxyz) > 1 else map(float, wxyz)
    columns = [
        [1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)],
        [2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)],
        [2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)],
    ]
    return frozen(np.array(columns).T)


def product(a: FloatArray, b: FloatArray) -> FloatArray:
    """The quaternion (4,) of the rotation by ``b`` (4,), then by ``a`` (4,)."""
    if b is IDENTITY:
        return a
    u, v = a[1:], b[1:]
    return np.concatenate([[a[0] * b[0] - u @ v], a[0] * v + b[0] * u + np.cross(u, v)])


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
