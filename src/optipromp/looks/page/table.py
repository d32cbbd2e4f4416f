"""The table of a plan's metrics and violations as HTML; violated rows are red."""

import html

from optipromp.core.judging import Violation
from optipromp.core.planning import Plan
from optipromp.core.planning.verdict import verdict_of
from optipromp.looks.viewer.drawn import RED
from optipromp.looks.viewer.words import plan_rows

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


def table(plan: Plan) -> str:
    """The metrics of a plan in the words of the command line, and its violations."""
    found = violations(plan)
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


def violations(plan: Plan) -> tuple[Violation, ...]:
    """The violations that the judge finds in a plan."""
    return verdict_of(plan).judgement.violations
