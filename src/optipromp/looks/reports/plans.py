"""The report of a plan that was written, and of its simulated run where there is one."""

import json
import math
import shlex
from collections.abc import Callable
from html import escape
from pathlib import Path
from typing import Any

from optipromp.core.documents import read_document
from optipromp.core.errors import InvalidRequestError, InvalidSceneError
from optipromp.core.files import is_file, is_folder, reading
from optipromp.core.output import load_plan
from optipromp.core.planning import Plan
from optipromp.core.scenes.io import scene_from_dict
from optipromp.laboratory.experiments.scenarios import CASES, ScenarioRow
from optipromp.looks.reports.html import (
    LARGEST_FILE,
    film,
    made_with,
    page,
    paragraph,
    picture,
    section,
    table,
)
from optipromp.looks.viewer.embed import plan_page, scene_page
from optipromp.looks.viewer.figures import changed_terms, cost_figure, joint_figure, png
from optipromp.looks.viewer.notebook import DPI, HEIGHT, frame
from optipromp.looks.viewer.reach import reach_figure
from optipromp.looks.viewer.words import author, plan_rows, seconds

OURS = "—"


def plan_report(folder: Path | str) -> bytes:
    """One HTML file, at most 5 MB, about the plan in a folder that ``optipromp plan`` left.

    The report includes the outcome and film that ``optipromp simulate`` left in the folder. Without
    viser the 3-D view is left out.
    """
    folder = Path(folder)
    plan = load_plan(folder)
    folder = folder if is_folder(folder) else folder.parent
    written = json.loads((folder / "plan.json").read_text(encoding="utf-8")).get("version", "")
    title = f"{plan.scene.name}: {plan.planner}"
    kind = "good" if plan.success else "bad"
    total = seconds(plan.time.get("total", math.nan))
    head = (
        f"<h1>{escape(title)}</h1>"
        + paragraph(f"{plan.status} in {total}", f"status {kind}")
        + paragraph(plan.message)
    )
    figures = [
        ("The arm, and the cluster along two axes", reach_figure(plan)),
        ("Joints over time", joint_figure(plan)),
    ]
    if changed_terms(plan):
        figures.append(("Costs over the iterations", cost_figure(plan)))
    parts = [
        head,
        _shown(lambda: plan_page(plan), "Turn it with the mouse; pushed fruits move as predicted."),
        section("Pictures", *(picture(png(figure, DPI), name) for name, figure in figures)),
        section("Metrics", table(plan_rows(plan))),
        *_beside_paper(plan),
        *_contacts(plan),
        *_run(folder),
        section("Settings", table(_settings(plan))),
        made_with(_command(plan), {"plan written by": f"optipromp {written}"}),
    ]
    return _fitted(title, parts, folder)


def run_report(folder: Path | str) -> bytes:
    """One HTML file, at most 5 MB, about the rollout in a folder that ``simulate --out`` left."""
    folder = Path(folder)
    document = read_document(folder / "outcome.json", InvalidRequestError, "an outcome")
    with reading(folder, "no rollout of this version", passes=(InvalidSceneError,)):
        scene = scene_from_dict(document["scene_file"], base_dir=folder, source=str(folder))
        words = ["optipromp", "simulate", f"{scene.name}.yaml", "--seed", str(document["seed"])]
    title = f"{scene.name}: executed in the physics simulation"
    view = _shown(lambda: scene_page(scene), "Turn it with the mouse; the arm is at its start.")
    made = made_with(shlex.join(words), {"written by": f"optipromp {document.get('version')}"})
    return _fitted(title, [f"<h1>{escape(title)}</h1>", view, *_run(folder), made], folder)


def _fitted(title: str, parts: list[str], folder: Path) -> bytes:
    """The page, with the folder's film where there is room, without 3-D where there is none."""
    films = [path for kind in ("webm", "mp4") if is_file(path := folder / f"run.{kind}")]
    if films:
        newest = max(films, key=lambda path: path.stat().st_mtime)
        words = "The run in the physics simulation"
        shown = film(newest.read_bytes(), newest.suffix[1:], words)
        if sum(map(len, parts)) + len(shown) < LARGEST_FILE:
            parts.insert(2, section("Film", shown, screen=True))
    if sum(map(len, parts)) > LARGEST_FILE:
        parts[1] = section("3-D", paragraph("Left out: it is too large.", "faint"), screen=True)
    return page(title, parts)


def _shown(view: Callable[[], str], words: str) -> str:
    try:
        content = frame(view(), HEIGHT)
    except InvalidRequestError as error:
        content = paragraph(f"Left out: {error.message}.", "faint")
    return section("3-D", content, paragraph(words, "faint"), screen=True)


def _beside_paper(plan: Plan) -> list[str]:
    """The section of the paper's figures of the same scene beside the plan's."""
    cases = [case for case in CASES if case.scene == plan.scene.name and case.published]
    alike = [case for case in cases if case.strategy == plan.strategy]
    case = next(iter(alike or cases), None)
    if case is None or case.published is None:
        return []
    row, published, metrics = ScenarioRow(case, plan), case.published, plan.metrics
    holds = {None: OURS, True: "holds", False: "fails"}
    rows = [("M_c", _mm(published.M_c), _mm(metrics.M_c), holds[row.thresholds.get("M_c")])]
    rows += [
        (f"M_p {name}", _mm(value), _mm(metrics.M_p.get(name)),
         holds[row.thresholds.get(f"M_p {name}")])
        for name, value in published.M_p.items()
    ]  # fmt: skip
    rows += [
        (f"cost {item.term}, before ÷ after", f"{item.paper:g} in {item.paper_iterations}",
         f"{item.final:.3g} in {item.iterations}" if math.isfinite(item.final) else OURS, OURS)
        for item in row.reductions
    ]  # fmt: skip
    head = "figure", "the paper's", "this plan's", "the paper's test"
    return [section("Beside the paper", table(rows, head))]


def _contacts(plan: Plan) -> list[str]:
    if not plan.contacts:
        return []
    rows = [tuple(str(value) for value in vars(contact).values()) for contact in plan.contacts]
    return [section("Touches that must not be", table(rows, tuple(vars(plan.contacts[0]))))]


def _run(folder: Path) -> list[str]:
    """The outcome of the simulated run beside the plan."""
    path = folder / "outcome.json"
    if not is_file(path):
        return []
    try:
        found: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        good = "picked, nothing harmed" if found["picked"] else "nothing harmed"
        rows = [
            ("outcome", good if found["success"] else f"{found['cause']}"),
            ("in words", found["message"]),
            ("largest force on what is not to be picked", f"{found['unripe_peak_force']:.2f} N"),
            *(
                (f"force on {name}", f"{force:.2f} N")
                for name, force in found["peak_force"].items()
            ),
            ("tracking error", f"{1e3 * found['tracking_error']:.2f} mm"),
            ("duration", f"{found['duration']:.2f} s"),
        ]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InvalidRequestError(
            f"{path}: not an outcome that 'simulate' left ({error})"
        ) from None
    return [section("In the physics simulation", table(rows))]


def _settings(plan: Plan) -> list[tuple[str, str]]:
    scene, tool = plan.scene, plan.robot.tool
    rows = [
        ("planner", author(plan)),
        ("seed", str(plan.seed)),
        ("robot", repr(plan.robot)[7:-1]),
        ("tool", "none" if tool is None else repr(tool)),
        ("scene", repr(scene)[7:-1]),
        ("start", ", ".join(f"{value:.4g}" for value in plan.trajectory.positions[0])),
        ("approach", f"along {scene.frame[2].round(4).tolist()}"),
        *((f"option {name}", str(value)) for name, value in scene.options.items()),
        *((f"time, {name}", seconds(value)) for name, value in plan.time.items()),
        *((f"stage {stage.name}", f"{stage.solver}: {stage.message}") for stage in plan.stages),
    ]
    return [(name, value) for name, value in rows if value]


def _command(plan: Plan) -> str:
    from optipromp.core.scenes.io import scene_names

    name = plan.scene.name
    words = ["optipromp", "plan", name if name in scene_names() else f"{name}.yaml"]
    words += ["--planner", plan.planner]
    if plan.strategy:
        words += ["--strategy", plan.strategy]
    return shlex.join([*words, "--seed", str(plan.seed), "--out", "DIR"])


def _mm(value: float | None) -> str:
    return OURS if value is None or not math.isfinite(value) else f"{1e3 * value:+.1f} mm"
