"""The pairs of spheres of a robot that must stay apart, by the surfaces of its links.

A surface has a part for each sphere of its cover. Each small piece of the surface belongs to the
sphere that holds it best. Two links touch only where a part of one meets a part of the other. So
spheres may overlap while their parts are apart: while a plane separates the convex hulls of the
parts.
"""

from collections.abc import Callable, Collection
from dataclasses import replace
from itertools import product

import numpy as np
from scipy.spatial import ConvexHull

from optipromp.core.arrays import BoolArray, FloatArray, IntArray, frozen, lengths
from optipromp.core.compiled import called, inlined, inner, kernel
from optipromp.core.robots.description import LeftOut
from optipromp.core.robots.kernels import PRISMATIC, distances_between
from optipromp.core.robots.model import (
    Robot,
    candidate_pairs,
    drop_always_touching,
    random_postures,
)
from optipromp.readers.fit import shared_out

PIECE = 0.010  # [m] chosen: longest side of a piece that two spheres share
PIECES = 200  # chosen: pieces along a surface of more than 2 m, whose pieces are longer
ROUND = 64  # chosen: sides of a rod; of a radius of 0.1 m they cut off 0.12 mm
DIRECTIONS = 300  # chosen: a part is reduced to its farthest points in these directions
TURNS = 20  # chosen: iterations of Wolfe's algorithm; then two parts count as touching
MEETING = 1e-5  # [m] chosen: parts nearer than this count as touching
_RIDGE = 1e-12  # [m²] chosen: keeps the matrix of coplanar corners invertible
_POINTS_AT_ONCE = 500  # points, chosen: their products stay in the processor's cache
_FAR_AT_ONCE = 20_000  # points, chosen: their products take 50 MB
CHUNK = 1_000_000  # distances in one array, chosen: 8 MB


def of_box(size: FloatArray) -> FloatArray:
    """Triangles (f, 3, 3) of the surface of a box of sizes (3,)."""
    return _hull(0.5 * size * np.stack(np.meshgrid(*[[-1.0, 1.0]] * 3), axis=-1).reshape(-1, 3))


def of_rod(radius: float, length: float, round_ends: float) -> FloatArray:
    """Triangles (f, 3, 3) of a cylinder along z; its ends bulge by ``round_ends``: 0 or radius."""
    bend = np.linspace(0.0, 0.5 * np.pi, ROUND // 4 + 1)[: None if round_ends else 1]
    turn = np.linspace(0.0, 2.0 * np.pi, ROUND, endpoint=False)
    ring = np.column_stack([np.cos(turn), np.sin(turn), np.ones(ROUND)])
    rows = np.column_stack([radius * np.cos(bend)] * 2 + [0.5 * length + round_ends * np.sin(bend)])
    half = (ring[None] * rows[:, None]).reshape(-1, 3)
    return _hull(np.concatenate([half, half * [1.0, 1.0, -1.0]]))


def _hull(points: FloatArray) -> FloatArray:
    return np.asarray(points[ConvexHull(points).simplices])


def parts_of_cover(spheres: FloatArray, triangles: FloatArray) -> FloatArray:
    """Points (c, 4) of a surface of triangles (f, 3, 3): x, y, z [m], index of the sphere.

    ``spheres`` (k, 4) cover the surface. The hull of a sphere's points encloses its part.
    """
    longest = float(np.ptp(triangles, axis=(0, 1)).max())
    step = max(PIECE, longest / PIECES)
    pieces, owner = shared_out(triangles, spheres[:, :3], spheres[:, 3], step)
    out = []
    for index in np.unique(owner):
        points = _farthest(pieces[owner == index].reshape(-1, 3))
        out.append(np.column_stack([points, np.full(len(points), float(index))]))
    return np.concatenate(out)


def _farthest(points: FloatArray) -> FloatArray:
    """The points among ``points`` (m, 3) that are the farthest in one of :func:`_directions`."""
    ways = _directions()
    chunks = (_POINTS_AT_ONCE, *([_FAR_AT_ONCE] if len(points) > _FAR_AT_ONCE else []), len(points))
    for chunk in chunks:  # the farthest of all are among the farthest of each chunk
        starts = range(0, len(points), chunk)
        far = [start + (ways @ points[start : start + chunk].T).argmax(axis=1) for start in starts]
        points = points[np.unique(far)]
    return points


def _directions() -> FloatArray:
    """Unit vectors (DIRECTIONS + 6, 3): a Fibonacci spiral, and both directions of each axis."""
    k = np.arange(DIRECTIONS) + 0.5
    z, turn = 1.0 - 2.0 * k / DIRECTIONS, np.pi * (1.0 + np.sqrt(5.0)) * k
    flat = np.sqrt(1.0 - z * z)
    even = np.column_stack([flat * np.cos(turn), flat * np.sin(turn), z])
    return np.concatenate([even, np.eye(3), -np.eye(3)])


class Parts:
    """The parts of a robot's spheres, as arrays: ``points`` (B, M, 3) in the segments' frames.

    The part of sphere b is ``points[b, :counts[b]]``; ``known`` (B,) says which spheres have a
    part. ``given`` (c, 4): points as :func:`parts_of_cover` returns them, with indices of the B
    spheres.
    """

    def __init__(self, count: int, given: FloatArray) -> None:
        index = given[:, 3].astype(np.int64)
        found = np.bincount(index, minlength=count)
        self.known, self.counts = found > 0, np.maximum(found, 1)
        self.points = np.zeros((count, int(self.counts.max(initial=1)), 3))
        order = np.argsort(index, kind="stable")
        before = (np.cumsum(found) - found)[index[order]]
        self.points[index[order], np.arange(len(index)) - before] = given[order, :3]

    def beyond(self, robot: Robot) -> FloatArray:
        """The distance (B,) [m] by which the part of a fixed sphere reaches out of it, else 0."""
        off = np.linalg.norm(self.points - robot.spheres.center[:, None], axis=2)
        off[np.arange(off.shape[1]) >= self.counts[:, None]] = 0.0
        fixed = self.known & (robot.spheres.segment < 0)
        return np.where(fixed, np.maximum(off.max(axis=1) - robot.spheres.radius, 0.0), 0.0)

    def touch(
        self, robot: Robot, frames: tuple[FloatArray, FloatArray], rows: IntArray, pairs: IntArray
    ) -> BoolArray:
        """Whether the parts of pairs of spheres (m, 2) may touch, each at row ``rows`` (m,) of
        ``frames``: origins (k, S, 3) and rotations (k, S, 3, 3). See :func:`hulls_touch`.
        """
        out = np.empty(len(pairs), dtype=np.bool_)
        parts = self.points, self.counts, robot.spheres.segment
        parts_touch(parts, frames, rows, pairs, out)
        return out


@kernel
def parts_touch(parts, frames, rows, pairs, out):
    """:func:`hulls_touch` of the parts of each pair (m, 2) at its row; see :class:`Parts`."""
    (points, counts, segment), (origins, rotations) = parts, frames
    turn, move = np.empty((2, 3, 3)), np.empty((2, 3))
    between, shift = np.empty((3, 3)), np.empty(3)
    corners, weights, gram, best = np.empty((4, 3)), np.empty(4), np.empty((4, 4)), np.empty(4)
    work = corners, weights, gram, best, np.empty(3), np.empty(3)
    for i in range(pairs.shape[0]):
        for side in range(2):
            s = segment[pairs[i, side]]
            for j in range(3):
                move[side, j] = origins[rows[i], s, j] if s >= 0 else 0.0
                for k in range(3):
                    fixed = 1.0 if j == k else 0.0
                    turn[side, j, k] = rotations[rows[i], s, j, k] if s >= 0 else fixed
        for j in range(3):
            shift[j] = 0.0
            for k in range(3):
                shift[j] += turn[0, k, j] * (move[1, k] - move[0, k])
                between[j, k] = _dot(turn[0, :, j], turn[1, :, k])
        a, b = pairs[i, 0], pairs[i, 1]
        out[i] = hulls_touch(points[a, : counts[a]], points[b, : counts[b]], between, shift, work)


@called
def hulls_touch(one, other, rotation, translation, work):
    """Whether the hulls of points ``one`` (m, 3) and ``other`` (k, 3) come within :data:`MEETING`.

    ``other`` stands at ``rotation`` (3, 3), ``translation`` (3,) in the frame of ``one``. The point
    nearest to zero of the Minkowski difference is found by Wolfe's algorithm (Finding the nearest
    point in a polytope, 1976): the corner farthest against the present point joins the corners, and
    the nearest point of their hull is the next one. A corner on the far side of zero means a
    separating plane. Hulls count as touching if :data:`TURNS` iterations find none.
    ``work``: arrays of 4 by 3, 4, 4 by 4, 4, 3 and 3.
    """
    corners, weights, gram, best, nearest, back = work
    held, first, second = 0, _middle(one), _middle(other)
    for j in range(3):
        nearest[j] = translation[j] - first[j] + _dot(rotation[j], second)
    for _ in range(TURNS):
        for j in range(3):
            back[j] = -_dot(rotation[:, j], nearest)
        far, near = _farthest_along(one, nearest), _farthest_along(other, back)
        for j in range(3):
            corners[held, j] = translation[j] - one[far, j] + _dot(rotation[j], other[near])
        if _dot(corners[held], nearest) > 0.0:
            return False
        weights[held] = 1.0 if held == 0 else 0.0
        held = _nearest_of(corners, weights, gram, best, held + 1)
        for j in range(3):
            nearest[j] = 0.0
            for k in range(held):
                nearest[j] += weights[k] * corners[k, j]
        if held == 4 or _dot(nearest, nearest) < MEETING * MEETING:
            return True
    return True


@inner
def _nearest_of(corners, weights, gram, best, held):
    """The weights of the point nearest to zero in the hull of the first ``held`` corners.

    Corners of weight 0 are dropped, in place. Returns the number of corners left.
    """
    while True:
        _nearest_of_flat(corners, gram, best, held)
        share, out = 1.0, -1
        for k in range(held):  # the longest step towards ``best`` that leaves no weight negative
            if best[k] <= 0.0 and weights[k] <= share * (weights[k] - best[k]):
                share, out = weights[k] / (weights[k] - best[k]), k
        for k in range(held):
            weights[k] += share * (best[k] - weights[k])
        if out < 0:
            return held
        held -= 1
        for k in range(out, held):
            weights[k] = weights[k + 1]
            for j in range(3):
                corners[k, j] = corners[k + 1, j]


@inner
def _nearest_of_flat(corners, gram, best, held):
    """The weights ``best`` of the point nearest to zero in the flat through corners C (held, 3).

    They solve (C Cᵀ + 1) w = 1, scaled to sum 1. Elimination needs no pivots: the matrix is
    positive definite.
    """
    for i in range(held):
        best[i] = 1.0
        for j in range(held):
            gram[i, j] = _dot(corners[i], corners[j]) + 1.0 + (_RIDGE if i == j else 0.0)
    for i in range(held):
        for k in range(i + 1, held):
            factor = gram[k, i] / gram[i, i]
            best[k] -= factor * best[i]
            for j in range(i, held):
                gram[k, j] -= factor * gram[i, j]
    total = 0.0
    for i in range(held - 1, -1, -1):
        for j in range(i + 1, held):
            best[i] -= gram[i, j] * best[j]
        best[i] /= gram[i, i]
        total += best[i]
    for i in range(held):
        best[i] /= total


@inlined
def _dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@inlined
def _middle(points):
    """The mean of points (m, 3), as a tuple."""
    x, y, z = 0.0, 0.0, 0.0
    for k in range(points.shape[0]):
        x, y, z = x + points[k, 0], y + points[k, 1], z + points[k, 2]
    return x / points.shape[0], y / points.shape[0], z / points.shape[0]


@inner
def _farthest_along(points, way):
    """Index of the point farthest along ``way`` (3,)."""
    best, index = -np.inf, 0
    for k in range(points.shape[0]):
        value = _dot(points[k], way)
        if value > best:
            best, index = value, k
    return index


SORTING_POSTURES = 20_000  # configurations, chosen: for the slack of the final covers
TRYING_POSTURES = 4_000  # configurations, chosen: for the slack while covers are made finer
SHARED = 2_000  # configurations, chosen: for the search for loose spheres
SHARE = 0.010  # chosen: share of them above which a sphere is loose
WRONG = 0.030  # chosen: share of them below which no sphere is loose
ROUNDS = 2  # of halving, at most, chosen: UR10 needs 2
MOSTLY = 0.95  # chosen: share of configurations; above it a check of two links says nothing
OFTEN = 30  # overlaps among SORTING_POSTURES, chosen: the fewest from which a slack is estimated
KEPT = 0.0005  # [m] chosen: subtracted from the slack, as parts are known by corners (DIRECTIONS)
TAIL = 3.0  # chosen: mean gaps of the sampled distances that are subtracted from the slack
FAR = 0.05  # [m] chosen: distance of two covers above which a check is not worth its time
ALONG = 0.9999  # chosen: least cosine between slides of one direction (0.8 degrees)
MOST_LINKS = 3000  # pairs of links, chosen: 78 links have as many; 3,000 links would take hours
_GAPS_AT_ONCE = 10_000_000  # distances in one array, chosen: 80 MB

Found = tuple[IntArray, FloatArray, tuple[LeftOut, ...]]
Finer = Callable[[Robot, IntArray], tuple[Robot, FloatArray]]


def with_self_pairs(
    robot: Robot, allowed: Collection[tuple[str, str]], parts: FloatArray, finer: Finer
) -> Robot:
    """The robot with its self-collision pairs: spheres of links two or more joints apart.

    ``robot``: without pairs. ``allowed``: pairs of links that are left out. ``parts``: (c, 4)
    surfaces of the links whose covers were fitted; see :class:`Parts`. By them :func:`sorted_out`
    gives pairs of such links a slack, or leaves them out. ``finer``: halves the spheres of some
    indices; returns the robot and its parts. Called with the :func:`loose_spheres` in at most
    :data:`ROUNDS` rounds.
    """
    for _ in range(ROUNDS if len(parts) else 0):
        tried = _sorted(robot, allowed, parts, TRYING_POSTURES)
        loose = loose_spheres(tried, parts)
        if not len(loose):
            break
        robot, parts = finer(robot, loose)
    return _sorted(robot, allowed, parts, SORTING_POSTURES)


def _sorted(
    robot: Robot, allowed: Collection[tuple[str, str]], parts: FloatArray, count: int
) -> Robot:
    pairs = candidate_pairs(robot, allowed)
    pairs, slack, out = sorted_out(robot, pairs, list(robot.excess), parts, count)
    return replace(
        robot, self_pairs=frozen(pairs, np.int64), self_slack=frozen(slack), left_out=out
    )


def loose_spheres(robot: Robot, parts: FloatArray) -> IntArray:
    """Indices of the spheres that stop the arm although no surfaces touch.

    A false alarm is a configuration at which spheres overlap by more than their slack, but the
    parts (see :class:`Parts`) of none of these pairs meet. A sphere is loose if it takes part in
    false alarms at more than :data:`SHARE` of :data:`SHARED` random configurations. There are none
    if fewer than :data:`WRONG` of the configurations are false alarms. A sphere that does not move
    is loose only if some of its part lies outside it.
    """
    surfaces, count = Parts(len(robot.spheres.radius), parts), np.zeros(len(robot.spheres.radius))
    wrong = 0
    parts_of = 1 + SHARED * max(len(robot.self_pairs), 1) // _GAPS_AT_ONCE
    for postures in np.array_split(random_postures(robot, SHARED), max(10, parts_of)):
        row, pair = np.nonzero(robot.self_gaps(postures) < 0.0)
        pairs = robot.self_pairs[pair]
        meet = surfaces.touch(robot, robot.segment_frames(postures), row, pairs)
        apart = ~np.isin(row, row[meet])
        short = np.column_stack([np.repeat(row[apart], 2), pairs[apart].ravel()])
        np.add.at(count, np.unique(short, axis=0)[:, 1], 1.0)
        wrong += len(np.unique(row[apart]))
    if wrong < WRONG * SHARED:
        return np.zeros(0, dtype=np.int64)
    able = surfaces.known & ((robot.spheres.segment >= 0) | (surfaces.beyond(robot) > 0.0))
    return np.flatnonzero((count > SHARE * SHARED) & able)


def sorted_out(
    robot: Robot, pairs: IntArray, fitted: Collection[str], given: FloatArray, count: int
) -> Found:
    """The pairs of spheres to keep apart, their slack [m], and the links that are left out.

    Pairs of links named in ``fitted`` are examined at home and at ``count`` random configurations
    (fixed seed). The slack of two spheres is the largest overlap at which their parts stay apart:

    - A sphere that leaves some of its part outside counts as larger by that distance; the slack of
      its pairs may be negative.
    - The samples may miss the largest distance at which parts meet. So the slack is reduced by
      :data:`TAIL` mean gaps between the n sampled distances below it, and by :data:`KEPT`.
    - A pair of spheres that overlaps :data:`OFTEN` while its parts never meet is left out.
    - Two links are left out if pairs overlap by more than their slack at more than :data:`MOSTLY`
      of the configurations, or if their covers keep :data:`FAR` at all of them.
    - If pairs overlap by more than their slack at home, where their parts do not meet, their slack
      is raised to what home needs. If home has a joint at its limit, nobody chose it: then only if
      no configuration at which parts meet is accepted for it.

    Pairs of other links are left out if they overlap at every one of SAMPLED_POSTURES random
    configurations. Of more than :data:`MOST_LINKS` pairs of links none is examined.

    ``pairs``: (P, 2) of spheres. ``given``: (c, 4) the parts; see :class:`Parts`.
    """
    link, names = robot.spheres.link, robot.link_names
    pairs = pairs[np.lexsort((link[pairs[:, 1]], link[pairs[:, 0]]))] if fitted else pairs
    looked = np.isin(link[pairs], [names.index(name) for name in fitted]).all(axis=1)
    kept = [drop_always_touching(robot, pairs[~looked])]
    slacks = [np.zeros(len(kept[0]))]
    pairs, out = pairs[looked], list[LeftOut]()
    if not len(pairs):
        return kept[0], slacks[0], ()
    links, first = np.unique(link[pairs], axis=0, return_index=True)
    if len(links) > MOST_LINKS:
        pairs = np.concatenate([*kept, drop_always_touching(robot, pairs)])
        return pairs, np.zeros(len(pairs)), ()
    sample = _Sample(robot, Parts(len(link), given), count)
    for (a, b), of_links in zip(links, np.split(pairs, first[1:]), strict=True):
        slack, share, nearest = sample.slack(of_links)
        meet = np.isfinite(slack)
        if nearest > FAR:
            why = "never near"
        elif share > MOSTLY:
            why = f"touch at {100.0 * share:.0f} % of configurations"
        else:
            kept.append(of_links[meet])
            slacks.append(slack[meet])
            if meet.all():
                continue
            why = f"{(~meet).sum()} of {len(of_links)} pairs of spheres: only the covers touch"
        out.append(LeftOut(names[a], names[b], why))
    return np.concatenate(kept), np.concatenate(slacks), tuple(out)


class _Sample:
    """Home and random configurations of a robot, with the frames of its segments."""

    def __init__(self, robot: Robot, parts: Parts, count: int) -> None:
        self.robot, self.parts = robot, parts
        postures = np.vstack([robot.home, random_postures(robot, count)])
        self.frames = robot.segment_frames(postures)
        self.balls = dict[tuple[int, int], tuple[FloatArray, float]]()
        self.radius = robot.spheres.radius + parts.beyond(robot)
        self.chosen = ((robot.home > robot.lower) & (robot.home < robot.upper)).all()

    def placed(
        self, link: IntArray, points: FloatArray, rows: slice | IntArray = slice(None)
    ) -> FloatArray:
        """World positions (m, k, 3) [m] at configurations ``rows`` of ``points`` (k, 3), which lie
        on the segment of the spheres ``link`` of one link."""
        segment = int(self.robot.spheres.segment[link[0]])
        origins, rotations = self.frames[0][rows], self.frames[1][rows]
        if segment < 0:
            return np.tile(points, (len(origins), 1, 1))
        turned = np.matmul(points, rotations[:, segment].transpose(0, 2, 1))
        return np.asarray(turned + origins[:, segment, None])

    def slack(self, pairs: IntArray) -> tuple[FloatArray, float, float]:
        """The slack (P,) [m] of pairs (P, 2) of spheres of two links, infinite where their parts
        never meet; the share of configurations at which a pair overlaps by more than its slack; and
        the least gap of all pairs [m]."""
        centers, radius = self.robot.spheres.center, self.radius
        first, i = np.unique(pairs[:, 0], return_inverse=True)
        second, j = np.unique(pairs[:, 1], return_inverse=True)
        full = radius[pairs].sum(axis=1)
        times, least = np.zeros(len(pairs), np.int64), np.inf
        step, overlaps = max(1, CHUNK // len(pairs)), []
        (ball, reached), (further, out_to) = self._ball(first), self._ball(second)
        near = np.flatnonzero(lengths(ball - further) < FAR + reached + out_to)
        for start in range(0, max(len(near), 1), step):
            rows = near[start : start + step]
            one = self.placed(first, centers[first], rows)
            other = self.placed(second, centers[second], rows)
            apart = np.empty((len(one), len(pairs)))
            distances_between(one, other, i, j, apart)
            least = min(least, float((apart - full).min(initial=np.inf)))
            row, pair = np.nonzero(apart < full)
            times += np.bincount(pair, minlength=len(pairs))
            overlaps.append((rows[row], pair, apart[row, pair]))
        row, pair, apart = map(np.concatenate, zip(*overlaps, strict=True))
        order = np.lexsort((-apart, pair))
        reach = self._reach(pairs, row[order], pair[order], apart[order])
        often = OFTEN * len(self.frames[0]) / SORTING_POSTURES
        known = self.parts.known[pairs].all(axis=1) & (times >= often)
        deep, nearest = apart <= reach[pair], full.copy()
        np.minimum.at(nearest, pair, apart)
        unseen = TAIL * (reach - nearest) / np.bincount(pair[deep], minlength=len(pairs)).clip(1)
        slack = np.where(known, np.maximum(full - reach - unseen - KEPT, 0.0), 0.0)
        slack[known & (reach == 0.0)] = np.inf
        if known.any() and not reach.any():  # the links never touch
            slack[:] = np.inf
        short = apart < (full - slack)[pair]
        home = np.flatnonzero(short & (row == 0))
        if len(home) and not self._touch(row[home], pairs[pair[home]]).any():
            freed = slack.copy()
            freed[pair[home]] = full[pair[home]] - apart[home] + KEPT
            still = apart < (full - freed)[pair]
            lost = np.flatnonzero(short & ~still & ~np.isin(row, row[still]))
            if self.chosen or not self._touch(row[lost], pairs[pair[lost]]).any():
                slack = freed
        short = np.unique(row[short])
        slack -= full - self.robot.spheres.radius[pairs].sum(axis=1)
        return slack, len(short) / len(self.frames[0]), least

    def _ball(self, spheres: IntArray) -> tuple[FloatArray, float]:
        """World centres (m, 3) and radius [m] of a ball that encloses ``spheres`` of one link."""
        key = int(self.robot.spheres.link[spheres[0]]), len(spheres)
        if key not in self.balls:
            center, radius = self.robot.spheres.center[spheres], self.radius[spheres]
            middle = center.mean(axis=0)
            reach = float((lengths(center - middle) + radius).max())
            self.balls[key] = self.placed(spheres, middle[None])[:, 0], reach
        return self.balls[key]

    def _touch(self, rows: IntArray, pairs: IntArray) -> BoolArray:
        return self.parts.touch(self.robot, self.frames, rows, pairs)

    def _reach(
        self, pairs: IntArray, row: IntArray, pair: IntArray, apart: FloatArray
    ) -> FloatArray:
        """The largest distance (P,) [m] between the centres of each pair at which its parts meet;
        0 if they never do. Overlaps, by pair and the largest distance first: the configuration
        ``row``, the index ``pair`` and the distance ``apart`` [m]."""
        reach, count = np.zeros(len(pairs)), 8
        at, end = (np.searchsorted(pair, np.arange(len(pairs)), side) for side in ("left", "right"))
        while len(open_ := np.flatnonzero((reach == 0.0) & (at < end))):
            taken = np.minimum(count, end[open_] - at[open_])
            before = np.cumsum(taken) - taken
            index = np.arange(taken.sum()) + np.repeat(at[open_] - before, taken)
            meets = self._touch(row[index], pairs[pair[index]])
            np.maximum.at(reach, pair[index[meets]], apart[index[meets]])
            at[open_] += taken
            count *= 2
        return reach


def telescopes(robot: Robot) -> list[tuple[str, str]]:
    """Pairs of links that slide past one another along one direction, as tubes of a telescope.

    Covers of tubes within tubes overlap, and so do the hulls of their parts; the tubes do not.
    """
    kin, spheres = robot.kinematics, robot.spheres
    links, first = np.unique(spheres.link, return_index=True)
    of_segment = dict[int, list[str]]()
    for link, segment in zip(links, spheres.segment[first], strict=True):
        of_segment.setdefault(int(segment), []).append(robot.link_names[link])
    ways = np.einsum("sij,sj->si", kin.rotation, kin.axis)  # in the frame of the segment before
    slides = kin.kind == PRISMATIC
    alike = np.abs(np.einsum("si,si->s", ways[1:], kin.axis[:-1])) > ALONG
    on = np.append(False, slides[1:] & slides[:-1] & alike)  # with the slide before
    out, first = [], np.maximum.accumulate(np.where(on, 0, np.arange(len(on)))) - 1
    for s in np.flatnonzero(on):
        for other in range(first[s], s - 1):
            out += list(product(of_segment.get(other, ()), of_segment.get(int(s), ())))
    return out
