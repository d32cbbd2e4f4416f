r"""The judge's sweep: closest approaches of a trajectory, apart from the planner's kernels.

Segment frames are composed as unit quaternions (the planner's kernels multiply matrices), and the
distances give values only. Every check is exact; bounding spheres only skip what cannot matter.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from optipromp.arrays import BoolArray, FloatArray, IntArray

SPHERE, BOX, CYLINDER, CAPSULE, HALF_SPACE = 0, 1, 2, 3, 4
STATIC, AVOID, PUSHABLE = 0, 1, 2


class Body(NamedTuple):
    """A robot as the judge sees it; spheres are sorted by link."""

    prismatic: BoolArray  # (S,)
    turn: FloatArray  # (S, 4) fixed rotation of each joint, quaternion wxyz
    shift: FloatArray  # (S, 3)
    axis: FloatArray  # (S, 3)
    driver: IntArray  # (S,) joint
    ratio: FloatArray  # (S,)
    offset: FloatArray  # (S,)
    carrier: IntArray  # (B,) segment, -1 fixed
    local: FloatArray  # (B, 3)
    radius: FloatArray  # (B,)
    original: IntArray  # (B,) index of the sphere in the robot's own order
    start: IntArray  # (L + 1,) spheres of each link
    distal: BoolArray  # (L,)
    hub: FloatArray  # (L, 3) bounding centre, in the carrier of the link's first sphere
    hub_radius: FloatArray  # (L,)
    groups: IntArray  # (G, 4) two links, range of pairs
    pairs: IntArray  # (P, 2)


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
def turned(w, x, y, z, vx, vy, vz):  # type: ignore[no-untyped-def]
    """A vector turned by a unit quaternion."""
    tx, ty, tz = 2 * (y * vz - z * vy), 2 * (z * vx - x * vz), 2 * (x * vy - y * vx)
    return (
        vx + w * tx + y * tz - z * ty,
        vy + w * ty + z * tx - x * tz,
        vz + w * tz + x * ty - y * tx,
    )


@njit(cache=True, error_model="numpy", nogil=True)
def composed(a, b, c, d, e, f, g, h):  # type: ignore[no-untyped-def]
    """Product of the quaternions (a, b, c, d) and (e, f, g, h)."""
    return (
        a * e - b * f - c * g - d * h,
        a * f + b * e + c * h - d * g,
        a * g - b * h + c * e + d * f,
        a * h + b * g - c * f + d * e,
    )


@njit(cache=True, error_model="numpy", nogil=True)
def segments(body, q, turns, origins):  # type: ignore[no-untyped-def]
    """Rotations (S, 3, 3) and origins (S, 3) of the segments at one configuration, in place."""
    w, x, y, z = 1.0, 0.0, 0.0, 0.0
    ox, oy, oz = 0.0, 0.0, 0.0
    for s in range(body.driver.shape[0]):
        dx, dy, dz = turned(w, x, y, z, body.shift[s, 0], body.shift[s, 1], body.shift[s, 2])
        ox, oy, oz = ox + dx, oy + dy, oz + dz
        t = body.turn[s]
        w, x, y, z = composed(w, x, y, z, t[0], t[1], t[2], t[3])
        value = body.ratio[s] * q[body.driver[s]] + body.offset[s]
        a = body.axis[s]
        if body.prismatic[s]:
            dx, dy, dz = turned(w, x, y, z, a[0] * value, a[1] * value, a[2] * value)
            ox, oy, oz = ox + dx, oy + dy, oz + dz
        else:
            half = math.sin(0.5 * value)
            w, x, y, z = composed(
                w, x, y, z, math.cos(0.5 * value), half * a[0], half * a[1], half * a[2]
            )
        r = turns[s]
        r[0, 0], r[0, 1], r[0, 2] = (
            1 - 2 * (y * y + z * z),
            2 * (x * y - w * z),
            2 * (x * z + w * y),
        )
        r[1, 0], r[1, 1], r[1, 2] = (
            2 * (x * y + w * z),
            1 - 2 * (x * x + z * z),
            2 * (y * z - w * x),
        )
        r[2, 0], r[2, 1], r[2, 2] = (
            2 * (x * z - w * y),
            2 * (y * z + w * x),
            1 - 2 * (x * x + y * y),
        )
        origins[s, 0], origins[s, 1], origins[s, 2] = ox, oy, oz


@njit(cache=True, error_model="numpy", nogil=True)
def carried(turns, origins, s, p, out):  # type: ignore[no-untyped-def]
    """World position of a point ``p`` (3,) that segment ``s`` carries (-1: the base), in place."""
    for i in range(3):
        if s < 0:
            out[i] = p[i]
        else:
            r = turns[s]
            out[i] = origins[s, i] + (r[i, 0] * p[0] + r[i, 1] * p[1] + r[i, 2] * p[2])


@njit(cache=True, error_model="numpy", nogil=True)
def place(body, q, out):  # type: ignore[no-untyped-def]
    """World centres (M, B, 3) of the spheres at configurations ``q`` (M, n), in place."""
    n_segments = body.driver.shape[0]
    turns, origins = np.empty((n_segments, 3, 3)), np.empty((n_segments, 3))
    for m in range(q.shape[0]):
        segments(body, q[m], turns, origins)
        for b in range(body.carrier.shape[0]):
            carried(turns, origins, body.carrier[b], body.local[b], out[m, b])


@njit(cache=True, error_model="numpy", nogil=True)
def tool_path(body, q, point, axis, points, axes):  # type: ignore[no-untyped-def]
    """The tool's ``point`` and ``axis`` (3,), carried by the last segment, at ``q`` (T, n)."""
    last = body.driver.shape[0] - 1
    turns, origins = np.empty((last + 1, 3, 3)), np.empty((last + 1, 3))
    nowhere = np.zeros((last + 1, 3))
    for t in range(q.shape[0]):
        segments(body, q[t], turns, origins)
        carried(turns, origins, last, point, points[t])
        carried(turns, nowhere, last, axis, axes[t])


@njit(cache=True, error_model="numpy", nogil=True)
def to_surface(kind, size, x, y, z):  # type: ignore[no-untyped-def]
    """Signed distance of a point, in the shape's own frame, to a simple shape."""
    if kind == SPHERE:
        return math.sqrt(x * x + y * y + z * z) - size[0]
    if kind == BOX:
        ax, ay, az = abs(x) - size[0], abs(y) - size[1], abs(z) - size[2]
        px, py, pz = max(ax, 0.0), max(ay, 0.0), max(az, 0.0)
        return math.sqrt(px * px + py * py + pz * pz) + min(max(ax, ay, az), 0.0)
    if kind == CYLINDER:
        ar, az = math.sqrt(x * x + y * y) - size[0], abs(z) - size[1]
        return math.hypot(max(ar, 0.0), max(az, 0.0)) + min(max(ar, az), 0.0)
    if kind == CAPSULE:
        dz = z - min(max(z, -size[1]), size[1])
        return math.sqrt(x * x + y * y + dz * dz) - size[0]
    return z


@njit(cache=True, error_model="numpy", nogil=True)
def to_core(kind, size, x, y, z):  # type: ignore[no-untyped-def]
    """Distance of a point to the paper's core: a sphere's centre, the long axis of a bar."""
    if kind == SPHERE:
        return math.sqrt(x * x + y * y + z * z)
    if kind == BOX:
        if size[0] >= size[1] and size[0] >= size[2]:
            x -= min(max(x, -size[0]), size[0])
        elif size[1] >= size[2]:
            y -= min(max(y, -size[1]), size[1])
        else:
            z -= min(max(z, -size[2]), size[2])
        return math.sqrt(x * x + y * y + z * z)
    if kind == HALF_SPACE:
        return z
    z -= min(max(z, -size[1]), size[1])
    return math.sqrt(x * x + y * y + z * z)


@njit(cache=True, error_model="numpy", nogil=True)
def divisions(body, q, parts):  # type: ignore[no-untyped-def]
    """Into how many parts (T-1,) each interval is cut, so that no sphere moves half its radius.

    Arcs are taken for 1.1 times their chords: no interval may turn a sphere by much more than a
    radian.
    """
    spheres = np.empty((2, body.radius.shape[0], 3))
    place(body, q[:1], spheres[:1])
    for t in range(q.shape[0] - 1):
        before, now = spheres[t % 2], spheres[(t + 1) % 2]
        place(body, q[t + 1 : t + 2], spheres[(t + 1) % 2 : (t + 1) % 2 + 1])
        worst = 0.0
        for b in range(body.radius.shape[0]):
            squared = 0.0
            for i in range(3):
                squared += (now[b, i] - before[b, i]) ** 2
            worst = max(worst, squared / (body.radius[b] * body.radius[b]))
        parts[t] = max(1, math.ceil(1.1 * 2.0 * math.sqrt(worst)))


@njit(cache=True, error_model="numpy", nogil=True)
def inside(r, p, point):  # type: ignore[no-untyped-def]
    """A world ``point`` in the frame with the rotation ``r`` (3, 3) and the origin ``p`` (3,)."""
    dx, dy, dz = point[0] - p[0], point[1] - p[1], point[2] - p[2]
    return (
        r[0, 0] * dx + r[1, 0] * dy + r[2, 0] * dz,
        r[0, 1] * dx + r[1, 1] * dy + r[2, 1] * dz,
        r[0, 2] * dx + r[1, 2] * dy + r[2, 2] * dz,
    )


@njit(cache=True, error_model="numpy", nogil=True)
def apart_by(a, b):  # type: ignore[no-untyped-def]
    """Distance between two points (3,)."""
    dx, dy, dz = a[0] - b[0], a[1] - b[1], a[2] - b[2]
    return math.sqrt(dx * dx + dy * dy + dz * dz)


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
            radius[c] = max(radius[c], apart_by(middle[c], position[k]) + bound[k])
    return start[: count + 1], middle, radius


@njit(cache=True, error_model="numpy", nogil=True)
def sweep(body, things, q, closest, core, depth, deepest, apart):  # type: ignore[no-untyped-def]
    """Closest approaches over configurations ``q`` (M, n), in place.

    ``closest`` (4,): static, avoid by B_d, avoid by the last link and tool, pushable by B_d.
    ``core`` (1,): the paper's M_c over static and avoid things. ``depth`` and ``deepest`` (K,): the
    smallest distance of what must not touch each thing, and the sphere, exact where negative.
    ``apart`` (3,): smallest distance between links that are not neighbours, and the two spheres.

    What is too far to matter is not looked at again before the links have moved by as much as it
    is too far. ``way`` (L,) holds how far the spheres of a link have moved at most, ``longest`` the
    sum of the largest of these steps. The same holds for blocks of things.
    """
    n_segments, n_links = body.driver.shape[0], body.hub_radius.shape[0]
    turns, origins = np.zeros((n_segments, 3, 3)), np.empty((n_segments, 3))
    spheres, hubs = np.empty((body.radius.shape[0], 3)), np.empty((n_links, 3))
    placed = np.empty(n_links, dtype=np.bool_)
    way, longest = np.zeros(n_links), 0.0
    due, due_any = np.zeros((things.kind.shape[0], n_links)), np.zeros(things.kind.shape[0])
    due_block, due_pair = np.zeros(things.block_bound.shape[0]), np.zeros(body.groups.shape[0])
    for m in range(q.shape[0]):
        longest += _advance(body, q[m], m == 0, turns, origins, hubs, way)
        placed[:] = False
        for c in range(things.block_bound.shape[0]):
            if longest < due_block[c]:
                continue
            role = things.role[things.block[c]]
            wanted = _wanted(role, closest, core)
            slack = _room(things.block_middle[c], things.block_bound[c], hubs, body.hub_radius)
            if slack > wanted:  # too far from every link
                due_block[c] = longest + slack - wanted
                continue
            due_block[c] = math.inf
            for k in range(things.block[c], things.block[c + 1]):
                if longest < due_any[k]:
                    due_block[c] = min(due_block[c], due_any[k])
                    continue
                kind, bound = things.kind[k], things.bound[k]
                r, p, size = things.rotation[k], things.position[k], things.size[k]
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
                        far = apart_by(hubs[link], p) - bound - body.hub_radius[link]
                    if far < wanted:
                        x, y, z = inside(r, p, hubs[link])
                        far = max(far, to_surface(kind, size, x, y, z) - body.hub_radius[link])
                    slack = far - wanted
                    if far < wanted:
                        if not placed[link]:
                            _place_link(body, turns, origins, link, spheres)
                            placed[link] = True
                        nearest, nearest_core = math.inf, math.inf
                        for b in range(body.start[link], body.start[link + 1]):
                            x, y, z = inside(r, p, spheres[b])
                            d = to_surface(kind, size, x, y, z) - body.radius[b]
                            nearest = min(nearest, d)
                            if role != PUSHABLE:
                                nearest_core = min(nearest_core, to_core(kind, size, x, y, z))
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
        for g in range(body.groups.shape[0]):
            first, second = body.groups[g, 0], body.groups[g, 1]
            both = way[first] + way[second]
            if both < due_pair[g]:
                continue
            reach = body.hub_radius[first] + body.hub_radius[second]
            nearest = apart_by(hubs[first], hubs[second]) - reach
            if nearest < apart[0]:
                for link in (first, second):
                    if not placed[link]:
                        _place_link(body, turns, origins, link, spheres)
                        placed[link] = True
                nearest = _nearest_pair(body, g, spheres, hubs, apart)
            due_pair[g] = both + nearest - apart[0]


@njit(cache=True, error_model="numpy", nogil=True)
def _wanted(role, closest, core):  # type: ignore[no-untyped-def]
    """From which distance on things of a role change nothing."""
    if role == STATIC:
        return max(closest[0], core[0], 0.0)
    if role == AVOID:
        return max(closest[1], closest[2], core[0], 0.0)
    return max(closest[3], 0.0)


@njit(cache=True, error_model="numpy", nogil=True)
def _room(middle, bound, hubs, radius):  # type: ignore[no-untyped-def]
    """Distance between a ball and the nearest of the balls (L,) about ``hubs`` (L, 3)."""
    nearest = math.inf
    if bound == math.inf:
        return -math.inf
    for link in range(hubs.shape[0]):
        nearest = min(nearest, apart_by(middle, hubs[link]) - radius[link])
    return nearest - bound


@njit(cache=True, error_model="numpy", nogil=True)
def _advance(body, q, begin, turns, origins, hubs, way):  # type: ignore[no-untyped-def]
    """Move the segments and hubs to ``q``; adds to ``way``, and returns the largest that it adds.

    A turn by the angle θ moves a point at distance h from the hub by at most 2 sin(θ/2) h about it,
    and 2 sin(θ/2) is the Frobenius norm of the change of the rotation over √2.
    """
    before, hub, largest = turns.copy(), np.empty(3), 0.0
    segments(body, q, turns, origins)
    for link in range(hubs.shape[0]):
        s = body.carrier[body.start[link]]
        carried(turns, origins, s, body.hub[link], hub)
        turn = 0.0
        if s >= 0:
            for i in range(3):
                for j in range(3):
                    turn += (turns[s, i, j] - before[s, i, j]) ** 2
        step = apart_by(hub, hubs[link]) + math.sqrt(0.5 * turn) * body.hub_radius[link]
        for i in range(3):
            hubs[link, i] = hub[i]
        if not begin:
            step = step * (1.0 + 1e-9) + 1e-12  # rounding
            way[link] += step
            largest = max(largest, step)
    return largest


@njit(cache=True, error_model="numpy", nogil=True)
def _nearest_pair(body, group, spheres, hubs, apart):  # type: ignore[no-untyped-def]
    """A lower bound of the distance between two links; ``apart`` where it is the least so far."""
    second = body.groups[group, 1]
    last, skip, nearest = -1, False, math.inf
    for i in range(body.groups[group, 2], body.groups[group, 3]):
        a, b = body.pairs[i, 0], body.pairs[i, 1]
        if a != last:
            last = a
            far = apart_by(spheres[a], hubs[second]) - body.radius[a] - body.hub_radius[second]
            skip = far >= apart[0]
            if skip:
                nearest = min(nearest, far)
        if skip:
            continue
        d = apart_by(spheres[a], spheres[b]) - body.radius[a] - body.radius[b]
        nearest = min(nearest, d)
        if d < apart[0]:
            apart[0] = d
            apart[1] = a
            apart[2] = b
    return nearest


@njit(cache=True, error_model="numpy", nogil=True)
def _place_link(body, turns, origins, link, spheres):  # type: ignore[no-untyped-def]
    """World centres of one link's spheres, in place."""
    for b in range(body.start[link], body.start[link + 1]):
        carried(turns, origins, body.carrier[b], body.local[b], spheres[b])


@njit(cache=True, error_model="numpy", nogil=True)
def entered_first(kind, size, bound, r, p, spheres, radius, distal):  # type: ignore[no-untyped-def]
    """How deep what is not distal gets into a thing where nothing distal has been as deep before.

    Args:
        kind, size, bound, r, p: of the thing, see :class:`Things`.
        spheres: (M, B, 3) one configuration after the other.
        radius, distal: (B,) of the spheres.

    Returns:
        The depth, 0 where there is none, and the sphere.
    """
    pushed, depth, deepest = 0.0, 0.0, 0
    for m in range(spheres.shape[0]):
        reached = pushed
        for b in range(radius.shape[0]):
            if apart_by(spheres[m, b], p) > bound + radius[b]:
                continue
            x, y, z = inside(r, p, spheres[m, b])
            d = radius[b] - to_surface(kind, size, x, y, z)
            if distal[b]:
                reached = max(reached, d)
            elif d > max(pushed, depth):
                depth, deepest = d, b
        pushed = reached
    return depth, deepest
