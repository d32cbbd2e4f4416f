"""Reports: one self-contained HTML file about a plan or a run, for screens and paper."""

import json
import math
import platform
import shlex
from base64 import b64encode
from collections.abc import Callable, Iterable, Mapping, Sequence
from html import escape
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from optipromp.core.documents import read_document
from optipromp.core.errors import InvalidRequestError, InvalidSceneError
from optipromp.core.files import is_file, is_folder, reading
from optipromp.core.output import load_pick
from optipromp.core.planning import Picked, Plan
from optipromp.core.planning.legs import legs_of, takes
from optipromp.core.scenes.io import scene_from_dict
from optipromp.looks.viewer import html
from optipromp.looks.viewer.drawn import pushed
from optipromp.looks.viewer.figures import changed_terms, cost_figure, joint_figure, png
from optipromp.looks.viewer.html import DPI, HEIGHT, frame
from optipromp.looks.viewer.reach import reach_figure
from optipromp.looks.viewer.sentences import complaint, sentences
from optipromp.looks.viewer.serving import plan_page, scene_page
from optipromp.looks.viewer.words import plan_rows, seconds
from optipromp.parts import added

LARGEST_FILE = 5_000_000  # bytes of a report
PACKAGES = "optipromp", "numpy", "scipy", "numba", "mujoco", "viser"
STYLE = """
:root { color-scheme: light; }
body { font: 15px/1.5 system-ui, "Segoe UI", Roboto, "Helvetica Neue", Arial, sans-serif;
  color: #20262c; background: #fff; margin: 0 auto; max-width: 1080px; padding: 0 20px 40px; }
h1 { font-size: 26px; margin: 28px 0 4px; } h2 { font-size: 18px; margin: 34px 0 8px;
  border-bottom: 1px solid #d9dde1; padding-bottom: 4px; }
p { max-width: 75ch; } .faint { color: #66707a; font-size: 13px; }
.good { color: #1c7a35; } .bad { color: #b3261e; } .status { font-weight: 600; }
.wide { overflow-x: auto; }
table { border-collapse: collapse; margin: 8px 0 14px; font-size: 14px; }
th, td { text-align: left; vertical-align: top; padding: 4px 14px 4px 0;
  border-bottom: 1px solid #eceff1; } th[scope=row] { font-weight: 500; color: #47515a; }
tr.head th { color: #66707a; font-weight: 600; font-size: 13px; }
td { font-variant-numeric: tabular-nums; }
img, video { max-width: 100%; height: auto; display: block; }
code { background: #f3f5f7; padding: 2px 6px; border-radius: 4px; overflow-wrap: anywhere; }
figure { margin: 10px 0 18px; break-inside: avoid; } figcaption { font-size: 13px; color: #47515a; }
.cases { display: grid; grid-template-columns: repeat(auto-fill, minmax(320px, 1fr)); gap: 18px; }
@media (max-width: 600px) { iframe { height: 360px !important; } body { padding: 0 12px 24px; } }
@media print { body { max-width: none; font-size: 10.5pt; padding: 0; } .screen { display: none; }
  h2 { break-after: avoid; } table, tr { break-inside: avoid; } a { color: inherit; }
  .cases { grid-template-columns: 1fr 1fr; } @page { margin: 15mm; } }
"""


def page(title: str, sections: Iterable[str]) -> bytes:
    """The HTML file, which fetches nothing."""
    head = (
        '<!doctype html><html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{escape(title)}</title><style>{STYLE}</style></head><body>"
    )
    return "".join([head, *sections, "</body></html>\n"]).encode("utf-8")


def section(title: str, *content: str, screen: bool = False) -> str:
    """A heading and its content; with ``screen``, left out on paper."""
    kind = ' class="screen"' if screen else ""
    return f"<section{kind}><h2>{escape(title)}</h2>{''.join(content)}</section>"


def paragraph(text: str, kind: str = "") -> str:
    """A paragraph of text."""
    return f'<p class="{kind}">{escape(text)}</p>'


def table(rows: Iterable[Sequence[str]], head: Sequence[str] = ()) -> str:
    """A table of texts, which scrolls on a narrow screen; the first of each row is its name."""
    return f'<div class="wide">{html.table(rows, head)}</div>'


def picture(content: bytes, caption: str, kind: str = "png") -> str:
    """A picture of a ``kind`` (png, svg+xml), embedded in the file."""
    return (
        f'<figure><img alt="{escape(caption)}" src="{_data(f"image/{kind}", content)}">'
        f"<figcaption>{escape(caption)}</figcaption></figure>"
    )


def film(content: bytes, kind: str, caption: str) -> str:
    """A film of a ``kind`` (webm, mp4), embedded in the file; left out on paper."""
    source = _data(f"video/{kind}", content)
    return (
        f'<figure class="screen"><video controls loop muted src="{source}">'
        f"</video><figcaption>{escape(caption)}</figcaption></figure>"
    )


def made_with(command: str, recorded: Mapping[str, str]) -> str:
    """The section of the command and of versions."""
    versions = [(name, _version(name)) for name in PACKAGES]
    rows = [*recorded.items(), *((name, found) for name, found in versions if found)]
    rows += [("Python", platform.python_version()), ("system", platform.platform(terse=True))]
    return section("Made with", f"<p><code>{escape(command)}</code></p>", table(rows))


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return ""


def _data(kind: str, content: bytes) -> str:
    return f"data:{kind};base64,{b64encode(content).decode('ascii')}"


def plan_report(folder: Path | str) -> bytes:
    """One HTML file, at most 5 MB, about the plan or pick that ``optipromp plan`` left in a folder.
    The report includes the outcome and film that ``optipromp simulate`` left in the folder. Without
    viser the 3-D view is left out."""
    folder = Path(folder)
    made = load_pick(folder)
    plan, *later = legs_of(made).values()
    folder = folder if is_folder(folder) else folder.parent
    written = json.loads((folder / "plan.json").read_text(encoding="utf-8")).get("version", "")
    title = f"{plan.scene.name}: {plan.planner}"
    kind = "good" if made.success else "bad"
    total = seconds(plan.time.get("total", math.nan))
    told = paragraph(f"{made.status}, the reach in {total}", f"status {kind}")
    words = sentences(made, pushed(made).shifts()) if made.success else (complaint(made),)
    verdict, run = _outcome(folder)
    head = f"<h1>{escape(title)}</h1>{told}{paragraph(' '.join(words))}{verdict}"
    figures = [
        ("The arm, and the cluster along two axes", reach_figure(plan)),
        ("Joints over time", joint_figure(made)),
    ]
    if changed_terms(plan):
        figures.append(("Costs over the iterations", cost_figure(plan)))
    contacts = [vars(contact) for leg in (plan, *later) for contact in leg.contacts]
    rows = [tuple(map(str, contact.values())) for contact in contacts]
    touches = [table(rows, tuple(contacts[0]))] if rows else []
    parts = [
        head,
        _shown(lambda: plan_page(made), "Turn it with the mouse; pushed fruits move as predicted."),
        section("Pictures", *(picture(png(figure, DPI), name) for name, figure in figures)),
        section("Metrics", table([*plan_rows(made), ("judged", made.message)])),
        *_beside_paper(plan),
        *(section("Touches that must not be", each) for each in touches),
        *run,
        section("Settings", table(_settings(plan))),
        made_with(_command(made), {"plan written by": f"optipromp {written}"}),
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
    verdict, run = _outcome(folder)
    head = f"<h1>{escape(title)}</h1>{verdict}"
    return _fitted(title, [head, view, *run, made], folder)


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
    beside = added("beside_paper")
    rows = [] if beside is None else beside(plan)
    head = "figure", "the paper's", "this plan's", "the paper's test"
    return [section("Beside the paper", table(rows, head))] if rows else []


def _outcome(folder: Path) -> tuple[str, list[str]]:
    """The outcome of the simulated run as a paragraph, and as a section; empty: there is none."""
    path = folder / "outcome.json"
    if not is_file(path):
        return "", []
    try:
        found: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        good = "picked, nothing harmed" if found["picked"] else "nothing harmed"
        good, force = good if found["success"] else f"{found['cause']}", found["unripe_peak_force"]
        rows = [
            ("outcome", good),
            ("in words", found["message"]),
            ("largest force on what is not to be picked", f"{force:.2f} N"),
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
    simulated = "In the physics simulation"
    verdict = f"{simulated}: {good}; largest force on what is not to be picked {force:.2f} N."
    return paragraph(verdict), [section(simulated, table(rows))]


def _settings(plan: Plan) -> list[tuple[str, str]]:
    scene, tool = plan.scene, plan.robot.tool
    rows = [
        ("planner", plan.planner),
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


def _command(made: Plan | Picked) -> str:
    from optipromp.core.scenes.io import scene_names

    plan = legs_of(made)["reach"]
    name = plan.scene.name
    words = ["optipromp", "plan", name if name in scene_names() else f"{name}.yaml"]
    words += ["--planner", plan.planner]
    if made is plan and plan.success and takes(plan.scene, plan.robot):
        words.append("--reach")
    return shlex.join([*words, "--seed", str(plan.seed), "--out", "DIR"])
