"""Gaps of fruits and stems to a cup: to its wall, floor, cone, neck and flange.

Kernels take and return points and directions as three numbers each, which stay in registers.
"""

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from optipromp.core.arrays import FloatArray, lengths
from optipromp.core.compiled import called, inner, kernel
from optipromp.core.geometry.shapes import outlines
from optipromp.core.pushing.parameters import PUSH
from optipromp.core.robots.model import Robot
from optipromp.core.robots.tool_protocol import Tool, meets
from optipromp.core.robots.tools import WALL
from optipromp.core.scenes.objects import SceneObject

SWING = PUSH.swing
TOUCHES = 1e-3  # [m] gap below which the force on a fruit is the cup's: contacts press fruits apart
ABOVE = 1.0  # [m] added to the gap of a piece of stem over the rim, which touches nothing


class Mouth(NamedTuple):
    """A round cup: radii, and heights over the tool point [m]; solid where inner = -outer.

    Of fingers and blades (``within`` above 0), radii are the distances of their inner sides and
    backs from the axis: fruits and stems meet two boxes and the palm's box.
    """

    inner: float
    outer: float
    base: float
    rim: float
    floor: float  # thickness
    neck: float  # radius
    flange: float = 0.0  # radius of the arm's last link, see :func:`flange_of`
    flange_top: float = -1.0  # height of the end of the last link
    end: float = -1.0  # height of the other end of the last link, and of the neck
    cut: float = 0.0  # of blades: from the centre of the target's lower ball to its stem, else 0
    within: float = 0.0  # of fingers and blades: half of their width
    ax: float = 0.0  # of these: the direction of their width, which is across the opening
    ay: float = 0.0
    az: float = 0.0
    palm_x: float = 0.0  # of both: half of the width of the palm across the opening
    palm_y: float = 0.0  # likewise along it
    palm_end: float = 0.0  # height of the palm's back
    rubbing: float = PUSH.swing.friction  # coefficient of friction on fruits
    cone: float = 0.0  # height of the cone under the base, from its edge to the neck; 0: none


class MouthPose(NamedTuple):
    """The tool point (x, y, z) [m] and the axis (u, v, w) out of the mouth."""

    x: float
    y: float
    z: float
    u: float
    v: float
    w: float


@lru_cache(maxsize=32)
def flange_of(robot: Robot) -> tuple[float, float, float]:
    """The arm's last link as a round body behind the tool: radius, and heights of both ends [m].

    Heights are over the tool point. The radius is the median, over the directions around the tool
    axis, of the extent of the body spheres from the axis. The first height is the median of their
    extent along the axis at 0.7 of that radius. The second height is that of the lowest sphere.
    (0, -1, -1) for a link without spheres about the axis.
    """
    spheres = robot.spheres
    last = np.asarray(spheres.segment) == robot.n_segments - 1
    last &= np.asarray(spheres.link) < robot.n_own_links
    center, radius = spheres.center[last] - robot.tool_point, spheres.radius[last]
    height = center @ robot.tool_axis
    aside = center - height[:, None] * robot.tool_axis
    if not (lengths(aside) < radius).any():
        return 0.0, -1.0, -1.0
    angles = np.linspace(0.0, 2.0 * np.pi, 72, endpoint=False)
    across = np.linalg.svd(robot.tool_axis[None])[2][1:]  # two directions across the axis
    toward = np.column_stack([np.cos(angles), np.sin(angles)]) @ across
    along = toward @ aside.T  # (72, k)
    square = radius**2 - (lengths(aside) ** 2 - along**2)
    reach = np.where(square > 0.0, along + np.sqrt(np.maximum(square, 0.0)), 0.0).max(axis=1)
    wide = float(np.median(reach))
    off = np.linalg.norm(0.7 * wide * toward[:, None] - aside, axis=2)
    top = np.where(off < radius, height + np.sqrt(np.maximum(radius**2 - off**2, 0.0)), -np.inf)
    return wide, float(np.median(top.max(axis=1))), float((height - radius).min())


def fits(
    fruit: SceneObject, axes: FloatArray, tool: Tool
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """The room of a fruit in a round mouth that comes along unit vectors ``axes`` (M, 3) [m].

    Returns: (M,) beside the fruit, (M,) from the floor to the fruit whose centre is at the tool
    point, and (M, 3) from its centre to the middle of its outline.
    """
    radius, middle, below = outlines(fruit.shape, axes @ fruit.rotation)
    floor = tool.reach - tool.front - WALL
    return tool.mouth[0] - radius, floor - below, middle @ fruit.rotation.T


@inner
def _box(rho, h, low, high, bottom, top):
    """Signed distance of (rho, h) to a rectangle, and its gradient."""
    x, y = rho - 0.5 * (low + high), h - 0.5 * (bottom + top)
    qx, qy = abs(x) - 0.5 * (high - low), abs(y) - 0.5 * (top - bottom)
    sx, sy = math.copysign(1.0, x), math.copysign(1.0, y)
    if qx > 0.0 and qy > 0.0:
        d = math.sqrt(qx * qx + qy * qy)
        return d, sx * qx / d, sy * qy / d
    if qx > qy:
        return qx, sx, 0.0
    return qy, 0.0, sy


@called
def cup_distance(rho, h, cup):
    """Signed distance to the cup in the half-plane, with d/drho and d/dh."""
    best, g0, g1 = _box(rho, h, cup.inner, cup.outer, cup.base, cup.rim)
    d, e0, e1 = _box(rho, h, -cup.outer, cup.outer, cup.base, cup.base + cup.floor)
    if d < best:
        best, g0, g1 = d, e0, e1
    d, e0, e1 = _box(rho, h, -cup.neck, cup.neck, cup.end, cup.base)
    if d < best:
        best, g0, g1 = d, e0, e1
    if cup.flange > cup.neck:
        d, e0, e1 = _box(rho, h, -cup.flange, cup.flange, cup.end, cup.flange_top)
        if d < best:
            best, g0, g1 = d, e0, e1
    if cup.cone > 0.0 and h < cup.base:  # wall and neck have the ends of the cone's side
        x, y, wide = rho - cup.outer, h - cup.base, cup.outer - cup.neck
        side = math.sqrt(wide * wide + cup.cone * cup.cone)
        e0, e1 = cup.cone / side, -wide / side
        d = x * e0 + y * e1
        if d < best and 0.0 < x * e1 - y * e0 < side:
            best, g0, g1 = d, e0, e1
    return best, g0, g1


@inner
def in_cup(x, y, z, at):
    """Height of a point over the tool point, its distance and its vector from the axis [m]."""
    x, y, z = x - at.x, y - at.y, z - at.z
    h = x * at.u + y * at.v + z * at.w
    x, y, z = x - h * at.u, y - h * at.v, z - h * at.w
    return h, math.sqrt(x * x + y * y + z * z), x, y, z


@called
def fruit_gap(x, y, z, radius, at, cup):
    """Gap of a fruit to the cup, and the direction in which the cup pushes the fruit."""
    h, rho, x, y, z = in_cup(x, y, z, at)
    if cup.within > 0.0:
        return _hand_gap(h, rho, x, y, z, radius, at, cup)
    d, g0, g1 = cup_distance(rho, h, cup)
    out = g0 / rho if rho > 1e-9 else 0.0
    return d - radius, out * x + g1 * at.u, out * y + g1 * at.v, out * z + g1 * at.w


@inner
def _block(x, y, z, a, b, c):
    """Signed distance of a point to a box of half sizes (a, b, c) about the origin, and its
    gradient."""
    px, py, pz = abs(x) - a, abs(y) - b, abs(z) - c
    ox, oy, oz = max(px, 0.0), max(py, 0.0), max(pz, 0.0)
    out = math.sqrt(ox * ox + oy * oy + oz * oz)
    if out > 0.0:
        return (
            out, math.copysign(ox, x) / out, math.copysign(oy, y) / out, math.copysign(oz, z) / out
        )  # fmt: skip
    if px >= py and px >= pz:
        return px, math.copysign(1.0, x), 0.0, 0.0
    if py >= pz:
        return py, 0.0, math.copysign(1.0, y), 0.0
    return pz, 0.0, 0.0, math.copysign(1.0, z)


@inner
def _hand_gap(h, rho, x, y, z, radius, at, cup):
    """:func:`fruit_gap` of fingers, to a ball at the height h and at (x, y, z) from the axis."""
    off = cup.ax * at.u + cup.ay * at.v + cup.az * at.w
    ax, ay, az = cup.ax - off * at.u, cup.ay - off * at.v, cup.az - off * at.w
    long = 1.0 / math.sqrt(ax * ax + ay * ay + az * az)
    ax, ay, az = long * ax, long * ay, long * az
    bx, by, bz = at.v * az - at.w * ay, at.w * ax - at.u * az, at.u * ay - at.v * ax
    p, q = x * ax + y * ay + z * az, x * bx + y * by + z * bz
    thick, deep = 0.5 * (cup.outer - cup.inner), 0.5 * (cup.rim - cup.base)
    d, gp, gq, gh = _block(
        p, abs(q) - cup.inner - thick, h - cup.base - deep, cup.within, thick, deep
    )
    gq = math.copysign(gq, q * gq)
    deep = 0.5 * (cup.base - cup.palm_end)
    e, ep, eq, eh = _block(p, q, h - cup.base + deep, cup.palm_x, cup.palm_y, deep)
    if e < d:
        d, gp, gq, gh = e, ep, eq, eh
    if cup.flange > 0.0:
        e, out, eh = _box(rho, h, -cup.flange, cup.flange, cup.end, cup.flange_top)
        if e < d:
            d, gh, out = e, eh, out / rho if rho > 1e-9 else 0.0
            gp, gq = out * p, out * q
    return (
        d - radius, gp * ax + gq * bx + gh * at.u, gp * ay + gq * by + gh * at.v,
        gp * az + gq * bz + gh * at.w,
    )  # fmt: skip


@called
def stem_gap(x, y, z, radius, within, at, cup):
    """Gap of a piece of stem to the cup's side, and the direction in which it pushes the piece.

    ``within``: whether the fruit is inside the wall, which decides the side: a stem may move
    farther in one step than a wall is thick. A piece over the rim touches nothing: its gap is its
    height over the rim plus :data:`ABOVE`.
    """
    h, rho, x, y, z = in_cup(x, y, z, at)
    if cup.within > 0.0:
        return _hand_gap(h, rho, x, y, z, radius, at, cup)
    if h > cup.rim + 1e-6 or rho < 1e-9:
        return ABOVE + max(h - cup.rim, 0.0), 0.0, 0.0, 0.0
    out = 1.0 / rho
    if h < cup.base - 1e-6:
        wide = cup.neck
        if h > cup.base - cup.cone:
            wide += (cup.outer - cup.neck) * (1.0 - (cup.base - h) / cup.cone)
        gap = rho - wide - radius
    elif within:
        gap, out = cup.inner - rho - radius, -out
    else:
        gap = rho - cup.outer - radius
    return gap, out * x, out * y, out * z


@called
def inside_cup(x, y, z, rx, ry, rz, radius, apart, at, cup):
    """Whether a fruit is inside the cup, or between the fingers; of blades, the fruit or its stem.

    No wall keeps a fruit out of fingers: a ball that reaches in from aside may slip in, and one
    whose centre is ``SWING.barely`` before the tips. Of a stem its line counts.
    """
    if cup.within > 0.0:
        if _within(x, y, z, rx, ry, rz, apart, False, at, cup, SWING.barely, radius):
            return True
        stem, deep = cup.cut > 0.0, SWING.barely
        return stem and _within(x, y, z, rx, ry, rz, apart, stem, at, cup, deep, 0.0)
    return _within(x, y, z, rx, ry, rz, apart, False, at, cup, -SWING.barely, 0.0)


@inner
def _within(x, y, z, rx, ry, rz, apart, stem, at, cup, beyond, aside):
    """Whether the axis of a fruit meets the room in the cup, or in one that is larger.

    The room ends ``beyond`` the rim; between fingers it is wider by ``aside`` on either side [m].
    The axis begins at the lower ball's centre (x, y, z) and leads ``apart`` [m] towards the stem's
    root (rx, ry, rz), with the ``stem`` as far as there. See
    :func:`optipromp.core.robots.tool_protocol.meets`.
    """
    h, _, a, b, c = in_cup(x, y, z, at)
    dh = da = db = dc = 0.0
    if apart > 0.0 or stem:
        rx, ry, rz = rx - x, ry - y, rz - z
        share = 1.0 if stem else apart / math.sqrt(rx * rx + ry * ry + rz * rz)
        dh, _, da, db, dc = in_cup(x + share * rx, y + share * ry, z + share * rz, at)
        dh, da, db, dc = dh - h, da - a, db - b, dc - c
    ends, wide = (cup.base, cup.rim + beyond), cup.within + aside
    return meets(h, a, b, c, dh, da, db, dc, cup.inner, *ends, wide, cup.ax, cup.ay, cup.az)


@called
def taken(x, y, z, rx, ry, rz, apart, at, cup):
    """Whether the target is inside the cup; see :func:`inside_cup`.

    Of blades: whether the line of the stem, from the fruit to the root (rx, ry, rz), is where they
    close, and the fruit is not.
    """
    if cup.cut == 0.0:
        return _within(x, y, z, rx, ry, rz, apart, False, at, cup, -SWING.barely, 0.0)
    top, _, a, b, c = in_cup(rx, ry, rz, at)
    rx, ry, rz = rx - x, ry - y, rz - z
    share = cup.cut / math.sqrt(rx * rx + ry * ry + rz * rz)
    h, _, x, y, z = in_cup(x + share * rx, y + share * ry, z + share * rz, at)
    deep, wide, w = cup.rim - SWING.barely, cup.inner, cup.within
    if meets(h, x, y, z, 0.0, 0.0, 0.0, 0.0, wide, -deep, deep, w, cup.ax, cup.ay, cup.az):
        return False
    top, a, b, c = top - h, a - x, b - y, c - z
    return meets(h, x, y, z, top, a, b, c, wide, -deep, deep, w, cup.ax, cup.ay, cup.az)


@kernel
def steps_inside(positions, points, axes, cup, s):
    """Number of steps (N,) in which each fruit, at ``positions`` (P, N, 3), is inside the cup.

    ``s``: the N stems.
    """
    within = np.zeros(positions.shape[1], dtype=np.int64)
    for p in range(len(points)):
        at = MouthPose(points[p, 0], points[p, 1], points[p, 2], axes[p, 0], axes[p, 1], axes[p, 2])
        for i in range(len(within)):
            x, y, z = positions[p, i, 0], positions[p, i, 1], positions[p, i, 2]
            rx, ry, rz = s.root[i, 0], s.root[i, 1], s.root[i, 2]
            apart = (1.0 - s.upper[i]) * s.length[i]
            within[i] += inside_cup(x, y, z, rx, ry, rz, s.radius[i], apart, at, cup)
    return within


@inner
def _ball(s, f, i, upper):
    """Centre and radius of a ball of fruit i, and the direction of its stem from the root [m]."""
    x, y, z = f.center[i, 0], f.center[i, 1], f.center[i, 2]
    a, b, c = x - s.root[i, 0], y - s.root[i, 1], z - s.root[i, 2]
    far = math.sqrt(a * a + b * b + c * c)
    a, b, c = a / far, b / far, c / far
    if not upper:
        return x, y, z, s.radius[i], a, b, c
    back = (1.0 - s.upper[i]) * s.length[i]
    return x - back * a, y - back * b, z - back * c, s.above[i], a, b, c


@called
def wedged(mass, along, speed, friction):
    """Pull on a fruit along its taut stem, as the cup's blow slides it aside [N].

    The fruit cannot move along its stem. Along the contact's normal n, whose cosine with the stem
    is ``along`` = n·s = cos α, it weighs m / (sin α (sin α − μ cos α)), and a contact of stiffness
    k that meets it at a ``speed`` v along n [m/s] presses with N = v √(k m / (sin α (sin α − μ
    cos α))), which pulls the stem with N (cos α + μ sin α) + m g. ``friction`` is μ. Where
    tan α ≤ μ the fruit jams: the pull is infinite. Derivation: docs/concepts.md.
    """
    across = math.sqrt(max(1.0 - along * along, 0.0))
    slides = across * (across - friction * along)
    if slides <= 0.0:
        return np.inf
    force = speed * math.sqrt(SWING.stiffness * mass / slides)
    return force * (along + friction * across) + mass * PUSH.beam.gravity


@inner
def pull_on(s, f, step, speed, pulls):
    """Update the largest pull (N,) of a cup that leaves on each fruit, away from its root [N].

    ``s``: the N stems. ``f``: the fruits after the ``step``. ``speed``: of the cup [m/s]; 0: not
    known. A pull is the force on a ball of the fruit, along the stem, or that of :func:`wedged`, if
    the speed is known and that is larger.
    """
    at, shift, cup = step.at, step.shift, step.cup
    far = math.sqrt(shift.x * shift.x + shift.y * shift.y + shift.z * shift.z)
    rate = speed / max(far, 1e-9)
    for i in range(len(s.root)):
        for upper in range(2 if s.upper[i] < 1.0 else 1):
            x, y, z, radius, a, b, c = _ball(s, f, i, upper)
            gap, n0, n1, n2 = fruit_gap(x, y, z, radius, at, cup)
            along = n0 * a + n1 * b + n2 * c
            if gap <= TOUCHES and along > 0.0:
                pulls[i] = max(pulls[i], f.force[i] * along)
                met = rate * (shift.x * n0 + shift.y * n1 + shift.z * n2)
                if met > 0.0:
                    pulls[i] = max(pulls[i], wedged(s.mass[i], along, met, cup.rubbing))
