"""Contacts of fruits on stems: with the cup, with one another, and with static objects.

The contacts of fruit i and of its stem are numbered. Among N fruits, with K = 3 (N - 1):

- 0: the fruit and the cup;
- 1 + 3k, 2 + 3k, 3 + 3k: the fruit and another one, the fruit and the other's stem, the stem and
  the other fruit;
- K + 1 and on: the fruit and the static objects near it;
- ``on_fruit[i]`` and on: the stem and the cup, at the rim, at the base, and between at the points
  of the stem's grid.

A contact has a gap [m] (negative: pressed), the direction in which it pushes the fruit or the stem,
and the share of the stem at which it pushes.
"""

import math
from typing import NamedTuple

import numpy as np

from optipromp.arrays import BoolArray, FloatArray, IntArray
from optipromp.compiled import inlined, inner
from optipromp.geometry.distances import distance_and_gradient
from optipromp.geometry.obstacles import Obstacles
from optipromp.pushing.parameters import PUSH
from optipromp.pushing.stems.bending import Stems
from optipromp.pushing.stems.cup import NECK_LOOKED_AT, Mouth, MouthPose
from optipromp.pushing.stems.deflected import level, place

LISTED, WANDERED = PUSH.swing.listed, PUSH.swing.wandered


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


class Contacts(NamedTuple):
    """The possible contacts of N fruits.

    Attributes:
        overlap: (N, N, 2) see :func:`overlapping`.
        firm: (N, W) obstacles near a fruit; ``listed_at`` (N, 3) where it was as they were listed.
        on_fruit: (N,) how many contacts are the fruit's; ``on_all`` with those of its stem.
        top: (N,) share of the stem that is level with the rim, or 0; ``bottom`` with the base.
        first: (N,) the grid's first point under the rim.
        close: (N,) how many contacts are close; ``number`` (N, M) which, ``share`` (N, M) where.
    """

    overlap: BoolArray
    firm: IntArray
    listed_at: FloatArray
    on_fruit: IntArray
    on_all: IntArray
    top: FloatArray
    bottom: FloatArray
    first: IntArray
    close: IntArray
    number: IntArray
    share: FloatArray


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
    root, axes, shape, length = s.root, s.axes, s.shape, s.length
    for i in range(len(root)):
        for o in range(len(root)):
            overlap[i, o, 0] = overlap[i, o, 1] = False
            for a, own in ((1.0, s.radius[i]), (s.upper[i], s.above[i])):
                x0, x1, x2 = place(root, axes, shape, u, i, length[i], a)
                for b, other in ((1.0, s.radius[o]), (s.upper[o], s.above[o])):
                    y0, y1, y2 = place(root, axes, shape, u, o, length[o], b)
                    d, _, _, _ = apart(x0, x1, x2, y0, y1, y2)
                    overlap[i, o, 0] |= d < own + other
                share = level(root, axes, o, length[o], x0, x1, x2)
                y0, y1, y2 = place(root, axes, shape, u, o, length[o], share)
                d, _, _, _ = apart(x0, x1, x2, y0, y1, y2)
                overlap[i, o, 1] |= d < own + s.thickness[o]


@inner
def list_firm(
    s: Stems, center: FloatArray, firm: IntArray, listed_at: FloatArray, on_fruit: IntArray,
    solid: Obstacles,
) -> None:  # fmt: skip
    """Obstacles within :data:`LISTED` of each fruit that has moved since, into ``firm``."""
    before = 3 * (len(center) - 1) + 1
    for i in range(len(center)):
        x, y, z = center[i, 0], center[i, 1], center[i, 2]
        moved, _, _, _ = apart(x, y, z, listed_at[i, 0], listed_at[i, 1], listed_at[i, 2])
        if moved <= WANDERED:
            continue
        listed_at[i, 0], listed_at[i, 1], listed_at[i, 2] = x, y, z
        on_fruit[i] = before
        reach = max(s.radius[i], (1.0 - s.upper[i]) * s.length[i] + s.above[i]) + LISTED
        for k in range(firm.shape[1]):
            gap, _, _, _ = distance_and_gradient(solid, k, x, y, z)
            if gap < reach:
                firm[i, on_fruit[i] - before] = k
                on_fruit[i] += 1


@inner
def list_pieces(s: Stems, c: Contacts, at: MouthPose, cup: Mouth) -> None:
    """Which pieces of each stem are level with the cup, and those at its rim and base."""
    root, axes, length, above, n = s.root, s.axes, s.length, s.above, s.shape.shape[1] - 1
    under = cup.base - NECK_LOOKED_AT
    for i in range(len(root)):
        c.top[i] = _level_with(root, axes, i, length[i], at, cup.rim)
        c.bottom[i] = _level_with(root, axes, i, length[i], at, cup.base)
        low = _level_with(root, axes, i, length[i], at, under)
        c.first[i] = int(c.top[i] * n) + 1
        end = int(low * n) if low > 0.0 else int((s.upper[i] - above[i] / length[i]) * n)
        c.on_all[i] = c.on_fruit[i] + 2 + max(end - c.first[i] + 1, 0)


@inner
def _level_with(
    root: FloatArray, axes: FloatArray, i: int, length: float, at: MouthPose, h: float
) -> float:
    """Share of stem i that is level with the point of the cup's axis at height h."""
    return level(root, axes, i, length, at.x + h * at.u, at.y + h * at.v, at.z + h * at.w)


@inlined
def between(
    root: FloatArray, axes: FloatArray, shape: FloatArray, length: FloatArray, radius: FloatArray,
    thickness: FloatArray, upper: FloatArray, above: FloatArray, u: FloatArray, up: FloatArray,
    center: FloatArray, resting: BoolArray, overlap: BoolArray, i: int, what: int,
) -> tuple[float, float, float, float, float]:  # fmt: skip
    """Contact ``what`` of a fruit and its stem with another fruit and its stem.

    The arrays are those of :class:`Stems`, :class:`Fruits` and :class:`Contacts`.

    Returns:
        The gap, infinite where they cannot touch, the direction, and the share of stem i.
    """
    o = (what - 1) // 3
    o += 1 if o >= i else 0
    if resting[i] and resting[o]:
        return np.inf, 0.0, 0.0, 0.0, 1.0
    if (what % 3 == 1 and overlap[i, o, 0]) or (what % 3 == 2 and overlap[i, o, 1]):
        return np.inf, 0.0, 0.0, 0.0, 1.0
    if what % 3 == 0 and overlap[o, i, 1]:
        return np.inf, 0.0, 0.0, 0.0, 1.0
    least, m0, m1, m2, at = np.inf, 0.0, 0.0, 0.0, 1.0
    for first in range(2 if what % 3 and upper[i] < 1.0 else 1):  # the balls of fruit i
        share, own = 1.0, radius[i]
        x0, x1, x2 = center[i, 0], center[i, 1], center[i, 2]
        if first:
            share, own = upper[i], above[i]
            x0, x1, x2 = place(root, axes, shape, u, i, length[i] - up[i], share)
        for second in range(2 if what % 3 != 2 and upper[o] < 1.0 else 1):  # those of fruit o
            y0, y1, y2 = center[o, 0], center[o, 1], center[o, 2]
            other = above[o] if second else radius[o]
            if second:
                y0, y1, y2 = place(root, axes, shape, u, o, length[o] - up[o], upper[o])
            if what % 3 == 1:
                keep = own + other
            elif what % 3 == 2:
                along = level(root, axes, o, length[o], x0, x1, x2)
                if along == 0.0:
                    continue
                y0, y1, y2 = place(root, axes, shape, u, o, length[o] - up[o], along)
                keep = own + thickness[o]
            else:
                share = level(root, axes, i, length[i], y0, y1, y2)
                if share == 0.0 or share > upper[i] - above[i] / length[i]:
                    continue
                x0, x1, x2 = place(root, axes, shape, u, i, length[i] - up[i], share)
                keep = other + thickness[i]
            gap, n0, n1, n2 = apart(x0, x1, x2, y0, y1, y2)
            if gap - keep < least:
                least, m0, m1, m2, at = gap - keep, n0, n1, n2, share
    return least, m0, m1, m2, at
