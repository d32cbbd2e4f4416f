"""``optipromp plan`` on a folder: every scene in it, on all cores."""

import math
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from optipromp.cli.console import (
    OK,
    exit_code,
    grid,
    print_json,
    progress_bar,
    say_if_compiling,
    stdout,
)
from optipromp.errors import Code, InvalidRequestError, OptiPrompError

if TYPE_CHECKING:
    from rich.table import Table

    from optipromp.planning import Plan

_SUFFIXES = (".yaml", ".yml", ".json")


@dataclass(frozen=True)
class Entry:
    """A scene file, where its plan goes, and what came of it."""

    file: Path
    out: Path | None
    result: "Plan | OptiPrompError"

    @property
    def status(self) -> Code:
        """The plan's, or the error's."""
        return self.result.code if isinstance(self.result, OptiPrompError) else self.result.status

    def to_dict(self) -> dict[str, Any]:
        """The plan's document with the names of its files; an error's has the same keys."""
        names = {
            "file": str(self.file),
            "out": None if self.out is None else str(self.out),
        }
        if not isinstance(self.result, OptiPrompError):
            return {**names, **self.result.to_dict()}
        return {
            **names, "scene": self.file.stem, "status": self.result.code,
            "message": self.result.message, "metrics": None, "terms": None, "time": None,
        }  # fmt: skip


def scene_files(folder: Path) -> list[Path]:
    """The scene files in ``folder``, by name; robot files and plans beside them are passed over.

    Raises:
        InvalidRequestError: there is none, or the folder cannot be read.
    """
    from optipromp.cli.kinds import Kind, kind_of

    try:
        files = sorted(path for path in folder.iterdir() if path.suffix.lower() in _SUFFIXES)
    except OSError as error:
        raise InvalidRequestError(f"cannot read {folder}: {error.strerror or error}") from error
    kinds = [kind_of(str(path)) for path in files]
    scenes = [path for path, kind in zip(files, kinds, strict=True) if kind is Kind.SCENE]
    for path, kind in zip(files, kinds, strict=True):
        if kind is not Kind.SCENE:
            sys.stderr.write(f"passed over {path}: a {kind}, not a scene\n")
    if not scenes:
        hint = "; it holds a plan, for 'simulate'" if (folder / "plan.json").exists() else ""
        raise InvalidRequestError(f"no scene file ({', '.join(_SUFFIXES)}) in {folder}{hint}")
    return scenes


def outputs(files: Sequence[Path], folder: Path) -> list[Path]:
    """A folder for the plan of each file: its stem, or its whole name where two share a stem."""
    stems = [path.stem for path in files]
    return [folder / (path.name if stems.count(path.stem) > 1 else path.stem) for path in files]


def plan_folder(
    folder: Path,
    out: Path | None,
    figures: bool,
    workers: int | None,
    as_json: bool,
    request: dict[str, Any],
) -> int:
    """Plan every scene in ``folder``; ``request`` is what :func:`plan_many` takes besides."""
    from optipromp.cli.plan import write
    from optipromp.planning import plan_many

    files = scene_files(folder)
    homes: Sequence[Path | None] = [None] * len(files) if out is None else outputs(files, out)
    say_if_compiling()
    began = time.perf_counter()
    done_so_far, good = 0, 0
    with progress_bar(10) as shown:

        def done(index: int, result: "Plan | OptiPrompError") -> None:
            nonlocal done_so_far, good
            home = homes[index]
            if home is not None and not isinstance(result, OptiPrompError):
                write(result, home, figures)
            done_so_far, good = done_so_far + 1, good + getattr(result, "success", False)
            words = f"{done_so_far} of {len(files)} planned, {good} succeeded"
            shown(done_so_far, len(files), words)

        results = plan_many(files, workers=workers, progress=done, **request)
    seconds = time.perf_counter() - began
    entries = [Entry(*item) for item in zip(files, homes, results, strict=True)]
    succeeded = sum(entry.status is Code.SUCCESS for entry in entries)
    if as_json:
        scenes = [entry.to_dict() for entry in entries]
        print_json({"folder": str(folder), "succeeded": succeeded, "of": len(entries),
                    "seconds": seconds, "scenes": scenes})  # fmt: skip
    else:
        console = stdout()
        console.print(table(entries))
        console.print(f"{succeeded} of {len(entries)} plans succeeded, in {seconds:.1f} s")
        if out is not None:
            console.print(f"wrote a folder for each plan to {out}", markup=False)
    return max((exit_code(entry.status) for entry in entries), default=OK)


def table(entries: Sequence[Entry]) -> "Table":
    """One line a scene: what came of it, and the figures that matter most."""
    out = grid(("scene", "status"), ("time, ms", "room, mm", "off, mm", "motion, s"))
    for entry in entries:
        cells = ["", "", "", ""]
        if not isinstance(entry.result, OptiPrompError):
            m = entry.result.metrics
            rooms = m.clearance_static, m.clearance_avoid, m.clearance_pushable, m.clearance_self
            room = min((value for value in rooms if value is not None), default=math.inf)
            cells = [
                f"{1e3 * entry.result.time['total']:.0f}",
                f"{1e3 * room:.1f}" if math.isfinite(room) else "–",
                f"{1e3 * m.goal_error:.2f}",
                f"{m.duration:.2f}",
            ]
        out.add_row(entry.file.stem, str(entry.status), *cells)
    return out
