"""Reports of studies: one self-contained HTML file, for screens and paper."""

import re
import shlex
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from optipromp.core.errors import Code, InvalidRequestError, OptiPrompError
from optipromp.core.output import ROWS
from optipromp.core.planning import PlanOptions
from optipromp.core.scenes.crops import load_crop
from optipromp.looks.reports import made_with, page, paragraph, picture, section, table
from optipromp_bench.experiments.rows import ERROR, NO_PLAN, Row, rows_of
from optipromp_bench.experiments.statistics import Table, summary
from optipromp_bench.experiments.study import file_of, settings_of, study_picture
from optipromp_bench.experiments.tables import tables_of
from optipromp_bench.experiments.trials import FOLDER, again
from optipromp_eyes.pictures import png_file
from optipromp_sim.generate import PANDA
from optipromp_sim.simulation import Run
from optipromp_sim.situations import AS_CROP

SIZE = 640, 360  # [pixel] of a worst case's picture
WORST = 6  # failed runs that are shown
_UNSAID = re.compile(r"(?:, )?\b\w+=(?:None|\{\}|\(\))")  # a choice of a robot's arm not made
SLIGHT = 0.2  # [N] largest force of a run whose end is shown instead of the moment of that force


def study_report(
    folder: Path | str, *, worst: int = WORST, progress: Callable[[str], None] | None = None
) -> bytes:
    """One HTML file about the study in a folder that ``optipromp bench study`` left. The ``worst``
    failed runs are made again for their pictures, if anything can be drawn off screen.
    ``progress``: called with a line about the run that is drawn."""
    folder = Path(folder)
    rows = rows_of(folder)
    if not rows:
        raise InvalidRequestError(f"{folder} holds no rows of a study ({ROWS})")
    settings, robot = settings_of(folder)
    settings["risk"] = PlanOptions(risk=settings.get("risk", PlanOptions.risk)).risk
    cells = summary(rows)
    kept, plans = sum(cell.kept for cell in cells), sum(cell.plans for cell in cells)
    title = f"Study of {len(rows)} runs"
    head = f"<h1>{title}</h1>" + paragraph(
        f"{kept} of {len(rows)} were promised, picked the target and harmed nothing, in the "
        f"physics simulation; {plans - kept} of {plans} promises were broken."
    )
    parts = [
        head,
        section("Shares", picture(study_picture(cells), "Shares with their intervals", "svg+xml")),
        section("Tables", *map(_tabled, tables_of({"": rows}))),
        *_worst(rows, worst, progress, robot, settings),
        section("Settings", table([(k, _told(v)) for k, v in settings.items() if k != FOLDER])),
        made_with(_study_command(rows, robot, settings), {}),
    ]  # fmt: skip
    return page(title, parts)


def worst_of(rows: Sequence[Row], count: int) -> list[Row]:
    """The worst failed runs: broken promises first, then by force; the causes take turns."""
    failed = [row for row in rows if not row.success and row.cause != NO_PLAN]
    failed.sort(key=lambda r: (r.plan_status != Code.SUCCESS, -(r.unripe_force or 0.0)))
    seen: dict[str, int] = {}
    rank = {}
    for row in failed:
        rank[row.key] = seen[row.cause] = seen.get(row.cause, -1) + 1
    return sorted(failed, key=lambda row: rank[row.key])[:count]


def _worst(
    rows: Sequence[Row],
    count: int,
    progress: Callable[[str], None] | None,
    robot: str | None,
    settings: Mapping[str, Any],
) -> list[str]:
    shown = []
    for row in worst_of(rows, count):
        name = f"{row.preset}, seed {row.seed}, {row.planner}"
        if row.loop:
            name = f"{row.preset}, seed {row.seed}, {row.condition}, {row.loop} loop"
        if progress is not None:
            progress(f"drawing {name} ...")
        cause = row.cause.replace("_", " ")
        caption = f"{name}: {cause}. {row.message} (plan: {row.plan_status})"
        try:
            file = file_of(settings, row.preset)
            run = None
            if row.cause != ERROR and robot is not None and (file or "scenes" not in settings):
                crop = load_crop(settings["crop"]) if "crop" in settings else None
                run = again(row, robot, settings["risk"], file, crop)
            shown.append(paragraph(caption) if run is None else picture(_picture(run), caption))
        except OptiPrompError:  # nothing can be drawn off screen, or the robot's file is not there
            shown.append(paragraph(caption))
    if not shown:
        return []
    return [section("Worst cases", f'<div class="cases">{"".join(shown)}</div>')]


def _picture(run: Run) -> bytes:
    from optipromp_sim.simulation.film import View, frames

    view = View(*SIZE)
    (shown,) = frames(run, np.array([worst_moment(run)]), view, caption=True)
    return png_file(shown)


def worst_moment(run: Run) -> float:
    """The moment of a failed run to show [s]: the first tear, else the largest force. The force is
    that on a fruit or stem. Where it is below :data:`SLIGHT`, the moment is the end."""
    rollout = run.rollout
    if rollout.torn_at:
        return min(rollout.torn_at.values())
    others = [k for k, name in enumerate(rollout.fruit_ids) if name != run.outcome.target]
    force = np.concatenate([rollout.fruit_force[:, others], rollout.stem_force], axis=1)
    if not force.size or force.max() < SLIGHT:
        return float(rollout.times[-1])
    return float(rollout.times[int(force.max(axis=1).argmax())])


def _tabled(one: Table) -> str:
    lines = ([str(cell).replace("`", "") for cell in line] for line in one.lines)
    return paragraph(one.title) + table(lines, one.heads)


def _study_command(rows: Sequence[Row], robot: str | None, settings: Mapping[str, Any]) -> str:
    first, seeds = rows[0], [row.seed for row in rows]
    names = {"preset": "presets", "planner": "planners"}
    if first.loop:
        seen = "eyes" if first.finder else "conditions"
        names = {"preset": "presets", "loop": "loops", "condition": seen}
    said: dict[str, Any] = {
        field: ",".join(dict.fromkeys(getattr(row, name) for row in rows))
        for name, field in names.items()
    }
    files = [said.pop("presets")] if any(Path(row.preset).suffix for row in rows) else []
    said |= {"seeds": f"{min(seeds)}:{max(seeds) + 1}", "noise": first.noise}
    if not first.noise:
        said |= {name: getattr(first, name) or "" for name in ("noise_position", "noise_angle")}
    if first.variation:
        said["vary"] = "crop" if first.variation == AS_CROP else "true"
    if (risk := settings["risk"]) != PlanOptions.risk:
        said["risk"] = risk
    words = [f"{field}={value}" for field, value in said.items() if value != ""]
    words += ["--scenes", "DIR"] if files else []
    if robot != PANDA and not files:
        words += ["--robot", robot or "ROBOT"]
    if "crop" in settings:
        words += ["--crop", crop if isinstance(crop := settings["crop"], str) else "CROP.yaml"]
    return shlex.join(["optipromp", "bench", "study", *words, "--out", "DIR"])


def _told(value: object) -> str:
    """A setting in words; the robot's without the choices that were not made."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, Mapping):
        return str(value.get("name", ", ".join(value)))
    return _UNSAID.sub("", str(value)).replace("Choice(", "(").removesuffix(" ()") or "its own"
