"""A study: presets × contenders × seeds on all cores, resumable, one row a trial.

One process appends each row, whole, to ``rows.csv``; a study that begins again in the same folder
runs what is missing. ``study.json`` holds the settings that all rows share; ``summary.json`` and
``study.png`` hold the results.
"""

import functools
import itertools
import json
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

from optipromp.core.errors import InvalidRequestError, installed_by, short
from optipromp.core.files import check_folder, is_file, json_text, write_atomically
from optipromp.core.output import ROWS
from optipromp.core.robots.library import NOTHING
from optipromp.looks.viewer.figures import png
from optipromp_bench.experiments.cluster import Progress, gathered
from optipromp_bench.experiments.rows import LOCK, Key, Row, RowFile, locked, source_version
from optipromp_bench.experiments.statistics import PlanCell, calibration, loop_summary
from optipromp_bench.experiments.trials import FOLDER, digests, run_trials, warm_up
from optipromp_bench.experiments.trials import Study as Study
from optipromp_sim.generate import PANDA

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

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
    check_folder(folder)
    folder.mkdir(parents=True, exist_ok=True)
    with locked(folder / LOCK):
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


COLOURS = {
    "straight": "#b0b5bd",
    "promp": "#8fa6c4",
    "i-promp": "#e0a458",
    "i-promp-guard": "#c9822b",
    "drift": "#b08fc4",
    "paper": "#7d5ba6",
    "obstacles": "#7fb28a",
    "chomp": "#4f8a5c",
    "opti-promp": "#1f5fb4",
    "open": "#b0b5bd",
    "closed": "#1f5fb4",
}

RATE = "promised and picked, nothing harmed [%]"
TITLE = "Promised and picked, 95 % intervals (Wilson); dots: executed although refused"
_BELOW: dict[str, Any] = {"loc": "upper center", "bbox_to_anchor": (0.5, -0.15)}


def write_results(rows: Sequence[Row], cells: Sequence[PlanCell], folder: Path) -> tuple[str, ...]:
    """Write ``summary.json`` and ``study.png``.

    Returns: The names of the files.
    """
    found = calibration(rows)
    document: dict[str, Any] = {
        "cells": [cell.to_dict() for cell in cells],
        "calibration": None if found is None else found.to_dict(),
    }
    if any(row.loop for row in rows):
        document["loops"] = [cell.to_dict() for cell in loop_summary(rows)]
    write_atomically(folder / "summary.json", json_text(document).encode("utf-8"))
    write_atomically(folder / "study.png", png(study_figure(cells)))
    return "summary.json", "study.png"


def study_figure(cells: Sequence[PlanCell]) -> "Figure":
    """Success rates by preset and planner with 95 % intervals, and the causes of failure."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11.0, 4.6), layout="constrained")
    rates, causes = figure.subplots(1, 2, width_ratios=(3, 2))
    many = len({cell.preset for cell in cells}) > 9  # variations: their names are long
    _rates(rates, cells, many)
    _causes(causes, cells)
    for axes in (rates, causes):
        axes.spines[["top", "right"]].set_visible(False)
    return figure


def _rates(axes: "Axes", cells: Sequence[PlanCell], level: bool) -> None:
    """Bars over the presets; ``level``: points beside the names of variations of the physics."""
    names = list(dict.fromkeys(cell.preset for cell in cells))
    planners = list(dict.fromkeys(cell.planner for cell in cells))
    width = (0.6 if level else 0.8) / len(planners)
    for i, planner in enumerate(planners):
        mine = [cell for cell in cells if cell.planner == planner]
        at = [names.index(cell.preset) + (i - 0.5 * (len(planners) - 1)) * width for cell in mine]
        rates, dots = [100 * c.rate for c in mine], [100 * c.successes / c.runs for c in mine]
        spans = [[100 * (c.rate - c.low) for c in mine], [100 * (c.high - c.rate) for c in mine]]
        own: dict[str, Any] = {"color": COLOURS.get(planner), "label": planner}
        if level:
            axes.errorbar(rates, at, xerr=spans, fmt="s", markersize=4.0, elinewidth=1.0, **own)
        else:
            lines = {"elinewidth": 1.0, "capsize": 2.0, "ecolor": "#333333"}
            axes.bar(at, rates, 0.9 * width, yerr=spans, error_kw=lines, **own)
        axes.plot(*((dots, at) if level else (at, dots)), "o", color="#333333", ms=2.5)
    if level:
        axes.set_yticks(range(len(names)), names)
        axes.grid(axis="y", linewidth=0.4, color="#dddddd")
        axes.invert_yaxis()
        runs = sorted({cell.runs for cell in cells})
        axes.set(xlim=(-2.0, 102.0), xlabel=f"{RATE}; {'–'.join(map(str, runs))} scenes each")
    else:
        of_each = (sorted({c.runs for c in cells if c.preset == name}) for name in names)
        counts = ("–".join(map(str, runs)) for runs in of_each)
        labels = [f"{name}\n{runs} scenes" for name, runs in zip(names, counts, strict=True)]
        axes.set_xticks(range(len(names)), labels)
        axes.set(ylim=(0.0, 105.0), ylabel=RATE)
    axes.set_title(TITLE, fontsize=10)
    axes.legend(frameon=False, fontsize=8, ncols=len(planners), **_BELOW)


def _causes(axes: "Axes", cells: Sequence[PlanCell]) -> None:
    planners = list(dict.fromkeys(cell.planner for cell in cells))
    counts = {planner: Counter[str]() for planner in planners}
    runs: Counter[str] = Counter()
    for cell in cells:
        counts[cell.planner].update(cell.causes)
        runs[cell.planner] += cell.runs
    causes = [cause for cause, _ in sum(counts.values(), Counter[str]()).most_common()]
    width = 0.8 / len(planners)
    for i, planner in enumerate(planners):
        y = [k + (i - 0.5 * (len(planners) - 1)) * width for k in range(len(causes))]
        share = [100.0 * counts[planner][cause] / runs[planner] for cause in causes]
        axes.barh(y, share, 0.9 * width, color=COLOURS.get(planner))
    axes.set_yticks(range(len(causes)), [cause.replace("_", " ") for cause in causes])
    axes.invert_yaxis()
    axes.set_xlabel("of all runs [%]")
    axes.set_title("Why runs failed: all causes", fontsize=10)
