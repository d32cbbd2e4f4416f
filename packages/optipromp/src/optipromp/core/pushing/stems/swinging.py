r"""Push prediction for fruits on stems, step by step along the path of a cup.

At every step all fruits come to the equilibrium of their stems, their inertia and their contacts.
The harm along the path is recorded.

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

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from optipromp.core.arrays import FloatArray
from optipromp.core.compiled import called, inlined, inner, kernel
from optipromp.core.geometry.obstacles import Obstacles
from optipromp.core.pushing.parameters import PUSH
from optipromp.core.pushing.stems import contacts, kept_states
from optipromp.core.pushing.stems.bending import Stems
from optipromp.core.pushing.stems.cup import (
    ABOVE,
    Mouth,
    MouthPose,
    in_cup,
    inside_cup,
    pull_on,
    stem_gap,
    taken,
)

SWING, HARM = PUSH.swing, PUSH.harm


class Harm(NamedTuple):
    """The predicted harm of a path. The first fruit is the target.

    Attributes:
        stem: largest lasting force of the cup on a stem [N].
        fruit: largest force on another fruit than the target [N].
        target: largest lasting force on the target [N].
        inside: longest time of another fruit inside the cup [s].
        pinched: time in which the cup presses another fruit against a static object [s].
        missed: whether the target is outside the cup at the end.
    """

    stem: float
    fruit: float
    target: float
    inside: float
    pinched: float
    missed: bool


@called
def score_of(stem, fruit, target, inside, pinched, missed):
    """The score of a :class:`Harm`: the sum of its parts.

    A part is 1 where a force reaches what a fruit bears, or a fruit is pinched for
    ``pinched_time``. A momentary force up to ``sudden_force`` counts nothing. A swallowed neighbour
    and a missed target add ``HARM.swallowed`` each.
    """
    lost = HARM.swallowed * (inside > HARM.inside_time) + HARM.swallowed * missed
    crushed = max(fruit - HARM.sudden_force, 0.0) / (HARM.fruit_force - HARM.sudden_force)
    pressed = stem / HARM.stem_force + crushed + target / HARM.target_force
    return pressed + pinched / HARM.pinched_time + lost


NEVER = 1 << 40  # the first step of the way out, of a motion that has none


class CupStep(NamedTuple):
    """One step of the cup."""

    cup: Mouth
    at: MouthPose
    shift: MouthPose  # motion of the tool point in this step (x, y, z) [m]
    point: int  # of the path, from 0


@inlined
def relax(s, f, c, d, step, solid, look):
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
            contacts.begin(s, f.u, f.ahead, i, d)
        f.pressed[i], f.firmly[i] = 0.0, False
        largest = t0 = t1 = t2 = 0.0
        last = contacts.under_fruit(s, i)
        h, rho, _, _, _ = in_cup(f.center[i, 0], f.center[i, 1], f.center[i, 2], at)
        within = h > cup.base and rho < cup.inner
        close, clear = 0, 0  # number of close contacts; no piece before ``clear`` is close
        for k in range(c.possible[i] if look else c.closes[i]):
            number = k if look else c.close[i, k]
            kind, other, share = c.kind[i, number], c.other[i, number], 1.0
            if kind == contacts.ON_CUP:
                gap, n0, n1, n2, share = contacts.on_cup(s, f, i, at, cup)
            elif kind == contacts.STEM_ON_CUP:
                share = 0.0 if look and other < clear else contacts.piece(s, c, i, other)
                if look and (share == 0.0 or share > last):
                    continue
                x, y, z = contacts.place(s, f.u, i, s.length[i] - f.up[i], share)
                gap, n0, n1, n2 = stem_gap(x, y, z, s.thickness[i], within, at, cup)
                if look and other > contacts.AT_BASE:
                    away = gap - max(cup.outer - cup.neck, 0.0) if gap < ABOVE else gap - ABOVE
                    clear = other + int((away - SWING.close) * n / s.length[i])
            elif kind == contacts.ON_WALL:
                if f.resting[i] and step.point > 0:
                    continue
                gap, n0, n1, n2, share = contacts.on_wall(s, f, i, solid, other)
            else:
                gap, n0, n1, n2, share = contacts.between(s, f, c.overlap, i, kind, other)
            if look and gap < SWING.close:
                c.close[i, close] = number
                close += 1
            if gap >= 0.0:
                continue
            if not begun:
                begun, woken, f.resting[i] = True, True, False
                contacts.begin(s, f.u, f.ahead, i, d)
            hard = -gap * SWING.stiffness
            contacts.press(s, f.u, i, share, (n0, n1, n2), -gap, SWING.stiffness, d)
            if kind == contacts.STEM_ON_CUP:
                t0, t1, t2 = t0 + hard * n0, t1 + hard * n1, t2 + hard * n2
            elif kind != contacts.STEM_ON_FRUIT:
                largest = max(largest, hard)
            if kind == contacts.ON_WALL:  # without friction
                f.firmly[i] = True
                continue
            most = SWING.skin_friction * hard
            if kind == contacts.ON_CUP:
                most, f.pressed[i] = cup.rubbing * f.earlier[i], hard
            elif kind == contacts.STEM_ON_CUP:
                most = SWING.stem_friction * hard
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
def _slip(s, f, step, i, kind, o, share):
    """Slip (x, y, z) of this step between fruit or stem i and its partner [m]."""
    at, shift, chord = step.at, step.shift, s.length[i] - f.up[i]
    d0 = d1 = d2 = 0.0  # drift of the root of i, and of that of its partner backwards
    if s.drift.shape[1]:
        now, last = s.drift[:, step.point], s.drift[:, max(step.point - 1, 0)]
        d0, d1, d2 = now[i, 0] - last[i, 0], now[i, 1] - last[i, 1], now[i, 2] - last[i, 2]
        if kind not in (contacts.ON_CUP, contacts.STEM_ON_CUP):  # the partner ``o`` is a fruit
            d0, d1 = d0 - (now[o, 0] - last[o, 0]), d1 - (now[o, 1] - last[o, 1])
            d2 -= now[o, 2] - last[o, 2]
        shift = MouthPose(shift.x - d0, shift.y - d1, shift.z - d2, 0.0, 0.0, 0.0)
    x0, x1, x2 = f.center[i, 0], f.center[i, 1], f.center[i, 2]
    a0, a1, a2 = f.began[i, 0], f.began[i, 1], f.began[i, 2]
    if kind in (contacts.STEM_ON_FRUIT, contacts.STEM_ON_CUP):
        x0, x1, x2 = contacts.place(s, f.u, i, chord, share)
        a0, a1, a2 = contacts.place(s, f.before, i, chord, share)
    if kind == contacts.STEM_ON_CUP:
        x0, x1, x2 = x0 - a0 - shift.x, x1 - a1 - shift.y, x2 - a2 - shift.z
        along = x0 * at.u + x1 * at.v + x2 * at.w
        return x0 - along * at.u, x1 - along * at.v, x2 - along * at.w
    if kind == contacts.ON_CUP:
        x0, x1, x2 = x0 - a0, x1 - a1, x2 - a2
        if share < 1.0:  # the upper ball: add its motion relative to the lower ball
            for sign, part, u in (
                (1.0, share, f.u),
                (-1.0, 1.0, f.u),
                (-1.0, share, f.before),
                (1.0, 1.0, f.before),
            ):
                a0, a1, a2 = contacts.place(s, u, i, chord, part)
                x0, x1, x2 = x0 + sign * a0, x1 + sign * a1, x2 + sign * a2
        return x0 - shift.x, x1 - shift.y, x2 - shift.z
    y0, y1, y2 = f.center[o, 0], f.center[o, 1], f.center[o, 2]
    b0, b1, b2 = f.began[o, 0], f.began[o, 1], f.began[o, 2]
    if kind == contacts.ON_STEM:
        along = contacts.level_place(s, o, x0, x1, x2)
        y0, y1, y2 = contacts.place(s, f.u, o, s.length[o] - f.up[o], along)
        b0, b1, b2 = contacts.place(s, f.before, o, s.length[o] - f.up[o], along)
    return x0 - a0 - y0 + b0 + d0, x1 - a1 - y1 + b1 + d1, x2 - a2 - y2 + b2 + d2


@inlined
def _rub(s, f, i, share, slip, way, most, d):
    """Friction of at most ``most`` [N] on a share of stem i, against the slip across ``way``."""
    (x, y, z), (n0, n1, n2) = slip, way
    along = x * n0 + y * n1 + z * n2
    x, y, z = x - along * n0, y - along * n1, z - along * n2
    far = math.sqrt(x * x + y * y + z * z)
    if far > 1e-7:
        back = -x / far, -y / far, -z / far
        contacts.press(s, f.u, i, share, back, far, most / max(far, SWING.stuck), d)


@inlined
def _step(s, f, i, d):
    """Step stem i to the minimum of the quadratic model; returns the largest deflection change [m].

    No loaded point moves farther than ``SWING.farthest``. A step back by more than the share
    ``SWING.reversal`` of the last step would go on for ever: it and all later steps are halved.
    """
    change, last = d.v, d.last
    square, most = 0.0, 0  # of the loaded point that moves farthest
    back = before = 0.0
    for a in range(2 * contacts.LOADS):
        change[a] = 0.0
        for b in range(2 * contacts.LOADS):
            change[a] += d.inverse[a, b] * d.gradient[b]
        back -= change[a] * last[i, a]
        before += last[i, a] ** 2
    for a in range(contacts.LOADS):
        across = change[a] ** 2 + change[contacts.LOADS + a] ** 2
        if across > square:
            square, most = across, a
    far = math.hypot(change[most], change[contacts.LOADS + most])
    if back > SWING.reversal * before:
        d.eased[i] *= 0.5
    scale: float = min(d.eased[i], SWING.farthest / max(far, 1e-12))
    for a in range(2 * contacts.LOADS):
        last[i, a] = scale * change[a]
        f.u[i, a] -= last[i, a]
    f.up[i] = contacts.shortened(s, f.u, i) - s.lifted[i]
    contacts.hang(s, f, i)
    return far * scale


@kernel
def push(
    s, points, axes, dt, cup, solid, worst, positions, forces, stem_forces, so_far, pulls, leaves,
    speed, begin, kept,
):  # fmt: skip
    """Lead the cup along a path.

    ``s``: the N stems. ``points``: (P, 3) of the tool point; ``axes`` (P, 3) out of the mouth.
    ``dt``: between points [s]. ``cup``: its shape. ``solid``: static objects that fruits are
    pressed against; stems pass through them. ``worst``: score
    (:func:`score_of`) above which the push ends. ``positions``:
    (P, N, 3) out, of the fruits [m]. ``forces``: (P, N) out, largest contact force on each fruit
    [N]. ``stem_forces``: (P, N) out, of the cup on each stem [N]. ``so_far``: (5,) in and out, the
    numbers of :class:`Harm`. ``pulls``: (N,) in and out [N], see :func:`.cup.pull_on`. ``leaves``:
    first step of the way out, on which the cup has that ``speed`` [m/s], pulls count, and the first
    fruit is as any other. ``begin``: number of points that the cup was led through before; 0 for
    a push that begins. ``kept``: (N, :func:`.kept_states.width`) in and out, what a push goes on
    from, whose points before are the last ``begin``; (0, 0) for a push that does not go on.
    Drifting roots are not kept.

    Returns: Number of points that the cup was led through.
    """
    count, n, dofs = len(s.root), s.shape.shape[1] - 1, 2 * contacts.LOADS
    most = 1 + 3 * (count - 1) + len(solid.kind) + n + 3  # contacts of a fruit and its stem
    f = contacts.Fruits(
        s.rest.copy(), s.rest.copy(), s.rest.copy(), np.zeros(count),
        np.zeros((count, 3)), np.zeros((count, 3)), np.ones(count, dtype=np.bool_),
        np.zeros(count), np.zeros(count), np.zeros(count, dtype=np.bool_), np.zeros(count),
        np.zeros(count),
    )  # fmt: skip
    c = contacts.Contacts(
        np.zeros((count, most), dtype=np.int64), np.zeros((count, most), dtype=np.int64),
        np.zeros(count, dtype=np.int64), np.zeros((count, most), dtype=np.int64),
        np.zeros(count, dtype=np.int64), np.zeros((count, count, 2), dtype=np.bool_),
        np.zeros(count, dtype=np.int64), np.full((count, 3), np.inf), np.zeros(count),
        np.zeros(count), np.zeros(count, dtype=np.int64),
    )  # fmt: skip
    d = contacts.Descent(
        s.mass / (dt * dt), np.zeros((count, contacts.LOADS, contacts.LOADS)), np.zeros(dofs),
        np.zeros((dofs, dofs)), np.zeros(dofs), np.zeros(dofs), np.zeros(count),
        np.zeros((count, dofs)),
    )  # fmt: skip
    pinched, spell = np.zeros(count, dtype=np.int64), np.zeros(count, dtype=np.int64)
    fixed, held, load = s.root, s.root.copy(), np.zeros((s.joint.shape[1], 3))
    s = Stems(
        fixed.copy(), s.axes, s.length, s.mass, s.radius, s.thickness, s.upper, s.above, s.shape,
        s.stiffness, s.compliance, s.shortening, s.joint, s.rest, s.lifted, s.drift,
    )  # fmt: skip
    _drift(s, f, fixed, held, 0)
    contacts.overlapping(s, f.u, c.overlap)
    contacts.list_fruits(c)
    for i in range(count):
        contacts.hang(s, f, i)
        contacts.freely(s, i, d)
    if begin:
        kept_states.resume(
            s, f, c, solid, spell, pinched, positions, forces, stem_forces, so_far, begin, kept
        )
        if _so_far(so_far, pulls, begin > leaves, False) > worst:
            return begin
    for p in range(begin, len(points)):
        at = MouthPose(points[p, 0], points[p, 1], points[p, 2], axes[p, 0], axes[p, 1], axes[p, 2])
        _drift(s, f, fixed, held, p)
        if p > 0 and _untouched(s, f, at, cup):
            positions[p] = f.center
            continue
        q = max(p - 1, 0)
        x, y, z = at.x - points[q, 0], at.y - points[q, 1], at.z - points[q, 2]
        step = CupStep(cup, at, MouthPose(x, y, z, 0.0, 0.0, 0.0), p)
        _follow_truss(s, f, held, load)
        _advance(s, f, c, d, step, solid)
        positions[p] = f.center
        _take(s, f, at, cup, dt, p, p >= leaves, forces, stem_forces, spell, pinched, so_far)
        if p >= leaves:
            pull_on(s, f, step, speed, pulls)
        if _so_far(so_far, pulls, p >= leaves, False) > worst:
            return p + 1
    if len(kept):
        kept_states.keep(s, f, c, spell, pinched, forces, stem_forces, so_far, begin, kept)
    return len(points)


@inner
def _so_far(h, pulls, out, missed):
    """The score of numbers (5,) of :class:`Harm`; ``out``: on the way out, with its pulls (N,)."""
    if not out:
        return score_of(h[0], h[1], h[2], h[3], h[4], missed)
    most = 0.0
    for pull in pulls:
        most = max(most, pull)
    return score_of(h[0], h[1], 0.0, h[3], h[4], False) + most / HARM.pull


@inner
def _drift(s, f, fixed, held, p):
    """Move the roots from where they are ``fixed`` (N, 3) to where they are ``held`` at point p.

    A fruit whose root has moved no longer rests.
    """
    for i in range(len(held) if s.drift.shape[1] else 0):
        for k in range(3):
            held[i, k] = fixed[i, k] + s.drift[i, p, k]
            f.resting[i] &= s.drift[i, p, k] == s.drift[i, 0, k]
            s.root[i, k] = held[i, k]
        contacts.hang(s, f, i)


@inner
def _follow_truss(s, f, held, load):
    """Move the stems of a truss by the forces on the other fruits after the last step.

    ``held`` (N, 3) are the roots before any contact [m], ``load`` (N, 3) is scratch for the forces;
    (0, 3) without a truss.
    """
    for i in range(len(load)):
        for k in range(3):
            load[i, k] = 0.0
        for a in range(contacts.LOADS):
            f1 = f2 = 0.0
            for b in range(contacts.LOADS):
                f1 += s.stiffness[i, a, b] * (f.u[i, b] - s.rest[i, b])
                f2 += s.stiffness[i, a, b] * (
                    f.u[i, contacts.LOADS + b] - s.rest[i, contacts.LOADS + b]
                )
            for k in range(3):
                load[i, k] += f1 * s.axes[i, 0, k] + f2 * s.axes[i, 1, k]
    for i in range(len(load)):
        for k in range(3):
            s.root[i, k] = held[i, k]
            for o in range(len(load)):
                for m in range(3):
                    s.root[i, k] += s.joint[i, o, k, m] * load[o, m]
        contacts.hang(s, f, i)


@inner
def _untouched(s, f, at, cup):
    """Whether all fruits rest, and the rim is below all fruits and roots."""
    for i in range(len(s.root)):
        h, _, _, _, _ = in_cup(f.center[i, 0], f.center[i, 1], f.center[i, 2], at)
        above, _, _, _, _ = in_cup(s.root[i, 0], s.root[i, 1], s.root[i, 2], at)
        if not (f.resting[i] and min(h - s.radius[i], above) > cup.rim + SWING.close):
            return False
    return True


@kernel
def clear(s, points, axes, cup):
    """Whether the cup, led through points (P, 3), stays away from all fruits and stems at rest.

    Roots that drift do so without a swing.

    Fruit and stem are clear before the rim, behind the end of the last link, or aside of both.
    """
    palm = math.hypot(cup.palm_x, cup.palm_y)
    e, wide = s.axes, max(cup.outer, cup.neck, cup.flange, palm) + SWING.close
    for p in range(len(points)):
        at = MouthPose(points[p, 0], points[p, 1], points[p, 2], axes[p, 0], axes[p, 1], axes[p, 2])
        for i in range(len(s.root)):
            x, y, z, far = s.root[i, 0], s.root[i, 1], s.root[i, 2], s.length[i]
            if s.drift.shape[1]:
                x, y, z = x + s.drift[i, p, 0], y + s.drift[i, p, 1], z + s.drift[i, p, 2]
            above, _, a, b, c = in_cup(x, y, z, at)
            x, y, z = x + far * e[i, 2, 0], y + far * e[i, 2, 1], z + far * e[i, 2, 2]
            h, _, u, v, w = in_cup(x, y, z, at)
            thick = max(s.radius[i], s.above[i])
            low, high = min(h, above) - thick, max(h, above) + thick
            if low > cup.rim + SWING.close or high < cup.end - SWING.close:
                continue
            a, b, c = a - u, b - v, c - w  # across the cup's axis, from the fruit to the root
            along = a * a + b * b + c * c
            k = -(a * u + b * v + c * w) / along if along > 0.0 else 0.0
            k = min(max(k, 0.0), 1.0)
            u, v, w = u + k * a, v + k * b, w + k * c
            if math.sqrt(u * u + v * v + w * w) < wide + thick:
                return False
    return True


@inlined
def _advance(s, f, c, d, step, solid):
    """Let the fruits swing on, then bring them to their equilibrium with the cup of this step."""
    for i in range(len(f.up)):
        for k in range(3):
            f.began[i, k] = f.center[i, k]
        for a in range(2 * contacts.LOADS):
            f.ahead[i, a] = f.u[i, a] + SWING.kept_speed * (f.u[i, a] - f.before[i, a])
            f.before[i, a] = f.u[i, a]
            d.last[i, a] = 0.0
        f.earlier[i], d.eased[i] = f.pressed[i], 1.0
    contacts.list_walls(s, f.center, c, solid)
    contacts.list_pieces(s, c, step.at, step.cup)
    stirred = np.inf
    for _ in range(SWING.iterations):
        look = stirred > SWING.stirred
        if look:
            stirred = 0.0
        moved, woken = relax(s, f, c, d, step, solid, look)
        stirred += np.inf if woken else moved
        if moved < SWING.settled:
            break


@inner
def _take(s, f, at, cup, dt, p, out, forces, stem_forces, spell, pinched, so_far):
    """Update the harm ``so_far`` (5,) by step p; ``out``: on the way out.

    ``spell`` (N,) counts the steps since which each fruit has been inside, ``pinched`` (N,) the
    steps in which the cup pressed it against a static object.
    """
    held = math.ceil(HARM.lasting / dt)  # steps
    for i in range(len(f.up)):
        forces[p, i], stem_forces[p, i] = f.force[i], f.on_stem[i]
        lasting = lasting_on_fruit = np.inf if p >= held - 1 else 0.0
        for q in range(max(p - held + 1, 0), p + 1):
            lasting = min(lasting, stem_forces[q, i])
            lasting_on_fruit = min(lasting_on_fruit, forces[q, i])
        so_far[0] = max(so_far[0], lasting)
        if i > 0 or out:
            so_far[1] = max(so_far[1], forces[p, i])
        if i == 0:
            so_far[2] = max(so_far[2], lasting_on_fruit)
            continue
        x, y, z = f.center[i, 0], f.center[i, 1], f.center[i, 2]
        rx, ry, rz = s.root[i, 0], s.root[i, 1], s.root[i, 2]
        apart = (1.0 - s.upper[i]) * s.length[i]
        swallowed = inside_cup(x, y, z, rx, ry, rz, s.radius[i], apart, at, cup)
        spell[i] = spell[i] + 1 if swallowed else 0
        so_far[3] = max(so_far[3], spell[i] * dt)
        if f.firmly[i] and f.pressed[i] > 0.0:
            pinched[i] += 1
            so_far[4] = max(so_far[4], pinched[i] * dt)


class Led(NamedTuple):
    """Effect of a cup, led along a path, on N fruits."""

    harm: Harm
    positions: FloatArray  # (P, N, 3) of the fruits after each step [m]
    on_fruits: FloatArray  # (N,) largest force on each fruit [N]
    on_stems: FloatArray  # (N,) largest lasting force (least within HARM.lasting) on each stem [N]
    pulls: FloatArray  # (N,) largest pull on each fruit on the way out [N]


def led(
    s: Stems, points: FloatArray, axes: FloatArray, dt: float, cup: Mouth, solid: Obstacles,
    leaves: int = NEVER, speed: float = 0.0, begin: int = 0,
    kept: FloatArray = kept_states.NOT_KEPT,
) -> Led:  # fmt: skip
    """Effect of the cup along a path (arguments of :func:`push`); the first fruit is the target.

    ``leaves``: first step of the way out, on which the cup has that ``speed`` [m/s]. Of a push that
    goes on, forces are those of the last steps.
    """
    steps, count = len(points), len(s.root)
    positions, so_far = np.zeros((steps, count, 3)), np.zeros(5)
    forces, stem_forces = np.zeros((steps, count)), np.zeros((steps, count))
    pulls = np.zeros(count)
    push(
        s, points, axes, dt, cup, solid, np.inf, positions, forces, stem_forces, so_far, pulls,
        leaves, speed, begin, kept.copy(),
    )  # fmt: skip
    x, y, z = positions[-1, 0]
    end = MouthPose(*points[-1], *axes[-1])
    rx, ry, rz = s.root[0]
    apart = (1.0 - s.upper[0]) * s.length[0]
    missed = cup.inner > 0.0 and not taken(x, y, z, rx, ry, rz, apart, end, cup)
    stem, fruit, target, within, pinched = so_far.tolist()
    if leaves < steps:
        target, missed = 0.0, False
    held = sliding_window_view(stem_forces, min(math.ceil(HARM.lasting / dt), steps), axis=0)
    return Led(
        Harm(stem, fruit, target, within, pinched, missed),
        positions,
        forces.max(axis=0),
        held.min(axis=-1).max(axis=0),
        pulls,
    )


@kernel
def summed_score(
    s, count, states, points, axes, dt, cup, solid, hopeless, worst, seen, leaves, speed, total,
    begin, kept, keep,
):  # fmt: skip
    """Sum of the scores of a path over sampled states of the same fruits.

    ``s``: the stems, one state after the other. ``states``: the first state of the sum, and the
    last plus one. ``points``: see :func:`push`, as for the arguments up to ``solid``. ``hopeless``:
    largest score of a single state. ``worst``: largest sum of interest; a larger sum may be
    returned as any number above it. ``seen``: whether the first state is the perceived one; a
    hopeless perceived state ends the sum. ``leaves``: first step of the way out, on which a pull
    counts (:func:`.cup.pull_on`) and the cup has that ``speed`` [m/s]. ``total``: the sum over the
    states before. ``begin``, ``kept``: see :func:`push`, the latter for each state, or (0, 0, 0).
    """
    steps = len(points)
    positions, forces = np.zeros((steps, count, 3)), np.zeros((steps, count))
    stem_forces, h, pulls = np.zeros((steps, count)), np.zeros(5), np.zeros(count)
    own = np.zeros(kept.shape[1:])
    p = steps - 1
    end = MouthPose(points[p, 0], points[p, 1], points[p, 2], axes[p, 0], axes[p, 1], axes[p, 2])
    for d in range(*states):
        low = d * count
        one = _state(s, low, low + count)
        if len(kept):
            own[:] = kept[d]
        left = min(worst - total, hopeless)
        h[:], forces[:], stem_forces[:], pulls[:] = 0.0, 0.0, 0.0, 0.0
        done = push(
            one, points, axes, dt, cup, solid, left, positions, forces, stem_forces, h, pulls,
            leaves, speed, begin, own,
        )  # fmt: skip
        if keep:
            kept[d] = own
        x, y, z = positions[p, 0, 0], positions[p, 0, 1], positions[p, 0, 2]
        rx, ry, rz = s.root[low, 0], s.root[low, 1], s.root[low, 2]
        apart = (1.0 - s.upper[low]) * s.length[low]
        held = cup.inner > 0.0 and taken(x, y, z, rx, ry, rz, apart, end, cup)
        missed = done < steps or (cup.inner > 0.0 and not held)
        score = _so_far(h, pulls, leaves < steps, missed)
        total += min(score, hopeless)
        if seen and d == 0 and total >= hopeless:
            return total
        if total > worst:
            break
    return total


@kernel
def _state(s, low, high):
    """The stems from ``low`` to ``high``."""
    return Stems(
        s.root[low:high], s.axes[low:high], s.length[low:high], s.mass[low:high],
        s.radius[low:high], s.thickness[low:high], s.upper[low:high], s.above[low:high],
        s.shape[low:high], s.stiffness[low:high], s.compliance[low:high],
        s.shortening[low:high], s.joint[low:high], s.rest[low:high], s.lifted[low:high],
        s.drift[low:high],
    )  # fmt: skip
