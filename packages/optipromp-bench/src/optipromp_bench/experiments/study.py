"""A study: presets × contenders × seeds on all cores, resumable, one row a trial.

One process appends each row, whole, to ``rows.csv``; a study that begins again in the same folder
runs what is missing. ``study.json`` holds the settings that all rows share; ``summary.json`` and
``study.svg`` hold the results.
"""

import functools
import itertools
import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from optipromp.core.errors import InvalidRequestError, installed_by, short
from optipromp.core.files import check_folder, is_file, json_text, write_atomically
from optipromp.core.output import ROWS
from optipromp.core.robots.library import NOTHING
from optipromp_bench.experiments.cluster import Progress, gathered
from optipromp_bench.experiments.forest import Panels, Share, forest
from optipromp_bench.experiments.rows import Key, Row, RowFile, locked, source_version
from optipromp_bench.experiments.statistics import PlanCell, calibration, loop_summary, summary
from optipromp_bench.experiments.trials import FOLDER, digests, run_trials, warm_up
from optipromp_bench.experiments.trials import Study as Study
from optipromp_sim.generate import PANDA

SETTINGS = "study.json"


def run_study(
    study: Study,
    folder: Path,
    *,
    workers: int | None = None,
    ray: str | None = None,
    progress: Progress | None = None,
) -> list[Row]:
    """Run the trials of a study that its folder does not hold yet.

    Ctrl-C lets the scenes under way finish, keeps their rows and raises ``KeyboardInterrupt``.

    ``folder``: holds the rows of earlier calls, and gets the new ones. ``workers``, ``ray``,
    ``progress``: see :func:`optipromp_bench.experiments.cluster.gathered`.

    Returns: The study's rows, those of earlier calls too, in the study's order.
    """
    if workers is not None and workers < 1:
        raise InvalidRequestError(f"workers is {workers}; it must be at least 1")
    if find_spec("mujoco") is None:
        raise InvalidRequestError(f"a study needs MuJoCo: {installed_by('optipromp-sim')}")
    with locked(folder):
        file = row_file(study, folder)
        done = {row.key for row in file.rows}
        keys = study.keys()
        missing = [key for key in keys if key not in done]

        def hear(_: int, made: Sequence[Row]) -> Iterator[Row]:
            for row in made:
                if row.key not in done:
                    file.append(row)
                    yield row

        gathered(
            run_trials, _jobs(study, missing), hear, len(keys) - len(missing), len(keys),
            progress=progress, workers=workers, ray=ray,
            prepare=functools.partial(warm_up, study.source(study.presets[0]), study),
        )  # fmt: skip
        held = {row.key: row for row in file.rows}
        return [held[key] for key in keys]


def _jobs(study: Study, missing: Sequence[Key]) -> list[tuple[Any, ...]]:
    """The arguments of :func:`run_trials` for the missing rows of each scene and condition."""
    return [
        (
            study, *scene,
            tuple(dict.fromkeys(loop or planner for _, _, planner, _, loop, *_ in group)),
            source_version(),
        )
        for scene, group in itertools.groupby(missing, key=lambda key: (key[0], key[1], key[5]))
    ]  # fmt: skip


def row_file(study: Study, folder: Path) -> RowFile:
    """The open file of a study's rows in a folder, which refuses rows of another study."""
    check_folder(folder)
    path, wanted = folder / SETTINGS, study.common()
    if not (folder / ROWS).exists():
        write_atomically(path, json_text(wanted).encode())
        return RowFile(folder)
    try:
        held = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise InvalidRequestError(
            f"{folder / ROWS} is there and {path.name} beside it cannot be read ({error}): choose "
            "another folder"
        ) from None
    for name in dict.fromkeys((*wanted, *held)):  # a default may be left out of either
        if name != FOLDER and held.get(name) != wanted.get(name):
            raise InvalidRequestError(
                f"{folder} holds rows with {name} {short(held.get(name))}, this study has "
                f"{short(wanted.get(name))}: choose another folder"
            )
    return RowFile(folder)


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


def write_results(rows: Sequence[Row], folder: Path) -> None:
    """Write ``summary.json`` and ``study.svg``."""
    found, cells = calibration(rows), summary(rows)
    document: dict[str, Any] = {
        "cells": [cell.to_dict() for cell in cells],
        "calibration": None if found is None else found.to_dict(),
    }
    if any(row.loop for row in rows):
        document["loops"] = [cell.to_dict() for cell in loop_summary(rows)]
    write_atomically(folder / "summary.json", json_text(document).encode("utf-8"))
    write_atomically(folder / "study.svg", study_picture(cells))


def study_picture(cells: Iterable[PlanCell]) -> bytes:
    """SVG: what became of the plans of each preset and planner, with 95 % intervals (Wilson)."""
    shares: Panels = {}
    for c in cells:
        counts = {
            "promised and picked": (c.kept, c.runs), "broken promises": (c.broken, c.plans),
            "picked, if refusals are not heeded": (c.successes, c.runs),
        }  # fmt: skip
        for panel, (count, of) in counts.items():
            if of:
                lines = shares.setdefault(panel, {}).setdefault(f"{c.preset}, {c.planner}", {})
                lines[""] = Share.of(count, of)
    return forest(shares).encode()
