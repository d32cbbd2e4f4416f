"""The pairs of spheres of a robot that must stay apart."""

import hashlib
from collections.abc import Collection, Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np

from optipromp.arrays import FloatArray, IntArray, frozen
from optipromp.errors import InvalidRequestError
from optipromp.files import cache_folder, npz, read_npz, write_atomically
from optipromp.robots.model import LeftOut, Robot
from optipromp.robots.surfaces import Neighbourhood

SAMPLED_POSTURES = 200
SORTING_POSTURES = 1_000  # at which pairs of fitted covers are looked at
MOSTLY = 0.95  # share of them at which covers touch, so that a check of them would say nothing
TRIED = 100  # of those at which covers touch, at most: do the surfaces?
OFTEN = 5  # times that spheres touch there, at least, while the surfaces never do
FAR = 0.05  # [m] that covers keep at all of them, so that a check of them is not worth its time
_PAIRS_VERSION = 1  # part of the cache key: raise it when the same robot gets other pairs
_CHUNK = 1_000_000


def with_self_pairs(
    robot: Robot,
    allowed: Collection[tuple[str, str]] = (),
    excess: Mapping[str, float] | None = None,
    surfaces: Mapping[str, FloatArray] | None = None,
) -> Robot:
    """The robot with its self-collision pairs: spheres of links two or more joints apart.

    Left out are the pairs of links in ``allowed``, and those that overlap at every one of
    SAMPLED_POSTURES random configurations (fixed seed): such covers overlap whatever the arm does.
    ``excess`` holds, for each link whose cover was fitted, how far it reaches beyond the link [m];
    pairs of such links are left out by :func:`leave_out` too. ``surfaces`` (c, 3) are those of
    :mod:`optipromp.robots.surfaces`, by link, in the frames of the segments.
    """
    excess, surfaces = excess or {}, surfaces or {}
    file = _cache_file(robot, allowed, excess, surfaces) if surfaces else None
    found = None if file is None else _load(file)
    if found is None:
        pairs = drop_always_touching(robot, candidate_pairs(robot, allowed))
        found = leave_out(robot, pairs, excess, surfaces)
        if file is not None:
            why = np.array(found[1], dtype=np.str_).reshape(-1, 3)
            with suppress(InvalidRequestError):  # the next run finds them again
                write_atomically(file, npz({"pairs": found[0], "left_out": why}))
    return replace(robot, self_pairs=frozen(found[0], np.int64), left_out=found[1])


Found = tuple[IntArray, tuple[LeftOut, ...]]


def _cache_file(
    robot: Robot,
    allowed: Collection[tuple[str, str]],
    excess: Mapping[str, float],
    surfaces: Mapping[str, FloatArray],
) -> Path | None:
    """The file that holds the pairs of a robot of these arrays."""
    folder = cache_folder()
    if folder is None:
        return None
    told = robot.link_names, sorted(allowed), sorted(excess.items())
    digest = hashlib.sha256(f"{_PAIRS_VERSION} {told}".encode())
    arrays = robot.lower, robot.upper, robot.home, *robot.kinematics, *robot.spheres
    for array in (*arrays, *surfaces.values()):
        digest.update(np.ascontiguousarray(array).tobytes())
    return folder / "pairs" / f"{digest.hexdigest()}.npz"


def _load(file: Path) -> Found | None:
    """What a cache file holds; None where there is none, or none that can be used."""
    try:
        data = read_npz(file)
        pairs = np.asarray(data["pairs"], dtype=np.int64).reshape(-1, 2)
        return pairs, tuple(LeftOut(*map(str, row)) for row in data["left_out"])
    except (InvalidRequestError, KeyError, TypeError, ValueError):
        return None


def leave_out(
    robot: Robot,
    pairs: IntArray,
    excess: Mapping[str, float],
    surfaces: Mapping[str, FloatArray],
) -> Found:
    """``pairs`` (P, 2) without those that need not, or cannot, be kept apart; and which, and why.

    Looked at are pairs of links named in ``excess``. Left out are links whose covers touch at more
    than :data:`MOSTLY` of SORTING_POSTURES random configurations (fixed seed), or keep
    :data:`FAR` at all of them. Of links whose covers touch at home by less than they reach beyond
    the links, which may be free there, only the spheres that touch are left out; a home with a
    joint at its limit is where nobody chose to be, and says nothing. The spheres that touch only
    where the surfaces of the links are apart are left out too; see :func:`only_covers`.
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
        elif len(empty := only_covers(robot, own, postures[gaps < 0.0][:TRIED], surfaces)):
            why = f"{len(empty)} of {len(own)} pairs of spheres: only the covers touch"
            kept.append(own[~np.isin(np.arange(len(own)), empty)])
        elif chosen and -beyond < at_home.min() < 0.0:
            touching = at_home < 0.0
            why = f"{touching.sum()} of {len(own)} pairs of spheres: only the covers touch, at home"
            kept.append(own[~touching])
        else:
            kept.append(own)
            continue
        out.append(LeftOut(names[a], names[b], why))
    return np.concatenate(kept), tuple(out)


def only_covers(
    robot: Robot, pairs: IntArray, postures: FloatArray, surfaces: Mapping[str, FloatArray]
) -> IntArray:
    """Which pairs of spheres (P, 2) of two links touch while the links themselves never do.

    Indices of those that touch at :data:`OFTEN` of ``postures`` (m, n) or more, and at none where
    the surfaces of the links touch. Where no surface touches, all pairs.
    """

    names = [robot.link_names[robot.spheres.link[sphere]] for sphere in pairs[0]]
    if len(postures) < OFTEN or not all(name in surfaces for name in names):
        return np.zeros(0, dtype=np.int64)
    origins, rotations = robot.segment_frames(postures)
    fixed = np.tile(np.eye(3), (len(postures), 1, 1)), np.zeros((len(postures), 3))
    (turn, at), (other, where) = (
        fixed if s < 0 else (rotations[:, s], origins[:, s])
        for s in robot.spheres.segment[pairs[0]]
    )
    back = np.moveaxis(other, 1, 2)
    shifts = np.einsum("mij,mj->mi", back, at - where)
    real = Neighbourhood(surfaces[names[1]]).touched(surfaces[names[0]], back @ turn, shifts)
    if not real.any():
        return np.arange(len(pairs))
    touch = np.array([_gaps(robot, q, pairs) < 0.0 for q in postures])
    return np.flatnonzero((touch.sum(axis=0) >= OFTEN) & ~touch[real].any(axis=0))


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
