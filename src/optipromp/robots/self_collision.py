"""The pairs of spheres of a robot that must stay apart."""

from collections.abc import Collection, Mapping
from dataclasses import replace

import numpy as np

from optipromp.arrays import FloatArray, IntArray, frozen
from optipromp.robots.model import LeftOut, Robot

SAMPLED_POSTURES = 200
SORTING_POSTURES = 1_000  # at which pairs of fitted covers are looked at
MOSTLY = 0.95  # share of them at which covers touch, so that a check of them would say nothing
FAR = 0.05  # [m] that covers keep at all of them, so that a check of them is not worth its time
_CHUNK = 1_000_000


def with_self_pairs(
    robot: Robot,
    allowed: Collection[tuple[str, str]] = (),
    excess: Mapping[str, float] | None = None,
) -> Robot:
    """The robot with its self-collision pairs: spheres of links two or more joints apart.

    Left out are the pairs of links in ``allowed``, and those that overlap at every one of
    SAMPLED_POSTURES random configurations (fixed seed): such covers overlap whatever the arm does.
    ``excess`` holds, for each link whose cover was fitted, how far it reaches beyond the link [m];
    pairs of such links are left out by :func:`leave_out` too.
    """
    pairs = drop_always_touching(robot, candidate_pairs(robot, allowed))
    pairs, left_out = leave_out(robot, pairs, excess or {})
    return replace(robot, self_pairs=frozen(pairs, np.int64), left_out=left_out)


def leave_out(
    robot: Robot, pairs: IntArray, excess: Mapping[str, float]
) -> tuple[IntArray, tuple[LeftOut, ...]]:
    """``pairs`` (P, 2) without those that need not, or cannot, be kept apart; and which, and why.

    Looked at are pairs of links named in ``excess``. Left out are links whose covers touch at more
    than :data:`MOSTLY` of SORTING_POSTURES random configurations (fixed seed), or keep
    :data:`FAR` at all of them. Of links whose covers touch at home by less than they reach beyond
    the links, which may be free there, only the spheres that touch are left out; a home with a
    joint at its limit is where nobody chose to be, and says nothing.
    """
    link, names = robot.spheres.link, robot.link_names
    pairs = pairs[np.lexsort((link[pairs[:, 1]], link[pairs[:, 0]]))] if excess else pairs
    fitted = np.array([name in excess for name in names])[link[pairs]].all(axis=1)
    kept, looked = [pairs[~fitted]], pairs[fitted]
    if not len(looked):
        return pairs, ()
    links, first = np.unique(link[looked], axis=0, return_index=True)
    postures = _postures(robot, SORTING_POSTURES)
    nearest = np.array([np.minimum.reduceat(_gaps(robot, q, looked), first) for q in postures])
    chosen = ((robot.home > robot.lower) & (robot.home < robot.upper)).all()
    home = np.split(_gaps(robot, robot.home, looked), first[1:])
    out = []
    for (a, b), own, at_home, gaps in zip(
        links, np.split(looked, first[1:]), home, nearest.T, strict=True
    ):
        share = float((gaps < 0.0).mean())
        beyond = excess[names[a]] + excess[names[b]]
        if share > MOSTLY:
            why = f"covers touch at {100.0 * share:.0f} % of configurations"
        elif gaps.min() > FAR and at_home.min() > FAR:
            why = "never near"
        elif chosen and -beyond < at_home.min() < 0.0:
            touching = at_home < 0.0
            why = f"{touching.sum()} of {len(own)} pairs of spheres: only the covers touch, at home"
            kept.append(own[~touching])
        else:
            kept.append(own)
            continue
        out.append(LeftOut(names[a], names[b], why))
    return np.concatenate(kept), tuple(out)


def _postures(robot: Robot, count: int) -> FloatArray:
    """Random configurations (count, n) within the limits; continuous joints turn once."""
    rng = np.random.default_rng(0)
    low = np.where(np.isfinite(robot.lower), robot.lower, -np.pi)
    high = np.where(np.isfinite(robot.upper), robot.upper, np.pi)
    postures: FloatArray = rng.uniform(low, high, size=(count, robot.n_joints))
    return postures


def candidate_pairs(robot: Robot, allowed: Collection[tuple[str, str]] = ()) -> IntArray:
    """Sphere index pairs (P, 2) of links two or more joints apart and not ``allowed`` to touch."""
    segment, link = robot.spheres.segment, robot.spheres.link
    index = {name: i for i, name in enumerate(robot.link_names)}
    names = len(index)
    codes = {min(index[a], index[b]) * names + max(index[a], index[b]) for a, b in allowed}
    first, second = np.nonzero(np.triu(np.abs(segment[:, None] - segment) >= 2, 1))
    code = np.minimum(link[first], link[second]) * names + np.maximum(link[first], link[second])
    free = ~np.isin(code, list(codes))
    return np.column_stack([first[free], second[free]])


def drop_always_touching(robot: Robot, pairs: IntArray) -> IntArray:
    """``pairs`` (P, 2) without those of links that overlap at every sampled configuration."""
    if not len(pairs):
        return pairs
    link = robot.spheres.link
    code = link[pairs[:, 0]] * len(robot.link_names) + link[pairs[:, 1]]
    kept = np.arange(len(pairs))  # pairs of links that have touched in every sample so far
    for q in _postures(robot, SAMPLED_POSTURES):
        touched = np.zeros(len(robot.link_names) ** 2, dtype=bool)
        touched[code[kept][_gaps(robot, q, pairs[kept]) < 0.0]] = True
        kept = kept[touched[code[kept]]]
        if not len(kept):
            return pairs
    return np.asarray(pairs[~touched[code]])


def _gaps(robot: Robot, q: FloatArray, pairs: IntArray) -> FloatArray:
    """Surface distance (P,) [m] of each pair at ``q`` (n,)."""
    centers, radius = robot.sphere_centers(q), robot.spheres.radius
    out = np.empty(len(pairs))
    for start in range(0, len(pairs), _CHUNK):
        i, j = pairs[start : start + _CHUNK].T
        reach = radius[i] + radius[j]
        out[start : start + _CHUNK] = np.linalg.norm(centers[i] - centers[j], axis=1) - reach
    return out
