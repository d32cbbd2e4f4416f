"""How each published result is kept and shown; ``scripts/publish.py`` has the commands.

A kind of result is a function of the folder that its commands left and of its row in
``scripts/publish.toml``. It gives *figures*, plain values for ``docs/results/NAME.json``.
:func:`shown` makes texts of figures, by name: a table, or words for a cell or a sentence.
"""

import itertools
import json
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from optipromp.bench import table as board_of
from optipromp.bench.results import submission, zip_of
from optipromp.laboratory.experiments.rows import Row, rows_of
from optipromp.laboratory.experiments.statistics import (
    ALL,
    Cell,
    calibration,
    loop_summary,
    percent,
    summary,
    wilson,
)

Figures = dict[str, Any]
Texts = dict[str, str]  # of a result, by key
CONDITIONS = {  # of the closed loop, in words
    "none": "as seen", "zero-mean": "errors of 5 mm, 5°", "detector": "bias, misses, swaps",
    "missed": "a neighbour not seen at first", "lower": "10 mm lower",
    "aside": "15 mm aside, then a jump of 10 mm", "sway": "roots sway ± 10 mm",
    "calibration": "camera 5 mm, 1° off", "limp": "stems softer than told",
    "near": "a camera blind below 7 cm", "frozen": "a picture that stands still",
    "early": "stamps too early", "breaks": "the target's stem breaks",
    "larger": "fruits 15 % larger", "gust": "sway that falls and rises",
    "stiff": "stems five times stiffer", "all": "seven of them at once",
}  # fmt: skip


def table(columns: Sequence[str], rows: Sequence[Sequence[Any]]) -> str:
    """A table of a page."""
    lines = ["|".join(["", *(f" {cell} " if cell != "" else " " for cell in cells), ""])
             for cells in (columns, *rows)]  # fmt: skip
    return "\n".join([lines[0], "|---" * len(columns) + "|", *lines[1:]])


def tables_in(text: str) -> list[Figures]:
    """The tables of a printed text, in order."""
    found: list[Figures] = []
    for block in re.findall(r"(?:^\|.*\|[ ]*\n?)+", text, re.MULTILINE):
        lines = [
            [cell.strip() for cell in line.strip()[1:-1].split("|")] for line in block.splitlines()
        ]
        ruled = len(lines) > 1 and all(re.fullmatch(r":?-+:?", cell) for cell in lines[1])
        if ruled:
            found.append({"columns": lines[0], "rows": lines[2:]})
        elif found:  # rows that follow after other lines belong to the table before
            found[-1]["rows"] += lines
    return found


class Words(dict[str, str]):
    """Texts of a result, by key. A key ``LIST/ROWS/COLUMN/HOW`` is worked out of its figures.

    LIST is a table, or a list of cells, of the result. ROWS is a regular expression: it finds the
    rows among their words, joined by ", ". COLUMN is how the head of a column begins, or the
    column's number from 1. HOW: ``cell`` of the one row as it stands; ``range`` of the numbers with
    which cells begin ("86 to 96"); their ``sum``; or the ``count`` that shares in % of ``n`` are.
    """

    def __init__(self, texts: Mapping[str, str], found: Figures) -> None:
        super().__init__(texts)
        self.found = found

    def rows(self, name: str) -> list[dict[str, str]]:
        """The cells of each row by the head of their column, which ends in its number."""
        listed = self.found.get(name)
        if isinstance(listed, list):
            return [_flat(row) for row in listed]
        (table,) = tables_in(self[name])
        heads = [f"{head}#{k}" for k, head in enumerate(table["columns"], 1)]
        return [dict(zip(heads, cells, strict=True)) for cells in table["rows"]]

    def __missing__(self, key: str) -> str:
        try:
            name, pattern, column, how = key.split("/")
        except ValueError:
            raise KeyError(key) from None
        rows = [row for row in self.rows(name) if re.search(pattern, ", ".join(row.values()))]
        cells = [cell for row in rows for cell in _under(row, column)]
        if not cells or (how == "cell" and len(cells) > 1):
            raise KeyError(f"{key}: {len(cells)} cells")
        if how == "cell":
            return cells[0]
        numbers = [found[0] for cell in cells if (found := re.search(r"\d[\d.]*", cell))]
        values = [float(number) for number in numbers]
        if how == "range":
            low, high = min(numbers, key=float), max(numbers, key=float)
            return low if low == high else f"{low} to {high}"
        if how == "sum":
            return f"{sum(values):,.0f}"
        if how == "count":
            runs = [float(cell) for row in rows for cell in _under(row, "n")]
            return f"{sum(n * v for n, v in zip(runs, values, strict=True)) / 100:,.0f}"
        raise KeyError(f"{key}: {how} is none of cell, range, sum, count")


def _flat(row: Mapping[str, Any]) -> dict[str, str]:
    """The cells of a row in words; one that holds others has one for each: ``causes.torn``."""
    parts = [
        [(f"{key}.{name}", part) for name, part in cell.items()]
        if isinstance(cell, dict) else [(key, cell)]
        for key, cell in row.items()
    ]  # fmt: skip
    return {key: str(cell) for part in parts for key, cell in part}


def _under(row: Mapping[str, str], column: str) -> list[str]:
    """The cell under the column of that number, else under the first that begins so, if any."""
    heads = [head for head in row if head.endswith(f"#{column}")]
    heads += [head for head in row if head.partition("#")[0] == column]
    heads += [head for head in row if head.startswith(column)]
    return [row[heads[0]]] if heads else []


def rate(count: int, of: int, digits: int = 0) -> str:
    """A share in percent with its interval."""
    share = 100.0 * count / max(of, 1)
    return f"{share:.{digits}f} ({percent(*wilson(count, of))})"


def cell_rate(cell: Cell) -> str:
    """A promised and picked share in percent with its interval."""
    return f"{100 * cell.rate:.1f} ({cell.interval})"


# studies of plans that are executed blind


def study(folder: Path, _: Mapping[str, Any]) -> Figures:
    """Of the rows of all studies in a folder."""
    rows = [row for path in sorted(folder.rglob("rows.csv")) for row in rows_of(path.parent)]
    return result(rows)


def result(rows: Sequence[Row]) -> Figures:
    """What the tables of a study need, as plain values."""
    together = [replace(row, preset="all", seed=k) for k, row in enumerate(rows)]
    found = calibration(rows)
    times = 1e3 * np.quantile([row.plan_time for row in rows], [0.5, 0.95])
    return {
        "cells": [cell.to_dict() for cell in summary(rows)],
        "all": summary(together)[0].to_dict(),
        "reliability": None if found is None else found.to_dict(),
        "plan_time_ms": [round(float(time), 1) for time in times],
        "tilted": sum(row.tilt > 0.1 for row in rows),
        "runs": len(rows),
    }


def study_words(found: Figures) -> Texts:
    """Tables ``rates`` and ``reliability``; words for a table of several studies."""
    cells, whole = [Cell(each) for each in found["cells"]], Cell(found["all"])
    best, worst = (pick(cells, key=lambda cell: cell.rate) for pick in (max, min))
    times = [f"{t:.0f} ms" if t < 1000 else f"{t / 1000:.1f} s" for t in found["plan_time_ms"]]
    low, high = 100 * whole.broken_low, 100 * whole.broken_high
    words = {
        "rates": _rates(cells, whole),
        "best": f"`{best.preset}` {cell_rate(best)}",
        "worst": f"`{worst.preset}` {cell_rate(worst)}",
        "all": f"{cell_rate(whole)} of {whole.runs}",
        "rate": cell_rate(whole),
        "runs": str(whole.runs),
        "broken": f"{whole.broken} of {whole.plans} promises broken",
        "broken_rate": f"{100 * whole.broken_rate:.1f} ({low:.0f}–{high:.0f})",
        "times": " / ".join(times),
        "median": times[0],
        "late": times[1],
        "tilted": f"{found['tilted']} of {found['runs']}",
    }
    if found["reliability"] is not None:
        words["reliability"] = _reliability(found["reliability"])
        words["auc"] = f"{found['reliability']['auc']:.2f}"
    return words


def _rates(cells: Sequence[Cell], whole: Cell) -> str:
    columns = [
        "preset", "promised and picked", "% (95 %)", "broken promises", "% (95 %)",
        "executed although refused", "force on unripe, median / 90 % [N]", "failed by",
    ]  # fmt: skip
    rows = [
        (c.preset, f"{c.kept} of {c.runs}", cell_rate(c), f"{c.broken} of {c.plans}",
         f"{100 * c.broken_rate:.1f} ({100 * c.broken_low:.0f}–{100 * c.broken_high:.0f})",
         c.successes, f"{c.unripe_force:.1f} / {c.unripe_force_90:.1f}", c.failed_by)
        for c in ([*cells, whole] if len(cells) > 1 else cells)
    ]  # fmt: skip
    return table(columns, rows)


def _reliability(found: Figures) -> str:
    rows = [
        (f"{100 * b['low']:g} to {100 * b['high']:g} %", b["runs"], f"{100 * b['predicted']:.1f}",
         b["failures"],
         f"{100 * b['rate']:.1f} ({100 * b['rate_low']:.0f}–{100 * b['rate_high']:.0f})")
        for b in found["bins"]
    ]  # fmt: skip
    return table(["not clean, predicted", "runs", "mean", "failed", "% (95 %)"], rows)


# picks by loops: in a folder for each way to pick, the rows of one study


def loops(folder: Path, row: Mapping[str, Any]) -> Figures:
    """Of the studies of loops in the folders that ``parts`` names, over all presets and by each."""
    rows = {part: rows_of(folder / part) for part in row["parts"]}
    return {
        "cells": [
            {"part": part, **cell.to_dict()}
            for part in row["parts"]
            for cell in loop_summary(rows[part])
        ],
        "pairs": pairs(*rows.items()) if len(rows) == 2 else [],
    }


def pairs(first: tuple[str, Sequence[Row]], second: tuple[str, Sequence[Row]]) -> list[Figures]:
    """How often one of two alone came to an end, of what both met; p by McNemar's exact test."""
    ends = [
        {(r.preset, r.seed, r.condition): r.result for r in rows} for _, rows in (first, second)
    ]
    both = sorted(ends[0].keys() & ends[1].keys())
    conditions = dict.fromkeys(condition for *_, condition in both)
    out = []
    for condition in [ALL, *conditions] if len(conditions) > 1 else conditions:
        keys = [key for key in both if condition in (ALL, key[2])]
        for end in ("clean", "harmed"):
            met = [(ends[0][key] == end, ends[1][key] == end) for key in keys]
            p = board_of.paired(met)
            out.append({
                "end": end, "first": first[0], "second": second[0],
                "condition": "every" if condition == ALL else condition,
                "met": len(met),
                "first alone": sum(a and not b for a, b in met),
                "second alone": sum(b and not a for a, b in met),
                "p": "< 0.001" if p < 0.001 else f"= {p:.2g}",
            })  # fmt: skip
    return out


def loops_words(found: Figures) -> Texts:
    """Tables ``conditions`` and ``presets`` of both loops; words by part, preset and condition."""
    cells = [Cell(each) for each in found["cells"]]
    words, whole = {}, dict[tuple[str, str], Cell]()
    for c in cells:
        preset = "all" if c.preset == ALL else c.preset
        key = f"{c.part}.{preset}.{c.condition}"
        words[key] = rate(c.clean, c.runs)
        words[f"{key}.runs"] = str(c.runs)
        for name in ("harmed", "gave_up", "refused", "missed"):
            words[f"{key}.{name}"] = f"{100 * getattr(c, name) / c.runs:.0f}"
        lost = c.gave_up + c.refused + c.missed + c.error
        words[f"{key}.told"] = (
            f"{rate(c.clean, c.runs)}, {words[f'{key}.harmed']}, {100 * lost / c.runs:.0f}"
        )
        if preset == "all":
            whole[c.part, c.condition] = c
    closed = {condition: c for (part, condition), c in whole.items() if part == "closed"}
    if closed:
        words["count"] = str(len(closed))
        ranked = sorted(closed, key=lambda name: -closed[name].clean / closed[name].runs)
        for name, condition in (("best", ranked[0]), ("worst", ranked[-1])):
            c = closed[condition]
            words[name] = f"`{condition}` {rate(c.clean, c.runs)}"
            words[f"{name}.harmed"] = f"`{condition}` {100 * c.harmed / c.runs:.0f}"
        words["conditions"] = _conditions(whole)
        words["presets"] = _presets(cells)
    return words


def _conditions(whole: Mapping[tuple[str, str], Cell]) -> str:
    columns = [
        "condition", "open: n", "clean %", "harmed %", "closed: n", "clean %", "harmed %",
        "gave up %",
    ]  # fmt: skip
    rows = []
    for condition, words in CONDITIONS.items():
        o, c = whole.get(("open", condition)), whole.get(("closed", condition))
        if c is None:
            continue
        beside = ["", "", ""]
        if o is not None:
            beside = [str(o.runs), rate(o.clean, o.runs), f"{100 * o.harmed / o.runs:.1f}"]
        rows.append(
            [f"{words} (`{condition}`)", *beside, c.runs, rate(c.clean, c.runs),
             f"{100 * c.harmed / c.runs:.1f}", f"{100 * c.gave_up / c.runs:.1f}"]
        )  # fmt: skip
    return table(columns, rows)


def _presets(cells: list[Cell]) -> str:
    """All conditions together, without intervals: each scene counts once under each of them."""
    rows, ends = [], {"open": ("clean", "harmed"), "closed": ("clean", "harmed", "gave_up")}
    for preset in dict.fromkeys(c.preset for c in cells):
        row = ["all" if preset == ALL else f"`{preset}`"]
        for part, names in ends.items():
            own = [c for c in cells if (c.part, c.preset) == (part, preset)]
            runs = sum(c.runs for c in own)
            counts = [sum(getattr(c, name) for c in own) for name in names]
            row += [str(runs), *(f"{100 * n / runs:.1f}" if runs else "" for n in counts)]
        rows.append(row)
    columns = [
        "kind of scene", "open: n", "clean %", "harmed %", "closed: n", "clean %", "harmed %",
        "gave up %",
    ]  # fmt: skip
    return table(columns, rows)


# the board


def board(folder: Path, row: Mapping[str, Any]) -> Figures:
    """Of the submissions in a folder, one for each entry of ``entries``."""
    found = board_of.leaderboard(folder / entry for entry in row["entries"])
    tables = tables_in(board_of.markdown(found))
    run = found.run
    return {
        "tables": {"board": tables[0], "presets": tables[1]},
        "told": {"set": f"{run.scenes.count} scenes each of {', '.join(run.scenes.presets)}"},
        "standings": [cell.to_dict() for cell in found.standings],
        "torn": torn(folder / entry for entry in row["entries"]),
    }


def torn(folders: Iterable[Path]) -> list[Figures]:
    """How many runs of each entry tore a fruit or pulled it too hard, engine by engine."""
    out = []
    for folder in folders:
        run, rows, *_ = submission(zip_of(folder))
        for engine in run.engines:
            own = [r.cause for r in rows if r.engine == engine and r.result == "harmed"]
            count = sum("torn" in cause or "pulled" in cause for cause in own)
            out.append({"entry": run.entry, "engine": engine, "torn": count})
    return out


def board_words(found: Figures) -> Texts:
    """Its tables, and of the first entry best, worst, all and harmed, engine by engine."""
    words = printed_words(found)
    standings = [Cell(each) for each in found.get("standings", ())]
    if not standings:
        return words
    first = standings[0].entry
    own = [c for c in standings if c.entry == first]
    presets = dict.fromkeys(c.preset for c in own if c.preset)
    clean = {p: sum(c.clean for c in own if c.preset == p) for p in presets}

    def of(preset: str) -> str:
        return ", ".join(rate(c.clean, c.runs, 1) for c in own if c.preset == preset)

    def harmed(preset: str) -> str:
        shares = (f"{100 * c.harmed / c.runs:.1f}" for c in own if c.preset == preset)
        return ", ".join(shares)

    best, worst = max(clean, key=clean.__getitem__), min(clean, key=clean.__getitem__)
    runs = next(c.runs for c in own if not c.preset)
    return words | {
        "best": f"`{best}` {of(best)}",
        "worst": f"`{worst}` {of(worst)}",
        "all": f"{of('')} of {runs}",
        "harmed": f"{harmed('')} % harmed; `{worst}` {harmed(worst)} %",
    }


def tracks(folder: Path, row: Mapping[str, Any]) -> Figures:
    """Of the submissions of other tracks: a line for each entry of ``entries`` and engine."""
    columns = [
        "track, condition", "entry", "engine", "clean (95 %)", "harmed", "missed", "refused", "n",
        "clean by preset",
    ]  # fmt: skip
    rows, told, standings = [], {}, []
    held = {entry: submission(zip_of(folder / entry)) for entry in row["entries"]}
    for entry in row["entries"]:
        found = board_of.leaderboard([folder / entry])
        run, (name,) = found.run, found.order
        standings += [cell.to_dict() for cell in found.standings]
        whole = [found.of(name, engine) for engine in run.engines]
        for c in whole:
            by = [found.of(name, c.engine, preset) for preset in run.scenes.presets]
            rows.append(
                [f"`{run.track}`, `{run.condition}`", f"`{entry}`", c.engine,
                 f"**{100 * c.clean / c.runs:.0f}** ({c.interval})", str(c.harmed), str(c.missed),
                 str(c.refused + c.errors), str(c.runs),
                 ", ".join(f"`{each.preset}` {each.clean} of {each.runs}" for each in by)]
            )  # fmt: skip
        first = [found.of(name, run.engines[0], preset) for preset in run.scenes.presets]
        for end, pick in (("best", max), ("worst", min)):
            c = pick(first, key=lambda cell: cell.clean / cell.runs)
            told[f"{entry}.{end}"] = f"`{c.preset}` {c.clean} of {c.runs}"
        told[f"{entry}.all"] = (
            f"{', '.join(rate(c.clean, c.runs) for c in whole)} of {whole[0].runs}"
        )
        shares = ", ".join(f"{100 * c.harmed / c.runs:.0f}" for c in whole)
        told[f"{entry}.harmed"] = f"{shares} % harmed"
    return {
        "tables": {"tracks": {"columns": columns, "rows": rows}},
        "told": told,
        "standings": standings,
        "pairs": [
            pair
            for (one, first), (other, second) in itertools.combinations(held.items(), 2)
            if first[0].track == second[0].track
            for pair in pairs((one, first[1]), (other, second[1]))
        ],
    }


# what a command prints, or leaves as JSON


def printed(folder: Path, row: Mapping[str, Any]) -> Figures:
    """Of what the last command printed: tables in the order of ``tables``, words by ``told``.

    Words are what the group of a regular expression finds first.
    """
    last = max(folder.glob("*.out"), key=lambda path: int(path.stem))
    text = last.read_text("utf-8")
    found, names, told = tables_in(text), row.get("tables", []), {}
    if len(found) != len(names):
        raise ValueError(f"{folder} holds {len(found)} tables; {row['name']} has {names}")
    for name, pattern in row.get("told", {}).items():
        match = re.search(pattern, text)
        if match is None:
            raise ValueError(f"{folder} holds nothing like {pattern}")
        told[name] = match[1]
    return {"tables": dict(zip(names, found, strict=True)), "told": told}


def printed_words(found: Figures) -> Texts:
    """Its tables and words as they are kept."""
    return {
        **{name: table(each["columns"], each["rows"]) for name, each in found["tables"].items()},
        **found.get("told", {}),
    }


def eyes(folder: Path, _: Mapping[str, Any]) -> Figures:
    """Of the lines of JSON that ``scripts/eyes_study.py`` printed."""
    lines = [
        json.loads(line)
        for path in sorted(folder.glob("*.out"))
        for line in path.read_text("utf-8").splitlines()
        if line.startswith("{")
    ]
    columns = [
        "pictures", "finder", "n", "visible fruits", "recall %", "false (share %)",
        "centre: median, 90 % [mm]", "normalised: mean (beyond %)", "ripe right %",
        "stems found of visible", "angle: mean, 90 % [°] (over deviation)", "ms",
    ]  # fmt: skip
    rows = [
        [f"`{f['preset']}`, {f['mount']}" + (f", {f['looks']}" if f["looks"] != "plain" else ""),
         f["finder"], f"{f['pictures']:.0f}", f"{f['visible']:.0f}",
         rate(round(f["recall"] * f["visible"]), round(f["visible"]), 1),
         f"{f['false']:.0f} ({100 * f['false_share']:.1f})",
         f"{f['center_median_mm']:.1f}, {f['center_90_mm']:.1f}",
         f"{f['normalised_mean']:.1f} ({100 * f['normalised_beyond_99']:.1f})",
         f"{100 * f['ripe_right']:.0f}", f"{f['stems_found']:.0f} of {f['stems_visible']:.0f}",
         f"{f['angle_mean_deg']:.1f}, {f['angle_90_deg']:.1f} ({f['angle_over_deviation']:.1f})",
         f"{f['ms']:.0f}"]
        for f in lines
    ]  # fmt: skip
    rows = [[cell.replace("nan", "–") for cell in row] for row in rows]  # nothing tells it
    return {"tables": {"eyes": {"columns": columns, "rows": rows}}, "lines": lines}


def guard(folder: Path, _: Mapping[str, Any]) -> Figures:
    """Of the runs in ``guard.jsonl`` of ``scripts/guard_study.py``: alone beside guarded."""
    lines = [json.loads(line) for line in (folder / "guard.jsonl").read_text("utf-8").splitlines()]
    columns = [
        "entry", "preset", "engine", "n", "alone: clean % (95 %)", "harmed % (95 %)",
        "guarded: clean % (95 %)", "harmed % (95 %)", "acted", "a step: median, 95 %",
    ]  # fmt: skip
    groups: dict[tuple[str, ...], dict[bool, list[Any]]] = {}
    for line in lines:
        asked = line["asked"]
        noise, guarded = asked["noise"], asked["guarded"]
        told = "" if noise == "none" else noise
        where = ", ".join(filter(None, (asked["engine"], told)))
        keys = [("", told, f"`{asked['entry']}`", f"`{asked['preset']}`", where)]
        if asked["entry"] != "random":
            keys.append(("all", told, "all", "", told))
        for each in keys:
            groups.setdefault(each, {False: [], True: []})[guarded].append(line)
    rows = []
    for key in sorted(groups):
        sides = groups[key]
        cells = [*key[2:], str(len(sides[True]))]
        for side in (sides[False], sides[True]):
            for name in ("clean", "harmed"):
                cells.append(rate(sum(line["result"] == name for line in side), len(side)))
        rows.append([*cells, *steps_of([line for line in sides[True] if line.get("steps")])])
    return {"tables": {"guard": {"columns": columns, "rows": rows}}}


def steps_of(runs: Sequence[Mapping[str, Any]]) -> tuple[str, str]:
    """In how many periods the guard acted, and its time a step, of guarded runs."""
    if not runs:
        return "–", "–"
    steps = np.array([line["steps"] for line in runs])
    times = np.array([line["spent"] for line in runs])  # quantiles of each run [ms]
    weights = np.broadcast_to(steps[:, None], times.shape).ravel()
    half, late = np.quantile(times.ravel(), [0.5, 0.95], weights=weights, method="inverted_cdf")
    acted = sum(line["acted"] for line in runs) / steps.sum()
    return f"{100 * acted:.0f} %", f"{half:.1f} ms, {late:.1f} ms"


CASES = {  # of scripts/judged, in words
    "still": "still, makers' bodies", "moving": "along random curves, makers' bodies",
    "own": "still, the judge's own spheres", "own-moving": "along random curves, its own spheres",
    "self": "links against links",
}  # fmt: skip


def judged(folder: Path, row: Mapping[str, Any]) -> Figures:
    """Of the counts that ``scripts/judged`` printed; ``words`` hold where all commands ended well.

    Raises:
        ValueError: other cases than those of CASES were run.
    """
    text = (folder / "1.out").read_text("utf-8")
    found = re.findall(
        r"^([\w-]+), (\d+) cases: in contact by more than 1 mm: (\d+);.* missed: (\d+)$"
        r"(?:\n  ours minus theirs .* 95, 99: ([^;]*);)?",
        text, re.MULTILINE,
    )  # fmt: skip
    if [name for name, *_ in found] != list(CASES):
        raise ValueError(f"{folder}/1.out holds the cases {[name for name, *_ in found]}")
    columns = [
        "cases", "in contact by > 1 mm", "missed",
        "our distance minus theirs [mm]: 1 %, 5 %, median, 95 %, 99 %",
    ]  # fmt: skip
    rows = [
        [CASES[name], f"{int(touching):,} of {int(cases):,}", missed, off]
        for name, cases, touching, missed, off in found
    ]
    missed, touching = (sum(int(each[k]) for each in found) for k in (3, 2))
    told = {"missed": f"{missed} of {touching:,}", **row["words"]}
    return {"tables": {"judged": {"columns": columns, "rows": rows}}, "told": told}


def benchmarks(folder: Path, _: Mapping[str, Any]) -> Figures:
    """Of the results of ``python -m benchmarks``: each table, each value, and all as ``page``."""
    from benchmarks import tables as made
    from benchmarks.registry import Row as Measured

    results = json.loads((folder / "results.json").read_text("utf-8"))
    rows, text = [Measured.from_dict(row) for row in results["rows"]], made.markdown(results)
    _, *parts = re.split(r"^### (.+)\n", text, flags=re.MULTILINE)
    names = [name.strip().lower() for name in parts[::2]]
    found = {name: tables_in(part)[0] for name, part in zip(names, parts[1::2], strict=True)}
    told = {row.metric.name: made.cell(row).partition(" (")[0] for row in rows}
    return {"tables": found, "told": {"page": text.strip(), **told}}


KINDS: Mapping[str, tuple[Callable[[Path, Mapping[str, Any]], Figures], Callable[..., Texts]]] = {
    "study": (study, study_words),
    "loops": (loops, loops_words),
    "board": (board, board_words),
    "tracks": (tracks, printed_words),
    "guard": (guard, printed_words),
    "printed": (printed, printed_words),
    "judged": (judged, printed_words),
    "eyes": (eyes, printed_words),
    "benchmarks": (benchmarks, printed_words),
}


def shown(kind: str, found: Figures, about: Mapping[str, str] = MappingProxyType({})) -> Words:
    """The texts of figures, beside those of ``about``.

    Tables and words that were kept as they are stand for themselves.
    """
    words = printed_words if "tables" in found and kind != "board" else KINDS[kind][1]
    return Words({**about, **words(found)}, found)
