"""Checks of a scene's values, with the words of the refusals."""

from __future__ import annotations

import math

import numpy as np

from optipromp.core.arrays import FloatArray, frozen
from optipromp.core.errors import InvalidSceneError, is_name, no_name, suggest
from optipromp.core.geometry.shapes import FARTHEST

__all__ = ["array", "named", "numbers", "suggest", "unit"]


def named(what: str, text: object) -> None:
    """Refuse a text that is no name. ``what`` begins the error."""
    if not isinstance(text, str) or not is_name(text):
        raise InvalidSceneError(f"{what} is {no_name(str(text))}")


LARGEST_PADDING = 1.0  # [m] chosen: a larger one is a number in millimetres


def keep(name: str, value: object) -> float:
    """``value`` as a distance to be kept [m]; refused below 0 or above :data:`LARGEST_PADDING`."""
    number = value if isinstance(value, int | float) and not isinstance(value, bool) else math.nan
    if not 0.0 <= number <= LARGEST_PADDING:
        raise InvalidSceneError(f"{name} is {value!r}: must be 0 to {LARGEST_PADDING:g} [m]")
    return float(number)


def limited(
    name: str, value: float | None, unit: str = "", most: float = math.inf, *, zero: bool = False
) -> None:
    """Refuse a number that is below 0, too large, or (unless ``zero``) 0; None is accepted."""
    if value is None or (0.0 < value <= most and value < math.inf) or (zero and value == 0.0):
        return
    above = "" if math.isinf(most) else f" and at most {most:g}"
    wanted = f"0 to {most:g}" if zero and above else f"{'at least' if zero else 'above'} 0{above}"
    raise InvalidSceneError(f"{name} is {value:g}: must be {wanted}{unit and f' [{unit}]'}")


def numbers(name: str, values: object) -> FloatArray:
    """``values`` as a read-only array of any shape; refused if they are no numbers."""
    try:
        return frozen(values)
    except (TypeError, ValueError, OverflowError):
        raise InvalidSceneError(f"{name} is {values!r:.60}: must be finite numbers") from None


def array(name: str, values: object, *shape: int | None) -> FloatArray:
    """``values`` as a read-only array; refused if not finite or not of ``shape`` (None: any)."""
    array = numbers(name, values)
    fits = [want in (None, have) for want, have in zip(shape, array.shape, strict=False)]
    if array.ndim != len(shape) or not all(fits):
        wanted = ", ".join("n" if size is None else str(size) for size in shape)
        wanted += "," if len(shape) == 1 else ""
        raise InvalidSceneError(f"{name} has shape {array.shape}: must be ({wanted})")
    usable = np.abs(array) <= FARTHEST
    if not usable.all():
        at = tuple(int(i) for i in np.argwhere(~usable)[0])
        where = "".join(f"[{i}]" for i in at)
        wanted = f"at most {FARTHEST:g}" if np.isfinite(array[at]) else "finite"
        raise InvalidSceneError(f"{name}{where} is {array[at]}: must be {wanted}")
    return array


def unit(name: str, values: object) -> FloatArray:
    """``values`` (3,) normalised, read-only; refused if their length is 0."""
    vector = array(name, values, 3)
    length = math.hypot(*vector)
    if not length > 0.0:
        raise InvalidSceneError(f"{name} is {vector.tolist()}: must have a direction")
    return frozen(vector / length)
