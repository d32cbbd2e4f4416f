"""Spheroids by least squares, many at once, and rays that meet them."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from optipromp.core.arrays import FloatArray
from optipromp.perception.parameters import EyeParameters

HUBER = 2.0  # [standard deviations] beyond which a residual counts linearly: a choice


class FitData(NamedTuple):
    """What R fits use, padded with weights 0."""

    points: FloatArray  # (R, P, 3) of fronts [m]
    weights: FloatArray  # (R, P) [1/m]
    rays: FloatArray  # (R, K, 3) through free outlines
    pulls: FloatArray  # (R, K) their weights [1/m]


def axis_of(x: FloatArray, axes: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Axes (R, 3) of states (R, 7), and their derivatives (R, 2, 3) by the tilts."""
    ways = x[:, 5:] @ axes[:, :2].T + axes[:, 2]
    size = np.linalg.norm(ways, axis=1)[:, None]
    ways = ways / size
    slope = axes[:, :2].T[None] - (ways @ axes[:, :2])[:, :, None] * ways[:, None]
    return ways, slope / size[:, :, None]


def system(x: FloatArray, axes: FloatArray, data: FitData) -> tuple[FloatArray, FloatArray]:
    """Weighted residuals (R, P + K) of states (R, 7), and their derivatives (R, P + K, 7)."""
    axis, turn = axis_of(x, axes)
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
        now, slope = system(x, axes, data)
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


class SpheroidRows(NamedTuple):
    """R spheroids: centres (R, 3), axes (R, 3), radii (R,), half lengths (R,)."""

    center: FloatArray
    axis: FloatArray
    radius: FloatArray
    half: FloatArray


def balls_through(x: FloatArray, axes: FloatArray) -> SpheroidRows:
    """The spheroids of states (R, 7)."""
    radius = np.exp(x[:, 3])
    return SpheroidRows(x[:, :3], axis_of(x, axes)[0], radius, radius * np.exp(x[:, 4]))


def surface(rays: FloatArray, balls: SpheroidRows) -> tuple[FloatArray, FloatArray]:
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
