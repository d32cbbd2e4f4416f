"""The pose of one frame in another, and values that a frame has."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, ClassVar, NamedTuple, Self, overload

import numpy as np

from optipromp.core.arrays import FloatArray, frozen
from optipromp.core.scenes.rotations import IDENTITY, from_quaternion, product, unit_quaternion
from optipromp.core.scenes.values import array, unit


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


class Quantity(NamedTuple):
    """What a value in a frame is: how it is checked, and how it changes with the frame."""

    checked: Callable[[str, Any], Any]
    moved: Callable[[Pose, Any], Any]


def _each(pose: Pose, part: Any) -> Any:
    if isinstance(part, tuple):
        return tuple(one.transformed(pose) for one in part)
    return part.transformed(pose)


POINT = Quantity(lambda name, point: array(name, point, 3), lambda pose, point: pose @ point)
SPAN = Quantity(POINT.checked, lambda pose, span: pose.rotation @ span)
DIRECTION = Quantity(unit, SPAN.moved)
TURN = Quantity(lambda _, turn: unit_quaternion(turn), lambda pose, q: product(pose.orientation, q))
PART = Quantity(lambda _, part: part, _each)  # a :class:`Framed`, or a tuple of such


class Framed:
    """Base of dataclasses with values in a frame, which may be None.

    A subclass states the kind of each of them, and the ``label`` before their names in messages.
    """

    kinds: ClassVar[Mapping[str, Quantity]]
    label: ClassVar[str]

    def __init_subclass__(cls, label: str = "", **kinds: Quantity) -> None:
        cls.label, cls.kinds = label, kinds

    def __post_init__(self) -> None:
        for name, kind in self.kinds.items():
            if (value := getattr(self, name)) is not None:
                object.__setattr__(self, name, kind.checked(f"{self.label}.{name}", value))

    def moved(self, pose: Pose) -> dict[str, Any]:
        """The values in another frame, in which their present frame has the ``pose``, by name."""
        stated = {name: getattr(self, name) for name in self.kinds}
        return {k: self.kinds[k].moved(pose, v) for k, v in stated.items() if v is not None}

    def transformed(self, pose: Pose) -> Self:
        """The same in another frame, in which its present frame has the ``pose``."""
        return replace(self, **self.moved(pose))  # type: ignore[type-var]
