"""A way round obstacles: two trees of configurations that grow towards each other (RRT-Connect).

One tree grows from the start, the other from all goal configurations (Kuffner and LaValle, 2000).
Shortcuts then shorten the way. The way is a start of the optimisation, which rounds its corners.
Its edges are checked for collisions at places, not between them.
"""

import numpy as np

from optipromp.core.arrays import FloatArray, IntArray, lengths
from optipromp.core.budget import Budget
from optipromp.core.compiled import inner
from optipromp.core.planning.collision import Collider, collider, open_edge
from optipromp.core.planning.parameters import TREE
from optipromp.core.planning.task import Task
from optipromp.core.robots.model import Robot

BATCH = 500  # samples, after which the budget is asked


def way(
    task: Task,
    goals: FloatArray,
    seeds: FloatArray,
    rng: np.random.Generator,
    budget: Budget | None = None,
) -> FloatArray | None:
    """Corners (k, n) of a way from the start to one of the goals; None where none was found.

    Objects to push are obstacles of the last link and the tool too, unless that leaves no way.

    ``task``: the arm, its start and its obstacles. ``goals``: (m, n) configurations, free.
    ``seeds``: (s, n) configurations, near which a share of the samples is drawn; may be empty.
    ``rng``: of the samples. ``budget``: asked before each batch of samples.
    """
    around = task.surroundings
    for pushed in sorted({around.shared, len(around.dynamic.kind)}, reverse=True):
        body = collider(task, pushed)
        best: FloatArray | None = None
        for _ in range(TREE.ways):
            corners = _grown(body, task.robot, task.start, goals, seeds, rng, budget)
            if corners is None:
                break
            corners = _shortened(body, corners, rng)
            if best is None or _length(corners) < _length(best):
                best = corners
        if best is not None:
            return best
    return None


def _length(corners: FloatArray) -> float:
    return float(lengths(np.diff(corners, axis=0)).sum())


def _grown(
    body: Collider, robot: Robot, start: FloatArray, goals: FloatArray, seeds: FloatArray,
    rng: np.random.Generator, budget: Budget | None,
) -> FloatArray | None:  # fmt: skip
    low = np.where(np.isinf(robot.lower), start - np.pi, robot.lower)
    high = np.where(np.isinf(robot.upper), start + np.pi, robot.upper)
    room, n = TREE.samples, robot.n_joints
    nodes, parent = np.empty((2, room, n)), np.full((2, room), -1, dtype=np.int64)
    nodes[0, 0], nodes[1, : len(goals)] = start, goals
    count = np.array([1, len(goals)])
    for _ in range(0, TREE.samples, BATCH):
        if budget is not None and budget.spent():
            return None
        samples = rng.uniform(low, high, (BATCH, n))
        if len(seeds):
            near = rng.random(BATCH) < TREE.seeded
            picked = seeds[rng.integers(len(seeds), size=int(near.sum()))]
            samples[near] = picked + TREE.spread * rng.standard_normal(picked.shape)
            samples = np.clip(samples, low, high)
        if grow(body, samples, nodes, parent, count, TREE.reach, np.empty(n)):
            first = _back(nodes[0], parent[0], count[0] - 1)[::-1]
            return np.vstack([first, _back(nodes[1], parent[1], count[1] - 1)[1:]])
    return None


def _back(nodes: FloatArray, parent: IntArray, index: int) -> FloatArray:
    """Nodes (k, n) from ``index`` back to the root of its tree."""
    out = []
    while index >= 0:
        out.append(nodes[index])
        index = parent[index]
    return np.array(out)


def _shortened(body: Collider, corners: FloatArray, rng: np.random.Generator) -> FloatArray:
    room = np.empty((len(corners) + 2 * TREE.shortcuts, corners.shape[1]))
    room[: len(corners)] = corners
    places, along = rng.random((TREE.shortcuts, 2)), np.empty(len(room))
    left = shorten(body, room, len(corners), places, along, *np.empty((3, corners.shape[1])))
    return room[:left].copy()


@inner
def nearest(nodes, count, q):
    """Index of the node nearest to ``q`` (n,), and the square of its distance."""
    best, least = 0, np.inf
    for i in range(count):
        squared = 0.0
        for j in range(q.shape[0]):
            squared += (nodes[i, j] - q[j]) ** 2
        if squared < least:
            best, least = i, squared
    return best, least


@inner
def extend(body, nodes, parent, count, tree, q, reach, room):
    """Grow a tree towards ``q`` (n,) by ``reach`` at most: 2: at ``q``, 1: nearer, 0: blocked."""
    if count[tree] >= nodes.shape[1]:
        return 0
    near, squared = nearest(nodes[tree], count[tree], q)
    share = min(1.0, reach / np.sqrt(max(squared, 1e-18)))
    new = nodes[tree, count[tree]]
    for j in range(q.shape[0]):
        new[j] = nodes[tree, near, j] + share * (q[j] - nodes[tree, near, j])
    if not open_edge(body, nodes[tree, near], new, room):
        return 0
    parent[tree, count[tree]] = near
    count[tree] += 1
    return 2 if share == 1.0 else 1


@inner
def grow(body, samples, nodes, parent, count, reach, room):
    """Grow both trees by samples (s, n), the smaller one first, until they meet.

    ``nodes`` (2, N, n), ``parent`` (2, N) and ``count`` (2,) change in place. Returns whether the
    trees met; then their last nodes are the same. ``room`` (n,) is a work array.
    """
    for s in range(samples.shape[0]):
        one = 0 if count[0] <= count[1] else 1
        if extend(body, nodes, parent, count, one, samples[s], reach, room) == 0:
            continue
        new, state = nodes[one, count[one] - 1], 1
        while state == 1:
            state = extend(body, nodes, parent, count, 1 - one, new, reach, room)
        if state == 2:
            return True
    return False


@inner
def shorten(body, path, count, places, along, a, b, room):
    """Replace parts of a path (the first ``count`` rows) by straight lines between two places.

    ``places`` (p, 2) are shares of the path's length. Work arrays are ``along``, with as many rows
    as ``path``, and ``a``, ``b`` and ``room`` (n,). Returns the new number of rows.
    """
    n = path.shape[1]
    for k in range(places.shape[0]):
        along[0] = 0.0
        for i in range(1, count):
            squared = 0.0
            for j in range(n):
                squared += (path[i, j] - path[i - 1, j]) ** 2
            along[i] = along[i - 1] + np.sqrt(squared)
        low = min(places[k, 0], places[k, 1]) * along[count - 1]
        high = max(places[k, 0], places[k, 1]) * along[count - 1]
        i, i2 = 0, count - 2  # pieces that hold the two places
        while i < count - 2 and along[i + 1] < low:
            i += 1
        while i2 > i and along[i2] > high:
            i2 -= 1
        if i2 == i:
            continue
        u = (low - along[i]) / max(along[i + 1] - along[i], 1e-12)
        v = (high - along[i2]) / max(along[i2 + 1] - along[i2], 1e-12)
        straight = 0.0
        for j in range(n):
            a[j] = path[i, j] + u * (path[i + 1, j] - path[i, j])
            b[j] = path[i2, j] + v * (path[i2 + 1, j] - path[i2, j])
            straight += (b[j] - a[j]) ** 2
        if np.sqrt(straight) > (high - low) * (1.0 - 1e-3) or not open_edge(body, a, b, room):
            continue
        shift = i + 3 - (i2 + 1)  # rows i + 1 … i2 become two
        if count + shift > path.shape[0]:
            break
        for j in range(n):
            if shift > 0:
                for r in range(count - 1, i2, -1):
                    path[r + shift, j] = path[r, j]
            else:
                for r in range(i2 + 1, count):
                    path[r + shift, j] = path[r, j]
            path[i + 1, j], path[i + 2, j] = a[j], b[j]
        count += shift
    return count
