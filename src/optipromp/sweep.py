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
    """Objects of simple shape."""

    kind: IntArray  # (K,)
    role: IntArray  # (K,)
    position: FloatArray  # (K, 3)
    rotation: FloatArray  # (K, 3, 3)
    size: FloatArray  # (K, 3) radius / half sizes / radius and half length
    bound: FloatArray  # (K,)


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
def carried(turns, origins, s, p, out):  # type: ignore[no-untyped-def]
    """World position of a point ``p`` (3,) that segment ``s`` carries (-1: the base), in place."""
    if s < 0:
        out[0], out[1], out[2] = p[0], p[1], p[2]
        return
    t = turns[s]
    dx, dy, dz = turned(t[0], t[1], t[2], t[3], p[0], p[1], p[2])
    out[0], out[1], out[2] = origins[s, 0] + dx, origins[s, 1] + dy, origins[s, 2] + dz


@njit(cache=True, error_model="numpy", nogil=True)
def place(body, q, spheres, hubs):  # type: ignore[no-untyped-def]
    """World centres of the spheres (B, 3) and of the links' bounding spheres (L, 3), in place."""
    n_segments = body.driver.shape[0]
    turns, origins = np.empty((n_segments, 4)), np.empty((n_segments, 3))
    w, x, y, z = 1.0, 0.0, 0.0, 0.0
    ox, oy, oz = 0.0, 0.0, 0.0
    for s in range(n_segments):
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
        turns[s, 0], turns[s, 1], turns[s, 2], turns[s, 3] = w, x, y, z
        origins[s, 0], origins[s, 1], origins[s, 2] = ox, oy, oz
    for b in range(body.carrier.shape[0]):
        carried(turns, origins, body.carrier[b], body.local[b], spheres[b])
    for k in range(hubs.shape[0]):
        carried(turns, origins, body.carrier[body.start[k]], body.hub[k], hubs[k])


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
    n_spheres, n_links = body.radius.shape[0], body.hub_radius.shape[0]
    spheres, before = np.empty((n_spheres, 3)), np.empty((n_spheres, 3))
    hubs = np.empty((n_links, 3))
    place(body, q[0], before, hubs)
    for t in range(q.shape[0] - 1):
        place(body, q[t + 1], spheres, hubs)
        worst = 0.0
        for b in range(n_spheres):
            squared = 0.0
            for i in range(3):
                squared += (spheres[b, i] - before[b, i]) ** 2
                before[b, i] = spheres[b, i]
            worst = max(worst, squared / (body.radius[b] * body.radius[b]))
        parts[t] = max(1, math.ceil(1.1 * 2.0 * math.sqrt(worst)))


@njit(cache=True, error_model="numpy", nogil=True)
def sweep(body, things, q, closest, core, depth, deepest, apart):  # type: ignore[no-untyped-def]
    """Closest approaches over configurations ``q`` (M, n), in place.

    ``closest`` (4,): static, avoid by B_d, avoid by the last link and tool, pushable by B_d.
    ``core`` (1,): the paper's M_c over static and avoid things. ``depth`` and ``deepest`` (K,): the
    smallest distance of what must not touch each thing, and the sphere, exact where negative.
    ``apart`` (3,): smallest distance between links that are not neighbours, and the two spheres.
    """
    n_spheres, n_links = body.radius.shape[0], body.hub_radius.shape[0]
    spheres, hubs = np.empty((n_spheres, 3)), np.empty((n_links, 3))
    for m in range(q.shape[0]):
        place(body, q[m], spheres, hubs)
        for k in range(things.kind.shape[0]):
            role, kind, bound = things.role[k], things.kind[k], things.bound[k]
            r, p, size = things.rotation[k], things.position[k], things.size[k]
            for link in range(n_links):
                fault = role == STATIC or not body.distal[link]
                if role == STATIC:
                    slot = 0
                elif role == AVOID:
                    slot = 2 if body.distal[link] else 1
                elif body.distal[link]:
                    continue  # the tool may touch what it pushes
                else:
                    slot = 3
                far = -math.inf
                if bound < math.inf:
                    dx, dy, dz = hubs[link, 0] - p[0], hubs[link, 1] - p[1], hubs[link, 2] - p[2]
                    far = math.sqrt(dx * dx + dy * dy + dz * dz) - bound - body.hub_radius[link]
                wanted = max(closest[slot], 0.0)
                if role != PUSHABLE:
                    wanted = max(wanted, core[0])
                if far >= wanted:
                    continue
                for b in range(body.start[link], body.start[link + 1]):
                    dx, dy, dz = spheres[b, 0] - p[0], spheres[b, 1] - p[1], spheres[b, 2] - p[2]
                    x = r[0, 0] * dx + r[1, 0] * dy + r[2, 0] * dz
                    y = r[0, 1] * dx + r[1, 1] * dy + r[2, 1] * dz
                    z = r[0, 2] * dx + r[1, 2] * dy + r[2, 2] * dz
                    d = to_surface(kind, size, x, y, z) - body.radius[b]
                    closest[slot] = min(closest[slot], d)
                    if role != PUSHABLE:
                        core[0] = min(core[0], to_core(kind, size, x, y, z))
                    if fault and d < depth[k]:
                        depth[k] = d
                        deepest[k] = b
        for g in range(body.groups.shape[0]):
            first, second = body.groups[g, 0], body.groups[g, 1]
            dx = hubs[first, 0] - hubs[second, 0]
            dy = hubs[first, 1] - hubs[second, 1]
            dz = hubs[first, 2] - hubs[second, 2]
            reach = body.hub_radius[first] + body.hub_radius[second]
            if math.sqrt(dx * dx + dy * dy + dz * dz) - reach >= apart[0]:
                continue
            last, skip = -1, False
            for i in range(body.groups[g, 2], body.groups[g, 3]):
                a, b = body.pairs[i, 0], body.pairs[i, 1]
                if a != last:
                    last = a
                    dx = spheres[a, 0] - hubs[second, 0]
                    dy = spheres[a, 1] - hubs[second, 1]
                    dz = spheres[a, 2] - hubs[second, 2]
                    reach = body.radius[a] + body.hub_radius[second]
                    skip = math.sqrt(dx * dx + dy * dy + dz * dz) - reach >= apart[0]
                if skip:
                    continue
                dx = spheres[a, 0] - spheres[b, 0]
                dy = spheres[a, 1] - spheres[b, 1]
                dz = spheres[a, 2] - spheres[b, 2]
                d = math.sqrt(dx * dx + dy * dy + dz * dz) - body.radius[a] - body.radius[b]
                if d < apart[0]:
                    apart[0] = d
                    apart[1] = a
                    apart[2] = b
