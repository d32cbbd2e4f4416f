"""Stems above fruits: the longest line, or the longest trace, through points of their colour."""

import math
from dataclasses import dataclass

import numpy as np

from optipromp.core.arrays import BoolArray, FloatArray, IntArray, frame_along
from optipromp_eyes.parameters import EyeParameters
from optipromp_eyes.spheroids import Spheroid as Spheroid

TRIES = 20  # directions that are tried, of those to the points about a fruit: a choice
STEEPEST = math.cos(math.radians(75.0))  # of the angle of a stem from the vertical: a choice
BIN = 0.004  # [m] pieces of a stem that are seen or not: a choice
GAP = 3  # pieces that may be missing within a stem: a choice
FIRST_GAP = 0.014  # [m] between the end of a fruit and what shows of its stem: a choice
TURNING = 0.35  # share of each piece in the direction of a trace: a choice
LONGEST = 0.40  # [m] of a stem: a choice
RIVAL = math.cos(math.radians(15.0))  # of the angle from which two lines are two stems: a choice


@dataclass(frozen=True, eq=False)
class SeenStem:
    """A stem in the frame of the camera."""

    direction: FloatArray  # (3,) unit, from the fruit to the root
    length: float  # from the fruit's centre as far as it was seen [m]
    deviation: float  # standard deviation of its tilt, the larger of two axes [rad]
    support: float  # length of it that told the direction [m]
    bent: bool = False  # whether it was traced, as no straight one was seen


def stem_of(
    fruit: Spheroid, points: FloatArray, deep: FloatArray, up: FloatArray, p: EyeParameters,
    per: float, bends: bool = True,
) -> SeenStem | None:  # fmt: skip
    """The stem of a fruit; None where too little of one is seen.

    The direction to each of some points about the fruit is tried; the longest piece without a gap
    wins. Where none is long enough, stems that bend are traced from these points outwards, in
    pieces between two spheres about the fruit's centre. A line is then fitted to the points of the
    first part: precise across the view, coarse along it, with upright stems as a prior.

    ``points``: (N, 3) of all stems [m], of which ``per`` err as one. ``deep``: (N,) deviations of
    their places along the view [m]. ``up``: (3,) unit, upwards.
    """
    off = points - fruit.center
    away = np.linalg.norm(off, axis=1)
    begin = max(fruit.radius, fruit.half)
    near = (away > 0.8 * fruit.radius) & (away < LONGEST) & (off @ up > STEEPEST * away)
    rows = np.flatnonzero(near)[np.argsort(away[near], kind="stable")]
    off, away, deep = off[rows], away[rows], deep[rows]
    views = points[rows] / np.linalg.norm(points[rows], axis=1)[:, None]
    about = np.flatnonzero((away > begin) & (away < begin + p.stem_reach))
    if len(about) < 5:  # points: a choice
        return None
    chosen = about[np.linspace(0, len(about) - 1, min(len(about), TRIES)).astype(int)]
    ways = off[chosen] / away[chosen][:, None]
    beside, along = _beside(off[about], views[about], ways, p)
    lengths = _whole(along, beside & (along < begin + p.stem_reach), begin)
    best = int(np.argmax(lengths + 1e-3 * (ways @ up)))  # of equals the more upright: a choice
    if lengths[best] < p.stem_least:
        return _bent(fruit, off, away, views, deep, up, p, per) if bends else None
    way = ways[best]
    cosine = np.clip(ways @ way, -1.0, 1.0)
    rival = np.where(cosine < RIVAL, lengths, 0.0)
    other = int(np.argmax(rival))
    odds = rival[other] / lengths[best]
    doubt = odds**2 / (1.0 + odds**2) * math.acos(float(cosine[other])) ** 2
    for _ in range(2):
        beside, along = _beside(off, views, way[None], p)
        used = (beside & (along < begin + p.stem_reach) & (along > 0.8 * fruit.radius))[0]
        way, deviation = _line(off[used], views[used], deep[used], way, up, p, per)
    beside, along = _beside(off, views, way[None], p)
    support = float(_whole(along, beside & (along < begin + p.stem_reach), begin)[0])
    if support < p.stem_least:
        return None
    length = begin + float(_whole(along, beside, begin)[0])
    deviation = math.hypot(max(deviation, math.radians(p.stem_floor)), 0.5 * math.sqrt(doubt))
    return SeenStem(way, length, deviation, support)


def _beside(
    off: FloatArray, views: FloatArray, ways: FloatArray, p: EyeParameters
) -> tuple[BoolArray, FloatArray]:
    """Whether points (N,) are beside the lines along ``ways`` (K, 3), (K, N), and how far along
    these they are [m]. ``views``: (N, 3) unit, along the lines of sight."""
    along = ways @ off.T
    deep = np.abs((off * views).sum(axis=1) - along * (ways @ views.T))
    across = (off**2).sum(axis=1) - along**2 - deep**2  # squared
    close = (across < p.stem_aside**2) & (deep < 4.0 * p.stem_depth)
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


def _bent(
    fruit: Spheroid, off: FloatArray, away: FloatArray, views: FloatArray, deep: FloatArray,
    up: FloatArray, p: EyeParameters, per: float,
) -> SeenStem | None:  # fmt: skip
    """The longest trace that begins at the fruit, of points in the order of their distances."""
    begin = max(fruit.radius, fruit.half)
    about = np.flatnonzero((away > 0.9 * begin) & (away < begin + FIRST_GAP))
    if len(about) < 5:  # points: a choice
        return None
    chosen = about[np.linspace(0, len(about) - 1, min(len(about), TRIES)).astype(int)]
    view = fruit.center / np.linalg.norm(fruit.center)
    traces = [_traced(off, away, int(k), view, p) for k in chosen]
    lengths = np.array([away[trace[-1]].mean() for trace in traces]) - begin
    mine = np.concatenate(traces[int(np.argmax(np.minimum(lengths, p.stem_reach)))])
    length = float(away[mine].max())
    used = mine[away[mine] < begin + p.stem_reach]
    if length - begin < p.stem_least or len(used) < 5:
        return None
    first = off[used][away[used] > 0.7 * away[used].max()].mean(axis=0)  # the far end of the part
    way = first / np.linalg.norm(first)
    _, deviation = _line(off[used], views[used], deep[used], way, up, p, per)
    across = np.cross(view, way)
    aside = off[used] @ across / max(float(np.linalg.norm(across)), 1e-3)
    bow = 2.0 * float(np.sqrt(np.mean(aside**2))) / float(away[used].max())
    deviation = math.hypot(max(deviation, math.radians(p.stem_floor)), bow)
    return SeenStem(way, length, deviation, min(length - begin, p.stem_reach), bent=True)


def _traced(
    off: FloatArray, away: FloatArray, start: int, view: FloatArray, p: EyeParameters
) -> list[IntArray]:
    """The rows of the points of a stem, in pieces from a row ``start`` outwards.

    ``off``: (N, 3) of points from the fruit's centre, in the order of their distance ``away``.
    ``view``: (3,) unit, along the line of sight.
    """
    at, way, far = off[start], off[start] / away[start], float(away[start])
    pieces, missing = [np.array([start])], 0
    while missing <= GAP:
        low, high = np.searchsorted(away, (far, far + BIN))
        ahead = at + (missing + 1) * BIN * way
        rest = off[low:high] - ahead
        deep = rest @ view
        across = (rest**2).sum(axis=1) - deep**2
        close = (across < p.stem_aside**2) & (np.abs(deep) < 4.0 * p.stem_depth)
        if close.any():
            rows = low + np.flatnonzero(close)
            here = off[rows].mean(axis=0)
            step = here - at
            way = way + TURNING * (step / max(float(np.linalg.norm(step)), 1e-6) - way)
            way = way / np.linalg.norm(way)
            at, missing = here, 0
            pieces.append(rows)
        else:
            missing += 1
        far += BIN
    return pieces


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
    sharp = 1.0 / (p.stem_noise**2 * max(per, 1.0))
    # the inverse of the error, of p.stem_noise all around and of deep along the line of sight
    blunt = deep**2 / (p.stem_noise**2 + deep**2 * (x**2 + y**2))
    weights = sharp * np.array([1.0 - blunt * x**2, -blunt * x * y, 1.0 - blunt * y**2])
    sums = weights[[0, 1, 1, 2]] @ np.stack([np.ones(len(t)), t, t**2], axis=1)
    one, first, second = sums.T.reshape(3, 2, 2)
    pulls = np.stack([
        weights[0] * place[:, 0] + weights[1] * place[:, 1],
        weights[1] * place[:, 0] + weights[2] * place[:, 1],
    ])  # fmt: skip
    tilt = math.radians(p.tilt)
    before = np.diag([1.0 / p.stem_aside**2] * 2 + [1.0 / tilt**2] * 2)
    leaning = up @ axes / max(float(up @ way), STEEPEST)
    matrix = before + np.block([[one, first], [first, second]])
    vector = np.concatenate([pulls.sum(axis=1), pulls @ t])
    vector[2:] += leaning / tilt**2
    covariance = np.linalg.inv(matrix)
    turned = way + axes @ (covariance @ vector)[2:]
    deviation = math.sqrt(float(np.linalg.eigvalsh(covariance[2:, 2:])[-1]))
    return turned / np.linalg.norm(turned), deviation
