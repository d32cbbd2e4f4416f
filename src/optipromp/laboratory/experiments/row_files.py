"""The files of a study: its rows, one a run, and the settings that they share."""

import csv
import io
import json
import os
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from optipromp.core.errors import InvalidRequestError
from optipromp.core.files import check_folder, is_file, json_text, write_atomically
from optipromp.core.robots.library import NOTHING
from optipromp.laboratory.experiments.runs import COLUMNS, Row, row_from_text
from optipromp.laboratory.experiments.sources import digests
from optipromp.laboratory.generate import PANDA

ROWS, SETTINGS = "rows.csv", "study.json"
FOLDER = "folder"  # of the scene files; another one does not make another study


class RowFile:
    """The rows of a study in its folder, which is made if need be.

    ``wanted`` are the settings that they share. A line that an interruption cut short is
    dropped when the file is opened.
    """

    def __init__(self, folder: Path, wanted: Mapping[str, Any]) -> None:
        check_folder(folder)
        self.path = folder / ROWS
        self._check_settings(folder / SETTINGS, wanted)
        self.rows: list[Row] = self._read()

    def _check_settings(self, path: Path, wanted: Mapping[str, Any]) -> None:
        if not self.path.exists():
            write_atomically(path, json_text(dict(wanted)).encode())
            return
        try:
            found = json.loads(path.read_text(encoding="utf-8"))
        except (OSError, ValueError) as error:
            raise InvalidRequestError(
                f"{self.path} is there and {path.name} beside it cannot be read ({error}): choose "
                "another folder"
            ) from None
        for name in dict.fromkeys((*wanted, *found)):  # a default may be left out of either
            if name == FOLDER:
                continue
            value = wanted.get(name)
            if found.get(name) != value:
                raise InvalidRequestError(
                    f"{path.parent} holds rows with {name} {found.get(name)!r}, this study has "
                    f"{value!r}: choose another folder"
                )

    def _read(self) -> list[Row]:
        content = self.path.read_bytes() if self.path.exists() else b""
        whole = content[: content.rfind(b"\n") + 1]
        if len(whole) < len(content):
            os.truncate(self.path, len(whole))
        if not whole:
            self._append(",".join(COLUMNS) + "\n")
        return _parsed(whole, self.path)

    def append(self, row: Row) -> None:
        """Append a row to the file, and wait until it is on disk."""
        line = io.StringIO()
        values = {name: getattr(row, name) for name in COLUMNS}
        values["message"] = " ".join(row.message.split())  # one line a row
        csv.DictWriter(line, COLUMNS, lineterminator="\n").writerow(values)
        self._append(line.getvalue())
        self.rows.append(row)

    def _append(self, text: str) -> None:
        try:
            with self.path.open("ab", buffering=0) as stream:
                stream.write(text.encode("utf-8"))
                os.fsync(stream.fileno())
        except OSError as error:
            raise InvalidRequestError(f"cannot write {self.path}: {error.strerror}") from error


def rows_of(folder: Path) -> list[Row]:
    """The whole rows in a study's folder, oldest first; empty where there is no file."""
    path = folder / ROWS
    try:
        content = path.read_bytes() if path.exists() else b""
    except OSError as error:
        raise InvalidRequestError(f"cannot read {path}: {error.strerror}") from None
    return _parsed(content[: content.rfind(b"\n") + 1], path)


def _parsed(content: bytes, path: Path) -> list[Row]:
    try:
        table = csv.DictReader(io.StringIO(content.decode("utf-8")))
        rows = [row_from_text(line) for line in table]
    except (ValueError, KeyError, TypeError, AttributeError, csv.Error) as error:
        raise InvalidRequestError(f"{path} holds something that is no row: {error}") from None
    counts = Counter(row.key for row in rows)
    if len(counts) < len(rows):
        (key, count), *_ = counts.most_common(1)
        told = ", ".join(str(part) for part in key if part != "")
        raise InvalidRequestError(f"{path} holds {count} rows of {told}: must hold one")
    return rows


def settings_of(folder: Path) -> tuple[dict[str, Any], str | None]:
    """The settings that the rows of a study share, and the robot of its scenes.

    The robot is None where its file was read with choices.
    """
    try:
        settings = dict(json.loads((folder / SETTINGS).read_text(encoding="utf-8")))
    except (OSError, ValueError) as error:
        raise InvalidRequestError(f"{folder / SETTINGS}: {error}") from None
    told = str(settings.get("robot", f"{PANDA} {NOTHING}"))
    return settings, told.removesuffix(f" {NOTHING}") if told.endswith(f" {NOTHING}") else None


def file_of(settings: Mapping[str, Any], name: str) -> Path | None:
    """The scene file of a study's rows; None where it is not there, or has changed since."""
    known, path = settings.get("scenes"), Path(str(settings.get(FOLDER))) / name
    if not isinstance(known, Mapping) or name not in known or not is_file(path):
        return None
    return path if digests([path]) == {name: known[name]} else None
