r"""The surface of a link in parts, one a sphere of its cover: whether links touch, or only covers.

Each small piece of the surface belongs to the sphere that holds it best. Two links touch only where
a part of one meets a part of the other; so spheres may overlap as long as their parts stay apart,
and that is seen by a plane between the parts' convex hulls.
"""

import numpy as np

from optipromp.arrays import BoolArray, FloatArray, IntArray
from optipromp.robots.model import Robot

PIECE = 0.010  # [m] chosen: longest side of the pieces of a surface
ROUND = 64  # chosen: sides of a rod; of a radius of 0.1 m they cut off 0.12 mm
DIRECTIONS = 300  # chosen: the points of a part that are the farthest in one of them are kept
TURNS = 20  # chosen: of a plane between two parts, until they count as touching
_AT_ONCE = 4_000  # pairs of parts at once


def of_box(size: FloatArray) -> FloatArray:
    """Triangles (f, 3, 3) of the surface of a box of sizes (3,)."""
    return _hull(0.5 * size * np.stack(np.meshgrid(*[[-1.0, 1.0]] * 3), axis=-1).reshape(-1, 3))


def of_rod(radius: float, length: float, round_ends: float) -> FloatArray:
    """The same of a cylinder along z; its ends bulge by ``round_ends``: 0, or the radius."""
    bend = np.linspace(0.0, 0.5 * np.pi, ROUND // 4 + 1)[: None if round_ends else 1]
    turn = np.linspace(0.0, 2.0 * np.pi, ROUND, endpoint=False)
    ring = np.column_stack([np.cos(turn), np.sin(turn), np.ones(ROUND)])
    rows = np.column_stack([radius * np.cos(bend)] * 2 + [0.5 * length + round_ends * np.sin(bend)])
    half = (ring[None] * rows[:, None]).reshape(-1, 3)
    return _hull(np.concatenate([half, half * [1.0, 1.0, -1.0]]))


def _hull(points: FloatArray) -> FloatArray:
    from scipy.spatial import ConvexHull

    faces: FloatArray = points[ConvexHull(points).simplices]
    return faces


def parts(spheres: FloatArray, triangles: FloatArray) -> FloatArray:
    """Points (c, 4) of a surface of triangles (f, 3, 3) [m], each with the index of a sphere.

    ``spheres`` (k, 4) cover it. The hull of a sphere's points holds its part of the surface.
    """
    from scipy.spatial.distance import cdist

    from optipromp.robots.fit import cut  # with SciPy's image functions, which load slowly

    pieces = cut(triangles, PIECE)
    beyond = np.full((len(spheres), len(pieces)), -np.inf)
    for corner in range(3):
        away = cdist(spheres[:, :3], pieces[:, corner]) - spheres[:, 3:]
        np.maximum(beyond, away, out=beyond)
    owner, out = beyond.argmin(axis=0), []
    for index in np.unique(owner):
        points = _farthest(pieces[owner == index].reshape(-1, 3))
        out.append(np.column_stack([points, np.full(len(points), float(index))]))
    return np.concatenate(out)


def _farthest(points: FloatArray) -> FloatArray:
    """Those of ``points`` (m, 3) that are the farthest in one of the directions."""
    ways = _directions()
    for chunk in (_AT_ONCE, len(points)):  # of the farthest of each chunk the farthest
        starts = range(0, len(points), chunk)
        far = [start + (ways @ points[start : start + chunk].T).argmax(axis=1) for start in starts]
        points = points[np.unique(far)]
    return points


def _directions() -> FloatArray:
    """Unit vectors (DIRECTIONS, 3), spread evenly (Fibonacci's spiral), and the six of the axes."""
    k = np.arange(DIRECTIONS) + 0.5
    z, turn = 1.0 - 2.0 * k / DIRECTIONS, np.pi * (1.0 + np.sqrt(5.0)) * k
    flat = np.sqrt(1.0 - z * z)
    even = np.column_stack([flat * np.cos(turn), flat * np.sin(turn), z])
    return np.concatenate([even, np.eye(3), -np.eye(3)])


class Parts:
    """The parts of a robot's spheres, as arrays: ``points`` (B, M, 3) in the segments' frames.

    A part of fewer than M points has its last one several times; a sphere without one is not in
    ``known`` (B,). ``given`` are those of :func:`parts`, with indices of the robot's spheres.
    """

    def __init__(self, count: int, given: FloatArray) -> None:
        index = given[:, 3].astype(np.int64)
        found, start, size = np.unique(index, return_index=True, return_counts=True)
        rows = start[:, None] + np.minimum(np.arange(size.max(initial=1)), size[:, None] - 1)
        self.points = np.zeros((count, rows.shape[1], 3))
        self.points[found] = given[rows, :3]
        self.known = np.isin(np.arange(count), found)

    def touch(
        self, robot: Robot, frames: tuple[FloatArray, FloatArray], pairs: IntArray
    ) -> BoolArray:
        """Whether the parts of pairs of spheres (m, 2) may touch, each at frames of its own.

        ``frames`` are origins (m, S, 3) and rotations (m, S, 3, 3). A plane between two hulls
        proves them apart; see :func:`hulls_touch`.
        """
        out = np.empty(len(pairs), dtype=bool)
        for start in range(0, len(pairs), _AT_ONCE):
            rows = slice(start, start + _AT_ONCE)
            one, other = (
                self._placed(robot, (frames[0][rows], frames[1][rows]), pairs[rows, side])
                for side in (0, 1)
            )
            out[rows] = hulls_touch(one, other)
        return out

    def _placed(
        self, robot: Robot, frames: tuple[FloatArray, FloatArray], index: IntArray
    ) -> FloatArray:
        segment, each = robot.spheres.segment[index], np.arange(len(index))
        turns = frames[1][each, segment].transpose(0, 2, 1)
        placed: FloatArray = np.matmul(self.points[index], turns)
        placed += frames[0][each, segment][:, None]
        fixed = segment < 0
        placed[fixed] = self.points[index[fixed]]
        return placed


def hulls_touch(one: FloatArray, other: FloatArray) -> BoolArray:
    """Whether the hulls of points (m, M, 3) and (m, M, 3) cannot be told apart by TURNS planes.

    Of their difference (Minkowski's) the corner farthest against the point nearest to zero so far
    is added to the corners known; the nearest point of these is found by moving weight from the
    corner farthest along it to the one least far (Mitchell, Demyanov and Malozemov).
    """
    left, each = np.arange(len(one)), np.arange(len(one))
    nearest = other.mean(axis=1) - one.mean(axis=1)
    corners, weights = np.zeros((len(one), TURNS, 3)), np.zeros((len(one), TURNS))
    for turn in range(TURNS):
        way = nearest[:, :, None]
        far = one[left][each, np.matmul(one[left], way)[:, :, 0].argmax(axis=1)]
        near = other[left][each, np.matmul(other[left], way)[:, :, 0].argmin(axis=1)]
        corner = near - far
        still = (corner * nearest).sum(axis=1) <= 0.0
        left, corners, weights = left[still], corners[still], weights[still]
        each = np.arange(len(left))
        corners[:, turn], weights[:, turn] = corner[still], float(turn == 0)
        known = corners[:, : turn + 1]
        for _ in range(turn + 1):
            nearest = np.matmul(weights[:, None, : turn + 1], known)[:, 0]
            along = np.matmul(known, nearest[:, :, None])[:, :, 0]
            to = along.argmin(axis=1)
            start = np.where(weights[:, : turn + 1] > 0.0, along, -np.inf).argmax(axis=1)
            back = known[each, start] - known[each, to]
            share = (back * nearest).sum(axis=1) / np.maximum((back * back).sum(axis=1), 1e-18)
            share = np.clip(share, 0.0, weights[each, start])
            weights[each, start] -= share
            weights[each, to] += share
        nearest = np.matmul(weights[:, None, : turn + 1], known)[:, 0]
    out = np.zeros(len(one), dtype=bool)
    out[left] = True
    return out
