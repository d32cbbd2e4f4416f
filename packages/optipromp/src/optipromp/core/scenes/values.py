"""Arrays and distances of scenes: no farther than :data:`FARTHEST`."""

from __future__ import annotations

from typing import Annotated

from annotated_types import Ge, Gt, Le, Unit
from numpy.typing import ArrayLike

from optipromp.core import values
from optipromp.core.arrays import FloatArray
from optipromp.core.errors import InvalidSceneError, suggest
from optipromp.core.geometry.shapes import FARTHEST

__all__ = ["Array", "Length", "Padding", "array", "suggest", "unit"]

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
