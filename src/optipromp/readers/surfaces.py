"""The surface of a link in parts, one for each sphere of its cover.

Each small piece of the surface belongs to the sphere that holds it best. Two links touch only where
a part of one meets a part of the other. So spheres may overlap while their parts are apart: while
a plane separates the convex hulls of the parts.
"""

import numpy as np
from scipy.spatial import ConvexHull

from optipromp.core.arrays import BoolArray, FloatArray, IntArray
from optipromp.core.compiled import inlined, inner, kernel
from optipromp.core.robots.model import Robot
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
    faces: FloatArray = points[ConvexHull(points).simplices]
    return faces


def parts(spheres: FloatArray, triangles: FloatArray) -> FloatArray:
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
    part. ``given`` (c, 4): points as :func:`parts` returns them, with indices of the B spheres.
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


@inner
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
