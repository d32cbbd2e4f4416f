r"""The judge's sweep: closest approaches of a trajectory, apart from the planner's kernels.

The distances give values only. Every check is exact; bounding spheres only skip what cannot matter.
What is handed a whole :class:`Body` in the loop is compiled into it: a call would copy its arrays'
descriptions, which takes as long as the work.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from optipromp.arrays import FloatArray, IntArray
from optipromp.kinematic_checks import carried, segments

SPHERE, BOX, CYLINDER, CAPSULE, HALF_SPACE = 0, 1, 2, 3, 4
STATIC, AVOID, PUSHABLE = 0, 1, 2


class Things(NamedTuple):
    """Objects of simple shape, in blocks of one role that are near one another."""

    place: IntArray  # (K,) in the scene's objects
    kind: IntArray  # (K,)
    role: IntArray  # (K,)
    position: FloatArray  # (K, 3)
    rotation: FloatArray  # (K, 3, 3)
    size: FloatArray  # (K, 3) radius / half sizes / radius and half length
    bound: FloatArray  # (K,)
    block: IntArray  # (C + 1,) where each block begins
    block_middle: FloatArray  # (C, 3) and
    block_bound: FloatArray  # (C,) of a ball that holds the bounding balls of its things


@njit(cache=True, error_model="numpy", nogil=True)
def to_surface(kind, a, b, c, x, y, z):  # type: ignore[no-untyped-def]
    """Signed distance of a point, in the shape's own frame, to a simple shape of sizes a, b, c."""
    if kind == SPHERE:
        return math.sqrt(x * x + y * y + z * z) - a
    if kind == BOX:
        ax, ay, az = abs(x) - a, abs(y) - b, abs(z) - c
        px, py, pz = max(ax, 0.0), max(ay, 0.0), max(az, 0.0)
        return math.sqrt(px * px + py * py + pz * pz) + min(max(ax, ay, az), 0.0)
    if kind == CYLINDER:
        ar, az = math.sqrt(x * x + y * y) - a, abs(z) - b
        return math.hypot(max(ar, 0.0), max(az, 0.0)) + min(max(ar, az), 0.0)
    if kind == CAPSULE:
        dz = z - min(max(z, -b), b)
        return math.sqrt(x * x + y * y + dz * dz) - a
    return z


@njit(cache=True, error_model="numpy", nogil=True)
def to_core(kind, a, b, c, x, y, z):  # type: ignore[no-untyped-def]
    """Distance of a point to the paper's core: a sphere's centre, the long axis of a bar."""
    if kind == SPHERE:
        return math.sqrt(x * x + y * y + z * z)
    if kind == BOX:
        if a >= b and a >= c:
            x -= min(max(x, -a), a)
        elif b >= c:
            y -= min(max(y, -b), b)
        else:
            z -= min(max(z, -c), c)
        return math.sqrt(x * x + y * y + z * z)
    if kind == HALF_SPACE:
        return z
    z -= min(max(z, -b), b)
    return math.sqrt(x * x + y * y + z * z)


@njit(cache=True, error_model="numpy", nogil=True)
def inside(r, p, k, points, i):  # type: ignore[no-untyped-def]
    """World point ``i`` of ``points`` in frame ``k``: rotations ``r`` (K, 3, 3), origins ``p``."""
    x, y, z = points[i, 0] - p[k, 0], points[i, 1] - p[k, 1], points[i, 2] - p[k, 2]
    return (
        r[k, 0, 0] * x + r[k, 1, 0] * y + r[k, 2, 0] * z,
        r[k, 0, 1] * x + r[k, 1, 1] * y + r[k, 2, 1] * z,
        r[k, 0, 2] * x + r[k, 1, 2] * y + r[k, 2, 2] * z,
    )


@njit(cache=True, error_model="numpy", nogil=True)
def apart_by(a, i, b, j):  # type: ignore[no-untyped-def]
    """Distance between point ``i`` of ``a`` (A, 3) and point ``j`` of ``b`` (B, 3)."""
    x, y, z = a[i, 0] - b[j, 0], a[i, 1] - b[j, 1], a[i, 2] - b[j, 2]
    return math.sqrt(x * x + y * y + z * z)


@njit(cache=True, error_model="numpy", nogil=True)
def blocks(role, position, bound, most):  # type: ignore[no-untyped-def]
    """Things cut into blocks of one role, at most ``most`` each, with balls that hold them.

    Args:
        role, position, bound: of things, see :class:`Things`, of one role after the other.
        most: things in a block.

    Returns:
        Where each block begins (C + 1,), middles (C, 3) and radii (C,) of the balls.
    """
    start, count = np.empty(role.shape[0] // most + 4, dtype=np.int64), 0
    for k in range(role.shape[0]):
        if count == 0 or role[k] != role[k - 1] or k == start[count - 1] + most:
            start[count] = k
            count += 1
    start[count] = role.shape[0]
    middle, radius = np.empty((count, 3)), np.zeros(count)
    for c in range(count):
        for i in range(3):
            low = high = position[start[c], i]
            for k in range(start[c], start[c + 1]):
                low, high = min(low, position[k, i]), max(high, position[k, i])
            middle[c, i] = 0.5 * (low + high)
        for k in range(start[c], start[c + 1]):
            radius[c] = max(radius[c], apart_by(middle, c, position, k) + bound[k])
    return start[: count + 1], middle, radius


@njit(cache=True, error_model="numpy", nogil=True)
def sweep(body, things, q, points, axes, closest, core, depth, deepest, apart):  # type: ignore[no-untyped-def]
    """Closest approaches over configurations ``q`` (M, n), in place.

    ``points`` and ``axes`` (M, 3): tool point and tool axis at every one of them.
    ``closest`` (4,): static, avoid by B_d, avoid by the last link and tool, pushable by B_d.
    ``core`` (1,): the paper's M_c over static and avoid things. ``depth`` and ``deepest`` (K,): the
    smallest distance of what must not touch each thing, and the sphere, exact where negative.
    ``apart`` (3,): smallest distance between links that are not neighbours, and the two spheres.

    What is too far to matter is not looked at again before the links have moved by as much as it
    is too far. ``way`` (L,) holds how far the spheres of a link have moved at most, ``longest`` the
    sum of the largest of these steps, for which blocks of things wait too; ``turned`` (S,) how far
    the joints have. The first configuration is followed by the last and what is before it: a motion
    ends near things, and what is found near early makes the rest too far.
    """
    n_segments, n_links = body.driver.shape[0], body.hub_radius.shape[0]
    turns, origins = np.zeros((n_segments, 3, 3)), np.empty((n_segments, 3))
    nowhere = np.zeros((n_segments, 3))
    fresh, chord = np.empty((n_segments, 3, 3)), np.empty(n_segments)
    spheres, hubs = np.empty((body.radius.shape[0], 3)), np.empty((n_links, 3))
    middle, ball = np.empty((1, 3)), 0.0
    placed = np.empty(n_links, dtype=np.bool_)
    way, longest = np.zeros(n_links), 0.0
    due, due_any = np.zeros((things.kind.shape[0], n_links)), np.zeros(things.kind.shape[0])
    due_block = np.zeros(things.block_bound.shape[0])
    due_pair, due_pairs = np.zeros(body.groups.shape[0]), 0.0
    turned, most, levers = np.zeros(n_segments), 0.0, body.levers
    for i in range(q.shape[0]):
        m, last = -i % q.shape[0], -(i - 1) % q.shape[0]
        longest += _advance(body, q[m], i == 0, turns, origins, fresh, chord, hubs, way)
        most += _turn_on(body.driver, body.ratio, body.longest, q, last, m, turned)
        x, y, z = carried(turns, origins, n_segments - 1, body.tool, 0)
        points[m, 0], points[m, 1], points[m, 2] = x, y, z
        x, y, z = carried(turns, nowhere, n_segments - 1, body.tool, 1)
        axes[m, 0], axes[m, 1], axes[m, 2] = x, y, z
        placed[:] = False
        about = False
        for c in range(things.block_bound.shape[0]):
            if longest < due_block[c]:
                continue
            role = things.role[things.block[c]]
            wanted = _wanted(role, closest, core)
            slack = _room(things, c, hubs, body.hub_radius)
            if slack > wanted:  # too far from every link
                due_block[c] = longest + slack - wanted
                continue
            due_block[c] = math.inf
            for k in range(things.block[c], things.block[c + 1]):
                if longest < due_any[k]:
                    due_block[c] = min(due_block[c], due_any[k])
                    continue
                kind, bound = things.kind[k], things.bound[k]
                r, p = things.rotation, things.position
                size0, size1, size2 = things.size[k, 0], things.size[k, 1], things.size[k, 2]
                wanted = _wanted(role, closest, core)
                if bound + wanted < math.inf:
                    if not about:
                        ball, about = _about(hubs, body.hub_radius, middle), True
                    slack = apart_by(middle, 0, p, k) - bound - ball - wanted
                    if slack > 0.0:  # too far from the whole arm
                        due_any[k] = longest + slack
                        due_block[c] = min(due_block[c], due_any[k])
                        continue
                least = math.inf
                for link in range(n_links):
                    if way[link] < due[k, link]:
                        least = min(least, due[k, link] - way[link])
                        continue
                    fault = role == STATIC or not body.distal[link]
                    if role == STATIC:
                        slot = 0
                    elif role == AVOID:
                        slot = 2 if body.distal[link] else 1
                    elif body.distal[link]:
                        continue  # the tool may touch what it pushes
                    else:
                        slot = 3
                    wanted = max(closest[slot], 0.0)
                    if role != PUSHABLE:
                        wanted = max(wanted, core[0])
                    far = -math.inf
                    if bound < math.inf:
                        far = apart_by(hubs, link, p, k) - bound - body.hub_radius[link]
                    if far < wanted:
                        x, y, z = inside(r, p, k, hubs, link)
                        d = to_surface(kind, size0, size1, size2, x, y, z)
                        far = max(far, d - body.hub_radius[link])
                    slack = far - wanted
                    if far < wanted:
                        if not placed[link]:
                            _place_link(body, turns, origins, link, spheres)
                            placed[link] = True
                        nearest, nearest_core = math.inf, math.inf
                        for b in range(body.start[link], body.start[link + 1]):
                            x, y, z = inside(r, p, k, spheres, b)
                            d = to_surface(kind, size0, size1, size2, x, y, z) - body.radius[b]
                            nearest = min(nearest, d)
                            if role != PUSHABLE:
                                d_core = to_core(kind, size0, size1, size2, x, y, z)
                                nearest_core = min(nearest_core, d_core)
                            if fault and d < depth[k]:
                                depth[k] = d
                                deepest[k] = b
                        closest[slot] = min(closest[slot], nearest)
                        core[0] = min(core[0], nearest_core)
                        slack = min(nearest - max(closest[slot], 0.0), nearest_core - core[0])
                    due[k, link] = way[link] + slack
                    least = min(least, slack)
                due_any[k] = longest + least
                due_block[c] = min(due_block[c], due_any[k])
        if most < due_pairs:
            continue
        due_pairs = math.inf
        for g in range(body.groups.shape[0]):
            moved = 0.0
            for s in range(n_segments):
                moved += levers[g, s] * turned[s]
            if moved >= due_pair[g]:
                first, second = body.groups[g, 0], body.groups[g, 1]
                reach = body.hub_radius[first] + body.hub_radius[second]
                nearest = apart_by(hubs, first, hubs, second) - reach
                if nearest < apart[0]:
                    for link in (first, second):
                        if not placed[link]:
                            _place_link(body, turns, origins, link, spheres)
                            placed[link] = True
                    nearest = _nearest_pair(body, g, spheres, hubs, apart)
                due_pair[g] = moved + nearest - apart[0]
            due_pairs = min(due_pairs, most + due_pair[g] - moved)


@njit(cache=True, error_model="numpy", nogil=True)
def _wanted(role, closest, core):  # type: ignore[no-untyped-def]
    """From which distance on things of a role change nothing."""
    if role == STATIC:
        return max(closest[0], core[0], 0.0)
    if role == AVOID:
        return max(closest[1], closest[2], core[0], 0.0)
    return max(closest[3], 0.0)


@njit(cache=True, error_model="numpy", nogil=True)
def _room(things, c, hubs, radius):  # type: ignore[no-untyped-def]
    """Distance between block ``c`` and the nearest of the balls (L,) about ``hubs`` (L, 3)."""
    nearest = math.inf
    if things.block_bound[c] == math.inf:
        return -math.inf
    for link in range(hubs.shape[0]):
        nearest = min(nearest, apart_by(things.block_middle, c, hubs, link) - radius[link])
    return nearest - things.block_bound[c]


@njit(cache=True, error_model="numpy", nogil=True)
def _about(hubs, radius, middle):  # type: ignore[no-untyped-def]
    """Radius of a ball that holds balls (L,) about ``hubs`` (L, 3); ``middle`` (1, 3) in place."""
    middle[:] = 0.0
    for link in range(hubs.shape[0]):
        for i in range(3):
            middle[0, i] += hubs[link, i] / hubs.shape[0]
    far = 0.0
    for link in range(hubs.shape[0]):
        far = max(far, apart_by(middle, 0, hubs, link) + radius[link])
    return far


@njit(cache=True, error_model="numpy", nogil=True, forceinline=True)
def _advance(body, q, begin, turns, origins, fresh, chord, hubs, way):  # type: ignore[no-untyped-def]
    """Move the segments and hubs to ``q``; adds to ``way``, and returns the largest that it adds.

    A turn by the angle θ moves a point at distance h from the hub by at most 2 sin(θ/2) h about it,
    and 2 sin(θ/2), in ``chord`` (S,), is the Frobenius norm of the change of the rotation over √2.
    ``fresh`` (S, 3, 3) is room to work in.
    """
    segments(body, q, fresh, origins)
    for s in range(origins.shape[0]):
        change = 0.0
        for i in range(3):
            for j in range(3):
                change += (fresh[s, i, j] - turns[s, i, j]) ** 2
                turns[s, i, j] = fresh[s, i, j]
        chord[s] = math.sqrt(0.5 * change)
    largest = 0.0
    for link in range(hubs.shape[0]):
        s = body.carrier[body.start[link]]
        step = chord[s] * body.hub_radius[link] if s >= 0 else 0.0
        x, y, z = carried(turns, origins, s, body.hub, link)
        dx, dy, dz = x - hubs[link, 0], y - hubs[link, 1], z - hubs[link, 2]
        step += math.sqrt(dx * dx + dy * dy + dz * dz)
        hubs[link, 0], hubs[link, 1], hubs[link, 2] = x, y, z
        if not begin:
            step = step * (1.0 + 1e-9) + 1e-12  # rounding
            way[link] += step
            largest = max(largest, step)
    return largest


@njit(cache=True, error_model="numpy", nogil=True, forceinline=True)
def _turn_on(driver, ratio, longest, q, last, m, turned):  # type: ignore[no-untyped-def]
    """Adds to ``turned`` (S,) how far each joint moves; the most that moves links of any group."""
    most = 0.0
    for s in range(turned.shape[0]):
        step = abs(ratio[s] * (q[m, driver[s]] - q[last, driver[s]]))
        step = step * (1.0 + 1e-9) + 1e-12  # rounding
        turned[s] += step
        most += longest[s] * step
    return most


@njit(cache=True, error_model="numpy", nogil=True, forceinline=True)
def _nearest_pair(body, group, spheres, hubs, apart):  # type: ignore[no-untyped-def]
    """The distance between two links; ``apart`` where it is the least so far."""
    second = body.groups[group, 1]
    last, skip, nearest = -1, False, math.inf
    for i in range(body.groups[group, 2], body.groups[group, 3]):
        a, b = body.pairs[i, 0], body.pairs[i, 1]
        if a != last:
            last = a
            far = apart_by(spheres, a, hubs, second) - body.radius[a] - body.hub_radius[second]
            skip = far >= nearest
        if skip:
            continue
        x, y, z = (
            spheres[a, 0] - spheres[b, 0],
            spheres[a, 1] - spheres[b, 1],
            spheres[a, 2] - spheres[b, 2],
        )
        squared, reach = x * x + y * y + z * z, nearest + body.radius[a] + body.radius[b]
        if squared > reach * reach * (1.0 + 1e-12):  # no nearer, and no root needed to see it
            continue
        d = math.sqrt(squared) - body.radius[a] - body.radius[b]
        nearest = min(nearest, d)
        if d < apart[0]:
            apart[0] = d
            apart[1] = a
            apart[2] = b
    return nearest


@njit(cache=True, error_model="numpy", nogil=True, forceinline=True)
def _place_link(body, turns, origins, link, spheres):  # type: ignore[no-untyped-def]
    """World centres of one link's spheres, in place."""
    for b in range(body.start[link], body.start[link + 1]):
        x, y, z = carried(turns, origins, body.carrier[b], body.local, b)
        spheres[b, 0], spheres[b, 1], spheres[b, 2] = x, y, z


@njit(cache=True, error_model="numpy", nogil=True)
def entered_first(kind, size, bound, r, p, spheres, radius, distal):  # type: ignore[no-untyped-def]
    """How deep what is not distal gets into a thing where nothing distal has been as deep before.

    Args:
        kind, size, bound, r, p: of the thing, see :class:`Things`; r (1, 3, 3) and p (1, 3).
        spheres: (M, B, 3) one configuration after the other.
        radius, distal: (B,) of the spheres.

    Returns:
        The depth, 0 where there is none, and the sphere.
    """
    pushed, depth, deepest = 0.0, 0.0, 0
    for m in range(spheres.shape[0]):
        reached = pushed
        for b in range(radius.shape[0]):
            if apart_by(spheres[m], b, p, 0) > bound + radius[b]:
                continue
            x, y, z = inside(r, p, 0, spheres[m], b)
            d = radius[b] - to_surface(kind, size[0], size[1], size[2], x, y, z)
            if distal[b]:
                reached = max(reached, d)
            elif d > max(pushed, depth):
                depth, deepest = d, b
        pushed = reached
    return depth, deepest
