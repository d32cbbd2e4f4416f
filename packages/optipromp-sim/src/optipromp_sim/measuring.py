"""A crop from measurements with a ruler, a kitchen scale and a phone."""

import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress

import numpy as np

from optipromp.core.arrays import FloatArray
from optipromp.core.errors import InvalidRequestError, suggest
from optipromp.core.parameters import GRAVITY
from optipromp.core.scenes.crops import ROWS, Crop, crop_from_dict, crop_to_dict

MEASURED: Mapping[str, str] = {
    "width": "mm", "length": "mm", "mass": "g", "stem_length": "mm", "stem_diameter": "mm",
    "sag_load": "g", "sag": "mm", "swings": "1", "swing_first": "mm", "swing_last": "mm",
    "pull_along": "g", "pull_across": "g",
}  # fmt: skip
"""Unit of each measurement."""
TO_SI = {"mm": 1e-3, "g": 1e-3, "1": 1.0}
DEEPEST = 0.3  # sag over length up to which a beam's tip sinks by F L³ / 3EI, to 5 %


def _modulus(length: FloatArray, d: FloatArray, load: FloatArray, sag: FloatArray) -> FloatArray:
    """Of a level round beam of diameter ``d`` [m] under a load at its tip [kg] [Pa]."""
    deepest = float((sag / length).max())
    if deepest > DEEPEST:
        raise InvalidRequestError(
            f"sag is {deepest:.2g} of stem_length: must be at most {DEEPEST:g}; hang a lighter "
            "weight"
        )
    return np.asarray(load * GRAVITY * length**3 / (3.0 * sag) * 64.0 / (math.pi * d**4))


def _ratio(swings: FloatArray, first: FloatArray, last: FloatArray) -> FloatArray:
    """Damping ratio by the logarithm of amplitudes."""
    if (last >= first).any():
        raise InvalidRequestError("swing_last is not below swing_first: must be, as swings die out")
    fall = np.log(first / last) / swings
    return np.asarray(fall / np.hypot(2.0 * math.pi, fall))


FORMULAS: Mapping[str, tuple[tuple[str, ...], Callable[..., FloatArray]]] = {
    "width": (("width",), lambda wide: wide),
    "elongation": (("length", "width"), lambda long, wide: long / wide),
    "density": (  # of an ellipsoid
        ("mass", "length", "width"),
        lambda mass, long, wide: mass / (math.pi / 6.0 * long * wide**2),
    ),
    "stem_length": (("stem_length",), lambda long: long),
    "stem_diameter": (("stem_diameter",), lambda thick: thick),
    "stem_modulus": (("stem_length", "stem_diameter", "sag_load", "sag"), _modulus),
    "damping_ratio": (("swings", "swing_first", "swing_last"), _ratio),
    "abscission": (("pull_along",), lambda pull: pull * GRAVITY),
}
"""The measurements that each row follows from, and how, fruit by fruit [SI]."""


def measured_crop(name: str, like: Crop, given: Mapping[str, Sequence[str]]) -> Crop:
    """A crop whose rows are measured where measurements are given, and else those of ``like``.

    ``given``: texts of each of :data:`MEASURED`, one a fruit, in its unit; empty where it was not
    measured.

    Raises:
        InvalidRequestError: a measurement that is unknown or no number above 0, numbers of
            measurements that differ, or one from which no row follows.
        InvalidSceneError: a row that is out of its range; mostly a unit is wrong.
    """
    known = {key: _numbers(key, each) for key, each in given.items()}
    document, used = crop_to_dict(like) | {"name": name}, set[str]()
    for row, (needs, formula) in FORMULAS.items():
        if known.keys() >= set(needs):
            values = formula(*_paired(known, needs))
            document[row] = {
                "value": float(values.mean()), "unit": ROWS[row][0],
                "spread": float(values.std(ddof=1)) if len(values) > 1 else 0.0,
                "source": f"measured, n = {len(values)}: {', '.join(needs)}",
            }  # fmt: skip
            used |= set(needs)
    if "pull_along" in known:
        along = document["abscission"]
        usual = like.rows["abscission"].at(along["value"])
        forces, angles = list(usual.values), list(usual.angles)
        source = f"other angles in proportion as of {like.name}"
        if "pull_across" in known:
            across = GRAVITY * _paired(known, ("pull_across",))
            forces, angles = [along["value"], float(across.mean())], [0.0, 90.0]
            source = f"pull_across, n = {across.size}"
            used.add("pull_across")
        along |= {"value": forces, "angles": angles, "source": f"{along['source']}; {source}"}
    if alone := sorted(known.keys() - used):
        words = (f"{row} of {', '.join(names)}" for row, (names, _) in FORMULAS.items())
        raise InvalidRequestError(
            f"no row follows from {', '.join(alone)} alone; they follow: {'; '.join(words)}"
        )
    return crop_from_dict(document, "from measurements in mm and g")


def _numbers(name: str, texts: Sequence[str]) -> FloatArray:
    """A measurement of each fruit [SI]; NaN where it was not made."""
    if name not in MEASURED:
        raise InvalidRequestError(f"{name} is no measurement: {suggest(name, MEASURED)}")
    out = np.full(len(texts), np.nan)
    for k, text in enumerate(texts):
        with suppress(ValueError):
            out[k] = float(text)
        if text.strip() and not 0.0 < out[k] < np.inf:
            raise InvalidRequestError(
                f"{name}[{k}] is {text}: must be a number above 0 [{MEASURED[name]}]"
            )
    return TO_SI[MEASURED[name]] * out


def _paired(given: Mapping[str, FloatArray], needs: Sequence[str]) -> FloatArray:
    """The measurements ``needs`` (M, N) of the N fruits that have all of them."""
    counts = {name: len(given[name]) for name in needs}
    if len(set(counts.values())) > 1:
        told = ", ".join(f"{name} {count}" for name, count in counts.items())
        raise InvalidRequestError(f"numbers of measurements differ: {told}; one a fruit each")
    columns = np.array([given[name] for name in needs])
    columns = columns[:, np.isfinite(columns).all(axis=0)]
    if not columns.size:
        raise InvalidRequestError(f"no fruit has all of {', '.join(needs)}")
    return columns
