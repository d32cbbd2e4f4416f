r"""Things on a plane that a tool ploughs through: a quasi-static forward model.

Slow pushes have no inertia: where the tool moves into things, they move by what friction with the
plane makes cheapest. With the limit surface of each thing taken as an ellipsoid, the velocities
:math:`(v_b, ω_b)` under a push are those that minimise

.. math:: \tfrac12\sum_b f_b\,(\lVert v_b\rVert^2 + ρ_b^2 ω_b^2)

subject to nothing entering anything, :math:`f_b = μ m_b g` being the sliding friction of thing b
and :math:`ρ_b` its friction moment over its friction. The model takes steps of a millimetre or two
and projects on the contacts in turn (position-based dynamics); where surfaces would slip along one
another the contact carries at most the share μ of its normal part, as Coulomb has it.

Things are discs or convex polygons in coordinates (u, v): along the approach and along y_g. The
tool is a set of convex polygons that goes where it is told; walls are convex polygons that stand.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numba import njit

from optipromp.arrays import FloatArray, IntArray

CORNERS = 8  # of a polygon at most
SETTLED = 4e-4  # [m] of overlap that is none
SWEEPS = 25  # over the contacts, in a step
JAMMED = 4e-3  # [m] of overlap left after these at which something gives way that must not
FLAT = 1e-3  # [m] within which corners of a polygon are pressed together


class Shapes(NamedTuple):
    """Convex shapes: discs where ``size`` is 0, else polygons with corners counter-clockwise."""

    corners: FloatArray  # (B, CORNERS, 2) [m]
    size: IntArray  # (B,) how many corners
    radius: FloatArray  # (B,) [m] of a disc, or of the circle about a polygon's origin
    box: FloatArray  # (B, 4) [m] least u and v, largest u and v


class Result(NamedTuple):
    """What a push did.

    Attributes:
        state: (B, 3) where things end: u, v [m], turn [rad].
        force: estimate of the largest force on a thing in one step [N]: the multipliers of its
            contacts over the step of the tool. Where things slide freely it is about the friction
            that is pushed along; where they wedge or jam it grows without bound.
        jam: largest overlap that could not be resolved: something is pressed against a wall [m].
        done: share of the way after which it was stopped: 1, or less where something jammed or
            the first thing moved farther than it may.
    """

    state: FloatArray
    force: float
    jam: float
    done: float


def shapes(parts: Sequence[FloatArray | float]) -> Shapes:
    """Shapes of polygons (k, 2) and of discs given by their radius.

    Raises:
        ValueError: a polygon of more than :data:`CORNERS` corners.
    """
    corners = np.zeros((len(parts), CORNERS, 2))
    count, radius = np.zeros(len(parts), dtype=np.int64), np.zeros(len(parts))
    box = np.zeros((len(parts), 4))
    for i, part in enumerate(parts):
        if isinstance(part, float | int):
            radius[i], box[i] = part, [-part, -part, part, part]
            continue
        if len(part) > CORNERS:
            raise ValueError(f"a polygon has {len(part)} corners; at most {CORNERS} are taken")
        corners[i, : len(part)], count[i] = part, len(part)
        radius[i] = float(np.linalg.norm(part, axis=1).max())
        box[i] = [*part.min(axis=0), *part.max(axis=0)]
    return Shapes(corners, count, radius, box)


def push(
    path: FloatArray,
    tool: Shapes,
    things: Shapes,
    state: FloatArray,
    friction: FloatArray,
    lever: FloatArray,
    walls: Shapes,
    slip: float,
    most: float = np.inf,
) -> Result:
    """Move the tool along a path and see where things go.

    Args:
        path: (T, 3) of the tool point: u, v [m] and turn [rad], in steps of 1 to 3 mm.
        tool: its parts, about the tool point.
        things: B of them, about their centres.
        state: (B, 3) where they stand.
        friction: (B,) sliding friction of each [N].
        lever: (B,) friction moment of each over its friction [m].
        walls: what stands, in place.
        slip: coefficient of friction between things, and with the tool.
        most: how far the first thing may move before the push is stopped [m].
    """
    end = np.array(state, dtype=np.float64)
    report = np.zeros(3)
    _push(
        np.ascontiguousarray(path, dtype=np.float64), tool, things, end, 1.0 / friction, lever**2,
        walls, slip, most, report,
    )  # fmt: skip
    return Result(end, float(report[0]), float(report[1]), float(report[2]))


@njit(cache=True, error_model="numpy", nogil=True)
def _placed(corners, count, u, v, turn, out):  # type: ignore[no-untyped-def]
    c, s = math.cos(turn), math.sin(turn)
    for k in range(count):
        x, y = corners[k, 0], corners[k, 1]
        out[k, 0], out[k, 1] = u + c * x - s * y, v + s * x + c * y


@njit(cache=True, error_model="numpy", nogil=True)
def _disc_in_polygon(u, v, radius, corners, count, hit):  # type: ignore[no-untyped-def]
    """Contact of a disc and a polygon: depth; ``hit`` = normal from polygon to disc, and where."""
    deepest, nearest = -math.inf, math.inf
    nx = ny = px = py = 0.0
    for k in range(count):
        x0, y0 = corners[k, 0], corners[k, 1]
        x1, y1 = corners[(k + 1) % count, 0], corners[(k + 1) % count, 1]
        ex, ey = x1 - x0, y1 - y0
        length = math.hypot(ex, ey)
        out = ((u - x0) * ey - (v - y0) * ex) / length
        if out > deepest:
            deepest = out
            nx, ny = ey / length, -ex / length
        share = min(1.0, max(0.0, ((u - x0) * ex + (v - y0) * ey) / (length * length)))
        qx, qy = x0 + share * ex, y0 + share * ey
        away = math.hypot(u - qx, v - qy)
        if away < nearest:
            nearest, px, py = away, qx, qy
    if deepest <= 0.0:
        hit[0], hit[1] = nx, ny
        hit[2], hit[3] = u - deepest * nx, v - deepest * ny
        return radius - deepest
    hit[0], hit[1], hit[2], hit[3] = (u - px) / nearest, (v - py) / nearest, px, py
    return radius - nearest


@njit(cache=True, error_model="numpy", nogil=True)
def _face(a, na, b, nb, hit):  # type: ignore[no-untyped-def]
    """Largest separation of polygon b from a face of a, with that face's normal and where."""
    best = -math.inf
    for k in range(na):
        x0, y0 = a[k, 0], a[k, 1]
        ex, ey = a[(k + 1) % na, 0] - x0, a[(k + 1) % na, 1] - y0
        length = math.hypot(ex, ey)
        ex, ey = ex / length, ey / length
        least = math.inf
        for j in range(nb):
            least = min(least, (b[j, 0] - x0) * ey - (b[j, 1] - y0) * ex)
        if least <= best:
            continue
        best = least
        low, high = math.inf, -math.inf
        for j in range(nb):
            if (b[j, 0] - x0) * ey - (b[j, 1] - y0) * ex < least + FLAT:
                along = (b[j, 0] - x0) * ex + (b[j, 1] - y0) * ey
                low, high = min(low, along), max(high, along)
        middle = 0.5 * (min(length, max(0.0, low)) + min(length, max(0.0, high)))
        hit[0], hit[1] = ey, -ex
        hit[2], hit[3] = x0 + middle * ex, y0 + middle * ey
        if best >= 0.0:
            return best
    return best


@njit(cache=True, error_model="numpy", nogil=True)
def _contact(a, na, ua, va, ra, b, nb, ub, vb, rb, hit, spare):  # type: ignore[no-untyped-def]
    """Depth (negative: apart); ``hit``: unit normal from a to b, and where."""
    if na == 0 and nb == 0:
        du, dv = ub - ua, vb - va
        away = max(math.hypot(du, dv), 1e-12)
        hit[0], hit[1] = du / away, dv / away
        hit[2], hit[3] = ua + ra * hit[0], va + ra * hit[1]
        return ra + rb - away
    if na == 0:
        depth = _disc_in_polygon(ua, va, ra, b, nb, hit)
        hit[0], hit[1] = -hit[0], -hit[1]
        return depth
    if nb == 0:
        return _disc_in_polygon(ub, vb, rb, a, na, hit)
    one = _face(a, na, b, nb, hit)
    if one >= 0.0:
        return -one
    other = _face(b, nb, a, na, spare)
    if other > one:
        hit[0], hit[1], hit[2], hit[3] = -spare[0], -spare[1], spare[2], spare[3]
        return -other
    return -one


@njit(cache=True, error_model="numpy", nogil=True)
def _resolve(  # type: ignore[no-untyped-def]
    state, before, yields, lever2, i, j, hit, depth, slip, away, press
):
    """Move i (−1: what does not yield, and moved by ``away`` at the contact) and j apart."""
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


@njit(cache=True, error_model="numpy", nogil=True)
def _outside(box, at, radius):  # type: ignore[no-untyped-def]
    """Whether a disc is outside a box along the axes."""
    return (
        at[0] + radius <= box[0]
        or at[1] + radius <= box[1]
        or at[0] - radius >= box[2]
        or at[1] - radius >= box[3]
    )


@njit(cache=True, error_model="numpy", nogil=True)
def _beside(corners, count, at, radius):  # type: ignore[no-untyped-def]
    """Whether a disc is outside the box about a polygon along the axes."""
    u, v = corners[0, 0], corners[0, 1]
    low_u = high_u = u
    low_v = high_v = v
    for k in range(1, count):
        u, v = corners[k, 0], corners[k, 1]
        low_u, high_u = min(low_u, u), max(high_u, u)
        low_v, high_v = min(low_v, v), max(high_v, v)
    return (
        at[0] + radius <= low_u
        or at[1] + radius <= low_v
        or at[0] - radius >= high_u
        or at[1] - radius >= high_v
    )


@njit(cache=True, error_model="numpy", nogil=True)
def _push(  # type: ignore[no-untyped-def]
    path, tool, things, state, yields, lever2, walls, slip, most, report
):
    first_u, first_v = state[0, 0], state[0, 1]
    count, parts = state.shape[0], tool.size.shape[0]
    placed = np.empty((count, CORNERS, 2))
    hand = np.empty((parts, CORNERS, 2))
    before, hit, spare, away = np.empty((count, 3)), np.empty(4), np.empty(4), np.zeros(2)
    press = np.zeros(count)
    for b in range(count):
        _placed(things.corners[b], things.size[b], state[b, 0], state[b, 1], state[b, 2], placed[b])
    for t in range(path.shape[0]):
        u, v, turn = path[t, 0], path[t, 1], path[t, 2]
        last = max(t - 1, 0)
        du, dv, dturn = u - path[last, 0], v - path[last, 1], turn - path[last, 2]
        for h in range(parts):
            _placed(tool.corners[h], tool.size[h], u, v, turn, hand[h])
        before[:] = state
        press[:] = 0.0
        worst = 0.0
        for _ in range(SWEEPS):
            worst = 0.0
            for j in range(count):
                for h in range(parts):
                    if _beside(hand[h], tool.size[h], state[j], things.radius[j]):
                        continue
                    depth = _contact(
                        hand[h], tool.size[h], u, v, tool.radius[h], placed[j], things.size[j],
                        state[j, 0], state[j, 1], things.radius[j], hit, spare,
                    )  # fmt: skip
                    if depth > 0.0:
                        worst = max(worst, depth)
                        away[0] = du - dturn * (hit[3] - v)
                        away[1] = dv + dturn * (hit[2] - u)
                        _resolve(
                            state, before, yields, lever2, -1, j, hit, depth, slip, away, press
                        )
                        _placed(
                            things.corners[j], things.size[j], state[j, 0], state[j, 1],
                            state[j, 2], placed[j],
                        )  # fmt: skip
                for i in range(j):
                    reach = things.radius[i] + things.radius[j]
                    su, sv = state[j, 0] - state[i, 0], state[j, 1] - state[i, 1]
                    if su * su + sv * sv > reach * reach:
                        continue
                    depth = _contact(
                        placed[i], things.size[i], state[i, 0], state[i, 1], things.radius[i],
                        placed[j], things.size[j], state[j, 0], state[j, 1], things.radius[j],
                        hit, spare,
                    )  # fmt: skip
                    if depth > 0.0:
                        worst = max(worst, depth)
                        _resolve(state, before, yields, lever2, i, j, hit, depth, slip, away, press)
                        for b in (i, j):
                            _placed(
                                things.corners[b], things.size[b], state[b, 0], state[b, 1],
                                state[b, 2], placed[b],
                            )  # fmt: skip
                for w in range(walls.size.shape[0]):
                    if _outside(walls.box[w], state[j], things.radius[j]):
                        continue
                    depth = _contact(
                        walls.corners[w], walls.size[w], 0.0, 0.0, walls.radius[w], placed[j],
                        things.size[j], state[j, 0], state[j, 1], things.radius[j], hit, spare,
                    )  # fmt: skip
                    if depth > 0.0:
                        worst = max(worst, depth)
                        away[:] = 0.0
                        _resolve(
                            state, before, yields, lever2, -1, j, hit, depth, slip, away, press
                        )
                        _placed(
                            things.corners[j], things.size[j], state[j, 0], state[j, 1],
                            state[j, 2], placed[j],
                        )  # fmt: skip
            if worst < SETTLED:
                break
        report[1] = max(report[1], worst)
        moved = math.hypot(du, dv)
        if moved > 1e-6:
            report[0] = max(report[0], press.max() / moved)
        report[2] = (t + 1.0) / path.shape[0]
        if worst > JAMMED or math.hypot(state[0, 0] - first_u, state[0, 1] - first_v) > most:
            return


def room(path: FloatArray, tool: Shapes, walls: Shapes) -> float:
    """Least distance of the tool from the walls along a path (T, 3) [m]; negative inside them.

    By separating axes, so that past a corner it may say less than there is.
    """
    return float(_room(np.ascontiguousarray(path, dtype=np.float64), tool, walls))


@njit(cache=True, error_model="numpy", nogil=True)
def _room(path, tool, walls):  # type: ignore[no-untyped-def]
    hand = np.empty((CORNERS, 2))
    least = math.inf
    for t in range(path.shape[0]):
        for h in range(tool.size.shape[0]):
            n = tool.size[h]
            _placed(tool.corners[h], n, path[t, 0], path[t, 1], path[t, 2], hand)
            for w in range(walls.size.shape[0]):
                m = walls.size[w]
                one = _widest(hand, n, walls.corners[w], m)
                least = min(least, max(one, _widest(walls.corners[w], m, hand, n)))
    return least


@njit(cache=True, error_model="numpy", nogil=True)
def _widest(a, na, b, nb):  # type: ignore[no-untyped-def]
    """Largest separation of polygon b from the faces of polygon a."""
    best = -math.inf
    for k in range(na):
        x0, y0 = a[k, 0], a[k, 1]
        ex, ey = a[(k + 1) % na, 0] - x0, a[(k + 1) % na, 1] - y0
        length = math.hypot(ex, ey)
        least = math.inf
        for j in range(nb):
            least = min(least, ((b[j, 0] - x0) * ey - (b[j, 1] - y0) * ex) / length)
        best = max(best, least)
    return best
