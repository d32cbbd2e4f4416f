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
from typing import NamedTuple

import numpy as np
from numba import njit

from optipromp.arrays import BoolArray, FloatArray
from optipromp.geometry.distances import distance_and_gradient
from optipromp.geometry.obstacles import Obstacles
from optipromp.pushing.bending import Stems
from optipromp.robots.ik import cholesky_solve

CONTACT = 3000.0  # [N/m]
FRICTION = 0.15  # of the cup on fruits
STUCK = 3e-4  # [m] of slip in a step up to which a fruit counts as stuck to the cup
ITERATIONS = 6
SETTLED = 1e-4  # [m] change of the deflections that ends the iterations
FARTHEST = 0.004  # [m] that a loaded point moves in one iteration
LIVELY = 0.9  # share of its speed that a fruit keeps from step to step
HELD = 5  # steps over which a force must last
NECK_LOOKED_AT = 0.03  # [m] under the cup that stems are kept off the neck
BARELY = 0.003  # [m] under the rim at which a fruit counts as inside

_jit = njit(cache=True, error_model="numpy", nogil=True)


class Cup(NamedTuple):
    """A cup about its axis, heights over the tool point [m]."""

    inner: float
    outer: float
    base: float
    rim: float
    floor: float  # thickness
    neck: float  # radius


class Harm(NamedTuple):
    """What is foreseen of a path; the first fruit is the target.

    Attributes:
        stem: largest lasting force of the cup on a stem [N].
        fruit: largest force on another fruit than the target [N].
        target: largest lasting force on the target [N].
        inside: longest that another fruit is inside the cup [s].
        missed: whether the target is not inside at the end.
    """

    stem: float
    fruit: float
    target: float
    inside: float
    missed: bool


@_jit
def _box(
    rho: float, h: float, low: float, high: float, bottom: float, top: float, out: FloatArray
) -> float:
    """Signed distance of (rho, h) to a rectangle, its gradient into ``out`` (2,)."""
    x, y = rho - 0.5 * (low + high), h - 0.5 * (bottom + top)
    qx, qy = abs(x) - 0.5 * (high - low), abs(y) - 0.5 * (top - bottom)
    sx, sy = math.copysign(1.0, x), math.copysign(1.0, y)
    if qx > 0.0 and qy > 0.0:
        d = math.sqrt(qx * qx + qy * qy)
        out[0], out[1] = sx * qx / d, sy * qy / d
        return d
    if qx > qy:
        out[0], out[1] = sx, 0.0
        return qx
    out[0], out[1] = 0.0, sy
    return qy


@_jit
def cup_distance(rho: float, h: float, cup: Cup, out: FloatArray) -> float:
    """Signed distance to wall, floor and neck in the half-plane; (d/drho, d/dh) into ``out``."""
    best = _box(rho, h, cup.inner, cup.outer, cup.base, cup.rim, out)
    g0, g1 = out[0], out[1]
    d = _box(rho, h, -cup.outer, cup.outer, cup.base, cup.base + cup.floor, out)
    if d < best:
        best, g0, g1 = d, out[0], out[1]
    d = _box(rho, h, -cup.neck, cup.neck, cup.base - 1.0, cup.base, out)
    if d < best:
        best, g0, g1 = d, out[0], out[1]
    out[0], out[1] = g0, g1
    return best


@_jit
def _in_cup(x: FloatArray, point: FloatArray, axis: FloatArray, normal: FloatArray) -> float:
    """Height of ``x`` over the tool point; the way from the axis to it into ``normal`` (3,)."""
    h = 0.0
    for c in range(3):
        h += (x[c] - point[c]) * axis[c]
    for c in range(3):
        normal[c] = x[c] - point[c] - h * axis[c]
    return h


@_jit
def _fruit_gap(
    x: FloatArray, radius: float, point: FloatArray, axis: FloatArray, cup: Cup,
    normal: FloatArray, flat: FloatArray,
) -> float:  # fmt: skip
    """Gap of a fruit to the cup, the direction it is pushed in into ``normal`` (3,)."""
    h = _in_cup(x, point, axis, normal)
    rho = math.sqrt(normal[0] ** 2 + normal[1] ** 2 + normal[2] ** 2)
    d = cup_distance(rho, h, cup, flat)
    out = flat[0] / rho if rho > 1e-9 else 0.0
    for c in range(3):
        normal[c] = out * normal[c] + flat[1] * axis[c]
    return d - radius


@_jit
def _stem_gap(
    x: FloatArray, radius: float, within: bool, point: FloatArray, axis: FloatArray, cup: Cup,
    normal: FloatArray,
) -> float:  # fmt: skip
    """Gap of a piece of stem to wall or neck, on the side of the wall where its fruit is.

    A wall is thinner than a stem moves in a step, so the distance is not asked for the side.
    """
    h = _in_cup(x, point, axis, normal)
    rho = math.sqrt(normal[0] ** 2 + normal[1] ** 2 + normal[2] ** 2)
    if h > cup.rim + 1e-6 or rho < 1e-9:
        return 1.0
    sign = 1.0
    if h < cup.base - 1e-6:
        gap = rho - cup.neck - radius
    elif within:
        gap, sign = cup.inner - rho - radius, -1.0
    else:
        gap = rho - cup.outer - radius
    for c in range(3):
        normal[c] *= sign / rho
    return gap


@_jit
def _shortened(shortening: FloatArray, u: FloatArray) -> float:
    """How far a stem's deflections draw its end up [m]."""
    loaded = len(shortening)
    up = 0.0
    for a in range(loaded):
        for b in range(loaded):
            up += 0.5 * shortening[a, b] * (u[a] * u[b] + u[loaded + a] * u[loaded + b])
    return up


@_jit
def _place(
    root: FloatArray, axes: FloatArray, shape: FloatArray, u: FloatArray, length: float,
    share: float, x: FloatArray,
) -> None:  # fmt: skip
    """Where the point at a share of a stem is, into ``x`` (3,)."""
    n, loaded = shape.shape[0] - 1, shape.shape[1]
    k = min(int(share * n), n - 1)
    t = share * n - k
    w1 = w2 = 0.0
    for a in range(loaded):
        w = (1.0 - t) * shape[k, a] + t * shape[k + 1, a]
        w1 += w * u[a]
        w2 += w * u[loaded + a]
    along = length * share
    for c in range(3):
        x[c] = root[c] + w1 * axes[0, c] + w2 * axes[1, c] + along * axes[2, c]


@_jit
def _level(root: FloatArray, axes: FloatArray, length: float, x: FloatArray) -> float:
    """Share of a stem, as it is at rest, that is level with ``x``; 0 beyond its ends."""
    d = 0.0
    for c in range(3):
        d += (x[c] - root[c]) * axes[2, c]
    share = d / length
    return share if 0.0 < share < 1.0 else 0.0


@_jit
def _begin(
    stiffness: FloatArray, u: FloatArray, ahead: FloatArray, inertia: float,
    gradient: FloatArray, hessian: FloatArray,
) -> None:  # fmt: skip
    """Energy of stem and inertia: gradient (2L,) and Hessian (2L, 2L)."""
    loaded = len(stiffness)
    gradient[:] = 0.0
    hessian[:] = 0.0
    for a in range(loaded):
        for b in range(loaded):
            k = stiffness[a, b]
            gradient[a] += k * u[b]
            gradient[loaded + a] += k * u[loaded + b]
            hessian[a, b] = k
            hessian[loaded + a, loaded + b] = k
    for a in (loaded - 1, 2 * loaded - 1):
        gradient[a] += inertia * (u[a] - ahead[a])
        hessian[a, a] += inertia


@_jit
def _press(
    axes: FloatArray, shape: FloatArray, shortening: FloatArray, u: FloatArray, share: float,
    normal: FloatArray, depth: float, spring: float, j: FloatArray, gradient: FloatArray,
    hessian: FloatArray,
) -> None:  # fmt: skip
    """Add a spring [N/m], pressed by ``depth``, that pushes a share of a stem along ``normal``."""
    n, loaded = shape.shape[0] - 1, shape.shape[1]
    k = min(int(share * n), n - 1)
    t = share * n - k
    n1 = n2 = n3 = 0.0
    for c in range(3):
        n1 += normal[c] * axes[0, c]
        n2 += normal[c] * axes[1, c]
        n3 += normal[c] * axes[2, c]
    for a in range(loaded):
        w = (1.0 - t) * shape[k, a] + t * shape[k + 1, a]
        d1 = d2 = 0.0
        for b in range(loaded):
            d1 += shortening[a, b] * u[b]
            d2 += shortening[a, b] * u[loaded + b]
        j[a] = w * n1 - share * n3 * d1
        j[loaded + a] = w * n2 - share * n3 * d2
    for a in range(2 * loaded):
        gradient[a] -= spring * depth * j[a]
        for b in range(a + 1):
            hessian[a, b] += spring * j[a] * j[b]


@_jit
def _apart(x: FloatArray, y: FloatArray, normal: FloatArray) -> float:
    """Distance of two points, the direction from ``y`` to ``x`` into ``normal`` (3,)."""
    d = math.sqrt((x[0] - y[0]) ** 2 + (x[1] - y[1]) ** 2 + (x[2] - y[2]) ** 2)
    for c in range(3):
        normal[c] = (x[c] - y[c]) / d if d > 1e-9 else 0.0
    return d


@_jit
def _overlapping(s: Stems) -> BoolArray:
    """What is in one another at rest and so does not touch: (N, N, 2) fruits; fruit and stem.

    ``[i, o, 0]``: fruit ``i`` in fruit ``o``; ``[i, o, 1]``: fruit ``i`` in stem ``o``.
    """
    count, loaded = s.stiffness.shape[0], s.stiffness.shape[1]
    out = np.zeros((count, count, 2), dtype=np.bool_)
    still, x, y, normal = np.zeros(2 * loaded), np.empty(3), np.empty(3), np.empty(3)
    for i in range(count):
        _place(s.root[i], s.axes[i], s.shape[i], still, s.length[i], 1.0, x)
        for o in range(count):
            if o == i:
                continue
            _place(s.root[o], s.axes[o], s.shape[o], still, s.length[o], 1.0, y)
            out[i, o, 0] = _apart(x, y, normal) < s.radius[i] + s.radius[o]
            level = _level(s.root[o], s.axes[o], s.length[o], x)
            _place(s.root[o], s.axes[o], s.shape[o], still, s.length[o], level, y)
            out[i, o, 1] = _apart(x, y, normal) < s.radius[i] + s.thickness[o]
    return out


@_jit
def push(
    s: Stems, points: FloatArray, axes: FloatArray, dt: float, cup: Cup, solid: Obstacles,
    positions: FloatArray, forces: FloatArray, stem_forces: FloatArray,
) -> None:  # fmt: skip
    """Lead the cup along a path.

    Args:
        s: the N stems.
        points: (P, 3) of the tool point; ``axes`` (P, 3) out of the mouth.
        dt: between points [s].
        cup: its shape.
        solid: what fruits are pressed against; stems grow beside it.
        positions: (P, N, 3) out, of the fruits [m].
        forces: (P, N) out, largest contact force on each fruit [N].
        stem_forces: (P, N) out, of the cup on each stem [N].
    """
    count, loaded = s.stiffness.shape[0], s.stiffness.shape[1]
    n, dofs = s.shape.shape[1] - 1, 2 * loaded
    u, before, ahead = np.zeros((count, dofs)), np.zeros((count, dofs)), np.zeros((count, dofs))
    up, center, began = np.zeros(count), np.empty((count, 3)), np.empty((count, 3))
    gradient, hessian, j = np.empty(dofs), np.empty((dofs, dofs)), np.empty(dofs)
    y, normal, flat, total = np.empty(3), np.empty(3), np.empty(2), np.empty(3)
    resting = np.ones(count, dtype=np.bool_)
    touching = _overlapping(s)
    walls = len(solid.kind)
    for i in range(count):
        _place(s.root[i], s.axes[i], s.shape[i], u[i], s.length[i], 1.0, center[i])
    for p in range(len(points)):
        point, axis = points[p], axes[p]
        cup_began = points[max(p - 1, 0)]
        for i in range(count):
            for c in range(3):
                began[i, c] = center[i, c]
            for a in range(dofs):
                ahead[i, a] = u[i, a] + LIVELY * (u[i, a] - before[i, a])
                before[i, a] = u[i, a]
        for _ in range(ITERATIONS):
            moved = 0.0
            for i in range(count):
                root, frame, shape = s.root[i], s.axes[i], s.shape[i]
                stiffness, shortening = s.stiffness[i], s.shortening[i]
                length, radius, thin = s.length[i], s.radius[i], s.thickness[i]
                ui, x = u[i], center[i]
                begun = not resting[i]
                inertia = s.mass[i] / (dt * dt)
                if begun:
                    _begin(stiffness, ui, ahead[i], inertia, gradient, hessian)
                largest = 0.0
                total[:] = 0.0
                last = 1.0 - radius / length
                h = _in_cup(x, point, axis, normal)
                rho = math.sqrt(normal[0] ** 2 + normal[1] ** 2 + normal[2] ** 2)
                within = h > cup.base and rho < cup.inner
                # the stem's pieces level with the cup, and those at its rim and base
                for c in range(3):
                    y[c] = point[c] + cup.rim * axis[c]
                top = _level(root, frame, length, y)
                for c in range(3):
                    y[c] = point[c] + (cup.base - NECK_LOOKED_AT) * axis[c]
                low = _level(root, frame, length, y)
                for c in range(3):
                    y[c] = point[c] + cup.base * axis[c]
                bottom = _level(root, frame, length, y)
                first = int(top * n) + 1
                pieces = max((int(low * n) if low > 0.0 else int(last * n)) - first + 1, 0)
                others = count - 1
                for what in range(3 * others + 1 + walls + 2 + pieces):
                    on_stem = False
                    share = 1.0
                    if what == 0:  # the fruit and the cup
                        gap = _fruit_gap(x, radius, point, axis, cup, normal, flat)
                    elif what <= 3 * others:  # fruit and fruit, fruit and stem, stem and fruit
                        o = (what - 1) // 3
                        o += 1 if o >= i else 0
                        if what % 3 == 1:
                            if touching[i, o, 0]:
                                continue
                            gap = _apart(x, center[o], normal) - radius - s.radius[o]
                        elif what % 3 == 2:
                            level = _level(s.root[o], s.axes[o], s.length[o], x)
                            if level == 0.0 or touching[i, o, 1]:
                                continue
                            _place(
                                s.root[o], s.axes[o], s.shape[o], u[o], s.length[o] - up[o],
                                level, y,
                            )  # fmt: skip
                            gap = _apart(x, y, normal) - radius - s.thickness[o]
                        else:
                            share = _level(root, frame, length, center[o])
                            if share == 0.0 or share > last or touching[o, i, 1]:
                                continue
                            _place(root, frame, shape, ui, length - up[i], share, y)
                            gap = _apart(y, center[o], normal) - s.radius[o] - thin
                    elif what <= 3 * others + walls:  # the fruit and what stands firm
                        k = what - 3 * others - 1
                        gap, normal[0], normal[1], normal[2] = distance_and_gradient(
                            solid, k, x[0], x[1], x[2]
                        )
                        gap -= radius
                    else:  # the stem and the cup
                        on_stem = True
                        k = what - 3 * others - 1 - walls
                        share = top if k == 0 else bottom if k == 1 else (first + k - 2) / n
                        if share == 0.0 or share > last:
                            continue
                        _place(root, frame, shape, ui, length - up[i], share, y)
                        gap = _stem_gap(y, thin, within, point, axis, cup, normal)
                    if gap >= 0.0:
                        continue
                    if not begun:
                        begun = True
                        resting[i] = False
                        _begin(stiffness, ui, ahead[i], inertia, gradient, hessian)
                    _press(
                        frame,
                        shape,
                        shortening,
                        ui,
                        share,
                        normal,
                        -gap,
                        CONTACT,
                        j,
                        gradient,
                        hessian,
                    )
                    if what == 0:  # the cup rubs on the fruit
                        rub = 0.0
                        along = 0.0
                        for c in range(3):
                            y[c] = x[c] - began[i, c] - (point[c] - cup_began[c])
                            along += y[c] * normal[c]
                        for c in range(3):
                            y[c] -= along * normal[c]
                            rub += y[c] * y[c]
                        rub = math.sqrt(rub)
                        if rub > 1e-7:
                            for c in range(3):
                                y[c] /= -rub
                            spring = FRICTION * -gap * CONTACT / max(rub, STUCK)
                            _press(
                                frame,
                                shape,
                                shortening,
                                ui,
                                1.0,
                                y,
                                rub,
                                spring,
                                j,
                                gradient,
                                hessian,
                            )
                    if on_stem:
                        for c in range(3):
                            total[c] -= gap * CONTACT * normal[c]
                    elif share == 1.0:
                        largest = max(largest, -gap * CONTACT)
                forces[p, i] = largest
                stem_forces[p, i] = math.sqrt(total[0] ** 2 + total[1] ** 2 + total[2] ** 2)
                if not begun:
                    continue
                cholesky_solve(hessian, gradient)
                far = 0.0
                for a in range(loaded):
                    far = max(far, math.hypot(gradient[a], gradient[loaded + a]))
                scale = 1.0 if far <= FARTHEST else FARTHEST / far
                moved = max(moved, far * scale)
                for a in range(dofs):
                    ui[a] -= scale * gradient[a]
                up[i] = _shortened(shortening, ui)
                _place(root, frame, shape, ui, length - up[i], 1.0, x)
            if moved < SETTLED:
                break
        for i in range(count):
            positions[p, i] = center[i]


@_jit
def _inside(x: FloatArray, point: FloatArray, axis: FloatArray, cup: Cup, way: FloatArray) -> bool:
    h = _in_cup(x, point, axis, way)
    rho = math.sqrt(way[0] ** 2 + way[1] ** 2 + way[2] ** 2)
    return rho < cup.inner and cup.base < h < cup.rim - BARELY


def harm(
    s: Stems, points: FloatArray, axes: FloatArray, dt: float, cup: Cup, solid: Obstacles
) -> Harm:
    """What the cup, led along a path (see :func:`push`), does to the fruits; the first is wanted.

    A force lasts as long as it does not fall for :data:`HELD` steps.
    """
    return Harm(*_harm(s, points, axes, dt, cup, solid))


# A kernel returns no named tuple: Numba calls its class to make one, and does not survive an
# interruption there.
@_jit
def _harm(
    s: Stems, points: FloatArray, axes: FloatArray, dt: float, cup: Cup, solid: Obstacles
) -> tuple[float, float, float, float, bool]:
    """See :func:`harm`."""
    count, steps = s.stiffness.shape[0], len(points)
    positions, way = np.zeros((steps, count, 3)), np.empty(3)
    forces, stem_forces = np.zeros((steps, count)), np.zeros((steps, count))
    push(s, points, axes, dt, cup, solid, positions, forces, stem_forces)
    stem = fruit = target = inside = 0.0
    for i in range(count):
        spell = 0
        for p in range(steps):
            if p >= HELD - 1:
                lasting = lasting_target = np.inf
                for q in range(p - HELD + 1, p + 1):
                    lasting = min(lasting, stem_forces[q, i])
                    lasting_target = min(lasting_target, forces[q, i])
                stem = max(stem, lasting)
                if i == 0:
                    target = max(target, lasting_target)
            if i > 0:
                fruit = max(fruit, forces[p, i])
                if _inside(positions[p, i], points[p], axes[p], cup, way):
                    spell += 1
                    inside = max(inside, spell * dt)
                else:
                    spell = 0
    missed = not _inside(positions[-1, 0], points[-1], axes[-1], cup, way)
    return stem, fruit, target, inside, missed
