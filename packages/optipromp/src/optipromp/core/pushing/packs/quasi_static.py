r"""Planar pushing: a quasi-static model of objects on a plane that a tool pushes.

Slow pushes have no inertia: the objects move so that friction with the plane does the least work.
With an ellipsoid as the limit surface of each object, a push leads to the velocities
:math:`(v_b, ω_b)` that minimise

.. math:: \tfrac12\sum_b f_b\,(\lVert v_b\rVert^2 + ρ_b^2 ω_b^2)

where no two bodies overlap. :math:`f_b = μ m_b g` is the sliding friction of object b and
:math:`ρ_b` its friction moment over its friction. The model takes steps of a few millimetres and
resolves the contacts in turn (position-based dynamics). The tangential part of a contact is at most
the share μ of its normal part (Coulomb friction).

Objects are discs or convex polygons in coordinates (u, v): along the approach and along y_g. The
tool is a set of convex polygons that moves along a path. Walls are convex polygons at rest.
"""

import math
from typing import NamedTuple

import numpy as np

from optipromp.core.arrays import FloatArray
from optipromp.core.compiled import inlined, inner, kernel
from optipromp.core.pushing.packs import flat
from optipromp.core.pushing.parameters import PUSH

PLANE = PUSH.plane


class Bench(NamedTuple):
    """Objects around the target, in (u, v): along z_g and along y_g from the target."""

    objects: flat.Shapes  # the target first, then the pushables, about their centres
    yields: FloatArray  # (B,) 1 over the sliding friction 1/f of each object [1/N]
    lever2: FloatArray  # (B,) squares ρ² of the friction moments over the frictions [m²]
    walls: flat.Shapes  # static objects at the target's height
    hand: flat.Shapes  # outlines of the hand and of the wrist behind it, about the tool point
    mouth: FloatArray  # (3,) u of palm and finger tips, half the opening of the fingers [m]
    edge: float  # u of the board's front, behind which objects must stay [m]


class Pushed(NamedTuple):
    """The result of a push."""

    state: FloatArray  # (B, 3) final poses of the objects: u, v [m], turn [rad]
    # estimate of the largest force on an object in a step [N]: the multipliers of its contacts over
    # the step of the tool. It is about the friction of all objects that slide, and grows without
    # bound where an object jams
    force: float
    # largest overlap that could not be resolved: an object is pressed against a wall [m]
    jam: float
    done: float  # share of the path after which the push ended; 1: at the end of the path


def push_once(
    bench: Bench, path: FloatArray, state: FloatArray, slip: float, most: float = np.inf
) -> Pushed:
    """Move the hand along a path, and the objects with it; see :func:`pushed`."""
    end, report = np.array(state, dtype=np.float64), np.zeros(3)
    pushed(bench, np.ascontiguousarray(path, dtype=np.float64), end, slip, most, np.inf, report)
    return Pushed(end, *report.tolist())


class _Step(NamedTuple):
    """One step of the hand."""

    state: FloatArray  # (B, 3) poses of the objects: u, v [m], turn [rad]; changed in place
    before: FloatArray  # (B, 3) poses at the beginning of the step
    press: FloatArray  # (B,) sum of the normal multipliers of the contacts of each object [N m]
    slip: float  # coefficient of friction
    u: float  # of the tool point [m]
    v: float  # of the tool point [m]
    du: float  # motion of the tool point [m]
    dv: float  # motion of the tool point [m]
    turn: float  # of the hand in this step [rad]


@inlined
def _resolve(bench, step, i, j, hit, depth, away):
    """Move bodies i and j apart by ``depth``, and apply friction.

    i = −1 is a body that does not yield, with the motion ``away`` [m] at the contact.
    """
    state, before, yields, lever2 = step.state, step.before, bench.yields, bench.lever2
    nx, ny, px, py = hit[0], hit[1], hit[2], hit[3]
    tx, ty = -ny, nx
    bx, by = px - state[j, 0], py - state[j, 1]
    normal_b, tangent_b = bx * ny - by * nx, bx * ty - by * tx
    k = yields[j] * (1.0 + normal_b * normal_b / lever2[j])
    kt = yields[j] * (1.0 + tangent_b * tangent_b / lever2[j])
    turn = state[j, 2] - before[j, 2]
    sx = state[j, 0] - before[j, 0] - turn * by
    sy = state[j, 1] - before[j, 1] + turn * bx
    ax = ay = normal_a = tangent_a = 0.0
    if i >= 0:
        ax, ay = px - state[i, 0], py - state[i, 1]
        normal_a, tangent_a = ax * ny - ay * nx, ax * ty - ay * tx
        k += yields[i] * (1.0 + normal_a * normal_a / lever2[i])
        kt += yields[i] * (1.0 + tangent_a * tangent_a / lever2[i])
        turn = state[i, 2] - before[i, 2]
        sx -= state[i, 0] - before[i, 0] - turn * ay
        sy -= state[i, 1] - before[i, 1] + turn * ax
    else:
        sx -= away[0]
        sy -= away[1]
    normal = depth / k
    tangent = -(sx * tx + sy * ty) / kt
    tangent = min(step.slip * normal, max(-step.slip * normal, tangent))
    fx, fy = normal * nx + tangent * tx, normal * ny + tangent * ty
    step.press[j] += normal
    state[j, 0] += yields[j] * fx
    state[j, 1] += yields[j] * fy
    state[j, 2] += yields[j] * (normal * normal_b + tangent * tangent_b) / lever2[j]
    if i >= 0:
        step.press[i] += normal
        state[i, 0] -= yields[i] * fx
        state[i, 1] -= yields[i] * fy
        state[i, 2] -= yields[i] * (normal * normal_a + tangent * tangent_a) / lever2[i]


@inlined
def _follow(bench, state, b, bodies):
    """Place the outline of object b at its state."""
    flat.place(bench.objects, b, state[b, 0], state[b, 1], state[b, 2], bodies, b)


@inner
def _near(bodies, parts, pairs):
    """List ``pairs`` (P, 3) of a body and an object closer than ``PLANE.ahead``; returns P.

    Bodies are the objects, the ``parts`` of the hand and the walls, in this order. Each object is
    paired with the hand first, then with the objects before it, then with walls. The third column
    is for :func:`optipromp.core.pushing.packs.flat.polygons`.
    """
    n, count = 0, bodies.objects
    for j in range(count):
        for turn in range(len(bodies.at)):
            i = turn + count if turn < parts else turn - parts if turn < parts + count else turn
            if (i < count and i >= j) or flat.apart(bodies, i, j, PLANE.ahead):
                continue
            pairs[n, 0], pairs[n, 1], pairs[n, 2] = i, j, 0
            n += 1
    return n


@inner
def _outlines(bench, state, bodies):
    """Fill ``bodies`` with objects and walls; the hand is placed by :func:`_lead`."""
    objects, hand, walls = bench.objects, bench.hand, bench.walls
    b = 0
    for shapes in (objects, hand, walls):
        for i in range(len(shapes.size)):
            bodies.size[b], bodies.radius[b] = shapes.size[i], shapes.radius[i]
            b += 1
    for i in range(bodies.objects):
        _follow(bench, state, i, bodies)
    for w in range(len(walls.size)):
        b = bodies.objects + len(hand.size) + w
        flat.place(walls, w, 0.0, 0.0, 0.0, bodies, b)
        flat.enclose(bodies, b)


@inlined
def _lead(hand, bodies, step, turn, anew):
    """Move the hand's parts: to the pose of the step where ``anew``, else by ``du`` and ``dv``."""
    corners, boxes = bodies.corners, bodies.boxes
    for h in range(len(hand.size)):
        b = bodies.objects + h
        if anew:
            flat.place(hand, h, step.u, step.v, turn, bodies, b)
            flat.enclose(bodies, b)
            continue
        for k in range(bodies.size[b]):
            corners[b, k, 0] += step.du
            corners[b, k, 1] += step.dv
        boxes[b, 0], boxes[b, 2] = boxes[b, 0] + step.du, boxes[b, 2] + step.du
        boxes[b, 1], boxes[b, 3] = boxes[b, 1] + step.dv, boxes[b, 3] + step.dv


@inlined
def _sweep(bench, bodies, step, pairs, n, hit):
    """Resolve the contacts of n near pairs in turn; returns their largest overlap [m]."""
    count, worst = bodies.objects, 0.0
    for p in range(n):
        i, j = pairs[p, 0], pairs[p, 1]
        if flat.apart(bodies, i, j, 0.0):
            continue
        depth = flat.contact(bodies, i, j, pairs, p, hit)
        if depth <= 0.0:
            continue
        worst = max(worst, depth)
        away = 0.0, 0.0
        if count <= i < count + len(bench.hand.size):
            away = step.du - step.turn * (hit[3] - step.v), step.dv + step.turn * (hit[2] - step.u)
        yielding = i if i < count else -1
        _resolve(bench, step, yielding, j, hit, depth, away)
        _follow(bench, step.state, j, bodies)
        if yielding >= 0:
            _follow(bench, step.state, i, bodies)
    return worst


@kernel
def pushed(bench, path, state, slip, most, hardest, report):
    """Move the hand along a path, and the objects with it.

    ``path``: (T, 3) of the tool point: u, v [m] and turn [rad], in steps of 1 to 5 mm. ``state``:
    (B, 3) poses of the objects: u, v [m], turn [rad], in and out. ``slip``: coefficient of friction
    between objects, and with the hand. ``most``: motion of the first object at which the push is
    stopped [m]. ``hardest``: force at which the push is stopped [N]. ``report``: (3,) out: force,
    jam and done, see :class:`Pushed`.
    """
    first_u, first_v = state[0, 0], state[0, 1]
    count, parts = len(state), len(bench.hand.size)
    total = count + parts + len(bench.walls.size)
    bodies = flat.Bodies(
        count, np.empty((total, flat.CORNERS, 2)), np.empty((total, flat.CORNERS, 2)),
        np.empty(total, dtype=np.int64), np.empty(total), np.zeros((total, 2)),
        np.empty((total, 4)),
    )  # fmt: skip
    pairs = np.empty((count * total, 3), dtype=np.int64)
    before, seen, hit, press = state.copy(), state.copy(), np.empty(4), np.zeros(count)
    _outlines(bench, state, bodies)
    n, gone, shifted = -1, 0.0, 0.0
    report[:] = 0.0
    for t in range(len(path)):
        past = max(t - 1, 0)
        step = _Step(
            state, before, press, slip, path[t, 0], path[t, 1], path[t, 0] - path[past, 0],
            path[t, 1] - path[past, 1], path[t, 2] - path[past, 2],
        )  # fmt: skip
        moved = math.sqrt(step.du * step.du + step.dv * step.dv)
        _lead(bench.hand, bodies, step, path[t, 2], t == 0 or step.turn != 0.0)
        gone += moved
        if n < 0 or step.turn != 0.0 or max(gone, shifted) > 0.35 * PLANE.ahead:
            n = _near(bodies, parts, pairs)
            gone = shifted = 0.0
            seen[:] = state
        before[:] = state
        press[:] = 0.0
        worst = 0.0
        for _ in range(PLANE.sweeps):
            worst = _sweep(bench, bodies, step, pairs, n, hit)
            if worst < PLANE.settled:
                break
        report[1] = max(report[1], worst)
        if moved > 1e-6:
            for b in range(count):
                report[0] = max(report[0], press[b] / moved)
        report[2] = (t + 1.0) / len(path)
        off = math.sqrt((state[0, 0] - first_u) ** 2 + (state[0, 1] - first_v) ** 2)
        if worst > PLANE.jammed or off > most or report[0] > hardest:
            return
        for b in range(count):
            far = max(abs(state[b, 0] - seen[b, 0]), abs(state[b, 1] - seen[b, 1]))
            shifted = max(shifted, far)
