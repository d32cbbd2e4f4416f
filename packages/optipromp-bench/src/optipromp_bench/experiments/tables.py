"""Studies as rows of one TOML file, or as words, and the tables of what they came to.

``table`` of the file is MODULE:CLASS of a kind of its own; without it, plans are executed blind, or
loops pick. Each ``[[study]]`` has a ``name``, of its folder and in the tables, and fields of
:class:`optipromp_bench.experiments.trials.Study` or of that kind. Words ``FIELD=VALUE`` make one
study without a name. Lists may be written A,B, seeds A:B, and ``all`` names all that there are.
"""

import functools
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Annotated, Any, get_origin, get_type_hints

import numpy as np
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError, create_model

from optipromp.core.errors import InvalidRequestError, suggest
from optipromp.core.files import read_bytes
from optipromp_bench.experiments.eyes import WAYS
from optipromp_bench.experiments.kinds import Kind, kind_of
from optipromp_bench.experiments.rows import Row
from optipromp_bench.experiments.statistics import (
    ALL,
    LoopCell,
    Table,
    calibration,
    loop_summary,
    share,
    summary,
)
from optipromp_bench.experiments.trials import Study, study_planners
from optipromp_bench.table import paired, told_p
from optipromp_sim.generate import PRESETS
from optipromp_sim.situations import CONDITIONS, LOOP_PLANNER, LOOPS

OPTIONS = "choice", "files", "crop", "robot"  # fields of a study that are options of the command
PREDICTED = "hanging", "detected", "shelf"  # if any is there, predicted harm is told of these
EVERY: Mapping[str, Any] = {  # what ``all`` names
    "presets": lambda: PRESETS, "planners": study_planners, "loops": lambda: LOOPS,
    "conditions": lambda: tuple(CONDITIONS), "eyes": lambda: WAYS,
}  # fmt: skip


def _listed(field: str, value: Any) -> Any:
    """A list in a text."""
    if not isinstance(value, str):
        return value
    if value == "all" and field in EVERY:
        return EVERY[field]()
    return [part.strip() for part in value.split(":" if field == "seeds" else ",") if part.strip()]


@functools.cache
def _model(kind: Any) -> type[BaseModel]:
    """What reads a file."""
    strict, kinds = ConfigDict(extra="forbid"), get_type_hints(kind)
    row: dict[str, Any] = {}
    for each in fields(kind):
        if kind is not Study or each.name not in OPTIONS:
            own = kinds[each.name]
            if get_origin(own) is tuple:
                own = Annotated[own, BeforeValidator(functools.partial(_listed, each.name))]
            row[each.name] = own, each.default
    row["name"] = (str, Field(pattern=r"^[a-z0-9-]*$"))
    studies: Any = list[create_model("Line", __config__=strict, **row)]  # type: ignore[misc]
    return create_model("Studies", __config__=strict, table=(str, ""), study=(studies, ...))


def studies_of(
    words: Sequence[str], scenes: Sequence[Path] = (), **given: Any
) -> tuple[Any, dict[str, Study | Kind]]:
    """The class of studies, and the studies by name, of a file or of words; refuses what is none.

    ``scenes``: files whose scenes take the place of presets. ``given``: further fields of each.
    """
    where = " ".join(words)
    try:
        if len(words) == 1 and "=" not in where:
            told = tomllib.loads(read_bytes(Path(where), InvalidRequestError).decode("utf-8"))
        else:
            pairs = (word.partition("=") for word in words)
            told = {"study": [{"name": "", **{field: value for field, _, value in pairs}}]}
        table = told.setdefault("table", "")
        kind: Any = kind_of(table) if table else Study
        rows = _model(kind).model_validate(told).model_dump(exclude_unset=True)["study"]
    except ValidationError as error:
        wrong = error.errors()[0]
        place, why = ".".join(map(str, wrong["loc"])), wrong["msg"]
        if wrong["type"] == "extra_forbidden":
            known = [each.name for each in fields(kind) if each.name not in OPTIONS]
            why = f"no such field: {suggest(wrong['loc'][-1], known)}"
        raise InvalidRequestError(f"{where}: {place}: {why}") from None
    except ValueError as error:
        raise InvalidRequestError(f"{where} is no TOML: {error}") from None
    if kind is not Study and (scenes or given):
        raise InvalidRequestError(f"{where}: a study of {table} takes no scenes, crop or robot")
    studies: dict[str, Any] = {}
    for row in rows:
        name = row.pop("name")
        if name in studies:
            raise InvalidRequestError(f"{where}: two studies are {name}; each must have its own")
        if "eyes" in row:
            row.setdefault("loops", LOOPS[:1])
        if "loops" in row:
            row.setdefault("planners", (LOOP_PLANNER,))
        if scenes and "presets" in row:
            raise InvalidRequestError("presets and --scenes: state one of them")
        row |= given
        studies[name] = Study.of_files(scenes, **row) if scenes else kind(**row)
    return kind, studies


def tables_of(rows: Mapping[str, Sequence[Row]]) -> list[Table]:
    """The tables of studies by the rows of each: of plans, and of picks by loops."""
    parts: dict[tuple[str, str], list[Row]] = {}
    for name, own in rows.items():
        for row in own:
            parts.setdefault((name, row.loop or row.planner), []).append(row)
    alone = [name for name, _ in parts]
    told: tuple[dict[str, list[Row]], dict[str, list[Row]]] = {}, {}
    for (name, contender), each in parts.items():
        part = name if name and alone.count(name) == 1 else f"{name} {contender}".strip()
        told[bool(each[0].loop)][part] = each
    return [*(plans(told[0]) if told[0] else ()), *(loops(told[1]) if told[1] else ())]


def plans(parts: Mapping[str, Sequence[Row]]) -> list[Table]:
    """All parts in one line each, by preset or variation, and what became of predicted harm."""
    overview, presets, bins = list[list[Any]](), list[list[Any]](), list[list[Any]]()
    many = len({row.planner for rows in parts.values() for row in rows}) > 1
    chosen = [part for part in parts if part in PREDICTED] or list(parts)
    guessed = False
    for part, rows in parts.items():
        (whole,) = summary(
            [replace(row, preset=ALL, seed=k, variation="") for k, row in enumerate(rows)]
        )
        known, tilted = calibration(rows), sum(row.tilt > 0.1 for row in rows)
        times = np.quantile([row.plan_time for row in rows], [0.5, 0.95])
        errs = any(row.noise or row.noise_position or row.noise_angle for row in rows)
        overview.append([
            part, whole.runs, share(whole.kept, whole.runs, 1), share(whole.broken, whole.plans, 1),
            f"{tilted} of {whole.runs}", _number(None if known is None else known.auc, 2),
            " / ".join(f"{1e3 * t:.0f} ms" if t < 1 else f"{t:.1f} s" for t in times),
        ])  # fmt: skip
        for c in summary(rows):
            guessed |= c.changed is not None
            presets.append([
                f"`{c.preset}`", *([c.planner] if many else []),
                "as detected" if errs else "exactly", f"{c.kept} of {c.runs}",
                share(c.kept, c.runs, 1), f"{c.broken} of {c.plans}", share(c.broken, c.plans, 1),
                c.successes, f"{_number(c.unripe_force)} / {_number(c.unripe_force_90)}",
                c.failed_by, f"{100 * c.kept_before / c.runs:.1f}",
                *([] if c.changed is None else [c.changed]),
            ])  # fmt: skip
        bins += [[part, *line] for line in (known.rows() if known and part in chosen else ())]
    kept, broken = "promised and picked, % (95 %)", "broken promises, % (95 %)"
    heads = "scenes", "runs", kept, broken, "at an angle", "AUC", "time to plan, median / 95 %"
    more = "executed although refused", "force on unripe, median / 90 % [N]", "failed by", "0.3.0"
    by = ["preset", *(["planner"] if many else []), "known", "picked", kept, "broken", broken]
    predicted = ["scenes", "not clean, predicted", "runs", "mean", "failed, % (95 %)"]
    return [
        Table("All", heads, overview),
        Table("By preset", [*by, *more, *(["changed"] if guessed else [])], presets),
        Table("Does predicted harm tell what happens?", predicted, bins),
    ]


def loops(parts: Mapping[str, Sequence[Row]]) -> list[Table]:
    """By condition over all presets, and by preset over all conditions; pairs of two loops; and
    what pictures showed before the plan."""
    groups: dict[str, dict[tuple[str, str], list[LoopCell]]] = {"condition": {}, "preset": {}}
    for part, rows in parts.items():
        for c in loop_summary(rows):
            by, name = ("condition", c.condition) if c.preset == ALL else ("preset", c.preset)
            groups[by].setdefault((f"`{name}`", part), []).append(c)
    counts, tables = ("runs", "clean", "harmed", "gave_up", "missed", "refused"), list[Table]()
    for by, own in groups.items():
        names, lines = list(dict.fromkeys(name for name, _ in own)), []
        once = all(len(each) == 1 for each in own.values())  # a scene in several has no interval
        for name, part in sorted(own, key=lambda key: names.index(key[0])):
            n, clean, harmed, *lost = (
                sum(getattr(c, of) for c in own[name, part]) for of in counts
            )
            shares = [share(k, n) if once else f"{100 * k / n:.1f}" for k in (clean, harmed)]
            lines.append(
                [name, part, n, *shares, *lost, *(c.failed_by for c in own[name, part][:once])]
            )
        unit = "% (95 %)" if once else "%"
        heads = [by, "loop", "n", f"clean {unit}", f"harmed {unit}", "gave up", "missed", "refused"]
        if lines:
            tables.append(Table(f"By {by}", [*heads, "failed by"][: len(lines[0])], lines))
    if len(parts) == 2 and (alone := pairs(*parts.values())):
        heads = ["condition", "end", "met by both", "first alone", "second alone", "p"]
        first, second = parts
        title = f"{first.capitalize()} (first) and {second} (second), in pairs"
        tables.append(Table(title, heads, alone))
    cells = [(part, c) for part, rows in parts.items() for c in loop_summary(rows) if c.visible]
    if cells:
        heads = ["preset", "loop", "n", "seen %", "planned %", "picked, %", "recall %",
                 "false a run", "see [s]"]  # fmt: skip
        lines = [
            [f"`{c.preset}`", part, c.runs, f"{100 * c.seen / c.runs:.3g}",
             f"{100 * c.planned / c.runs:.3g}", share(c.picked, c.runs),
             f"{100 * c.found / c.visible:.3g}", f"{c.false / c.runs:.2f}", _number(c.see_time, 2)]
            for part, c in cells
        ]  # fmt: skip
        tables.append(Table("Pictures before the plan", heads, lines))
    return tables


def pairs(first: Sequence[Row], second: Sequence[Row]) -> list[list[Any]]:
    """How often one of two alone came to an end, of what both met; p by McNemar's exact test."""
    ends = [{(r.preset, r.seed, r.condition): r.result for r in rows} for rows in (first, second)]
    both, out = sorted(ends[0].keys() & ends[1].keys()), []
    for condition in dict.fromkeys(key[2] for key in both):
        keys = [key for key in both if key[2] == condition]
        for end in ("clean", "harmed"):
            met = [(ends[0][key] == end, ends[1][key] == end) for key in keys]
            alone = (sum(a and not b for a, b in met), sum(b and not a for a, b in met))
            out.append([f"`{condition}`", end, len(met), *alone, told_p(paired(met))])
    return out


def _number(value: float | None, digits: int = 1) -> str:
    return "–" if value is None else f"{value:.{digits}f}"
