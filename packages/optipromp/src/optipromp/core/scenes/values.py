"""Arrays and distances of scenes: no farther than :data:`FARTHEST`."""

from __future__ import annotations

import math
from typing import Annotated

from annotated_types import Ge, Gt, Le, Unit
from numpy.typing import ArrayLike

from optipromp.core import values
from optipromp.core.arrays import FloatArray, frozen
from optipromp.core.errors import InvalidSceneError, suggest
from optipromp.core.geometry.shapes import FARTHEST

__all__ = ["Array", "Length", "Padding", "array", "direction", "suggest", "unit"]

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


def direction(given: ArrayLike) -> FloatArray:
    """``given`` (3,) normalised, read-only; a validator refuses it if its length is 0."""
    vector = Array(3).read(given)
    length = math.hypot(*vector)
    if not length > 0.0:
        raise values.refuse(f"is {vector.tolist()}: must have a direction")
    return frozen(vector / length)


def unit(name: str, given: ArrayLike) -> FloatArray:
    """As :func:`direction`; ``name`` begins the error."""
    return values.read_by(direction, name, given, InvalidSceneError)
