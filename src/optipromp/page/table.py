"""The table of a plan's metrics and constraints, as HTML; what is violated is red."""

import html
import math
from collections.abc import Iterable

from optipromp.judging import Violation
from optipromp.planning import Plan
from optipromp.planning.result import verdict
from optipromp.planning.task import resolve

RED = "#c8322b"
_ROW = '<tr style="{}"><td>{}</td><td style="text-align:right">{}</td></tr>'


def table(plan: Plan) -> str:
    """Metrics of a plan and what it violates."""
    found = violations(plan)
    kinds = {violation.kind for violation in found}
    subjects = {violation.subject for violation in found}
    m, touched = plan.metrics, {contact.role for contact in plan.contacts}
    rows: list[tuple[str, str, bool]] = [
        ("off the goal", _mm(m.goal_error), "goal" in kinds),
        ("off its axis", _degrees(m.goal_axis_error), "axis" in kinds),
        ("clearance, static", _mm(m.clearance_static), "static" in touched),
        ("clearance, arm to avoid", _mm(m.clearance_avoid), "avoid" in touched),
        ("clearance, tool to avoid", _mm(m.clearance_avoid_tool), False),
        ("clearance, arm to pushable", _mm(m.clearance_pushable), "pushable" in touched),
        ("clearance, arm to itself", _mm(m.clearance_self), "the robot itself" in touched),
        ("M_c, to the nearest core", _mm(m.M_c), False),
    ]
    rows += [(f"M_p {name}, passed at", _mm(m.M_p[name]), name in subjects) for name in m.M_p]
    rows += [
        (f"{name}, of its limit", f"{100.0 * value:.0f} %", name in kinds)
        for name, value in (("velocity", m.velocity_ratio), ("acceleration", m.acceleration_ratio),
                            ("jerk", m.jerk_ratio))
    ]  # fmt: skip
    rows += [
        ("beyond joint limits", f"{m.limit_violation:.3g}", "limit" in kinds),
        ("largest step", f"{m.max_step:.4f} rad", False),
        ("duration", f"{m.duration:.2f} s", "motion" in kinds),
        ("smoothness, RMS", f"{m.smoothness:.2f} rad/s²", False),
    ]
    if plan.prediction is not None:
        harm = f"{plan.prediction.harm:.2f} of {plan.prediction.threshold:g}"
        rows.append(("predicted harm, of allowed", harm, plan.prediction.harmful))
    body = "".join(
        _ROW.format(f"color:{RED};font-weight:600" if bad else "", html.escape(label), value)
        for label, value, bad in rows if value
    )  # fmt: skip
    return (
        f'<div style="padding:0 1em;font-size:0.85em"><table style="width:100%">{body}</table>'
        f"{_list(violation.message for violation in found)}</div>"
    )


def violations(plan: Plan) -> tuple[Violation, ...]:
    """What the judge finds wrong with a plan."""
    task = resolve(plan.scene, plan.robot)
    return verdict(task, plan.trajectory).judgement.violations


def _list(messages: Iterable[str]) -> str:
    items = "".join(f"<li>{html.escape(message)}</li>" for message in messages)
    return (
        f'<ul style="color:{RED};padding-left:1.2em;margin:0.4em 0">{items}</ul>' if items else ""
    )


def _mm(value: float | None) -> str:
    return "" if value is None or not math.isfinite(value) else f"{1e3 * value:.1f} mm"


def _degrees(value: float | None) -> str:
    return "" if value is None or not math.isfinite(value) else f"{math.degrees(value):.2f}°"
