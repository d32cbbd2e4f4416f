"""The folder of a run of the benchmark, its zip, and the zip executed once more.

==============================  ===================================================================
``run.json``                    entry and its digest, track, set, condition, variation, engines,
                                version, round; a digest in place of the word until all rows are
                                there, as the entry could read it
``rows.csv``                    a row a scene and engine, as they come, each signed by the word with
                                all before it; a run goes on where it ended, also with a larger
                                ``count``
``motions/PRESET-SEED.npz``     trajectory (times, positions, velocities, accelerations), or joint
                                velocities of a policy by engine
``round.json``                  the round of a run that was cut short, until it goes on
``submission.zip``              all of these, once every scene is done
``submission.verified.json``    what ``bench verify`` confirmed of the zip, by its SHA-256
==============================  ===================================================================
"""

import hashlib
import hmac
import io
import platform
import zipfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, nullcontext
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
from pydantic import TypeAdapter, ValidationError

from optipromp.core.errors import InvalidRequestError, check_one_of, is_name
from optipromp.core.files import (
    check_folder,
    is_folder,
    is_there,
    json_text,
    npz,
    read_bytes,
    read_npz,
    write_atomically,
)
from optipromp.core.output import ROWS
from optipromp.core.processes import cores
from optipromp_bench import tracks
from optipromp_bench.entrant import SERVED
from optipromp_bench.episode import ENGINES, Engine
from optipromp_bench.experiments.cluster import Progress, gathered
from optipromp_bench.experiments.rows import (
    BENCH,
    SIGNED,
    Key,
    Row,
    RowFile,
    lines_of,
    locked,
    rows_in,
    source_version,
)
from optipromp_bench.running import STEADY, Exercise, again, rows_and_arrays
from optipromp_bench.serve import dismissed, hide, hired, unread
from optipromp_bench.sets import DEVELOPMENT, Round, SceneSet, entry_digest
from optipromp_sim.situations import CONDITIONS, VARIATIONS

RUN, MOTIONS, ZIP, RECORD = "run.json", "motions", "submission.zip", ".verified.json"
LEFT = "round.json"
SAME = 1e-6  # [rad, 1/s, 1/s²] by which two motions are one: other processors, other last bits


@dataclass(frozen=True)
class BenchRun:
    """A run of the benchmark."""

    entry: str  # name, MODULE:CLASS or tcp:HOST:PORT
    track: tracks.Track  # one of TRACKS
    scenes: SceneSet  # the set
    condition: str = "none"  # of CONDITIONS
    # of VARIATIONS; empty: none
    variation: str = ""
    # that execute. Conditions that move plants and variations are of ``arm`` alone
    engines: tuple[Engine, ...] = ENGINES
    version: str = ""  # of the library, with a digest of its source
    processor: str = ""  # kind of machine; other machines may differ in last bits
    digest: str = ""  # of the entry's source; empty of tcp:
    # in which the set was drawn after the digest; None: the word was known before
    round: Round | None = None

    def __post_init__(self) -> None:
        check_one_of("condition", self.condition, CONDITIONS)
        check_one_of("variation", self.variation, ("", *VARIATIONS))
        for text in (self.entry, self.version or "-", self.processor or "-"):
            if not is_name(text):
                raise InvalidRequestError(f"{text[:60]!r} is no name: must be printable letters")
        engines = engines_of(self.condition, self.variation)
        if self.engines != engines:
            raise InvalidRequestError(
                f"engines are {', '.join(self.engines)}; {self.condition} {self.variation} has "
                f"{', '.join(engines)}"
            )
        if self.round is not None:
            self.round.check(self.entry, self.digest, self.version)
            if self.round.word != self.scenes.word:
                raise InvalidRequestError(
                    f"the set is of {self.scenes.word!r}; its round drew {self.round.word!r}"
                )

    @classmethod
    def of(
        cls, entry: str, track: tracks.Track, scenes: SceneSet, condition: str | None = None,
        variation: str = "", round: Round | None = None,
    ) -> "BenchRun":  # fmt: skip
        """A run on this machine: the track's condition by default, and all engines that have it."""
        condition = tracks.CONDITION[track] if condition is None else condition
        return cls(
            entry, track, scenes, condition, variation, engines_of(condition, variation),
            source_version(), f"{platform.system()} {platform.machine()}", entry_digest(entry),
            round,
        )  # fmt: skip

    def hidden(self) -> "BenchRun":
        """The run with SHA-256 of its word in place of the word, which is no secret if public."""
        word = self.scenes.word
        if word == DEVELOPMENT:
            return self
        word = hashlib.sha256(word.encode()).hexdigest()
        own = None if self.round is None else replace(self.round, word=word)
        return replace(self, scenes=replace(self.scenes, word=word), round=own)

    def tasks(self, patience: tracks.Patience = tracks.PATIENCE) -> Iterator[Exercise]:
        """One for each scene."""
        for preset, seed in self.scenes.scenes():
            yield Exercise(
                self.entry, self.track, preset, seed, self.condition, self.variation, self.engines,
                self.scenes.word, patience, self.digest,
            )  # fmt: skip


def engines_of(condition: str, variation: str) -> tuple[Engine, ...]:
    """Plants that move, and varied physics, are of ``arm`` alone."""
    return ENGINES if condition in STEADY and not variation else ("arm",)


@contextmanager
def staffed(
    entry: str, run: BenchRun, workers: int | None, patience: tracks.Patience = tracks.PATIENCE
) -> Iterator[None]:
    """Entries in processes that end with the context, within which nobody reads the word here.
    Raises InvalidRequestError where the entry cannot be made, or lacks the track's methods."""
    with unread(), ExitStack() as stack:
        stack.callback(dismissed)
        hired(entry, run.track, patience, run.digest).begin()
        if (workers or cores()) > 1:
            dismissed()  # each worker has its own
        yield


@contextmanager
def taken(run: BenchRun, folder: Path) -> Iterator[None]:
    """A run that is cut short leaves its round in the folder, once its entries have ended, and
    takes the file away before it goes on, so that no entry of it ever meets the word."""
    (folder / LEFT).unlink(missing_ok=True)
    try:
        yield
    except BaseException:
        if run.round is not None:
            write_atomically(folder / LEFT, json_text(asdict(run.round)).encode())
        raise


def run_bench(
    run: BenchRun,
    folder: Path,
    *,
    workers: int | None = None,
    ray: str | None = None,
    progress: Progress | None = None,
    patience: tracks.Patience = tracks.PATIENCE,
) -> list[Row]:
    """Run the scenes that a folder does not hold yet; see :mod:`optipromp_bench.results`.

    ``folder``: of the results, made if need be. ``patience``: the time that the entry has for an
    answer. Others: see :func:`optipromp_bench.experiments.cluster.gathered`; an entry tcp: has
    one worker.

    Returns: All rows, in the order of the set.
    """
    check_folder(folder / MOTIONS)
    with ExitStack() as stack:
        stack.enter_context(locked(folder))
        (folder / MOTIONS).mkdir(exist_ok=True)
        _check_run(run, folder / RUN)
        stack.enter_context(taken(run, folder))
        stack.enter_context(staffed(run.entry, run, workers, patience))
        file = RowFile(folder, SIGNED, tracks.ROW_FILE)
        if _signed(run, file.rows) != file.rows:
            raise InvalidRequestError(
                f"{file.path} holds rows that this run did not write: choose another folder"
            )
        write_atomically(folder / RUN, json_text(asdict(run.hidden())).encode())
        done = {row.key for row in file.rows}
        all_ = list(run.tasks(patience))
        keys = [key for task in all_ for key in task.keys]
        tasks = [task for task in all_ if not done.issuperset(task.keys)]

        def hear(index: int, result: Any) -> list[Row]:
            arrays = npz(result[1], compressed=True)
            write_atomically(folder / MOTIONS / _file(tasks[index]), arrays)
            fresh = _signed(run, [row for row in result[0] if row.key not in done], file.rows)
            file.append(*fresh)
            return fresh

        jobs, there = [(task,) for task in tasks], len(done.intersection(keys))
        hands = _hands(run.entry, workers, ray)
        gathered(
            rows_and_arrays, jobs, hear, there, len(keys), progress=progress, prepare=hide,
            **hands,
        )  # fmt: skip
        held = {row.key: row for row in file.rows}
        ordered = [replace(held[key], sign="") for key in keys]
        write_atomically(folder / RUN, json_text(asdict(run)).encode())
        _zipped(run, folder, ordered)
    return ordered


def _hands(entry: str, workers: int | None, ray: str | None) -> dict[str, Any]:
    """Workers, or a cluster, for an entry; tcp: has one caller at a time."""
    return {"workers": 1} if entry.startswith(SERVED) else {"workers": workers, "ray": ray}


def _check_run(run: BenchRun, path: Path) -> None:
    if is_there(path):
        found = _run_of(read_bytes(path, InvalidRequestError, tracks.RUN_FILE), str(path))
        own = run if found.scenes.word == run.scenes.word else run.hidden()
        alike = replace(found, scenes=replace(found.scenes, count=own.scenes.count))
        if alike != own or found.scenes.count > own.scenes.count:  # a larger set begins alike
            name = next(f for f in vars(own) if getattr(found, f) != getattr(own, f))
            raise InvalidRequestError(
                f"{path.parent} holds a run with {name} {getattr(found, name)!r}, this one has "
                f"{getattr(own, name)!r}: choose another folder"
            )


def _signed(run: BenchRun, rows: Sequence[Row], before: Sequence[Row] = ()) -> list[Row]:
    """Rows with their signs: HMAC by the word of a row's line and of the sign before it.

    Who has not the word, as the entry, changes no row of a folder.
    """
    out, sign = list[Row](), before[-1].sign if before else ""
    for row in rows:
        told = sign.encode() + lines_of([row], BENCH)
        sign = hmac.new(run.scenes.word.encode(), told, "sha256").hexdigest()
        out.append(replace(row, sign=sign))
    return out


def _run_of(content: bytes, where: str) -> BenchRun:
    """The run of a run.json's content."""
    try:
        return TypeAdapter(BenchRun).validate_json(content)
    except (ValidationError, InvalidRequestError) as error:
        told = tracks.words(str(error))
        raise InvalidRequestError(f"{where} holds no run of the benchmark: {told}") from None


def _file(task: Exercise) -> str:
    return f"{task.preset}-{task.seed}.npz"


def _zipped(run: BenchRun, folder: Path, rows: Sequence[Row]) -> None:
    """All files with fixed dates and in a fixed order, so that equal runs are equal files."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_STORED) as file:

        def put(name: str, content: bytes) -> None:
            file.writestr(zipfile.ZipInfo(name, (2020, 1, 1, 0, 0, 0)), content)

        put(RUN, (folder / RUN).read_bytes())
        put(ROWS, lines_of(rows, BENCH, header=True))
        for task in run.tasks():
            put(f"{MOTIONS}/{_file(task)}", (folder / MOTIONS / _file(task)).read_bytes())
    if len(content := stream.getvalue()) > tracks.SUBMISSION:
        told = f"{len(content)} bytes; at most {tracks.SUBMISSION}"
        raise InvalidRequestError(f"the submission of {folder} has {told}")
    write_atomically(folder / ZIP, content)


Means = Literal["entry", "motions", "no"]
"""How a submission was verified: the entry was asked again, its motions were executed again."""


@dataclass(frozen=True)
class Verified:
    """A submission that was executed once more."""

    run: BenchRun
    rows: tuple[Row, ...]  # as submitted
    changed: tuple[tuple[Row, Row], ...]  # submitted and now; they differ not in thought alone
    unconfirmed: tuple[Row, ...]  # rows without a motion, which the entry alone can confirm
    by: Means

    @property
    def confirmed(self) -> bool:
        """Whether every row was."""
        return not (self.changed or self.unconfirmed)


@dataclass(frozen=True)
class Record:
    """What a verification confirmed, in a file beside the submission; it is not signed."""

    sha256: str  # of the submission's file
    by: Means
    digest: str  # of the entry's source
    rows: int
    version: str
    processor: str


def verify(
    path: Path,
    *,
    entry: str | None = None,
    workers: int | None = None,
    ray: str | None = None,
    progress: Progress | None = None,
) -> Verified:
    """Execute a submission again and compare the rows bit for bit; leave a :class:`Record` of it.

    Without the ``entry`` its motions are executed: they do what the rows say, and whether the entry
    would make them is not known. With it, the entry is asked for every scene again. Causes of
    errors may differ, as they name addresses; so may the last bits of another kind of processor.
    Further arguments: see :func:`run_bench`.
    """
    run, rows, motion, sha256 = submission(path)
    if run.version != source_version():
        raise InvalidRequestError(
            f"{path} is of version {run.version}, this is {source_version()}: install that one"
        )
    if entry is not None:
        digest = entry_digest(entry)
        if digest != run.digest:
            raise InvalidRequestError(
                f"entry {entry!r} has the digest {digest[:12] or 'none'}, the submission's has "
                f"{run.digest[:12] or 'none'}: give the entry as it was submitted"
            )
    tasks = [replace(task, entry=entry or "") for task in run.tasks()]
    fresh: dict[Key, Row] = {}

    submitted = {row.key: row for row in rows}

    def hear(index: int, made: list[Row]) -> list[Row]:
        fresh.update({row.key: row for row in made})
        return [submitted[key] for key in tasks[index].keys]  # also of what was refused

    call = again if entry is None else asked_again
    with nullcontext() if entry is None else staffed(entry, run, workers):
        hands = _hands(entry or "", workers, ray)
        jobs = _Jobs(tasks, motion)
        hidden = None if entry is None else hide
        gathered(call, jobs, hear, 0, len(rows), progress=progress, prepare=hidden, **hands)
    changed, unconfirmed = [], []
    for row in rows:
        now = fresh.get(row.key)
        if now is None and row.result in ("refused", "error"):
            unconfirmed.append(row)
            continue
        now = now or replace(row, result="error", cause="not executed")
        told = replace(row, cause=now.cause) if row.result == now.result == "error" else row
        if now.judged() != told.judged():
            changed.append((row, now))
    by: Means = "motions" if entry is None else "entry"
    made = Verified(run, tuple(rows), tuple(changed), tuple(unconfirmed), by)
    beside = path.with_suffix(RECORD)
    if made.confirmed and recorded(path, sha256, run) != "entry":
        record = Record(sha256, by, run.digest, len(rows), run.version, run.processor)
        write_atomically(beside, json_text(asdict(record)).encode())
    elif made.changed:
        beside.unlink(missing_ok=True)
    return made


def asked_again(task: Exercise, content: bytes, where: str) -> list[Row]:
    """The rows of an entry that is asked again, if its motion is the one of the content."""
    rows, arrays = rows_and_arrays(task)
    told = read_npz(where, content=content, most=tracks.MOTION_FILE)
    if told.keys() == arrays.keys() and all(
        np.shape(told[k]) == np.shape(each) and np.allclose(told[k], each, rtol=0.0, atol=SAME)
        for k, each in arrays.items()
    ):
        return rows
    # a digest that no row has, so that all of them differ
    return [replace(row, digest="", cause=f"another motion: {row.cause}") for row in rows]


def recorded(path: Path, sha256: str, run: BenchRun) -> Means:
    """How the submission of a path was verified, by the record beside it."""
    try:
        content = read_bytes(path.with_suffix(RECORD), InvalidRequestError, tracks.RUN_FILE)
        record = TypeAdapter(Record).validate_json(content)
    except (ValidationError, InvalidRequestError):
        return "no"
    wanted = (sha256, run.digest, run.version)
    return record.by if (record.sha256, record.digest, record.version) == wanted else "no"


def zip_of(path: Path) -> Path:
    """The submission of a run's folder, or the path itself."""
    return path / ZIP if is_folder(path) else path


class Submission(NamedTuple):
    """What a submission's file holds."""

    run: BenchRun
    rows: list[Row]
    motion: Callable[[Exercise], bytes]  # the content of a scene's file, unpacked when asked for
    sha256: str


class _Jobs(Sequence[tuple[Exercise, bytes, str]]):
    """Of a verification: scene, its motion, and where that is; one motion at a time is unpacked."""

    def __init__(self, tasks: Sequence[Exercise], motion: Callable[[Exercise], bytes]) -> None:
        self._tasks, self._motion = tasks, motion

    def __len__(self) -> int:
        return len(self._tasks)

    def __getitem__(self, index: Any) -> Any:
        task = self._tasks[index]
        return task, self._motion(task), f"{MOTIONS}/{_file(task)}"


def submission(path: Path) -> Submission:
    """A submission's file, whose motions are not unpacked."""
    content = read_bytes(path, InvalidRequestError, tracks.SUBMISSION)
    sizes = {RUN: tracks.RUN_FILE, ROWS: tracks.ROW_FILE}

    def held(name: str, whole: bool = True) -> bytes:
        with _unpacking(path):
            told = file.getinfo(name)
            if told.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
                raise ValueError(f"{name} is packed as {told.compress_type}; must be deflated")
            most = sizes.get(name, tracks.MOTION_FILE)
            if told.file_size > most:
                raise ValueError(f"{name} has {told.file_size} bytes; at most {most}")
            return file.read(told) if whole else b""

    with _unpacking(path):
        if content.count(b"PK\x01\x02") > tracks.MEMBERS:
            raise ValueError(f"more than {tracks.MEMBERS} files")
        file = zipfile.ZipFile(io.BytesIO(content))
    run, table = _run_of(held(RUN), f"{path}: {RUN}"), held(ROWS)
    keys = {key for task in run.tasks() for key in task.keys}
    if table.count(b"\n") > len(keys) + 1:
        raise InvalidRequestError(f"{path}: {ROWS} has more lines than the set has rows")
    rows = rows_in(table, f"{path}: {ROWS}", BENCH)
    for task in run.tasks():
        held(f"{MOTIONS}/{_file(task)}", whole=False)
    if {row.key for row in rows} != keys:
        raise InvalidRequestError(f"{path}: rows and scenes differ")
    sha256 = hashlib.sha256(content).hexdigest()
    return Submission(run, rows, lambda task: held(f"{MOTIONS}/{_file(task)}"), sha256)


@contextmanager
def _unpacking(path: Path) -> Iterator[None]:
    try:
        yield
    except Exception as error:  # zipfile and zlib raise whatever goes wrong in them
        raise InvalidRequestError(f"{path} is no submission: {tracks.words(str(error))}") from None
