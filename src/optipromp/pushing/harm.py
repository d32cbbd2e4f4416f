"""What a push is foreseen to do, and one number for how bad that is."""

from typing import NamedTuple

from numba import njit

SUDDEN = 14.0  # [N] momentarily on a fruit, up to which the model's force says nothing
PINCHED = 0.2  # [s]


class Harm(NamedTuple):
    """What is foreseen of a path; the first fruit is the target.

    Attributes:
        stem: largest lasting force of the cup on a stem [N].
        fruit: largest force on another fruit than the target [N].
        target: largest lasting force on the target [N].
        inside: longest that another fruit is inside the cup [s].
        pinched: how long the cup presses another fruit against what stands firm [s].
        missed: whether the target is not inside at the end.
    """

    stem: float
    fruit: float
    target: float
    inside: float
    pinched: float
    missed: bool


@njit(cache=True, error_model="numpy", nogil=True)
def score_of(
    stem: float, fruit: float, target: float, inside: float, pinched: float, missed: bool
) -> float:
    """One number for a :class:`Harm`: well below 1 nothing is expected to go wrong.

    Each part is 1 where it reaches what a fruit bears: 2 N on a stem for long, 5 N on the target,
    30 N on another fruit, and :data:`PINCHED` of a fruit between cup and gutter, from where it
    slips more easily in the model than elsewhere. A momentary force up to :data:`SUDDEN` counts
    nothing: runs that go well in the twin have it in the model too, one in ten above 8 N. A
    swallowed neighbour and a missed target end all hope.
    """
    lost = 5.0 * (inside > 0.03) + 5.0 * missed
    pressed = stem / 2.0 + max(fruit - SUDDEN, 0.0) / (30.0 - SUDDEN) + target / 5.0
    return pressed + pinched / PINCHED + lost
