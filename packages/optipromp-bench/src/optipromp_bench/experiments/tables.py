"""Studies as rows of one TOML file, and the tables of what they came to.

``table`` of the file is ``plans``, for plans that are executed blind, ``loops``, for picks by two
loops, or MODULE:CLASS of a kind of its own. Each ``[[study]]`` has a ``name``, of its folder and in
the table, and fields of :class:`optipromp_bench.experiments.trials.Study` or of that kind.
"""

import functools
import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, NamedTuple, get_type_hints

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError, create_model

from optipromp.core.errors import InvalidRequestError
from optipromp.core.files import read_bytes
from optipromp_bench.experiments.kinds import Kind, kind_of
from optipromp_bench.experiments.rows import Row, rows_of
from optipromp_bench.experiments.statistics import (
    ALL,
    Cell,
    LoopCell,
    PlanCell,
    StudyCell,
    calibration,
    loop_summary,
    share,
    summary,
    tabled,
)
from optipromp_bench.experiments.study import Study
from optipromp_bench.table import paired, told_p

LEFT_OUT = "choice", "files", "crop"  # fields of a study that are no words or numbers
DETECTED = "detected"  # the part of plans whose fruits are detected with errors
PREDICTED = "hanging", DETECTED, "shelf"  # parts for which predicted harm is told


@functools.cache
def _model(kind: Any) -> type[BaseModel]:
    """What reads a file."""
    strict, kinds = ConfigDict(extra="forbid"), get_type_hints(kind)
    row: dict[str, Any] = {
        each.name: (kinds[each.name], each.default)
        for each in fields(kind)
        if each.name not in LEFT_OUT
    }
    row["name"] = (str, Field(pattern=r"^[a-z0-9-]+$"))
    studies: Any = list[create_model("Line", __config__=strict, **row)]  # type: ignore[misc]
    return create_model("Studies", __config__=strict, table=(str, ...), study=(studies, ...))


def studies_in(file: Path) -> tuple[str, dict[str, Study | Kind]]:
    """The kind of tables of a file, and its studies by name; refuses what is none."""
    try:
        told = tomllib.loads(read_bytes(file, InvalidRequestError).decode("utf-8"))
        table = str(told.get("table", "plans"))
        kind: Any = Study if table in TABLES else kind_of(table)
        rows = _model(kind).model_validate(told).model_dump()
    except ValidationError as error:
        wrong = error.errors()[0]
        where = ".".join(map(str, wrong["loc"]))
        raise InvalidRequestError(f"{file}: {where}: {wrong['msg']}") from None
    except ValueError as error:
        raise InvalidRequestError(f"{file} is no TOML: {error}") from None
    studies: dict[str, Any] = {row.pop("name"): kind(**row) for row in rows["study"]}
    if len(studies) < len(rows["study"]):
        raise InvalidRequestError(f"{file}: two studies have one name; each must have its own")
    if rows["table"] == "loops" and [len(each.loops) for each in studies.values()] != [1, 1]:
        raise InvalidRequestError(f"{file}: a table of loops is of two studies, of one loop each")
    if rows["table"] == "plans" and any(each.loops for each in studies.values()):
        raise InvalidRequestError(f"{file}: a table of plans is of studies without loops")
    return table, studies


def tables_of(table: str, folder: Path, rows: Mapping[str, Sequence[Any]]) -> str:
    """The tables of studies that were run, by the rows of each."""
    return TABLES[table](folder, list(rows)) if table in TABLES else kind_of(table).told(rows)


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
            p = told_p(paired(met))
            out.append([f"`{condition}`", end, len(met), *alone, p])
    return out


def loops_told(cells: Sequence[tuple[str, LoopCell]], paired: list[list[Any]]) -> str:
    """By condition over all presets, and by preset over all conditions; pairs of both loops."""
    groups: dict[str, dict[tuple[str, str], list[LoopCell]]] = {}
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


TABLES: Mapping[str, Callable[[Path, Sequence[str]], str]] = {"plans": plans, "loops": loops}


TITLE = """%: promised and picked, nothing harmed, in the simulation; 95 %: Wilson's interval
0.3.0: the same where a stem bears 2 N, not what is cited of the crop (strawberry 10 N)
plans: those that promised it, broken: of these; all: picked if no refusal is heeded; torn: runs
plan, cycle: median seconds of planning, and of motion with the way out
clean: all seconds over clean picks"""
LOOP_TITLE = """%: clean: picked, nothing harmed, in the simulation; 95 %: Wilson's interval
0.3.0: the same where a stem bears 2 N, not what is cited of the crop (strawberry 10 N)
harmed, gave up, refused, missed [%]; back: retreats; s: median duration
clean: seconds a clean pick"""
EYES_TITLE = """% of runs: a ripe fruit seen, a plan made, the fruit in the tool at the end (95 %:
Wilson's interval), something harmed; recall [%] of visible fruits in the pictures before the plan;
false: wrong detections a run; see: median processor time of seeing [s]"""
NAMES, LOOP_NAMES = ("preset", "planner"), ("preset", "condition", "loop")


def _number(name: str, digits: int = 0) -> Callable[[Cell], str]:
    """A figure with so many decimals; a dash where there is none."""

    def column(cell: Cell) -> str:
        value = getattr(cell, name)
        return "–" if value is None else f"{value:.{digits}f}"

    return column


def _share(name: str) -> Callable[[Cell], str]:
    """A count in percent of the runs."""
    return lambda cell: f"{100 * getattr(cell, name) / cell.runs:.3g}"


def _causes(cell: StudyCell) -> str:
    return cell.failed_by


PLANNER: Mapping[str, Callable[[PlanCell], str]] = {
    "n": _number("runs"), "0.3.0": lambda cell: f"{100 * cell.kept_before / cell.runs:.1f}",
    "%": lambda cell: f"{100 * cell.rate:.1f}",
    "95 %": lambda cell: cell.interval, "plans": _number("plans"), "broken": _number("broken"),
    "all": _number("successes"), "torn": _number("torn"), "plan": _number("plan_time", 2),
    "cycle": _number("cycle", 1), "clean": _number("clean_seconds", 1),
}  # fmt: skip
LOOP: Mapping[str, Callable[[LoopCell], str]] = {
    "n": _number("runs"), "0.3.0": _share("kept_before"), "%": _share("clean"),
    "95 %": lambda cell: cell.interval, "harm": _share("harmed"), "gave": _share("gave_up"),
    "ref": _share("refused"), "miss": _share("missed"), "s": _number("duration", 1),
    "clean": _number("clean_seconds", 1), "back": _number("retreats"),
}  # fmt: skip
EYES: Mapping[str, Callable[[LoopCell], str]] = {
    "n": _number("runs"), "seen": _share("seen"), "planned": _share("planned"),
    "picked": _share("picked"),
    "95 %": lambda cell: "–".join(f"{100 * end:.0f}" for end in cell.picked_interval),
    "harm": _share("harmed"),
    "recall": lambda cell: f"{100 * cell.found / cell.visible:.3g}" if cell.visible else "–",
    "false": lambda cell: f"{cell.false / cell.runs:.2f}" if cell.visible else "–",
    "see": _number("see_time", 2),
}  # fmt: skip


class Told(NamedTuple):
    """A table of a study."""

    title: str  # what its columns are
    heads: list[str]
    lines: list[list[str]]
    names: int  # of columns, the first, that name a line


def cells_in(rows: Sequence[Row]) -> Sequence[PlanCell | LoopCell]:
    """The figures of a study of loops, else of one of plans."""
    return loop_summary(rows) if any(row.loop for row in rows) else summary(rows)


def told(rows: Sequence[Row]) -> list[Told]:
    """What a study of plans or of loops came to, why runs failed, and what was predicted."""
    cells = cells_in(rows)
    looping, known = isinstance(cells[0], LoopCell), calibration(rows)
    names = LOOP_NAMES if looping else NAMES
    parts: list[tuple[str, Mapping[str, Callable[[Any], str]]]] = [(TITLE, PLANNER)]
    if looping:
        parts = [(EYES_TITLE, EYES)] if any(row.pictures for row in rows) else []
        parts.append((LOOP_TITLE, LOOP))
    elif summary(rows)[0].changed is not None:  # by a guess of the crop
        parts = [(TITLE, {**PLANNER, "changed": _number("changed")})]
    parts.append(("causes of failure, a run may have several", {"failed by": _causes}))
    out = [
        Told(
            title, [*names, *columns],
            [[*(getattr(c, n) for n in names), *(column(c) for column in columns.values())]
             for c in cells],
            len(names),
        )
        for title, columns in parts
    ]  # fmt: skip
    if known is not None and not looping:
        title = (
            f"not clean, predicted and counted [%]; AUC {known.auc:.2f}; of {known.successes} "
            f"plans that promise success {known.failed} failed"
        )
        heads = ["predicted", "n", "mean", "failed", "%", "95 %"]
        out.append(Told(title, heads, list(map(list, known.rows())), 0))
    return out
