"""``optipromp scenarios``: the paper's experiments, its figures beside ours."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from optipromp.cli.console import (
    FAILED,
    OK,
    command,
    print_json,
    say_if_compiling,
    stdout,
    waiting,
)
from optipromp.cli.plan import leave, read_primitive

if TYPE_CHECKING:
    from rich.table import Table

    from optipromp.experiments.scenarios import Row


@command()
def scenarios(
    seed: Annotated[int, typer.Option(min=0, help="Same seed, same plans.")] = 0,
    demonstrations: Annotated[
        Path | None, typer.Option(help="What the Panda learns from, in scenarios 3 and 4.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Leave every plan with its figures here.")
    ] = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print one JSON document and nothing else.")
    ] = False,
) -> int:
    """Run the paper's four scenarios and set its figures beside ours.

    Scenarios 1 and 2 must end in a collision with the table-top, as in the
    paper; 3 and 4 must succeed with the joint strategy. The exit code is 0
    when all of that holds, else 1.

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
        for row in rows:
            leave(row.plan, out / f"scenario-{row.case.key}")
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


def table_one(rows: Sequence["Row"]) -> "Table":
    """Table I of the paper, ours beside it."""
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    ids = ("n1", "n2")
    table = Table(
        box=SIMPLE_HEAD,
        title="Table I: the paper's figures | ours, millimetres",
        title_justify="left",
        pad_edge=False,
        padding=(0, 1, 0, 0),
    )
    for name in ("scenario", "status", "M_c", *(f"M_p {item}" for item in ids), "static", "time"):
        table.add_column(name, no_wrap=True)
    for row in rows:
        metrics, paper = row.plan.metrics, row.case.published
        table.add_row(
            row.case.key,
            f"[{'green' if row.as_expected else 'red'}]{row.plan.status}[/]",
            _pair(paper.M_c if paper else None, metrics.M_c),
            *(_pair(paper.M_p[item] if paper else None, metrics.M_p.get(item)) for item in ids),
            _millimetres(metrics.clearance_static),
            f"{row.plan.time['total']:.2f} s",
        )
    return table


def reductions(rows: Sequence["Row"]) -> "Table":
    """How far each stage's cost falls with the paper's strategy, beside the paper."""
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    table = Table(
        box=SIMPLE_HEAD,
        title="Cost before ÷ after a stage, sequential strategy",
        title_justify="left",
        pad_edge=False,
    )
    for name in ("scenario", "cost", "paper", "ours, as many", "ours, at the end"):
        table.add_column(name)
    for row in rows:
        for item in row.reductions if row.case.strategy == "sequential" else ():
            table.add_row(
                row.case.key,
                item.term,
                f"÷ {item.paper:g} in {item.paper_iterations}",
                _factor(item.same),
                _factor(item.final) + (f" in {item.iterations}" if item.iterations else ""),
            )
    return table


def _pair(paper: float | None, ours: float | None) -> str:
    return f"{_millimetres(paper)} | {_millimetres(ours)}"


def _millimetres(value: float | None) -> str:
    return "–" if value is None or not math.isfinite(value) else f"{1e3 * value:.0f}"


def _factor(value: float) -> str:
    if math.isnan(value):
        return "nothing to lower"
    return "to zero" if value > 1e6 else f"÷ {value:.3g}"
