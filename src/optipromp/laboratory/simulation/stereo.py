"""Depth as a stereo camera measures it: with noise, a scale error, ragged edges and holes."""

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter, maximum_filter, minimum_filter

from optipromp.core.arrays import BoolArray, FloatArray
from optipromp.core.parameters import Checked, parameter


@dataclass(frozen=True)
class StereoParameters(Checked):
    """Errors of a stereo camera of short range on a hand."""

    baseline: float = parameter(0.018, "m", "published", "imagers of a RealSense D405 (sheet)")
    subpixel: float = parameter(0.08, "pixel", "published", "of the disparity; tuned (Intel)")
    window: float = parameter(1.5, "pixel", "guess", "deviation of the noise's filter")
    scale: float = parameter(0.005, "1", "guess", "of depth; sheet of the D405: < 0.02 at 0.5 m")
    ragged: float = parameter(1.0, "pixel", "guess", "deviation of an edge's place, each axis")
    step: float = parameter(0.015, "m", "choice", "least step of depth that is an edge")
    edge_holes: float = parameter(0.3, "1", "guess", "share of pixels at edges without a depth")
    holes: float = parameter(0.01, "1", "guess", "of all pixels: gloss and no texture")
    hole_size: float = parameter(3.0, "pixel", "guess", "correlation length of these holes")
    nearest: float = parameter(0.07, "m", "published", "least depth of a D405 (data sheet)")
    farthest: float = parameter(1.5, "m", "choice", "largest depth that is kept")


def sensed(
    depth: FloatArray, focal: float, parameters: StereoParameters, rng: np.random.Generator
) -> FloatArray:
    r"""Depth (height, width) [m] as measured from the true one; 0 where nothing is measured.

    The disparity is :math:`d = f b / z`. Its error :math:`\sigma_d` is an error
    :math:`\sigma_z = z^2 \sigma_d / (f b)` of depth. A pixel that the second imager does not see is
    a hole.

    ``depth``: true depth along the optical axis [m]. ``focal``: length [pixel]. ``parameters``: of
    the camera. ``rng``: of the errors.
    """
    p, size = parameters, depth.shape
    rows, columns = np.indices(size)
    ragged = [p.ragged * _smooth(size, p.window, rng) for _ in range(2)]
    low = np.clip(np.rint(rows + ragged[0]).astype(int), 0, size[0] - 1)
    right = np.clip(np.rint(columns + ragged[1]).astype(int), 0, size[1] - 1)
    moved = depth[low, right]
    disparity = focal * p.baseline / np.maximum(moved, 1e-3)
    holes = _unseen(disparity)
    disparity = disparity + p.subpixel * _smooth(size, p.window, rng)
    measured = focal * p.baseline / np.maximum(disparity, 1e-3)
    measured *= 1.0 + p.scale * rng.standard_normal()
    steps = maximum_filter(moved, 3) - minimum_filter(moved, 3) > p.step
    holes |= steps & (rng.random(size) < p.edge_holes)
    blobs = _smooth(size, p.hole_size, rng)
    holes |= blobs > np.quantile(blobs, 1.0 - p.holes)
    holes |= (measured < p.nearest) | (measured > p.farthest)
    return np.where(holes, 0.0, measured)


def _unseen(disparity: FloatArray) -> BoolArray:
    """Whether (height, width) a nearer surface hides a pixel from the imager to the right."""
    there = np.arange(disparity.shape[1]) - disparity
    least = np.minimum.accumulate(there[:, ::-1], axis=1)[:, ::-1]
    beyond = np.full_like(there, np.inf)
    beyond[:, :-1] = least[:, 1:]
    return np.asarray(beyond <= there - 1.0)


def _smooth(size: tuple[int, ...], width: float, rng: np.random.Generator) -> FloatArray:
    """Gaussian noise of unit standard deviation, correlated over ``width`` pixels."""
    noise = gaussian_filter(rng.standard_normal(size), width, mode="wrap")
    return np.asarray(noise / noise.std())
