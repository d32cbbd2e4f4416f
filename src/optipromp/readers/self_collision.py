"""The pairs of spheres of a robot that must stay apart, found by the surfaces of its links."""

from collections.abc import Callable, Collection
from dataclasses import replace
from itertools import product

import numpy as np

from optipromp.core.arrays import BoolArray, FloatArray, IntArray, frozen, lengths
from optipromp.core.robots.description import LeftOut
from optipromp.core.robots.kernels import PRISMATIC, distances_between
from optipromp.core.robots.model import Robot
from optipromp.core.robots.self_collision import (
    CHUNK,
    candidate_pairs,
    drop_always_touching,
    random_postures,
)
from optipromp.readers.surfaces import Parts

SORTING_POSTURES = 20_000  # configurations, chosen: for the slack of the final covers
TRYING_POSTURES = 4_000  # configurations, chosen: for the slack while covers are made finer
SHARED = 2_000  # configurations, chosen: for the search for loose spheres
SHARE = 0.010  # chosen: share of them above which a sphere is loose
WRONG = 0.030  # chosen: share of them below which no sphere is loose
ROUNDS = 2  # of halving, at most, chosen: UR10 needs 2
MOSTLY = 0.95  # chosen: share of configurations; above it a check of two links says nothing
OFTEN = 30  # overlaps among SORTING_POSTURES, chosen: the fewest from which a slack is estimated
KEPT = 0.0005  # [m] chosen: subtracted from the slack, as parts are known by corners (DIRECTIONS)
TAIL = 3.0  # chosen: mean gaps of the sampled distances that are subtracted from the slack
FAR = 0.05  # [m] chosen: distance of two covers above which a check is not worth its time
ALONG = 0.9999  # chosen: least cosine between slides of one direction (0.8 degrees)
MOST_LINKS = 3000  # pairs of links, chosen: 78 links have as many; 3,000 links would take hours
_GAPS_AT_ONCE = 10_000_000  # distances in one array, chosen: 80 MB

Found = tuple[IntArray, FloatArray, tuple[LeftOut, ...]]
Finer = Callable[[Robot, IntArray], tuple[Robot, FloatArray]]


def with_self_pairs(
    robot: Robot, allowed: Collection[tuple[str, str]], parts: FloatArray, finer: Finer
) -> Robot:
    """The robot with its self-collision pairs: spheres of links two or more joints apart.

    ``robot``: without pairs. ``allowed``: pairs of links that are left out. ``parts``: (c, 4)
    surfaces of the links whose covers were fitted; see :class:`Parts`. By them :func:`sorted_out`
    gives pairs of such links a slack, or leaves them out. ``finer``: halves the spheres of some
    indices; returns the robot and its parts. Called with the :func:`loose_spheres` in at most
    :data:`ROUNDS` rounds.
    """
    for _ in range(ROUNDS if len(parts) else 0):
        tried = _sorted(robot, allowed, parts, TRYING_POSTURES)
        loose = loose_spheres(tried, parts)
        if not len(loose):
            break
        robot, parts = finer(robot, loose)
    return _sorted(robot, allowed, parts, SORTING_POSTURES)


def _sorted(
    robot: Robot, allowed: Collection[tuple[str, str]], parts: FloatArray, count: int
) -> Robot:
    pairs = candidate_pairs(robot, allowed)
    pairs, slack, out = sorted_out(robot, pairs, list(robot.excess), parts, count)
    return replace(
        robot, self_pairs=frozen(pairs, np.int64), self_slack=frozen(slack), left_out=out
    )


def loose_spheres(robot: Robot, parts: FloatArray) -> IntArray:
    """Indices of the spheres that stop the arm although no surfaces touch.

    A false alarm is a configuration at which spheres overlap by more than their slack, but the
    parts (see :class:`Parts`) of none of these pairs meet. A sphere is loose if it takes part in
    false alarms at more than :data:`SHARE` of :data:`SHARED` random configurations. There are none
    if fewer than :data:`WRONG` of the configurations are false alarms. A sphere that does not move
    is loose only if some of its part lies outside it.
    """
    surfaces, count = Parts(len(robot.spheres.radius), parts), np.zeros(len(robot.spheres.radius))
    wrong = 0
    parts_of = 1 + SHARED * max(len(robot.self_pairs), 1) // _GAPS_AT_ONCE
    for postures in np.array_split(random_postures(robot, SHARED), max(10, parts_of)):
        row, pair = np.nonzero(robot.self_gaps(postures) < 0.0)
        pairs = robot.self_pairs[pair]
        meet = surfaces.touch(robot, robot.segment_frames(postures), row, pairs)
        apart = ~np.isin(row, row[meet])
        short = np.column_stack([np.repeat(row[apart], 2), pairs[apart].ravel()])
        np.add.at(count, np.unique(short, axis=0)[:, 1], 1.0)
        wrong += len(np.unique(row[apart]))
    if wrong < WRONG * SHARED:
        return np.zeros(0, dtype=np.int64)
    able = surfaces.known & ((robot.spheres.segment >= 0) | (surfaces.beyond(robot) > 0.0))
    return np.flatnonzero((count > SHARE * SHARED) & able)


def sorted_out(
    robot: Robot, pairs: IntArray, fitted: Collection[str], given: FloatArray, count: int
) -> Found:
    """The pairs of spheres to keep apart, their slack [m], and the links that are left out.

    Pairs of links named in ``fitted`` are examined at home and at ``count`` random configurations
    (fixed seed). The slack of two spheres is the largest overlap at which their parts stay apart:

    - A sphere that leaves some of its part outside counts as larger by that distance; the slack of
      its pairs may be negative.
    - The samples may miss the largest distance at which parts meet. So the slack is reduced by
      :data:`TAIL` mean gaps between the n sampled distances below it, and by :data:`KEPT`.
    - A pair of spheres that overlaps :data:`OFTEN` while its parts never meet is left out.
    - Two links are left out if pairs overlap by more than their slack at more than :data:`MOSTLY`
      of the configurations, or if their covers keep :data:`FAR` at all of them.
    - If pairs overlap by more than their slack at home, where their parts do not meet, their slack
      is raised to what home needs. If home has a joint at its limit, nobody chose it: then only if
      no configuration at which parts meet is accepted for it.

    Pairs of other links are left out if they overlap at every one of SAMPLED_POSTURES random
    configurations. Of more than :data:`MOST_LINKS` pairs of links none is examined.

    ``robot``: with its spheres. ``pairs``: (P, 2) of spheres. ``fitted``: names of links.
    ``given``: (c, 4) the parts; see :class:`Parts`. ``count``: of configurations.
    """
    link, names = robot.spheres.link, robot.link_names
    pairs = pairs[np.lexsort((link[pairs[:, 1]], link[pairs[:, 0]]))] if fitted else pairs
    looked = np.isin(link[pairs], [names.index(name) for name in fitted]).all(axis=1)
    kept = [drop_always_touching(robot, pairs[~looked])]
    slacks = [np.zeros(len(kept[0]))]
    pairs, out = pairs[looked], list[LeftOut]()
    if not len(pairs):
        return kept[0], slacks[0], ()
    links, first = np.unique(link[pairs], axis=0, return_index=True)
    if len(links) > MOST_LINKS:
        pairs = np.concatenate([*kept, drop_always_touching(robot, pairs)])
        return pairs, np.zeros(len(pairs)), ()
    sample = _Sample(robot, Parts(len(link), given), count)
    for (a, b), of_links in zip(links, np.split(pairs, first[1:]), strict=True):
        slack, share, nearest = sample.slack(of_links)
        meet = np.isfinite(slack)
        if nearest > FAR:
            why = "never near"
        elif share > MOSTLY:
            why = f"touch at {100.0 * share:.0f} % of configurations"
        else:
            kept.append(of_links[meet])
            slacks.append(slack[meet])
            if meet.all():
                continue
            why = f"{(~meet).sum()} of {len(of_links)} pairs of spheres: only the covers touch"
        out.append(LeftOut(names[a], names[b], why))
    return np.concatenate(kept), np.concatenate(slacks), tuple(out)


class _Sample:
    """Home and random configurations of a robot, with the frames of its segments."""

    def __init__(self, robot: Robot, parts: Parts, count: int) -> None:
        self.robot, self.parts = robot, parts
        postures = np.vstack([robot.home, random_postures(robot, count)])
        self.frames = robot.segment_frames(postures)
        self.balls = dict[tuple[int, int], tuple[FloatArray, float]]()
        self.radius = robot.spheres.radius + parts.beyond(robot)
        self.chosen = ((robot.home > robot.lower) & (robot.home < robot.upper)).all()

    def placed(
        self, link: IntArray, points: FloatArray, rows: slice | IntArray = slice(None)
    ) -> FloatArray:
        """World positions (m, k, 3) [m] at configurations ``rows`` of ``points`` (k, 3), which lie
        on the segment of the spheres ``link`` of one link."""
        segment = int(self.robot.spheres.segment[link[0]])
        origins, rotations = self.frames[0][rows], self.frames[1][rows]
        if segment < 0:
            return np.tile(points, (len(origins), 1, 1))
        turned = np.matmul(points, rotations[:, segment].transpose(0, 2, 1))
        placed: FloatArray = turned + origins[:, segment, None]
        return placed

    def slack(self, pairs: IntArray) -> tuple[FloatArray, float, float]:
        """The slack (P,) [m] of pairs (P, 2) of spheres of two links, infinite where their parts
        never meet; the share of configurations at which a pair overlaps by more than its slack; and
        the least gap of all pairs [m]."""
        centers, radius = self.robot.spheres.center, self.radius
        first, i = np.unique(pairs[:, 0], return_inverse=True)
        second, j = np.unique(pairs[:, 1], return_inverse=True)
        full = radius[pairs].sum(axis=1)
        times, least = np.zeros(len(pairs), np.int64), np.inf
        step, overlaps = max(1, CHUNK // len(pairs)), []
        near = self._near(first, second)
        for start in range(0, max(len(near), 1), step):
            rows = near[start : start + step]
            one = self.placed(first, centers[first], rows)
            other = self.placed(second, centers[second], rows)
            apart = np.empty((len(one), len(pairs)))
            distances_between(one, other, i, j, apart)
            least = min(least, float((apart - full).min(initial=np.inf)))
            row, pair = np.nonzero(apart < full)
            times += np.bincount(pair, minlength=len(pairs))
            overlaps.append((rows[row], pair, apart[row, pair]))
        row, pair, apart = map(np.concatenate, zip(*overlaps, strict=True))
        order = np.lexsort((-apart, pair))
        reach = self._reach(pairs, row[order], pair[order], apart[order])
        often = OFTEN * len(self.frames[0]) / SORTING_POSTURES
        known = self.parts.known[pairs].all(axis=1) & (times >= often)
        deep, nearest = apart <= reach[pair], full.copy()
        np.minimum.at(nearest, pair, apart)
        unseen = TAIL * (reach - nearest) / np.bincount(pair[deep], minlength=len(pairs)).clip(1)
        slack = np.where(known, np.maximum(full - reach - unseen - KEPT, 0.0), 0.0)
        slack[known & (reach == 0.0)] = np.inf
        if known.any() and not reach.any():  # the links never touch
            slack[:] = np.inf
        short = apart < (full - slack)[pair]
        home = np.flatnonzero(short & (row == 0))
        if len(home) and not self._touch(row[home], pairs[pair[home]]).any():
            freed = slack.copy()
            freed[pair[home]] = full[pair[home]] - apart[home] + KEPT
            still = apart < (full - freed)[pair]
            lost = np.flatnonzero(short & ~still & ~np.isin(row, row[still]))
            if self.chosen or not self._touch(row[lost], pairs[pair[lost]]).any():
                slack = freed
        short = np.unique(row[short])
        slack -= full - self.robot.spheres.radius[pairs].sum(axis=1)
        return slack, len(short) / len(self.frames[0]), least

    def _near(self, first: IntArray, second: IntArray) -> IntArray:
        """The configurations at which balls about spheres of two links are within FAR."""
        (one, reach), (other, further) = self._ball(first), self._ball(second)
        return np.flatnonzero(lengths(one - other) < FAR + reach + further)

    def _ball(self, spheres: IntArray) -> tuple[FloatArray, float]:
        """World centres (m, 3) and radius [m] of a ball that encloses ``spheres`` of one link."""
        key = int(self.robot.spheres.link[spheres[0]]), len(spheres)
        if key not in self.balls:
            center, radius = self.robot.spheres.center[spheres], self.radius[spheres]
            middle = center.mean(axis=0)
            reach = float((lengths(center - middle) + radius).max())
            self.balls[key] = self.placed(spheres, middle[None])[:, 0], reach
        return self.balls[key]

    def _touch(self, rows: IntArray, pairs: IntArray) -> BoolArray:
        return self.parts.touch(self.robot, self.frames, rows, pairs)

    def _reach(
        self, pairs: IntArray, row: IntArray, pair: IntArray, apart: FloatArray
    ) -> FloatArray:
        """The largest distance (P,) [m] between the centres of each pair at which its parts meet;
        0 if they never do. Overlaps, by pair and the largest distance first: the configuration
        ``row``, the index ``pair`` and the distance ``apart`` [m]."""
        reach, count = np.zeros(len(pairs)), 8
        at, end = (np.searchsorted(pair, np.arange(len(pairs)), side) for side in ("left", "right"))
        while len(open_ := np.flatnonzero((reach == 0.0) & (at < end))):
            taken = np.minimum(count, end[open_] - at[open_])
            before = np.cumsum(taken) - taken
            index = np.arange(taken.sum()) + np.repeat(at[open_] - before, taken)
            meets = self._touch(row[index], pairs[pair[index]])
            np.maximum.at(reach, pair[index[meets]], apart[index[meets]])
            at[open_] += taken
            count *= 2
        return reach


def telescopes(robot: Robot) -> list[tuple[str, str]]:
    """Pairs of links that slide past one another along one direction, as tubes of a telescope.

    Covers of tubes within tubes overlap, and so do the hulls of their parts; the tubes do not.
    """
    kin, spheres = robot.kinematics, robot.spheres
    links, first = np.unique(spheres.link, return_index=True)
    of_segment = dict[int, list[str]]()
    for link, segment in zip(links, spheres.segment[first], strict=True):
        of_segment.setdefault(int(segment), []).append(robot.link_names[link])
    ways = np.einsum("sij,sj->si", kin.rotation, kin.axis)  # in the frame of the segment before
    slides = kin.kind == PRISMATIC
    alike = np.abs(np.einsum("si,si->s", ways[1:], kin.axis[:-1])) > ALONG
    on = np.append(False, slides[1:] & slides[:-1] & alike)  # with the slide before
    out, first = [], np.maximum.accumulate(np.where(on, 0, np.arange(len(on)))) - 1
    for s in np.flatnonzero(on):
        for other in range(first[s], s - 1):
            out += list(product(of_segment.get(other, ()), of_segment.get(int(s), ())))
    return out
