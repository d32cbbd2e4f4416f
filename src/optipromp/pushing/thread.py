"""A tool path threaded past the pushables: where the tool point goes at each height.

At every height the path takes the point nearest to the approach line that is aside of each pushable
whose window it is in (cyclic projection on the half-planes of the drift constraint); where nothing
asks for anything it runs straight between. The optimiser starts near it, so that it begins on the
right side of everything.
"""

import math

import numpy as np
from numba import njit

from optipromp.arrays import FloatArray
from optipromp.pushing.sides import Drift

LEVEL = 0.001  # [m] between the heights that are looked at
SWEEPS = 40
ALIKE = 2e-6  # [m] between points that are one
APART = 1e-9  # [m] between corners that are two


def thread(
    drift: Drift,
    offsets: FloatArray,
    goal: FloatArray,
    frame: FloatArray,
    camera: FloatArray,
    capture: float,
) -> FloatArray:
    """Corners (k, 3) of the path from the camera point to the goal [m].

    Args:
        drift: windows and directions of the neighbours.
        offsets: (N,) how far the tool is to pass each of them [m].
        goal: (3,) where the tool point ends.
        frame: (3, 3) rows x_g, y_g, z_g.
        camera: (3,) where the path begins.
        capture: how far below the goal the tool must be on the approach line [m].
    """
    lateral, up = frame[:2], frame[2]
    centers = drift.centers - goal
    heights, flat = centers @ up, centers @ lateral.T
    directions = drift.directions @ lateral.T
    bottom = float((camera - goal) @ up)
    levels = np.arange(bottom, -capture, LEVEL)
    local = np.empty((2 * len(levels) + 3, 3))
    local[0, :2], local[0, 2] = (camera - goal) @ lateral.T, bottom
    aside = flat + offsets[:, None] * directions
    farthest = math.sqrt(max(float(point @ point) for point in aside))
    count = _corners(
        levels, np.ascontiguousarray(drift.windows), heights, flat, directions,
        np.ascontiguousarray(offsets), farthest, local,
    )  # fmt: skip
    local[count] = 0.0, 0.0, max(bottom, -capture)
    local[count + 1] = 0.0
    local = local[: count + 2]
    return np.asarray(goal + local[:, :2] @ lateral + local[:, 2:] * up)


@njit(cache=True, error_model="numpy", nogil=True)
def _corners(levels, windows, heights, flat, directions, offsets, farthest, corners):  # type: ignore[no-untyped-def]
    """Corners (k, 3) after the first, in place, where windows begin and end; returns their number.

    ``levels`` (L,) are the heights that are looked at, ``heights`` (N,) and ``flat`` (N, 2) those
    of the neighbours and where they are aside of the approach line.
    """
    n = heights.shape[0]
    inside, before = np.zeros(n, dtype=np.bool_), np.zeros(n, dtype=np.bool_)
    p, last, has_last, count = np.zeros(2), np.zeros(2), False, 1
    for i in range(levels.shape[0]):
        some, same = False, True
        for k in range(n):
            above = levels[i] - heights[k]
            before[k] = inside[k]
            inside[k] = windows[k, 0] <= above <= windows[k, 1]
            some |= inside[k]
            same &= inside[k] == before[k]
        if not some:
            has_last = False
            continue
        if not (has_last and same):
            _aside(flat, directions, offsets, inside, farthest, p)
            apart = max(abs(p[0] - last[0]), abs(p[1] - last[1]))
            if not has_last or apart > ALIKE:
                last[:] = p
                corners[count, 0], corners[count, 1], corners[count, 2] = p[0], p[1], levels[i]
                count += 1
                corners[count, 0], corners[count, 1] = p[0], p[1]
                count += 1
                has_last = True
        corners[count - 1, 2] = levels[i]  # as far as it goes on like this
    return count


@njit(cache=True, error_model="numpy", nogil=True)
def _aside(flat, directions, offsets, active, farthest, p):  # type: ignore[no-untyped-def]
    """``p`` (2,): the point nearest to the approach line that is aside of all ``active`` (N,).

    By cyclic projection, in place. None is farther from the line than ``farthest``: where things
    ask for opposite sides, the point would flee to where their half-planes meet; a compromise is
    nearer.
    """
    p[:] = 0.0
    for _ in range(SWEEPS):
        x, y = p[0], p[1]
        for k in range(flat.shape[0]):
            if not active[k]:
                continue
            dx, dy = directions[k, 0], directions[k, 1]
            short = offsets[k] - (dx * (p[0] - flat[k, 0]) + dy * (p[1] - flat[k, 1]))
            if short > 0.0:
                p[0] += short * dx
                p[1] += short * dy
                away = math.sqrt(p[0] * p[0] + p[1] * p[1])
                if away > farthest:
                    p *= farthest / away
        if p[0] == x and p[1] == y:
            break


@njit(cache=True, error_model="numpy", nogil=True)
def length(corners: FloatArray) -> float:
    """Length of a path through ``corners`` (k, 3) [m]."""
    far = 0.0
    for k in range(1, len(corners)):
        far += _step(corners, k)
    return far


def evenly(corners: FloatArray, count: int) -> FloatArray:
    """``count`` points (count, 3) along the path, evenly spaced."""
    return along(corners, corners, count)


@njit(cache=True, error_model="numpy", nogil=True)
def along(corners: FloatArray, values: FloatArray, count: int) -> FloatArray:
    """``values`` (k, m) of the corners (k, 3), at ``count`` places evenly along the path."""
    at, kept, last = np.zeros(len(corners)), np.zeros(len(corners), dtype=np.int64), 0
    far = 0.0
    for k in range(1, len(corners)):
        step = _step(corners, k)
        far += step
        if step > APART:
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


@njit(cache=True, error_model="numpy", nogil=True)
def _step(corners: FloatArray, k: int) -> float:
    x = corners[k, 0] - corners[k - 1, 0]
    y = corners[k, 1] - corners[k - 1, 1]
    z = corners[k, 2] - corners[k - 1, 2]
    return math.sqrt(x * x + y * y + z * z)
