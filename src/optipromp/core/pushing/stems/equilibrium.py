r"""The equilibrium of stems and their fruits after one step of the cup.

Each fruit takes the deflections u of its stem (:mod:`.bending`) that minimise

.. math:: \tfrac12 (u - u_0)^T K (u - u_0) + \tfrac{m}{2\,dt^2}\|u_L - \hat u_L\|^2
          + \tfrac{k_c}{2}\sum_j \max(0, -g_j(u))^2

by Gauss-Newton steps from the last equilibrium. The terms are the stem's energy about its bow
:math:`u_0`, the fruit's inertia (an implicit Euler step; :math:`\hat u_L` is where the fruit would
swing to without a contact) and the contacts with their gaps g
(:mod:`optipromp.core.pushing.stems.contacts`). Coulomb friction is a spring against the slip of the
step, as stiff as the contact force allows. Between cup and stem only the slip across the cup's axis
counts: with the slip along the axis the model presses stems too hard.
"""

import math
from typing import NamedTuple

from optipromp.core.compiled import inlined, inner
from optipromp.core.geometry.obstacles import Obstacles
from optipromp.core.pushing.parameters import PUSH
from optipromp.core.pushing.stems.bending import Stems
from optipromp.core.pushing.stems.contacts import (
    AT_BASE,
    ON_CUP,
    ON_STEM,
    ON_WALL,
    STEM_ON_CUP,
    STEM_ON_FRUIT,
    Contacts,
    Fruits,
    between,
    hang,
    on_cup,
    on_wall,
    piece,
    under_fruit,
)
from optipromp.core.pushing.stems.cup import ABOVE, Mouth, MouthPose, in_cup, stem_gap
from optipromp.core.pushing.stems.deflected import (
    LOADS,
    Descent,
    begin,
    level,
    place,
    press,
    shortened,
)

CONTACT, CLOSE = PUSH.swing.stiffness, PUSH.swing.close
RUBBING, STUCK = PUSH.swing.friction, PUSH.swing.stuck
SKIN_FRICTION, STEM_FRICTION = PUSH.swing.skin_friction, PUSH.swing.stem_friction
FARTHEST, REVERSAL = PUSH.swing.farthest, PUSH.swing.reversal


class CupStep(NamedTuple):
    """One step of the cup."""

    cup: Mouth
    at: MouthPose
    shift: MouthPose  # motion of the tool point in this step (x, y, z) [m]
    point: int  # of the path, from 0


@inlined
def relax(
    s: Stems, f: Fruits, c: Contacts, d: Descent, step: CupStep, solid: Obstacles, look: bool
) -> tuple[float, bool]:
    """One Gauss-Newton step of every fruit that is touched.

    ``s``: the N stems. ``f``: the fruits, in and out. ``c``: the contacts, in and out. ``d``: the
    iteration so far, in and out. ``step``: of the cup. ``solid``: static objects that fruits are
    pressed against. ``look``: whether all possible contacts are computed, not only the close ones.

    Returns:
        The largest change of a deflection [m], and whether a fruit was touched for the first time.
    """
    at, cup, n = step.at, step.cup, s.shape.shape[1] - 1
    moved, woken = 0.0, False
    for i in range(len(s.length)):
        begun = not f.resting[i]
        if begun:
            begin(s, f.u, f.ahead, i, d)
        f.pressed[i], f.firmly[i] = 0.0, False
        largest = t0 = t1 = t2 = 0.0
        last = under_fruit(s, i)
        h, rho, _, _, _ = in_cup(f.center[i, 0], f.center[i, 1], f.center[i, 2], at)
        within = h > cup.base and rho < cup.inner
        close, clear = 0, 0  # number of close contacts; no piece before ``clear`` is close
        for k in range(c.possible[i] if look else c.closes[i]):
            number = k if look else c.close[i, k]
            kind, other, share = c.kind[i, number], c.other[i, number], 1.0
            if kind == ON_CUP:
                gap, n0, n1, n2, share = on_cup(s, f, i, at, cup)
            elif kind == STEM_ON_CUP:
                share = piece(s, c, i, other)
                if look and (share == 0.0 or share > last or other < clear):
                    continue
                x, y, z = place(s, f.u, i, s.length[i] - f.up[i], share)
                gap, n0, n1, n2 = stem_gap(x, y, z, s.thickness[i], within, at, cup)
                if look and other > AT_BASE:
                    away = gap - cup.outer + cup.neck if gap < ABOVE else gap - ABOVE
                    clear = other + int((away - CLOSE) * n / s.length[i])
            elif kind == ON_WALL:
                if f.resting[i] and step.point > 0:
                    continue
                gap, n0, n1, n2, share = on_wall(s, f, i, solid, other)
            else:
                gap, n0, n1, n2, share = between(s, f, c.overlap, i, kind, other)
            if look and gap < CLOSE:
                c.close[i, close] = number
                close += 1
            if gap >= 0.0:
                continue
            if not begun:
                begun, woken, f.resting[i] = True, True, False
                begin(s, f.u, f.ahead, i, d)
            hard = -gap * CONTACT
            press(s, f.u, i, share, (n0, n1, n2), -gap, CONTACT, d)
            if kind == STEM_ON_CUP:
                t0, t1, t2 = t0 + hard * n0, t1 + hard * n1, t2 + hard * n2
            elif kind != STEM_ON_FRUIT:
                largest = max(largest, hard)
            if kind == ON_WALL:  # without friction
                f.firmly[i] = True
                continue
            most = SKIN_FRICTION * hard
            if kind == ON_CUP:
                most, f.pressed[i] = RUBBING * f.earlier[i], hard
            elif kind == STEM_ON_CUP:
                most = STEM_FRICTION * hard
            if most > 0.0:
                slip = _slip(s, f, step, i, kind, other, share)
                _rub(s, f, i, share, slip, (n0, n1, n2), most, d)
        if look:
            c.closes[i] = close
        f.force[i], f.on_stem[i] = largest, math.sqrt(t0 * t0 + t1 * t1 + t2 * t2)
        if begun:
            moved = max(moved, _step(s, f, i, d))
    return moved, woken


@inner
def _slip(
    s: Stems, f: Fruits, step: CupStep, i: int, kind: int, o: int, share: float
) -> tuple[float, float, float]:
    """Slip (x, y, z) of this step between fruit or stem i and its partner [m]."""
    at, shift, chord = step.at, step.shift, s.length[i] - f.up[i]
    d0 = d1 = d2 = 0.0  # drift of the root of i, and of that of its partner backwards
    if s.drift.shape[1]:
        now, last = s.drift[:, step.point], s.drift[:, max(step.point - 1, 0)]
        back = 0.0 if kind in (ON_CUP, STEM_ON_CUP) else 1.0
        d0 = now[i, 0] - last[i, 0] - back * (now[o, 0] - last[o, 0])
        d1 = now[i, 1] - last[i, 1] - back * (now[o, 1] - last[o, 1])
        d2 = now[i, 2] - last[i, 2] - back * (now[o, 2] - last[o, 2])
        shift = MouthPose(shift.x - d0, shift.y - d1, shift.z - d2, 0.0, 0.0, 0.0)
    x0, x1, x2 = f.center[i, 0], f.center[i, 1], f.center[i, 2]
    a0, a1, a2 = f.began[i, 0], f.began[i, 1], f.began[i, 2]
    if kind in (STEM_ON_FRUIT, STEM_ON_CUP):
        x0, x1, x2 = place(s, f.u, i, chord, share)
        a0, a1, a2 = place(s, f.before, i, chord, share)
    if kind == STEM_ON_CUP:
        x0, x1, x2 = x0 - a0 - shift.x, x1 - a1 - shift.y, x2 - a2 - shift.z
        along = x0 * at.u + x1 * at.v + x2 * at.w
        return x0 - along * at.u, x1 - along * at.v, x2 - along * at.w
    if kind == ON_CUP:
        x0, x1, x2 = x0 - a0, x1 - a1, x2 - a2
        if share < 1.0:  # the upper ball: add its motion relative to the lower ball
            for sign, part, u in (
                (1.0, share, f.u),
                (-1.0, 1.0, f.u),
                (-1.0, share, f.before),
                (1.0, 1.0, f.before),
            ):
                a0, a1, a2 = place(s, u, i, chord, part)
                x0, x1, x2 = x0 + sign * a0, x1 + sign * a1, x2 + sign * a2
        return x0 - shift.x, x1 - shift.y, x2 - shift.z
    y0, y1, y2 = f.center[o, 0], f.center[o, 1], f.center[o, 2]
    b0, b1, b2 = f.began[o, 0], f.began[o, 1], f.began[o, 2]
    if kind == ON_STEM:
        along = level(s, o, x0, x1, x2)
        y0, y1, y2 = place(s, f.u, o, s.length[o] - f.up[o], along)
        b0, b1, b2 = place(s, f.before, o, s.length[o] - f.up[o], along)
    return x0 - a0 - y0 + b0 + d0, x1 - a1 - y1 + b1 + d1, x2 - a2 - y2 + b2 + d2


@inlined
def _rub(
    s: Stems, f: Fruits, i: int, share: float, slip: tuple[float, float, float],
    way: tuple[float, float, float], most: float, d: Descent,
) -> None:  # fmt: skip
    """Friction of at most ``most`` [N] on a share of stem i, against the slip across ``way``."""
    (x, y, z), (n0, n1, n2) = slip, way
    along = x * n0 + y * n1 + z * n2
    x, y, z = x - along * n0, y - along * n1, z - along * n2
    far = math.sqrt(x * x + y * y + z * z)
    if far > 1e-7:
        back = -x / far, -y / far, -z / far
        press(s, f.u, i, share, back, far, most / max(far, STUCK), d)


@inlined
def _step(s: Stems, f: Fruits, i: int, d: Descent) -> float:
    """Step stem i to the minimum of the quadratic model; returns the largest deflection change [m].

    No loaded point moves farther than :data:`FARTHEST`. A step back by more than the share
    :data:`REVERSAL` of the last step would go on for ever: it and all later steps are halved.
    """
    change, last = d.v, d.last
    far = back = before = 0.0
    for a in range(2 * LOADS):
        change[a] = 0.0
        for b in range(2 * LOADS):
            change[a] += d.inverse[a, b] * d.gradient[b]
        back -= change[a] * last[i, a]
        before += last[i, a] ** 2
    for a in range(LOADS):
        far = max(far, math.hypot(change[a], change[LOADS + a]))
    if back > REVERSAL * before:
        d.eased[i] *= 0.5
    scale: float = min(d.eased[i], FARTHEST / max(far, 1e-12))
    for a in range(2 * LOADS):
        last[i, a] = scale * change[a]
        f.u[i, a] -= last[i, a]
    f.up[i] = shortened(s, f.u, i) - s.lifted[i]
    hang(s, f, i)
    return far * scale
