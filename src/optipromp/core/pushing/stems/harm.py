"""The predicted harm of a push to fruits on stems: its parts, and their sum."""

from typing import NamedTuple

from optipromp.core.compiled import inner
from optipromp.core.pushing.parameters import PUSH

STEM_BEARS, TARGET_BEARS = PUSH.harm.stem_force, PUSH.harm.target_force
FRUIT_BEARS, SUDDEN = PUSH.harm.fruit_force, PUSH.harm.sudden_force
BRIEFLY, PINCHED = PUSH.harm.inside_time, PUSH.harm.pinched_time
LOST = PUSH.harm.swallowed
PULL_BEARS = PUSH.harm.pull


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
def score_of(
    stem: float, fruit: float, target: float, inside: float, pinched: float, missed: bool
) -> float:
    """The score of a :class:`Harm`: the sum of its parts.

    A part is 1 where a force reaches what a fruit bears, or a fruit is pinched for :data:`PINCHED`.
    A momentary force up to :data:`SUDDEN` counts nothing. A swallowed neighbour and a missed target
    add :data:`LOST` each.
    """
    lost = LOST * (inside > BRIEFLY) + LOST * missed
    crushed = max(fruit - SUDDEN, 0.0) / (FRUIT_BEARS - SUDDEN)
    pressed = stem / STEM_BEARS + crushed + target / TARGET_BEARS
    return pressed + pinched / PINCHED + lost
