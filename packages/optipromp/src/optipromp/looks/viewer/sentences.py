"""What a motion does, and why there is none, in plain sentences."""

import math
from collections.abc import Mapping

from optipromp.core.errors import OptiPrompError
from optipromp.core.planning import Picked, Plan
from optipromp.core.planning.legs import legs_of
from optipromp.looks.viewer.words import head, least, without_codes

MOST = 4  # passed fruits that are told one by one: a choice
PUSHED = 1e-3  # [m] an object that moves by less is not told as pushed: a choice


def complaint(found: Plan | Picked | OptiPrompError) -> str:
    """A failure in one line; empty for a success."""
    if isinstance(found, OptiPrompError):
        return f"{head(found.code)}: {without_codes(' '.join(found.message.split()))}"
    told = without_codes(found.message).replace("harm is predicted: ", "")  # as the head says
    return "" if found.success else f"{head(found.status)}: {told}"


def sentences(made: Plan | Picked, shifts: Mapping[str, float]) -> tuple[str, ...]:
    """What the motion of a success does, one fact a sentence: its end, passings, clearances, way
    out; with the predicted pushes of objects by id [m], ``shifts``."""
    plan, *later = legs_of(made).values()
    m = plan.metrics
    end = "the target" if plan.scene.target is not None else "its goal"
    told = [f"Reaches {end} in {m.duration:.1f} s."]
    for room, what in (
        (least(m.clearance_avoid, m.clearance_avoid_tool), "what it should keep away from"),
        (least(m.clearance_static), "fixed things"),
    ):
        if room is not None:
            told.append(f"Stays {1e3 * room:.0f} mm from {what}.")
    if later:
        told.append(f"Then leaves the plant with it, in {made.duration - plan.duration:.1f} s.")
    return told[0], *_passings(plan, shifts), *told[1:]


def _passings(plan: Plan, shifts: Mapping[str, float]) -> tuple[str, ...]:
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
