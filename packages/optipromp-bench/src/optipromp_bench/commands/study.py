"""``optipromp study``: planners compared on random scenes in the physics simulation."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from optipromp.cli.command import Report, command
from optipromp.cli.console import Cluster, Workers, grid, progress_bar, say_if_compiling, seeds_of
from optipromp.cli.plan import scene_files
from optipromp.cli.robot import ArmOptions, Whose
from optipromp.core.errors import Code, InvalidRequestError

if TYPE_CHECKING:
    from rich.table import Table

    from optipromp_bench.experiments.rows import Row
    from optipromp_bench.experiments.tables import Told


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
    from optipromp_bench.experiments.statistics import summary
    from optipromp_bench.experiments.study import write_results
    from optipromp_bench.experiments.tables import cells_in, told

    files = ", ".join(write_results(rows, summary(rows), out))
    cells, last = [c.to_dict() for c in cells_in(rows)], f"wrote rows.csv, {files} to {out}"
    return Report({"runs": len(rows), "cells": cells}, (*map(table, told(rows)), last))


def _names(text: str, all_of_them: Sequence[str]) -> tuple[str, ...]:
    if text.strip() == "all":
        return tuple(all_of_them)
    return tuple(part.strip() for part in text.split(",") if part.strip())


def table(told: "Told") -> "Table":
    """A table of a study. A name is not repeated below itself; a line parts the first names."""
    count, heads, lines = told.names, told.heads, told.lines
    if count == 2 and max(len(line[0]) for line in lines) > 15:  # variations have long names
        few = [k for k, head in enumerate(heads) if k < 8 or head == "changed"]
        heads, lines = [heads[k] for k in few], [[line[k] for k in few] for line in lines]
    out = grid(heads[:count], heads[count:], title=told.title, padding=(0, 0))
    before: list[str] = []
    for line in lines:
        own = line[:count]
        if before and before[0] != own[0]:
            out.add_section()
        same = [before[: k + 1] == own[: k + 1] for k in range(len(own) - 1)]
        words = ["" if alike else name for alike, name in zip([*same, False], own, strict=False)]
        out.add_row(*words, *line[count:])
        before = own
    if heads[-1] == "failed by":
        out.columns[-1].justify, out.columns[-1].no_wrap = "left", False
    return out
