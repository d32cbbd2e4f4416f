"""A crop from measurements with a ruler, a kitchen scale and a phone."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from optipromp.core.arrays import FloatArray
from optipromp.core.documents import read_document, read_table
from optipromp.core.errors import InvalidRequestError
from optipromp.core.parameters import GRAVITY
from optipromp.core.scenes.crops import ROWS, Crop, Row
from optipromp.core.shown import suggest


class Limits(NamedTuple):
    """The unit of a measurement, and the least and largest that is one in that unit."""

    unit: str
    least: float
    most: float
    factor: float  # to SI


LIMITS: Mapping[str, Limits] = {
    "width": Limits("mm", 4, 400, 1e-3), "length": Limits("mm", 4, 600, 1e-3),
    "mass": Limits("g", 0.2, 5000, 1e-3), "stem_length": Limits("mm", 3, 2000, 1e-3),
    "stem_diameter": Limits("mm", 0.3, 30, 1e-3), "sag_load": Limits("g", 0.05, 2000, 1e-3),
    "sag": Limits("mm", 0.2, 600, 1e-3), "swings": Limits("swings", 1, 200, 1.0),
    "swing_first": Limits("mm", 0.5, 1000, 1e-3), "swing_last": Limits("mm", 0.1, 1000, 1e-3),
    "pull_along": Limits("g", 5, 1e5, 1e-3 * GRAVITY),
    "pull_across": Limits("g", 5, 1e5, 1e-3 * GRAVITY),
}  # fmt: skip
DEEPEST = 0.3  # sag over length up to which a beam's tip sinks by F L³ / 3EI, to 5 %


def _modulus(length: FloatArray, d: FloatArray, load: FloatArray, sag: FloatArray) -> FloatArray:
    """Of a level round beam of diameter ``d`` under a load at its tip [Pa]."""
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
    "abscission": (("pull_along",), lambda pull: pull),
}
"""The measurements that each row follows from, and how, fruit by fruit [SI]."""


def measured_crop(
    name: str, like: Crop, given: Mapping[str, Sequence[object]]
) -> tuple[Crop, tuple[str, ...]]:
    """A crop from measurements, and the names of the rows that were measured.

    ``like``: whose rows stand where nothing was measured. ``given``: texts or numbers of each of
    :data:`LIMITS`, one a fruit, in its unit; empty where it was not measured.

    Raises InvalidRequestError: a measurement that is unknown or out of its limits, numbers of
    measurements that differ, or one from which no row follows.
    """
    known = {key: _numbers(key, each) for key, each in given.items()}
    rows, used = dict(like.rows), set[str]()
    for row, (needs, formula) in FORMULAS.items():
        if known.keys() >= set(needs):
            rows[row] = _row(row, formula(*_paired(known, needs)), like.rows[row], needs)
            used |= set(needs)
    mine = tuple(row for row in rows if rows[row] is not like.rows[row])
    if "pull_across" in known and "abscission" in mine:
        along, aside = rows["abscission"], known["pull_across"]
        aside = aside[np.isfinite(aside)]
        rows["abscission"] = replace(
            along, angles=(0.0, 90.0), table=(along.value, float(aside.mean())),
            source=f"{along.source}; pull_across, n = {len(aside)}",
        )  # fmt: skip
        used.add("pull_across")
    if alone := sorted(known.keys() - used):
        words = (f"{row} of {', '.join(names)}" for row, (names, _) in FORMULAS.items())
        raise InvalidRequestError(
            f"no row follows from {', '.join(alone)} alone; they follow: {'; '.join(words)}"
        )
    return Crop(name, rows), mine


def read_measurements(table: Path) -> dict[str, Sequence[object]]:
    """The measurements of a CSV or YAML file, by name; of a fruit without one, an empty cell."""
    if table.suffix == ".csv":
        found = read_table(table, InvalidRequestError, "width, mass, ...")
        return {name: [row[k] for row in found.rows] for k, name in enumerate(found.header)}
    holds = "measurements (width: [31, 29], ...), or name=31,29 in place of a file"
    document = read_document(table, InvalidRequestError, holds)
    if not isinstance(document, dict):
        raise InvalidRequestError(f"{table}: must hold {holds}")
    return {key: one if isinstance(one, list) else [one] for key, one in document.items()}


def _numbers(name: str, given: Sequence[object]) -> FloatArray:
    """A measurement of each fruit [SI]; NaN where it was not made."""
    if name not in LIMITS:
        raise InvalidRequestError(f"{name} is no measurement: {suggest(name, LIMITS)}")
    unit, least, most, factor = LIMITS[name]
    out = np.full(len(given), np.nan)
    for k, each in enumerate(given):
        if each is None or str(each).strip() == "":
            continue
        try:
            out[k] = float(str(each))
        except ValueError:
            out[k] = np.nan
        if not least <= out[k] <= most:
            raise InvalidRequestError(
                f"{name}[{k}] is {each}: must be {least:g} to {most:g} [{unit}]"
            )
    return factor * out


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


def _row(name: str, values: FloatArray, usual: Row, needs: Sequence[str]) -> Row:
    """The row of the values of N fruits; a table of abscission is scaled."""
    kind, value = ROWS[name], float(values.mean())
    if not kind.least <= value <= kind.most:
        raise InvalidRequestError(
            f"{name} of {', '.join(needs)} is {value:.3g} {kind.unit}: must be {kind.least:g} to "
            f"{kind.most:g} {kind.unit}; look at their units"
        )
    spread = float(values.std(ddof=1)) if len(values) > 1 else 0.0
    words = f"measured, n = {len(values)}: {', '.join(needs)}"
    return replace(usual.at(value), source=words, guess=False, spread=spread, range=None)
