"""The cost of a hand's path through packs, in the quasi-static model.

A path is tried in the perceived state and in sampled states. Most paths are bad: a trial ends as
soon as the cost is sure to exceed a limit.
"""

import math

import numpy as np

from optipromp.core.arrays import FloatArray
from optipromp.core.compiled import inner, kernel
from optipromp.core.pushing.packs.flat import clear
from optipromp.core.pushing.packs.quasi_static import Bench, pushed
from optipromp.core.pushing.parameters import PUSH

MODEL_STEP = PUSH.pack.step
FAR, WORST, MOVED = PUSH.pack.far, PUSH.pack.worst, PUSH.pack.moved
LIGHT, HEAVY = PUSH.pack.light, PUSH.pack.heavy
WIDE, TIGHT = PUSH.pack.wide, PUSH.pack.tight
BEHIND, BACK = PUSH.pack.behind, PUSH.pack.back
BEYOND, JAM, TAKEN = PUSH.pack.beyond, PUSH.pack.jam, PUSH.pack.taken


@kernel
def stepped(corners: FloatArray) -> FloatArray:
    """Poses (T, 3) along a path (k, 2), in equal steps of the model, without a turn."""
    total = 0.0
    for k in range(1, len(corners)):
        total += math.hypot(corners[k, 0] - corners[k - 1, 0], corners[k, 1] - corners[k - 1, 1])
    count = max(2, math.ceil(total / MODEL_STEP) + 1)
    out = np.zeros((count, 3))
    out[0, :2], out[-1, :2] = corners[0], corners[-1]
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


@inner
def excess(value: float, free: float, unit: float) -> float:
    """Cost of a value above ``free``: ((value - free) / unit)², 0 below."""
    return (max(0.0, value - free) / unit) ** 2


@inner
def motion_cost(start: FloatArray, end: FloatArray) -> float:
    """Cost of the target's motion from one state (B, 3) to another."""
    u, v = end[0, 0] - start[0, 0], end[0, 1] - start[0, 1]
    return float((u * u + v * v) / (MOVED * MOVED))


@inner
def depth_cost(bench: Bench, end: FloatArray) -> float:
    """Cost of a target that ends too deep between the fingers."""
    return excess(end[0, 0], 0.4 * bench.mouth[1], BEYOND)


@inner
def edge_cost(bench: Bench, u: float) -> float:
    """Cost of an object that ends near the front of the board."""
    return excess(bench.edge + BEHIND, u, BACK)


@inner
def force_cost(force: float) -> float:
    """Cost of the largest force [N]."""
    return excess(force, LIGHT, HEAVY)


@inner
def wall_cost(room: float) -> float:
    """Cost of a distance to the walls [m]."""
    return excess(WIDE, room, TIGHT)


@kernel
def room(bench: Bench, path: FloatArray) -> float:
    """Least distance of the hand from the walls along a path (T, 3) [m], at most :data:`WIDE`."""
    return clear(path, 5, bench.hand, bench.walls, WIDE)


@inner
def taken(bench: Bench, u: float, v: float) -> bool:
    """Whether an object ends between the fingers."""
    palm, tip, half = bench.mouth
    return bool(palm < u < tip and abs(v) < half)


@kernel
def cost(
    bench: Bench, corners: FloatArray, states: FloatArray, slips: FloatArray, so_far: FloatArray,
    limit: float,
) -> float:  # fmt: skip
    """Mean cost of a path over trials, or infinity where it is sure to exceed ``limit``.

    A trial costs where the target moves, an object jams, an object ends between the fingers, the
    force is large, or a wall or the board's edge is near. The trials of the largest cost for
    earlier paths come first: they end a bad path soon.

    ``bench``: objects, walls and hand. ``corners``: (k, 2) of the path. ``states``: (N, B, 3) poses
    of the objects in each trial. ``slips``: (N,) coefficients of friction between objects, and with
    the tool. ``so_far``: (N,) summed cost of each trial for earlier paths; changed in place.
    ``limit``: largest mean cost of interest.
    """
    path = stepped(corners)
    always = 0.001 * len(path) + wall_cost(room(bench, path))
    total, trials = 0.0, len(slips)
    costs = np.full(trials, -1.0)  # of the trials so far; -1: not made yet
    hardest = LIGHT + HEAVY * math.sqrt(WORST)
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
        enough = min(hardest, LIGHT + HEAVY * math.sqrt(left))
        pushed(bench, path, end, slips[n], FAR, enough, report)
        force, jam, done = report
        if done < 1.0:
            one = float(WORST * (2.0 - done))
        else:
            one = motion_cost(states[n], end) + depth_cost(bench, end)
            one += (jam / JAM) ** 2 + force_cost(force)
            for b in range(1, len(end)):
                if taken(bench, end[b, 0], end[b, 1]):
                    one += TAKEN
                one += edge_cost(bench, end[b, 0])
            one = min(one, 2.0 * WORST)
        costs[n] = one
        so_far[n] += one
        total += one
    total = 0.0
    for n in range(trials):  # in the order of the trials: the sum does not depend on ``so_far``
        total += costs[n]
    return always + total / trials
