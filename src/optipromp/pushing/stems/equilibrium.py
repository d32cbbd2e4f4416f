r"""The equilibrium of stems and their fruits after one step of the cup.

Each fruit takes the deflections u of its stem (:mod:`.bending`) that minimise

.. math:: \tfrac12 (u - u_0)^T K (u - u_0) + \tfrac{m}{2\,dt^2}\|u_L - \hat u_L\|^2
          + \tfrac{k_c}{2}\sum_j \max(0, -g_j(u))^2

by Gauss-Newton steps from the last equilibrium. The terms are the stem's energy, which is least at
its bow :math:`u_0`, the fruit's
inertia (an implicit Euler step; :math:`\hat u_L` is where the fruit would swing to by itself) and
the contacts with their gaps g (:mod:`optipromp.pushing.stems.contacts`). What touches rubs: Coulomb
friction is a spring against the slip of the step, as stiff as the contact force allows. Between cup
and stem only the slip across the cup's axis counts: without it a stem that lies over the mouth
would slide off round the rim, and with the slip along the axis the model presses stems too hard.
"""

import math
from typing import NamedTuple

from optipromp.arrays import FloatArray
from optipromp.compiled import inlined, inner
from optipromp.geometry.distances import distance_and_gradient
from optipromp.geometry.obstacles import Obstacles
from optipromp.pushing.parameters import PUSH
from optipromp.pushing.stems.bending import Stems
from optipromp.pushing.stems.contacts import Contacts, Fruits, between
from optipromp.pushing.stems.cup import ABOVE, Mouth, MouthPose, fruit_gap, in_cup, stem_gap
from optipromp.pushing.stems.deflected import LOADS, begin, level, place, press, shortened

CONTACT, CLOSE = PUSH.swing.stiffness, PUSH.swing.close
RUBBING, STUCK = PUSH.swing.friction, PUSH.swing.stuck
ON_SKIN, ON_STEM = PUSH.swing.skin_friction, PUSH.swing.stem_friction
FARTHEST, REVERSAL = PUSH.swing.farthest, PUSH.swing.reversal


class Descent(NamedTuple):
    """Gauss-Newton on the energy of one stem after the other.

    Attributes:
        free: (N, L, L) inverse of stiffness and inertia of each stem [m/N].
        gradient: (2L,) of the energy of one [N]; ``inverse`` (2L, 2L) of its Hessian [m/N].
        j, v: (2L,) see :func:`optipromp.pushing.stems.deflected.press`.
        eased: (N,) share of a step that is taken; ``last`` (N, 2L) the last step [m].
    """

    free: FloatArray
    gradient: FloatArray
    inverse: FloatArray
    j: FloatArray
    v: FloatArray
    eased: FloatArray
    last: FloatArray


@inlined
def relax(
    s: Stems, f: Fruits, c: Contacts, d: Descent, at: MouthPose, shift: MouthPose, cup: Mouth,
    solid: Obstacles, dt: float, look: bool, p: int, forces: FloatArray, stem_forces: FloatArray,
) -> tuple[float, bool]:  # fmt: skip
    """One Gauss-Newton step of every fruit that is touched.

    Args:
        s: the N stems.
        f: where they are, in and out.
        c: their contacts, in and out.
        d: the iteration so far, in and out.
        at: of the cup; ``shift``: its motion in this step [m].
        cup: its shape.
        solid: what stands firm.
        dt: of the step [s].
        look: whether all contacts are looked at, not only those known to be close.
        p: number of the step.
        forces: (P, N) out, largest contact force on each fruit in each step [N].
        stem_forces: (P, N) out, of the cup on each stem [N].

    Returns:
        The largest change of a deflection [m], and whether a fruit was touched for the first time.
    """
    root, axes, shape, shortening, stiffness = s.root, s.axes, s.shape, s.shortening, s.stiffness
    length, radii, thickness, mass = s.length, s.radius, s.thickness, s.mass
    upper, above, rest, lifted = s.upper, s.above, s.rest, s.lifted
    u, before, ahead, up, center, began = f.u, f.before, f.ahead, f.up, f.center, f.began
    resting, pressed, earlier, firmly = f.resting, f.pressed, f.earlier, f.firmly
    overlap, firm, on_fruits, on_all = c.overlap, c.firm, c.on_fruit, c.on_all
    top, bottom, first, close, number, shares = c.top, c.bottom, c.first, c.close, c.number, c.share
    free, gradient, inverse, j, v, eased, taken = (
        d.free, d.gradient, d.inverse, d.j, d.v, d.eased, d.last
    )  # fmt: skip
    n, others = shape.shape[1] - 1, 3 * (len(length) - 1)
    moved, woken = 0.0, False
    for i in range(len(length)):
        radius, on_fruit = radii[i], on_fruits[i]
        begun, inertia = not resting[i], mass[i] / (dt * dt)
        if begun:
            begin(stiffness, rest, free, u, ahead, i, inertia, gradient, inverse)
        pressed[i], firmly[i] = 0.0, False
        largest = t0 = t1 = t2 = 0.0
        last = upper[i] - above[i] / length[i]
        h, rho, _, _, _ = in_cup(center[i, 0], center[i, 1], center[i, 2], at)
        within = h > cup.base and rho < cup.inner
        looked_at = on_all[i] if look else close[i]
        if look:
            close[i] = 0
        clear = 0  # contacts before this one cannot be close
        for k in range(looked_at):
            what = k if look else number[i, k]
            share = 1.0
            if what == 0:
                gap, n0, n1, n2, share = _on_cup(
                    root, axes, shape, length, upper, above, u, up, center, i, radius, at, cup
                )
            elif what <= others:
                gap, n0, n1, n2, share = between(
                    root, axes, shape, length, radii, thickness, upper, above, u, up, center,
                    resting, overlap, i, what,
                )  # fmt: skip
            elif what < on_fruit:
                if resting[i] and p > 0:
                    continue
                wall = firm[i, what - others - 1]
                gap, n0, n1, n2, share = _on_wall(
                    root, axes, shape, length, upper, above, u, up, center, i, radius, solid, wall
                )
            else:
                share = shares[i, k]
                if look:
                    piece = what - on_fruit - 2
                    share = (first[i] + piece) / n
                    if piece < 0:
                        share = top[i] if piece == -2 else bottom[i]
                if look and (share == 0.0 or share > last or k < clear):
                    continue
                y0, y1, y2 = place(root, axes, shape, u, i, length[i] - up[i], share)
                gap, n0, n1, n2 = stem_gap(y0, y1, y2, thickness[i], within, at, cup)
                if look and what >= on_fruit + 2:
                    away = gap - cup.outer + cup.neck if gap < ABOVE else gap - ABOVE
                    clear = k + int((away - CLOSE) * n / length[i])
            if look and gap < CLOSE:
                number[i, close[i]], shares[i, close[i]] = what, share
                close[i] += 1
            if gap >= 0.0:
                continue
            if not begun:
                begun, woken, resting[i] = True, True, False
                begin(stiffness, rest, free, u, ahead, i, inertia, gradient, inverse)
            hard = -gap * CONTACT
            press(
                axes, shape, shortening, u, i, share, n0, n1, n2, -gap, CONTACT, j, v,
                gradient, inverse,
            )  # fmt: skip
            most = r0 = r1 = r2 = 0.0  # force against the slip (r0, r1, r2)
            if 0 < what <= others:
                most = ON_SKIN * hard
                r0, r1, r2 = _slip(
                    root, axes, shape, length, u, before, up, center, began, i, what, share
                )
            elif what >= on_fruit:
                most = ON_STEM * hard
                t0, t1, t2 = t0 + hard * n0, t1 + hard * n1, t2 + hard * n2
                z0, z1, z2 = place(root, axes, shape, before, i, length[i] - up[i], share)
                r0, r1, r2 = y0 - z0 - shift.x, y1 - z1 - shift.y, y2 - z2 - shift.z
                along = r0 * at.u + r1 * at.v + r2 * at.w
                r0, r1, r2 = r0 - along * at.u, r1 - along * at.v, r2 - along * at.w
            elif what > others:
                firmly[i] = True
            else:
                most, pressed[i] = RUBBING * earlier[i], hard
                r0, r1, r2 = _slip_on_cup(
                    root, axes, shape, length, u, before, up, center, began, i, share
                )
                r0, r1, r2 = r0 - shift.x, r1 - shift.y, r2 - shift.z
            if what < on_fruit and (what == 0 or what > others or what % 3):  # not on its stem
                largest = max(largest, hard)
            if most > 0.0:
                _rub(
                    axes, shape, shortening, u, i, share, r0, r1, r2, n0, n1, n2, most, j, v,
                    gradient, inverse,
                )  # fmt: skip
        forces[p, i] = largest
        stem_forces[p, i] = math.sqrt(t0 * t0 + t1 * t1 + t2 * t2)
        if begun:
            change = _step(shortening, lifted, u, up, i, inverse, gradient, eased, taken, v)
            moved = max(moved, change)
            y0, y1, y2 = place(root, axes, shape, u, i, length[i] - up[i], 1.0)
            center[i, 0], center[i, 1], center[i, 2] = y0, y1, y2
    return moved, woken


@inlined
def _on_cup(
    root: FloatArray, axes: FloatArray, shape: FloatArray, length: FloatArray, upper: FloatArray,
    above: FloatArray, u: FloatArray, up: FloatArray, center: FloatArray, i: int, radius: float,
    at: MouthPose, cup: Mouth,
) -> tuple[float, float, float, float, float]:  # fmt: skip
    """Gap of fruit i to the cup, the direction it is pushed in, and the share of its stem."""
    gap, n0, n1, n2 = fruit_gap(center[i, 0], center[i, 1], center[i, 2], radius, at, cup)
    if upper[i] < 1.0:
        x, y, z = place(root, axes, shape, u, i, length[i] - up[i], upper[i])
        over, m0, m1, m2 = fruit_gap(x, y, z, above[i], at, cup)
        if over < gap:
            return over, m0, m1, m2, upper[i]
    return gap, n0, n1, n2, 1.0


@inlined
def _on_wall(
    root: FloatArray, axes: FloatArray, shape: FloatArray, length: FloatArray, upper: FloatArray,
    above: FloatArray, u: FloatArray, up: FloatArray, center: FloatArray, i: int, radius: float,
    solid: Obstacles, wall: int,
) -> tuple[float, float, float, float, float]:  # fmt: skip
    """:func:`_on_cup` for a static object."""
    gap, n0, n1, n2 = distance_and_gradient(
        solid, wall, center[i, 0], center[i, 1], center[i, 2]
    )  # fmt: skip
    if upper[i] < 1.0:
        x, y, z = place(root, axes, shape, u, i, length[i] - up[i], upper[i])
        over, m0, m1, m2 = distance_and_gradient(solid, wall, x, y, z)
        if over - above[i] < gap - radius:
            return over - above[i], m0, m1, m2, upper[i]
    return gap - radius, n0, n1, n2, 1.0


@inner
def _slip_on_cup(
    root: FloatArray, axes: FloatArray, shape: FloatArray, length: FloatArray, u: FloatArray,
    before: FloatArray, up: FloatArray, center: FloatArray, began: FloatArray, i: int, share: float,
) -> tuple[float, float, float]:  # fmt: skip
    """How far a ball of fruit i has moved in this step [m]: the lower one, or that at ``share``.

    The upper ball began as far from the lower one as it was.
    """
    x, y, z = center[i, 0] - began[i, 0], center[i, 1] - began[i, 1], center[i, 2] - began[i, 2]
    if share < 1.0:
        chord = length[i] - up[i]
        for sign, at, deflections in (
            (1.0, share, u), (-1.0, 1.0, u), (-1.0, share, before), (1.0, 1.0, before)
        ):  # fmt: skip
            a, b, c = place(root, axes, shape, deflections, i, chord, at)
            x, y, z = x + sign * a, y + sign * b, z + sign * c
    return x, y, z


@inner
def _slip(
    root: FloatArray, axes: FloatArray, shape: FloatArray, length: FloatArray, u: FloatArray,
    before: FloatArray, up: FloatArray, center: FloatArray, began: FloatArray, i: int, what: int,
    share: float,
) -> tuple[float, float, float]:  # fmt: skip
    """Slip of this step between fruit or stem i and another, at contact ``what`` [m]."""
    o = (what - 1) // 3
    o += 1 if o >= i else 0
    x0, x1, x2 = center[i, 0], center[i, 1], center[i, 2]
    y0, y1, y2 = center[o, 0], center[o, 1], center[o, 2]
    a0, a1, a2 = began[i, 0], began[i, 1], began[i, 2]
    b0, b1, b2 = began[o, 0], began[o, 1], began[o, 2]
    if what % 3 == 0:
        x0, x1, x2 = place(root, axes, shape, u, i, length[i] - up[i], share)
        a0, a1, a2 = place(root, axes, shape, before, i, length[i] - up[i], share)
    elif what % 3 == 2:
        along = level(root, axes, o, length[o], x0, x1, x2)
        y0, y1, y2 = place(root, axes, shape, u, o, length[o] - up[o], along)
        b0, b1, b2 = place(root, axes, shape, before, o, length[o] - up[o], along)
    return x0 - a0 - y0 + b0, x1 - a1 - y1 + b1, x2 - a2 - y2 + b2


@inner
def _rub(
    axes: FloatArray, shape: FloatArray, shortening: FloatArray, u: FloatArray, i: int,
    share: float, x: float, y: float, z: float, n0: float, n1: float, n2: float, most: float,
    j: FloatArray, v: FloatArray, gradient: FloatArray, inverse: FloatArray,
) -> None:  # fmt: skip
    """Rub on a share of stem i with at most ``most`` [N], against its slip (x, y, z).

    The part of the slip along the contact's direction (n0, n1, n2) does not count.
    """
    along = x * n0 + y * n1 + z * n2
    x, y, z = x - along * n0, y - along * n1, z - along * n2
    slip = math.sqrt(x * x + y * y + z * z)
    if slip > 1e-7:
        press(
            axes, shape, shortening, u, i, share, -x / slip, -y / slip, -z / slip, slip,
            most / max(slip, STUCK), j, v, gradient, inverse,
        )  # fmt: skip


@inner
def _step(
    shortening: FloatArray, lifted: FloatArray, u: FloatArray, up: FloatArray, i: int,
    inverse: FloatArray, gradient: FloatArray, eased: FloatArray, last: FloatArray,
    step: FloatArray,
) -> float:  # fmt: skip
    """Step stem i to the minimum of the quadratic model; the largest change of a deflection [m].

    No loaded point moves farther than :data:`FARTHEST`. A step back as long as the last one would
    go on for ever; it is halved, and those after it.
    """
    far = back = before = 0.0
    for a in range(2 * LOADS):
        step[a] = 0.0
        for b in range(2 * LOADS):
            step[a] += inverse[a, b] * gradient[b]
        back -= step[a] * last[i, a]
        before += last[i, a] ** 2
    for a in range(LOADS):
        far = max(far, math.hypot(step[a], step[LOADS + a]))
    if back > REVERSAL * before:
        eased[i] *= 0.5
    scale: float = min(eased[i], FARTHEST / max(far, 1e-12))
    for a in range(2 * LOADS):
        last[i, a] = scale * step[a]
        u[i, a] -= last[i, a]
    up[i] = shortened(shortening, u, i) - lifted[i]
    return far * scale
