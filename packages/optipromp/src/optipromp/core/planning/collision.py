"""The planner's check whether the body is free at a configuration; the judge has its own.

The obstacles are those of the optimisation. Meshes and point clouds are measured in their distance
grids, which may enlarge them by less than a cell.

At the end stands a way round obstacles: two trees of configurations that grow towards each other
(RRT-Connect). One tree grows from the start, the other from all goal configurations (Kuffner and
LaValle, 2000). Shortcuts then shorten the way. The way is a start of the optimisation, which rounds
its corners. Its edges are checked for collisions at places, not between them.
"""

import functools
from itertools import islice
from typing import NamedTuple

import numpy as np

from optipromp.core.arrays import BoolArray, FloatArray, IntArray, lengths
from optipromp.core.budget import Budget
from optipromp.core.compiled import called, inlined, inner, kernel
from optipromp.core.geometry.distances import distance_and_gradient
from optipromp.core.geometry.obstacles import Obstacles, appended, packed_shapes
from optipromp.core.geometry.shapes import CAPSULE
from optipromp.core.optimization.problem import FARTHER, apart, reach
from optipromp.core.planning.parameters import TREE
from optipromp.core.planning.task import Task
from optipromp.core.robots.kernels import Kinematics, carried_points, chain_frames
from optipromp.core.robots.model import Robot
from optipromp.core.scenes.scene import Scene

STRIDE = 8  # [1] an edge is checked at every eighth place first, then at the places between


class Collider(NamedTuple):
    """Body and obstacles for the kernels; arrays as in :class:`BodyPoints` and `Surroundings`."""

    kin: Kinematics
    segment: IntArray
    local: FloatArray
    radius: FloatArray
    link_start: IntArray
    link_bound: FloatArray
    link_distal: BoolArray
    groups: IntArray
    pairs: IntArray
    slack: FloatArray
    static: Obstacles
    dynamic: Obstacles
    shared: int
    special: Obstacles  # see :class:`optipromp.core.planning.task.RoomApart`
    room: FloatArray  # (L, K) [m] of the special obstacles
    common: FloatArray  # (L, 0): the other obstacles have no room
    lever: FloatArray  # (n,) [m per rad or m] :func:`levers`
    step: float  # [m] largest motion of the body between two places along an edge
    # work arrays of the kinematics of one configuration
    origins: FloatArray
    rotations: FloatArray
    axes: FloatArray
    points: FloatArray


def collider(task: Task, shared: int) -> Collider:
    """The arm and the obstacles of a task; ``shared`` as in :class:`Surroundings`."""
    robot, body, around = task.robot, task.body, task.surroundings
    segments = robot.n_segments
    other, room = apart(task.scene.world, robot, reach(robot) + FARTHER)
    return Collider(
        robot.kinematics, body.segment, body.local, body.radius, body.link_start, body.link_bound,
        body.link_distal, body.groups, body.pairs, body.slack, around.static, around.dynamic,
        shared, other, room, np.zeros((len(room), 0)), levers(robot), TREE.step,
        np.empty((1, segments, 3)), np.empty((1, segments, 3, 3)), np.empty((1, segments, 3)),
        np.empty((1, len(body), 3)),
    )  # fmt: skip


def free(task: Task, q: FloatArray, most: int | None = None) -> FloatArray:
    """The first ``most`` of configurations ``q`` (m, n) at which the body touches nothing.

    Stems count as obstacles. The last link and the tool may touch all but static objects.
    """
    body = _among_stems(task)
    q = np.array(q, dtype=np.float64, order="C")  # always writable: kernels compile once
    room = np.empty(task.robot.n_joints)
    found = (i for i in range(len(q)) if open_edge(body, q[i], q[i], room))
    return np.asarray(q[list(islice(found, most))])


def open_until(task: Task, q: FloatArray) -> int:
    """The first of configurations ``q`` (m, n), in their order, that a free motion cannot reach.

    ``m`` where the whole motion is free. What is touched, and what not, is as in :func:`free`.
    """
    body, room = _among_stems(task), np.empty(task.robot.n_joints)
    q = np.array(q, dtype=np.float64, order="C")
    edges = (i for i in range(len(q)) if not open_edge(body, q[max(i - 1, 0)], q[i], room))
    return next(edges, len(q))


def _among_stems(task: Task) -> Collider:
    body = collider(task, 0)
    return body._replace(dynamic=appended(body.dynamic, _stems(task.scene.world)))


@functools.lru_cache(maxsize=4)
def _stems(scene: Scene) -> Obstacles:
    """The pieces of all stems, including the target's, but of fruits that a link may touch."""
    free = {name for pair in scene.may_touch for name in pair}
    spared = [k for k, item in enumerate(scene.objects if free else ()) if item.id in free]
    owner, *capsules = scene.strands
    middle, turn, size = (each[~np.isin(owner, spared)] for each in capsules)
    measured = np.full(len(size), CAPSULE), size, size.sum(axis=1)
    return packed_shapes((), middle, turn, measured)


def levers(robot: Robot) -> FloatArray:
    """The largest motion (n,) of any point of the robot for a unit of each joint [m/rad or m/m]."""
    kin, spheres = robot.kinematics, robot.spheres
    far = np.zeros(robot.n_segments)  # largest distance of any point from the segment's origin
    own = lengths(spheres.center) + spheres.radius
    np.maximum.at(far, spheres.segment[spheres.segment >= 0], own[spheres.segment >= 0])
    far[-1] = max(far[-1], float(np.linalg.norm(robot.tool_point)))
    out = np.zeros(robot.n_joints)
    for s in reversed(range(robot.n_segments)):
        if s + 1 < robot.n_segments:
            slide = 0.0
            if kin.kind[s + 1] == 1:
                j = kin.dof[s + 1]
                slide = float(max(abs(robot.lower[j]), abs(robot.upper[j])))
            far[s] = max(far[s], float(np.linalg.norm(kin.translation[s + 1])) + slide + far[s + 1])
        lever = 1.0 if kin.kind[s] == 1 else far[s]
        out[kin.dof[s]] += abs(kin.multiplier[s]) * lever
    return out


@inlined
def blocked(body, q):
    """Whether the body at ``q`` (n,) touches an obstacle or itself."""
    origins, points, spheres = body.origins, body.points, body.radius.shape[0]
    chain_frames(body.kin, q, origins[0], body.rotations[0], body.axes[0])
    carried_points(body.segment, body.local, origins, body.rotations, points)
    p = points[0]
    for link in range(body.link_start.shape[0] - 1):
        if meets(body, p, link, spheres, body.static, body.static.kind.shape[0], body.common):
            return True
        last = body.shared if body.link_distal[link] else body.dynamic.kind.shape[0]
        if meets(body, p, link, spheres, body.dynamic, last, body.common):
            return True
        if meets(body, p, link, spheres, body.special, body.special.kind.shape[0], body.room):
            return True
    for g in range(body.groups.shape[0]):
        first, second = body.groups[g, 0], body.groups[g, 1]
        bounds = body.link_bound[first] + body.link_bound[second]
        if not closer(p, spheres + 2 + first, spheres + 2 + second, bounds):
            continue
        for k in range(body.groups[g, 2], body.groups[g, 3]):
            i, j = body.pairs[k, 0], body.pairs[k, 1]
            if closer(p, i, j, body.radius[i] + body.radius[j] - body.slack[k]):
                return True
    return False


@inlined
def closer(p, i, j, apart):
    """Whether points i and j of ``p`` (P, 3) are nearer than ``apart``."""
    x, y, z = p[i, 0] - p[j, 0], p[i, 1] - p[j, 1], p[i, 2] - p[j, 2]
    return x * x + y * y + z * z < apart * apart


@inlined
def meets(body, p, link, spheres, obstacles, last, room):
    """Whether a link comes nearer to one of the first ``last`` obstacles than its ``room`` (L, K).

    Where ``room`` has no columns, it is 0.
    """
    c = p[spheres + 2 + link]
    for k in range(last):
        keep = room[link, k] if k < room.shape[1] else 0.0
        if keep == -np.inf:
            continue
        bound = body.link_bound[link] + keep
        o, far = obstacles.position[k], obstacles.bound[k] + bound
        x, y, z = c[0] - o[0], c[1] - o[1], c[2] - o[2]
        if x * x + y * y + z * z >= far * far:
            continue
        d, _, _, _ = distance_and_gradient(obstacles, k, c[0], c[1], c[2])
        if d >= bound:
            continue
        for b in range(body.link_start[link], body.link_start[link + 1]):
            d, _, _, _ = distance_and_gradient(obstacles, k, p[b, 0], p[b, 1], p[b, 2])
            if d < body.radius[b] + keep:
                return True
    return False


@called
def open_edge(body, a, b, q):
    """Whether the edge from ``a`` to ``b`` (n,) is free, without ``a``; ``q`` (n,) changes."""
    moved = 0.0
    for j in range(a.shape[0]):
        moved += body.lever[j] * abs(b[j] - a[j])
    count = int(moved / body.step) + 1
    for offset in range(STRIDE):
        for i in range(count - offset, 0, -STRIDE):
            for j in range(a.shape[0]):
                q[j] = a[j] + (b[j] - a[j]) * i / count
            if blocked(body, q):
                return False
    return True


BATCH = 500  # samples, after which the budget is asked


def way(
    task: Task, goals: FloatArray, seeds: FloatArray, rng: np.random.Generator,
    budget: Budget | None = None,
) -> FloatArray | None:  # fmt: skip
    """Corners (k, n) of a way from the start to one of the goals; None where none was found.

    Objects to push are obstacles of the last link and the tool too, unless that leaves no way.

    ``goals``: (m, n) configurations, free. ``seeds``: (s, n) configurations, near which a share of
    the samples is drawn; may be empty. ``budget``: asked before each batch of samples.
    """
    around = task.surroundings
    for pushed in sorted({around.shared, len(around.dynamic.kind)}, reverse=True):
        body = collider(task, pushed)
        best: FloatArray | None = None
        for _ in range(TREE.ways):
            corners = _grown(body, task.robot, task.start, goals, seeds, rng, budget)
            if corners is None:
                break
            places = np.sort(rng.random((TREE.shortcuts, 2)), axis=1)
            corners = np.asarray(shorten(body, corners, places, np.empty(corners.shape[1])))
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


@called
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


@kernel
def shorten(body, path, places, room):
    """The path (k, n) with parts replaced by straight lines between two places, where free.

    A row of ``places`` (p, 2) has two shares of the path's length, the smaller one first. ``room``
    (n,) is a work array.
    """
    for k in range(places.shape[0]):
        along = np.zeros(len(path))
        for i in range(1, len(path)):
            _, squared = nearest(path[i - 1 : i], 1, path[i])
            along[i] = along[i - 1] + np.sqrt(squared)
        low, high = places[k, 0] * along[-1], places[k, 1] * along[-1]
        i = np.searchsorted(along[1:-1], low)  # pieces that hold the two places
        j = np.searchsorted(along[1:-1], high, side="right")
        if i == j:
            continue
        u = (low - along[i]) / max(along[i + 1] - along[i], 1e-12)
        v = (high - along[j]) / max(along[j + 1] - along[j], 1e-12)
        ends = np.empty((2, path.shape[1]))
        ends[0] = path[i] + u * (path[i + 1] - path[i])
        ends[1] = path[j] + v * (path[j + 1] - path[j])
        _, straight = nearest(ends[:1], 1, ends[1])
        shorter = np.sqrt(straight) <= (high - low) * (1.0 - 1e-3)
        if shorter and open_edge(body, ends[0], ends[1], room):
            path = np.concatenate((path[: i + 1], ends, path[j + 1 :]))
    return path
