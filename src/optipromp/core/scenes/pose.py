"""The pose of one frame in another."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import overload

import numpy as np

from optipromp.core.arrays import FloatArray, frozen
from optipromp.core.scenes.rotations import IDENTITY, from_quaternion, product, unit_quaternion
from optipromp.core.scenes.values import array


@dataclass(frozen=True, eq=False)
class Pose:
    """The pose of a frame B in a frame A.

    ``pose @ p`` are the coordinates in A of a point ``p`` in B: x_A = R x_B + position.
    ``pose @ other`` is the pose in A of a frame whose pose in B is ``other``.

    Args:
        position: (3,) origin of B in A [m].
        orientation: of B in A: quaternion (4,) ``w, x, y, z``, or rotation matrix (3, 3), which is
            converted to a quaternion.

    Raises:
        InvalidSceneError: a value is not finite, or the orientation is no rotation.
    """

    position: FloatArray = field(default_factory=lambda: np.zeros(3))
    orientation: FloatArray = field(default_factory=lambda: IDENTITY)

    def __post_init__(self) -> None:
        object.__setattr__(self, "position", array("position", self.position, 3))
        object.__setattr__(self, "orientation", unit_quaternion(self.orientation))

    @cached_property
    def rotation(self) -> FloatArray:
        """(3, 3) R, whose columns are the axes of B in A."""
        return from_quaternion(self.orientation)

    @cached_property
    def is_identity(self) -> bool:
        """Whether A and B are the same, to the bit."""
        return not self.position.any() and bool((self.rotation == np.eye(3)).all())

    def inverse(self) -> Pose:
        """The pose of A in B."""
        return Pose(-self.position @ self.rotation, self.orientation * [1.0, -1.0, -1.0, -1.0])

    @overload
    def __matmul__(self, other: Pose) -> Pose: ...

    @overload
    def __matmul__(self, other: FloatArray) -> FloatArray: ...

    def __matmul__(self, other: Pose | FloatArray) -> Pose | FloatArray:
        """The composition with a pose, or points (..., 3) of B in the coordinates of A."""
        if isinstance(other, Pose):
            return Pose(self @ other.position, product(self.orientation, other.orientation))
        return frozen(np.asarray(other) @ self.rotation.T + self.position)
