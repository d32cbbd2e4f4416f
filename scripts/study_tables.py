"""The tables of studies and of submissions, of what they left in folders.

    python scripts/study_tables.py plans FOLDER PART ...     plans executed blind: studies
    python scripts/study_tables.py loops FOLDER PART PART    picks by two loops: studies
    python scripts/study_tables.py board FOLDER ENTRY ...    the benchmark: submissions of one set

Each part of ``FOLDER`` has the rows of one study; each entry one submission. A table stands under
its heading. A column whose head ends with ``(95 %)`` has shares in % with Wilson's intervals.
"""

import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from optipromp_bench import table as board_of
from optipromp_bench.experiments.rows import Row, rows_of
from optipromp_bench.experiments.statistics import (
    ALL,
    Cell,
    calibration,
    loop_summary,
    share,
    summary,
    tabled,
)
from optipromp_bench.results import submission, zip_of

DETECTED = "detected"  # the part of plans whose fruits are detected with errors
PREDICTED = "hanging", DETECTED, "shelf"  # parts for which predicted harm is told


# plans that are executed blind: in a folder for each part, the rows of a study


def plans(folder: Path, parts: Sequence[str]) -> str:
    """Of a study for each part."""
    return plans_told({part: studied(rows_of(folder / part)) for part in parts})


def studied(rows: Sequence[Row]) -> dict[str, Any]:
    """What the tables of plans need of a study."""
    found = calibration(rows)
    return {
        "cells": summary(rows),
        "all": summary([replace(row, preset="all", seed=k) for k, row in enumerate(rows)])[0],
        "reliability": None if found is None else found.to_dict(),
        "seconds": np.quantile([row.plan_time for row in rows], [0.5, 0.95]),
        "tilted": sum(row.tilt > 0.1 for row in rows),
    }


def plans_told(found: Mapping[str, Mapping[str, Any]]) -> str:
    """All parts in one line each, by preset, and what became of predicted harm."""
    overview, presets, bins = [], [], []
    for part, study in found.items():
        whole, predicted = study["all"], study["reliability"]
        overview.append([
            part, whole.runs, share(whole.kept, whole.runs, 1), share(whole.broken, whole.plans, 1),
            f"{study['tilted']} of {whole.runs}", f"{predicted['auc']:.2f}" if predicted else "–",
            " / ".join(f"{1e3 * t:.0f} ms" if t < 1 else f"{t:.1f} s" for t in study["seconds"]),
        ])  # fmt: skip
        presets += [
            [f"`{c.preset}`", "as detected" if part == DETECTED else "exactly",
             f"{c.kept} of {c.runs}", share(c.kept, c.runs, 1), f"{c.broken} of {c.plans}",
             share(c.broken, c.plans, 1), c.successes,
             f"{c.unripe_force:.1f} / {c.unripe_force_90:.1f}", c.failed_by]
            for c in study["cells"]
        ]  # fmt: skip
        bins += [
            [part, f"{100 * b['low']:g} to {100 * b['high']:g} %", b["runs"],
             f"{100 * b['predicted']:.1f}", share(b["failures"], b["runs"], 1)]
            for b in (predicted["bins"] if predicted and part in PREDICTED else ())
        ]  # fmt: skip
    kept, broken = "promised and picked, % (95 %)", "broken promises, % (95 %)"
    heads = "scenes", "runs", kept, broken, "at an angle", "AUC", "time to plan, median / 95 %"
    more = "executed although refused", "force on unripe, median / 90 % [N]", "failed by"
    return "\n".join([
        tabled("All", heads, overview),
        tabled("By preset", ["preset", "known", "picked", kept, "broken", broken, *more], presets),
        tabled(
            "Does predicted harm tell what happens?",
            ["scenes", "not clean, predicted", "runs", "mean", "failed, % (95 %)"], bins,
        ),
    ])  # fmt: skip


# picks by loops: in a folder for each way to pick, the rows of one study


def loops(folder: Path, parts: Sequence[str]) -> str:
    """Of a study of each of two loops."""
    rows = {part: rows_of(folder / part) for part in parts}
    cells = [(part, cell) for part in rows for cell in loop_summary(rows[part])]
    return loops_told(cells, pairs(*rows.items()))


def pairs(first: tuple[str, Sequence[Row]], second: tuple[str, Sequence[Row]]) -> list[list[Any]]:
    """How often one of two alone came to an end, of what both met; p by McNemar's exact test."""
    ends = [
        {(r.preset, r.seed, r.condition): r.result for r in rows} for _, rows in (first, second)
    ]
    both, out = sorted(ends[0].keys() & ends[1].keys()), []
    for condition in dict.fromkeys(key[2] for key in both):
        keys = [key for key in both if key[2] == condition]
        for end in ("clean", "harmed"):
            met = [(ends[0][key] == end, ends[1][key] == end) for key in keys]
            alone = (sum(a and not b for a, b in met), sum(b and not a for a, b in met))
            p = board_of.told_p(board_of.paired(met))
            out.append([f"`{condition}`", end, len(met), *alone, p])
    return out


def loops_told(cells: Sequence[tuple[str, Cell]], paired: list[list[Any]]) -> str:
    """By condition over all presets, and by preset over all conditions; pairs of both loops."""
    groups: dict[str, dict[tuple[str, str], list[Cell]]] = {}
    for part, c in cells:
        by, name = ("condition", c.condition) if c.preset == ALL else ("preset", c.preset)
        groups.setdefault(by, {}).setdefault((f"`{name}`", part), []).append(c)
    counts = "runs", "clean", "harmed", "gave_up", "missed", "refused"
    tables, causes = [], "failed by"
    for by, own in sorted(groups.items()):  # condition, preset
        names, rows = list(dict.fromkeys(name for name, _ in own)), []
        once = all(len(each) == 1 for each in own.values())  # a scene in several has no interval
        for name, part in sorted(own, key=lambda key: names.index(key[0])):
            n, clean, harmed, *lost = (
                sum(getattr(c, of) for c in own[name, part]) for of in counts
            )
            shares = [share(k, n) if once else f"{100 * k / n:.1f}" for k in (clean, harmed)]
            rows.append(
                [name, part, n, *shares, *lost, *(c.failed_by for c in own[name, part][:once])]
            )
        unit = "% (95 %)" if once else "%"
        heads = [by, "loop", "n", f"clean {unit}", f"harmed {unit}", "gave up", "missed", "refused"]
        tables.append(tabled(f"By {by}", [*heads, causes][: len(rows[0])], rows))
    if paired:
        heads = ["condition", "end", "met by both", "first alone", "second alone", "p"]
        tables.append(tabled("Open (first) and closed (second), in pairs", heads, paired))
    return "\n".join(tables)


# the benchmark


def board(folder: Path, entries: Sequence[str]) -> str:
    """Of the submission of each entry."""
    lost = {entry: torn(folder / entry) for entry in entries}
    heads = ["entry", *(f"{engine}: torn" for engine in lost[entries[0]])]
    rows = [[f"`{entry}`", *counts.values()] for entry, counts in lost.items()]
    told = board_told(board_of.leaderboard(folder / entry for entry in entries))
    return told + tabled(
        f"Torn or pulled too hard: `{entries[0]}` and those beside it", heads, rows
    )


def board_told(found: board_of.Leaderboard) -> str:
    """The tables of ``optipromp bench table`` under headings."""
    run = found.run
    where = f"Track `{run.track}`, condition `{run.condition}`"
    _, whole, _, presets = board_of.markdown(found).strip().split("\n\n")
    first = f"### {where}: {run.scenes.count} scenes of each preset\n\n{whole}\n"
    return f"{first}\n### {where}: clean, harmed by preset, %\n\n{presets}\n\n"


def torn(folder: Path) -> dict[str, int]:
    """How many runs of an entry tore a fruit or pulled it too hard, by engine."""
    run, rows, *_ = submission(zip_of(folder))
    causes = [(r.engine, r.cause) for r in rows if r.result == "harmed"]
    return {
        engine: sum(of == engine and ("torn" in why or "pulled" in why) for of, why in causes)
        for engine in run.engines
    }


def main() -> None:
    """See the module."""
    kinds = {"plans": plans, "loops": loops, "board": board}
    match sys.argv[1:]:
        case [kind, folder, *parts] if kind in kinds and parts:
            print(kinds[kind](Path(folder), parts))
        case _:
            sys.exit(str(__doc__))


if __name__ == "__main__":
    main()
