"""The pose of one frame in another, and values that a frame has."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Annotated, Any, Self, overload

import numpy as np
from annotated_types import Ge, Gt, Le, Unit
from numpy.typing import ArrayLike
from pydantic import PlainValidator
from pydantic_core import core_schema

from optipromp.core import values
from optipromp.core.arrays import FloatArray, frozen
from optipromp.core.errors import InvalidSceneError
from optipromp.core.geometry.shapes import FARTHEST
from optipromp.core.scenes.rotations import IDENTITY, from_quaternion, product, unit_quaternion

LARGEST_PADDING = 1.0  # [m] chosen: a larger one is a number in millimetres
Padding = Annotated[float, Ge(0.0), Le(LARGEST_PADDING), Unit("m")]
Length = Annotated[float, Gt(0.0), Unit("m")]


class Array(values.Array):
    """An array of a scene."""

    def __init__(self, *shape: int | None) -> None:
        super().__init__(*shape, most=FARTHEST)


def array(name: str, given: ArrayLike, *shape: int | None) -> FloatArray:
    """``given`` as an :class:`Array`; ``name`` begins the error."""
    return values.array(name, given, *shape, most=FARTHEST, error=InvalidSceneError)


def unit(name: str, given: ArrayLike) -> FloatArray:
    """As :func:`optipromp.core.values.direction`; ``name`` begins the error."""
    return values.read_by(values.direction, name, given, InvalidSceneError)


@dataclass(frozen=True, eq=False)
class Pose(values.Validated, error=InvalidSceneError):
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

    position: Annotated[FloatArray, Array(3)] = field(default_factory=lambda: np.zeros(3))
    orientation: Annotated[FloatArray, PlainValidator(unit_quaternion)] = field(
        default_factory=lambda: IDENTITY
    )

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


class Quantity:
    """In an annotation: how the field is read, and how its value changes with the frame."""

    def __init__(
        self, read: Callable[[Any], FloatArray], moved: Callable[[Pose, Any], FloatArray]
    ) -> None:
        self.read, self.moved = read, moved

    def __get_pydantic_core_schema__(self, *_: object) -> core_schema.CoreSchema:
        return core_schema.no_info_plain_validator_function(self.read)


POINTS = Quantity(Array(None, 3).read, lambda pose, points: pose @ points)
Point = Annotated[FloatArray, Quantity(Array(3).read, POINTS.moved)]
Span = Annotated[FloatArray, Quantity(Array(3).read, lambda pose, span: pose.rotation @ span)]
Direction = Annotated[
    FloatArray, Quantity(values.direction, lambda pose, span: pose.rotation @ span)
]
Turn = Annotated[
    FloatArray, Quantity(unit_quaternion, lambda pose, turn: product(pose.orientation, turn))
]


@functools.cache
def _quantities(kind: type) -> Mapping[str, Quantity | None]:
    """The fields of a class, and what those that are in a frame are."""
    kinds = {name: [*values.notes(hint)] for name, hint in values.hints_of(kind).items()}
    return {
        name: next((one for one in found if isinstance(one, Quantity)), None)
        for name, found in kinds.items()
    }


class Framed(values.Validated, error=InvalidSceneError):
    """Base of dataclasses with values in a frame: quantities, others of the kind, tuples of such.

    A value may be None.
    """

    def moved(self, pose: Pose) -> dict[str, Any]:
        """The values in another frame, in which their present frame has the ``pose``, by name."""
        out: dict[str, Any] = {}
        kind: type = type(self)
        for name, quantity in _quantities(kind).items():
            value = getattr(self, name)
            if quantity is not None and value is not None:
                out[name] = quantity.moved(pose, value)
            elif isinstance(value, Framed):
                out[name] = value.transformed(pose)
            elif isinstance(value, tuple) and value and isinstance(value[0], Framed):
                out[name] = tuple(one.transformed(pose) for one in value)
        return out

    def transformed(self, pose: Pose) -> Self:
        """The same in another frame, in which its present frame has the ``pose``."""
        return replace(self, **self.moved(pose))  # type: ignore[type-var]
