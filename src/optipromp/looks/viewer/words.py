"""A plan in words and numbers, for people."""

import math
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from optipromp.core.planning import Plan


def plan_rows(plan: "Plan") -> list[tuple[str, str]]:
    """The figures by which a plan is judged: name and value."""
    m = plan.metrics
    rows = [
        ("target", f"{_mm(m.goal_error)} off, {_degrees(m.goal_axis_error)} off axis"),
        ("M_c", f"{_mm(m.M_c)} from a body point to the core of the nearest obstacle"),
    ]
    rows += [(f"M_p {name}", _passing(m.passage[name], m.stem_projection[name])) for name in m.M_p]
    for label, value in (
        ("clearance, static", m.clearance_static),
        ("clearance, arm to avoid", m.clearance_avoid),
        ("clearance, tool to avoid", m.clearance_avoid_tool),
        ("clearance, arm to itself", m.clearance_self),
    ):
        if value is not None and math.isfinite(value):
            rows.append((label, _mm(value)))
    rows += [
        (
            "duration",
            f"{m.duration:.2f} s with {100 * m.velocity_ratio:.0f} % of the velocity and "
            f"{100 * m.acceleration_ratio:.0f} % of the acceleration limits",
        ),
        ("joint limits", "kept" if m.limit_violation <= 0 else f"{m.limit_violation:.3g} beyond"),
        ("largest step", f"{m.max_step:.4f} rad of a {m.path_length:.2f} rad path"),
    ]
    if plan.prediction is not None:
        rows.append(("push", str(plan.prediction)))
    for name, term in plan.terms.items():
        told = f"{term.initial:.4g} → {term.followed:.4g} → {term.final:.4g}"
        rows.append((f"cost, {name}", f"{told} (primitive, followed, optimised)"))
    return rows


def _passing(way: tuple[float, float] | None, stem: float | None) -> str:
    if way is None:
        return "not passed"
    leans = "" if stem is None else f"; its stem leans by {1e3 * stem:+.1f} mm"
    return f"{1e3 * way[1]:+.1f} mm (x_g {1e3 * way[0]:+.1f}){leans}"


def _mm(value: float | None) -> str:
    if value is None or not math.isfinite(value):
        return "–"
    return f"{1e3 * value:.1f} mm" if abs(value) < 1.0 else f"{value:.3f} m"


def _degrees(value: float | None) -> str:
    return "–" if value is None or not math.isfinite(value) else f"{math.degrees(value):.2f}°"


def seconds(value: float) -> str:
    """A time with its unit."""
    return f"{1e3 * value:.0f} ms" if value < 1.0 else f"{value:.1f} s"
