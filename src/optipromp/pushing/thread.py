"""A tool path threaded past the pushables: where the tool point goes at each height.

At every height the path takes the point nearest to the approach line that is aside of each pushable
whose window it is in (cyclic projection on the half-planes of the drift constraint); where nothing
asks for anything it runs straight between. The optimiser starts near it, so that it begins on the
right side of everything.
"""

import math

import numpy as np

from optipromp.arrays import FloatArray
from optipromp.pushing.sides import Drift

LEVEL = 0.001  # [m] between the heights that are looked at
SWEEPS = 40


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
    corners = [np.append((camera - goal) @ lateral.T, bottom)]
    farthest = float(np.linalg.norm(flat + offsets[:, None] * directions, axis=1).max())
    above = levels[:, None] - heights
    inside = (drift.windows[:, 0] <= above) & (above <= drift.windows[:, 1])
    last: FloatArray | None = None
    for i, h in enumerate(levels):
        active = np.flatnonzero(inside[i])
        if not len(active):
            last = None
            continue
        if last is not None and np.array_equal(inside[i], inside[i - 1]):
            corners[-1] = np.append(last, h)  # the windows go on: their far end
            continue
        p = _aside(flat[active], directions[active], offsets[active], farthest)
        if last is not None and np.allclose(p, last, atol=1e-6):
            corners[-1] = np.append(p, h)
            continue
        corners += [np.append(p, h), np.append(p, h)]
        last = p
    corners += [np.array([0.0, 0.0, max(bottom, -capture)]), np.zeros(3)]
    local = np.array(corners)
    return np.asarray(goal + local[:, :2] @ lateral + local[:, 2:] * up)


def _aside(
    flat: FloatArray, directions: FloatArray, offsets: FloatArray, farthest: float
) -> FloatArray:
    """The point (2,) nearest to the approach line that is aside of all, by cyclic projection.

    None is farther from the line than ``farthest``: where things ask for opposite sides, the point
    would flee to where their half-planes meet; a compromise is nearer.
    """
    p = np.zeros(2)
    for _ in range(SWEEPS):
        before = p
        for center, direction, offset in zip(flat, directions, offsets, strict=True):
            short = offset - direction @ (p - center)
            if short > 0.0:
                p = p + short * direction
                away = math.sqrt(p @ p)
                if away > farthest:
                    p = p * (farthest / away)
        if np.array_equal(p, before):
            break
    return p


def length(corners: FloatArray) -> float:
    """Length of a path through ``corners`` (k, 3) [m]."""
    return float(np.linalg.norm(np.diff(corners, axis=0), axis=1).sum())


def evenly(corners: FloatArray, count: int) -> FloatArray:
    """``count`` points (count, 3) along the path, evenly spaced."""
    steps = np.linalg.norm(np.diff(corners, axis=0), axis=1)
    keep = np.append(True, steps > 1e-9)
    at = np.append(0.0, np.cumsum(steps))[keep]
    wanted = np.linspace(0.0, at[-1], count)
    return np.stack([np.interp(wanted, at, corners[keep, i]) for i in range(3)], axis=1)
