"""Spheroids through what one view shows of a fruit: the depths of its front, and its outline."""

import math
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import binary_erosion

from optipromp.core.arrays import BoolArray, FloatArray, frame_along
from optipromp.perception.geometry import box_of, edge_of
from optipromp.perception.parameters import EyeParameters
from optipromp.perception.pictures import DepthPicture

STEPS = 8  # of Gauss-Newton: a choice
DELTA = 1e-5  # of a parameter, for derivatives: a choice
MOST_POINTS, MOST_RAYS = 120, 60  # that a fit uses: a choice
INSIDE = 2  # [pixel] from the outline to the depths that are used: edges of depth are ragged
HUBER = 2.0  # [standard deviations] beyond which a residual counts linearly: a choice
BEFORE = 0.006  # [m] by which something that hides a fruit is nearer than it: a choice


@dataclass(frozen=True, eq=False)
class Spheroid:
    """A spheroid in the frame of the camera.

    Attributes:
        center: (3,) [m].
        axis: (3,) unit.
        radius: across the axis [m].
        half: half the length along the axis [m].
        covariance: (3, 3) of the centre [m²].
        misfit: median error of the depths over their deviation, 1 of a true spheroid.
        round: deviation of the depths from a plane over that from the spheroid; a wall has 1.
        off: mean error of the free outline over the radius.
        share: part of its area that is seen, or free part of its outline if less.
        gap: free part of its outline less the part of its area that is seen: what is not seen of a
            fruit is hidden, and then its outline is not free.
    """

    center: FloatArray
    axis: FloatArray
    radius: float
    half: float
    covariance: FloatArray
    misfit: float
    round: float
    off: float
    share: float
    gap: float


def fitted(
    picture: DepthPicture, pixels: BoolArray, up: FloatArray, p: EyeParameters
) -> Spheroid | None:
    r"""The likeliest spheroid of a fruit's pixels; None if they show none.

    With :math:`q = A (x - c)` the fruit is :math:`|q| \le 1`. A point of its front has the residual
    :math:`(|q| - 1) r`, and a ray that touches its outline :math:`(d - 1) r` with the distance
    :math:`d` of the ray from the origin in the coordinates :math:`q`. The outline is used only
    where nothing nearer hides the fruit. Radius, length and tilt have priors, so a fruit of which
    little is seen has a wide covariance along the view instead of a wrong place: the front alone
    would put it too near.

    Args:
        picture: that shows it.
        pixels: (height, width) of the fruit.
        up: (3,) unit, upwards in the frame of the camera.
        p: numbers of the fit.
    """
    points, weights = _front(picture, pixels, p)
    if len(points) < 8:  # a choice: fewer tell no place
        return None
    rays, share = _outline(picture, pixels, float(np.median(points[:, 2])))
    axes = frame_along(up)
    focal = 0.5 * (picture.camera.fx + picture.camera.fy)
    flat = math.sqrt(float(pixels.sum()) / math.pi) / focal
    middle = np.median(points, axis=0)
    ways = middle / np.linalg.norm(middle)
    radius = float(np.clip(flat * middle[2], p.least_radius, p.most_radius))
    state = np.array([*(middle + 0.7 * radius * ways), math.log(radius), p.longer, 0.0, 0.0])
    prior = np.array([0.0, 0.0, 0.0, math.log(p.radius), p.longer, 0.0, 0.0])
    tilt = math.radians(p.tilt)
    spread = np.array([np.inf] * 3 + [p.radius_spread, p.longer_spread, tilt, tilt])
    around = 2.0 * math.pi * radius * focal / middle[2] * share
    per = max(p.outline_run * len(rays) / max(around, 1.0), 1.0)
    rays_weight = focal / (p.outline * middle[2] * math.sqrt(per))

    def residuals(x: FloatArray) -> FloatArray:
        """Residuals (S, R) of states (S, 7)."""
        first, second = _distances(x, axes, points, rays)
        return np.concatenate([first * weights, second * rays_weight, (x - prior) / spread], axis=1)

    hessian = np.eye(7)
    for turn in range(STEPS):
        many = residuals(np.vstack([state, state + DELTA * np.eye(7)]))
        now, slope = many[0], (many[1:] - many[0]).T / DELTA
        robust = np.minimum(1.0, HUBER / np.maximum(np.abs(now), 1e-9))
        robust[-7:] = 1.0
        hessian = slope.T @ (robust[:, None] * slope)
        step = np.linalg.solve(hessian + 1e-9 * np.eye(7), slope.T @ (robust * now))
        state = (
            state - np.clip(step, -0.02, 0.02) if np.abs(step[:3]).max() > 0.02 else state - step
        )
        state[3] = np.clip(state[3], math.log(0.5 * p.least_radius), math.log(2 * p.most_radius))
        state[4:] = np.clip(state[4:], -0.7, 0.7)
        narrow = turn == 2 and math.exp(state[3]) < 0.85 * p.least_radius  # most are stems
        if narrow or np.abs(step).max() < 1e-5:
            break
    center, radius = state[:3], math.exp(state[3])
    if not p.least_radius <= radius <= p.most_radius or center[2] <= 0.0:
        return None
    covariance = np.linalg.inv(hessian)[:3, :3] + p.depth_scale**2 * np.outer(center, center)
    covariance += p.model**2 * np.eye(3)
    first, second = (each[0] for each in _distances(state[None], axes, points, rays))
    off = float(np.abs(second).mean()) / radius if len(second) else 0.0
    misfit = float(np.median(np.abs(first) * weights)) * math.sqrt(_per(picture, pixels, p)) / 0.67
    left = float(np.sqrt(np.mean((first * weights) ** 2)))
    half = radius * math.exp(state[4])
    part = float(pixels.sum()) / (math.pi * radius * half * (focal / center[2]) ** 2)
    return Spheroid(
        center, _axis(state[None], axes)[0], radius, half, 0.5 * (covariance + covariance.T),
        misfit, _planar(points, weights) / max(left, 1e-9),
        off, min(share, part), share - part,
    )  # fmt: skip


def _axis(states: FloatArray, axes: FloatArray) -> FloatArray:
    """Axes (S, 3) of states (S, 7)."""
    ways = states[:, 5:] @ axes[:, :2].T + axes[:, 2]
    return np.asarray(ways / np.linalg.norm(ways, axis=1)[:, None])


def _distances(
    x: FloatArray, axes: FloatArray, points: FloatArray, rays: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Distances (S, N) of points and (S, K) of rays from the surfaces of states (S, 7) [m].

    Positive outside.
    """
    axis, radius = _axis(x, axes), np.exp(x[:, 3])
    shorter = np.exp(-x[:, 4]) - 1.0

    def scaled(vectors: FloatArray) -> FloatArray:
        """Vectors (S or 1, N, 3) in the coordinates of unit balls (S, N, 3)."""
        along = np.matmul(vectors, axis[:, :, None]) * shorter[:, None, None]
        return np.asarray((vectors + along * axis[:, None, :]) / radius[:, None, None])

    q = scaled(points[None] - x[:, None, :3])
    first = np.sqrt(np.einsum("sni,sni->sn", q, q)) - 1.0
    eye, ways = scaled(-x[:, None, :3])[:, 0], scaled(rays[None])
    # the distance of a line through `eye` from the origin: |eye|² less what is along the line
    along = np.matmul(ways, eye[:, :, None])[:, :, 0]
    square = (eye * eye).sum(axis=1)[:, None]
    square = square - along**2 / np.einsum("ski,ski->sk", ways, ways)
    second = np.sqrt(np.maximum(square, 1e-12)) - 1.0
    return first * radius[:, None], second * radius[:, None]


def _planar(points: FloatArray, weights: FloatArray) -> float:
    """Root mean square distance of points (N, 3) from their plane, by their weights (N,)."""
    off = points - points.mean(axis=0)
    across = np.linalg.svd(off, full_matrices=False)[2][-1]
    return float(np.sqrt(np.mean(((off @ across) * weights) ** 2)))


def _per(picture: DepthPicture, pixels: BoolArray, p: EyeParameters) -> float:
    """How many used depths err as one, at least 1."""
    used = min(MOST_POINTS, int(pixels.sum()))
    return max(p.patch * used / max(float(pixels.sum()), 1.0), 1.0)


def _front(
    picture: DepthPicture, pixels: BoolArray, p: EyeParameters
) -> tuple[FloatArray, FloatArray]:
    """Points (N, 3) of the fruit's front [m], and their weights (N,) [1/m]."""
    box = box_of(pixels, INSIDE + 1)
    inside = binary_erosion(pixels[box], iterations=INSIDE)
    if inside.sum() < 0.3 * pixels[box].sum():  # a thin rest of a fruit: a choice
        inside = pixels[box]
    rows = np.argwhere(inside & (picture.depth[box] > 0.0))
    if not len(rows):
        return np.zeros((0, 3)), np.zeros(0)
    points = picture.points[box][rows[:, 0], rows[:, 1]]
    middle = np.median(points[:, 2])
    points = points[np.abs(points[:, 2] - middle) < p.most_radius]
    points = points[np.linspace(0, len(points) - 1, min(len(points), MOST_POINTS)).astype(int)]
    deviation = p.depth_noise * points[:, 2] ** 2
    return points, 1.0 / (deviation * math.sqrt(_per(picture, pixels, p)))


def _outline(picture: DepthPicture, pixels: BoolArray, middle: float) -> tuple[FloatArray, float]:
    """Directions (K, 3) through the free outline, of depth 1, and the free share of the outline.

    A part of the outline is free where what lies beyond it is not nearer than the fruit and the
    picture does not end there.
    """
    height, width = pixels.shape
    box = box_of(pixels, 2)
    rows = np.argwhere(edge_of(pixels[box])) + [box[0].start, box[1].start]
    if not len(rows):
        return np.zeros((0, 3)), 0.0
    center = rows.mean(axis=0)
    out = rows - center
    out = out / np.maximum(np.linalg.norm(out, axis=1), 1e-9)[:, None]
    border = (rows < 2) | (rows > np.array([height, width]) - 3)
    free = ~border.any(axis=1)
    for ahead in (3.0, 5.0):  # [pixel] beyond the outline: a choice
        there = np.rint(rows + ahead * out).astype(int)
        there = np.clip(there, 0, [height - 1, width - 1])
        depth = picture.depth[there[:, 0], there[:, 1]]
        mine = pixels[there[:, 0], there[:, 1]]  # a dent: the fruit goes on beyond
        free &= ~((depth > 0.0) & (depth < middle + BEFORE)) & ~mine
    share = float(free.mean())
    rows, out = rows[free], out[free]
    if len(rows) > MOST_RAYS:
        keep = np.linspace(0, len(rows) - 1, MOST_RAYS).astype(int)
        rows, out = rows[keep], out[keep]
    edge = rows + 0.5 * out  # the edge is half a pixel beyond the middle of its last pixel
    camera = picture.camera
    x = (edge[:, 1] - camera.cx) / camera.fx
    y = (edge[:, 0] - camera.cy) / camera.fy
    return np.column_stack([x, y, np.ones(len(rows))]), share
