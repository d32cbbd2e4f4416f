"""The tool's path: a smooth curve of the tool point from the entry of the approach to the target.

Two moving averages along the arc round the corners of a polyline: the curvature of the path is
continuous, so that an arm can follow it without a jump in acceleration.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from optipromp.core.arrays import FloatArray, frozen
from optipromp.core.compiled import called, inner, kernel
from optipromp.core.pushing.parameters import PUSH

STEP, ROUNDING = PUSH.rule.point_step, PUSH.rule.rounding


@dataclass(frozen=True, eq=False)
class ToolPath:
    """A path of the tool point.

    Attributes:
        points: (P, 3) about :data:`STEP` apart, the entry first, the goal last [m].
        speed: largest speed of the tool along the path [m/s].
        harm: predicted by the push model; 0 for a path of the rule.
    """

    points: FloatArray
    speed: float
    harm: float = 0.0

    @cached_property
    def length(self) -> float:
        """Length from entry to goal [m]."""
        return float(length(self.points))

    def at(self, share: FloatArray) -> FloatArray:
        """Points (m, 3) at shares (m,) of the length."""
        along = np.linspace(0.0, 1.0, len(self.points))
        return np.stack([np.interp(share, along, column) for column in self.points.T], axis=1)


def turning(axis: FloatArray, lead: FloatArray | None, share: FloatArray) -> FloatArray:
    """Tool axes (m, 3) at shares (m,) of a path, turning evenly from ``lead`` to ``axis`` (3,)."""
    if lead is None:
        return np.tile(axis, (len(share), 1))
    axes = lead + share[:, None] * (axis - lead)
    return np.asarray(axes / np.linalg.norm(axes, axis=1)[:, None])


def through(
    corners: FloatArray | Sequence[FloatArray], speed: float, harm: float = 0.0
) -> ToolPath:
    """The rounded path from the first to the last of ``corners`` (k, 3) [m]."""
    return ToolPath(frozen(rounded(np.ascontiguousarray(corners), STEP, ROUNDING)), speed, harm)


@kernel
def rounded(corners, step, width):
    """Points (P, 3) about ``step`` apart on the polyline ``corners`` (k, 3), averaged twice.

    Each average is over ``width`` of the arc [m], and over less near the ends, which stay in place.
    """
    points, half = stepped(corners, step), int(0.5 * width / step)
    count = len(points)
    sums = np.zeros((count + 1, 3))
    for _ in range(2):
        for i in range(count):
            for m in range(3):
                sums[i + 1, m] = sums[i, m] + points[i, m]
        for i in range(count):
            h = min(half, i, count - 1 - i)
            for m in range(3):
                points[i, m] = (sums[i + h + 1, m] - sums[i - h, m]) / (2 * h + 1)
    return points


@kernel
def stepped(corners, step):
    """Points (P, 3) about ``step`` apart, evenly along the polyline ``corners`` (k, 3)."""
    total = length(corners)
    count = max(2, math.ceil(total / step) + 1)
    points, gone, i = np.empty((count, 3)), 0.0, 1
    for m in range(3):
        points[0, m], points[count - 1, m] = corners[0, m], corners[len(corners) - 1, m]
    for k in range(1, len(corners)):
        piece = _step(corners, k)
        while i < count - 1 and i * total / (count - 1) <= gone + piece:
            share = (i * total / (count - 1) - gone) / max(piece, 1e-12)
            for m in range(3):
                low, high = corners[k - 1, m], corners[k, m]
                points[i, m] = low + share * (high - low)
            i += 1
        gone += piece
    return points


@called
def length(corners):
    """Length of a path through ``corners`` (k, 3) [m]."""
    far = 0.0
    for k in range(1, len(corners)):
        far += _step(corners, k)
    return far


def evenly(corners: FloatArray, count: int) -> FloatArray:
    """Points (count, 3), evenly spaced along the path."""
    return np.asarray(along(corners, corners, count))


@kernel
def along(corners, values, count):
    """Values (count, m), evenly along the path: interpolated from those of the corners (k, m)."""
    at, kept, last = np.zeros(len(corners)), np.zeros(len(corners), dtype=np.int64), 0
    far = 0.0
    for k in range(1, len(corners)):
        step = _step(corners, k)
        far += step
        if step > 1e-9:  # otherwise the two corners are one
            last += 1
            at[last], kept[last] = far, k
    out = np.empty((count, values.shape[1]))
    i = 0
    for c in range(count):
        wanted = at[last] if c == count - 1 else c * (at[last] / (count - 1))
        while i < last - 1 and at[i + 1] <= wanted:
            i += 1
        j = min(i + 1, last)
        low, high = kept[i], kept[j]
        for m in range(values.shape[1]):
            if wanted >= at[j]:
                out[c, m] = values[high, m]
            else:
                slope = (values[high, m] - values[low, m]) / (at[j] - at[i])
                out[c, m] = slope * (wanted - at[i]) + values[low, m]
    return out


@inner
def _step(corners, k):
    x = corners[k, 0] - corners[k - 1, 0]
    y = corners[k, 1] - corners[k - 1, 1]
    z = corners[k, 2] - corners[k - 1, 2]
    return math.sqrt(x * x + y * y + z * z)
