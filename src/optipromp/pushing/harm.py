"""What a push is predicted to do, and one number for how bad that is."""

from typing import NamedTuple

from optipromp.compiled import inner

STEM_BEARS, TARGET_BEARS, FRUIT_BEARS = 2.0, 5.0, 30.0  # [N] on a stem, the target, another fruit
BRIEFLY = 0.03  # [s] that another fruit may be inside the cup
SUDDEN = 14.0  # [N] momentarily on a fruit, up to which the model's force says nothing
PINCHED = 0.2  # [s]


class Harm(NamedTuple):
    """What is predicted of a path. The first fruit is the target.

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
    it in the model too, one in ten above 8 N. A swallowed neighbour or a missed target adds 5.
    """
    lost = 5.0 * (inside > BRIEFLY) + 5.0 * missed
    crushed = max(fruit - SUDDEN, 0.0) / (FRUIT_BEARS - SUDDEN)
    pressed = stem / STEM_BEARS + crushed + target / TARGET_BEARS
    return pressed + pinched / PINCHED + lost
