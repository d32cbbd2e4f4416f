"""Spheroids through what one view shows of fruits: the depths of fronts, and outlines."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from optipromp.core.arrays import BoolArray, FloatArray, IntArray, frame_along
from optipromp.perception.balls import (
    SpheroidRows,
    axis_of,
    descended,
    padded,
    planar,
    states_of,
    surface,
    system,
)
from optipromp.perception.finder import Region
from optipromp.perception.parameters import EyeParameters
from optipromp.perception.pictures import DepthPicture
from optipromp.perception.shown import SpheroidViews, rays_of, shown_of, slack_of, start_of

FIRST, AGAIN, ROUNDS = 6, 4, 2  # steps to a seed, after each claim, and claims: a choice
BATCH = 256  # seeds that are fitted at once, which bounds memory: a choice
NEAREST = 0.05  # [m] of a fruit's centre: a choice
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


def fitted(
    picture: DepthPicture, pixels: BoolArray, up: FloatArray, p: EyeParameters
) -> Spheroid | None:
    """The likeliest spheroid of a fruit's pixels (:func:`all_fitted`); None if they show none."""
    return all_fitted(
        picture,
        [Region("ripe", pixels, 1.0)],
        np.ones(1, dtype=np.int64),
        pixels.astype(np.int64),
        up,
        p,
    )[0]


def all_fitted(
    picture: DepthPicture, seeds: Sequence[Region], kinds: IntArray, colours: IntArray,
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

    ``picture``: that shows them. ``seeds``: R regions, each of one fruit, a part of one, or none.
    ``kinds``: (R,) colour of each seed, above 0. ``colours``: (height, width) colour of each pixel.
    ``up``: (3,) unit, upwards in the frame of the camera. ``p``: numbers of the fit.
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
        look = look.of(good)
        x, hessian = descended(x, axes, look.data, p, AGAIN)
    look = shown_of(picture, colours, kinds[rows], x, axes, p)
    residuals, _ = system(x, axes, look.data)
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
    whole = np.linalg.inv(hessian)
    whole[:3, :3] += p.depth_scale**2 * np.outer(center, center) + p.model**2 * np.eye(3)
    axis = axis_of(x[None], axes)[0][0]
    along = float(axis @ center) / float(np.linalg.norm(center))
    whole[:3, :3] += (p.tip * radius * along) ** 2 * np.outer(axis, axis)
    whole = 0.5 * (whole + whole.T)
    used = look.data.weights[k] > 0.0
    weights = look.data.weights[k][used]
    first = residuals[: len(used)][used]
    second = residuals[len(used) :][look.data.pulls[k] > 0.0]
    left = float(np.sqrt(np.mean(first**2)))
    pull = float(look.data.pulls[k].max(initial=1.0))
    return Spheroid(
        center, axis_of(x[None], axes)[0][0], radius, radius * math.exp(x[4]), whole[:3, :3], whole,
        planar(look.data.points[k][used], weights) / max(left, 1e-9),
        float(look.share[k]), float(look.through[k]), float(look.spill[k]),
        float(np.abs(second).mean() / pull / radius) if len(second) else 0.0,
    )  # fmt: skip


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
    balls = SpheroidRows(
        fit.center[None], fit.axis[None], np.array([fit.radius]), np.array([fit.half])
    )
    aside, front = surface(rays_of(picture, rows)[None], balls)
    depth = picture.depth[rows[:, 0], rows[:, 1]]
    inner = (aside[0] < 1.1) & (
        (depth == 0.0) | (np.abs(depth - front[0]) < 2.0 * slack_of(fit.center[2], p))
    )
    out[rows[inner, 0], rows[inner, 1]] = True
    return out
