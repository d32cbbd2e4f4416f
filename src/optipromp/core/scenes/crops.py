"""Crops: sizes, stems and what fruits bear, each row with its unit and source, or as a guess.

A scene names a crop (``crop: tomato``). Its rows are the physics of fruits and stems that state
none, and the limits by which the simulation judges harm; docs/crops.md tells the laws.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass, replace
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
import yaml
from pydantic import BeforeValidator, Field

from optipromp.core.arrays import FloatArray
from optipromp.core.documents import read_document
from optipromp.core.errors import InvalidSceneError
from optipromp.core.files import check_inside, is_there, write_atomically
from optipromp.core.scenes.schema import Number, Text, Value, as_list, form, needed, parse, values
from optipromp.core.scenes.values import suggest


class RowKind(NamedTuple):
    """What a row of a crop is."""

    unit: str
    least: float  # in the unit; a value outside is a mistake of units: a choice
    most: float
    meaning: str


ROWS: Mapping[str, RowKind] = {
    "width": RowKind("m", 0.004, 0.4, "of a ripe fruit, across its axis"),
    "elongation": RowKind("1", 0.3, 5.0, "length of a fruit along its axis over its width"),
    "density": RowKind("kg/m^3", 100.0, 1500.0, "of a fruit"),
    "stem_length": RowKind("m", 0.003, 2.0, "of the stem that bends with one fruit"),
    "stem_diameter": RowKind("m", 0.0003, 0.03, "of that stem"),
    "stem_modulus": RowKind("Pa", 1e6, 2e10, "of that stem, in bending"),
    "damping_ratio": RowKind("1", 0.005, 1.0, "of a fruit that swings on its stem"),
    "impact_energy": RowKind("J", 1e-4, 5.0, "of a blow that bruises"),
    "pressed_force": RowKind("N", 0.1, 1000.0, "that bruises if it lasts"),
    "pressed_time": RowKind("s", 0.005, 100.0, "in which flesh yields to 63 % under such a force"),
    "edge_force": RowKind("N", 0.1, 1000.0, "of an edge that pierces the skin"),
    "grip_force": RowKind("N", 0.1, 1000.0, "on a stem that crushes it"),
    "abscission": RowKind("N", 0.05, 1000.0, "pull that detaches, by its angle to the stem"),
    "abscission_moment": RowKind("N m", 1e-4, 10.0, "bending at the calyx that detaches a fruit"),
}
"""Rows by name; the table of abscission has a value for each of its ``angles``."""

UNITS: Mapping[str, tuple[str, float]] = {
    "mm": ("m", 1e-3), "cm": ("m", 1e-2), "%": ("1", 1e-2), "g/cm^3": ("kg/m^3", 1e3),
    "MPa": ("Pa", 1e6), "GPa": ("Pa", 1e9), "mJ": ("J", 1e-3), "ms": ("s", 1e-3),
    "mN": ("N", 1e-3), "N mm": ("N m", 1e-3),
    **{row.unit: (row.unit, 1.0) for row in ROWS.values()},
}  # fmt: skip
"""Units that a file may state: the unit of rows, and the factor to it."""

UNUSUAL = 3.0  # standard deviations of a width beyond which a fruit is told: a choice
SPAN = 0.5, 2.0  # factors from a guess to its ends, where the file states no range: a choice


@dataclass(frozen=True)
class Row:
    """A value of a crop.

    Args:
        value: in the unit of :data:`ROWS`; of abscission, at the first angle.
        source: who measured it, or why it is guessed.
        guess: whether nobody measured it on this crop.
        spread: standard deviation from fruit to fruit, in the unit.
        range: between which a guess lies, in the unit; None: half to twice the value.
        angles: of abscission, between pull and stem, ascending from 0 to 90 [degrees].
        table: of abscission, the forces at the angles [N].
    """

    value: float
    source: str
    guess: bool = False
    spread: float = 0.0
    range: tuple[float, float] | None = None
    angles: tuple[float, ...] = ()
    table: tuple[float, ...] = ()

    @property
    def ends(self) -> tuple[float, float]:
        """The least and the largest value that a guess may have."""
        return self.range or (SPAN[0] * self.value, SPAN[1] * self.value)

    def at(self, value: float) -> Row:
        """The row with another value; a table is scaled with it."""
        table = tuple(value / self.value * each for each in self.table)
        return replace(self, value=value, table=table)


@dataclass(frozen=True)
class Crop:
    """A crop: all :data:`ROWS` by name.

    ``crop[name]`` is the value of a row. ``path``: of its file; None: built in, or made in memory.
    """

    name: str
    rows: Mapping[str, Row]
    path: Path | None = None

    def __getitem__(self, name: str) -> float:
        return self.rows[name].value

    @property
    def guesses(self) -> tuple[str, ...]:
        """The rows that nobody measured."""
        return tuple(name for name, row in self.rows.items() if row.guess)

    def changed(self, name: str, value: float) -> Crop:
        """The crop with another value in a row."""
        return replace(self, rows={**self.rows, name: self.rows[name].at(value)}, path=None)

    def unusual(self, widths: Mapping[str, float]) -> list[str]:
        """Which fruits are wider or narrower than :data:`UNUSUAL` deviations, in words.

        ``widths``: of the fruits, by id [m].
        """
        far = UNUSUAL * self.rows["width"].spread
        odd = [
            f"{id_} {1e3 * w:.0f} mm" for id_, w in widths.items() if abs(w - self["width"]) > far
        ]
        if not (far and odd):
            return []
        usual = f"{1e3 * self['width']:.0f} mm"
        return [f"of another width than a {self.name}, {usual}: {', '.join(odd)}"]

    def detaching(self, angles: FloatArray) -> FloatArray:
        """Forces (K,) that detach a fruit, pulled at ``angles`` (K,) to the stem [degrees] [N].

        Between the table's angles it is interpolated. Beyond 90 degrees the fruit is pushed towards
        its stem, and only the part of the force across the stem detaches it.
        """
        row = self.rows["abscission"]
        aside = np.sin(np.deg2rad(np.maximum(angles, 90.0)))
        forces = np.interp(angles, row.angles, row.table)
        return np.asarray(forces / np.maximum(aside, 1e-9))


_WORDS = Annotated[str, Field(strict=True, min_length=1, max_length=1000)]
_NUMBERS = Annotated[list[Number], Field(min_length=1, max_length=91)]
ROW = form(
    value=needed(Value(Annotated[_NUMBERS, BeforeValidator(as_list)])),
    unit=needed(Value(Text)), source=needed(Value(_WORDS)), guess=Value(bool, default=False),
    spread=Value(Annotated[float, Field(strict=True, ge=0.0, allow_inf_nan=False)]),
    range=Value(Annotated[list[Number], Field(min_length=2, max_length=2)]),
    angles=Value(_NUMBERS),
)  # fmt: skip
CROP = form(
    format=Value(int, default=1), name=needed(Value(Text)), like=Value(Text),
    **{name: Value(ROW) for name in ROWS},
)  # fmt: skip


def crop_from_dict(document: Any, source: str, path: Path | None = None) -> Crop:
    """The crop of the plain values of a crop file; ``source`` names it in messages.

    Raises:
        InvalidSceneError: names the row, its value, and what would be right.
    """
    model = parse(document, source, CROP)
    if model.like is not None and model.like not in crop_names():
        raise InvalidSceneError(
            f"{source}: like is {model.like!r}: {suggest(model.like, crop_names())}"
        )
    like = {} if model.like is None else load_crop(model.like).rows
    rows = {}
    for name in ROWS:
        given = getattr(model, name)
        if given is None and name not in like:
            raise InvalidSceneError(
                f"{source}: {name} is missing: state it, or like: {', '.join(crop_names())}, whose "
                "rows take the place of those that are missing"
            )
        try:
            rows[name] = like[name] if given is None else _made(name, **values(given, 1.0))
        except InvalidSceneError as error:
            raise InvalidSceneError(f"{source}: {name}{error.message}") from None
    return Crop(model.name, rows, path)


def _made(
    name: str, value: list[float], unit: str, source: str, guess: bool = False,
    spread: float = 0.0, range: list[float] | None = None, angles: list[float] | None = None,
) -> Row:  # fmt: skip
    kind = ROWS[name]
    fits, factor = UNITS.get(unit, ("", 1.0))
    if fits != kind.unit:
        units = [known for known, (whose, _) in UNITS.items() if whose == kind.unit]
        raise InvalidSceneError(f".unit is {unit!r}: must be {' or '.join(units)}")
    numbers = [factor * each for each in value]
    ends = None if range is None else (factor * range[0], factor * range[1])
    for number in (*numbers, *(ends or ())):
        if not kind.least <= number <= kind.most:
            raise InvalidSceneError(
                f" is {number / factor:g} {unit}: must be {kind.least / factor:g} to "
                f"{kind.most / factor:g} {unit} ({kind.meaning})"
            )
    if ends is not None and not (guess and ends[0] <= numbers[0] <= ends[1]):
        raise InvalidSceneError(
            f".range is {range}: must be of a guess (guess: true), and hold its value"
        )
    if name != "abscission":
        if len(numbers) != 1 or angles is not None:
            raise InvalidSceneError(".value must be one number; abscission alone has angles")
        return Row(numbers[0], source, guess, factor * spread, ends)
    turns = angles or ([0.0, 90.0] if len(numbers) == 1 else [])
    numbers = numbers * len(turns) if len(numbers) == 1 else numbers
    rises = all(a < b for a, b in itertools.pairwise(turns))
    if not (len(turns) == len(numbers) and rises and turns[0] == 0.0 and turns[-1] == 90.0):
        raise InvalidSceneError(
            f".angles are {angles}: must ascend from 0 to 90 [degrees], one for each value"
        )
    return Row(numbers[0], source, guess, factor * spread, ends, tuple(turns), tuple(numbers))


def crop_names() -> tuple[str, ...]:
    """Names of the built-in crops."""
    folder = resources.files("optipromp.core.scenes") / "crop_files"
    return tuple(sorted(f.name[:-5] for f in folder.iterdir() if f.name.endswith(".yaml")))


def load_crop(name_or_path: str | Path, base_dir: Path | None = None) -> Crop:
    """Load a built-in crop by name, or a crop file.

    ``base_dir``: folder of the scene that names the file, which may lie in no other; None: any.

    Raises:
        InvalidSceneError: no such crop, or one that cannot be used; names the row and its value.
    """
    name = str(name_or_path)
    if name in crop_names():
        built_in = resources.files("optipromp.core.scenes") / "crop_files" / f"{name}.yaml"
        with resources.as_file(built_in) as path:
            return crop_from_dict(_read(path), f"{name}.yaml")
    path = Path(name_or_path)
    if base_dir is not None:
        path = check_inside(base_dir / path, base_dir, InvalidSceneError)
    if path.suffix not in (".yaml", ".yml", ".json") and not is_there(path):
        raise InvalidSceneError(
            f"crop {name!r} is neither a file nor built in: {suggest(name, crop_names())}"
        )
    return crop_from_dict(_read(path), str(path), path)


def _read(path: Path) -> Any:
    return read_document(path, InvalidSceneError, "a crop (format: 1, name, width, density, ...)")


def crop_document(crop: Crop) -> dict[str, Any]:
    """The crop as the plain values of a crop file, in the units of :data:`ROWS`."""
    document: dict[str, Any] = {"format": 1, "name": crop.name}
    for name, row in crop.rows.items():
        document[name] = {
            "value": list(row.table) or row.value, "unit": ROWS[name].unit,
            **({"angles": list(row.angles)} if row.angles else {}),
            **({"spread": row.spread} if row.spread else {}),
            **({"guess": True} if row.guess else {}),
            **({"range": list(row.range)} if row.range else {}),
            "source": row.source,
        }  # fmt: skip
    return document


def save_crop(crop: Crop, path: Path) -> None:
    """Write a crop file (YAML), whole or not at all."""
    text = yaml.safe_dump(
        crop_document(crop), sort_keys=False, default_flow_style=None, width=100, allow_unicode=True
    )
    write_atomically(path, text.encode("utf-8"))


def hanging_on(crop: Crop, shares: Mapping[str, float]) -> tuple[str, ...]:
    """The guesses on which a verdict hangs.

    ``shares``: largest figure of a run over the value of its row. The verdict would be another one
    with another value of the guess's range.
    """
    out = []
    for name, share in shares.items():
        low, high = (end / crop[name] for end in crop.rows[name].ends)
        if crop.rows[name].guess and low < share <= high:
            out.append(name)
    return tuple(out)
