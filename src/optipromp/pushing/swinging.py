r"""What a cup does to fruits on stems, foreseen step by step along the tool's path.

At every step each fruit takes the deflections u of its stem (:mod:`optipromp.pushing.bending`) that
minimise

.. math:: \tfrac12 u^T K u + \tfrac{m}{2\,dt^2}\|u_L - \hat u_L\|^2
          + \tfrac{k_c}{2}\sum_j \max(0, -g_j(u))^2

by a few Gauss-Newton steps from where they were: the stem's energy, the fruit's inertia (an
implicit Euler step; :math:`\hat u_L` is where it would swing to by itself) and its contacts, with
the gaps g of fruit and stem to the cup, to other fruits and their stems and to what is firm. The
cup rubs on fruits: Coulomb's friction as a spring against the slip of the step, as stiff as the
contact force allows.
"""

import math

import numpy as np
from numba import njit

from optipromp.arrays import BoolArray, FloatArray
from optipromp.geometry.distances import distance_and_gradient
from optipromp.geometry.obstacles import Obstacles
from optipromp.pushing.bending import Stems
from optipromp.pushing.cup import (
    ABOVE,
    NECK_LOOKED_AT,
    Cup,
    Pose,
    fruit_gap,
    in_cup,
    inside,
    stem_gap,
)
from optipromp.pushing.deflected import LOADS, begin, freely, level, place, press, shortened
from optipromp.pushing.harm import Harm, score_of

CONTACT = 3000.0  # [N/m]
FRICTION = 0.15  # of the cup on fruits
STUCK = 3e-4  # [m] of slip in a step up to which a fruit counts as stuck to the cup
ITERATIONS = 6
SETTLED = 1e-4  # [m] change of the deflections that ends the iterations
FARTHEST = 0.004  # [m] that a loaded point moves in one iteration
LIVELY = 0.9  # share of its speed that a fruit keeps from step to step
HELD = 5  # steps over which a force must last
CLOSE = 0.016  # [m] gap up to which a contact is looked at within a step
WALLS = 0.08  # [m] gap of a fruit to what stands firm up to which that is listed
WANDERED = 0.04  # [m] that a fruit moves until it is listed again
AS_FAR = 0.5  # share of the last iteration's change whose reverse is taken by half
STIRRED = 0.007  # [m] that fruits move in a step until what is close is looked for again

_jit = njit(cache=True, error_model="numpy", nogil=True)


@_jit
def _apart(
    x: float, y: float, z: float, a: float, b: float, c: float
) -> tuple[float, float, float, float]:
    """Distance of two points, and the direction from the second to the first."""
    x, y, z = x - a, y - b, z - c
    d = math.sqrt(x * x + y * y + z * z)
    out = 1.0 / d if d > 1e-9 else 0.0
    return d, out * x, out * y, out * z


@_jit
def _overlapping(s: Stems) -> BoolArray:
    """What is in one another at rest and so does not touch: (N, N, 2) fruits; fruit and stem.

    ``[i, o, 0]``: fruit ``i`` in fruit ``o``; ``[i, o, 1]``: fruit ``i`` in stem ``o``.
    """
    root, axes, shape, length = s.root, s.axes, s.shape, s.length
    count = len(root)
    out = np.zeros((count, count, 2), dtype=np.bool_)
    still = np.zeros((count, 2 * shape.shape[2]))
    for i in range(count):
        x0, x1, x2 = place(root, axes, shape, still, i, length[i], 1.0)
        for o in range(count):
            if o == i:
                continue
            y0, y1, y2 = place(root, axes, shape, still, o, length[o], 1.0)
            d, _, _, _ = _apart(x0, x1, x2, y0, y1, y2)
            out[i, o, 0] = d < s.radius[i] + s.radius[o]
            share = level(root, axes, o, length[o], x0, x1, x2)
            y0, y1, y2 = place(root, axes, shape, still, o, length[o], share)
            d, _, _, _ = _apart(x0, x1, x2, y0, y1, y2)
            out[i, o, 1] = d < s.radius[i] + s.thickness[o]
    return out


@_jit
def push(
    s: Stems, points: FloatArray, axes: FloatArray, dt: float, cup: Cup, solid: Obstacles,
    worst: float, positions: FloatArray, forces: FloatArray, stem_forces: FloatArray,
    so_far: FloatArray,
) -> int:  # fmt: skip
    """Lead the cup along a path.

    Args:
        s: the N stems.
        points: (P, 3) of the tool point; ``axes`` (P, 3) out of the mouth.
        dt: between points [s].
        cup: its shape.
        solid: what fruits are pressed against; stems grow beside it.
        worst: a score (:func:`optipromp.pushing.harm.score_of`) beyond which it need not go on.
        positions: (P, N, 3) out, of the fruits [m].
        forces: (P, N) out, largest contact force on each fruit [N].
        stem_forces: (P, N) out, of the cup on each stem [N].
        so_far: (5,) in and out, the numbers of :class:`optipromp.pushing.harm.Harm`.

    Returns:
        How many points it was led through.
    """
    root, frame, shape, shortening = s.root, s.axes, s.shape, s.shortening
    lengths, radii, thickness = s.length, s.radius, s.thickness
    mass, stiffness = s.mass, s.stiffness
    count, n, dofs = len(root), shape.shape[1] - 1, 2 * LOADS
    others, walls = count - 1, len(solid.kind)
    u, before, ahead = np.zeros((count, dofs)), np.zeros((count, dofs)), np.zeros((count, dofs))
    up, center, began = np.zeros(count), np.empty((count, 3)), np.empty((count, 3))
    gradient, step, inverse = np.empty(dofs), np.empty(dofs), np.empty((dofs, dofs))
    j, v, free = np.empty(dofs), np.empty(dofs), np.empty((count, LOADS, LOADS))
    eased, last_step = np.ones(count), np.zeros((count, dofs))
    now, earlier = np.zeros(count), np.zeros(count)  # forces of the cup on fruits
    firmly, pinched = np.zeros(count, dtype=np.bool_), np.zeros(count, dtype=np.int64)
    resting, spell = np.ones(count, dtype=np.bool_), np.zeros(count, dtype=np.int64)
    touching = _overlapping(s)
    most = 3 * others + 1 + walls + n + 3  # contacts of a fruit and its stem
    whats = np.empty((count, most), dtype=np.int64)
    shares, close = np.ones((count, most)), np.zeros(count, dtype=np.int64)
    firm, listed_at = np.empty((count, walls), dtype=np.int64), np.full((count, 3), np.inf)
    on_fruit = np.empty(count, dtype=np.int64)  # contacts that are numbered; then the stem's
    top, bottom, first = np.zeros(count), np.zeros(count), np.zeros(count, dtype=np.int64)
    on_all = np.zeros(count, dtype=np.int64)
    for i in range(count):
        center[i] = place(root, frame, shape, u, i, lengths[i], 1.0)
        freely(s.compliance, mass[i] / (dt * dt), i, free)
    for p in range(len(points)):
        at = Pose(points[p, 0], points[p, 1], points[p, 2], axes[p, 0], axes[p, 1], axes[p, 2])
        untouched = p > 0  # nothing has moved, and the rim is below all
        for i in range(count):
            h, _, _, _, _ = in_cup(center[i, 0], center[i, 1], center[i, 2], at)
            above, _, _, _, _ = in_cup(root[i, 0], root[i, 1], root[i, 2], at)
            untouched &= resting[i] and min(h - radii[i], above) > cup.rim + CLOSE
        if untouched:
            positions[p] = center
            continue
        q = max(p - 1, 0)
        c0, c1, c2 = at.x - points[q, 0], at.y - points[q, 1], at.z - points[q, 2]
        for i in range(count):
            for c in range(3):
                began[i, c] = center[i, c]
            for a in range(dofs):
                ahead[i, a] = u[i, a] + LIVELY * (u[i, a] - before[i, a])
                before[i, a] = u[i, a]
            wandered, _, _, _ = _apart(
                center[i, 0], center[i, 1], center[i, 2],
                listed_at[i, 0], listed_at[i, 1], listed_at[i, 2],
            )  # fmt: skip
            if wandered > WANDERED:
                listed_at[i] = center[i]
                on_fruit[i] = 3 * others + 1
                for k in range(walls):
                    gap, _, _, _ = distance_and_gradient(
                        solid, k, center[i, 0], center[i, 1], center[i, 2]
                    )
                    if gap - radii[i] < WALLS:
                        firm[i, on_fruit[i] - 3 * others - 1] = k
                        on_fruit[i] += 1
            # the stem's pieces level with the cup, and those at its rim and base
            length = lengths[i]
            top[i] = level(
                root, frame, i, length, at.x + cup.rim * at.u, at.y + cup.rim * at.v,
                at.z + cup.rim * at.w,
            )  # fmt: skip
            bottom[i] = level(
                root, frame, i, length, at.x + cup.base * at.u, at.y + cup.base * at.v,
                at.z + cup.base * at.w,
            )  # fmt: skip
            under = cup.base - NECK_LOOKED_AT
            low = level(
                root, frame, i, length, at.x + under * at.u, at.y + under * at.v,
                at.z + under * at.w,
            )  # fmt: skip
            first[i] = int(top[i] * n) + 1
            end = int(low * n) if low > 0.0 else int((1.0 - radii[i] / length) * n)
            on_all[i] = on_fruit[i] + 2 + max(end - first[i] + 1, 0)
        earlier[:] = now
        eased[:] = 1.0
        last_step[:] = 0.0
        stirred = np.inf
        for _ in range(ITERATIONS):
            look = stirred > STIRRED  # for all contacts that are close, not only those known
            if look:
                stirred = 0.0
            moved = 0.0
            for i in range(count):
                length, radius = lengths[i], radii[i]
                x0, x1, x2 = center[i, 0], center[i, 1], center[i, 2]
                begun = not resting[i]
                inertia = mass[i] / (dt * dt)
                if begun:
                    begin(stiffness, free, u, ahead, i, inertia, gradient, inverse)
                now[i], firmly[i] = 0.0, False
                largest = t0 = t1 = t2 = 0.0
                last = 1.0 - radius / length
                h, rho, _, _, _ = in_cup(x0, x1, x2, at)
                within = h > cup.base and rho < cup.inner
                looked_at = on_all[i] if look else close[i]
                if look:
                    close[i] = 0
                clear = 0  # contacts before this one cannot be close
                for k in range(looked_at):
                    what = k if look else whats[i, k]
                    share = 1.0
                    if what == 0:  # the fruit and the cup
                        gap, n0, n1, n2 = fruit_gap(x0, x1, x2, radius, at, cup)
                    elif what <= 3 * others:  # fruit and fruit, fruit and stem, stem and fruit
                        o = (what - 1) // 3
                        o += 1 if o >= i else 0
                        if resting[i] and resting[o]:
                            continue
                        y0, y1, y2 = center[o, 0], center[o, 1], center[o, 2]
                        if what % 3 == 1:
                            if touching[i, o, 0]:
                                continue
                            gap, n0, n1, n2 = _apart(x0, x1, x2, y0, y1, y2)
                            gap -= radius + radii[o]
                        elif what % 3 == 2:
                            there = level(root, frame, o, lengths[o], x0, x1, x2)
                            if there == 0.0 or touching[i, o, 1]:
                                continue
                            y0, y1, y2 = place(root, frame, shape, u, o, lengths[o] - up[o], there)
                            gap, n0, n1, n2 = _apart(x0, x1, x2, y0, y1, y2)
                            gap -= radius + thickness[o]
                        else:
                            share = level(root, frame, i, length, y0, y1, y2)
                            if share == 0.0 or share > last or touching[o, i, 1]:
                                continue
                            z0, z1, z2 = place(root, frame, shape, u, i, length - up[i], share)
                            gap, n0, n1, n2 = _apart(z0, z1, z2, y0, y1, y2)
                            gap -= radii[o] + thickness[i]
                    elif what < on_fruit[i]:  # the fruit and what stands firm
                        if resting[i] and p > 0:
                            continue
                        gap, n0, n1, n2 = distance_and_gradient(
                            solid, firm[i, what - 3 * others - 1], x0, x1, x2
                        )
                        gap -= radius
                    else:  # the stem and the cup
                        share = shares[i, k]
                        if look:
                            piece = what - on_fruit[i] - 2
                            share = (first[i] + piece) / n
                            if piece < 0:
                                share = top[i] if piece == -2 else bottom[i]
                            if share == 0.0 or share > last or k < clear:
                                continue
                        y0, y1, y2 = place(root, frame, shape, u, i, length - up[i], share)
                        gap, n0, n1, n2 = stem_gap(y0, y1, y2, thickness[i], within, at, cup)
                        if look and piece >= 0:
                            away = gap - cup.outer + cup.neck if gap < ABOVE else gap - ABOVE
                            clear = k + int((away - CLOSE) * n / length)
                    if look and gap < CLOSE:
                        whats[i, close[i]], shares[i, close[i]] = what, share
                        close[i] += 1
                    if gap >= 0.0:
                        continue
                    if not begun:
                        begun, resting[i], stirred = True, False, np.inf
                        begin(stiffness, free, u, ahead, i, inertia, gradient, inverse)
                    force = -gap * CONTACT
                    press(
                        frame, shape, shortening, u, i, share, n0, n1, n2, -gap, CONTACT, j, v,
                        gradient, inverse,
                    )  # fmt: skip
                    if what >= on_fruit[i]:
                        t0, t1, t2 = t0 + force * n0, t1 + force * n1, t2 + force * n2
                    elif share == 1.0:
                        largest = max(largest, force)
                    if 3 * others < what < on_fruit[i]:
                        firmly[i] = True
                    if what != 0:
                        continue
                    # the cup rubs on the fruit, as hard as it was pressed a step before
                    now[i] = force
                    if earlier[i] == 0.0:
                        continue
                    y0, y1, y2 = x0 - began[i, 0] - c0, x1 - began[i, 1] - c1, x2 - began[i, 2] - c2
                    along = y0 * n0 + y1 * n1 + y2 * n2
                    y0, y1, y2 = y0 - along * n0, y1 - along * n1, y2 - along * n2
                    rub = math.sqrt(y0 * y0 + y1 * y1 + y2 * y2)
                    if rub > 1e-7:
                        press(
                            frame, shape, shortening, u, i, 1.0, -y0 / rub, -y1 / rub, -y2 / rub,
                            rub, FRICTION * earlier[i] / max(rub, STUCK), j, v, gradient,
                            inverse,
                        )  # fmt: skip
                forces[p, i] = largest
                stem_forces[p, i] = math.sqrt(t0 * t0 + t1 * t1 + t2 * t2)
                if not begun:
                    continue
                far = back = length_before = 0.0
                for a in range(dofs):
                    step[a] = 0.0
                    for b in range(dofs):
                        step[a] += inverse[a, b] * gradient[b]
                    back -= step[a] * last_step[i, a]
                    length_before += last_step[i, a] ** 2
                for a in range(LOADS):
                    far = max(far, math.hypot(step[a], step[LOADS + a]))
                # a step back as long as the last one goes on for ever
                if back > AS_FAR * length_before:
                    eased[i] *= 0.5
                scale = min(eased[i], FARTHEST / max(far, 1e-12))
                moved = max(moved, far * scale)
                for a in range(dofs):
                    last_step[i, a] = scale * step[a]
                    u[i, a] -= last_step[i, a]
                up[i] = shortened(shortening, u, i)
                center[i] = place(root, frame, shape, u, i, length - up[i], 1.0)
            stirred += moved
            if moved < SETTLED:
                break
        for i in range(count):
            positions[p, i] = center[i]
            lasting = lasting_on_fruit = np.inf if p >= HELD - 1 else 0.0
            for q in range(max(p - HELD + 1, 0), p + 1):
                lasting = min(lasting, stem_forces[q, i])
                lasting_on_fruit = min(lasting_on_fruit, forces[q, i])
            so_far[0] = max(so_far[0], lasting)
            if i == 0:
                so_far[2] = max(so_far[2], lasting_on_fruit)
                continue
            so_far[1] = max(so_far[1], forces[p, i])
            swallowed = inside(center[i, 0], center[i, 1], center[i, 2], at, cup)
            spell[i] = spell[i] + 1 if swallowed else 0
            so_far[3] = max(so_far[3], spell[i] * dt)
            if firmly[i] and now[i] > 0.0:
                pinched[i] += 1
                so_far[4] = max(so_far[4], pinched[i] * dt)
        if score_of(so_far[0], so_far[1], so_far[2], so_far[3], so_far[4], False) > worst:
            return p + 1
    return len(points)


def harm(
    s: Stems, points: FloatArray, axes: FloatArray, dt: float, cup: Cup, solid: Obstacles
) -> Harm:
    """What the cup, led along a path (see :func:`push`), does to the fruits; the first is wanted.

    A force lasts as long as it does not fall for :data:`HELD` steps.
    """
    return Harm(*_harm(s, points, axes, dt, cup, solid, np.inf))


def led(
    s: Stems, points: FloatArray, axes: FloatArray, dt: float, cup: Cup, solid: Obstacles
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Where the cup, led along a path (see :func:`push`), brings the fruits, and how hard.

    Returns:
        Positions (P, N, 3) [m]; the largest force on each fruit and the largest lasting one on each
        stem (N,) [N]; and how long each fruit is inside (N,) [s].
    """
    steps, count = len(points), len(s.root)
    positions = np.zeros((steps, count, 3))
    forces, stem_forces = np.zeros((steps, count)), np.zeros((steps, count))
    push(s, points, axes, dt, cup, solid, np.inf, positions, forces, stem_forces, np.zeros(5))
    held = np.lib.stride_tricks.sliding_window_view(stem_forces, min(HELD, steps), axis=0)
    within = np.array(
        [
            [inside(x[0], x[1], x[2], Pose(*point, *axis), cup) for x in places]
            for places, point, axis in zip(positions, points, axes, strict=True)
        ]
    )
    return positions, forces.max(axis=0), held.min(axis=-1).max(axis=0), dt * within.sum(axis=0)


# A kernel returns no named tuple: Numba calls its class to make one, and does not survive an
# interruption there.
@_jit
def _harm(
    s: Stems, points: FloatArray, axes: FloatArray, dt: float, cup: Cup, solid: Obstacles,
    worst: float,
) -> tuple[float, float, float, float, float, bool]:  # fmt: skip
    """See :func:`harm`; ``missed`` also where the score passes ``worst`` before the end."""
    count, steps, so_far = len(s.root), len(points), np.zeros(5)
    positions = np.zeros((steps, count, 3))
    forces, stem_forces = np.zeros((steps, count)), np.zeros((steps, count))
    done = push(s, points, axes, dt, cup, solid, worst, positions, forces, stem_forces, so_far)
    x, p = positions[-1, 0], steps - 1
    end = Pose(points[p, 0], points[p, 1], points[p, 2], axes[p, 0], axes[p, 1], axes[p, 2])
    missed = done < steps or (cup.inner > 0.0 and not inside(x[0], x[1], x[2], end, cup))
    return so_far[0], so_far[1], so_far[2], so_far[3], so_far[4], missed


@_jit
def mean_score(
    s: Stems, count: int, draws: int, points: FloatArray, axes: FloatArray, dt: float, cup: Cup,
    solid: Obstacles, hopeless: float, worst: float,
) -> float:  # fmt: skip
    """Mean score of a path over several ways that the same fruits may hang.

    Args:
        s: the stems, one way after the other, ``count`` in each.
        count: of fruits.
        draws: how many ways are looked at.
        points: see :func:`push`, and so on to ``solid``.
        hopeless: what one way counts at most; where the first does, the others are not looked at.
        worst: a mean beyond which the exact one does not matter.
    """
    total = 0.0
    for d in range(draws):
        low, high = d * count, (d + 1) * count
        one = Stems(
            s.root[low:high], s.axes[low:high], s.length[low:high], s.mass[low:high],
            s.radius[low:high], s.thickness[low:high], s.shape[low:high],
            s.stiffness[low:high], s.compliance[low:high], s.shortening[low:high],
        )  # fmt: skip
        left = min(worst * draws - total, hopeless)
        h = _harm(one, points, axes, dt, cup, solid, left)
        total += min(score_of(h[0], h[1], h[2], h[3], h[4], h[5]), hopeless)
        if d == 0 and total >= hopeless:
            return total
        if total > worst * draws:
            break
    return total / draws
