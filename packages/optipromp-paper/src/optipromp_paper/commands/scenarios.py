"""``optipromp scenarios``: the paper's experiments, its figures beside ours."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from optipromp.cli.command import FAILED, OK, Report, Shown, command
from optipromp.cli.console import Recorded, Seed, grid, say_if_compiling, waiting
from optipromp.cli.plan import Output, read_primitive
from optipromp.core.errors import InvalidRequestError
from optipromp.core.files import check_folder, is_there, read_bytes, write_atomically

if TYPE_CHECKING:
    from rich.table import Table

    from optipromp_paper.scenarios import ScenarioRow


@command()
def scenarios(
    seed: Seed = 0,
    demonstrations: Recorded = None,
    out: Path | None = None,
    as_markdown: Path | None = None,
) -> Report:
    """Run the paper's four scenarios and set its figures beside ours.

    Scenarios 1 and 2 must end in a collision with the table-top, as in the
    paper; 3 and 4 must succeed. The cases "paper" have the hand, the start
    and the distances that the paper must have had. The exit code is 0 when
    all of that holds, else 1.

    Examples:
        optipromp scenarios
        optipromp scenarios --out paper --json
        optipromp scenarios --markdown docs/paper.md

    Args:
        out (DIR): Leave every plan with its figures here.
        as_markdown (--markdown FILE): Leave the tables here; in a page with marks, between them.
    """
    from optipromp_paper.scenarios import run_scenarios

    if out is not None:
        check_folder(out)
    primitive = read_primitive(demonstrations)
    say_if_compiling()
    with waiting("planning") as say:
        rows = run_scenarios(seed=seed, demonstrations=primitive, progress=say)
    if out is not None:
        with waiting("drawing"):
            for row in rows:
                Output().write(row.plan, out / f"scenario-{row.case.key}", figures=True)
    if as_markdown is not None:
        renew(as_markdown, markdown(rows))
    code = OK if all(row.as_expected for row in rows) else FAILED
    return Report({"scenarios": [row.to_dict() for row in rows]}, _shown(rows, out), code)


def _shown(rows: Sequence["ScenarioRow"], out: Path | None) -> Shown:
    yield table_one(rows)
    yield reductions(rows)
    yield "why our falls are not the paper's: docs/paper.md"
    for row in rows:
        yield f"{row.case.key}, {row.case.title}: {row.plan.message}"
    if out is not None:
        yield f"wrote the plans and their figures to {out}"


BEGIN, END = "<!-- scenarios: begin -->", "<!-- scenarios: end -->"
SHORT = {  # Statuses in the width of the table; the lines below it say more
    "success": "success",
    "HARM_PREDICTED": "harm",
    "INVALID_PLAN": "invalid",
    "TIMEOUT": "timeout",
}


def table_one(rows: Sequence["ScenarioRow"]) -> "Table":
    """Table I of the paper, ours beside it; see :func:`figures`."""
    from rich.text import Text

    title = "Table I: the paper's | ours, mm, + where the paper's test holds, ! where it fails"
    header, lines = figures(rows)
    table = grid(header, title=title, padding=(0, 1, 0, 0))
    for row, (key, status, *others) in zip(rows, lines, strict=True):
        colour = "green" if row.as_expected else "red"
        table.add_row(key, Text(status, style=colour), *others)
    return table


def reductions(rows: Sequence["ScenarioRow"]) -> "Table":
    """How far each stage's cost falls with the paper's strategy; see :func:`factors`."""
    title = "Cost before ÷ after a stage / iterations; no factors of a plan that is not valid"
    header, lines = factors(rows)
    table = grid(header, title=title, padding=(0, 1, 0, 0))
    for line in lines:
        table.add_row(*line)
    return table


def figures(rows: Sequence["ScenarioRow"]) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Header and lines of Table I: the paper's figures, ours, and whether these pass its tests. The
    column ``joints`` has M_c over joint origins. In brackets: our tool's offset along x_g."""
    ids, lines = ("n1", "n2"), list[tuple[str, ...]]()
    for row in rows:
        metrics, paper, holds = row.plan.metrics, row.case.published, row.thresholds
        published = (paper.M_c, paper.M_p) if paper else (None, {})
        offsets = (
            _pair(published[1].get(item), metrics.M_p.get(item), holds.get(f"M_p {item}"))
            + _across(metrics.passage.get(item))
            for item in ids
        )
        lines.append(
            (
                row.case.key,
                SHORT.get(row.plan.status, "other"),
                _pair(published[0], metrics.M_c, holds.get("M_c")),
                _millimetres(row.M_c_joints) + _mark(holds.get("M_c_joints")),
                *offsets,
            )
        )
    return ("scenario", "status", "M_c", "joints", *(f"M_p {item} (x_g)" for item in ids)), lines


def factors(rows: Sequence["ScenarioRow"]) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Header and lines of the factors by which each stage's cost falls, beside the paper's."""
    lines = list[tuple[str, ...]]()
    for row in rows:
        for item in row.reductions if row.staged else ():
            ours = ("–", "–", "–")
            if item.valid:
                count = f" / {item.iterations}" if item.iterations else ""
                ours = _factor(item.same), _factor(item.final) + count, _factor(item.kept)
            paper = f"÷ {item.paper:g} / {item.paper_iterations}"
            valid = "valid" if item.valid else "invalid"
            lines.append((row.case.key, valid, item.term, paper, *ours))
    return ("scenario", "plan", "cost", "paper", "as many", "stage's end", "final plan"), lines


def markdown(rows: Sequence["ScenarioRow"]) -> str:
    """Both tables for the documentation, with a description of each case."""
    header, lines = figures(rows)
    ends = ["" if row.case.published is None else f": {row.plan.reason}" for row in rows]
    told = [  # without the notes of a plan
        (*line, row.case.title + end.partition(" (")[0])
        for row, line, end in zip(rows, lines, ends, strict=True)
    ]
    return "\n".join([*_table((*header, "what it is"), told), "", *_table(*factors(rows)), ""])


def _table(header: Sequence[str], lines: Sequence[Sequence[str]]) -> list[str]:
    cells = [header, ["---"] * len(header), *lines]
    return ["| " + " | ".join(cell.replace("|", "/") for cell in line) + " |" for line in cells]


def renew(page: Path, text: str) -> None:
    """Write the tables to ``page``; where the page has both marks, only between them."""
    if is_there(page):
        old = read_bytes(page, InvalidRequestError).decode("utf-8")
        if BEGIN in old and END in old:
            before, rest = old.split(BEGIN, 1)
            text = f"{before}{BEGIN}\n\n{text}\n{END}{rest.split(END, 1)[1]}"
    write_atomically(page, text.encode("utf-8"))


def _pair(paper: float | None, ours: float | None, holds: bool | None) -> str:
    return f"{_millimetres(paper)} | {_millimetres(ours)}{_mark(holds)}"


def _across(way: tuple[float, float] | None) -> str:
    """The tool's offset along x_g in millimetres, which M_p does not include."""
    return "" if way is None else f" ({round(1e3 * way[0]):+d})"


def _mark(holds: bool | None) -> str:
    """A mark of whether a test of the paper holds; empty where there is none."""
    return "" if holds is None else "+" if holds else "!"


def _millimetres(value: float | None) -> str:
    return "–" if value is None or not math.isfinite(value) else f"{round(1e3 * value)}"


def _factor(value: float) -> str:
    if math.isnan(value):
        return "was 0"
    if value == 0.0:
        return "rose from 0"
    return "to zero" if value > 1e6 else f"÷ {value:.3g}"
