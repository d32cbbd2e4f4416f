"""The pairs of spheres of a robot that must stay apart, by their links and by samples."""

from collections.abc import Collection, Iterable
from dataclasses import replace

import numpy as np

from optipromp.core.arrays import FloatArray, IntArray, frozen
from optipromp.core.robots.kernels import distances_between
from optipromp.core.robots.model import Robot

SAMPLED_POSTURES = 200  # configurations, chosen: links that overlap at all of them always do


def random_postures(robot: Robot, count: int) -> FloatArray:
    """Random configurations (count, n) within the limits; continuous joints turn once."""
    rng = np.random.default_rng(0)
    low = np.where(np.isfinite(robot.lower), robot.lower, -np.pi)
    high = np.where(np.isfinite(robot.upper), robot.upper, np.pi)
    return np.asarray(rng.uniform(low, high, size=(count, robot.n_joints)))


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


def letting_touch(robot: Robot, pairs: Iterable[tuple[str, str]]) -> Robot:
    """``robot`` without the pairs of spheres of links that may touch, by their names."""
    link, index = robot.spheres.link, {name: i for i, name in enumerate(robot.link_names)}
    both = np.sort(link[robot.self_pairs], axis=1)
    free = np.ones(len(both), dtype=np.bool_)
    for one, other in pairs:
        if one in index and other in index:
            low, high = sorted((index[one], index[other]))
            free &= (both[:, 0] != low) | (both[:, 1] != high)
    if free.all():
        return robot
    pairs, slack = frozen(robot.self_pairs[free], np.int64), frozen(robot.self_slack[free])
    return replace(robot, self_pairs=pairs, self_slack=slack)


def drop_always_touching(robot: Robot, pairs: IntArray) -> IntArray:
    """``pairs`` (P, 2) without those of links that overlap at every sampled configuration."""
    if not len(pairs):
        return pairs
    link = robot.spheres.link
    code = link[pairs[:, 0]] * len(robot.link_names) + link[pairs[:, 1]]
    kept = np.arange(len(pairs))  # pairs of links that have touched in every sample so far
    for q in random_postures(robot, SAMPLED_POSTURES):
        touched = np.zeros(len(robot.link_names) ** 2, dtype=bool)
        touched[code[kept][_gaps(robot, q, pairs[kept]) < 0.0]] = True
        kept = kept[touched[code[kept]]]
        if not len(kept):
            return pairs
    return np.asarray(pairs[~touched[code]])


def _gaps(robot: Robot, q: FloatArray, pairs: IntArray) -> FloatArray:
    """Surface distance (P,) [m] of each pair at ``q`` (n,)."""
    centers, radius = robot.sphere_centers(q[None]), robot.spheres.radius
    apart, (i, j) = np.empty((1, len(pairs))), np.ascontiguousarray(pairs.T)
    distances_between(centers, centers, i, j, apart)
    return np.asarray(apart[0] - (radius[i] + radius[j]))
