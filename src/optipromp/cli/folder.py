"""``optipromp plan DIR``: a folder of scenes, on all cores, each plan into a folder of its own."""

import math
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from optipromp.cli.command import OK, Report, Shown, exit_code
from optipromp.cli.console import grid, progress_bar, say_if_compiling
from optipromp.cli.plan import Output, Request, failed_plan
from optipromp.core.errors import Code, InvalidRequestError, OptiPrompError
from optipromp.core.files import is_there
from optipromp.core.shown import printable

if TYPE_CHECKING:
    from rich.table import Table

    from optipromp.cli.robot import Named
    from optipromp.core.planning import Picked, Plan

_SUFFIXES = (".yaml", ".yml", ".json")


@dataclass(frozen=True)
class Entry:
    """A scene file, the folder of its plan, and the plan or the error."""

    file: Path
    out: Path | None
    result: "Plan | Picked | OptiPrompError"

    @property
    def status(self) -> Code:
        """The status of the plan, or the code of the error."""
        return self.result.code if isinstance(self.result, OptiPrompError) else self.result.status

    def to_dict(self, request: Request) -> dict[str, Any]:
        """The plan's document with the paths of its files; an error's has the same keys."""
        if isinstance(self.result, OptiPrompError):
            told = failed_plan(self.result, {"scene": self.file.stem, **vars(request)})
        else:
            told = self.result.to_dict()
        return {"file": str(self.file), "out": self.out and str(self.out), **told}


def scene_files(folder: Path) -> list[Path]:
    """The scene files in ``folder``, by name; robot files and plans are passed over."""
    from optipromp.cli.check import Kind, kind_of

    try:
        files = sorted(path for path in folder.iterdir() if path.suffix.lower() in _SUFFIXES)
    except OSError as error:
        raise InvalidRequestError(f"cannot read {folder}: {error.strerror or error}") from error
    kinds = [kind_of(str(path)) for path in files]
    scenes = [path for path, kind in zip(files, kinds, strict=True) if kind is Kind.SCENE]
    for path, kind in zip(files, kinds, strict=True):
        if kind is not Kind.SCENE:
            sys.stderr.write(f"passed over {printable(str(path))}: a {kind}, not a scene\n")
    if not scenes:
        hint = "; it holds a plan, for 'simulate'" if is_there(folder / "plan.json") else ""
        raise InvalidRequestError(f"no scene file ({', '.join(_SUFFIXES)}) in {folder}{hint}")
    return scenes


def outputs(files: Sequence[Path], folder: Path) -> list[Path]:
    """A folder for the plan of each file: its stem, or its whole name where two share a stem."""
    stems = [path.stem for path in files]
    return [folder / (path.name if stems.count(path.stem) > 1 else path.stem) for path in files]


def plan_folder(
    folder: Path,
    request: Request,
    output: Output,
    named: "Named",
    workers: int | None = None,
    progress: bool | None = None,
) -> Report:
    """Plan every scene in ``folder``, with the robot that is named, and write each plan."""
    from optipromp.core.planning import plan_many
    from optipromp.core.planning.legs import Picked
    from optipromp.core.scenes.io import load_scene

    files, out = scene_files(folder), output.out
    homes: Sequence[Path | None] = [None] * len(files) if out is None else outputs(files, out)
    say_if_compiling(progress)
    began = time.perf_counter()
    done_so_far, good = 0, 0
    with progress_bar(10, progress) as shown:

        def done(index: int, result: "Plan | Picked | OptiPrompError") -> None:
            nonlocal done_so_far, good
            home = homes[index]
            if home is not None and not isinstance(result, OptiPrompError):
                if isinstance(result, Picked):
                    output.write_legs(result, home, figures=False)
                else:
                    output.write(result, home)
            done_so_far, good = done_so_far + 1, good + getattr(result, "success", False)
            words = f"{done_so_far} of {len(files)} planned, {good} succeeded"
            shown(done_so_far, len(files), words)

        stated = [named.of(load_scene(file)) for file in files] if named else files
        results = plan_many(stated, workers=workers, legs=True, progress=done, **vars(request))
    seconds = time.perf_counter() - began
    entries = [Entry(*item) for item in zip(files, homes, results, strict=True)]
    succeeded = sum(entry.status is Code.SUCCESS for entry in entries)
    document = {
        "folder": str(folder),
        "succeeded": succeeded,
        "of": len(entries),
        "seconds": seconds,
        "scenes": [entry.to_dict(request) for entry in entries],
    }
    code = max((exit_code(entry.status) for entry in entries), default=OK)
    return Report(document, _shown(entries, succeeded, seconds, out), code)


def _shown(entries: Sequence[Entry], succeeded: int, seconds: float, out: Path | None) -> Shown:
    yield table(entries)
    yield f"{succeeded} of {len(entries)} plans succeeded, in {seconds:.1f} s"
    if out is not None:
        yield f"wrote a folder for each plan to {out}"


def table(entries: Sequence[Entry]) -> "Table":
    """The status and the main figures of each scene; the motion is that of all its legs."""
    from optipromp.core.planning.legs import Picked

    out = grid(("scene", "status"), ("time, ms", "room, mm", "off, mm", "motion, s"))
    for entry in entries:
        cells = ["", "", "", ""]
        if not isinstance(entry.result, OptiPrompError):
            made = entry.result
            reach = made.reach if isinstance(made, Picked) else made
            m = reach.metrics
            rooms = m.clearance_static, m.clearance_avoid, m.clearance_pushable, m.clearance_self
            room = min((value for value in rooms if value is not None), default=math.inf)
            cells = [
                f"{1e3 * reach.time['total']:.0f}",
                f"{1e3 * room:.1f}" if math.isfinite(room) else "–",
                f"{1e3 * m.goal_error:.2f}",
                f"{made.duration if isinstance(made, Picked) else m.duration:.2f}",
            ]
        out.add_row(printable(entry.file.stem), str(entry.status), *cells)
    return out
