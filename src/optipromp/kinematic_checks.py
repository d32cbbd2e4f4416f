"""The judge's kinematics: where a robot is, and how finely its motion must be looked at.

Segment frames are composed as unit quaternions (the planner's kernels multiply matrices).
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from optipromp.arrays import BoolArray, FloatArray, IntArray


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
    slimmest: FloatArray  # (L,) smallest radius of its spheres
    tool: FloatArray  # (2, 3) tool point and tool axis, which the last segment carries
    groups: IntArray  # (G, 4) two links, range of pairs
    pairs: IntArray  # (P, 2)
    levers: FloatArray  # (G, S) most that a group's links move about one another, by each joint
    longest: FloatArray  # (S,) the largest of them


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


@njit(cache=True, error_model="numpy", nogil=True, forceinline=True)
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
def carried(turns, origins, s, local, b):  # type: ignore[no-untyped-def]
    """World position of point ``b`` of ``local`` (B, 3), which segment ``s`` carries (-1: none)."""
    x, y, z = local[b, 0], local[b, 1], local[b, 2]
    if s < 0:
        return x, y, z
    return (
        origins[s, 0] + (turns[s, 0, 0] * x + turns[s, 0, 1] * y + turns[s, 0, 2] * z),
        origins[s, 1] + (turns[s, 1, 0] * x + turns[s, 1, 1] * y + turns[s, 1, 2] * z),
        origins[s, 2] + (turns[s, 2, 0] * x + turns[s, 2, 1] * y + turns[s, 2, 2] * z),
    )


@njit(cache=True, error_model="numpy", nogil=True)
def place(body, q, out):  # type: ignore[no-untyped-def]
    """World centres (M, B, 3) of the spheres at configurations ``q`` (M, n), in place."""
    n_segments = body.driver.shape[0]
    turns, origins = np.empty((n_segments, 3, 3)), np.empty((n_segments, 3))
    for m in range(q.shape[0]):
        segments(body, q[m], turns, origins)
        for b in range(body.carrier.shape[0]):
            x, y, z = carried(turns, origins, body.carrier[b], body.local, b)
            out[m, b, 0], out[m, b, 1], out[m, b, 2] = x, y, z


@njit(cache=True, error_model="numpy", nogil=True)
def divisions(body, q, parts):  # type: ignore[no-untyped-def]
    """Into how many parts (T-1,) each interval is cut, so that no sphere moves half its radius.

    Arcs are taken for 1.1 times their chords: no interval may turn a sphere by much more than a
    radian.
    """
    n_segments = body.driver.shape[0]
    turns, origins = np.empty((2, n_segments, 3, 3)), np.empty((2, n_segments, 3))
    segments(body, q[0], turns[0], origins[0])
    for t in range(q.shape[0] - 1):
        old, new = t % 2, (t + 1) % 2
        segments(body, q[t + 1], turns[new], origins[new])
        worst = 0.0
        for link in range(body.hub_radius.shape[0] - 1, -1, -1):  # the last moves most
            s = body.carrier[body.start[link]]
            if s >= 0:
                worst = _farthest(
                    body, link, turns[old, s], origins[old, s], turns[new, s], origins[new, s],
                    worst,
                )  # fmt: skip
        parts[t] = max(1, math.ceil(1.1 * 2.0 * math.sqrt(worst)))


@njit(cache=True, error_model="numpy", nogil=True)
def _farthest(body, link, r, o, r_new, o_new, worst):  # type: ignore[no-untyped-def]
    """The largest (step / radius)² of a link's spheres from one pose to another, or ``worst``.

    ``r`` and ``r_new`` (3, 3), ``o`` and ``o_new`` (3,) are the poses of the link's segment.
    """
    x0, x1, x2 = r_new[0, 0] - r[0, 0], r_new[0, 1] - r[0, 1], r_new[0, 2] - r[0, 2]
    y0, y1, y2 = r_new[1, 0] - r[1, 0], r_new[1, 1] - r[1, 1], r_new[1, 2] - r[1, 2]
    z0, z1, z2 = r_new[2, 0] - r[2, 0], r_new[2, 1] - r[2, 1], r_new[2, 2] - r[2, 2]
    ox, oy, oz = o_new[0] - o[0], o_new[1] - o[1], o_new[2] - o[2]
    h = body.hub[link]
    hx = ox + x0 * h[0] + x1 * h[1] + x2 * h[2]
    hy = oy + y0 * h[0] + y1 * h[1] + y2 * h[2]
    hz = oz + z0 * h[0] + z1 * h[1] + z2 * h[2]
    turn = x0 * x0 + x1 * x1 + x2 * x2 + y0 * y0 + y1 * y1 + y2 * y2 + z0 * z0 + z1 * z1 + z2 * z2
    most = math.sqrt(hx * hx + hy * hy + hz * hz) + math.sqrt(0.5 * turn) * body.hub_radius[link]
    if most * most * (1.0 + 1e-9) <= worst * body.slimmest[link] * body.slimmest[link]:
        return worst
    for b in range(body.start[link], body.start[link + 1]):
        p, radius = body.local[b], body.radius[b]
        dx = ox + x0 * p[0] + x1 * p[1] + x2 * p[2]
        dy = oy + y0 * p[0] + y1 * p[1] + y2 * p[2]
        dz = oz + z0 * p[0] + z1 * p[1] + z2 * p[2]
        worst = max(worst, (dx * dx + dy * dy + dz * dz) / (radius * radius))
    return worst


@njit(cache=True, error_model="numpy", nogil=True)
def cut(q, parts, fine):  # type: ignore[no-untyped-def]
    """Each interval of ``q`` (T, n) in ``parts`` (T-1,): ``fine`` (M, n), the knots among them."""
    m = 0
    for t in range(parts.shape[0]):
        for k in range(parts[t]):
            share = k / parts[t]
            for j in range(q.shape[1]):
                fine[m, j] = q[t, j] + share * (q[t + 1, j] - q[t, j])
            m += 1
    for j in range(q.shape[1]):
        fine[m, j] = q[q.shape[0] - 1, j]
