"""Contacts of fruits on stems: with the cup, with one another, and with static objects.

A contact of fruit i or of its stem has a kind, such as :data:`ON_WALL`, and a partner: a fruit, an
obstacle or a piece of the stem. It has a gap [m] (negative: pressed), the unit direction in which
it pushes the fruit or the stem, and the share of the stem at which it pushes.

``u[i]`` (2L,) are the deflections of the loaded points of stem i: L along the first direction
across the stem, then L along the second [m]. Kernels take the arrays of all stems and the index of
a stem: counting the references of a slice would cost more than the kernel itself.
"""

import math
from typing import NamedTuple

import numpy as np

from optipromp.core.arrays import BoolArray, FloatArray, IntArray
from optipromp.core.compiled import called, inlined, inner
from optipromp.core.geometry.distances import distance_and_gradient
from optipromp.core.pushing.parameters import PUSH
from optipromp.core.pushing.stems.cup import fruit_gap

LOADS = len(PUSH.beam.loaded)


class Descent(NamedTuple):
    """Gauss-Newton on the energy of one stem after the other."""

    inertia: FloatArray  # (N,) mass of the fruits over the squared time of a step [N/m]
    free: FloatArray  # (N, L, L) inverse of stiffness plus inertia of each stem [m/N]
    gradient: FloatArray  # (2L,) of the energy of the present stem [N]
    inverse: FloatArray  # (2L, 2L) of the Hessian of that energy [m/N]
    j: FloatArray  # (2L,) see :func:`press`
    v: FloatArray  # (2L,) see :func:`press`
    eased: FloatArray  # (N,) share of a Gauss-Newton step that is taken
    last: FloatArray  # (N, 2L) last step [m]


@inlined
def shortened(s, u, i):
    """Height by which the deflections of a stem lift its fruit: ½ uᵀ S u [m]."""
    up = 0.0
    for a in range(LOADS):
        for b in range(LOADS):
            both = u[i, a] * u[i, b] + u[i, LOADS + a] * u[i, LOADS + b]
            up += 0.5 * s.shortening[i, a, b] * both
    return up


@inlined
def place(s, u, i, chord, share):
    """Position of the point at a share of a stem; ``chord`` is the distance root to fruit [m]."""
    root, axes, shape = s.root, s.axes, s.shape
    n = shape.shape[1] - 1
    k = min(int(share * n), n - 1)
    t = share * n - k
    w1 = w2 = 0.0
    for a in range(LOADS):
        w = (1.0 - t) * shape[i, k, a] + t * shape[i, k + 1, a]
        w1 += w * u[i, a]
        w2 += w * u[i, LOADS + a]
    along = chord * share
    return (
        root[i, 0] + w1 * axes[i, 0, 0] + w2 * axes[i, 1, 0] + along * axes[i, 2, 0],
        root[i, 1] + w1 * axes[i, 0, 1] + w2 * axes[i, 1, 1] + along * axes[i, 2, 1],
        root[i, 2] + w1 * axes[i, 0, 2] + w2 * axes[i, 1, 2] + along * axes[i, 2, 2],
    )


@inlined
def level_place(s, i, x, y, z):
    """Share of a straight stem that is level with a point; 0 beyond the ends of the stem."""
    root, axes = s.root, s.axes
    d = (
        (x - root[i, 0]) * axes[i, 2, 0]
        + (y - root[i, 1]) * axes[i, 2, 1]
        + (z - root[i, 2]) * axes[i, 2, 2]
    )
    share = d / s.length[i]
    return share if 0.0 < share < 1.0 else 0.0


@called
def freely(s, i, d):
    """``d.free[i]`` (L, L): inverse of the stiffness plus the fruit's inertia [m/N]."""
    last = LOADS - 1
    shared = 1.0 / d.inertia[i] + s.compliance[i, last, last]
    for a in range(LOADS):
        for b in range(LOADS):
            both = s.compliance[i, a, last] * s.compliance[i, b, last]
            d.free[i, a, b] = s.compliance[i, a, b] - both / shared


@inlined
def begin(s, u, ahead, i, d):
    """``d.gradient`` and ``d.inverse`` of the energy of stem and inertia, without contacts."""
    gradient, inverse = d.gradient, d.inverse
    for a in range(LOADS):
        g1 = g2 = 0.0
        for b in range(LOADS):
            k = s.stiffness[i, a, b]
            g1 += k * (u[i, b] - s.rest[i, b])
            g2 += k * (u[i, LOADS + b] - s.rest[i, LOADS + b])
            inverse[a, b] = inverse[LOADS + a, LOADS + b] = d.free[i, a, b]
            inverse[a, LOADS + b] = inverse[LOADS + a, b] = 0.0
        gradient[a], gradient[LOADS + a] = g1, g2
    for a in (LOADS - 1, 2 * LOADS - 1):
        gradient[a] += d.inertia[i] * (u[i, a] - ahead[i, a])


@inlined
def press(s, u, i, share, way, depth, spring, d):
    """Add a spring [N/m], compressed by ``depth`` [m], that pushes a share of a stem along ``way``.

    With ``d.j`` the derivative of the spring's length by the deflections, the Hessian grows by
    ``spring`` j jᵀ. Its inverse follows by Sherman and Morrison's formula; ``d.v`` is scratch.
    """
    axes, shape, inverse, j, v = s.axes, s.shape, d.inverse, d.j, d.v
    nx, ny, nz = way
    n = shape.shape[1] - 1
    k = min(int(share * n), n - 1)
    t = share * n - k
    n1 = nx * axes[i, 0, 0] + ny * axes[i, 0, 1] + nz * axes[i, 0, 2]
    n2 = nx * axes[i, 1, 0] + ny * axes[i, 1, 1] + nz * axes[i, 1, 2]
    n3 = share * (nx * axes[i, 2, 0] + ny * axes[i, 2, 1] + nz * axes[i, 2, 2])
    for a in range(LOADS):
        w = (1.0 - t) * shape[i, k, a] + t * shape[i, k + 1, a]
        d1 = d2 = 0.0
        for b in range(LOADS):
            d1 += s.shortening[i, a, b] * u[i, b]
            d2 += s.shortening[i, a, b] * u[i, LOADS + b]
        j[a] = w * n1 - n3 * d1
        j[LOADS + a] = w * n2 - n3 * d2
    yielding = 1.0 / spring
    for a in range(2 * LOADS):
        total = 0.0
        for b in range(2 * LOADS):
            total += inverse[a, b] * j[b]
        v[a] = total
        yielding += total * j[a]
    for a in range(2 * LOADS):
        d.gradient[a] -= spring * depth * j[a]
        total = v[a] / yielding
        for b in range(2 * LOADS):
            inverse[a, b] -= total * v[b]


SWING = PUSH.swing
ON_CUP = 0  # the fruit and the cup
ON_FRUIT = 1  # the fruit and another fruit
ON_STEM = 2  # the fruit and the stem of another fruit
STEM_ON_FRUIT = 3  # the stem and another fruit
ON_WALL = 4  # the fruit and a static object
STEM_ON_CUP = 5  # a piece of the stem and the cup
AT_RIM, AT_BASE = 0, 1  # pieces of a stem, level with rim and base; from 2 on: points of the grid


class Fruits(NamedTuple):
    """N fruits as they move."""

    u: FloatArray  # (N, 2L) deflections of the stems [m]
    before: FloatArray  # (N, 2L) deflections at the beginning of the step [m]
    ahead: FloatArray  # (N, 2L) deflections that the fruits would swing to without a contact [m]
    up: FloatArray  # (N,) height by which the deflections lift the fruit [m]
    center: FloatArray  # (N, 3) [m]
    began: FloatArray  # (N, 3) centres at the beginning of the step [m]
    resting: BoolArray  # (N,) whether nothing has touched the fruit or its stem yet
    pressed: FloatArray  # (N,) force of the cup on the fruit [N]
    earlier: FloatArray  # (N,) that force in the last step [N]
    firmly: BoolArray  # (N,) whether the fruit is pressed against a static object
    force: FloatArray  # (N,) largest contact force on the fruit [N]
    on_stem: FloatArray  # (N,) force of the cup on the stem [N]


class Contacts(NamedTuple):
    """Possible contacts of N fruits and their stems, at most M of each fruit."""

    kind: IntArray  # (N, M)
    other: IntArray  # (N, M) partner: index of a fruit, of an obstacle or of a piece of the stem
    possible: IntArray  # (N,) number of possible contacts
    close: IntArray  # (N, M) indices of the close contacts
    closes: IntArray  # (N,) number of close contacts
    overlap: BoolArray  # (N, N, 2) see :func:`overlapping`
    walls: IntArray  # (N,) number of static objects near the fruit
    listed_at: FloatArray  # (N, 3) centre of the fruit when static objects were listed [m]
    top: FloatArray  # (N,) share of the stem that is level with the rim, or 0
    bottom: FloatArray  # (N,) share of the stem that is level with the base, or 0
    first: IntArray  # (N,) the grid's first point under the rim


@inlined
def hang(s, f, i):
    """Bring fruit i to the end of its deflected stem."""
    chord = s.length[i] - f.up[i]
    f.center[i, 0], f.center[i, 1], f.center[i, 2] = place(s, f.u, i, chord, 1.0)


@inner
def _apart(x, y, z, a, b, c):
    """Distance of two points, and the unit vector from the second to the first."""
    x, y, z = x - a, y - b, z - c
    d = math.sqrt(x * x + y * y + z * z)
    out = 1.0 / d if d > 1e-9 else 0.0
    return d, out * x, out * y, out * z


@inner
def overlapping(s, u, overlap):
    """Find the pairs that overlap at the deflections ``u``: between them is no contact.

    ``overlap`` (N, N, 2) out: [i, o, 0] fruit i in fruit o; [i, o, 1] fruit i in stem o.
    """
    for i in range(len(s.root)):
        for o in range(len(s.root)):
            overlap[i, o, 0] = overlap[i, o, 1] = False
            for a, own in ((1.0, s.radius[i]), (s.upper[i], s.above[i])):
                x0, x1, x2 = place(s, u, i, s.length[i], a)
                for b, other in ((1.0, s.radius[o]), (s.upper[o], s.above[o])):
                    y0, y1, y2 = place(s, u, o, s.length[o], b)
                    d, _, _, _ = _apart(x0, x1, x2, y0, y1, y2)
                    overlap[i, o, 0] |= d < own + other
                share = level_place(s, o, x0, x1, x2)
                y0, y1, y2 = place(s, u, o, s.length[o], share)
                d, _, _, _ = _apart(x0, x1, x2, y0, y1, y2)
                overlap[i, o, 1] |= d < own + s.thickness[o]


@inner
def list_fruits(c):
    """List the contacts of each fruit with the cup and with the other fruits."""
    for i in range(len(c.kind)):
        n = 1
        c.kind[i, 0] = ON_CUP
        for o in range(len(c.kind)):
            for kind in range(ON_FRUIT, STEM_ON_FRUIT + 1 if o != i else ON_FRUIT):
                c.kind[i, n], c.other[i, n] = kind, o
                n += 1


@inner
def list_walls(s, center, c, solid):
    """List the obstacles near each fruit that has moved by ``SWING.wandered``."""
    for i in range(len(center)):
        x, y, z = center[i, 0], center[i, 1], center[i, 2]
        at = c.listed_at
        moved, _, _, _ = _apart(x, y, z, at[i, 0], at[i, 1], at[i, 2])
        if moved <= SWING.wandered:
            continue
        at[i, 0], at[i, 1], at[i, 2] = x, y, z
        n = first = 1 + 3 * (len(center) - 1)
        reach = max(s.radius[i], (1.0 - s.upper[i]) * s.length[i] + s.above[i]) + SWING.listed
        for k in range(len(solid.kind)):
            gap, _, _, _ = distance_and_gradient(solid, k, x, y, z)
            if gap < reach:
                c.kind[i, n], c.other[i, n] = ON_WALL, k
                n += 1
        c.walls[i] = n - first


@inner
def list_pieces(s, c, at, cup):
    """List the pieces of each stem at rim and base, and at the grid's points below the rim."""
    n = s.shape.shape[1] - 1
    for i in range(len(s.root)):
        c.top[i] = _level_with(s, i, at, cup.rim)
        c.bottom[i] = _level_with(s, i, at, cup.base)
        low = _level_with(s, i, at, cup.base - max(SWING.neck, cup.cone))
        c.first[i] = int(c.top[i] * n) + 1
        end = int(low * n) if low > 0.0 else int(under_fruit(s, i) * n)
        before = 1 + 3 * (len(s.root) - 1) + c.walls[i]
        pieces = 2 + max(end - c.first[i] + 1, 0)
        for k in range(pieces):
            c.kind[i, before + k], c.other[i, before + k] = STEM_ON_CUP, k
        c.possible[i] = before + pieces


@inlined
def piece(s, c, i, k):
    """Share of stem i at its piece k; 0 where there is no such piece."""
    if k == AT_RIM:
        return float(c.top[i])
    if k == AT_BASE:
        return float(c.bottom[i])
    return float((c.first[i] + k - 2) / (s.shape.shape[1] - 1))


@inlined
def under_fruit(s, i):
    """Share of stem i at which its fruit begins."""
    return float(s.upper[i] - s.above[i] / s.length[i])


@inlined
def _level_with(s, i, at, h):
    """Share of stem i that is level with the cup's axis at height h."""
    return level_place(s, i, at.x + h * at.u, at.y + h * at.v, at.z + h * at.w)


@inlined
def on_cup(s, f, i, at, cup):
    """Contact of fruit i with the cup: gap, direction and share of the stem."""
    center = f.center
    gap, n0, n1, n2 = fruit_gap(center[i, 0], center[i, 1], center[i, 2], s.radius[i], at, cup)
    where = 1.0
    if s.upper[i] < 1.0:  # a fruit of more than five radii has balls between, two radii apart
        apart, wide = (1.0 - s.upper[i]) * s.length[i], max(s.radius[i], s.above[i])
        count = math.ceil(0.5 * apart / wide) if apart > 3.0 * wide else 1
        for k in range(1, count + 1):
            share, radius = s.upper[i], s.above[i]
            if k < count:
                share = 1.0 - (1.0 - share) * k / count
                radius = s.radius[i] + (radius - s.radius[i]) * k / count
            x, y, z = place(s, f.u, i, s.length[i] - f.up[i], share)
            over, m0, m1, m2 = fruit_gap(x, y, z, radius, at, cup)
            if over < gap:
                gap, n0, n1, n2, where = over, m0, m1, m2, share
    return gap, n0, n1, n2, where


@inlined
def on_wall(s, f, i, solid, wall):
    """Contact of fruit i with a static object: gap, direction and share of the stem."""
    center = f.center
    gap, n0, n1, n2 = distance_and_gradient(solid, wall, center[i, 0], center[i, 1], center[i, 2])
    if s.upper[i] < 1.0:
        x, y, z = place(s, f.u, i, s.length[i] - f.up[i], s.upper[i])
        over, m0, m1, m2 = distance_and_gradient(solid, wall, x, y, z)
        if over - s.above[i] < gap - s.radius[i]:
            return over - s.above[i], m0, m1, m2, s.upper[i]
    return gap - s.radius[i], n0, n1, n2, 1.0


@inlined
def between(s, f, overlap, i, kind, o):
    """Contact of fruit i or its stem with fruit o or its stem; an infinite gap for none."""
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
                along = level_place(s, o, x0, x1, x2)
                if along == 0.0:
                    continue
                y0, y1, y2 = place(s, u, o, s.length[o] - up[o], along)
                keep = own + s.thickness[o]
            else:
                share = level_place(s, i, y0, y1, y2)
                if share == 0.0 or share > under_fruit(s, i):
                    continue
                x0, x1, x2 = place(s, u, i, s.length[i] - up[i], share)
                keep = other + s.thickness[i]
            gap, n0, n1, n2 = _apart(x0, x1, x2, y0, y1, y2)
            if gap - keep < least:
                least, m0, m1, m2, at = gap - keep, n0, n1, n2, share
    return least, m0, m1, m2, at
