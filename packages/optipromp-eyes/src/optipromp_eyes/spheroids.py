"""Spheroids through what one view shows of fruits: the depths of fronts, and outlines."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from optipromp.core.arrays import BoolArray, FloatArray, IntArray, frame_along
from optipromp.core.compiled import kernel
from optipromp_eyes.finder import Region
from optipromp_eyes.geometry import edge_of, middle_of, morphed
from optipromp_eyes.parameters import EyeParameters
from optipromp_eyes.pictures import DepthPicture

Codes = NDArray[np.int8]  # (height, width) the colour of each pixel; 0: none
RUN = 4.0  # [pixel] of outline, which errs by a pixel, that errs as one: a guess
MODEL = 0.0015  # [m] measured deviation of a centre besides: fruits are no spheroids
TIP = 0.2  # of the radius, measured: the same along an axis in view, whose length the tip hides
HUBER = 2.0  # [standard deviations] beyond which a residual counts linearly: a choice


class FitData(NamedTuple):
    """What R fits use, padded with weights 0."""

    points: FloatArray  # (R, P, 3) of fronts [m]
    weights: FloatArray  # (R, P) [1/m]
    rays: FloatArray  # (R, K, 3) through free outlines
    pulls: FloatArray  # (R, K) their weights [1/m]


def _squares(vectors: FloatArray) -> FloatArray:
    """Squared lengths (R, N) of vectors (R, N, 3)."""
    return np.asarray(np.einsum("rni,rni->rn", vectors, vectors))


def axis_of(x: FloatArray, axes: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Axes (R, 3) of states (R, 7), and their derivatives (R, 2, 3) by the tilts."""
    ways = x[:, 5:] @ axes[:, :2].T + axes[:, 2]
    size = np.linalg.norm(ways, axis=1)[:, None]
    ways = ways / size
    slope = axes[:, :2].T[None] - (ways @ axes[:, :2])[:, :, None] * ways[:, None]
    return ways, slope / size[:, :, None]


@kernel
def system(x, axis, turn, data):
    """Weighted residuals (R, P + K) of states (R, 7), by their robust weights the sums of squares
    of the derivatives (R, 7, 7), and of derivatives by residuals (R, 7).

    ``axis``, ``turn``: of :func:`axis_of`. ``data``: :class:`FitData`.
    """
    count, depths = data.weights.shape
    all_of = depths + data.pulls.shape[1]
    residuals = np.zeros((count, all_of))
    squares, sums, slope = np.zeros((count, 7, 7)), np.zeros((count, 7)), np.empty(7)
    for r in range(count):
        longer, radius = math.exp(-2.0 * x[r, 4]), math.exp(x[r, 3])
        k, a0, a1, a2 = longer - 1.0, axis[r, 0], axis[r, 1], axis[r, 2]
        c0, c1, c2 = x[r, 0], x[r, 1], x[r, 2]
        bent = k * (c0 * a0 + c1 * a1 + c2 * a2)
        for n in range(all_of):
            weight = data.weights[r, n] if n < depths else data.pulls[r, n - depths]
            if weight == 0.0:
                continue
            if n < depths:
                d0, d1, d2 = data.points[r, n]
            else:
                d0, d1, d2 = data.rays[r, n - depths]
                along = d0 * a0 + d1 * a1 + d2 * a2
                across = d0 * c0 + d1 * c1 + d2 * c2 + bent * along
                share = across / max(d0 * d0 + d1 * d1 + d2 * d2 + k * along * along, 1e-12)
                d0, d1, d2 = share * d0, share * d1, share * d2
            d0, d1, d2 = d0 - c0, d1 - c1, d2 - c2
            s = d0 * a0 + d1 * a1 + d2 * a2
            size = math.sqrt(max(d0 * d0 + d1 * d1 + d2 * d2 + k * s * s, 1e-12))
            slope[0], slope[1], slope[2] = -d0 - k * s * a0, -d1 - k * s * a1, -d2 - k * s * a2
            slope[3], slope[4] = -radius * size, -longer * s * s
            for j in range(2):
                way = turn[r, j]
                slope[5 + j] = k * s * (d0 * way[0] + d1 * way[1] + d2 * way[2])
            now = residuals[r, n] = (size - radius) * weight
            robust = min(1.0, HUBER / max(abs(now), 1e-9))
            for i in range(7):
                slope[i] *= weight / size
                sums[r, i] += robust * slope[i] * now
                for j in range(i + 1):
                    squares[r, i, j] += robust * slope[i] * slope[j]
        for i in range(7):
            for j in range(i):
                squares[r, j, i] = squares[r, i, j]
    return residuals, squares, sums


def descended(
    x: FloatArray, axes: FloatArray, data: FitData, p: EyeParameters, steps: int
) -> tuple[FloatArray, FloatArray]:
    """States (R, 7) after some steps of Gauss-Newton, and the last Hessians (R, 7, 7)."""
    prior = np.array([0.0, 0.0, 0.0, math.log(p.radius), p.longer, 0.0, 0.0])
    tilt = math.radians(p.tilt)
    sharp = np.array([0.0] * 3 + [p.radius_spread, p.longer_spread, tilt, tilt])
    sharp[3:] **= -2.0
    hessian = np.tile(np.eye(7), (len(x), 1, 1))
    for _ in range(steps):
        _, squares, sums = system(x, *axis_of(x, axes), data)
        hessian = squares + np.diag(sharp + 1e-9)
        gradient = sums + sharp * (x - prior)
        step = np.linalg.solve(hessian, gradient[:, :, None])[:, :, 0]
        far = np.abs(step[:, :3]).max(axis=1, keepdims=True) > 0.02
        x = x - np.where(far, np.clip(step, -0.02, 0.02), step)
        x[:, 3] = np.clip(x[:, 3], math.log(0.5 * p.least_radius), math.log(2 * p.most_radius))
        x[:, 4:] = np.clip(x[:, 4:], -0.7, 0.7)
    return x, hessian


class SpheroidRows(NamedTuple):
    """R spheroids: centres (R, 3), axes (R, 3), radii (R,), half lengths (R,)."""

    center: FloatArray
    axis: FloatArray
    radius: FloatArray
    half: FloatArray


def surface(rays: FloatArray, balls: SpheroidRows) -> tuple[FloatArray, FloatArray]:
    """Of rays (R, N, 3): distance from the centre in radii, and depth of the front, beyond the
    outline that of the nearest point."""
    center, axis, radius = balls.center, balls.axis, balls.radius[:, None]
    k = (radius / balls.half[:, None]) ** 2 - 1.0
    metric = center + k * (center * axis).sum(axis=1)[:, None] * axis
    along = np.matmul(rays, axis[:, :, None])[:, :, 0]
    across = np.matmul(rays, metric[:, :, None])[:, :, 0]
    size = _squares(rays) + k * along**2
    share = across / size
    square = (center * metric).sum(axis=1)[:, None] - across * share
    root = np.sqrt(np.maximum(radius**2 - square, 0.0) / size)
    return np.sqrt(np.maximum(square, 0.0)) / radius, share - root


def planar(points: FloatArray, weights: FloatArray) -> float:
    """Root mean square distance of points (N, 3) from their plane, by their weights (N,)."""
    off = points - points.mean(axis=0)
    across = np.linalg.eigh(off.T @ off)[1][:, 0]
    return float(np.sqrt(np.mean(((off @ across) * weights) ** 2)))


def padded(rows: Sequence[FitData]) -> FitData:
    """Data of one fit each, (1, ...), as one."""
    most = [max(each[k].shape[0] for each in rows) for k in range(4)]
    out = [np.zeros((len(rows), most[k], *rows[0][k].shape[1:])) for k in range(4)]
    for row, each in enumerate(rows):
        for k in range(4):
            out[k][row, : len(each[k])] = each[k]
    return FitData(*out)


def states_of(places: FloatArray, radii: FloatArray, p: EyeParameters) -> FloatArray:
    """States (R, 7) of upright fruits behind the middles (R, 3) of their fronts."""
    away = 1.0 + 0.7 * radii / np.linalg.norm(places, axis=1)
    rest = np.tile([p.longer, 0.0, 0.0], (len(radii), 1))
    return np.column_stack([places * away[:, None], np.log(radii), rest])


MOST_POINTS, MOST_RAYS = 120, 60  # that a fit uses: a choice
TOUCHING = 1e-3  # [m] depth below which nothing is measured, but numbers overflow: a choice
CROSS = np.array([[0, 1, 0], [1, 1, 1], [0, 1, 0]], dtype=bool)
INSIDE = 2  # [pixel] from the outline to the depths that are used: edges of depth are ragged
BEFORE = 0.006  # [m] by which something that hides a fruit is nearer than it: a choice
GRID, WIDE = 25, 1.4  # samples across a fruit, and radii from its middle to the last: a choice
TURNS, TICKS = 48, 64  # directions in which an outline is looked for, and samples along: a choice
BEYOND = 3.0, 5.0  # [pixel] beyond an outline, where what hides the fruit would be: a choice


class SpheroidViews(NamedTuple):
    """What the picture shows of R spheroids; names as in :class:`Spheroid`."""

    data: FitData  # for the next fit
    support: IntArray  # (R,) samples where its surface is seen
    share: FloatArray
    through: FloatArray
    spill: FloatArray


def _there(picture: DepthPicture, where: FloatArray) -> tuple[FloatArray, IntArray, FloatArray]:
    """The nearest pixels (..., 2) to places (..., 2), their numbers, and their depths (nan outside
    the picture)."""
    camera = picture.camera
    cells = np.rint(where)
    inside = np.empty(cells.shape)
    for k, size in enumerate((camera.width, camera.height)):
        np.clip(cells[..., k], 0.0, size - 1.0, out=inside[..., k])
    place = (inside[..., 1] * camera.width + inside[..., 0]).astype(np.int64)
    depth = picture.depth.ravel()[place]
    beyond = (inside[..., 0] != cells[..., 0]) | (inside[..., 1] != cells[..., 1])
    depth[beyond] = np.nan
    return inside, place, depth


def slack_of(depth: Any, p: EyeParameters) -> Any:
    """Largest error of a depth that shows a fruit at this depth [m]."""
    return 3.0 * p.depth_noise * depth**2 + 0.002  # a choice


def shown_of(
    picture: DepthPicture, colours: Codes, kinds: IntArray, x: FloatArray, axes: FloatArray,
    p: EyeParameters,
) -> SpheroidViews:  # fmt: skip
    """Where spheroids (R, 7) are seen, hidden, or seen through."""
    count, focal = len(x), picture.camera.focal
    middle = picture.camera.pixels(x[:, :3])
    size = np.exp(x[:, 3] + np.maximum(x[:, 4], 0.0)) * focal / x[:, 2]  # [pixel]
    noise = p.depth_noise * x[:, 2] ** 2
    slack = slack_of(x[:, 2], p)[:, None]
    radius = np.exp(x[:, 3])
    balls = SpheroidRows(x[:, :3], axis_of(x, axes)[0], radius, radius * np.exp(x[:, 4]))
    ticks = np.linspace(-WIDE, WIDE, GRID)
    grid = np.stack(np.meshgrid(ticks, ticks), axis=-1).reshape(-1, 2)
    cells, place, depth = _there(picture, middle[:, None] + size[:, None, None] * grid)
    rays, colour = picture.camera.through(cells), colours.ravel()[place]
    aside, front = surface(rays, balls)
    known = depth > 0.0
    mine = known & (colour == kinds[:, None]) & (np.abs(depth - front) < slack)
    inside = aside < 1.0
    area = np.maximum((inside & ~np.isnan(depth)).sum(axis=1), 1)  # within the picture
    deep = aside < 1.0 - np.minimum(INSIDE / size, 0.3)[:, None]
    ring = (aside > 1.0 + 2.0 / size[:, None]) & (aside < 1.0 + 6.0 / size[:, None])
    support = mine & deep
    through = known & deep & (depth > front + slack)
    spread = (2.0 * WIDE * size / (GRID - 1)) ** 2  # [pixel] of a sample
    per = np.maximum(p.patch / spread, 1.0)
    weights = support / (noise * np.sqrt(per))[:, None]
    points = rays * np.where(known, depth, 0.0)[:, :, None]
    ways, pulls = _outlines(picture, colours, kinds, balls, (middle, size, slack), p)
    order = np.argsort(~support, axis=1, kind="stable")[:, : max(int(support.sum(axis=1).max()), 1)]
    rows = np.arange(count)[:, None]
    return SpheroidViews(
        FitData(points[rows, order], weights[rows, order], ways, pulls),
        support.sum(axis=1), (mine & inside).sum(axis=1) / area,
        through.sum(axis=1) / np.maximum(deep.sum(axis=1), 1),
        (mine & ring).sum(axis=1) / np.maximum(ring.sum(axis=1), 1),
    )  # fmt: skip


@kernel
def _ends(depth, colours, lens, kinds, balls, about, turn, tick):
    """In directions ``turn`` (K, 2) from the middles of R spheroids: the last sample (R, K) that is
    surely of the fruit, -1: none; and the first beyond it that has another colour."""
    high, wide = depth.shape
    fx, fy, cx, cy = lens
    middle, size, slack = about
    deep = np.full((len(size), len(turn)), -1)
    ends = np.full((len(size), len(turn)), len(tick))
    for r in range(len(size)):
        (c0, c1, c2), (a0, a1, a2) = balls.center[r], balls.axis[r]
        k = (balls.radius[r] / balls.half[r]) ** 2 - 1.0
        bent = k * (c0 * a0 + c1 * a1 + c2 * a2)
        m0, m1, m2 = c0 + bent * a0, c1 + bent * a1, c2 + bent * a2
        least = c0 * m0 + c1 * m1 + c2 * m2 - balls.radius[r] ** 2
        for n in range(len(turn)):
            for t in range(len(tick) - 1, -1, -1):
                column = round(middle[r, 0] + size[r] * (turn[n, 0] * tick[t]))
                row = round(middle[r, 1] + size[r] * (turn[n, 1] * tick[t]))
                i, j = min(max(row, 0), high - 1), min(max(column, 0), wide - 1)
                if colours[i, j] != kinds[r]:
                    ends[r, n] = t
                elif i == row and j == column and depth[i, j] > 0.0:
                    x, y = (column - cx) / fx, (row - cy) / fy
                    along, across = x * a0 + y * a1 + a2, x * m0 + y * m1 + m2
                    length = x * x + y * y + 1.0 + k * along * along
                    root = math.sqrt(max(across * across / length - least, 0.0) / length)
                    if abs(depth[i, j] - across / length + root) < slack[r, 0]:
                        deep[r, n] = t
                        break
    return deep, ends


def _outlines(
    picture: DepthPicture, colours: Codes, kinds: IntArray, balls: SpheroidRows,
    about: tuple[FloatArray, FloatArray, FloatArray], p: EyeParameters,
) -> tuple[FloatArray, FloatArray]:  # fmt: skip
    """Rays (R, K, 3) through the free outlines of spheroids (R, 7), and their weights (R, K)."""
    middle, size, _ = about
    focal = picture.camera.focal
    angle = np.arange(TURNS) * (2.0 * math.pi / TURNS)
    turn = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    tick = np.linspace(0.3, WIDE, TICKS)
    lens = picture.camera.fx, picture.camera.fy, picture.camera.cx, picture.camera.cy
    deep, ends = _ends(picture.depth, colours, lens, kinds, balls, about, turn, tick)
    pixel = (size * (tick[1] - tick[0]))[:, None]
    ragged = (ends - deep) * pixel < 3.5  # [pixel] as edges of depth are
    last = np.where(ragged, ends - 1, deep)
    rim = tick[np.clip(last, 0, TICKS - 1)] + tick[np.clip(last + 1, 0, TICKS - 1)]
    edge = middle[:, None] + ((0.5 * rim) * size[:, None])[..., None] * turn
    ways = picture.camera.through(edge)
    aside, front = surface(ways, balls)
    close = np.abs(aside - 1.0) * size[:, None] < np.maximum(0.25 * size, 4.0)[:, None]
    free = (deep >= 0) & (last < TICKS - 1) & close
    for ahead in BEYOND:
        _, _, beyond = _there(picture, edge + ahead * turn)
        free &= ~((beyond > 0.0) & (beyond < front + BEFORE)) & ~np.isnan(beyond)
    around = 2.0 * math.pi * size / TURNS  # [pixel] of a direction
    per = np.maximum(RUN / around, 1.0)
    return ways, free * (focal / (balls.center[:, 2] * np.sqrt(per)))[:, None]


class SeedStart(NamedTuple):
    """The middle (3,) of a seed's front [m], its radius if it is whole [m], and its data."""

    place: FloatArray
    radius: float
    data: FitData


def start_of(picture: DepthPicture, seed: Region, p: EyeParameters) -> SeedStart | None:
    """Where a fit to the pixels of a seed begins."""
    box, pixels = seed.grown(INSIDE + 3)
    depth = picture.depth[box]
    area = int(pixels.sum())
    inside = morphed(pixels, "ERODE", CROSS, INSIDE)
    if inside.sum() < 0.3 * area:  # a thin rest of a fruit: a choice
        inside = pixels
    rows = np.argwhere(inside & (depth > 0.0))
    if len(rows) < 8:  # a choice: fewer tell no place
        return None
    camera, focal = picture.camera, picture.camera.focal
    begin = np.array([box[0].start, box[1].start])
    rows = rows[np.linspace(0, len(rows) - 1, min(len(rows), 2 * MOST_POINTS)).astype(int)]
    far = depth[rows[:, 0], rows[:, 1]]
    middle = float(middle_of(far))
    if middle < TOUCHING:
        return None
    near = np.abs(far - middle) < p.most_radius
    if not near.any():  # as many pixels far before the middle as behind it: the nearer half
        middle = float(far[far < middle].max())
        near = np.abs(far - middle) < p.most_radius
    points = camera.through((rows[near] + begin)[:, ::-1]) * far[near][:, None]
    points = points[:: max(len(points) // MOST_POINTS, 1)]
    per = max(p.patch * len(points) / area, 1.0)
    weights = 1.0 / (p.depth_noise * points[:, 2] ** 2 * math.sqrt(per))
    edge = _free(picture.depth, pixels, begin, np.argwhere(edge_of(pixels)), middle)
    edge = edge[:: max(-(-len(edge) // MOST_RAYS), 1)]
    radius = math.sqrt(area / math.pi) / focal * middle
    radius = min(max(radius, p.least_radius), p.most_radius)
    around = 2.0 * math.pi * radius * focal / middle
    per = max(RUN * len(edge) / max(around, 1.0), 1.0)
    pulls = np.full(len(edge), focal / (middle * math.sqrt(per)))
    data = FitData(points, weights, camera.through(edge[:, ::-1]), pulls)
    return SeedStart(middle_of(points), radius, data)


@kernel
def _free(depth, pixels, begin, rows, middle):
    """Rows and columns (K, 2) of the free part of an outline, of its pixels ``rows`` (N, 2).

    A part of the outline is free where what lies beyond it is not nearer than the fruit and the
    picture does not end there.
    """
    (height, width), (high, wide), (top, left) = depth.shape, pixels.shape, begin
    out, count = np.empty((len(rows), 2)), 0
    down_mean, across_mean = rows[:, 0].mean(), rows[:, 1].mean()
    for row, column in rows:
        down, across = row - down_mean, column - across_mean
        away = max(math.sqrt(down * down + across * across), 1e-9)
        down, across = down / away, across / away
        free = 2 <= row + top <= height - 3 and 2 <= column + left <= width - 3
        for ahead in BEYOND:
            i, j = round(row + ahead * down), round(column + ahead * across)
            far = depth[min(max(i + top, 0), height - 1), min(max(j + left, 0), width - 1)]
            mine = pixels[min(max(i, 0), high - 1), min(max(j, 0), wide - 1)]  # a dent: it goes on
            free = free and not mine and not 0.0 < far < middle + BEFORE
        if free:  # half a pixel beyond the middle of the last pixel
            out[count, 0], out[count, 1] = row + 0.5 * down + top, column + 0.5 * across + left
            count += 1
    return out[:count]


FIRST, AGAIN, ROUNDS = 6, 4, 2  # steps to a seed, after each claim, and claims: a choice
BATCH = 256  # seeds that are fitted at once, which bounds memory: a choice
NEAREST = 0.05  # [m] of a fruit's centre: a choice
ODDS = 6.65, 6.34, -22.0, -20.0, -13.5, -2.4
"""Of a fruit by share, logarithm of round, through, spill, off, and 1."""


@dataclass(frozen=True, eq=False)
class Spheroid:
    """A spheroid in the frame of the camera, and what the picture says for and against it."""

    center: FloatArray  # (3,) [m]
    axis: FloatArray  # (3,) unit
    radius: float  # across the axis [m]
    half: float  # half the length along the axis [m]
    covariance: FloatArray  # (3, 3) of the centre [m²]
    round: float  # deviation of the depths from a plane over that from the spheroid; a wall has 1
    bulge: float  # its square less that of a spheroid in the mean, in standard deviations
    share: float  # part of its outline's area within the picture where its surface is seen
    through: float  # part of its outline's area where something farther is seen
    spill: float  # part of a ring about its outline where its colour goes on at its depth
    off: float  # mean error of the free outline over the radius

    @property
    def odds(self) -> float:
        """Logarithm of the odds that this is a fruit."""
        told = self.share, math.log(max(self.round, 0.05)), self.through, self.spill, self.off, 1.0
        return float(np.dot(ODDS, told))


def all_fitted(
    picture: DepthPicture, seeds: Sequence[Region], kinds: IntArray, colours: Codes,
    up: FloatArray, p: EyeParameters,
) -> list[Spheroid | None]:  # fmt: skip
    r"""The likeliest spheroid of each seed; None where it shows none.

    With :math:`q = A (x - c)` the fruit is :math:`|q| \le 1`. A point of its front has the residual
    :math:`(|q| - 1) r`, and a ray that touches its outline the same with the point of the ray where
    :math:`|q|` is least. The outline is used only where nothing nearer hides the fruit. Radius,
    length and tilt have priors, so a fruit of which little is seen has a wide covariance along the
    view instead of a wrong place: the front alone would put it too near. A first fit to the pixels
    of the seed is repeated with those pixels of its colour that agree with it, wherever the
    seed ends: a stem before a fruit cuts its pixels in two, and a stem behind it adds some.

    A seed is a fruit, a part of one, or none. ``kinds``: (R,) its colour, above 0. ``colours``:
    (height, width) colour of each pixel. ``up``: (3,) unit, upwards in the frame of the camera.
    """
    if len(seeds) > BATCH:
        parts = [slice(k, k + BATCH) for k in range(0, len(seeds), BATCH)]
        return [f for s in parts for f in all_fitted(picture, seeds[s], kinds[s], colours, up, p)]
    out: list[Spheroid | None] = [None] * len(seeds)
    axes = frame_along(up)
    starts = [start_of(picture, seed, p) for seed in seeds]
    rows = np.array([k for k, start in enumerate(starts) if start is not None], dtype=np.int64)
    if not len(rows):
        return out
    begun = [start for start in starts if start is not None]
    places, sizes = np.array([s.place for s in begun]), np.array([s.radius for s in begun])
    data = padded([start.data for start in begun])
    x, _ = descended(states_of(places, sizes, p), axes, data, p, FIRST)
    narrow = np.exp(x[:, 3]) < 0.85 * p.least_radius  # a piece of a fruit, or a stem
    x[narrow] = states_of(places, np.full(len(places), p.radius), p)[narrow]
    hessian = np.zeros((len(x), 7, 7))
    for _ in range(ROUNDS):
        good = _sound(x, p)
        rows, x = rows[good], x[good]
        if not len(rows):
            return out
        look = shown_of(picture, colours, kinds[rows], x, axes, p)
        good = (look.support >= 8) & (look.through < 0.3)  # a choice: fewer tell no place
        rows, x = rows[good], x[good]
        if not len(rows):
            return out
        data = FitData(*(each[good] for each in look.data))
        x, hessian = descended(x, axes, data, p, AGAIN)
    look = shown_of(picture, colours, kinds[rows], x, axes, p)
    residuals, _, _ = system(x, *axis_of(x, axes), look.data)
    good = _sound(x, p) & (look.support >= 8)
    for k in np.flatnonzero(good):
        out[rows[k]] = _spheroid(x[k], axes, hessian[k], residuals[k], look, int(k), p)
    return out


def _sound(x: FloatArray, p: EyeParameters) -> BoolArray:
    radius = np.exp(x[:, 3])
    return np.asarray((radius >= p.least_radius) & (radius <= p.most_radius) & (x[:, 2] > NEAREST))


def _spheroid(
    x: FloatArray, axes: FloatArray, hessian: FloatArray, residuals: FloatArray,
    look: SpheroidViews, k: int, p: EyeParameters,
) -> Spheroid:  # fmt: skip
    center, radius = x[:3], math.exp(x[3])
    whole = np.linalg.inv(hessian)  # of centre, logarithms of radius and length over width, tilts
    whole[:3, :3] += p.depth_scale**2 * np.outer(center, center) + MODEL**2 * np.eye(3)
    axis = axis_of(x[None], axes)[0][0]
    along = float(axis @ center) / float(np.linalg.norm(center))
    whole[:3, :3] += (TIP * radius * along) ** 2 * np.outer(axis, axis)
    whole = 0.5 * (whole + whole.T)
    used = look.data.weights[k] > 0.0
    weights = look.data.weights[k][used]
    first = residuals[: len(used)][used]
    second = residuals[len(used) :][look.data.pulls[k] > 0.0]
    left = max(float(np.sqrt(np.mean(first**2))), 1e-9)
    points = look.data.points[k][used]
    ball = SpheroidRows(center[None], axis[None], np.array([radius]), radius * np.exp(x[None, 4]))
    rays = points / points[:, 2:]
    curved = math.sqrt(len(points)) * planar(
        rays * surface(rays[None], ball)[1][0, :, None], weights
    )
    off = planar(points, weights)
    # errors of unit variance that the depths have add 2 curved to the deviation of the squares
    bulge = (len(points) * (off**2 - left**2) - curved**2) / max(2.0 * curved, 1e-9)
    pull = float(look.data.pulls[k].max(initial=1.0))
    return Spheroid(
        center, axis, radius, radius * math.exp(x[4]), whole[:3, :3],
        off / left, bulge,
        float(look.share[k]), float(look.through[k]), float(look.spill[k]),
        float(np.abs(second).mean() / pull / radius) if len(second) else 0.0,
    )  # fmt: skip


def claimed(
    picture: DepthPicture, colour: BoolArray, fit: Spheroid, p: EyeParameters
) -> tuple[tuple[slice, slice], BoolArray]:
    """A box, and its pixels (h, w) of a colour (height, width) that show a fruit."""
    camera = picture.camera
    column, row = camera.pixels(fit.center)
    size = 1.1 * max(fit.radius, fit.half) / fit.center[2]
    high, wide = (
        slice(max(int(at - size * f), 0), min(max(int(at + size * f) + 2, 0), most))
        for at, f, most in ((row, camera.fy, camera.height), (column, camera.fx, camera.width))
    )
    out = np.array(colour[high, wide])
    rows = np.argwhere(out) + [high.start, wide.start]
    balls = SpheroidRows(
        fit.center[None], fit.axis[None], np.array([fit.radius]), np.array([fit.half])
    )
    aside, front = surface(camera.through(rows[:, ::-1])[None], balls)
    depth = picture.depth[rows[:, 0], rows[:, 1]]
    inner = (aside[0] < 1.1) & (
        (depth == 0.0) | (np.abs(depth - front[0]) < 2.0 * slack_of(fit.center[2], p))
    )
    out[out] = inner
    return (high, wide), out
