"""Spheroids through what one view shows of fruits: the depths of fronts, and outlines."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from scipy.ndimage import binary_erosion

from optipromp.core.arrays import BoolArray, FloatArray, IntArray, frame_along
from optipromp.perception.geometry import box_of, edge_of
from optipromp.perception.parameters import EyeParameters
from optipromp.perception.pictures import DepthPicture

FIRST, AGAIN, ROUNDS = 6, 4, 2  # steps to a seed, after each claim, and claims: a choice
MOST_POINTS, MOST_RAYS = 120, 60  # that a fit uses: a choice
INSIDE = 2  # [pixel] from the outline to the depths that are used: edges of depth are ragged
HUBER = 2.0  # [standard deviations] beyond which a residual counts linearly: a choice
BEFORE = 0.006  # [m] by which something that hides a fruit is nearer than it: a choice
GRID, WIDE = 25, 1.4  # samples across a fruit, and radii from its middle to the last: a choice
TURNS, TICKS = 48, 64  # directions in which an outline is looked for, and samples along: a choice
BEYOND = 3.0, 5.0  # [pixel] beyond an outline, where what hides the fruit would be: a choice

ODDS = 6.65, 6.34, -22.0, -20.0, -13.5, -2.4
"""Of a fruit by share, logarithm of round, through, spill, off, and 1."""


@dataclass(frozen=True, eq=False)
class Spheroid:
    """A spheroid in the frame of the camera, and what the picture says for and against it.

    Attributes:
        center: (3,) [m].
        axis: (3,) unit.
        radius: across the axis [m].
        half: half the length along the axis [m].
        covariance: (3, 3) of the centre [m²].
        state_covariance: (7, 7) of centre, logarithms of radius and of length over width, tilts.
        misfit: median error of the depths over their deviation, 1 of a true spheroid.
        round: deviation of the depths from a plane over that from the spheroid; a wall has 1.
        share: part of its outline's area where its surface is seen.
        through: part of its outline's area where something farther is seen.
        spill: part of a ring about its outline where its colour goes on at its depth.
        off: mean error of the free outline over the radius.
    """

    center: FloatArray
    axis: FloatArray
    radius: float
    half: float
    covariance: FloatArray
    state_covariance: FloatArray
    misfit: float
    round: float
    share: float
    through: float
    spill: float
    off: float

    @property
    def odds(self) -> float:
        """Logarithm of the odds that this is a fruit."""
        told = self.share, math.log(max(self.round, 0.05)), self.through, self.spill, self.off, 1.0
        return float(np.dot(ODDS, told))


class _Data(NamedTuple):
    """What R fits use, padded with weights 0.

    Attributes:
        points: (R, P, 3) of fronts [m].
        weights: (R, P) [1/m].
        rays: (R, K, 3) through free outlines.
        pulls: (R, K) their weights [1/m].
    """

    points: FloatArray
    weights: FloatArray
    rays: FloatArray
    pulls: FloatArray


def fitted(
    picture: DepthPicture, pixels: BoolArray, up: FloatArray, p: EyeParameters
) -> Spheroid | None:
    """The likeliest spheroid of a fruit's pixels; None if they show none. See :func:`all_fitted`."""
    return all_fitted(
        picture, [pixels], np.ones(1, dtype=np.int64), pixels.astype(np.int64), up, p
    )[0]


def all_fitted(
    picture: DepthPicture, seeds: Sequence[BoolArray], kinds: IntArray, colours: IntArray,
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

    Args:
        picture: that shows them.
        seeds: R masks (height, width).
        kinds: (R,) colour of each seed, above 0.
        colours: (height, width) colour of each pixel.
        up: (3,) unit, upwards in the frame of the camera.
        p: numbers of the fit.
    """
    out: list[Spheroid | None] = [None] * len(seeds)
    axes = frame_along(up)
    starts = [_start(picture, pixels, p) for pixels in seeds]
    rows = np.array([k for k, start in enumerate(starts) if start is not None], dtype=np.int64)
    if not len(rows):
        return out
    begun = [start for start in starts if start is not None]
    places, sizes = np.array([s.place for s in begun]), np.array([s.radius for s in begun])
    data = _padded([start.data for start in begun])
    x, _ = _descended(_states(places, sizes, p), axes, data, p, FIRST)
    narrow = np.exp(x[:, 3]) < 0.85 * p.least_radius  # a piece of a fruit, or a stem
    x[narrow] = _states(places, np.full(len(places), p.radius), p)[narrow]
    hessian = np.zeros((len(x), 7, 7))
    for _ in range(ROUNDS):
        good = _sound(x, p)
        rows, x = rows[good], x[good]
        if not len(rows):
            return out
        look = _looked(picture, colours, kinds[rows], x, axes, p)
        good = (look.support >= 8) & (look.through < 0.3)  # a choice: fewer tell no place
        rows, x = rows[good], x[good]
        if not len(rows):
            return out
        look = look.of(good)
        x, hessian = _descended(x, axes, look.data, p, AGAIN)
    look = _looked(picture, colours, kinds[rows], x, axes, p)
    residuals, _ = _system(x, axes, look.data)
    good = _sound(x, p) & (look.support >= 8)
    for k in np.flatnonzero(good):
        out[rows[k]] = _spheroid(x[k], axes, hessian[k], residuals[k], look, int(k), p)
    return out


def _sound(x: FloatArray, p: EyeParameters) -> BoolArray:
    radius = np.exp(x[:, 3])
    return np.asarray((radius >= p.least_radius) & (radius <= p.most_radius) & (x[:, 2] > 0.05))


def _spheroid(
    x: FloatArray, axes: FloatArray, hessian: FloatArray, residuals: FloatArray, look: "_Look",
    k: int, p: EyeParameters,
) -> Spheroid:  # fmt: skip
    center, radius = x[:3], math.exp(x[3])
    whole = np.linalg.inv(hessian)
    whole[:3, :3] += p.depth_scale**2 * np.outer(center, center) + p.model**2 * np.eye(3)
    whole = 0.5 * (whole + whole.T)
    used = look.data.weights[k] > 0.0
    weights = look.data.weights[k][used]
    first = residuals[: len(used)][used]
    second = residuals[len(used) :][look.data.pulls[k] > 0.0]
    misfit = float(np.median(np.abs(first))) * math.sqrt(look.per[k]) / 0.67
    left = float(np.sqrt(np.mean(first**2)))
    pull = float(look.data.pulls[k].max(initial=1.0))
    return Spheroid(
        center, _axis(x[None], axes)[0][0], radius, radius * math.exp(x[4]), whole[:3, :3], whole,
        misfit, _planar(look.data.points[k][used], weights) / max(left, 1e-9),
        float(look.share[k]), float(look.through[k]), float(look.spill[k]),
        float(np.abs(second).mean() / pull / radius) if len(second) else 0.0,
    )  # fmt: skip


def _axis(x: FloatArray, axes: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Axes (R, 3) of states (R, 7), and their derivatives (R, 2, 3) by the tilts."""
    ways = x[:, 5:] @ axes[:, :2].T + axes[:, 2]
    size = np.linalg.norm(ways, axis=1)[:, None]
    ways = ways / size
    slope = axes[:, :2].T[None] - (ways @ axes[:, :2])[:, :, None] * ways[:, None]
    return ways, slope / size[:, :, None]


def _system(x: FloatArray, axes: FloatArray, data: _Data) -> tuple[FloatArray, FloatArray]:
    """Weighted residuals (R, P + K) of states (R, 7), and their derivatives (R, P + K, 7)."""
    axis, turn = _axis(x, axes)
    longer = np.exp(-2.0 * x[:, 4])
    k = (longer - 1.0)[:, None]
    center, radius = x[:, :3], np.exp(x[:, 3])[:, None]
    metric = center + k * (center * axis).sum(axis=1)[:, None] * axis
    along = np.matmul(data.rays, axis[:, :, None])[:, :, 0]
    share = np.matmul(data.rays, metric[:, :, None])[:, :, 0]
    share /= np.maximum((data.rays**2).sum(axis=2) + k * along**2, 1e-12)
    off = np.concatenate([data.points, share[:, :, None] * data.rays], axis=1) - center[:, None]
    s = np.matmul(off, axis[:, :, None])[:, :, 0]
    size = np.sqrt(np.maximum((off**2).sum(axis=2) + k * s**2, 1e-12))
    slope = np.empty((*size.shape, 7))
    slope[:, :, :3] = -(off + (k * s)[:, :, None] * axis[:, None]) / size[:, :, None]
    slope[:, :, 3] = -radius
    slope[:, :, 4] = -longer[:, None] * s**2 / size
    slope[:, :, 5:] = (k * s / size)[:, :, None] * np.matmul(off, turn.transpose(0, 2, 1))
    weights = np.concatenate([data.weights, data.pulls], axis=1)
    return (size - radius) * weights, slope * weights[:, :, None]


def _descended(
    x: FloatArray, axes: FloatArray, data: _Data, p: EyeParameters, steps: int
) -> tuple[FloatArray, FloatArray]:
    """States (R, 7) after some steps of Gauss-Newton, and the last Hessians (R, 7, 7)."""
    prior = np.array([0.0, 0.0, 0.0, math.log(p.radius), p.longer, 0.0, 0.0])
    tilt = math.radians(p.tilt)
    sharp = np.array([0.0] * 3 + [p.radius_spread, p.longer_spread, tilt, tilt])
    sharp[3:] **= -2.0
    hessian = np.tile(np.eye(7), (len(x), 1, 1))
    for _ in range(steps):
        now, slope = _system(x, axes, data)
        robust = np.minimum(1.0, HUBER / np.maximum(np.abs(now), 1e-9))
        weighted = (slope * robust[:, :, None]).transpose(0, 2, 1)
        hessian = weighted @ slope + np.diag(sharp + 1e-9)
        gradient = (weighted @ now[:, :, None])[:, :, 0] + sharp * (x - prior)
        step = np.linalg.solve(hessian, gradient[:, :, None])[:, :, 0]
        far = np.abs(step[:, :3]).max(axis=1, keepdims=True) > 0.02
        x = x - np.where(far, np.clip(step, -0.02, 0.02), step)
        x[:, 3] = np.clip(x[:, 3], math.log(0.5 * p.least_radius), math.log(2 * p.most_radius))
        x[:, 4:] = np.clip(x[:, 4:], -0.7, 0.7)
    return x, hessian


class _Look(NamedTuple):
    """What the picture shows of R spheroids; names as in :class:`Spheroid`.

    Attributes:
        data: for the next fit.
        support: (R,) samples where its surface is seen.
        per: (R,) how many of the points err as one.
    """

    data: _Data
    support: IntArray
    per: FloatArray
    share: FloatArray
    through: FloatArray
    spill: FloatArray

    def of(self, rows: BoolArray) -> "_Look":
        """Those of some spheroids."""
        data = _Data(*(each[rows] for each in self.data))
        return _Look(data, *(each[rows] for each in self[1:]))


def _at(picture: DepthPicture, colours: IntArray, where: FloatArray) -> tuple[FloatArray, ...]:
    """Rays (..., 3), depths (nan outside the picture) and colours at pixels (..., 2)."""
    camera = picture.camera
    cells = np.rint(where).astype(np.int64)
    column = np.clip(cells[..., 0], 0, camera.width - 1)
    row = np.clip(cells[..., 1], 0, camera.height - 1)
    depth = np.where(
        (column == cells[..., 0]) & (row == cells[..., 1]), picture.depth[row, column], np.nan
    )
    x, y = (column - camera.cx) / camera.fx, (row - camera.cy) / camera.fy
    return np.stack([x, y, np.ones_like(x)], axis=-1), depth, colours[row, column]


class _Balls(NamedTuple):
    """R spheroids: centres (R, 3), axes (R, 3), radii (R,), half lengths (R,)."""

    center: FloatArray
    axis: FloatArray
    radius: FloatArray
    half: FloatArray


def _balls(x: FloatArray, axes: FloatArray) -> _Balls:
    radius = np.exp(x[:, 3])
    return _Balls(x[:, :3], _axis(x, axes)[0], radius, radius * np.exp(x[:, 4]))


def _surface(rays: FloatArray, balls: _Balls) -> tuple[FloatArray, FloatArray]:
    """Of rays (R, N, 3): distance from the centre in radii, and depth of the front, beyond the
    outline that of the nearest point."""
    center, axis, radius = balls.center, balls.axis, balls.radius[:, None]
    k = (radius / balls.half[:, None]) ** 2 - 1.0
    metric = center + k * (center * axis).sum(axis=1)[:, None] * axis
    along = np.matmul(rays, axis[:, :, None])[:, :, 0]
    across = np.matmul(rays, metric[:, :, None])[:, :, 0]
    size = (rays**2).sum(axis=2) + k * along**2
    share = across / size
    square = (center * metric).sum(axis=1)[:, None] - across * share
    root = np.sqrt(np.maximum(radius**2 - square, 0.0) / size)
    return np.sqrt(np.maximum(square, 0.0)) / radius, share - root


def claimed(picture: DepthPicture, colour: BoolArray, fit: Spheroid, p: EyeParameters) -> BoolArray:
    """The pixels (height, width) of a colour that show a fruit."""
    camera = picture.camera
    column, row = camera.pixels(fit.center)
    size = 1.1 * max(fit.radius, fit.half) / fit.center[2]
    box = tuple(
        slice(max(int(at - size * f), 0), max(int(at + size * f) + 2, 0))
        for at, f in ((row, camera.fy), (column, camera.fx))
    )
    out = np.zeros(colour.shape, dtype=bool)
    rows = np.argwhere(colour[box]) + [box[0].start, box[1].start]
    balls = _Balls(fit.center[None], fit.axis[None], np.array([fit.radius]), np.array([fit.half]))
    aside, front = _surface(_rays(picture, rows)[None], balls)
    depth = picture.depth[rows[:, 0], rows[:, 1]]
    inner = (aside[0] < 1.1) & (
        (depth == 0.0) | (np.abs(depth - front[0]) < 2.0 * _slack(fit.center[2], p))
    )
    out[rows[inner, 0], rows[inner, 1]] = True
    return out


def _slack(depth: Any, p: EyeParameters) -> Any:
    """Largest error of a depth that shows a fruit at this depth [m]."""
    return 3.0 * p.depth_noise * depth**2 + 0.002  # a choice


def _looked(
    picture: DepthPicture, colours: IntArray, kinds: IntArray, x: FloatArray, axes: FloatArray,
    p: EyeParameters,
) -> _Look:  # fmt: skip
    """Where spheroids (R, 7) are seen, hidden, or seen through."""
    count, focal = len(x), 0.5 * (picture.camera.fx + picture.camera.fy)
    middle = picture.camera.pixels(x[:, :3])
    size = np.exp(x[:, 3] + np.maximum(x[:, 4], 0.0)) * focal / x[:, 2]  # [pixel]
    noise = p.depth_noise * x[:, 2] ** 2
    slack = _slack(x[:, 2], p)[:, None]
    balls = _balls(x, axes)
    ticks = np.linspace(-WIDE, WIDE, GRID)
    grid = np.stack(np.meshgrid(ticks, ticks), axis=-1).reshape(-1, 2)
    rays, depth, colour = _at(picture, colours, middle[:, None] + size[:, None, None] * grid)
    aside, front = _surface(rays, balls)
    known = depth > 0.0
    mine = known & (colour == kinds[:, None]) & (np.abs(depth - front) < slack)
    inside = aside < 1.0
    area = np.maximum(inside.sum(axis=1), 1)
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
    return _Look(
        _Data(points[rows, order], weights[rows, order], ways, pulls),
        support.sum(axis=1), per, (mine & inside).sum(axis=1) / area,
        through.sum(axis=1) / np.maximum(deep.sum(axis=1), 1),
        (mine & ring).sum(axis=1) / np.maximum(ring.sum(axis=1), 1),
    )  # fmt: skip


def _outlines(
    picture: DepthPicture, colours: IntArray, kinds: IntArray, balls: _Balls,
    about: tuple[FloatArray, FloatArray, FloatArray], p: EyeParameters,
) -> tuple[FloatArray, FloatArray]:  # fmt: skip
    """Rays (R, K, 3) through the free outlines of spheroids (R, 7), and their weights (R, K)."""
    middle, size, slack = about
    count, focal = len(size), 0.5 * (picture.camera.fx + picture.camera.fy)
    angle = np.arange(TURNS) * (2.0 * math.pi / TURNS)
    turn = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    tick = np.linspace(0.3, WIDE, TICKS)
    where = turn[:, None] * tick[:, None]  # (K, T, 2) in sizes
    where = middle[:, None, None] + size[:, None, None, None] * where
    rays, depth, colour = _at(picture, colours, where.reshape(count, -1, 2))
    aside, front = _surface(rays, balls)
    shape = count, TURNS, TICKS
    dyed = (colour == kinds[:, None]).reshape(shape)
    near = ((depth > 0.0) & (np.abs(depth - front) < slack)).reshape(shape)
    pixel = (size * (tick[1] - tick[0]))[:, None]
    order = np.arange(TICKS)
    deep = np.where(dyed & near, order, -1).max(axis=2)  # the last that is surely of the fruit
    ends = np.where(~dyed & (order > deep[:, :, None]), order, TICKS).min(axis=2)
    last = np.where(
        (ends - deep) * pixel < 3.5, ends - 1, deep
    )  # [pixel] edges of depth are ragged
    rows = np.arange(count)[:, None], np.arange(TURNS)
    reach = (
        0.5 * (tick[np.clip(last, 0, TICKS - 1)] + tick[np.clip(last + 1, 0, TICKS - 1)])
    ) * size[:, None]
    edge = middle[:, None] + reach[..., None] * turn
    camera = picture.camera
    ways = np.concatenate(
        [(edge - [camera.cx, camera.cy]) / [camera.fx, camera.fy], np.ones((count, TURNS, 1))],
        axis=2,
    )
    aside, front = _surface(ways, balls)
    free = (
        (deep >= 0)
        & (last < TICKS - 1)
        & (np.abs(aside - 1.0) * size[:, None] < np.maximum(0.25 * size, 4.0)[:, None])
    )
    for ahead in BEYOND:
        _, beyond, _ = _at(picture, colours, edge + ahead * turn)
        free &= ~((beyond > 0.0) & (beyond < front + BEFORE)) & ~np.isnan(beyond)
    around = 2.0 * math.pi * size / TURNS  # [pixel] of a direction
    per = np.maximum(p.outline_run / around, 1.0)
    return ways, free * (focal / (p.outline * balls.center[:, 2] * np.sqrt(per)))[:, None]


def _planar(points: FloatArray, weights: FloatArray) -> float:
    """Root mean square distance of points (N, 3) from their plane, by their weights (N,)."""
    off = points - points.mean(axis=0)
    across = np.linalg.eigh(off.T @ off)[1][:, 0]
    return float(np.sqrt(np.mean(((off @ across) * weights) ** 2)))


def _padded(rows: Sequence[_Data]) -> _Data:
    """Data of one fit each, (1, ...), as one."""
    most = [max(each[k].shape[0] for each in rows) for k in range(4)]
    out = [np.zeros((len(rows), most[k], *rows[0][k].shape[1:])) for k in range(4)]
    for row, each in enumerate(rows):
        for k in range(4):
            out[k][row, : len(each[k])] = each[k]
    return _Data(*out)


class _Start(NamedTuple):
    """The middle (3,) of a seed's front [m], its radius if it is whole [m], and its data."""

    place: FloatArray
    radius: float
    data: _Data


def _states(places: FloatArray, radii: FloatArray, p: EyeParameters) -> FloatArray:
    """States (R, 7) of upright fruits behind the middles (R, 3) of their fronts."""
    away = 1.0 + 0.7 * radii / np.linalg.norm(places, axis=1)
    rest = np.tile([p.longer, 0.0, 0.0], (len(radii), 1))
    return np.column_stack([places * away[:, None], np.log(radii), rest])


def _start(picture: DepthPicture, pixels: BoolArray, p: EyeParameters) -> _Start | None:
    """Where a fit to the pixels of a seed begins."""
    box = box_of(pixels, INSIDE + 3)
    pixels, depth = pixels[box], picture.depth[box]
    area = int(pixels.sum())
    inside = binary_erosion(pixels, iterations=INSIDE)
    if inside.sum() < 0.3 * area:  # a thin rest of a fruit: a choice
        inside = pixels
    rows = np.argwhere(inside & (depth > 0.0))
    if len(rows) < 8:  # a choice: fewer tell no place
        return None
    camera = picture.camera
    focal = 0.5 * (camera.fx + camera.fy)
    begin = np.array([box[0].start, box[1].start])
    rows = rows[np.linspace(0, len(rows) - 1, min(len(rows), 2 * MOST_POINTS)).astype(int)]
    far = depth[rows[:, 0], rows[:, 1]]
    middle = float(np.median(far))
    near = np.abs(far - middle) < p.most_radius
    points = _rays(picture, rows[near] + begin) * far[near][:, None]
    points = points[:: max(len(points) // MOST_POINTS, 1)]
    per = max(p.patch * len(points) / area, 1.0)
    weights = 1.0 / (p.depth_noise * points[:, 2] ** 2 * math.sqrt(per))
    edge = _free(picture, pixels, begin, middle)
    radius = float(
        np.clip(math.sqrt(area / math.pi) / focal * middle, p.least_radius, p.most_radius)
    )
    around = 2.0 * math.pi * radius * focal / middle
    per = max(p.outline_run * len(edge) / max(around, 1.0), 1.0)
    pulls = np.full(len(edge), focal / (p.outline * middle * math.sqrt(per)))
    data = _Data(points, weights, _rays(picture, edge), pulls)
    return _Start(np.median(points, axis=0), radius, data)


def _rays(picture: DepthPicture, rows: FloatArray) -> FloatArray:
    """Directions (N, 3), of depth 1, through rows and columns (N, 2)."""
    camera = picture.camera
    x, y = (rows[:, 1] - camera.cx) / camera.fx, (rows[:, 0] - camera.cy) / camera.fy
    return np.column_stack([x, y, np.ones(len(rows))])


def _free(picture: DepthPicture, pixels: BoolArray, begin: IntArray, middle: float) -> FloatArray:
    """Rows and columns (K, 2) of the free part of an outline.

    A part of the outline is free where what lies beyond it is not nearer than the fruit and the
    picture does not end there.
    """
    height, width = picture.depth.shape
    rows = np.argwhere(edge_of(pixels))
    out = rows - rows.mean(axis=0)
    out = out / np.maximum(np.linalg.norm(out, axis=1), 1e-9)[:, None]
    shape = np.array(pixels.shape)
    free = ((rows + begin >= 2) & (rows + begin <= np.array([height, width]) - 3)).all(axis=1)
    for ahead in BEYOND:
        there = np.rint(rows + ahead * out).astype(int)
        here = np.clip(there, 0, shape - 1)
        mine = pixels[here[:, 0], here[:, 1]]  # a dent: the fruit goes on beyond
        there = np.clip(there + begin, 0, [height - 1, width - 1])
        depth = picture.depth[there[:, 0], there[:, 1]]
        free &= ~((depth > 0.0) & (depth < middle + BEFORE)) & ~mine
    edge = (rows + 0.5 * out + begin)[free]  # half a pixel beyond the middle of the last pixel
    return np.asarray(edge[:: max(-(-len(edge) // MOST_RAYS), 1)])
