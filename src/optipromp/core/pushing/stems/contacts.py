"""Contacts of fruits on stems: with the cup, with one another, and with static objects.

A contact of fruit i or of its stem has a kind, such as :data:`ON_WALL`, and another partner: a
fruit, an obstacle or a piece of the stem. It has a gap [m] (negative: pressed), the direction in
which it pushes the fruit or the stem, and the share of the stem at which it pushes.
"""

import math
from typing import NamedTuple

import numpy as np

from optipromp.core.arrays import BoolArray, FloatArray, IntArray
from optipromp.core.compiled import inlined, inner
from optipromp.core.geometry.distances import distance_and_gradient
from optipromp.core.geometry.obstacles import Obstacles
from optipromp.core.pushing.parameters import PUSH
from optipromp.core.pushing.stems.bending import Stems
from optipromp.core.pushing.stems.cup import NECK_LOOKED_AT, Mouth, MouthPose, fruit_gap
from optipromp.core.pushing.stems.deflected import level, place

LISTED, WANDERED = PUSH.swing.listed, PUSH.swing.wandered
ON_CUP = 0  # the fruit and the cup
ON_FRUIT = 1  # the fruit and another one
ON_STEM = 2  # the fruit and another one's stem
STEM_ON_FRUIT = 3  # the stem and another fruit
ON_WALL = 4  # the fruit and a static object
STEM_ON_CUP = 5  # the stem and the cup, level with its rim or base, or at a point of the grid
AT_RIM, AT_BASE = 0, 1  # pieces of a stem; those from 2 on are the grid's points under the rim


class Fruits(NamedTuple):
    """N fruits as they move.

    Attributes:
        u: (N, 2L) deflections of the stems [m]; ``before`` those of the last step; ``ahead`` those
            that the fruits would swing to by themselves.
        up: (N,) how far the deflections lift the fruits [m].
        center: (N, 3) of the fruits [m]; ``began`` where the step began.
        resting: (N,) whether nothing has touched them yet.
        pressed: (N,) force of the cup on the fruit [N]; ``earlier`` that of the last step.
        firmly: (N,) whether the fruit is pressed against a static object.
        force: (N,) largest contact force on the fruit; ``on_stem`` of the cup on the stem [N].
    """

    u: FloatArray
    before: FloatArray
    ahead: FloatArray
    up: FloatArray
    center: FloatArray
    began: FloatArray
    resting: BoolArray
    pressed: FloatArray
    earlier: FloatArray
    firmly: BoolArray
    force: FloatArray
    on_stem: FloatArray


class Contacts(NamedTuple):
    """The possible contacts of N fruits and their stems.

    Attributes:
        kind, other: (N, M) of each contact: with the cup, with the other fruits, with static
            objects and with the cup again, in this order.
        possible: (N,) how many they are.
        close: (N, M) which of them are close; ``closes`` (N,) how many.
        overlap: (N, N, 2) see :func:`overlapping`.
        walls: (N,) how many static objects are near; ``listed_at`` (N, 3) where the fruit was as
            they were listed.
        top: (N,) share of the stem that is level with the rim, or 0; ``bottom`` with the base.
        first: (N,) the grid's first point under the rim.
    """

    kind: IntArray
    other: IntArray
    possible: IntArray
    close: IntArray
    closes: IntArray
    overlap: BoolArray
    walls: IntArray
    listed_at: FloatArray
    top: FloatArray
    bottom: FloatArray
    first: IntArray


@inlined
def hang(s: Stems, f: Fruits, i: int) -> None:
    """Bring fruit i to the end of its deflected stem."""
    x, y, z = place(s, f.u, i, s.length[i] - f.up[i], 1.0)
    f.center[i, 0], f.center[i, 1], f.center[i, 2] = x, y, z


@inner
def apart(
    x: float, y: float, z: float, a: float, b: float, c: float
) -> tuple[float, float, float, float]:
    """Distance of two points, and the direction from the second to the first."""
    x, y, z = x - a, y - b, z - c
    d = math.sqrt(x * x + y * y + z * z)
    out = 1.0 / d if d > 1e-9 else 0.0
    return d, out * x, out * y, out * z


@inner
def overlapping(s: Stems, u: FloatArray, overlap: BoolArray) -> None:
    """Which fruits and stems overlap at rest (``u`` = 0) and so do not touch, into (N, N, 2).

    ``overlap[i, o, 0]``: fruit i in fruit o; ``overlap[i, o, 1]``: fruit i in stem o.
    """
    for i in range(len(s.root)):
        for o in range(len(s.root)):
            overlap[i, o, 0] = overlap[i, o, 1] = False
            for a, own in ((1.0, s.radius[i]), (s.upper[i], s.above[i])):
                x0, x1, x2 = place(s, u, i, s.length[i], a)
                for b, other in ((1.0, s.radius[o]), (s.upper[o], s.above[o])):
                    y0, y1, y2 = place(s, u, o, s.length[o], b)
                    d, _, _, _ = apart(x0, x1, x2, y0, y1, y2)
                    overlap[i, o, 0] |= d < own + other
                share = level(s, o, x0, x1, x2)
                y0, y1, y2 = place(s, u, o, s.length[o], share)
                d, _, _, _ = apart(x0, x1, x2, y0, y1, y2)
                overlap[i, o, 1] |= d < own + s.thickness[o]


@inner
def list_fruits(c: Contacts) -> None:
    """List the contacts of each fruit with the cup and with the other fruits."""
    for i in range(len(c.kind)):
        n = 1
        c.kind[i, 0] = ON_CUP
        for o in range(len(c.kind)):
            for kind in range(ON_FRUIT, STEM_ON_FRUIT + 1 if o != i else ON_FRUIT):
                c.kind[i, n], c.other[i, n] = kind, o
                n += 1


@inner
def list_walls(s: Stems, center: FloatArray, c: Contacts, solid: Obstacles) -> None:
    """List obstacles within :data:`LISTED` of each fruit that has moved since."""
    for i in range(len(center)):
        x, y, z = center[i, 0], center[i, 1], center[i, 2]
        at = c.listed_at
        moved, _, _, _ = apart(x, y, z, at[i, 0], at[i, 1], at[i, 2])
        if moved <= WANDERED:
            continue
        at[i, 0], at[i, 1], at[i, 2] = x, y, z
        n = first = 1 + 3 * (len(center) - 1)
        reach = max(s.radius[i], (1.0 - s.upper[i]) * s.length[i] + s.above[i]) + LISTED
        for k in range(len(solid.kind)):
            gap, _, _, _ = distance_and_gradient(solid, k, x, y, z)
            if gap < reach:
                c.kind[i, n], c.other[i, n] = ON_WALL, k
                n += 1
        c.walls[i] = n - first


@inner
def list_pieces(s: Stems, c: Contacts, at: MouthPose, cup: Mouth) -> None:
    """List the pieces of each stem that are level with the cup, and those at its rim and base."""
    n = s.shape.shape[1] - 1
    for i in range(len(s.root)):
        c.top[i] = _level_with(s, i, at, cup.rim)
        c.bottom[i] = _level_with(s, i, at, cup.base)
        low = _level_with(s, i, at, cup.base - NECK_LOOKED_AT)
        c.first[i] = int(c.top[i] * n) + 1
        end = int(low * n) if low > 0.0 else int(under_fruit(s, i) * n)
        before = 1 + 3 * (len(s.root) - 1) + c.walls[i]
        pieces = 2 + max(end - c.first[i] + 1, 0)
        for k in range(pieces):
            c.kind[i, before + k], c.other[i, before + k] = STEM_ON_CUP, k
        c.possible[i] = before + pieces


@inlined
def piece(s: Stems, c: Contacts, i: int, k: int) -> float:
    """Share of stem i at which its piece k is; 0 where there is none."""
    if k == AT_RIM:
        return float(c.top[i])
    if k == AT_BASE:
        return float(c.bottom[i])
    return float((c.first[i] + k - 2) / (s.shape.shape[1] - 1))


@inlined
def under_fruit(s: Stems, i: int) -> float:
    """Share of stem i at which its fruit begins."""
    return float(s.upper[i] - s.above[i] / s.length[i])


@inlined
def _level_with(s: Stems, i: int, at: MouthPose, h: float) -> float:
    """Share of stem i that is level with the point of the cup's axis at height h."""
    return level(s, i, at.x + h * at.u, at.y + h * at.v, at.z + h * at.w)


@inlined
def on_cup(
    s: Stems, f: Fruits, i: int, at: MouthPose, cup: Mouth
) -> tuple[float, float, float, float, float]:
    """Gap of fruit i to the cup, the direction, and the share of its stem."""
    gap, n0, n1, n2 = fruit_gap(
        f.center[i, 0], f.center[i, 1], f.center[i, 2], s.radius[i], at, cup
    )
    if s.upper[i] < 1.0:
        x, y, z = place(s, f.u, i, s.length[i] - f.up[i], s.upper[i])
        over, m0, m1, m2 = fruit_gap(x, y, z, s.above[i], at, cup)
        if over < gap:
            return over, m0, m1, m2, s.upper[i]
    return gap, n0, n1, n2, 1.0


@inlined
def on_wall(
    s: Stems, f: Fruits, i: int, solid: Obstacles, wall: int
) -> tuple[float, float, float, float, float]:
    """:func:`on_cup` for a static object."""
    gap, n0, n1, n2 = distance_and_gradient(
        solid, wall, f.center[i, 0], f.center[i, 1], f.center[i, 2]
    )
    if s.upper[i] < 1.0:
        x, y, z = place(s, f.u, i, s.length[i] - f.up[i], s.upper[i])
        over, m0, m1, m2 = distance_and_gradient(solid, wall, x, y, z)
        if over - s.above[i] < gap - s.radius[i]:
            return over - s.above[i], m0, m1, m2, s.upper[i]
    return gap - s.radius[i], n0, n1, n2, 1.0


@inlined
def between(
    s: Stems, f: Fruits, overlap: BoolArray, i: int, kind: int, o: int
) -> tuple[float, float, float, float, float]:
    """Contact of fruit i or its stem with fruit o or its stem; the gap is infinite for none."""
    u, up, center, upper, above = f.u, f.up, f.center, s.upper, s.above
    if f.resting[i] and f.resting[o]:
        return np.inf, 0.0, 0.0, 0.0, 1.0
    if (
        (kind == ON_FRUIT and overlap[i, o, 0])
        or (kind == ON_STEM and overlap[i, o, 1])
        or (kind == STEM_ON_FRUIT and overlap[o, i, 1])
    ):
        return np.inf, 0.0, 0.0, 0.0, 1.0
    least, m0, m1, m2, at = np.inf, 0.0, 0.0, 0.0, 1.0
    for first in range(2 if kind != STEM_ON_FRUIT and upper[i] < 1.0 else 1):  # balls of fruit i
        share, own = 1.0, s.radius[i]
        x0, x1, x2 = center[i, 0], center[i, 1], center[i, 2]
        if first:
            share, own = upper[i], above[i]
            x0, x1, x2 = place(s, u, i, s.length[i] - up[i], share)
        for second in range(2 if kind != ON_STEM and upper[o] < 1.0 else 1):  # those of fruit o
            y0, y1, y2 = center[o, 0], center[o, 1], center[o, 2]
            other = above[o] if second else s.radius[o]
            if second:
                y0, y1, y2 = place(s, u, o, s.length[o] - up[o], upper[o])
            if kind == ON_FRUIT:
                keep = own + other
            elif kind == ON_STEM:
                along = level(s, o, x0, x1, x2)
                if along == 0.0:
                    continue
                y0, y1, y2 = place(s, u, o, s.length[o] - up[o], along)
                keep = own + s.thickness[o]
            else:
                share = level(s, i, y0, y1, y2)
                if share == 0.0 or share > under_fruit(s, i):
                    continue
                x0, x1, x2 = place(s, u, i, s.length[i] - up[i], share)
                keep = other + s.thickness[i]
            gap, n0, n1, n2 = apart(x0, x1, x2, y0, y1, y2)
            if gap - keep < least:
                least, m0, m1, m2, at = gap - keep, n0, n1, n2, share
    return least, m0, m1, m2, at
