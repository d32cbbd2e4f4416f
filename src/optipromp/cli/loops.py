"""The options and the tables of a study of loops."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import typer

from optipromp.cli.console import grid

if TYPE_CHECKING:
    from rich.table import Table

    from optipromp.laboratory.experiments.loop_statistics import LoopCell

TITLE = """%: clean: picked, nothing harmed, in the simulation; 95 %: Wilson's interval
harmed, gave up, refused, missed [%]; back: retreats; s: median duration"""
EYES_TITLE = """% of runs: a ripe fruit seen, a plan made, the fruit in the tool at the end (95 %:
Wilson's interval), something harmed; recall [%] of visible fruits in the pictures before the plan;
false: wrong detections a run; see: median processor time of seeing [s]"""
LEFT = "preset", "condition", "loop"


@dataclass(frozen=True)
class LoopChoices:
    """The options that choose loops and conditions."""

    loop: Annotated[
        str,
        typer.Option(
            metavar="NAMES",
            help="Instead of planners compare open (plan, execute blind), looks (look again at the "
            "camera point, execute blind) and closed (the controller), or all.",
        ),
    ] = ""
    conditions: Annotated[
        str,
        typer.Option(
            metavar="NAMES",
            help="Of loops: none, zero-mean, detector, missed, lower, aside, sway, calibration, "
            "limp, all (at once); 'all' by itself is each of them, 'all,' that one.",
        ),
    ] = ""
    eyes: Annotated[
        str,
        typer.Option(
            metavar="NAMES",
            help="Of loops (open by itself): scenes are seen by the eyes. rendered: in pictures, "
            "in the closed loop too, for a handful of scenes; fitted: by a camera model with the "
            "errors of these eyes.",
        ),
    ] = ""
    finder: Annotated[
        str, typer.Option(metavar="NAME", help="Of --eyes, what finds fruits in pictures.")
    ] = "geometry"
    views: Annotated[
        int,
        typer.Option(metavar="1|2", help="Of --eyes: pictures from as many sides, before a plan."),
    ] = 1


def eyes_table(cells: Sequence["LoopCell"]) -> "Table":
    """What became of the circle: fruits seen, scenes planned in, fruits picked."""
    figures = "n", "seen", "planned", "picked", "95 %", "harm", "recall", "false", "see"
    out = grid(LEFT, figures, title=EYES_TITLE, padding=(0, 0))
    before = ("", "")
    for cell in cells:
        if before[0] not in ("", cell.preset):
            out.add_section()
        low, high = cell.picked_interval
        recall = f"{100 * cell.found / cell.visible:.3g}" if cell.visible else "–"
        out.add_row(
            *_names(cell, before), str(cell.runs),
            *(f"{100 * k / cell.runs:.3g}" for k in (cell.seen, cell.planned, cell.picked)),
            f"{100 * low:.0f}–{100 * high:.0f}", f"{100 * cell.harmed / cell.runs:.3g}", recall,
            f"{cell.false / cell.runs:.2f}" if cell.visible else "–",
            "–" if cell.see_time is None else f"{cell.see_time:.2f}",
        )  # fmt: skip
        before = (cell.preset, cell.condition)
    return out


def loop_table(cells: Sequence["LoopCell"]) -> "Table":
    """What became of the picks of every preset, condition and loop."""
    figures = "n", "%", "95 %", "harm", "gave", "ref", "miss", "s", "back"
    out = grid(LEFT, figures, title=TITLE, padding=(0, 0))
    before = ("", "")
    for cell in cells:
        if before[0] not in ("", cell.preset):
            out.add_section()
        shares = (cell.harmed, cell.gave_up, cell.refused, cell.missed)
        out.add_row(
            *_names(cell, before), str(cell.runs), f"{100 * cell.rate:.3g}",
            f"{100 * cell.low:.0f}–{100 * cell.high:.0f}",
            *(f"{100 * count / cell.runs:.3g}" for count in shares),
            "–" if cell.duration is None else f"{cell.duration:.1f}", str(cell.retreats),
        )  # fmt: skip
        before = (cell.preset, cell.condition)
    return out


def loop_causes(cells: Sequence["LoopCell"]) -> "Table":
    """Why runs were not clean, most frequent first."""
    out = grid(LEFT, title="causes of failure, a run may have several", padding=(0, 0))
    out.add_column("failed by")
    before = ("", "")
    for cell in cells:
        if before[0] not in ("", cell.preset):
            out.add_section()
        out.add_row(*_names(cell, before), cell.failed_by)
        before = (cell.preset, cell.condition)
    return out


def _names(cell: "LoopCell", before: tuple[str, str]) -> tuple[str, str, str]:
    """The first three columns; a name that stands in the row ``before`` is left out."""
    new = cell.preset != before[0]
    fresh = new or cell.condition != before[1]
    return cell.preset if new else "", cell.condition if fresh else "", cell.loop
