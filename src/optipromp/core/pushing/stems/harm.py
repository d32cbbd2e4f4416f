"""The predicted harm of a push to fruits on stems: its parts, and their sum."""

from typing import NamedTuple

from optipromp.core.compiled import inner
from optipromp.core.pushing.parameters import PUSH

HARM = PUSH.harm


class Harm(NamedTuple):
    """The predicted harm of a path. The first fruit is the target.

    Attributes:
        stem: largest lasting force of the cup on a stem [N].
        fruit: largest force on another fruit than the target [N].
        target: largest lasting force on the target [N].
        inside: longest time of another fruit inside the cup [s].
        pinched: time in which the cup presses another fruit against a static object [s].
        missed: whether the target is outside the cup at the end.
    """

    stem: float
    fruit: float
    target: float
    inside: float
    pinched: float
    missed: bool


@inner
def score_of(stem, fruit, target, inside, pinched, missed):
    """The score of a :class:`Harm`: the sum of its parts.

    A part is 1 where a force reaches what a fruit bears, or a fruit is pinched for
    ``pinched_time``. A momentary force up to ``sudden_force`` counts nothing. A swallowed neighbour
    and a missed target add ``HARM.swallowed`` each.
    """
    lost = HARM.swallowed * (inside > HARM.inside_time) + HARM.swallowed * missed
    crushed = max(fruit - HARM.sudden_force, 0.0) / (HARM.fruit_force - HARM.sudden_force)
    pressed = stem / HARM.stem_force + crushed + target / HARM.target_force
    return pressed + pinched / HARM.pinched_time + lost
