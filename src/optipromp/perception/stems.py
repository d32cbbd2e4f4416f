"""The stems of fruits: lines upwards from a fruit through pixels of the colour of stems."""

import math
from dataclasses import dataclass

import numpy as np

from optipromp.core.arrays import BoolArray, FloatArray, frame_along
from optipromp.perception.parameters import EyeParameters
from optipromp.perception.spheroids import Spheroid

TRIES = 20  # directions that are tried, of those to the points about a fruit: a choice
STEEPEST = math.cos(math.radians(75.0))  # of the angle of a stem from the vertical: a choice
BIN = 0.004  # [m] pieces of a stem that are seen or not: a choice
GAP = 3  # pieces that may be missing within a stem, and between fruit and stem: a choice
LONGEST = 0.40  # [m] of a stem: a choice
RIVAL = math.cos(math.radians(15.0))  # of the angle from which two lines are two stems: a choice


@dataclass(frozen=True, eq=False)
class SeenStem:
    """A stem in the frame of the camera.

    Attributes:
        direction: (3,) unit, from the fruit to the root.
        length: from the fruit's centre as far as it was seen [m].
        deviation: standard deviation of its tilt, the larger of two axes [rad].
        support: length of it that told the direction [m].
    """

    direction: FloatArray
    length: float
    deviation: float
    support: float


def stem_of(
    fruit: Spheroid, points: FloatArray, up: FloatArray, p: EyeParameters, per: float
) -> SeenStem | None:
    """The stem of a fruit; None where too little of one is seen.

    The direction to each of some points about the fruit is tried; the longest piece without a gap
    wins. Its line is then fitted to the points beside it: precise across the view, coarse along it,
    with upright stems as a prior.

    ``fruit``: whose stem is looked for. ``points``: (N, 3) of all stems [m]. ``up``: (3,) unit,
    upwards. ``p``: numbers of the search. ``per``: how many points err as one.
    """
    off = points - fruit.center
    away = np.linalg.norm(off, axis=1)
    begin = max(fruit.radius, fruit.half)
    near = (away > 0.8 * fruit.radius) & (away < LONGEST) & (off @ up > STEEPEST * away)
    off, away, points = off[near], away[near], points[near]
    about = np.flatnonzero((away > begin) & (away < begin + p.stem_reach))
    if len(about) < 5:  # points: a choice
        return None
    chosen = about[np.linspace(0, len(about) - 1, min(len(about), TRIES)).astype(int)]
    close, places = off[about], points[about]
    ways = off[chosen] / away[chosen][:, None]
    lengths = np.zeros(len(ways))
    for k, way in enumerate(ways):
        beside, along = _beside(close, places, way, p)
        lengths[k] = _whole(along[beside & (along < begin + p.stem_reach)], begin)
    best = int(np.argmax(lengths + 1e-3 * (ways @ up)))  # of equals the more upright: a choice
    if lengths[best] < p.stem_least:
        return None
    way = ways[best]
    cosine = np.clip(ways @ way, -1.0, 1.0)
    rival = np.where(cosine < RIVAL, lengths, 0.0)
    other = int(np.argmax(rival))
    odds = rival[other] / lengths[best]
    doubt = odds**2 / (1.0 + odds**2) * math.acos(float(cosine[other])) ** 2
    for _ in range(2):
        beside, along = _beside(off, points, way, p)
        used = beside & (along < begin + p.stem_reach) & (along > 0.8 * fruit.radius)
        way, deviation = _line(off[used], points[used], way, up, p, per)
    beside, along = _beside(off, points, way, p)
    support = _whole(along[beside & (along < begin + p.stem_reach)], begin)
    if support < p.stem_least:
        return None
    length = begin + _whole(along[beside], begin)
    deviation = math.hypot(max(deviation, math.radians(p.stem_floor)), 0.5 * math.sqrt(doubt))
    return SeenStem(way, length, deviation, support)


def _beside(
    off: FloatArray, points: FloatArray, way: FloatArray, p: EyeParameters
) -> tuple[BoolArray, FloatArray]:
    """Whether points (N,) are beside the line along ``way``, and how far along [m]."""
    along = off @ way
    rest = off - along[:, None] * way
    views = points / np.linalg.norm(points, axis=1)[:, None]
    deep = np.abs(np.einsum("ni,ni->n", rest, views))
    across = np.sqrt(np.maximum((rest**2).sum(axis=1) - deep**2, 0.0))
    return (across < p.stem_aside) & (deep < 4.0 * p.stem_depth) & (along > 0.0), along


def _whole(along: FloatArray, begin: float) -> float:
    """Length of the piece from ``begin`` on without a long gap [m]."""
    bins = np.flatnonzero(np.bincount(((along[along > begin] - begin) / BIN).astype(int)))
    if not len(bins) or bins[0] > GAP:
        return 0.0
    gaps = np.flatnonzero(np.diff(bins) > GAP)
    last = bins[gaps[0]] if len(gaps) else bins[-1]
    return float((last + 1) * BIN)


def _line(
    off: FloatArray, points: FloatArray, way: FloatArray, up: FloatArray, p: EyeParameters,
    per: float,
) -> tuple[FloatArray, float]:  # fmt: skip
    r"""The direction (3,) of the line through the points, and the deviation of its tilt [rad].

    With axes :math:`E` across ``way``, a point at :math:`t` along it is off by
    :math:`E^T x = o + t \tau` plus an error. The offset :math:`o` and the tilt :math:`\tau` are
    Gaussian before: as wide as a stem, and as stems lean.
    """
    axes = frame_along(way)[:, :2]
    t = off @ way
    views = points / np.linalg.norm(points, axis=1)[:, None]
    seen = views @ axes  # (N, 2) share of the line of sight
    error = p.stem_noise**2 * np.eye(2) + p.stem_depth**2 * seen[:, :, None] * seen[:, None, :]
    weight = np.linalg.inv(error) / max(per, 1.0)
    design = np.zeros((len(t), 2, 4))
    design[:, 0, 0] = design[:, 1, 1] = 1.0
    design[:, 0, 2] = design[:, 1, 3] = t
    tilt = math.radians(p.tilt)
    before = np.diag([1.0 / p.stem_aside**2] * 2 + [1.0 / tilt**2] * 2)
    leaning = up @ axes / max(float(up @ way), STEEPEST)
    matrix = before + np.einsum("nia,nij,njb->ab", design, weight, design)
    vector = np.einsum("nia,nij,nj->a", design, weight, off @ axes)
    vector[2:] += leaning / tilt**2
    covariance = np.linalg.inv(matrix)
    turned = way + axes @ (covariance @ vector)[2:]
    deviation = math.sqrt(float(np.linalg.eigvalsh(covariance[2:, 2:])[-1]))
    return turned / np.linalg.norm(turned), deviation
