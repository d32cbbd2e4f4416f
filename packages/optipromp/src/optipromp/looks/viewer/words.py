"""Plans and errors for people: in figures, and in plain words without codes and symbols."""

import math
import re
from collections.abc import Mapping
from typing import TYPE_CHECKING

from optipromp.core.errors import Code
from optipromp.core.planning.legs import legs_of

if TYPE_CHECKING:
    from optipromp.core.planning import Picked, Plan


def plan_rows(made: "Plan | Picked") -> list[tuple[str, str]]:
    """The figures by which a plan, or the reach of a pick, is judged: name and value; its legs."""
    plan, *later = legs_of(made).values()
    m = plan.metrics
    off = m.goal_axis_error
    axis = "–" if off is None or not math.isfinite(off) else f"{math.degrees(off):.2f}°"
    rows = [
        ("target", f"{_mm(m.goal_error)} off, {axis} off axis"),
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
    for name, leg in legs_of(made).items() if later else ():
        harm = "" if leg.prediction is None else f", harm {leg.harm:.2f}"
        rows.append((name, f"{leg.status}, {leg.duration:.2f} s{harm}"))
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


def seconds(value: float) -> str:
    """A time with its unit."""
    return f"{1e3 * value:.0f} ms" if value < 1.0 else f"{value:.1f} s"


WORDS: Mapping[Code, str] = {  # Each code as a clause that can begin a sentence
    Code.SUCCESS: "this plan works",
    Code.INVALID_ROBOT: "the robot cannot be used",
    Code.INVALID_SCENE: "the scene cannot be used",
    Code.INVALID_DEMONSTRATION: "the demonstrations cannot be used",
    Code.INVALID_REQUEST: "this cannot be done",
    Code.START_INVALID: "the arm cannot start like this",
    Code.START_IN_COLLISION: "at the start the arm touches what it must not",
    Code.GOAL_IN_COLLISION: "at the goal the arm would touch what it must not",
    Code.GOAL_UNREACHABLE: "the goal is out of reach",
    Code.NO_PLAN: "no way was found",
    Code.INVALID_PLAN: "this motion breaks a rule",
    Code.HARM_PREDICTED: "this motion would do harm",
    Code.TIMEOUT: "the time ran out",
    Code.EXECUTION_FAILED: "the arm did not do it",
}

_CODE = re.compile("|".join(rf"\b{code}\b" for code in WORDS if code.isupper()))


def head(code: Code) -> str:
    """A code as the beginning of a sentence."""
    return sentence(WORDS[code])


def sentence(text: str) -> str:
    """A text that begins with a capital letter."""
    return text[:1].upper() + text[1:]


def without_codes(text: str) -> str:
    """A text with the words of each code in the place of the code."""
    return _CODE.sub(lambda found: WORDS[Code(found[0])], text)


def least(*rooms: float | None) -> float | None:
    """The smallest of the clearances that are known and finite; None where none is."""
    return min((r for r in rooms if r is not None and math.isfinite(r)), default=None)
