"""Starts of the optimisation that lead round obstacles, on a way found by :mod:`tree`."""

from collections.abc import Iterator

import numpy as np

from optipromp.core.arrays import FloatArray
from optipromp.core.budget import Budget
from optipromp.core.planning import tree
from optipromp.core.planning.follow import Start, Waypoints, free_count, within_limits
from optipromp.core.planning.goals import clearance
from optipromp.core.planning.options import Searched
from optipromp.core.planning.parameters import TREE, WAYPOINT
from optipromp.core.planning.primitive import led_through
from optipromp.core.planning.task import Task
from optipromp.core.promp.conditioning import condition
from optipromp.core.promp.model import ProMP
from optipromp.core.promp.points import JointPoint


def free_starts(
    task: Task,
    options: Searched,
    promp: ProMP,
    goals: FloatArray,
    rng: np.random.Generator,
    budget: Budget,
) -> Iterator[Start]:
    """Starts of a reach without a tool path, to goal configurations ``goals`` (m, n).

    First comes the primitive conditioned on start and goal, the nearest goal first, where it does
    not go deep into obstacles. Ways round the obstacles follow, then the deep primitives.
    """
    order = np.argsort(np.abs(goals - task.start).max(axis=1), kind="stable")
    deep = []
    for goal in goals[order]:
        count = options.waypoints or free_count(goal - task.start, options.max_step)
        q = led_through(promp, task.start, np.array([1.0]), goal[None], np.zeros(1), count)
        start = Start(q, q, Waypoints(count, count - 1), None)
        if clearance(task, q).min() < -TREE.deep:
            deep.append(start)
        else:
            yield start
    ends = [JointPoint(0.0, task.start), JointPoint(1.0, goals[order[0]])]
    shown = condition(promp, ends).sample(rng, TREE.shown, WAYPOINT.fewest)
    for _ in range(TREE.rounds):
        corners = tree.way(task, goals, shown.reshape(-1, shown.shape[2]), rng, budget)
        if corners is None:
            break
        q = along(corners, options.waypoints or within_limits(way_count(corners, options) + 1))
        yield Start(q, q, Waypoints(len(q), len(q) - 1), None)
    yield from deep


def led_round(
    task: Task, start: Start, options: Searched, rng: np.random.Generator, budget: Budget
) -> Iterator[Start]:
    """The start to the same tool path whose reach goes round obstacles, if there is a way."""
    first, last = start.waypoints.first, start.waypoints.count - 1
    corners = None
    if first:
        corners = tree.way(
            task, start.followed[first : first + 1], start.primitive[:first], rng, budget
        )
    if corners is None:
        return
    reach = first
    if not options.waypoints:
        most = WAYPOINT.most - (last - first)
        reach = max(int(min(way_count(corners, options), most)), WAYPOINT.fewest_reach)
    q = np.vstack([along(corners, reach + 1, stop=False)[:-1], start.followed[first:]])
    rows = np.concatenate(
        [np.linspace(0, first, reach, endpoint=False), np.arange(first, last + 1)]
    )
    shown = np.stack([np.interp(rows, np.arange(last + 1), one) for one in start.primitive.T], 1)
    yield Start(shown, q, Waypoints(len(q), reach), start.path)


def way_count(corners: FloatArray, options: Searched) -> float:
    """Number of steps along a way (k, n), such that none is over ``max_step``."""
    turns = float(np.abs(np.diff(corners, axis=0)).max(axis=1).sum())
    return float(np.ceil(turns / (1.0 - TREE.ramp) / (WAYPOINT.share * options.max_step)))


def along(corners: FloatArray, count: int, *, stop: bool = True) -> FloatArray:
    """Waypoints (count, n) along corners (k, n), from rest, and with ``stop`` to rest.

    Between the ends, the joint that turns most on an edge has the same speed on all edges.
    """
    u = np.linspace(0.0, 1.0, count)
    done = _started(u)
    if stop:
        done = np.where(u < 0.5, done, 1.0 - TREE.ramp - _started(1.0 - u))
    turned = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(corners, axis=0)).max(axis=1))])
    at = done / done[-1] * turned[-1]
    return np.stack([np.interp(at, turned, one) for one in corners.T], axis=1)


def _started(u: FloatArray) -> FloatArray:
    """Distance (m,) at times ``u`` (m,) from rest; the speed rises smoothly to 1."""
    x = np.minimum(u / TREE.ramp, 1.0)
    return np.asarray(TREE.ramp * (x**3 - 0.5 * x**4) + np.maximum(u - TREE.ramp, 0.0))
