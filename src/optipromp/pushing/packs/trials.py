"""The cost of a hand's path through packs, in the quasi-static model.

A path is tried in the perceived state and in sampled ones. Most paths are bad, so a trial ends as
soon as the cost is sure to exceed a limit.
"""

import math
from typing import NamedTuple

import numpy as np

from optipromp.arrays import FloatArray
from optipromp.compiled import kernel
from optipromp.pushing.packs.flat import Shapes, clear
from optipromp.pushing.packs.quasi_static import pushed
from optipromp.pushing.parameters import PUSH

MODEL_STEP = PUSH.pack.step
FAR, WORST, MOVED = PUSH.pack.far, PUSH.pack.worst, PUSH.pack.moved
LIGHT, HEAVY = PUSH.pack.light, PUSH.pack.heavy
WIDE, TIGHT = PUSH.pack.wide, PUSH.pack.tight
BEHIND, BACK = PUSH.pack.behind, PUSH.pack.back
BEYOND, JAM, TAKEN = PUSH.pack.beyond, PUSH.pack.jam, PUSH.pack.taken


class Bench(NamedTuple):
    """Objects around the target, in (u, v): along z_g and along y_g from the target.

    Attributes:
        objects: the target first, then the pushables.
        yields, lever2: (B,) see :func:`optipromp.pushing.packs.quasi_static.pushed`.
        walls: static objects at the target's height.
        hand: the outlines of the hand and of the wrist behind it.
        mouth: (3,) u of palm and finger tips, and half the opening between the fingers [m].
        edge: u of the board's front, behind which objects must stay [m].
    """

    objects: Shapes
    yields: FloatArray
    lever2: FloatArray
    walls: Shapes
    hand: Shapes
    mouth: FloatArray
    edge: float


@kernel
def stepped(corners, step):  # type: ignore[no-untyped-def]
    """Poses (T, 3) along a path (k, 2), in equal steps of at most ``step``, without a turn."""
    total = 0.0
    for k in range(1, len(corners)):
        total += math.hypot(corners[k, 0] - corners[k - 1, 0], corners[k, 1] - corners[k - 1, 1])
    count = max(2, math.ceil(total / step) + 1)
    out = np.zeros((count, 3))
    for c in range(2):
        out[0, c], out[count - 1, c] = corners[0, c], corners[len(corners) - 1, c]
    gone, t = 0.0, 1
    for k in range(1, len(corners)):
        du, dv = corners[k, 0] - corners[k - 1, 0], corners[k, 1] - corners[k - 1, 1]
        length = math.hypot(du, dv)
        while t < count - 1 and total * t / (count - 1) <= gone + length:
            share = (total * t / (count - 1) - gone) / max(length, 1e-12)
            out[t, 0] = corners[k - 1, 0] + share * du
            out[t, 1] = corners[k - 1, 1] + share * dv
            t += 1
        gone += length
    return out


@kernel
def cost(bench, corners, states, slips, so_far, limit):  # type: ignore[no-untyped-def]
    """Mean cost of a path over trials, or infinity where it is sure to exceed ``limit``.

    A trial costs where the target moves, an object jams, an object ends between the fingers, the
    force is large, or a wall or the board's edge is near. The trials that cost the most for earlier
    paths are made first, so that a bad path is soon known for one.

    Args:
        bench: what stands there.
        corners: (k, 2) of the path.
        states: (N, B, 3) where objects stand in each trial.
        slips: (N,) coefficients of friction between objects, and with the tool.
        so_far: (N,) what each trial has cost for the paths so far, in sum; changed in place.
        limit: largest mean cost of interest.
    """
    path = stepped(corners, MODEL_STEP)
    always = 0.001 * path.shape[0]
    if len(bench.walls.size):
        near = max(0.0, WIDE - clear(path, 5, bench.hand, bench.walls, WIDE))
        always += (near / TIGHT) ** 2
    total, trials = 0.0, len(slips)
    costs = np.full(trials, -1.0)  # of those that were made
    hardest = LIGHT + HEAVY * math.sqrt(WORST)
    palm, tip, half = bench.mouth
    report = np.zeros(3)
    for _ in range(trials):
        left = (limit - always) * trials - total
        if left < 0.0:
            return math.inf
        n = -1
        for k in range(trials):
            if costs[k] < 0.0 and (n < 0 or so_far[k] > so_far[n]):
                n = k
        end = states[n].copy()
        pushed(
            path, bench.hand, bench.objects, end, bench.yields, bench.lever2, bench.walls,
            slips[n], FAR, min(hardest, LIGHT + HEAVY * math.sqrt(left)), report,
        )  # fmt: skip
        force, jam, done = report
        if done < 1.0:
            one = WORST * (2.0 - done)
        else:
            moved_u, moved_v = end[0, 0] - states[n, 0, 0], end[0, 1] - states[n, 0, 1]
            one = (moved_u * moved_u + moved_v * moved_v) / (MOVED * MOVED)
            one += (max(0.0, end[0, 0] - 0.4 * tip) / BEYOND) ** 2
            one += (jam / JAM) ** 2 + (max(0.0, force - LIGHT) / HEAVY) ** 2
            for b in range(1, len(end)):
                u, v = end[b, 0], end[b, 1]
                if palm < u < tip and abs(v) < half:
                    one += TAKEN
                one += (max(0.0, bench.edge + BEHIND - u) / BACK) ** 2
            one = min(one, 2.0 * WORST)
        costs[n] = one
        so_far[n] += one
        total += one
    total = 0.0
    for n in range(trials):  # in the order of the trials: the sum does not depend on ``so_far``
        total += costs[n]
    return always + total / trials
