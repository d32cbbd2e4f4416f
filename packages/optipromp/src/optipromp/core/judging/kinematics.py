"""The judge's kinematics, and the refinement of a motion for its checks.

Segment frames are composed as unit quaternions (the planner's kernels multiply matrices).
"""

import functools
import itertools
import math
from typing import NamedTuple

import numpy as np

from optipromp.core.arrays import BoolArray, FloatArray, IntArray, lengths
from optipromp.core.compiled import inlined, inner, kernel
from optipromp.core.judging.curve import along, coefficients
from optipromp.core.robots.model import Robot
from optipromp.core.scenes.rotations import to_quaternion
from optipromp.core.trajectory import Trajectory

MOST_CHECKS = 200_000  # configurations of one trajectory: a choice, about 0.5 s of checking
GRAZED = 1e-3  # [m] depth to which a point may enter a sphere between two checks: a choice
LARGEST_TURN = 0.2  # [rad or m] of all joints in a part: its chord is < 1 % shorter than its arc
UNEVEN = 0.01  # [rad or m] deviation of a part's motion from one linear in time: a choice


class Body(NamedTuple):
    """A robot as the judge sees it: S segments, B spheres sorted by link, L links with spheres."""

    prismatic: BoolArray  # (S,)
    turn: FloatArray  # (S, 4) fixed rotation of each joint, quaternion wxyz
    shift: FloatArray  # (S, 3) fixed translation of each joint [m]
    axis: FloatArray  # (S, 3) unit
    driver: IntArray  # (S,) the joint that drives the segment
    ratio: FloatArray  # (S,) value = ratio · q[driver] + offset
    offset: FloatArray  # (S,)
    carrier: IntArray  # (B,) segment that carries the sphere, -1 the base
    local: FloatArray  # (B, 3) centres in the carriers' frames [m]
    radius: FloatArray  # (B,) [m]
    original: IntArray  # (B,) index of the sphere in the robot's order
    start: IntArray  # (L + 1,) where the spheres of each link begin
    distal: BoolArray  # (L,) the last link and the tool
    middle: FloatArray  # (L, 3) centre of a ball that holds the link's spheres [m]
    reach: FloatArray  # (L,) radius of this ball [m]
    tool: FloatArray  # (2, 3) tool point and tool axis in the last segment
    groups: IntArray  # (G, 4) two links that must not touch, and their range of `pairs`
    pairs: IntArray  # (P, 2) two spheres that must not touch
    slack: FloatArray  # (P,) permitted overlap of the two spheres, negative: required gap [m]
    levers: FloatArray  # (G, S) largest relative motion of two links per unit of a joint [m/rad]
    longest: FloatArray  # (S,) largest lever of each joint [m/rad]


@functools.lru_cache(maxsize=32)
def body_of(robot: Robot) -> Body:
    """The robot as the judge's kernels take it."""
    kin, spheres = robot.kinematics, robot.spheres
    order = np.argsort(spheres.link, kind="stable")
    link, radius = np.asarray(spheres.link)[order], np.asarray(spheres.radius)[order]
    local = np.asarray(spheres.center)[order]
    names, start = np.unique(link, return_index=True)
    start = np.append(start, len(link)).astype(np.int64)
    spans = [slice(i, j) for i, j in itertools.pairwise(start)]
    low, high = local - radius[:, None], local + radius[:, None]
    middle = np.reshape(
        [0.5 * (low[own].min(axis=0) + high[own].max(axis=0)) for own in spans], (-1, 3)
    )
    reach = [
        np.max(lengths(local[own] - center) + radius[own])
        for own, center in zip(spans, middle, strict=True)
    ]
    pairs = np.sort(np.argsort(order)[np.asarray(robot.self_pairs).reshape(-1, 2)], axis=1)
    links, kept = np.searchsorted(names, link[pairs]), np.zeros(len(names))
    apart = np.asarray(robot.self_slack) < 0.0
    np.maximum.at(kept, links[apart], -robot.self_slack[apart, None])
    code = links[:, 0] * len(names) + links[:, 1]
    by = np.argsort((code * len(radius) + pairs[:, 0]) * len(radius) + pairs[:, 1])
    pairs = pairs[by]
    code, first, count = np.unique(code[by], return_index=True, return_counts=True)
    both, carrier = np.column_stack(np.divmod(code, len(names))), np.asarray(spheres.segment)[order]
    bearer = carrier[start[:-1]]
    shifts = lengths(kin.translation)
    moves = [_levers(robot, local[own], at, shifts) for own, at in zip(spans, bearer, strict=True)]
    two = bearer[both]
    far = both[np.arange(len(both)), two.argmax(axis=1)]
    levers = np.reshape(moves, (-1, robot.n_segments))[far]
    levers[np.arange(robot.n_segments) <= two.min(axis=1)[:, None]] = 0.0
    quaternions = np.array([to_quaternion(rotation) for rotation in kin.rotation])
    return Body(
        prismatic=kin.kind == 1, turn=quaternions.reshape(-1, 4), shift=kin.translation,
        axis=kin.axis, driver=kin.dof, ratio=kin.multiplier, offset=kin.offset,
        carrier=carrier, local=local, radius=radius, original=order,
        start=start, distal=np.asarray(spheres.distal)[order][start[:-1]], middle=middle,
        reach=np.add(reach, kept), tool=np.array([robot.tool_point, robot.tool_axis]),
        groups=np.column_stack([both, first, first + count]).astype(np.int64),
        pairs=pairs.astype(np.int64), slack=np.asarray(robot.self_slack)[by], levers=levers,
        longest=levers.max(axis=0, initial=0.0),
    )  # fmt: skip


def _levers(robot: Robot, local: FloatArray, carrier: int, shifts: FloatArray) -> FloatArray:
    """Bound (S,) of the motion of spheres on segment ``carrier`` per unit of each joint.

    ``local`` (k, 3) are the centres of the spheres, ``shifts`` (S,) the distances between joints
    [m]. The bound is the length of the chain from joint to spheres: infinite with a prismatic joint
    in between, 0 for joints beyond the carrier.
    """
    kin, out = robot.kinematics, np.zeros(robot.n_segments)
    if carrier < 0:
        return out
    (x, y, z), (a, b, c) = local.T, kin.axis[carrier]
    aside = np.column_stack([y * c - z * b, z * a - x * c, x * b - y * a])
    length = lengths(local).max()
    for s in range(carrier, -1, -1):
        lever = lengths(aside).max() if s == carrier else length
        out[s] = 1.0 if kin.kind[s] == 1 else lever
        length += np.inf if kin.kind[s] == 1 else shifts[s]
    return out


def centers(robot: Robot, q: FloatArray) -> FloatArray:
    """World centres (M, B, 3) of the body spheres at ``q`` (M, n), in the robot's order [m]."""
    body = body_of(robot)
    placed = np.empty((len(q), len(body.radius), 3))
    place(body, np.array(q, dtype=np.float64, order="C"), placed)
    out = np.empty_like(placed)
    out[:, body.original] = placed
    return out


def refined(robot: Robot, trajectory: Trajectory) -> tuple[FloatArray, FloatArray, IntArray, bool]:
    """Checks along the curve, between which no sphere moves more than half its radius.

    A sphere of radius above 32 :data:`GRAZED` moves less, so that no point enters it deeper than
    :data:`GRAZED` between two checks.

    Returns: Times (M,) [s] and configurations (M, n) of the checks; the indices (T,) of the
    waypoints among them; and whether :data:`MOST_CHECKS` sufficed.
    """
    kin = robot.kinematics
    powers = np.abs(coefficients(trajectory)[:, :, 1:])
    turns = powers.sum(axis=2)[:, kin.dof] @ np.abs(kin.multiplier)  # upper bounds [rad or m]
    uneven = powers[:, :, 1:].sum(axis=2).max(axis=1)
    parts = np.ceil(np.maximum(turns / LARGEST_TURN, np.sqrt(uneven / UNEVEN)))
    coarse, fits = fitting(np.maximum(parts, 1.0))
    _, placed, rows = along(trajectory, coarse)
    parts = np.empty(len(placed) - 1)
    divisions(body_of(robot), placed, parts)
    fine, complete = fitting(np.asarray(coarse * np.maximum.reduceat(parts, rows[:-1])))
    return *along(trajectory, fine), fits and complete


def fitting(parts: FloatArray) -> tuple[IntArray, bool]:
    """``parts`` (T-1,), reduced to :data:`MOST_CHECKS` in total; whether none was removed."""
    total = float(parts.sum())
    if total > MOST_CHECKS:
        parts = np.maximum(1, np.floor(parts * (MOST_CHECKS / total)))
    return parts.astype(np.int64), total <= MOST_CHECKS


@inner
def turned(w, x, y, z, vx, vy, vz):
    """The vector (vx, vy, vz) turned by the unit quaternion (w, x, y, z)."""
    tx, ty, tz = 2 * (y * vz - z * vy), 2 * (z * vx - x * vz), 2 * (x * vy - y * vx)
    return (
        vx + w * tx + y * tz - z * ty,
        vy + w * ty + z * tx - x * tz,
        vz + w * tz + x * ty - y * tx,
    )


@inner
def composed(a, b, c, d, e, f, g, h):
    """Product of the quaternions (a, b, c, d) and (e, f, g, h)."""
    return (
        a * e - b * f - c * g - d * h,
        a * f + b * e + c * h - d * g,
        a * g - b * h + c * e + d * f,
        a * h + b * g - c * f + d * e,
    )


@inlined
def segments(body, q, turns, origins):
    """Rotations (S, 3, 3) and origins (S, 3) [m] of the segments at ``q`` (n,), in place."""
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
            u, v = math.cos(0.5 * value), math.sin(0.5 * value)
            w, x, y, z = composed(w, x, y, z, u, v * a[0], v * a[1], v * a[2])
        r = turns[s]
        r[0, 0], r[0, 1] = 1 - 2 * (y * y + z * z), 2 * (x * y - w * z)
        r[0, 2], r[1, 0] = 2 * (x * z + w * y), 2 * (x * y + w * z)
        r[1, 1], r[1, 2] = 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)
        r[2, 0], r[2, 1] = 2 * (x * z - w * y), 2 * (y * z + w * x)
        r[2, 2] = 1 - 2 * (x * x + y * y)
        origins[s, 0], origins[s, 1], origins[s, 2] = ox, oy, oz


@inner
def carried(turns, origins, s, local, b):
    """World position of point ``b`` of ``local`` (B, 3), which segment ``s`` carries (-1: none)."""
    x, y, z = local[b, 0], local[b, 1], local[b, 2]
    if s < 0:
        return x, y, z
    return (
        origins[s, 0] + (turns[s, 0, 0] * x + turns[s, 0, 1] * y + turns[s, 0, 2] * z),
        origins[s, 1] + (turns[s, 1, 0] * x + turns[s, 1, 1] * y + turns[s, 1, 2] * z),
        origins[s, 2] + (turns[s, 2, 0] * x + turns[s, 2, 1] * y + turns[s, 2, 2] * z),
    )


@kernel
def place(body, q, out):
    """World centres (M, B, 3) of the spheres at configurations ``q`` (M, n), in place."""
    n_segments = body.driver.shape[0]
    turns, origins = np.empty((n_segments, 3, 3)), np.empty((n_segments, 3))
    for m in range(q.shape[0]):
        segments(body, q[m], turns, origins)
        for b in range(body.carrier.shape[0]):
            x, y, z = carried(turns, origins, body.carrier[b], body.local, b)
            out[m, b, 0], out[m, b, 1], out[m, b, 2] = x, y, z


@kernel
def divisions(body, q, parts):
    """Number of ``parts`` (T-1,) of each interval, so that no sphere moves over half its radius.

    Half-way between two checks at distance s, a point may be s² / 8r deeper in a sphere of radius
    r. The length of an arc is taken as 1.1 times its chord: intervals of ``q`` (T, n) must turn no
    sphere by much more than a radian, at nearly constant speed.
    """
    placed = np.empty((q.shape[0], body.radius.shape[0], 3))
    place(body, q, placed)
    for t in range(parts.shape[0]):
        worst = 0.0  # largest (step / longest allowed)²
        for b in range(body.radius.shape[0]):
            x = placed[t + 1, b, 0] - placed[t, b, 0]
            y = placed[t + 1, b, 1] - placed[t, b, 1]
            z = placed[t + 1, b, 2] - placed[t, b, 2]
            squared, radius = x * x + y * y + z * z, body.radius[b]
            allowed = min(0.25 * radius * radius, 8.0 * GRAZED * radius)
            if squared > worst * allowed:
                worst = squared / allowed
        parts[t] = max(1.0, math.ceil(1.1 * math.sqrt(worst)))


def last_poses(robot: Robot, q: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Tool points (M, 3) [m], rotations (M, 3, 3) of the last segment at ``q`` (M, n)."""
    points, turns = np.empty((len(q), 3)), np.empty((len(q), 3, 3))
    _last_poses(body_of(robot), np.array(q, dtype=np.float64, order="C"), points, turns)
    return points, turns


@kernel
def _last_poses(body, q, points, out):
    last = body.driver.shape[0] - 1
    turns, origins = np.empty((last + 1, 3, 3)), np.empty((last + 1, 3))
    for m in range(len(q)):
        segments(body, q[m], turns, origins)
        points[m, 0], points[m, 1], points[m, 2] = carried(turns, origins, last, body.tool, 0)
        out[m] = turns[last]
