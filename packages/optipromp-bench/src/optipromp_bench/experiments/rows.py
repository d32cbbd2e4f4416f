"""Rows: one trial each, of a study or of the benchmark, and the file that they come to as they end.

``rows.csv`` is whole after every row, so a run that was interrupted goes on where it ended.
"""

import csv
import functools
import hashlib
import io
import os
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import KW_ONLY, dataclass, fields
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path
from types import NoneType
from typing import Any, Literal, get_args, get_type_hints

from pydantic import BaseModel, create_model

from optipromp.core.errors import InvalidRequestError
from optipromp.core.files import LARGEST_ARRAYS, check_folder, is_there, read_bytes
from optipromp.core.output import ROWS

NO_PLAN = "no_plan"
"""Cause of a trial that was not executed because there was no plan to execute."""
ERROR = "error"
"""Cause of a trial that raised an error; its message is the error's."""
PACKAGES = (
    "optipromp", "optipromp_bench", "optipromp_eyes", "optipromp_loop", "optipromp_paper",
    "optipromp_sim",
)  # fmt: skip
"""The packages whose source decides what a row says."""

Key = tuple[str, int, str, str, str, str, str]
Columns = Sequence[str]
"""Names in the order of a file."""


@dataclass(frozen=True)
class Row:
    """One trial: which one, how it ended, and what was measured; None: it was not measured."""

    preset: str  # of the scene, as the seed; a scene file's name stands for a preset
    seed: int
    _: KW_ONLY
    planner: str = ""  # see trials.study_planners; empty in the benchmark: rows are of one entry
    noise_position: float = 0.0  # standard deviation of detected positions [m]
    noise_angle: float = 0.0  # the same of stem directions [degrees]
    pushables: int = 0  # in the scene
    redraws: int = 0  # impossible scenes sampled before this one
    plan_status: str = ""  # code of the plan; of a loop, success: it said that it was done
    success: bool = False  # whether the target alone was picked and nothing was harmed
    cause: str = ""  # the first cause of a failure
    message: str = ""  # the outcome in words
    picked: bool | None = None  # whether the target was in the tool at the end; None: not executed
    # success by the definition of 0.3.0: a stem bears 2 N; None: as ``success``
    success_before: bool | None = None
    swallowed: str = ""  # ids of other objects in the tool at the end, separated by spaces
    unripe_force: float | None = None  # largest on any object but the target [N]
    target_force: float | None = None  # largest on the target [N]
    static_force: float | None = None  # largest of arm or tool on static objects [N]
    torn: str = ""  # ids of fruits that came off, separated by spaces
    stem_force: float | None = None  # largest of arm or tool on a stem [N]
    duration: float | None = None  # of the executed motion [s]
    predicted_harm: float | None = None  # of the plan's push; None where no push model applies
    predicted_failure: float | None = None  # probability that the pick is not clean; likewise
    tilt: float = 0.0  # angle between the planner's approach and the scene's [degrees]
    plan_time: float = 0.0  # wall time of planning [s]
    simulation_time: float = 0.0  # wall time of the execution [s]
    version: str = ""  # of the library, with a digest of its source
    variation: str = ""  # see situations
    noise: str = ""  # name in NOISES; empty: none
    causes: str = ""  # all causes, separated by spaces
    loop: str = ""  # one of loops.LOOPS; empty without a loop
    condition: str = ""  # see situations; may be one of eyes.WAYS
    # clean, harmed, missed (nothing was harmed, nothing picked), gave_up, refused (not executed)
    # or error; empty where planners are compared
    result: str = ""
    retreats: int | None = None
    looks: int | None = None  # that reached the controller
    cycle_median: float | None = None  # wall time of the controller's cycles [s]
    cycle_p99: float | None = None
    nis: float | None = None  # mean normalised innovation squared; 3 where covariances are true
    worst_jump: float | None = None  # of a joint at a takeover: position, velocity, ... [SI]
    worst_limit: float | None = None  # largest share of a limit of velocity, acceleration or jerk
    finder: str = ""  # of eyes; empty without eyes, as all below
    views: int | None = None  # least number of pictures before a plan
    pictures: int | None = None  # before a plan
    visible: int | None = None  # fruits of which enough showed on these; counted in each
    found: int | None = None  # of the visible fruits
    false: int | None = None  # detections that no fruit matches
    see_time: float | None = None  # processor time of seeing these pictures [s]
    # of the benchmark alone:
    digest: str = ""  # of the scene
    engine: str = ""  # that executed the motion
    force: float | None = None  # largest on any fruit but the target [N]
    thought: float = 0.0  # wall time of the entry [s]; of a policy, the median of a call
    sign: str = ""  # of this row and all before it in a folder; see optipromp_bench.results

    @property
    def key(self) -> Key:
        """By which a row is unique in its file."""
        return (
            self.preset, self.seed, self.planner, self.variation, self.loop, self.condition,
            self.engine,
        )  # fmt: skip

    def judged(self) -> Mapping[str, Any]:
        """A benchmark's row but for the times that differ from machine to machine."""
        return {name: getattr(self, name) for name in BENCH if name != "thought"}


BENCH: Columns = (
    "preset", "seed", "digest", "engine", "result", "picked", "cause", "force", "duration",
    "thought",
)  # fmt: skip
SIGNED: Columns = (*BENCH, "sign")
STUDY: Columns = tuple(
    each.name
    for each in fields(Row)
    if each.name not in ("digest", "engine", "force", "thought", "sign")
)
NEEDED: Columns = STUDY[: STUDY.index("success")]
"""Columns that even the oldest rows of a study have."""
_KINDS = get_type_hints(Row)
_OF_BENCH = {"result": Literal["clean", "harmed", "missed", "refused", "error"], "picked": bool}


@functools.cache
def _line(columns: Columns) -> type[BaseModel]:
    """What reads the cells of one line."""
    if columns is not STUDY:
        cells: Any = {name: (_OF_BENCH.get(name, _KINDS[name]), ...) for name in columns}
    else:
        cells = {
            each.name: (_KINDS[each.name], ... if each.name in NEEDED else each.default)
            for each in fields(Row)
            if each.name in STUDY
        }
    return create_model("Row", **cells)


def row_of(texts: Mapping[str, str], columns: Columns = STUDY) -> Row:
    """A row from its CSV cells; older rows have fewer columns."""
    values: dict[str, Any] = {name: texts[name] for name in columns if name in texts}
    for name in values:
        if NoneType in get_args(_KINDS[name]):
            values[name] = values[name] or None
    return Row(**_line(columns).model_validate(values).model_dump())


def rows_in(content: bytes, where: object, columns: Columns = STUDY) -> list[Row]:
    """The rows of a file's content; refuses what is no row, and a trial that stands twice."""
    try:
        table = csv.DictReader(io.StringIO(content.decode("utf-8")))
        rows = [row_of(line, columns) for line in table]
    except (ValueError, KeyError, TypeError, AttributeError, csv.Error) as error:
        raise InvalidRequestError(f"{where} holds something that is no row: {error}") from None
    counts = Counter(row.key for row in rows)
    if len(counts) < len(rows):
        (key, count), *_ = counts.most_common(1)
        told = ", ".join(str(part) for part in key if part != "")
        raise InvalidRequestError(f"{where} holds {count} rows of {told}: must hold one")
    return rows


def rows_of(folder: Path, columns: Columns = STUDY, most: int = LARGEST_ARRAYS) -> list[Row]:
    """The whole rows in a folder, oldest first; empty where there is no file."""
    path = folder / ROWS
    content = read_bytes(path, InvalidRequestError, most) if is_there(path) else b""
    return rows_in(content[: content.rfind(b"\n") + 1], path, columns)


def lines_of(rows: Iterable[Row], columns: Columns = STUDY, header: bool = False) -> bytes:
    """Rows as lines of a file, each text on one line."""
    text = io.StringIO()
    table = csv.DictWriter(text, columns, lineterminator="\n")
    if header:
        table.writeheader()
    for row in rows:
        values = {name: getattr(row, name) for name in columns}
        for name in {"message", "cause"} & values.keys():
            values[name] = " ".join(values[name].split())
        table.writerow(values)
    return text.getvalue().encode()


class RowFile:
    """The rows in a folder, which is there; a line that an interruption cut short is dropped."""

    def __init__(self, folder: Path, columns: Columns = STUDY, most: int = LARGEST_ARRAYS) -> None:
        self.path, self.columns = folder / ROWS, columns
        self.rows = rows_of(folder, columns, most)
        content = self.path.read_bytes() if self.path.exists() else b""
        whole = content.rfind(b"\n") + 1
        if whole < len(content):
            os.truncate(self.path, whole)
        if not whole:
            self._append(lines_of((), columns, header=True))

    def append(self, *rows: Row) -> None:
        """Append rows to the file, and wait until they are on disk."""
        self._append(lines_of(rows, self.columns))
        self.rows.extend(rows)

    def _append(self, content: bytes) -> None:
        try:
            with self.path.open("ab", buffering=0) as stream:
                stream.write(content)
                os.fsync(stream.fileno())
        except OSError as error:
            raise InvalidRequestError(f"cannot write {self.path}: {error.strerror}") from error


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Keep other processes out of a folder, where the system can lock files; make it if need be."""
    check_folder(folder)
    folder.mkdir(parents=True, exist_ok=True)
    try:
        with (folder / ".lock").open("ab") as file:
            if find_spec("fcntl") is not None:
                import fcntl

                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            yield
    except BlockingIOError:
        raise InvalidRequestError(
            f"another study writes into {folder}: wait for its end, or choose another folder"
        ) from None


@functools.lru_cache(maxsize=1)
def source_version() -> str:
    """The version, and a digest of :data:`PACKAGES`, by which rows of other code differ."""
    digest = hashlib.sha256()
    for package in PACKAGES:
        spec = find_spec(package)
        if spec is None or spec.origin is None:
            continue  # it is not installed
        root = Path(spec.origin).resolve().parent
        for path in sorted(root.rglob("*.py")):
            inside = path.relative_to(root)
            if inside.parts[0] not in ("cli", "commands", "looks"):  # they change no row
                digest.update(f"{package}/{inside.as_posix()}".encode())
                digest.update(path.read_bytes())
    try:
        version = metadata.version("optipromp")
    except metadata.PackageNotFoundError:  # run from its source
        version = "source"
    return f"{version}+{digest.hexdigest()[:10]}"
