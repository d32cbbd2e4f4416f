"""The files of a study beside its rows: ``summary.json`` and ``study.png``."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from optipromp.core.files import json_text, write_atomically
from optipromp.laboratory.experiments.rows import Row
from optipromp.laboratory.experiments.statistics import Cell, calibration, loop_summary
from optipromp.looks.viewer.figures import png

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

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
    "looks": "#8fa6c4",
    "closed": "#1f5fb4",
}

RATE = "promised and picked, nothing harmed [%]"
TITLE = "Promised and picked, 95 % intervals (Wilson); dots: executed although refused"
_BELOW: dict[str, Any] = {"loc": "upper center", "bbox_to_anchor": (0.5, -0.15)}


def write_results(rows: Sequence[Row], cells: Sequence[Cell], folder: Path) -> tuple[str, ...]:
    """Write ``summary.json`` and ``study.png``.

    Returns: The names of the files.
    """
    found = calibration(rows)
    document: dict[str, Any] = {
        "cells": [cell.to_dict() for cell in cells],
        "calibration": None if found is None else asdict(found),
    }
    if any(row.loop for row in rows):
        document["loops"] = [cell.to_dict() for cell in loop_summary(rows)]
    write_atomically(folder / "summary.json", json_text(document).encode("utf-8"))
    write_atomically(folder / "study.png", png(study_figure(cells)))
    return "summary.json", "study.png"


def study_figure(cells: Sequence[Cell]) -> "Figure":
    """Success rates by preset and planner with 95 % intervals, and the causes of failure."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11.0, 4.6), layout="constrained")
    rates, causes = figure.subplots(1, 2, width_ratios=(3, 2))
    many = len({cell.preset for cell in cells}) > 9  # variations: their names are long
    (_varied if many else _rates)(rates, cells)
    _causes(causes, cells)
    for axes in (rates, causes):
        axes.spines[["top", "right"]].set_visible(False)
    return figure


def _rates(axes: "Axes", cells: Sequence[Cell]) -> None:
    presets = list(dict.fromkeys(cell.preset for cell in cells))
    planners = list(dict.fromkeys(cell.planner for cell in cells))
    width = 0.8 / len(planners)
    for i, planner in enumerate(planners):
        mine = [cell for cell in cells if cell.planner == planner]
        x = [presets.index(cell.preset) + (i - 0.5 * (len(planners) - 1)) * width for cell in mine]
        spans = [[c.rate - c.low for c in mine], [c.high - c.rate for c in mine]]
        axes.bar(
            x, [100 * cell.rate for cell in mine], 0.9 * width, color=COLOURS.get(planner),
            yerr=[[100 * v for v in side] for side in spans], label=planner,
            error_kw={"elinewidth": 1.0, "capsize": 2.0, "ecolor": "#333333"},
        )  # fmt: skip
        axes.plot(x, [100 * c.successes / c.runs for c in mine], "o", color="#333333", ms=2.5)
    labels = []
    for preset in presets:
        runs = sorted({cell.runs for cell in cells if cell.preset == preset})
        labels.append(f"{preset}\n{'–'.join(map(str, runs))} scenes")
    axes.set_xticks(range(len(presets)), labels)
    axes.set_ylim(0.0, 105.0)
    axes.set_ylabel(RATE)
    axes.set_title(TITLE, fontsize=10)
    axes.legend(frameon=False, fontsize=8, ncols=len(planners), **_BELOW)


def _varied(axes: "Axes", cells: Sequence[Cell]) -> None:
    """A line for each variation of the physics, with a rate and its interval for each planner."""
    names = list(dict.fromkeys(cell.preset for cell in cells))
    planners = list(dict.fromkeys(cell.planner for cell in cells))
    for i, planner in enumerate(planners):
        mine = [cell for cell in cells if cell.planner == planner]
        beside = 0.6 * (i - 0.5 * (len(planners) - 1)) / len(planners)
        spans = [[c.rate - c.low for c in mine], [c.high - c.rate for c in mine]]
        axes.errorbar(
            [100 * cell.rate for cell in mine], [names.index(c.preset) + beside for c in mine],
            xerr=[[100 * v for v in side] for side in spans], fmt="s", markersize=4.0,
            elinewidth=1.0, color=COLOURS.get(planner), label=planner,
        )  # fmt: skip
        y = [names.index(cell.preset) + beside for cell in mine]
        axes.plot([100 * c.successes / c.runs for c in mine], y, "o", color="#333333", ms=2.5)
    axes.set_yticks(range(len(names)), names)
    axes.grid(axis="y", linewidth=0.4, color="#dddddd")
    axes.invert_yaxis()
    axes.set_xlim(-2.0, 102.0)
    axes.set_xlabel(f"{RATE}; {'–'.join(map(str, sorted({c.runs for c in cells})))} scenes each")
    axes.set_title(TITLE, fontsize=10)
    axes.legend(frameon=False, fontsize=8, ncols=len(planners), **_BELOW)


def _causes(axes: "Axes", cells: Sequence[Cell]) -> None:
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
