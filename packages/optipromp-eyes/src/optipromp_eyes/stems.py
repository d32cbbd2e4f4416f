"""Stems above fruits: the longest line through points of their colour."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from optipromp.core.arrays import BoolArray, FloatArray, frame_along
from optipromp_eyes.parameters import EyeParameters
from optipromp_eyes.spheroids import Spheroid as Spheroid

TRIES = 20  # directions that are tried, of those to the points about a fruit: a choice
STEEPEST = math.cos(math.radians(75.0))  # of the angle of a stem from the vertical: a choice
UPRIGHT, BOW = 0.5, math.radians(5.0)
"""Least cosine to the vertical of a stem that is hidden beside its fruit, and how far it may bow
there [rad]: choices."""
REACH = 0.06  # [m] above a fruit, or from where a stem shows on, that tells its direction: a choice
LEAST = 0.020  # [m] least length that is a stem: a choice
ASIDE = 0.0045  # [m] from a stem's line, across the view, as far as it goes: a choice
NOISE, DEPTH = 0.002, 0.004  # [m] of a stem's pixels from its line, across and along: guesses
FLOOR = math.radians(2.0)  # [rad] least deviation of a stem's tilt: a guess
BIN = 0.004  # [m] pieces of a stem that are seen or not: a choice
GAP = 3  # pieces that may be missing within a stem: a choice
FIRST_GAP = 0.014  # [m] between the end of a fruit and what shows of its stem: a choice
HIDDEN = 0.0, 0.024, 0.048
"""[m] of a stem beside its fruit that a leaf or the calyx may hide, tried in turn: choices."""
LONGEST = 0.40  # [m] of a stem: a choice
RIVAL = math.cos(math.radians(15.0))  # of the angle from which two lines are two stems: a choice


@dataclass(frozen=True, eq=False)
class SeenStem:
    """A stem in the frame of the camera."""

    direction: FloatArray  # (3,) unit, from the fruit to the root
    length: float  # from the fruit's centre as far as it was seen [m]
    deviation: float  # standard deviation of its tilt, the larger of two axes [rad]
    support: float  # length of it that told the direction [m]
    gap: float = 0.0  # length beside the fruit that something hides [m]


def stem_of(
    fruit: Spheroid, points: FloatArray, deep: FloatArray, up: FloatArray, p: EyeParameters,
    per: float, hidden: Sequence[float] = HIDDEN,
) -> SeenStem | None:  # fmt: skip
    """The stem of a fruit; None where too little of one is seen.

    The direction to each of some points about the fruit is tried; the longest piece without a gap
    wins. Where none is long enough, points farther off are tried, as if the part before them were
    ``hidden`` [m]. A line is then fitted to the points of the first part: precise across the view,
    coarse along it, with upright stems as a prior.

    ``points``: (N, 3) of all stems [m], of which ``per`` err as one. ``deep``: (N,) deviations of
    their places along the view [m]. ``up``: (3,) unit, upwards.
    """
    off = points - fruit.center
    away = np.linalg.norm(off, axis=1)
    near = (away > 0.8 * fruit.radius) & (away < LONGEST) & (off @ up > STEEPEST * away)
    rows = np.flatnonzero(near)[np.argsort(away[near], kind="stable")]
    off, away, deep = off[rows], away[rows], deep[rows]
    views = points[rows] / np.linalg.norm(points[rows], axis=1)[:, None]
    begin = max(fruit.radius, fruit.half)
    tries = (_from(begin, gap, off, away, views, deep, up, p, per) for gap in hidden)
    return next((stem for stem in tries if stem is not None), None)


def _from(
    begin: float, gap: float, off: FloatArray, away: FloatArray, views: FloatArray,
    deep: FloatArray, up: FloatArray, p: EyeParameters, per: float,
) -> SeenStem | None:  # fmt: skip
    """The stem that shows from a ``gap`` beyond a distance ``begin`` of its fruit's centre on [m].

    The longer the gap, the more of a stem must show: it may be of another fruit.
    """
    begin, least = begin + gap, LEAST + 0.5 * gap
    about = np.flatnonzero((away > begin) & (away < begin + REACH))
    if len(about) < 5:  # points: a choice
        return None
    chosen = about[np.linspace(0, len(about) - 1, min(len(about), TRIES)).astype(int)]
    ways = off[chosen] / away[chosen][:, None]
    beside, along = _beside(off[about], views[about], ways)
    lengths = _whole(along, beside & (along < begin + REACH), begin)
    best = int(np.argmax(lengths + 1e-3 * (ways @ up)))  # of equals the more upright: a choice
    if lengths[best] < least or (gap and ways[best] @ up < UPRIGHT):
        return None
    way = ways[best]
    cosine = np.clip(ways @ way, -1.0, 1.0)
    rival = np.where(cosine < RIVAL, lengths, 0.0)
    other = int(np.argmax(rival))
    odds = rival[other] / lengths[best]
    doubt = odds**2 / (1.0 + odds**2) * math.acos(float(cosine[other])) ** 2
    for _ in range(2):
        beside, along = _beside(off, views, way[None])
        used = (beside & (along < begin + REACH) & (along > 0.8 * begin))[0]
        way, deviation = _line(off[used], views[used], deep[used], way, up, p, per)
    beside, along = _beside(off, views, way[None])
    support = float(_whole(along, beside & (along < begin + REACH), begin)[0])
    if support < least:
        return None
    length = begin + float(_whole(along, beside, begin)[0])
    bow = BOW if gap else 0.0
    deviation = math.hypot(max(deviation, FLOOR), 0.5 * math.sqrt(doubt), bow)
    return SeenStem(way, length, deviation, support, gap)


def _beside(off: FloatArray, views: FloatArray, ways: FloatArray) -> tuple[BoolArray, FloatArray]:
    """Whether points (N,) are beside the lines along ``ways`` (K, 3), (K, N), and how far along
    these they are [m]. ``views``: (N, 3) unit, along the lines of sight."""
    along = ways @ off.T
    deep = np.abs((off * views).sum(axis=1) - along * (ways @ views.T))
    across = (off**2).sum(axis=1) - along**2 - deep**2  # squared
    close = (across < ASIDE**2) & (deep < 4.0 * DEPTH)
    return close & (along > 0.0), along


def _whole(along: FloatArray, there: BoolArray, begin: float) -> FloatArray:
    """Lengths (K,) of pieces from ``begin`` on without a long gap [m], of points (K, N) that are
    ``there`` (K, N)."""
    row, column = np.nonzero(there & (along > begin))
    bins = ((along[row, column] - begin) / BIN).astype(int)
    seen = np.zeros((len(along), int(bins.max(initial=0)) + 1), dtype=bool)
    seen[row, bins] = True
    last, ends = np.zeros(len(along), dtype=np.int64), np.zeros(len(along))
    for k in range(seen.shape[1]):
        goes_on = seen[:, k] & (k - last <= GAP)
        last[goes_on], ends[goes_on] = k, (k + 1) * BIN
        if k - int(last.max()) > GAP:
            break
    return ends


def _line(
    off: FloatArray, views: FloatArray, deep: FloatArray, way: FloatArray, up: FloatArray,
    p: EyeParameters, per: float,
) -> tuple[FloatArray, float]:  # fmt: skip
    r"""The direction (3,) of the line through the points, and the deviation of its tilt [rad].

    With axes :math:`E` across ``way``, a point at :math:`t` along it is off by
    :math:`E^T x = o + t \tau` plus an error. The offset :math:`o` and the tilt :math:`\tau` are
    Gaussian before: as wide as a stem, and as stems lean.
    """
    axes = frame_along(way)[:, :2]
    t, place = off @ way, off @ axes
    x, y = (views @ axes).T  # (N,) share of the line of sight
    sharp = 1.0 / (NOISE**2 * max(per, 1.0))
    # the inverse of the error, of NOISE all around and of deep along the line of sight
    blunt = deep**2 / (NOISE**2 + deep**2 * (x**2 + y**2))
    weights = sharp * np.array([1.0 - blunt * x**2, -blunt * x * y, 1.0 - blunt * y**2])
    sums = weights[[0, 1, 1, 2]] @ np.stack([np.ones(len(t)), t, t**2], axis=1)
    one, first, second = sums.T.reshape(3, 2, 2)
    pulls = np.stack([
        weights[0] * place[:, 0] + weights[1] * place[:, 1],
        weights[1] * place[:, 0] + weights[2] * place[:, 1],
    ])  # fmt: skip
    tilt = math.radians(p.tilt)
    before = np.diag([1.0 / ASIDE**2] * 2 + [1.0 / tilt**2] * 2)
    leaning = up @ axes / max(float(up @ way), STEEPEST)
    matrix = before + np.block([[one, first], [first, second]])
    vector = np.concatenate([pulls.sum(axis=1), pulls @ t])
    vector[2:] += leaning / tilt**2
    covariance = np.linalg.inv(matrix)
    turned = way + axes @ (covariance @ vector)[2:]
    deviation = math.sqrt(float(np.linalg.eigvalsh(covariance[2:, 2:])[-1]))
    return turned / np.linalg.norm(turned), deviation
