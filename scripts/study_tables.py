"""The tables of docs/studies.md, from the folders that `optipromp study` left.

    python scripts/study_tables.py FOLDER [FOLDER ...]               print the tables
    python scripts/study_tables.py --keep NAME FOLDER [FOLDER ...]   write docs/results/NAME.json
    python scripts/study_tables.py --pages                           write the tables of the page

Rows of several folders are taken together: a row for each preset, one for all, the reliability
table, and times to plan. A table of the page stands between ``<!-- table: KIND NAME ... -->`` and
``<!-- end of table -->``; KIND is ``rates``, ``reliability`` or ``overview``, NAME a kept result.
"""

import json
import re
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from optipromp.laboratory.experiments.rows import Row, rows_of
from optipromp.laboratory.experiments.statistics import Cell, calibration, summary

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "studies.md"
RESULTS = ROOT / "docs" / "results"
MARKED = re.compile(
    r"(?P<head><!-- table: (?P<kind>\w+) (?P<names>[\w ,-]+) -->\n).*?<!-- end of table -->",
    re.DOTALL,
)
Result = Mapping[str, Any]


def result(rows: Sequence[Row]) -> dict[str, Any]:
    """What the tables of a study need, as plain values."""
    together = [replace(row, preset="all", seed=k) for k, row in enumerate(rows)]
    found = calibration(rows)
    times = 1e3 * np.quantile([row.plan_time for row in rows], [0.5, 0.95])
    return {
        "versions": sorted({row.version for row in rows}),
        "cells": [cell.to_dict() for cell in summary(rows)],
        "all": summary(together)[0].to_dict(),
        "reliability": None if found is None else found.to_dict(),
        "plan_time_ms": [round(float(time), 1) for time in times],
        "tilted": sum(row.tilt > 0.1 for row in rows),
        "runs": len(rows),
    }


def kept(name: str) -> Result:
    """The kept result of this name."""
    found: Result = json.loads((RESULTS / f"{name}.json").read_text(encoding="utf-8"))
    return found


def _cell(values: Mapping[str, Any]) -> Cell:
    return Cell(values)


def rates(found: Result) -> list[str]:
    """Promised and picked by preset, the broken promises beside it."""
    out = [
        "| preset | promised and picked | % (95 %) | broken promises | % (95 %) | executed "
        "although refused | force on unripe, median / 90 % [N] | failed by |",
        "|---|---|---|---|---|---|---|---|",
    ]
    cells = [*map(_cell, found["cells"]), _cell(found["all"])]
    for c in cells[: 1 if len(cells) == 2 else None]:
        out.append(
            f"| {c.preset} | {c.kept} of {c.runs} | {100 * c.rate:.1f} ({100 * c.low:.0f}–"
            f"{100 * c.high:.0f}) | {c.broken} of {c.plans} | {100 * c.broken_rate:.1f} "
            f"({100 * c.broken_low:.0f}–{100 * c.broken_high:.0f}) | {c.successes} | "
            f"{c.unripe_force:.1f} / {c.unripe_force_90:.1f} | {c.failed_by} |"
        )
    return out


def reliability(found: Result) -> list[str]:
    """Predicted probabilities and what happened."""
    if found["reliability"] is None:
        return []
    out = [
        "| not clean, predicted | runs | mean | failed | % (95 %) |", "|---|---|---|---|---|",
    ]  # fmt: skip
    for b in found["reliability"]["bins"]:
        out.append(
            f"| {100 * b['low']:g} to {100 * b['high']:g} % | {b['runs']} | "
            f"{100 * b['predicted']:.1f} | {b['failures']} | {100 * b['rate']:.1f} "
            f"({100 * b['rate_low']:.0f}–{100 * b['rate_high']:.0f}) |"
        )
    return out


SCENES = {  # what a row of the overview is about, by the name of its result
    "clean": ("hanging fruits (four presets)", "exactly"),
    "noisy": ("hanging fruits (four presets)", "with errors of 5 mm and 5°"),
    "other": ("tight and long fruits", "exactly"),
    "plants": ("fruits, trusses and tissues of all kinds (`field`)", "exactly"),
    "shelf": ("packs on a shelf", "exactly"),
}


def overview(names: Sequence[str]) -> list[str]:
    """One row for each kept result."""
    out = [
        "| scenes | fruits are known | runs | promised and picked, % (95 %) | broken promises, % "
        "(95 %) | time to plan, median / 95 % |",
        "|---|---|---|---|---|---|",
    ]
    for name in names:
        found = kept(name)
        c = _cell(found["all"])
        times = (f"{t:.0f} ms" if t < 1000 else f"{t / 1000:.1f} s" for t in found["plan_time_ms"])
        out.append(
            f"| {' | '.join(SCENES[name])} | {c.runs} | {100 * c.rate:.1f} ({100 * c.low:.0f}–"
            f"{100 * c.high:.0f}) | {100 * c.broken_rate:.1f} ({100 * c.broken_low:.0f}–"
            f"{100 * c.broken_high:.0f}) | {' / '.join(times)} |"
        )
    return out


def page(text: str) -> str:
    """The page ``text`` with the tables of the kept results."""

    def table(match: re.Match[str]) -> str:
        names = match["names"].replace(",", " ").split()
        kind = match["kind"]
        if kind == "overview":
            lines = overview(names)
        else:
            lines = {"rates": rates, "reliability": reliability}[kind](kept(names[0]))
        return "\n".join([match["head"], *lines, "", "<!-- end of table -->"])

    return MARKED.sub(table, text)


def main(arguments: Sequence[str]) -> None:
    """Print, keep or write the tables."""
    if arguments == ["--pages"]:
        PAGE.write_text(page(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
        return
    name, folders = ("", arguments)
    if arguments[:1] == ["--keep"]:
        name, folders = arguments[1], arguments[2:]
    found = result([row for folder in folders for row in rows_of(Path(folder))])
    if name:
        RESULTS.mkdir(exist_ok=True)
        written = json.dumps(found, indent=1, ensure_ascii=False) + "\n"
        (RESULTS / f"{name}.json").write_text(written, encoding="utf-8")
        return
    print("\n".join([*rates(found), ""]))
    if found["reliability"] is not None:
        print(f"AUC {found['reliability']['auc']:.2f}\n")
        print("\n".join([*reliability(found), ""]))
    low, high = found["plan_time_ms"]
    print(f"time to plan, 50 and 95 %: {low:.0f} and {high:.0f} ms; "
          f"{found['tilted']} of {found['runs']} plans come at an angle")  # fmt: skip


if __name__ == "__main__":
    main(sys.argv[1:])
