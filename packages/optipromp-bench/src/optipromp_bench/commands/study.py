"""``optipromp study``: planners compared on random scenes in the physics simulation."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeVar

from optipromp.cli.command import Report, command
from optipromp.cli.console import Cluster, Workers, grid, progress_bar, say_if_compiling, seeds_of
from optipromp.cli.plan import scene_files
from optipromp.cli.robot import ArmOptions, Whose
from optipromp.core.errors import Code, InvalidRequestError

if TYPE_CHECKING:
    from rich.table import Table

    from optipromp_bench.experiments.rows import Row
    from optipromp_bench.experiments.statistics import (
        Cell,
        LoopCell,
        PlanCell,
        Reliability,
        StudyCell,
    )


@dataclass(frozen=True)
class LoopChoices:
    """The options that choose loops and conditions.

    Attributes:
        loop (NAMES): Instead of planners compare open (plan, execute blind) and closed (the
            controller), or all.
        conditions (NAMES): Of loops: none, zero-mean, detector, missed, lower, aside, sway,
            calibration, limp, near, frozen, early, breaks, larger, gust, stiff, all (what
            errs up to limp, at once); 'all' by itself is each of them, 'all,' that one.
        eyes (NAMES): Of loops (open by itself): scenes are seen by the eyes. rendered: in pictures,
            in the closed loop too, for a handful of scenes; fitted: by a camera model with the
            errors of these eyes.
        finder (NAME): Of --eyes, what finds fruits in pictures.
        views (1|2): Of --eyes: pictures from as many sides, before a plan.
    """

    loop: str = ""
    conditions: str = ""
    eyes: str = ""
    finder: str = "geometry"
    views: int = 2


@command()
def study(
    what: Literal["crop"] | None = None,
    /,
    *,
    out: Path,
    preset: str = "all",
    scenes: Path | None = None,
    planners: list[str] = ["all"],  # noqa: B006 (typer copies it)
    seeds: str | None = None,
    noise_position: float = 0.0,
    noise_angle: float = 0.0,
    noise: str = "",
    only_valid: bool = False,
    vary: bool = False,
    risk: float = 0.03,
    workers: Workers = None,
    ray: Cluster = None,
    crop: str | None = None,
    compared_loops: LoopChoices,
    robot: Whose = None,
    arm: ArmOptions,
) -> Report:
    """Run planners on random scenes, or on yours, and execute their plans in the simulation.

    Every run is a row of rows.csv in DIR. Ctrl-C keeps what is done; the same command goes on from
    there. At the end: what was promised and picked, with 95 % intervals, broken promises,
    causes of failure, and a figure.

    Examples:
        optipromp study --preset cluster,shelf --seeds 1000:1200 --out fresh
        optipromp study --preset cluster --planners opti-promp --robot ur5.urdf --out ur5
        optipromp study --scenes mine --planners opti-promp --seeds 0:5 --noise zero-mean --out own
        optipromp study --preset cluster --planner opti-promp --planner drift --vary --out varied
        optipromp study --preset cluster --crop tomato --vary crop --out guesses
        optipromp study --planners opti-promp --noise-position 0.005 --noise-angle 5 --out noisy
        optipromp study --preset tight --planners opti-promp --noise detector --out detected
        optipromp study --preset cluster,field --loop open,closed --conditions sway,missed --out two
        optipromp study --preset cluster --loop open,closed --eyes fitted --out circle

    Args:
        what: With --vary: each guess of the scenes' crop low and high, and which of them change a
            result.
        out (DIR): Where rows go; rows that are there are kept.
        preset (NAMES): Presets, separated by commas, or all.
        scenes (DIR): Your scenes in place of presets: the scene files of a folder. The seed is then
            of noise, planner and physics.
        planners (--planner --planners NAMES): Any that 'optipromp list' names, separated by commas
            or one an option, or all.
        seeds (A:B): Seeds of the scenes, from A to before B (0:20; with --scenes 0:1).
        noise_position (METRES): Standard deviation of detected positions.
        noise_angle (DEGREES): Standard deviation of detected stems.
        noise (NAME): Of the detector: zero-mean (5 mm, 5 degrees), low and high (and all seen 10 mm
            too low or high), missed (fruits not seen, hidden ones more often), detector (low and
            missed).
        only_valid: Do not execute plans that the judge refuses.
        vary: Execute each plan under a table of physical variations: softer and stiffer stems, that
            stretch, friction, mass, size, damping, a tool off its place, fruits lower than seen.
            --vary crop varies what nobody measured of a crop instead.
        risk: Share of promised successes that may be broken; less refuses more.
        crop (CROP): Of the scenes' fruits: strawberry, tomato, apple or a file; harm is judged in
            its units.
    """
    from optipromp.core.scenes.crops import load_crop
    from optipromp_bench.experiments.eyes import WAYS
    from optipromp_bench.experiments.study import Study, run_study
    from optipromp_bench.experiments.trials import study_planners
    from optipromp_sim.generate import PRESETS
    from optipromp_sim.situations import CONDITIONS, LOOP_PLANNER, LOOPS

    if what is not None and not vary:
        raise InvalidRequestError(f"{what} goes with --vary: write --vary {what}")
    compared: Any = _names(",".join(planners), study_planners())
    loops = _names(compared_loops.loop, LOOPS)
    conditions = _names(compared_loops.conditions, tuple(CONDITIONS))
    eyes = _names(compared_loops.eyes, WAYS)
    loops = loops or (LOOPS[:1] if eyes else ())
    if loops and planners == ["all"]:
        compared = (LOOP_PLANNER,)
    given = {
        "planners": compared, "noise_position": noise_position, "noise_angle": noise_angle,
        "only_valid": only_valid, "choice": arm.of(robot).choice, "noise": noise,
        "vary": what or vary, "crop": None if crop is None else load_crop(crop),
        "risk": risk, "loops": loops, "conditions": conditions or ("none",), "eyes": eyes,
        "finder": compared_loops.finder, "views": compared_loops.views,
        **({} if seeds is None else {"seeds": seeds_of(seeds)}),
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
    from optipromp_bench.experiments.statistics import calibration, loop_summary, summary
    from optipromp_bench.experiments.study import write_results

    plans, loops = summary(rows), loop_summary(rows) if any(row.loop for row in rows) else ()
    cells: Sequence[StudyCell] = loops or plans
    last = f"wrote rows.csv, {', '.join(write_results(rows, plans, out))} to {out}"
    shown = []
    if loops:
        if any(row.pictures for row in rows):
            shown.append(table(loops, LOOP_NAMES, EYES, EYES_TITLE))
        shown.append(table(loops, LOOP_NAMES, LOOP, LOOP_TITLE))
    else:
        columns = dict(PLANNER)
        if max(len(cell.preset) for cell in plans) > 15:  # variations: their names take the width
            columns = dict(list(columns.items())[:6])
        if plans[0].changed is not None:  # by a guess of the crop
            columns["changed"] = _number("changed")
        shown.append(table(plans, NAMES, columns, TITLE))
    shown.append(causes(cells, LOOP_NAMES if loops else NAMES))
    if not loops and (known := calibration(rows)) is not None:
        shown.append(reliability(known))
    return Report({"runs": len(rows), "cells": [c.to_dict() for c in cells]}, (*shown, last))


def _names(text: str, all_of_them: Sequence[str]) -> tuple[str, ...]:
    if text.strip() == "all":
        return tuple(all_of_them)
    return tuple(part.strip() for part in text.split(",") if part.strip())


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
C = TypeVar("C", bound="Cell")


def _number(name: str, digits: int = 0) -> "Callable[[Cell], str]":
    """A figure with so many decimals; a dash where there is none."""

    def column(cell: "Cell") -> str:
        value = getattr(cell, name)
        return "–" if value is None else f"{value:.{digits}f}"

    return column


def _share(name: str) -> "Callable[[Cell], str]":
    """A count in percent of the runs."""
    return lambda cell: f"{100 * getattr(cell, name) / cell.runs:.3g}"


PLANNER: "Mapping[str, Callable[[PlanCell], str]]" = {
    "n": _number("runs"), "0.3.0": lambda cell: f"{100 * cell.kept_before / cell.runs:.1f}",
    "%": lambda cell: f"{100 * cell.rate:.1f}",
    "95 %": lambda cell: cell.interval, "plans": _number("plans"), "broken": _number("broken"),
    "all": _number("successes"), "torn": _number("torn"), "plan": _number("plan_time", 2),
    "cycle": _number("cycle", 1), "clean": _number("clean_seconds", 1),
}  # fmt: skip
LOOP: "Mapping[str, Callable[[LoopCell], str]]" = {
    "n": _number("runs"), "0.3.0": _share("kept_before"), "%": _share("clean"),
    "95 %": lambda cell: cell.interval, "harm": _share("harmed"), "gave": _share("gave_up"),
    "ref": _share("refused"), "miss": _share("missed"), "s": _number("duration", 1),
    "clean": _number("clean_seconds", 1), "back": _number("retreats"),
}  # fmt: skip
EYES: "Mapping[str, Callable[[LoopCell], str]]" = {
    "n": _number("runs"), "seen": _share("seen"), "planned": _share("planned"),
    "picked": _share("picked"),
    "95 %": lambda cell: "–".join(f"{100 * end:.0f}" for end in cell.picked_interval),
    "harm": _share("harmed"),
    "recall": lambda cell: f"{100 * cell.found / cell.visible:.3g}" if cell.visible else "–",
    "false": lambda cell: f"{cell.false / cell.runs:.2f}" if cell.visible else "–",
    "see": _number("see_time", 2),
}  # fmt: skip


def table(
    cells: Sequence[C], names: Sequence[str], columns: Mapping[str, Callable[[C], str]], title: str
) -> "Table":
    """Cells as rows of a table: their names, then the columns. A name is not repeated below itself.
    A line parts the presets."""
    out = grid(names, list(columns), title=title, padding=(0, 0))
    before: list[str] = []
    for cell in cells:
        own = [getattr(cell, name) for name in names]
        if before and before[0] != own[0]:
            out.add_section()
        same = [before[: k + 1] == own[: k + 1] for k in range(len(own) - 1)]
        words = ["" if alike else name for alike, name in zip([*same, False], own, strict=True)]
        out.add_row(*words, *(column(cell) for column in columns.values()))
        before = own
    return out


def causes(cells: Sequence["StudyCell"], names: Sequence[str]) -> "Table":
    """Why runs failed, most frequent first."""
    title = "causes of failure, a run may have several"
    out = table(cells, names, {"failed by": lambda cell: cell.failed_by}, title)
    out.columns[-1].justify, out.columns[-1].no_wrap = "left", False
    return out


def reliability(found: "Reliability") -> "Table":
    """Predicted probabilities against outcomes: the rate of failure in each bin."""
    title = (
        f"not clean, predicted and counted [%]; AUC {found.auc:.2f}; of {found.successes} plans "
        f"that promise success {found.failed} failed"
    )
    head = "predicted", "n", "mean", "failed", "%", "95 %"
    out = grid((), head, title=title, padding=(0, 0))
    for row in found.rows():
        out.add_row(*row)
    return out
