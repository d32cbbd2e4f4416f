"""Studies of kinds of their own: a class says what is asked, makes a trial, and tells the rows.

``scripts/studies`` has those of the guard, the eyes, arms and doors.
"""

import json
import os
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from pkgutil import resolve_name
from typing import Any, Protocol

from optipromp.core.errors import InvalidRequestError
from optipromp_bench.experiments.cluster import Progress, gathered
from optipromp_bench.experiments.rows import Row, locked, source_version
from optipromp_bench.experiments.statistics import Table

Ask = Mapping[str, Any]


class Kind(Protocol):
    """A study: a frozen dataclass of plain fields, each with a default."""

    def asks(self) -> Sequence[Ask]:
        """What each trial is asked, in order, as plain values; ``preset`` and ``seed`` are two."""

    def trial(self, ask: Ask) -> Mapping[str, Any]:
        """What became of a trial, as plain values."""

    @staticmethod
    def told(parts: Mapping[str, Sequence[Mapping[str, Any]]]) -> Sequence[Table]:
        """The tables, of the rows of each study: what was asked and what became of it."""


def kind_of(name: str) -> type[Kind]:
    """The class of MODULE:CLASS; modules of the present folder count."""
    sys.path.insert(0, str(Path.cwd()))
    try:
        return resolve_name(name)  # type: ignore[no-any-return]
    except (ImportError, AttributeError, ValueError) as error:
        told = f"table is {name!r} ({error}); must be MODULE:CLASS, or left out"
        raise InvalidRequestError(told) from None


def run_kind(
    study: Kind, folder: Path, workers: int | None = None, progress: Progress | None = None
) -> list[Mapping[str, Any]]:
    """The rows of a study; those that its folder holds, of this version, are not made again."""
    asks, file = study.asks(), folder / "rows.jsonl"
    keys = [json.dumps([source_version(), ask]) for ask in asks]
    with locked(folder):
        content = file.read_bytes() if file.exists() else b""
        whole = content[: content.rfind(b"\n") + 1]  # a line that was cut short is dropped
        held = dict(map(json.loads, whole.splitlines()))
        missing = [k for k, key in enumerate(keys) if key not in held]
        with file.open("ab") as stream:
            stream.truncate(len(whole))

            def hear(index: int, made: Ask) -> list[Row]:
                ask, key = asks[missing[index]], keys[missing[index]]
                held[key] = {**ask, **made}
                stream.write(json.dumps([key, held[key]]).encode() + b"\n")
                stream.flush()
                os.fsync(stream.fileno())
                return [Row(ask["preset"], ask["seed"], result=str(made.get("result", "")))]

            tasks, there = [(asks[k],) for k in missing], len(keys) - len(missing)
            gathered(study.trial, tasks, hear, there, len(keys), progress=progress, workers=workers)
    return [held[key] for key in keys]
