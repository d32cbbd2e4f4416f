"""``optipromp study``: planners compared on random scenes in the physics simulation."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from optipromp.cli.command import Report, Shown, command
from optipromp.cli.console import Cluster, Workers, grid, progress_bar, say_if_compiling
from optipromp.cli.loops import LoopChoices, eyes_table, loop_causes, loop_table
from optipromp.cli.plan import scene_files
from optipromp.cli.robot import ArmOptions, Whose
from optipromp.core.errors import Code, InvalidRequestError

if TYPE_CHECKING:
    from rich.table import Table

    from optipromp.laboratory.experiments.runs import Row
    from optipromp.laboratory.experiments.statistics import Cell, Reliability


Compared = Annotated[
    list[str],
    typer.Option(
        "--planner",
        "--planners",
        metavar="NAMES",
        help="Any that 'optipromp list' names, separated by commas or one an option, or all.",
    ),
]


@command()
def study(
    out: Annotated[
        Path, typer.Option(metavar="DIR", help="Where rows go; rows that are there are kept.")
    ],
    preset: Annotated[
        str, typer.Option(metavar="NAMES", help="Presets, separated by commas, or all.")
    ] = "all",
    scenes: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Your scenes in place of presets: the scene files of a folder. The seed is then "
            "of noise, planner and physics.",
        ),
    ] = None,
    planners: Compared = ["all"],  # noqa: B006 (typer copies it)
    seeds: Annotated[
        str | None,
        typer.Option(
            metavar="A:B",
            help="Seeds of the scenes, from A to before B (0:20; with --scenes 0:1).",
            show_default=False,
        ),
    ] = None,
    noise_position: Annotated[
        float, typer.Option(metavar="METRES", help="Standard deviation of detected positions.")
    ] = 0.0,
    noise_angle: Annotated[
        float, typer.Option(metavar="DEGREES", help="Standard deviation of detected stems.")
    ] = 0.0,
    noise: Annotated[
        str,
        typer.Option(
            metavar="NAME",
            help="Of the detector: zero-mean (5 mm, 5 degrees), low and high (and all seen 10 mm "
            "too low or high), missed (fruits not seen, hidden ones more often), detector (low "
            "and missed).",
        ),
    ] = "",
    only_valid: Annotated[
        bool, typer.Option("--only-valid", help="Do not execute plans that the judge refuses.")
    ] = False,
    vary: Annotated[
        bool,
        typer.Option(
            "--vary",
            help="Execute each plan under a table of physical variations: softer and stiffer "
            "stems, friction, mass, size, damping, a tool off its place, fruits lower than seen.",
        ),
    ] = False,
    risk: Annotated[
        float,
        typer.Option(help="Share of promised successes that may be broken; less refuses more."),
    ] = 0.03,
    workers: Workers = None,
    ray: Cluster = None,
    *,
    compared_loops: LoopChoices,
    robot: Whose = None,
    arm: ArmOptions,
) -> Report:
    """Run planners on random scenes, or on yours, and execute their plans in the simulation.

    Every run is a row of rows.csv in DIR. Ctrl-C keeps what is done; the same command goes on from
    there. At the end: what was promised and picked, with 95 % intervals, broken promises,
    causes of failure, and a figure.

    [bold]Examples[/bold]

    \b
    optipromp study --preset cluster,shelf --seeds 1000:1200 --out fresh
    optipromp study --preset cluster --planners opti-promp --robot ur5.urdf --out ur5
    optipromp study --scenes my-crop --planners opti-promp --seeds 0:5 --noise zero-mean --out mine
    optipromp study --preset cluster --planner opti-promp --planner drift --vary --out varied
    optipromp study --planners opti-promp --noise-position 0.005 --noise-angle 5 --out noisy
    optipromp study --preset tight --planners opti-promp --noise detector --out detected
    optipromp study --preset cluster,field --loop open,closed --conditions sway,missed --out loops
    optipromp study --preset cluster --loop open,closed --eyes fitted --out circle
    """
    from optipromp.laboratory.experiments.baselines import study_planners
    from optipromp.laboratory.experiments.conditions import CONDITIONS
    from optipromp.laboratory.experiments.eyes import WAYS
    from optipromp.laboratory.experiments.loops import LOOP_PLANNER, LOOPS
    from optipromp.laboratory.experiments.study import Study, run_study
    from optipromp.laboratory.generate import PRESETS

    compared: Any = _names(",".join(planners), study_planners())
    loops = _names(compared_loops.loop, LOOPS)
    conditions = _names(compared_loops.conditions, tuple(CONDITIONS))
    eyes = _names(compared_loops.eyes, WAYS)
    loops = loops or (LOOPS[:1] if eyes else ())
    if loops and planners == ["all"]:
        compared = (LOOP_PLANNER,)
    given = {
        "planners": compared, "noise_position": noise_position, "noise_angle": noise_angle,
        "only_valid": only_valid, "choice": arm.of(robot).choice, "vary": vary, "noise": noise,
        "risk": risk, "loops": loops, "conditions": conditions or ("none",), "eyes": eyes,
        "finder": compared_loops.finder, "views": compared_loops.views,
        **({} if seeds is None else {"seeds": _range(seeds)}),
        **({} if robot is None else {"robot": robot}),
    }  # fmt: skip
    if scenes is None:
        plan = Study(_names(preset, PRESETS), **given)
    elif preset == "all":
        plan = Study.of_files(scene_files(scenes), **given)
    else:
        raise InvalidRequestError("--preset and --scenes: state one of them")
    say_if_compiling()
    successes: dict[str, list[bool]] = {}
    with progress_bar(20) as shown:

        def progress(done: int, total: int, row: "Row | None") -> None:
            if row is not None:
                kept = row.success and row.plan_status == Code.SUCCESS
                successes.setdefault(row.loop or row.planner, []).append(kept)
            shares = (f"{name} {sum(s)}/{len(s)}" for name, s in successes.items())
            shown(done, total, ", ".join((f"{done} of {total} runs", *shares)))

        rows = run_study(plan, out, workers=workers, ray=ray, progress=progress)
    return _report(rows, out)


def _report(rows: list["Row"], out: Path) -> Report:
    """Write the results beside the rows, and report them."""
    from optipromp.laboratory.experiments.loop_statistics import loop_summary
    from optipromp.laboratory.experiments.statistics import calibration, summary
    from optipromp.laboratory.experiments.study_output import write_results

    cells = summary(rows)
    written = write_results(rows, cells, out)
    document = {"runs": len(rows), "cells": [cell.to_dict() for cell in cells]}
    last = f"wrote rows.csv, {', '.join(written)} to {out}"
    if any(row.loop for row in rows):
        picks = loop_summary(rows)
        document["cells"] = [cell.to_dict() for cell in picks]
        seen = (eyes_table(picks),) if any(row.pictures for row in rows) else ()
        return Report(document, (*seen, loop_table(picks), loop_causes(picks), last))
    return Report(document, _shown(cells, calibration(rows), last))


def _shown(cells: Sequence["Cell"], found: "Reliability | None", last: str) -> Shown:
    yield table(cells)
    yield causes(cells)
    if found is not None:
        yield reliability(found)
    yield last


def _names(text: str, all_of_them: Sequence[str]) -> tuple[str, ...]:
    if text.strip() == "all":
        return tuple(all_of_them)
    return tuple(part.strip() for part in text.split(",") if part.strip())


def _range(text: str) -> tuple[int, int]:
    parts = text.split(":")
    try:
        first, end = (int(part) for part in parts)
    except ValueError:
        raise InvalidRequestError(f"seeds are {text!r}; write them as 0:200") from None
    return first, end


TITLE = """%: promised and picked, nothing harmed, in the simulation; 95 %: Wilson's interval
plans: those that promised it, broken: of these; executed: picked if no refusal is heeded
static, torn: runs with such contact; medians: force on unripe fruits [N], seconds"""


def table(cells: Sequence["Cell"]) -> "Table":
    """Rates, contacts, forces and median times of every preset and planner."""
    figures = ["n", "%", "95 %", "plans", "broken", "executed", "static", "torn", "unripe", "plan"]
    figures.append("run")
    if max(len(cell.preset) for cell in cells) > 15:  # variations: their names take the width
        figures = figures[:5]
    out = grid(("preset", "planner"), figures, title=TITLE, padding=(0, 0))
    for cell, first in _sections(out, cells):
        force = "–" if cell.unripe_force is None else f"{cell.unripe_force:.1f}"
        run = "–" if cell.simulation_time is None else f"{cell.simulation_time:.1f}"
        values = (
            str(cell.runs), f"{100 * cell.rate:.1f}",
            f"{100 * cell.low:.0f}–{100 * cell.high:.0f}", str(cell.plans),
            str(cell.broken), str(cell.successes), str(cell.static_contacts), str(cell.torn),
            force, f"{cell.plan_time:.2f}", run,
        )  # fmt: skip
        out.add_row(cell.preset if first else "", cell.planner, *values[: len(figures)])
    return out


def causes(cells: Sequence["Cell"]) -> "Table":
    """Why runs failed, most frequent first."""
    out = grid(
        ("preset", "planner"), title="causes of failure, a run may have several", padding=(0, 0)
    )
    out.add_column("failed by")
    for cell, first in _sections(out, cells):
        out.add_row(cell.preset if first else "", cell.planner, cell.failed_by)
    return out


def reliability(found: "Reliability") -> "Table":
    """Predicted probabilities against outcomes: the rate of failure in each bin."""
    title = (
        f"not clean, predicted and counted [%]; AUC {found.auc:.2f}; of {found.successes} plans "
        f"that promise success {found.failed} failed"
    )
    head = "predicted", "n", "mean", "failed", "%", "95 %"
    out = grid((), head, title=title, padding=(0, 0))
    for item in found.bins:
        out.add_row(
            f"{100 * item.low:g}–{100 * item.high:g}",
            str(item.runs),
            f"{100 * item.predicted:.1f}",
            str(item.failures),
            f"{100 * item.rate:.1f}",
            f"{100 * item.rate_low:.0f}–{100 * item.rate_high:.0f}",
        )
    return out


def _sections(out: "Table", cells: Sequence["Cell"]) -> Iterator[tuple["Cell", bool]]:
    """Each cell, and whether it is the first of its preset."""
    before = ""
    for cell in cells:
        if before and cell.preset != before:
            out.add_section()
        yield cell, cell.preset != before
        before = cell.preset
