"""What the page tells above its tabs, and the table of a plan's metrics, as HTML."""

import html
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

from optipromp.core.errors import OptiPrompError
from optipromp.core.planning import Plan
from optipromp.looks.page.replay import Replay
from optipromp.looks.viewer.drawn import GREEN, OPTIMISED, RED
from optipromp.looks.viewer.words import head, plan_rows, sentence, sentences, without_codes

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


def busy(words: str) -> Told:
    """A message that something is under way."""
    return Told(f"{words} …", tone=Tone.BUSY)


def of_error(error: OptiPrompError) -> Told:
    """An error of the scene or the request."""
    return Told(head(error.code), (_why(error),), Tone.BAD, str(error.code))


def of_runs(runs: Sequence[Replay]) -> Told:
    """Executed plans: the outcome of each."""
    good = all(run.success for run in runs)
    lines = tuple(f"{run.name}: {without_codes(run.message)}" for run in runs)
    return Told("Executed" if good else "Executed, not as wanted", lines,
                Tone.GOOD if good else Tone.BAD)  # fmt: skip


def of_plan(plan: Plan, how: str, shifts: dict[str, float]) -> Told:
    """A plan: how it was made, what it does, or why it failed.

    ``plan``: that is shown. ``how``: where it comes from, or how long it took. ``shifts``:
    predicted pushes by object [m].
    """
    lines = sentences(plan, shifts) if plan.success else (_why(plan),)
    tone = Tone.GOOD if plan.success else Tone.BAD
    return Told(head(plan.status), (*lines, f"{sentence(how)}."), tone, str(plan.status))


def _why(found: Plan | OptiPrompError) -> str:
    return sentence(without_codes(" ".join(found.message.split())))


def table(plan: Plan) -> str:
    """The metrics of a plan in the words of the command line, and its violations."""
    found = plan.judgement.violations
    kinds, subjects = {v.kind for v in found}, {v.subject for v in found}
    touched = {contact.role for contact in plan.contacts}

    def wrong(label: str) -> bool:
        if label == "push":
            return plan.prediction is not None and plan.prediction.harmful
        about = label.startswith("M_p ") and label.removeprefix("M_p ") in subjects
        return about or bool(_WRONG.get(label, set()) & kinds) or _TOUCHED.get(label) in touched

    rows = "".join(
        _ROW.format(
            f"color:{RED};font-weight:600" if wrong(label) else "",
            html.escape(label),
            html.escape(words),
        )
        for label, words in plan_rows(plan)
    )
    items = "".join(f"<li>{html.escape(violation.message)}</li>" for violation in found)
    return (
        f'<div style="padding:0 1em;font-size:0.85em"><table style="vertical-align:top">{rows}'
        f'</table><ul style="color:{RED};padding-left:1.2em">{items}</ul></div>'
    )
