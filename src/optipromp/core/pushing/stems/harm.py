"""The predicted harm of a push: its parts, and one number for them."""

from typing import NamedTuple

from optipromp.core.compiled import inner
from optipromp.core.pushing.parameters import PUSH

STEM_BEARS, TARGET_BEARS = PUSH.harm.stem_force, PUSH.harm.target_force
FRUIT_BEARS, SUDDEN = PUSH.harm.fruit_force, PUSH.harm.sudden_force
BRIEFLY, PINCHED = PUSH.harm.inside_time, PUSH.harm.pinched_time
LOST = PUSH.harm.swallowed


class Harm(NamedTuple):
    """The predicted harm of a path. The first fruit is the target.

    Attributes:
        stem: largest lasting force of the cup on a stem [N].
        fruit: largest force on another fruit than the target [N].
        target: largest lasting force on the target [N].
        inside: longest that another fruit is inside the cup [s].
        pinched: how long the cup presses another fruit against something static [s].
        missed: whether the target is not inside at the end.
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
    """One number for a :class:`Harm`: well below 1, nothing is expected to go wrong.

    Each part is 1 where a force reaches what a fruit bears, or where a fruit is pinched for
    :data:`PINCHED` (the model lets a pinched fruit slip out more easily than the simulation).
    A momentary force up to :data:`SUDDEN` counts nothing: runs that go well in the simulation have
    it in the model too, one in ten above 8 N. A swallowed neighbour or a missed target
    adds :data:`LOST`.
    """
    lost = LOST * (inside > BRIEFLY) + LOST * missed
    crushed = max(fruit - SUDDEN, 0.0) / (FRUIT_BEARS - SUDDEN)
    pressed = stem / STEM_BEARS + crushed + target / TARGET_BEARS
    return pressed + pinched / PINCHED + lost
