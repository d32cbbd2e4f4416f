"""Crops: sizes, stems and what fruits bear, each row with its unit and source, or as a guess.

A scene names a crop (``crop: tomato``). Its rows are the physics of fruits and stems that state
none, and the limits by which the simulation judges harm; docs/crops.md describes the laws.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, BeforeValidator, Field

from optipromp.core.arrays import FloatArray
from optipromp.core.documents import built_in, read_named, write_document
from optipromp.core.errors import InvalidSceneError
from optipromp.core.scenes import schema
from optipromp.core.scenes.schema import Value, needed
from optipromp.core.values import Name, NotNegative

ROWS: Mapping[str, tuple[str, float, float]] = {
    "width": ("m", 0.004, 0.4),  # of a ripe fruit, across its axis
    "elongation": ("1", 0.3, 5.0),  # length of a fruit along its axis over its width
    "density": ("kg/m^3", 100.0, 1500.0),  # of a fruit
    "stem_length": ("m", 0.003, 2.0),  # of the stem that bends with one fruit
    "stem_diameter": ("m", 0.0003, 0.03),  # of that stem
    "stem_modulus": ("Pa", 1e6, 2e10),  # of that stem, in bending
    "damping_ratio": ("1", 0.005, 1.0),  # of a fruit that swings on its stem
    "impact_energy": ("J", 1e-4, 5.0),  # of a blow that bruises
    "pressed_force": ("N", 0.1, 1000.0),  # that bruises if it lasts
    "pressed_time": ("s", 0.005, 100.0),  # in which flesh yields to 63 % under such a force
    "edge_force": ("N", 0.1, 1000.0),  # of an edge that pierces the skin
    "grip_force": ("N", 0.1, 1000.0),  # on a stem that crushes it
    "abscission": ("N", 0.05, 1000.0),  # pull that detaches, by its angle to the stem
    "abscission_moment": ("N m", 1e-4, 10.0),  # bending at the calyx that detaches a fruit
}
"""Unit of each row, and the least and largest value; others are mistakes of units: choices."""

UNITS: Mapping[str, Mapping[str, float]] = {
    "m": {"mm": 1e-3, "cm": 1e-2, "m": 1.0}, "kg/m^3": {"g/cm^3": 1e3, "kg/m^3": 1.0},
    "Pa": {"MPa": 1e6, "GPa": 1e9, "Pa": 1.0}, "N": {"mN": 1e-3, "N": 1.0},
    "J": {"mJ": 1e-3, "J": 1.0}, "N m": {"N mm": 1e-3, "N m": 1.0},
    "s": {"ms": 1e-3, "s": 1.0}, "1": {"%": 1e-2, "1": 1.0},
}  # fmt: skip
"""Units that a file may state, and the factors to the unit of a row."""

SPAN = 0.5, 2.0  # factors from a guess to its ends, where the file states no range: a choice
MOST_ANGLES = 91  # of abscission, one for each degree: a choice
CROP_FOLDER = "crop_files"


@dataclass(frozen=True)
class Row:
    """A row of a crop, in the unit of :data:`ROWS`.

    Args:
        values: the value; of abscission, one for each angle.
        source: who measured it, or why it is guessed.
        guess: whether nobody measured it on this crop.
        spread: standard deviation from fruit to fruit.
        range: between which a guess lies; None: half to twice the value.
        angles: of abscission, between pull and stem, ascending from 0 to 90 [degrees].
    """

    values: tuple[float, ...]
    source: str
    guess: bool = False
    spread: float = 0.0
    range: tuple[float, float] | None = None
    angles: tuple[float, ...] = (0.0,)

    @property
    def value(self) -> float:
        """The value; of abscission, at the first angle."""
        return self.values[0]

    @property
    def ends(self) -> tuple[float, float]:
        """The least and the largest value that a guess may have."""
        return self.range or (SPAN[0] * self.value, SPAN[1] * self.value)

    def hangs(self, figure: float) -> bool:
        """Whether some values of a guess bear a figure of a run, and others do not."""
        return self.guess and self.ends[0] < figure <= self.ends[1]

    def at(self, value: float) -> Row:
        """The row with another value; those of further angles are scaled with it."""
        further = (value / self.value * each for each in self.values[1:])
        return replace(self, values=(value, *further))


@dataclass(frozen=True)
class Crop:
    """A crop: all :data:`ROWS` by name. ``crop[name]`` is the value of a row.

    ``eyes``: what numbers of the perception (``EyeParameters``) differ in, and their ``source``.
    """

    name: str
    rows: Mapping[str, Row]
    eyes: Mapping[str, float | str] = field(default_factory=dict)

    def __getitem__(self, name: str) -> float:
        return self.rows[name].value

    @property
    def guesses(self) -> tuple[str, ...]:
        """The rows that nobody measured."""
        return tuple(name for name, row in self.rows.items() if row.guess)

    def changed(self, name: str, value: float) -> Crop:
        """The crop with another value in a row."""
        return replace(self, rows={**self.rows, name: self.rows[name].at(value)})


def detaching(crop: Crop, angles: FloatArray) -> FloatArray:
    """Forces (K,) [N] that detach a fruit, pulled at ``angles`` (K,) [degrees] to the stem.

    Between the row's angles it is interpolated. Beyond 90 degrees the fruit is pushed towards its
    stem, and only the part of the force across the stem detaches it.
    """
    row = crop.rows["abscission"]
    across = np.sin(np.deg2rad(np.maximum(angles, 90.0)))
    return np.asarray(np.interp(angles, row.angles, row.values) / np.maximum(across, 1e-9))


def _row(name: str) -> Any:
    """What a row is in a file: a :class:`Row`, once it is read."""
    (unit, least, largest), turns = ROWS[name], name == "abscission"  # alone has angles
    units = UNITS[unit]

    def made(row: Any) -> Row:
        factor, angles = units[row.unit], tuple(getattr(row, "angles", None) or (0.0,))
        for number in (*row.value, *(row.range or ())):
            if not least <= factor * number <= largest:
                raise schema.refuse(
                    f"{number:g} {row.unit} is out of range: must be {least / factor:g} to "
                    f"{largest / factor:g} {row.unit}"
                )
        if row.range and not (row.guess and row.range[0] <= row.value[0] <= row.range[1]):
            raise schema.refuse(
                f"range is {row.range}: must be of a guess (guess: true), and hold its value"
            )
        whole = angles == (0.0,) or (angles[0], angles[-1]) == (0.0, 90.0)
        rises = all(a < b for a, b in itertools.pairwise(angles))
        if not (whole and rises and len(angles) == len(row.value)):
            raise schema.refuse(
                f"angles are {list(angles)}: must ascend from 0 to 90 [degrees], one for each value"
            )
        return Row(
            tuple(factor * each for each in row.value), row.source, row.guess, factor * row.spread,
            (factor * row.range[0], factor * row.range[1]) if row.range else None, angles,
        )  # fmt: skip

    most = MOST_ANGLES if turns else 1
    numbers = Annotated[list[float], Field(min_length=1, max_length=most)]
    form = schema.form(
        value=needed(Value(Annotated[numbers, BeforeValidator(schema.as_list)])),
        unit=needed(Value(Literal[tuple(units)])), source=needed(schema.NAME),
        guess=Value(bool, default=False), spread=Value(NotNegative, default=0.0),
        range=Value(Annotated[list[float], Field(min_length=2, max_length=2)]),
        **({"angles": Value(numbers)} if turns else {}),
    )  # fmt: skip
    return Annotated[form, AfterValidator(made)]


def crop_names() -> tuple[str, ...]:
    """Names of the built-in crops."""
    return tuple(built_in(CROP_FOLDER))


_CROP = schema.form(
    format=Value(Literal[1], default=1), name=needed(schema.NAME),
    like=Value(Literal[crop_names()]), **{name: Value(_row(name)) for name in ROWS},
    eyes=Value(dict[Name, float | Name], default={}),
)  # fmt: skip
CROP_KEYS = frozenset({"format", "name", "like", "eyes", *ROWS})


def crop_from_dict(document: Any, source: str) -> Crop:
    """The crop of the plain values of a crop file; ``source`` names it in messages.

    Raises:
        InvalidSceneError: names the row, its value, and what would be right.
    """
    model = schema.parse(document, source, _CROP)
    usual = Crop("", {}) if model.like is None else load_crop(model.like)
    rows = dict(usual.rows)
    rows |= {name: row for name in ROWS if (row := getattr(model, name)) is not None}
    for name in ROWS:
        if name not in rows:
            raise InvalidSceneError(
                f"{source}: {name} is missing: state it, or like: {', '.join(crop_names())}, whose "
                "rows take the place of those that are missing"
            )
    return Crop(model.name, rows, {**usual.eyes, **model.eyes})


def load_crop(name_or_path: str | Path | dict[str, Any]) -> Crop:
    """Load a built-in crop by name, or a crop file; or take the plain values of such a file.

    Raises:
        InvalidSceneError: no such crop, or one that cannot be used; names the row and its value.
    """
    if isinstance(name_or_path, dict):
        return crop_from_dict(name_or_path, "crop")
    holds = "a crop (format: 1, name, width, density, ...)"
    document, source, _ = read_named(name_or_path, CROP_FOLDER, InvalidSceneError, holds)
    return crop_from_dict(document, source)


def crop_to_dict(crop: Crop) -> dict[str, Any]:
    """The crop as the plain values of a crop file, in the units of :data:`ROWS`."""
    document: dict[str, Any] = {"format": 1, "name": crop.name}
    for name, row in crop.rows.items():
        turns = len(row.angles) > 1
        document[name] = {
            "value": list(row.values) if turns else row.value, "unit": ROWS[name][0],
            **({"angles": list(row.angles)} if turns else {}),
            **({"spread": row.spread} if row.spread else {}),
            **({"guess": True} if row.guess else {}),
            **({"range": list(row.range)} if row.range else {}),
            "source": row.source,
        }  # fmt: skip
    return document | ({"eyes": dict(crop.eyes)} if crop.eyes else {})


def crop_in_scene(crop: Crop) -> str | dict[str, Any]:
    """The crop as a scene file has it: the name of one that is built in, or the rows."""
    known = crop.name in crop_names() and crop == load_crop(crop.name)
    return crop.name if known else crop_to_dict(crop)


def save_crop(crop: Crop, path: Path) -> None:
    """Write a crop file (JSON if the suffix is ``.json``, else YAML), whole or not at all."""
    write_document(crop_to_dict(crop), path)
