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

    Scenarios 1 and 2 must end in a collision with the table-top, as in the paper; 3 and 4 must
    succeed with the joint strategy. The exit code is 0 when all of that holds, else 1.

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
            if row.plan.message:
                console.print(f"{row.case.key}: {row.plan.message}", markup=False)
        if out is not None:
            console.print(f"wrote the plans and their figures to {out}", markup=False)
    return OK if all(row.as_expected for row in rows) else FAILED


def table_one(rows: Sequence["Row"]) -> "Table":
    """Table I of the paper, ours beside it."""
    from rich.table import Table

    table = Table(title="Table I: the paper's figures and ours [m]", title_justify="left")
    for name in ("scenario", "", "status", "M_c paper", "M_c ours"):
        table.add_column(name)
    ids = ("n1", "n2")
    for item in ids:
        table.add_column(f"M_p {item} paper")
        table.add_column("ours")
    for name in ("stems", "static", "goal", "time"):
        table.add_column(name)
    for row in rows:
        metrics, paper = row.plan.metrics, row.case.published
        cells = [
            row.case.key,
            row.case.title,
            f"[{'green' if row.as_expected else 'red'}]{row.plan.status}[/]",
            number(paper.M_c if paper else None),
            number(metrics.M_c),
        ]
        for item in ids:
            cells += [number(paper.M_p[item] if paper else None), number(metrics.M_p.get(item))]
        cells += [
            _sides(row),
            number(metrics.clearance_static),
            number(metrics.goal_error),
            f"{row.plan.time.get('total', math.nan):.3f} s",
        ]
        table.add_row(*cells)
    return table


def reductions(rows: Sequence["Row"]) -> "Table":
    """How far each stage's cost falls, beside the paper."""
    from rich.table import Table

    table = Table(title="Cost reductions, before ÷ after", title_justify="left")
    for name in (
        "scenario",
        "cost",
        "stage",
        "paper",
        "ours, as many iterations",
        "ours, at its end",
    ):
        table.add_column(name)
    for row in rows:
        for item in row.reductions:
            table.add_row(
                row.case.key,
                item.term,
                item.stage,
                f"÷ {item.paper:g} in {item.paper_iterations}",
                f"÷ {_factor(item.same)}",
                f"÷ {_factor(item.final)} in {item.iterations}",
            )
    return table


def number(value: float | None) -> str:
    """A length for a table; a dash where there is none."""
    if value is None or not math.isfinite(value):
        return "–"
    return f"{value:.4f}" if abs(value) >= 1e-4 or value == 0 else f"{value:.1e}"


def _factor(value: float) -> str:
    return "∞" if math.isinf(value) else f"{value:.3g}"


def _sides(row: "Row") -> str:
    """Whether the tool passes every pushable on the side away from its stem."""
    metrics = row.plan.metrics
    sides = []
    for item, offset in metrics.M_p.items():
        stem = metrics.stem_projection.get(item)
        if offset is not None and stem is not None:
            sides.append(offset * stem < 0)
    return "–" if not sides else "away" if all(sides) else "crossed"
