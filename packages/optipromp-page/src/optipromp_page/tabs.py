"""What the tabs of a window show: charts, the legend, what a camera saw, a recording."""

import html
import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

import numpy as np

from optipromp.core.arrays import FloatArray
from optipromp.core.errors import InvalidRequestError, OptiPrompError
from optipromp.core.planning import Picked, Plan
from optipromp.core.planning.legs import legs_of
from optipromp.core.promp import Demonstrations
from optipromp.core.promp.demonstrations import Demonstration
from optipromp.core.robots import ik
from optipromp.core.robots.model import Robot
from optipromp.core.scenes.scene import Scene
from optipromp.looks.appearance import SEE_THROUGH, colour_of, hex_colour
from optipromp.looks.viewer.drawn import GREEN, OPTIMISED, PRIMITIVE, RED, motions
from optipromp.looks.viewer.sentences import sentences
from optipromp.looks.viewer.words import head, plan_rows, sentence, without_codes
from optipromp_eyes.eyes import RIPE, STEM, UNRIPE
from optipromp_page.content import GREEN_AT, Chart
from optipromp_page.stage import AHEAD, BACK, SIDE, SPREAD, SURE, UNSURE, Replay
from optipromp_sim.simulation.files import LoopRecord

RECENT = 0.5  # [s] age of a look above which nothing is drawn: the camera is blocked, a choice
_SIDE = 200  # [pixel] of what the camera of a closed loop saw, beside the replay
CHART_HEIGHT = 170  # [pixel]
_NEEDLE = "#222222"


class Plots:
    """Charts of a client, in the container of its ``gui`` that is current now."""

    def __init__(self, gui: Any) -> None:
        self.gui, self.place = gui, gui.add_folder("over the plan")
        self.charts: list[tuple[Chart, Any]] = []
        self.marked = -np.inf

    def show(self, wanted: Sequence[Chart], now: float) -> None:
        """Show charts; where their curves are the same as before, only the values are sent."""
        if [_shape(chart) for chart in wanted] == [_shape(chart) for chart, _ in self.charts]:
            self.charts = [(c, node) for c, (_, node) in zip(wanted, self.charts, strict=True)]
            for chart, node in self.charts:
                node.data = columns(chart, now)
        else:
            for _, node in self.charts:
                node.remove()
            with self.place:
                self.charts = [(chart, self._add(chart, now)) for chart in wanted]
        self.marked = now

    def mark(self, now: float, least: float) -> None:
        """Move the needles to the time ``now`` [s], if they are more than ``least`` [s] away."""
        if abs(now - self.marked) > least:
            self.marked = now
            for chart, node in self.charts:
                if chart.timed:
                    node.data = columns(chart, now)

    def _add(self, chart: Chart, now: float) -> Any:
        needle = [("now", None, _NEEDLE)] if chart.timed else []
        series = [
            {"label": name, "stroke": colour, "width": 1.5, "points": {"show": False}}
            for name, _, colour in (*chart.curves, *needle)
        ]
        return self.gui.add_uplot(
            columns(chart, now), ({}, *series), title=chart.title, height=CHART_HEIGHT,
            scales={"x": {"time": False}}, legend={"show": len(chart.curves) > 1},
        )  # fmt: skip


def _shape(chart: Chart) -> tuple[str, ...]:
    return (chart.title, *(name for name, _, _ in chart.curves))


def columns(chart: Chart, now: float) -> tuple[FloatArray, ...]:
    """Columns of a chart; where it is timed, the last is a needle at ``now``."""
    if not chart.timed:
        return chart.x, *(values for _, values, _ in chart.curves)
    at = int(np.searchsorted(chart.x, now))
    found = [
        np.insert(values, at, [np.interp(now, chart.x, values)] * 3)
        for _, values, _ in chart.curves
    ]
    needle = np.full(len(chart.x) + 3, min(c.min() for c in found))
    needle[at + 1] = max(c.max() for c in found)
    return np.insert(chart.x, at, [now] * 3), *found, needle


ROLES = {
    "target": "target",
    "pushable": "may be pushed aside",
    "avoid": "the arm keeps away",
    "static": "fixed, not to be touched",
}
MOST = 3  # colours of one role
_LINES = {
    "conditioned ProMP": "movement primitive",
    "followed path": "way past the fruits",
    "optimised": "tool path",
}

Entry = tuple[str, str]  # sign as HTML, words


def things(scene: Scene) -> list[Entry]:
    """The colours of the scene's objects, one entry a role."""
    found = []
    for role, words in ROLES.items():
        colours = [colour_of(scene, item) for item in scene.objects if item.role == role]
        opacity = SEE_THROUGH if role == "avoid" else 1.0
        signs = "".join(disc(colour, opacity) for colour in list(dict.fromkeys(colours))[:MOST])
        if signs:
            found.append((signs, words))
    return found


def planned(made: Plan | Picked, shown: Collection[str]) -> list[Entry]:
    """The signs of a plan on those of its layers that are shown."""
    found, plan = [], legs_of(made)["reach"]
    if "trajectories" in shown:
        lines = list(motions(made))[::-1]  # the motion itself first
        words = ["tool path", *(_LINES.get(motion.name, motion.name) for motion in lines[1:])]
        found += [(line(m.colour), w) for m, w in zip(lines, words, strict=True)]
    if "initial bundle" in shown:
        found.append((disc(PRIMITIVE, SPREAD), "spread of the learnt motion"))
    if "pushed objects" in shown and plan.push_model is not None:
        sign = '<span style="border:1px solid #bbb;padding:0 0.3em;font-size:0.85em">n, 9 mm</span>'
        found.append((sign, "predicted push"))
    if "passing sides" in shown and any(plan.metrics.passage.values()):
        found.append((arrow(hex_colour(SIDE)), "side on which it passes"))
    if "candidate paths" in shown and plan.push_model is not None:
        found.append((scale(GREEN, RED), "ways tried: harmless to harmful"))
    if "body spheres" in shown:
        found.append((scale(RED, GREEN), f"arm: touch to {1e3 * GREEN_AT:.0f} mm away"))
    return found


def replayed(*, looks: bool) -> list[Entry]:
    """The signs of an executed plan, ``looks``: of one that looked on its way."""
    found = [(arrow(RED), "force of a touch")]
    if looks:
        found += [
            (line(AHEAD[0]), "way ahead, in the colour of its plan"),
            (line(BACK), "way back"),
            (disc(hex_colour(SURE)), "where it believes a fruit"),
            (disc(hex_colour(UNSURE)), "perhaps a fruit"),
        ]
    return found


def seen() -> list[Entry]:
    """The signs over a picture in which a scene was seen."""
    signs = ((RIPE, "ripe"), (UNRIPE, "unripe"), (STEM, "stem"))
    return [(line(hex_colour(colour)), f"found: {words}") for colour, words in signs]


def legend(entries: Collection[Entry]) -> str:
    """Entries as one block of HTML."""
    items = "".join(
        f'<span style="display:flex;align-items:center;gap:0.35em">'
        f"{sign}{html.escape(words)}</span>"
        for sign, words in entries
    )
    return (
        '<div class="legend" style="display:flex;flex-wrap:wrap;gap:0 0.9em;padding:0.4em 1em;'
        'font-size:0.8em;line-height:1.6">'
        f"{items}</div>"
    )


def disc(colour: str, opacity: float = 1.0) -> str:
    """A thing's colour, with its opacity in two more digits."""
    seen = f"{colour}{round(255 * opacity):02x}"
    style = f"border-radius:50%;background:{seen};border:1px solid {colour}"
    return _sign("0.8em", "0.8em", style)


def line(colour: str) -> str:
    """A line's colour."""
    return _sign("1.4em", "0.28em", f"background:{colour}ff")


def scale(first: str, last: str) -> str:
    """Colours from one to another."""
    return _sign("1.8em", "0.28em", f"background:linear-gradient(90deg,{first},#f0c43c,{last})")


def arrow(colour: str) -> str:
    """An arrow's colour."""
    return f'<span style="color:{colour};font-weight:700">→</span>'


def _sign(width: str, height: str, style: str) -> str:
    return (
        f'<span style="display:inline-block;flex:none;box-sizing:border-box;width:{width};'
        f'height:{height};{style}"></span>'
    )


def sight(record: LoopRecord, now: float) -> str:
    """The last look until ``now`` [s] as HTML: its cone of view with the detections in it. The
    picture is the camera's, its x axis to the right. Targets are red, other fruits green."""
    found = record.sight(now)
    if found is None:
        return ""
    age, view, discs = found
    wide = math.tan(0.5 * view)
    circles = "".join(
        f'<circle cx="{x:.4f}" cy="{y:.4f}" r="{r:.4f}" fill="none" stroke-width="{0.015 * wide}" '
        f'stroke="{RED if target else GREEN}"/>'
        for x, y, r, target in (discs.tolist() if age <= RECENT else ())
    )
    words = f"the camera, {1e3 * age:.0f} ms ago" if age <= RECENT else "the camera sees nothing"
    return (
        f'<figure class="sight" style="margin:0.5em 1em;font-size:0.8em"><svg width="{_SIDE}" '
        f'height="{_SIDE}" viewBox="{-wide} {-wide} {2 * wide} {2 * wide}">'
        f'<circle r="{wide}" fill="#f1f3f5"/>{circles}</svg>'
        f"<figcaption>{words}</figcaption></figure>"
    )


MISSED = 1e-3  # [m] from the handle to the tool; a pose that misses by more is out of reach
SHORTEST = 1e-3  # [s] between two samples, at least
LONGEST_PAUSE = 0.2  # [s] between two samples, at most: longer pauses of the hand are shortened
FEWEST_SAMPLES = 5  # of a demonstration


@dataclass
class Recorder:
    """Demonstrations of one robot, and the one that is being recorded."""

    robot: Robot
    q: FloatArray  # (n,) present configuration
    times: list[float] = field(default_factory=list)  # [s] of the demonstration under way
    rows: list[FloatArray] = field(default_factory=list)  # (n,) each
    kept: list[Demonstration] = field(default_factory=list)  # accepted
    last: float = 0.0  # [s] time of the last sample

    def begin(self, q: FloatArray) -> None:
        """Start anew from ``q`` (n,)."""
        self.q, self.times, self.rows = np.array(q), [], []

    def drag(self, point: FloatArray, now: float) -> bool:
        """Follow the handle to ``point`` (3,) [m] at the time ``now`` [s]; False if out of reach.
        The tool keeps its direction. Out of reach, the arm stays where it is."""
        if not self.times:
            self.times, self.rows, self.last = [0.0], [self.q], now - SHORTEST
        axis = self.robot.tool_pose(self.rows[0])[1]
        found, error = ik.track(self.robot, np.asarray(point)[None], axis[None], self.q)
        if error[0] > MISSED:
            return False
        self.q = found[0]
        if now >= self.last + SHORTEST:
            self.times.append(self.times[-1] + min(now - self.last, LONGEST_PAUSE))
            self.rows.append(self.q)
            self.last = now
        return True

    def accept(self) -> int:
        """Keep the demonstration under way; returns the number of demonstrations."""
        if len(self.times) < FEWEST_SAMPLES:
            raise InvalidRequestError(
                f"the recording has {len(self.times)} samples: drag the tool further"
            )
        self.kept.append(Demonstration(np.array(self.times), np.array(self.rows)))
        self.times, self.rows = [], []
        return len(self.kept)

    @property
    def demonstrations(self) -> Demonstrations:
        """The accepted demonstrations."""
        return Demonstrations(tuple(self.kept), self.robot.joint_names)


_WRONG = {  # rows of the table by the kinds of violation that concern them
    "target": {"goal", "axis"},
    "duration": {"velocity", "acceleration", "jerk", "motion"},
    "joint limits": {"limit"},
}
_TOUCHED = {
    "clearance, static": "static",
    "clearance, arm to avoid": "avoid",
    "clearance, arm to itself": "the robot itself",
}
_ROW = '<tr style="{}"><td style="padding-right:1em;white-space:nowrap">{}</td><td>{}</td></tr>'


class Tone(StrEnum):
    """How a message is meant, as the colour of its bar."""

    GOOD = GREEN
    BAD = RED
    BUSY = OPTIMISED


@dataclass(frozen=True)
class Told:
    """A message of the page."""

    head: str  # the first words, in bold type
    lines: tuple[str, ...] = ()  # further sentences, each on a line of its own
    tone: Tone = Tone.GOOD  # good, bad, or under way
    code: str = ""  # for programs and bug reports, shown while the mouse is over the message

    def html(self) -> str:
        """The message as one block."""
        lines = "".join(f"<div>{html.escape(line)}</div>" for line in self.lines)
        title = f' title="{html.escape(self.code)}"' if self.code else ""
        return (
            f'<div class="status" role="status"{title} style="padding:0.3em 1em;'
            f"border-left:4px solid {self.tone};font-size:0.9em;line-height:1.35;"
            f'max-height:12em;overflow-y:auto"><b>{html.escape(self.head)}</b>{lines}</div>'
        )


def of_error(error: OptiPrompError) -> Told:
    """An error of the scene or the request."""
    return Told(head(error.code), (_why(error),), Tone.BAD, str(error.code))


def of_runs(runs: Sequence[Replay]) -> Told:
    """Executed plans: the outcome of each."""
    good = all(run.success for run in runs)
    lines = tuple(f"{run.name}: {without_codes(run.message)}" for run in runs)
    return Told("Executed" if good else "Executed, not as wanted", lines,
                Tone.GOOD if good else Tone.BAD)  # fmt: skip


def of_plan(plan: Plan | Picked, how: str, shifts: dict[str, float]) -> Told:
    """A plan: how it was made, what it does, or why it failed. ``how``: where it comes from, or how
    long it took. ``shifts``: predicted pushes by object [m]."""
    lines = sentences(plan, shifts) if plan.success else (_why(plan),)
    tone = Tone.GOOD if plan.success else Tone.BAD
    return Told(head(plan.status), (*lines, f"{sentence(how)}."), tone, str(plan.status))


def _why(found: Plan | Picked | OptiPrompError) -> str:
    return sentence(without_codes(" ".join(found.message.split())))


def table(made: Plan | Picked) -> str:
    """The metrics of a plan in the words of the command line, and its violations."""
    plan = legs_of(made)["reach"]
    found = plan.judgement.violations
    kinds, subjects = {v.kind for v in found}, {v.subject for v in found}
    touched = {contact.role for contact in plan.contacts}

    def wrong(label: str) -> bool:
        if label == "push":
            return plan.prediction is not None and plan.prediction.harmful
        about = label.startswith("M_p ") and label.removeprefix("M_p ") in subjects
        return about or bool(_WRONG.get(label, set()) & kinds) or _TOUCHED.get(label) in touched

    rows = ""
    for name, words in plan_rows(made):
        style = f"color:{RED};font-weight:600" if wrong(name) else ""
        rows += _ROW.format(style, html.escape(name), html.escape(words))
    items = "".join(f"<li>{html.escape(violation.message)}</li>" for violation in found)
    return (
        f'<div style="padding:0 1em;font-size:0.85em"><table style="vertical-align:top">{rows}'
        f'</table><ul style="color:{RED};padding-left:1.2em">{items}</ul></div>'
    )
