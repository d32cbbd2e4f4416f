"""Reading tables of numbers from CSV files."""

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from optipromp.core.arrays import FloatArray
from optipromp.core.errors import OptiPrompError
from optipromp.core.files import LARGEST_TEXT, read_bytes


@dataclass(frozen=True)
class Table:
    """A CSV file: the names of its columns, and its rows as text.

    Attributes:
        path: of the file.
        error: type of the errors that are raised.
        header: names of the columns.
        first: line number of the header.
        lines: line number of each row.
        rows: texts, one a column.
    """

    path: Path
    error: type[OptiPrompError]
    header: list[str]
    first: int
    lines: list[int]
    rows: list[list[str]]

    def numbers(self, columns: Sequence[int]) -> FloatArray:
        """The numbers (R, C) in the columns of the C indices, for all R rows."""
        out = np.empty((len(self.rows), len(columns)))
        for k, row in enumerate(self.rows):
            for i, column in enumerate(columns):
                try:
                    out[k, i] = float(row[column])
                except ValueError:
                    out[k, i] = np.nan
        if not np.isfinite(out).all():
            k, i = (int(index) for index in np.argwhere(~np.isfinite(out))[0])
            raise self.error(
                f"{self.path}, line {self.lines[k]}: {self.header[columns[i]]} is "
                f"{self.rows[k][columns[i]]!r}, expected a finite number"
            )
        return out


def read_table(path: Path, error: type[OptiPrompError], wanted: str) -> Table:
    """Read a CSV file; ``wanted`` describes the expected header in messages."""
    try:
        text = read_bytes(path, error, LARGEST_TEXT).decode("utf-8-sig")
        lines = io.StringIO(text, newline="")
        found = [(n, row) for n, row in enumerate(csv.reader(lines), start=1) if row]
    except (UnicodeDecodeError, csv.Error) as cause:
        raise error(f"{path} is not a UTF-8 CSV file ({cause})") from None
    if not found:
        raise error(f"{path} is empty; expected a header {wanted}")
    header = [name.strip() for name in found[0][1]]
    for line, row in found[1:]:
        if len(row) != len(header):
            raise error(f"{path}, line {line}: {len(row)} values, the header has {len(header)}")
    numbers, rows = [line for line, _ in found[1:]], [row for _, row in found[1:]]
    return Table(path, error, header, found[0][0], numbers, rows)
