"""What a push goes on from: the state of N fruits after a step, as a row of numbers for each.

A row has the deflections now and a step ago, the places of fruit and root, the place where static
objects were listed, the height by which the fruit is lifted, whether it rests, the force of the
cup, the steps inside and pinched, and the forces of the last steps. All else that a push knows
follows from these.
"""

import math

import numpy as np

from optipromp.core.arrays import FloatArray
from optipromp.core.compiled import inner
from optipromp.core.pushing.parameters import PUSH
from optipromp.core.pushing.stems import contacts

DOFS = 2 * contacts.LOADS
PLACE = 2 * DOFS  # first column after the deflections, of now and of a step ago
SUMS = PLACE + 14  # column of the five numbers of the harm so far, in the row of the first fruit
ROWS = SUMS + 5  # column of the forces on fruit and stem in the last steps
NOT_KEPT = np.zeros((0, 0))  # of a push that does not go on


def width(dt: float) -> int:
    """Columns of what is kept of each fruit, for steps of ``dt`` [s]."""
    return ROWS + 2 * math.ceil(PUSH.harm.lasting / dt)


@inner
def resume(s, f, c, solid, spell, pinched, positions, forces, stem_forces, so_far, begin, kept):
    """Take the fruits over from ``kept``, at the last of ``begin`` points."""
    most = (kept.shape[1] - ROWS) // 2
    for i in range(len(kept)):
        for a in range(DOFS):
            f.u[i, a], f.before[i, a] = kept[i, a], kept[i, DOFS + a]
        for k in range(3):
            f.center[i, k], s.root[i, k] = kept[i, PLACE + k], kept[i, PLACE + 3 + k]
            f.began[i, k] = kept[i, PLACE + 6 + k]  # for now: where static objects were listed
            positions[begin - 1, i, k] = f.center[i, k]
        f.up[i], f.resting[i] = kept[i, PLACE + 9], kept[i, PLACE + 10] > 0.0
        f.pressed[i] = kept[i, PLACE + 11]
        spell[i], pinched[i] = int(kept[i, PLACE + 12]), int(kept[i, PLACE + 13])
        for q in range(begin):
            forces[q, i], stem_forces[q, i] = kept[i, ROWS + q], kept[i, ROWS + most + q]
    contacts.list_walls(s, f.began, c, solid)
    for k in range(5):
        so_far[k] = kept[0, SUMS + k]


@inner
def keep(s, f, c, spell, pinched, forces, stem_forces, so_far, begin, kept):
    """Keep the fruits as they are; the rows of forces are those of the last points."""
    most = (kept.shape[1] - ROWS) // 2
    rows = min(len(forces), most)
    for i in range(len(kept)):
        for a in range(DOFS):
            kept[i, a], kept[i, DOFS + a] = f.u[i, a], f.before[i, a]
        for k in range(3):
            kept[i, PLACE + k], kept[i, PLACE + 3 + k] = f.center[i, k], s.root[i, k]
            kept[i, PLACE + 6 + k] = c.listed_at[i, k]
        kept[i, PLACE + 9], kept[i, PLACE + 10] = f.up[i], 1.0 if f.resting[i] else 0.0
        kept[i, PLACE + 11] = f.pressed[i]
        kept[i, PLACE + 12], kept[i, PLACE + 13] = spell[i], pinched[i]
        for q in range(rows):
            kept[i, ROWS + q] = forces[len(forces) - rows + q, i]
            kept[i, ROWS + most + q] = stem_forces[len(forces) - rows + q, i]
    for k in range(5):
        kept[0, SUMS + k] = so_far[k]


def at_rest(kept: FloatArray) -> FloatArray:
    """What is kept (S, N, W), at rest: the forces of the last step, and no harm so far."""
    most = (kept.shape[2] - ROWS) // 2
    out = np.concatenate([kept[..., :ROWS], kept[..., [ROWS + most - 1, -1]]], axis=2)
    out[..., DOFS:PLACE] = out[..., :DOFS]
    out[..., PLACE + 12 : ROWS] = 0.0
    return out
