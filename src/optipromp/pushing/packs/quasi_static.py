r"""Planar pushing: a quasi-static model of objects on a plane that a tool pushes.

Slow pushes have no inertia: the objects move so that friction with the plane does the least work.
With an ellipsoid as the limit surface of each object, a push leads to the velocities
:math:`(v_b, ω_b)` that minimise

.. math:: \tfrac12\sum_b f_b\,(\lVert v_b\rVert^2 + ρ_b^2 ω_b^2)

where no two bodies overlap. :math:`f_b = μ m_b g` is the sliding friction of object b and
:math:`ρ_b` its friction moment over its friction. The model takes steps of a few millimetres and
resolves the contacts in turn (position-based dynamics). Along a slipping contact it applies at most
the share μ of the normal part (Coulomb friction).

Objects are discs or convex polygons in coordinates (u, v): along the approach and along y_g. The
tool is a set of convex polygons that moves along a given path. Walls are convex polygons at rest.
"""

import math
from typing import NamedTuple

import numpy as np

from optipromp.arrays import FloatArray, IntArray
from optipromp.compiled import inner, kernel
from optipromp.pushing.packs.flat import CORNERS, Shapes, bounds, contact, outside, placed
from optipromp.pushing.parameters import PUSH

NO_OVERLAP, SWEEPS = PUSH.plane.settled, PUSH.plane.sweeps
JAMMED, AHEAD = PUSH.plane.jammed, PUSH.plane.ahead


class Pushed(NamedTuple):
    """The result of a push.

    Attributes:
        state: (B, 3) final poses of the objects: u, v [m], turn [rad].
        force: estimate of the largest force on an object in one step [N]: the multipliers of its
            contacts over the step of the tool. For objects that slide freely it is about the
            friction of all that is pushed. For objects that jam it grows without bound.
        jam: largest overlap that could not be resolved: an object is pressed against a wall [m].
        done: share of the path after which the push ended: 1, or less where an object jammed or
            the first object moved farther than it may.
    """

    state: FloatArray
    force: float
    jam: float
    done: float


def push(
    path: FloatArray,
    tool: Shapes,
    objects: Shapes,
    state: FloatArray,
    friction: FloatArray,
    lever: FloatArray,
    walls: Shapes,
    slip: float,
    most: float = np.inf,
) -> Pushed:
    """Move the tool along a path, and the objects before it.

    Args:
        path: (T, 3) of the tool point: u, v [m] and turn [rad], in steps of 1 to 5 mm.
        tool: its parts, about the tool point.
        objects: B of them, about their centres.
        state: (B, 3) their poses: u, v [m], turn [rad].
        friction: (B,) sliding friction of each [N].
        lever: (B,) friction moment of each over its friction [m].
        walls: bodies at rest, in place.
        slip: coefficient of friction between objects, and with the tool.
        most: how far the first object may move before the push is stopped [m].
    """
    end = np.array(state, dtype=np.float64)
    report = np.zeros(3)
    pushed(
        np.ascontiguousarray(path, dtype=np.float64), tool, objects, end, 1.0 / friction, lever**2,
        walls, slip, most, np.inf, report,
    )  # fmt: skip
    return Pushed(end, float(report[0]), float(report[1]), float(report[2]))


@inner
def _resolve(  # type: ignore[no-untyped-def]
    state, before, yields, lever2, i, j, hit, depth, slip, away_u, away_v, press
):
    """Move i and j apart. i = −1: a body that does not yield, moved by ``away`` at the contact."""
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
        sx -= away_u
        sy -= away_v
    normal = depth / k
    press[j] += normal
    if i >= 0:
        press[i] += normal
    tangent = -(sx * tx + sy * ty) / kt
    tangent = min(slip * normal, max(-slip * normal, tangent))
    fx, fy = normal * nx + tangent * tx, normal * ny + tangent * ty
    state[j, 0] += yields[j] * fx
    state[j, 1] += yields[j] * fy
    state[j, 2] += yields[j] * (normal * normal_b + tangent * tangent_b) / lever2[j]
    if i >= 0:
        state[i, 0] -= yields[i] * fx
        state[i, 1] -= yields[i] * fy
        state[i, 2] -= yields[i] * (normal * normal_a + tangent * tangent_a) / lever2[i]


@inner
def _follow(objects, state, b, at, corners, normals):  # type: ignore[no-untyped-def]
    """Place the outline of object b at its state."""
    at[b, 0], at[b, 1] = state[b, 0], state[b, 1]
    if objects.size[b]:
        placed(objects, b, state[b, 0], state[b, 1], state[b, 2], corners, normals, b)


@inner
def _near(at, radius, boxes, count, parts, pairs):  # type: ignore[no-untyped-def]
    """Pairs (P, 2) of a body and an object less than AHEAD apart, in place; returns how many.

    Bodies are the objects, the parts of the tool and the walls, in this order. Each object is
    paired with the tool first, then with the objects before it, then with walls.
    """
    n = 0
    for j in range(count):
        reach = radius[j] + AHEAD
        for turn in range(at.shape[0]):
            i = turn + count if turn < parts else turn - parts if turn < parts + count else turn
            if i < count:
                if i >= j:
                    continue
                du, dv = at[j, 0] - at[i, 0], at[j, 1] - at[i, 1]
                far = reach + radius[i]
                if du * du + dv * dv > far * far:
                    continue
            elif outside(boxes, i, at[j, 0], at[j, 1], reach):
                continue
            pairs[n, 0], pairs[n, 1] = i, j
            n += 1
    return n


class _Bodies(NamedTuple):
    """The objects, then the parts of the tool, then the walls: N outlines in place.

    Attributes:
        corners, normals: (N, CORNERS, 2) of polygons.
        size: (N,) how many corners, 0 for a disc; ``radius`` (N,) [m].
        at: (N, 2) centres [m]; ``boxes`` (N, 4) about tool and walls.
    """

    corners: FloatArray
    normals: FloatArray
    size: IntArray
    radius: FloatArray
    at: FloatArray
    boxes: FloatArray


@inner
def _outlines(objects, tool, walls, state, bodies):  # type: ignore[no-untyped-def]
    """Fill ``bodies``, the objects where they stand; the tool is placed by :func:`_lead`."""
    count, parts = state.shape[0], tool.size.shape[0]
    for b in range(count):
        bodies.size[b], bodies.radius[b] = objects.size[b], objects.radius[b]
        _follow(objects, state, b, bodies.at, bodies.corners, bodies.normals)
    for h in range(parts):
        bodies.size[count + h], bodies.radius[count + h] = tool.size[h], tool.radius[h]
    for w in range(walls.size.shape[0]):
        b = count + parts + w
        bodies.size[b], bodies.radius[b] = walls.size[w], walls.radius[w]
        for k in range(4):
            bodies.boxes[b, k] = walls.box[w, k]
        for k in range(CORNERS):
            for c in range(2):
                bodies.corners[b, k, c] = walls.corners[w, k, c]
                bodies.normals[b, k, c] = walls.normals[w, k, c]


@inner
def _lead(tool, count, bodies, u, v, turn, du, dv, anew):  # type: ignore[no-untyped-def]
    """Bring the tool's parts to a pose; without a turn they are shifted by (du, dv)."""
    corners, boxes = bodies.corners, bodies.boxes
    for h in range(count, count + tool.size.shape[0]):
        bodies.at[h, 0], bodies.at[h, 1] = u, v
        if anew:
            placed(tool, h - count, u, v, turn, corners, bodies.normals, h)
            bounds(corners, bodies.size[h], h, boxes)
            continue
        for k in range(bodies.size[h]):
            corners[h, k, 0] += du
            corners[h, k, 1] += dv
        boxes[h, 0], boxes[h, 2] = boxes[h, 0] + du, boxes[h, 2] + du
        boxes[h, 1], boxes[h, 3] = boxes[h, 1] + dv, boxes[h, 3] + dv


@inner
def _sweep(  # type: ignore[no-untyped-def]
    objects, state, before, yields, lever2, bodies, pairs, n, last, tool_end, step, slip, hit, press
):
    """Resolve the contacts of n near pairs in turn; returns the largest overlap that was met [m].

    ``tool_end`` is the number of objects and parts of the tool. ``step`` holds the tool's position
    (u, v) and its motion (du, dv, turn).
    """
    corners, normals, size, radius = bodies.corners, bodies.normals, bodies.size, bodies.radius
    at, boxes, count = bodies.at, bodies.boxes, state.shape[0]
    u, v, du, dv, dturn = step
    worst = 0.0
    for p in range(n):
        i, j = pairs[p, 0], pairs[p, 1]
        if i < count:
            reach = radius[i] + radius[j]
            su, sv = at[j, 0] - at[i, 0], at[j, 1] - at[i, 1]
            if su * su + sv * sv > reach * reach:
                continue
        elif outside(boxes, i, at[j, 0], at[j, 1], radius[j]):
            continue
        depth = contact(corners, normals, size, at, radius, i, j, last, p, hit)
        if depth <= 0.0:
            continue
        worst = max(worst, depth)
        away_u = away_v = 0.0
        if count <= i < tool_end:
            away_u, away_v = du - dturn * (hit[3] - v), dv + dturn * (hit[2] - u)
        yielding = i if i < count else -1
        _resolve(
            state, before, yields, lever2, yielding, j, hit, depth, slip, away_u, away_v, press
        )
        _follow(objects, state, j, at, corners, normals)
        if yielding >= 0:
            _follow(objects, state, yielding, at, corners, normals)
    return worst


@kernel
def pushed(  # type: ignore[no-untyped-def]
    path, tool, objects, state, yields, lever2, walls, slip, most, hardest, report
):
    """:func:`push` in place: ``state`` (B, 3), and ``report`` (3,) of force, jam and share done.

    ``yields`` is 1 / friction, ``lever2`` lever². It also stops at a force beyond ``hardest``.
    """
    first_u, first_v = state[0, 0], state[0, 1]
    count, parts = state.shape[0], tool.size.shape[0]
    total = count + parts + walls.size.shape[0]
    bodies = _Bodies(
        np.empty((total, CORNERS, 2)), np.empty((total, CORNERS, 2)),
        np.empty(total, dtype=np.int64), np.empty(total), np.zeros((total, 2)),
        np.empty((total, 4)),
    )  # fmt: skip
    pairs = np.empty((count * total, 2), dtype=np.int64)
    last = np.zeros(count * total, dtype=np.int64)
    before, seen, hit, press = state.copy(), state.copy(), np.empty(4), np.zeros(count)
    _outlines(objects, tool, walls, state, bodies)
    n, gone, shifted = -1, 0.0, 0.0
    report[0] = report[1] = report[2] = 0.0
    for t in range(path.shape[0]):
        u, v, turn = path[t, 0], path[t, 1], path[t, 2]
        past = max(t - 1, 0)
        du, dv, dturn = u - path[past, 0], v - path[past, 1], turn - path[past, 2]
        moved = math.sqrt(du * du + dv * dv)
        _lead(tool, count, bodies, u, v, turn, du, dv, t == 0 or dturn != 0.0)
        gone += moved
        if n < 0 or dturn != 0.0 or max(gone, shifted) > 0.35 * AHEAD:
            n = _near(bodies.at, bodies.radius, bodies.boxes, count, parts, pairs)
            gone = shifted = 0.0
            last[:n] = 0
            _copy(state, seen)
        _copy(state, before)
        press[:] = 0.0
        worst = 0.0
        for _ in range(SWEEPS):
            worst = _sweep(
                objects, state, before, yields, lever2, bodies, pairs, n, last, count + parts,
                (u, v, du, dv, dturn), slip, hit, press,
            )  # fmt: skip
            if worst < NO_OVERLAP:
                break
        report[1] = max(report[1], worst)
        if moved > 1e-6:
            hardest_now = 0.0
            for b in range(count):
                hardest_now = max(hardest_now, press[b])
            report[0] = max(report[0], hardest_now / moved)
        report[2] = (t + 1.0) / path.shape[0]
        off = math.sqrt((state[0, 0] - first_u) ** 2 + (state[0, 1] - first_v) ** 2)
        if worst > JAMMED or off > most or report[0] > hardest:
            return
        for b in range(count):
            step = max(abs(state[b, 0] - seen[b, 0]), abs(state[b, 1] - seen[b, 1]))
            shifted = max(shifted, step)


@inner
def _copy(state, out):  # type: ignore[no-untyped-def]
    """Copy poses (B, 3)."""
    for b in range(state.shape[0]):
        for k in range(3):
            out[b, k] = state[b, k]
