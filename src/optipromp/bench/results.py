"""The folder of a run of the benchmark, its zip, and the zip executed once more.

==============================  ===================================================================
``run.json``                    entry, track, set, condition, variation, engines, version
``rows.csv``                    a row a scene and engine, as they come; a run goes on where it
                                ended, also with a larger ``count``
``motions/PRESET-SEED.npz``     trajectory (times, positions, velocities, accelerations), or joint
                                velocities of a policy by engine
``submission.zip``              all of these, once every scene is done
==============================  ===================================================================
"""

import csv
import io
import json
import platform
import zipfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import TypeAdapter, ValidationError

from optipromp.bench.running import (
    COLUMNS,
    ENGINES,
    STEADY,
    BenchRow,
    Engine,
    Exercise,
    again,
    row_of,
    rows_and_arrays,
)
from optipromp.bench.sets import SceneSet
from optipromp.bench.tracks import CONDITION, Track, check_entry, loaded
from optipromp.core.arrays import FloatArray
from optipromp.core.errors import InvalidRequestError
from optipromp.core.files import check_folder, json_text, write_atomically
from optipromp.core.scenes.values import suggest
from optipromp.laboratory.experiments.cluster import over
from optipromp.laboratory.experiments.conditions import CONDITIONS
from optipromp.laboratory.experiments.runs import source_version
from optipromp.laboratory.experiments.variations import VARIATIONS

RUN, ROWS, MOTIONS, ZIP = "run.json", "rows.csv", "motions", "submission.zip"
LARGEST = 1_000_000_000  # [byte] of a submission's content: 800 motions have 50 million


@dataclass(frozen=True)
class BenchRun:
    """A run of the benchmark.

    Attributes:
        entry: name, or MODULE:CLASS.
        track: one of :data:`optipromp.bench.tracks.TRACKS`.
        scenes: the set.
        condition: of :data:`optipromp.laboratory.experiments.conditions.CONDITIONS`.
        variation: of :data:`optipromp.laboratory.experiments.variations.VARIATIONS`; empty: none.
        engines: that execute. Conditions that move plants and variations are of ``arm`` alone.
        version: of the library, with a digest of its source.
        processor: kind of machine; other machines may differ in last bits.

    Raises:
        InvalidRequestError: an unknown condition or variation.
    """

    entry: str
    track: Track
    scenes: SceneSet
    condition: str = "none"
    variation: str = ""
    engines: tuple[Engine, ...] = ENGINES
    version: str = ""
    processor: str = ""

    def __post_init__(self) -> None:
        for name, value, valid in (
            ("condition", self.condition, tuple(CONDITIONS)),
            ("variation", self.variation, ("", *VARIATIONS)),
        ):
            if value not in valid:
                raise InvalidRequestError(f"{name} is {value!r}: {suggest(value, valid)}")

    @classmethod
    def of(
        cls, entry: str, track: Track, scenes: SceneSet, condition: str | None = None,
        variation: str = "",
    ) -> "BenchRun":  # fmt: skip
        """A run on this machine: the track's condition by default, and all engines that have it."""
        condition = CONDITION[track] if condition is None else condition
        both = condition in STEADY and not variation
        return cls(
            entry, track, scenes, condition, variation, ENGINES if both else ("arm",),
            source_version(), f"{platform.system()} {platform.machine()}",
        )  # fmt: skip

    def tasks(self) -> Iterator[Exercise]:
        """One for each scene."""
        for preset, seed in self.scenes.scenes():
            yield Exercise(
                self.entry, self.track, preset, seed, self.condition, self.variation, self.engines
            )


def run_bench(
    run: BenchRun,
    folder: Path,
    *,
    workers: int | None = None,
    ray: str | None = None,
    progress: Callable[[int, int, BenchRow | None], None] | None = None,
) -> list[BenchRow]:
    """Run the scenes that a folder does not hold yet; see :mod:`optipromp.bench.results`.

    Args:
        run: what to run.
        folder: of the results, made if need be.
        workers: processes; None: one a core.
        ray: address of a Ray cluster in place of them.
        progress: called with the number of scenes done, of all scenes, and the newest row.

    Returns:
        All rows, in the order of the set.

    Raises:
        InvalidRequestError: an unknown entry, or one without the track's methods; the folder
            cannot be written, or holds rows of another run; a process ended.
    """
    entry = loaded(run.entry)
    check_entry(entry, run.track)
    getattr(entry, "close", bool)()
    check_folder(folder)
    (folder / MOTIONS).mkdir(parents=True, exist_ok=True)
    _settle(run, folder / RUN)
    rows = read_rows(folder)
    done = {row.key for row in rows}
    tasks = [
        task for task in run.tasks()
        if not all((task.preset, task.seed, engine) in done for engine in task.engines)
    ]  # fmt: skip
    total = len(list(run.tasks()))
    if progress is not None:
        progress(total - len(tasks), total, None)
    count = total - len(tasks)

    def hear(index: int, result: Any) -> None:
        nonlocal count
        if isinstance(result, Exception):
            raise InvalidRequestError(f"{result}; begin again to go on")
        fresh, arrays = result
        task = tasks[index]
        write_atomically(folder / MOTIONS / _file(task), _packed(arrays))
        _append(folder / ROWS, [row for row in fresh if row.key not in done])
        rows.extend(fresh)
        count += 1
        if progress is not None:
            progress(count, total, fresh[0])

    over(rows_and_arrays, [(task,) for task in tasks], hear, workers=workers, ray=ray)
    held = {row.key: row for row in rows}
    ordered = [held[t.preset, t.seed, e] for t in run.tasks() for e in t.engines]
    _zipped(run, folder, ordered)
    return ordered


def _settle(run: BenchRun, path: Path) -> None:
    wanted = json.loads(json_text(asdict(run)))
    if path.exists():
        found = json.loads(path.read_text("utf-8"))
        fewer = found.get("scenes", {}).get("count", 0) < run.scenes.count
        more = {**found, "scenes": {**found.get("scenes", {}), "count": run.scenes.count}}
        if fewer and more == wanted:  # the first scenes of a set are those of a smaller one
            write_atomically(path, json_text(wanted).encode())
            return
        different = [name for name in wanted if found.get(name) != wanted[name]]
        if different:
            name = different[0]
            raise InvalidRequestError(
                f"{path.parent} holds a run with {name} {found.get(name)!r}, this one has "
                f"{wanted[name]!r}: choose another folder"
            )
    else:
        write_atomically(path, json_text(wanted).encode())


def _file(task: Exercise) -> str:
    return f"{task.preset}-{task.seed}.npz"


def _packed(arrays: Mapping[str, FloatArray]) -> bytes:
    stream = io.BytesIO()
    np.savez_compressed(stream, **arrays)  # type: ignore[arg-type]
    return stream.getvalue()


def _lines(rows: Iterable[BenchRow], header: bool) -> bytes:
    text = io.StringIO()
    table = csv.DictWriter(text, COLUMNS, lineterminator="\n")
    if header:
        table.writeheader()
    for row in rows:
        table.writerow(asdict(replace(row, cause=" ".join(row.cause.split()))))
    return text.getvalue().encode()


def _append(path: Path, rows: Sequence[BenchRow]) -> None:
    with path.open("ab") as stream:
        stream.write(_lines(rows, header=stream.tell() == 0))


def read_rows(folder: Path) -> list[BenchRow]:
    """The rows of a folder; a line that an interruption cut short is dropped.

    Raises:
        InvalidRequestError: something that is no row.
    """
    path = folder / ROWS
    content = path.read_bytes() if path.exists() else b""
    whole = content[: content.rfind(b"\n") + 1]
    if len(whole) < len(content):
        path.write_bytes(whole)
    return _parsed(whole, str(path))


def _parsed(content: bytes, where: str) -> list[BenchRow]:
    try:
        return [row_of(line) for line in csv.DictReader(io.StringIO(content.decode("utf-8")))]
    except (ValueError, KeyError, TypeError, csv.Error) as error:
        raise InvalidRequestError(f"{where} holds something that is no row: {error}") from None


def _zipped(run: BenchRun, folder: Path, rows: Sequence[BenchRow]) -> None:
    """All files with fixed dates and in a fixed order, so that equal runs are equal files."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_STORED) as file:

        def put(name: str, content: bytes) -> None:
            file.writestr(zipfile.ZipInfo(name, (2020, 1, 1, 0, 0, 0)), content)

        put(RUN, (folder / RUN).read_bytes())
        put(ROWS, _lines(rows, header=True))
        for task in run.tasks():
            put(f"{MOTIONS}/{_file(task)}", (folder / MOTIONS / _file(task)).read_bytes())
    write_atomically(folder / ZIP, stream.getvalue())


@dataclass(frozen=True)
class Verified:
    """A submission that was executed once more.

    Attributes:
        run: what it says that it is.
        rows: as submitted.
        changed: pairs of rows, submitted and now, that differ in more than times of thinking.
    """

    run: BenchRun
    rows: tuple[BenchRow, ...]
    changed: tuple[tuple[BenchRow, BenchRow], ...]


def verify(
    path: Path,
    *,
    workers: int | None = None,
    ray: str | None = None,
    progress: Callable[[int, int, BenchRow | None], None] | None = None,
) -> Verified:
    """Execute every motion of a submission again, and compare the rows bit for bit.

    The entry itself is not asked: what it did stands in the file, and so does what it saw, by the
    seeds. Of another kind of processor the last bits of forces may differ.

    Raises:
        InvalidRequestError: no submission, motions that are missing, or another library version.
    """
    run, rows, motions = submission(path)
    if run.version != source_version():
        raise InvalidRequestError(
            f"{path} is of version {run.version}, this is {source_version()}: install that one"
        )
    tasks = list(run.tasks())
    fresh: dict[tuple[str, int, str], BenchRow] = {}
    known = {row.key: row for row in rows}
    count = 0

    def hear(_: int, result: Any) -> None:
        nonlocal count
        if isinstance(result, Exception):
            raise InvalidRequestError(str(result))
        fresh.update({row.key: row for row in result})
        count += 1
        if progress is not None:
            progress(count, len(tasks), result[0] if result else None)

    jobs = [(task, motions[_file(task)]) for task in tasks]
    over(again, jobs, hear, workers=workers, ray=ray)
    changed = []
    for key, row in known.items():
        if row.result == "error" and not motions[f"{row.preset}-{row.seed}.npz"]:
            continue  # the entry raised an error: nothing to execute
        now = fresh.get(key)
        told = row if now is None or row.result != "refused" else replace(row, cause=now.cause)
        if now is None or now.judged() != told.judged():
            changed.append((row, now or replace(row, result="error", cause="not executed")))
    return Verified(run, tuple(rows), tuple(changed))


def submission(
    path: Path,
) -> tuple[BenchRun, list[BenchRow], dict[str, dict[str, FloatArray]]]:
    """Run, rows and motions of a submission's file.

    Raises:
        InvalidRequestError: the file is none, is too large, or lacks something.
    """
    try:
        with zipfile.ZipFile(path) as file:
            size = sum(each.file_size for each in file.infolist())
            if size > LARGEST:
                raise InvalidRequestError(f"{path} holds {size} bytes; at most {LARGEST}")
            run = TypeAdapter(BenchRun).validate_json(file.read(RUN))
            rows = _parsed(file.read(ROWS), f"{path}: {ROWS}")
            motions = {}
            for task in run.tasks():
                content = io.BytesIO(file.read(f"{MOTIONS}/{_file(task)}"))
                with np.load(content, allow_pickle=False) as arrays:
                    motions[_file(task)] = {
                        name: np.array(arrays[name], dtype=np.float64) for name in arrays.files
                    }
    except (OSError, zipfile.BadZipFile, KeyError, ValueError, ValidationError) as error:
        raise InvalidRequestError(f"{path} is no submission: {error}") from None
    wanted = {(t.preset, t.seed, e) for t in run.tasks() for e in t.engines}
    if {row.key for row in rows} != wanted or len(rows) != len(wanted):
        raise InvalidRequestError(f"{path}: rows and scenes differ")
    return run, rows, motions
