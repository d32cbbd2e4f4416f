r"""Few spheres over the meshes of a robot.

A sphere of radius r around a point at depth d inside a solid reaches at most :math:`r - d` beyond
it. So to cover a point p from a centre c costs the excess

.. math:: e(p, c) = |p - c| - d(c),

and k spheres of the least excess are a k-centre problem with this distance. It is solved as Lloyd
solves k means: each point goes to the centre that covers it with the least excess, each centre
moves to the candidate that covers its points with the least. The covers grow by one sphere at a
time, where the excess over all meshes is largest; so all covers end with about the same excess.

The solid is a voxel grid: the voxels of the surface, and those that the surface encloses along two
of three axes. So a mesh need not be closed. The whole surface is covered: its triangles are cut
until one centre covers all corners with the least excess, or no side is over half a voxel. A sphere
encloses all of its triangles.
"""

import math
from collections.abc import Callable, Collection, Sequence

import numpy as np
from scipy.ndimage import distance_transform_edt
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist

from optipromp.core.arrays import BoolArray, FloatArray, IntArray
from optipromp.core.compiled import called, kernel
from optipromp.core.processes import in_threads


@called
def _largest(cost, rows, out):
    """The maximum ``out`` (m,) over ``rows`` (k,) of ``cost`` (n, m), in place."""
    out[:] = -np.inf
    for i in rows:
        for j in range(out.shape[0]):
            out[j] = cost[i, j] if cost[i, j] > out[j] else out[j]


@kernel
def owners(pieces, centers, radius, owner, beyond):
    """The ball beyond which the corners of each piece (n, c, 3) reach the least: index ``owner``
    (n,) and distance ``beyond`` (n,) [m], in place. Balls: ``centers`` (k, 3), ``radius`` (k,)."""
    for i in range(pieces.shape[0]):
        beyond[i] = np.inf
        for k in range(centers.shape[0]):
            out = -np.inf
            for c in range(pieces.shape[1]):
                x = pieces[i, c, 0] - centers[k, 0]
                y = pieces[i, c, 1] - centers[k, 1]
                z = pieces[i, c, 2] - centers[k, 2]
                out = max(out, math.sqrt(x * x + y * y + z * z) - radius[k])
            if out < beyond[i]:
                beyond[i], owner[i] = out, k


VOXEL = 0.003  # [m] chosen: edge of the voxels, for meshes of 0.12 to 0.48 m
TIGHT = 0.008  # [m] chosen: excess at which a cover gets no further sphere
MOST_SPHERES = 40  # of a cover, chosen
_FINE, _COARSE = 40, 160  # voxels along the longest side, chosen: at least, at most
_VOXELS = 300_000  # of a mesh's box, chosen: at most about so many
_STEP = 0.7  # [voxels] chosen: distance of the points of a surface
MOST_SAMPLES = 10_000_000  # points of a surface, chosen: they take 8 s; a stock robot has 2 million
_AT_ONCE = 300_000  # points of a surface in one array, chosen: 7 MB
_FINE_STEP = 0.5  # [voxels] chosen: longest side of a triangle that two spheres share
_POINTS, _CENTERS = 1_200, 2_500  # chosen: points and candidates while a cover grows; at most
_SHARES = (0.6, 0.85)  # chosen: excess that a split aims at, over that before
_ROUNDS = 12  # iterations of Lloyd's algorithm, chosen: at most
_SLACK = 1.0 + 1e-9  # factor of the radii, against rounding
_SLENDER, _SLICE = 4.0, 2.0  # chosen: longest side over height, of a thin triangle and its slices
_FOOT = 1e-9  # of a side: least distance of the foot of the height from its ends


def fit_covers(
    meshes: Sequence[FloatArray], spheres: float, loose: Sequence[float]
) -> list[tuple[FloatArray, float]]:
    """Covers of meshes by spheres.

    ``meshes``: triangles (f, 3, 3) [m] of each mesh. ``spheres``: mean number of spheres of a mesh;
    fewer if all covers have an excess of at most :data:`TIGHT`, more for a cover whose excess is
    above its ``loose``. ``loose``: excess of each mesh [m].

    Returns: For each mesh its spheres (k, 4), centres and radii, and their excess: the largest
    distance [m] by which they reach beyond the mesh, within about a voxel.
    """
    fits = in_threads(_Fit, meshes, loose)
    while growing := [fit for fit in fits if not fit.done and fit.excess > TIGHT]:
        if sum(len(fit.chosen) for fit in fits) >= round(spheres * len(fits)):
            growing = [fit for fit in growing if fit.excess > fit.loose]
        if not growing:
            break
        max(growing, key=lambda fit: fit.excess).split()
    return in_threads(_Fit.finished, fits)


def finer(
    triangles: FloatArray, spheres: FloatArray, split: Collection[int]
) -> tuple[FloatArray, float]:
    """The cover ``spheres`` (k, 4) of a mesh (f, 3, 3), with those of indices ``split`` halved.

    Each is cut across that principal axis of its points that gives the least excess. Returns the
    spheres and their excess [m]; see :func:`fit_covers`.
    """
    fit = _Fit(triangles, 0.0)
    chosen: list[int] = cdist(spheres[:, :3], fit.centers).argmin(axis=1).tolist()
    points, owner = fit.few, fit.cost[:, chosen].argmin(axis=1)
    halves = []
    for own in split:
        mine = np.flatnonzero(owner == own)
        if len(mine) < 4:  # too few to have axes
            continue
        middle = points[mine] - points[mine].mean(axis=0)
        tried = []
        for axis in np.linalg.svd(middle, full_matrices=False)[2]:
            low = middle @ axis < np.ptp(middle @ axis) / 2.0 + (middle @ axis).min()
            if low.all() or not low.any():  # all in one plane across the axis
                continue
            cost = [fit.cost[mine[half]].max(axis=0) for half in (low, ~low)]
            tried.append((sum(c.min() for c in cost), [int(c.argmin()) for c in cost]))
        if tried:
            chosen[own], other = min(tried)[1]
            halves.append(other)
    fit.chosen = [*chosen, *halves]
    return fit.cover()


class _Fit:
    """A growing cover: ``chosen`` indices of candidate centres, and their ``excess`` [m]."""

    def __init__(self, triangles: FloatArray, loose: float) -> None:
        self.loose, low = loose, triangles.min(axis=(0, 1))
        size = np.ptp(triangles, axis=(0, 1))
        self.voxel = voxel(triangles)
        self.triangles, self.origin = triangles, low - 2.5 * self.voxel
        shape = np.ceil(size / self.voxel).astype(np.int64) + 6
        touched = np.zeros(shape, dtype=bool)
        found = []  # the first point in each voxel; the surface of a fine mesh has many more
        step = _STEP * self.voxel
        part = np.cumsum(samples(triangles, step)) // _AT_ONCE
        for some in np.split(triangles, np.flatnonzero(np.diff(part)) + 1):
            surface = spread_points(some, step)
            touched[self._index(surface)] = True
            found.append(surface[_thinned(surface - low, self.voxel)])
        surface = np.concatenate(found)
        self.points = surface[_thinned(surface - low, self.voxel)]
        solid = enclosed(touched)
        into = distance_transform_edt(solid)
        self.depth = self.voxel * (into - 1.0)  # at the voxels' middles; negative outside
        self.outside = self.points[into[self._index(self.points)] < 2.0]  # others can touch it
        inside = np.argwhere(solid)
        depth = self.depth[tuple(inside.T)]
        order = np.argsort(-depth, kind="stable")  # of the candidates in a cell the deepest stays
        sparse = max(1.0, (len(inside) / _CENTERS) ** (1.0 / 3.0))
        inside = inside[order]
        inside = inside[_thinned(inside, sparse, _CENTERS)]
        self.centers = self._middle(inside)
        self.few = self.points[_thinned(self.points - low, 2.0 * self.voxel, _POINTS)]
        cost = cdist(self.few, self.centers) - self.depth[tuple(inside.T)]
        self.cost = cost.astype(np.float32)  # excess of covering each point from each candidate
        self.known = dict[bytes, int]()
        self.chosen = [self._center(np.arange(len(self.few)))]
        self.excess = float(self.cost[:, self.chosen].max())
        self.at = inside
        self.done = False

    def _index(self, points: FloatArray) -> tuple[IntArray, ...]:
        return tuple(np.floor((points - self.origin) / self.voxel).astype(np.int64).T)

    def _middle(self, index: IntArray) -> FloatArray:
        return np.asarray(self.origin + (index + 0.5) * self.voxel)

    def split(self) -> None:
        """Put a second centre into the loosest sphere, and let all centres settle."""
        excess, chosen = self._split(self.chosen)
        self.done = len(chosen) in (len(self.chosen), MOST_SPHERES)  # no use, or no more allowed
        self.excess, self.chosen = excess, chosen

    def finished(self) -> tuple[FloatArray, float]:
        """The cover, after each centre was removed in turn and another sphere split, where that
        lowers the excess."""
        for center in list(self.chosen):
            if center in self.chosen and len(self.chosen) > 1:
                rest = [other for other in self.chosen if other != center]
                self.excess, self.chosen = min(
                    (self.excess, self.chosen), self._split(self._settled(rest)[1])
                )
        return self.cover()

    def _split(self, chosen: list[int]) -> tuple[float, list[int]]:
        """Excess and centres after a centre joined the loosest sphere; ``chosen`` if none helps."""
        cost = self.cost[:, chosen]
        needed, owner = cost.min(axis=1), cost.argmin(axis=1)
        worst = int(needed.argmax())
        mine = np.flatnonzero(owner == owner[worst])
        tried = [(float(needed[worst]), chosen)]
        for share in _SHARES:
            limit = share * needed[worst]
            able = np.flatnonzero(self.cost[worst] <= limit)
            if len(able):  # the centre that covers the worst point and most of its neighbours
                most = (self.cost[np.ix_(mine, able)] <= limit).sum(axis=0).argmax()
                tried.append(self._settled([*chosen, int(able[most])]))
        return min(tried)

    def _settled(self, chosen: list[int]) -> tuple[float, list[int]]:
        """Excess and centres after Lloyd's iterations from ``chosen``."""
        best = (np.inf, chosen)
        for _ in range(_ROUNDS):
            cost = self.cost[:, chosen]
            excess, owner = float(cost.min(axis=1).max()), cost.argmin(axis=1)
            if excess >= best[0]:
                break
            best = (excess, chosen)
            chosen = [self._center(np.flatnonzero(owner == k)) for k in np.unique(owner)]
        return best

    def _center(self, points: IntArray) -> int:
        """The candidate that covers ``points`` (indices into ``few``) with the least excess."""
        key = points.tobytes()
        if key not in self.known:  # most sets of points come again and again
            _largest(self.cost, points, most := np.empty(self.cost.shape[1], np.float32))
            self.known[key] = int(most.argmin())
        return self.known[key]

    def cover(self) -> tuple[FloatArray, float]:
        """The cover of all points of the surface, its centres moved by voxels."""
        at = self.at[self.chosen]
        points = self.points
        best, held = np.inf, at
        for _ in range(_ROUNDS):
            owner, beyond = _owners(points[:, None], self._middle(at), self.depth[tuple(at.T)])
            excess = float(beyond.max())
            if excess >= best - 1e-6:
                break
            best, held = excess, at
            at = np.array([self._moved(at[k], points[owner == k]) for k in np.unique(owner)])
        centers, depth = self._middle(held), self.depth[tuple(held.T)]
        pieces, owner = shared_out(self.triangles, centers, depth, _FINE_STEP * self.voxel)
        used = np.unique(owner)  # a sphere that holds the corners of a piece holds the piece
        corners = [pieces[owner == k].reshape(-1, 3) for k in used]
        radius = np.array(
            [_farthest(own, centers[[k]])[0] for k, own in zip(used, corners, strict=True)]
        )
        depth = cKDTree(self.outside).query(centers[used])[0]
        return np.column_stack([centers[used], radius * _SLACK]), float((radius - depth).max())

    def _moved(self, at: IntArray, points: FloatArray) -> IntArray:
        """The voxel near ``at`` from which ``points`` are covered with the least excess."""
        near = at + _NEARBY
        near = near[((near >= 0) & (near < self.depth.shape)).all(axis=1)]
        depth = self.depth[tuple(near.T)]
        near, depth = near[depth >= 0.0], depth[depth >= 0.0]
        best: IntArray = near[int((_farthest(points, self._middle(near)) - depth).argmin())]
        return best


_NEARBY = np.stack(np.meshgrid(*[np.arange(-2, 3)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)


def voxel(triangles: FloatArray) -> float:
    """Edge of the voxels of a mesh (f, 3, 3) [m]."""
    size = np.ptp(triangles, axis=(0, 1))
    longest = float(size.max())
    cube: float = float(np.prod(size) / _VOXELS) ** (1.0 / 3.0)
    return max(min(VOXEL, longest / _FINE), longest / _COARSE, cube)


def count_samples(triangles: FloatArray) -> int:
    """The number of points, at most, that sample the surface of a mesh (f, 3, 3)."""
    return int(samples(triangles, _STEP * voxel(triangles)).sum())


def samples(triangles: FloatArray, step: float) -> IntArray:
    """The number (f,) of points, at most, that :func:`spread_points` puts on each
    triangle (f, 3, 3)."""
    length = np.linalg.norm(triangles[:, [1, 2, 0]] - triangles, axis=2).max(axis=1)
    a, b, c = (triangles[:, k] for k in range(3))
    height = np.linalg.norm(np.cross(b - a, c - a), axis=1) / np.maximum(length, 1e-12)
    rows, along = (np.ceil(side / step).astype(np.int64) + 1 for side in (height, length))
    return np.asarray(rows * along)


def spread_points(triangles: FloatArray, step: float) -> FloatArray:
    """Points (m, 3) on triangles (f, 3, 3), in rows along the longest sides, ``step`` [m] apart."""
    sides = np.linalg.norm(triangles[:, [1, 2, 0]] - triangles, axis=2)
    longest, each = sides.argmax(axis=1), np.arange(len(triangles))
    a, b, c = (triangles[each, (longest + k) % 3] for k in range(3))
    length = sides.max(axis=1)
    height = np.linalg.norm(np.cross(b - a, c - a), axis=1) / np.maximum(length, 1e-12)
    rows = np.ceil(height / step).astype(np.int64) + 1
    row, up = _counted(rows)
    length, up = length[row] * (1.0 - up), up[:, None]
    start, end = a[row] + up * (c - a)[row], b[row] + up * (c - b)[row]
    point, along = _counted(np.ceil(length / step).astype(np.int64) + 1)
    return np.asarray(start[point] + along[:, None] * (end - start)[point])


def _counted(count: IntArray) -> tuple[IntArray, FloatArray]:
    """Index k repeated ``count[k]`` times, and for each repetition a share rising from 0 to 1."""
    index = np.repeat(np.arange(len(count)), count)
    turn = np.arange(len(index)) - (np.cumsum(count) - count)[index]
    return index, turn / np.maximum(count[index] - 1, 1)


def shared_out(
    triangles: FloatArray, centers: FloatArray, radius: FloatArray, step: float
) -> tuple[FloatArray, IntArray]:
    """A surface (f, 3, 3) cut into pieces (m, 3, 3), and the index (m,) of the ball of each.

    A piece belongs to the ball beyond which its corners reach the least. It is cut until that is
    the same ball for each of its corners, or no side is over ``step`` [m].
    """

    def whole(pieces: FloatArray) -> BoolArray:
        owner = _owners(pieces.reshape(-1, 1, 3), centers, radius)[0].reshape(-1, 3)
        return np.asarray(np.ptp(owner, axis=1) == 0)

    pieces = cut(triangles, step, whole)
    return pieces, _owners(pieces, centers, radius)[0]


def _owners(
    pieces: FloatArray, centers: FloatArray, radius: FloatArray
) -> tuple[IntArray, FloatArray]:
    """Owner (m,) of each piece, and the excess of each (m,) [m]; see :func:`owners`."""
    owner, beyond = np.zeros(len(pieces), np.int64), np.empty(len(pieces))
    owners(pieces, centers, radius, owner, beyond)
    return owner, beyond


def _farthest(points: FloatArray, centers: FloatArray) -> FloatArray:
    """Distance (m,) of each centre from its farthest point [m]."""
    return np.asarray(np.sqrt(cdist(points, centers, "sqeuclidean").max(axis=0)))


def cut(
    triangles: FloatArray, step: float, whole: Callable[[FloatArray], BoolArray] | None = None
) -> FloatArray:
    """The surface of triangles (f, 3, 3) as triangles (c, 3, 3) with no side over ``step`` [m].

    The longest side is halved until it is short, or until ``whole`` (m,) of the triangles is true.
    A triangle over :data:`_SLENDER` times as long as high is cut across instead: its halves would
    be as thin, and their number would grow with the square of the length.
    """
    done = []
    while len(triangles):
        turned = triangles[:, [1, 2, 0]]
        sides = np.square(turned - triangles).sum(axis=2)
        long = (sides > step * step).any(axis=1)
        if whole is not None:
            long[long] = ~whole(triangles[long])
        done.append(triangles[~long])
        longest = sides[long].argmax(axis=1)
        each = np.flatnonzero(long)
        a, b, c = (triangles[each, (longest + k) % 3] for k in range(3))
        length = np.sqrt(sides[each, longest])
        wide = np.linalg.norm(np.cross(b - a, c - a), axis=1) / np.maximum(length, 1e-12)
        parts = length / np.maximum(wide, step)
        thin, middle = parts > _SLENDER, 0.5 * (a + b)
        halves = [np.stack([a, middle, c], 1)[~thin], np.stack([middle, b, c], 1)[~thin]]
        count = np.ceil(parts[thin] / _SLICE).astype(np.int64)
        triangles = np.concatenate([*halves, _across(a[thin], b[thin], c[thin], count)])
    return np.concatenate(done)


def _across(a: FloatArray, b: FloatArray, c: FloatArray, count: IntArray) -> FloatArray:
    """Triangles abc (f, 3, 3) cut into (m, 3, 3), side ab in ``count`` (f,) parts, 2 or more.

    Each point of that side is joined to the point above it on the other two sides. One point is the
    foot of the height through ``c``.
    """
    along = b - a
    foot = ((c - a) * along).sum(axis=1) / np.square(along).sum(axis=1)
    foot = np.clip(foot, _FOOT, 1.0 - _FOOT)
    below = np.clip(np.rint(foot * count), 1, count - 1).astype(np.int64)
    own, share = _counted(count + 1)
    share[np.cumsum(count + 1) - (count + 1) + below] = foot
    far = share > foot[own]
    end = np.where(far[:, None], b[own], a[own])
    up = np.where(far, (1.0 - share) / (1.0 - foot[own]), share / foot[own])
    low, high = a[own] + share[:, None] * along[own], end + up[:, None] * (c[own] - end)
    one = np.flatnonzero(share < 1.0)  # every point of a side but its last, and the next one
    two = one + 1
    lower = np.stack([low[one], low[two], high[two]], 1)
    upper = np.stack([low[one], high[two], high[one]], 1)
    return np.concatenate([lower[share[two] < 1.0], upper[share[one] > 0.0]])


def enclosed(touched: BoolArray) -> BoolArray:
    """The voxels of a surface, and those that it encloses along two of the three axes."""
    axes = np.zeros(touched.shape, dtype=np.int8)
    for axis in range(3):
        before = np.logical_or.accumulate(touched, axis=axis)
        after = np.flip(np.logical_or.accumulate(np.flip(touched, axis), axis=axis), axis)
        axes += before & after
    return np.asarray(touched | (axes >= 2))


def _thinned(points: FloatArray | IntArray, edge: float, most: float = np.inf) -> IntArray:
    """Indices of the first point in each cell of a grid; ``edge`` grows until at most ``most``."""
    points = points.astype(np.float64)
    end = points.max(axis=0)
    while True:
        shape = np.maximum(np.floor(end / edge), 0.0).astype(np.int64) + 1
        cells = np.maximum(np.floor(points / edge), 0.0).astype(np.int64)
        codes = np.ravel_multi_index(tuple(cells.T), tuple(shape))
        first = np.full(int(shape.prod()), -1)  # of a cell, the point that is written last stays
        first[codes[::-1]] = np.arange(len(points))[::-1]
        first = np.sort(first[first >= 0])
        if len(first) <= most:
            return first
        edge *= max(1.05, (len(first) / most) ** (1.0 / 3.0))
