"""``optipromp scenarios``: the paper's experiments, its figures beside ours."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from optipromp.cli.console import (
    FAILED,
    OK,
    AsJson,
    Recorded,
    Seed,
    command,
    grid,
    print_json,
    say_if_compiling,
    stdout,
    waiting,
)
from optipromp.cli.plan import read_primitive, write

if TYPE_CHECKING:
    from rich.table import Table

    from optipromp.experiments.scenarios import ScenarioRow


@command()
def scenarios(
    seed: Seed = 0,
    demonstrations: Recorded = None,
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Leave every plan with its figures here.")
    ] = None,
    as_json: AsJson = False,
) -> int:
    """Run the paper's four scenarios and set its figures beside ours.

    Scenarios 1 and 2 must end in a collision with the table-top, as in the
    paper; 3 and 4 must succeed. The cases "paper" have the hand, the start
    and the distances that the paper must have had. The exit code is 0 when
    all of that holds, else 1.

    [bold]Examples[/bold]

    \b
    optipromp scenarios
    optipromp scenarios --out paper --json
    """
    from optipromp.experiments.scenarios import run_scenarios

    if out is not None:
        from optipromp.files import check_folder

        check_folder(out)
    primitive = None if demonstrations is None else read_primitive(demonstrations)
    say_if_compiling()
    with waiting("planning ...") as say:
        rows = run_scenarios(seed=seed, demonstrations=primitive, progress=say)
    document = {"scenarios": [row.to_dict() for row in rows]}
    if out is not None:
        with waiting("drawing ..."):
            for row in rows:
                write(row.plan, out / f"scenario-{row.case.key}")
    if as_json:
        print_json(document)
    else:
        console = stdout()
        console.print(table_one(rows))
        console.print(reductions(rows))
        for row in rows:
            console.print(f"{row.case.key}, {row.case.title}: {row.plan.message}", markup=False)
        if out is not None:
            console.print(f"wrote the plans and their figures to {out}", markup=False)
    return OK if all(row.as_expected for row in rows) else FAILED


SHORT = {
    "success": "success", "HARM_PREDICTED": "harm", "INVALID_PLAN": "invalid", "TIMEOUT": "timeout",
}  # fmt: skip
"""Statuses as the table has room for them; the lines below it say more."""


def table_one(rows: Sequence["ScenarioRow"]) -> "Table":
    """Table I of the paper, ours beside it, with what the paper verifies of each figure.

    The column ``joints`` has M_c over joint origins. In brackets: where our tool passes along x_g.
    """
    ids = ("n1", "n2")
    title = "Table I: the paper's | ours, mm, + where the paper's test holds, ! where it fails"
    columns = ("scenario", "status", "M_c", "joints", *(f"M_p {item} (x_g)" for item in ids))
    table = grid(columns, title=title, padding=(0, 1, 0, 0))
    for row in rows:
        metrics, paper, holds = row.plan.metrics, row.case.published, row.thresholds
        published = (paper.M_c, paper.M_p) if paper else (None, {})
        offsets = (
            _pair(published[1].get(item), metrics.M_p.get(item), holds.get(f"M_p {item}"))
            + _across(metrics.passage.get(item))
            for item in ids
        )
        table.add_row(
            row.case.key,
            f"[{'green' if row.as_expected else 'red'}]{SHORT.get(row.plan.status, 'other')}[/]",
            _pair(published[0], metrics.M_c, holds.get("M_c")),
            _millimetres(row.M_c_joints) + _mark(holds.get("M_c_joints")),
            *offsets,
        )
    return table


def reductions(rows: Sequence["ScenarioRow"]) -> "Table":
    """How far each stage's cost falls with the paper's strategy, beside the paper."""
    title = "Cost before ÷ after a stage / iterations; no factors of a plan that is not valid"
    columns = ("scenario", "plan", "cost", "paper", "as many", "stage's end", "final plan")
    table = grid(columns, title=title, padding=(0, 1, 0, 0))
    for row in rows:
        for item in row.reductions if row.case.strategy == "sequential" else ():
            ours = ("–", "–", "–")
            if item.valid:
                count = f" / {item.iterations}" if item.iterations else ""
                ours = _factor(item.same), _factor(item.final) + count, _factor(item.kept)
            table.add_row(
                row.case.key,
                "valid" if item.valid else "invalid",
                item.term,
                f"÷ {item.paper:g} / {item.paper_iterations}",
                *ours,
            )
    return table


def _pair(paper: float | None, ours: float | None, holds: bool | None) -> str:
    return f"{_millimetres(paper)} | {_millimetres(ours)}{_mark(holds)}"


def _across(way: tuple[float, float] | None) -> str:
    """Where the tool passes along x_g, of which M_p says nothing."""
    return "" if way is None else f" ({round(1e3 * way[0]):+d})"


def _mark(holds: bool | None) -> str:
    """Whether a threshold of the paper holds; nothing where there is none."""
    return "" if holds is None else "+" if holds else "!"


def _millimetres(value: float | None) -> str:
    return "–" if value is None or not math.isfinite(value) else f"{round(1e3 * value)}"


def _factor(value: float) -> str:
    if math.isnan(value):
        return "was 0"
    if value == 0.0:
        return "rose from 0"
    return "to zero" if value > 1e6 else f"÷ {value:.3g}"
