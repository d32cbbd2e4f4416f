"""Plans and errors in plain words, without codes and symbols."""

import math
import re
from collections.abc import Mapping
from typing import TYPE_CHECKING

from optipromp.core.errors import Code, OptiPrompError

if TYPE_CHECKING:
    from optipromp.core.planning import Plan

WORDS: Mapping[Code, str] = {
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
"""Each code as a clause that can begin a sentence."""

MOST = 4  # passed fruits that are told one by one: a choice
PUSHED = 1e-3  # [m] an object that moves by less is not told as pushed: a choice
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


def complaint(found: "Plan | OptiPrompError") -> str:
    """A failure in one line; empty for a success."""
    if isinstance(found, OptiPrompError):
        return f"{head(found.code)}: {without_codes(' '.join(found.message.split()))}"
    return "" if found.success else f"{head(found.status)}: {without_codes(found.message)}"


def sentences(plan: "Plan", shifts: Mapping[str, float]) -> tuple[str, ...]:
    """What the motion of a success does, one fact a sentence: its end, passings, clearances.

    ``plan``: a success. ``shifts``: distances by which objects are predicted to be pushed, by id
    [m].
    """
    m = plan.metrics
    end = "the target" if plan.scene.target is not None else "its goal"
    told = [f"Reaches {end} in {m.duration:.1f} s."]
    for room, what in (
        (_least(m.clearance_avoid, m.clearance_avoid_tool), "what it should keep away from"),
        (_least(m.clearance_static), "fixed things"),
    ):
        if room is not None:
            told.append(f"Stays {1e3 * room:.0f} mm from {what}.")
    return told[0], *_passings(plan, shifts), *told[1:]


def _passings(plan: "Plan", shifts: Mapping[str, float]) -> tuple[str, ...]:
    """A sentence for each object that the tool passes, the farthest pushed first."""
    passed = {name: way for name, way in plan.metrics.passage.items() if way is not None}

    def order(name: str) -> tuple[float, float]:
        return -shifts.get(name, 0.0), math.hypot(*passed[name])

    told, harm = [], ", no harm." if plan.prediction is not None else "."
    for name in sorted(passed, key=order):
        words = f"Passes {name} at {1e3 * math.hypot(*passed[name]):.0f} mm"
        if shifts.get(name, 0.0) > PUSHED:
            words += f", pushes it {1e3 * shifts[name]:.0f} mm aside"
        told.append(words + harm)
    if len(told) > MOST:
        told[MOST - 1 :] = [f"Passes {len(told) - MOST + 1} more{harm}"]
    return tuple(told)


def _least(*rooms: float | None) -> float | None:
    """The smallest of the clearances that are known and finite; None where none is."""
    return min((r for r in rooms if r is not None and math.isfinite(r)), default=None)
