"""Clearances and contacts of a robot in motion, by conservative advancement.

The distance of two bodies shrinks by no more than they move. A pair that is too far apart to matter
is therefore measured again only after the robot has moved by the excess. The figures equal those of
measuring every pair at every configuration.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from optipromp.core.arrays import FloatArray
from optipromp.core.compiled import inlined, inner, kernel
from optipromp.core.judging.distances import (
    AVOID,
    AVOID_BY_TOOL,
    PUSHABLE,
    ROLES,
    STATIC,
    STEM,
    apart_by,
    inside,
    names_of,
    nearest,
    objects_of,
    to_core,
    to_surface,
)
from optipromp.core.judging.kinematics import body_of, carried, centers, segments
from optipromp.core.robots.model import Robot
from optipromp.core.scenes.scene import Scene, SceneObject

CONFIGURATIONS = 4_000  # at once: 10 MB of spheres; a motion may have 200,000


@dataclass(frozen=True)
class Overlap:
    """A link that touches what it must not: an object or another link, how deep [m], when [s]."""

    link: str
    other: str
    role: str
    depth: float
    time: float | None = None

    def __str__(self) -> str:
        return f"{self.link} enters {self.other} ({self.role}) by {self.depth * 1e3:.1f} mm"


def clearances(
    scene: Scene, robot: Robot, q: FloatArray
) -> tuple[dict[str, float | None], list[Overlap]]:
    """Smallest distances [m] over configurations ``q`` (M, n), and forbidden contacts.

    Contacts count with static objects for every sphere, with avoid objects, pushables and stems for
    B_d (all but the last link and the tool), and between links that are not neighbours. The
    dictionary has the keys of :class:`optipromp.core.judging.Metrics`; None where there is nothing
    to measure.
    """
    distances, contacts, _, _ = swept(scene, robot, q)
    return distances, contacts


def swept(
    scene: Scene, robot: Robot, q: FloatArray, times: FloatArray | None = None
) -> tuple[dict[str, float | None], list[Overlap], FloatArray, FloatArray]:
    """:func:`clearances`, and tool point [m] and tool axis (M, 3) at every configuration.

    With ``times`` (M,) of the configurations [s], each contact says when it is deepest.
    """
    body = body_of(robot)
    objects, rest = objects_of(scene)
    closest, core, apart = np.full(STEM + 1, np.inf), np.full(1, np.inf), np.full(4, np.inf)
    count = len(objects.kind)
    depth, deepest = np.full(count, np.inf), np.zeros((2, count), dtype=np.int64)
    q = np.array(q, dtype=np.float64, order="C")  # always writable: kernels compile once
    points, axes = np.empty((len(q), 3)), np.empty((len(q), 3))
    advance(body, objects, q, points, axes, closest, core, depth, deepest, apart)

    def name(sphere: float) -> str:
        return str(robot.link_names[robot.spheres.link[body.original[int(sphere)]]])

    def when(at: float) -> float | None:
        return None if times is None else float(times[int(at)])

    met = np.flatnonzero(depth < 0.0)
    met = met[np.lexsort((depth[met], objects.rows[met]))]
    met = met[np.diff(objects.rows[met], prepend=-1) > 0]  # of a stem's pieces the deepest
    contacts = [
        Overlap(name(deepest[0, k]), *other, -float(depth[k]), when(deepest[1, k]))
        for k, other in zip(met.tolist(), names_of(scene, objects.rows[met]), strict=True)
    ]
    if rest:
        contacts += _other_shapes(rest, robot, q, closest, core, when)
    if apart[0] < 0.0:
        pair = name(apart[1]), name(apart[2])
        contacts.append(Overlap(*pair, "the robot itself", -float(apart[0]), when(apart[3])))
    distances = {
        "M_c": core[0],
        "clearance_static": closest[STATIC],
        "clearance_avoid": closest[AVOID],
        "clearance_avoid_tool": closest[AVOID_BY_TOOL],
        "clearance_pushable": closest[PUSHABLE],
        "clearance_self": apart[0],
    }
    found = {key: float(d) if math.isfinite(d) else None for key, d in distances.items()}
    return found, contacts, points, axes


def _other_shapes(
    items: Sequence[SceneObject],
    robot: Robot,
    q: FloatArray,
    closest: FloatArray,
    core: FloatArray,
    when: Callable[[float], float | None],
) -> list[Overlap]:
    """Contacts with meshes and point clouds; updates ``closest`` and ``core``."""
    radius, distal = np.array(robot.spheres.radius), np.array(robot.spheres.distal)
    sets = {
        STATIC: np.arange(len(radius)),
        AVOID: np.flatnonzero(~distal),
        AVOID_BY_TOOL: np.flatnonzero(distal),
        PUSHABLE: np.flatnonzero(~distal),
    }
    asked = [
        (item, row, sets[row])
        for item in items
        for row in ((AVOID, AVOID_BY_TOOL) if ROLES[item.role] == AVOID else (ROLES[item.role],))
        if len(sets[row])
    ]
    deepest = dict[int, tuple[float, int, int]]()
    for start in range(0, len(q), CONFIGURATIONS):
        spheres = centers(robot, q[start : start + CONFIGURATIONS])
        for n, (item, row, own) in enumerate(asked):
            d, sphere, at = nearest(item, spheres[:, own], radius[own], closest[row])
            closest[row] = min(closest[row], d)
            if row != AVOID_BY_TOOL and d < deepest.get(n, (0.0,))[0]:
                deepest[n] = d, int(own[sphere]), start + at
        for item in items:
            if ROLES[item.role] != PUSHABLE and len(radius):  # such a core is the surface
                core[0] = min(core[0], nearest(item, spheres, np.zeros_like(radius), core[0])[0])
    names = [str(robot.link_names[link]) for link in robot.spheres.link]
    return [
        Overlap(names[sphere], asked[n][0].id, asked[n][0].role, -d, when(at))
        for n, (d, sphere, at) in sorted(deepest.items())
    ]


def pushed_away(
    scene: Scene, robot: Robot, q: FloatArray, contacts: Sequence[Overlap]
) -> tuple[list[Overlap], list[str]]:
    """Contacts without those with objects that the tool had pushed away before; a note on each.

    A pushable without a stem stays where it was pushed to. If the tool has been in its first place
    to some depth, the object has moved by at least that depth. An arm link that enters the place
    later, and no deeper, finds it empty. Meshes and point clouds are not treated so.
    """
    met = {contact.other for contact in contacts if contact.role == "pushable"}
    if not met:
        return list(contacts), []
    objects, _ = objects_of(scene)
    own = np.flatnonzero(objects.role == PUSHABLE)
    loose = {
        item.id: k
        for k, item in zip(own.tolist(), scene.objects_at(objects.rows[own]), strict=True)
        if item.id in met and item.stem is None
    }
    if not loose:
        return list(contacts), []
    found = {k: np.zeros(3) for k in loose.values()}
    radius, distal = np.array(robot.spheres.radius), np.array(robot.spheres.distal)
    for start in range(0, len(q), CONFIGURATIONS):
        spheres = centers(robot, q[start : start + CONFIGURATIONS])
        for place, so_far in found.items():
            enter(objects, place, spheres, radius, distal, so_far)
    kept, notes = [], []
    for contact in contacts:
        k = loose.get(contact.other)
        if k is None:
            kept.append(contact)
            continue
        _, depth, sphere = found[k]
        if depth > 0.0:
            link = str(robot.link_names[robot.spheres.link[int(sphere)]])
            kept.append(replace(contact, link=link, depth=float(depth)))
        else:
            notes.append(
                f"{contact.link} passes where {contact.other} stood, from where the tool has "
                "pushed it by then"
            )
    return kept, notes


@inner
def enter(objects, k, spheres, radius, distal, so_far):
    """Lead the arm into object ``k``: how deep is it where no tool was so deep before?

    Args:
        objects: see :class:`optipromp.core.judging.distances.Objects`.
        k: which of them.
        spheres: (M, B, 3) centres, one configuration after the other.
        radius, distal: (B,) of the spheres; the last link and the tool are distal.
        so_far: (3,) in and out: the largest depth of the tool [m], the largest of the arm where no
            tool was so deep before [m], and its sphere.
    """
    size, p = objects.size[k], objects.position
    pushed, depth, deepest = so_far[0], so_far[1], so_far[2]
    for m in range(spheres.shape[0]):
        reached = pushed
        for b in range(radius.shape[0]):
            if apart_by(spheres[m], b, p, k) > objects.bound[k] + radius[b]:
                continue
            x, y, z = inside(objects.rotation, p, k, spheres[m], b)
            d = radius[b] - to_surface(objects.kind[k], size[0], size[1], size[2], x, y, z)
            if distal[b]:
                reached = max(reached, d)
            elif d > max(pushed, depth):
                depth, deepest = d, float(b)
        pushed = reached
    so_far[0], so_far[1], so_far[2] = pushed, depth, deepest


@kernel
def advance(body, objects, q, points, axes, closest, core, depth, deepest, apart):
    """Closest approaches over configurations ``q`` (M, n) by conservative advancement, in place.

    ``travel`` (L,) is an upper bound of the motion of each link's spheres [m]; ``farthest`` is the
    sum of the largest steps of a link. A link and an object are measured again when the link's
    travel reaches their ``wait``; an object, or a block of objects, when ``farthest`` reaches its
    own. Two links are measured again when the joints between them have ``turned`` (S,) far enough
    to bring them together. The order is: the first configuration, the last, then backwards. A
    motion ends near objects, and small distances found early leave less to measure.

    Args:
        body: see :class:`optipromp.core.judging.kinematics.Body`.
        objects: see :class:`optipromp.core.judging.distances.Objects`.
        q: configurations.
        points, axes: (M, 3) tool point [m] and tool axis at each of them.
        closest: (5,) smallest distances [m]: static, avoid by B_d, avoid by the last link and tool,
            pushable and stem by B_d.
        core: (1,) the paper's M_c [m] over static and avoid objects.
        depth: (K,) smallest distance [m] of the spheres that must not touch each object; exact
            where negative.
        deepest: (2, K) the nearest sphere, and at which configuration.
        apart: (4,) smallest distance [m] between links that are not neighbours, the two spheres,
            and at which configuration.
    """
    n_segments, n_links, n_objects = body.driver.shape[0], body.reach.shape[0], objects.kind.size
    frames, origins = np.zeros((2, n_segments, 3, 3)), np.empty((n_segments, 3))
    nowhere = np.zeros((n_segments, 3))
    spheres, middles = np.empty((body.radius.shape[0], 3)), np.empty((n_links, 3))
    placed = np.empty(n_links, dtype=np.bool_)
    travel, farthest = np.zeros(n_links), 0.0
    wait, wait_object = np.zeros((n_objects, n_links)), np.zeros(n_objects)
    wait_block = np.zeros(objects.block_bound.shape[0])
    wait_pair, wait_pairs = np.zeros(body.groups.shape[0]), 0.0
    turned, most, levers = np.zeros(n_segments), 0.0, body.levers
    for i in range(q.shape[0]):
        m = -i % q.shape[0]
        turns, before = frames[i % 2], frames[(i + 1) % 2]
        farthest += _move(body, q[m], i == 0, before, turns, origins, middles, travel)
        for s in range(n_segments):
            joint, last = body.driver[s], max(i - 1, 0)
            step = abs(body.ratio[s] * (q[m, joint] - q[-last % q.shape[0], joint]))
            step = step * (1.0 + 1e-9) + 1e-12  # rounding
            turned[s] += step
            most += body.longest[s] * step
        points[m, 0], points[m, 1], points[m, 2] = carried(
            turns, origins, n_segments - 1, body.tool, 0
        )
        axes[m, 0], axes[m, 1], axes[m, 2] = carried(turns, nowhere, n_segments - 1, body.tool, 1)
        placed[:] = False
        for c in range(wait_block.shape[0]):
            if farthest < wait_block[c]:
                continue
            role = objects.role[objects.block[c]]
            spare = _to_block(objects, c, middles, body.reach) - _wanted(role, closest, core)
            if spare > 0.0:
                wait_block[c] = farthest + spare
                continue
            wait_block[c] = math.inf
            for k in range(objects.block[c], objects.block[c + 1]):
                if farthest >= wait_object[k]:
                    least = math.inf
                    for link in range(n_links):
                        if role >= PUSHABLE and body.distal[link]:
                            continue  # the tool may touch what it pushes
                        if travel[link] >= wait[k, link]:
                            wait[k, link] = travel[link] + _measured(
                                body, objects, k, link, m, turns, origins, middles, spheres,
                                placed, closest, core, depth, deepest,
                            )  # fmt: skip
                        least = min(least, wait[k, link] - travel[link])
                    wait_object[k] = farthest + least
                wait_block[c] = min(wait_block[c], wait_object[k])
        if most < wait_pairs:
            continue
        wait_pairs = math.inf
        for g in range(wait_pair.shape[0]):
            moved = 0.0
            for s in range(n_segments):
                moved += levers[g, s] * turned[s]
            if moved >= wait_pair[g]:
                first, second = body.groups[g, 0], body.groups[g, 1]
                gap = apart_by(middles, first, middles, second)
                gap -= body.reach[first] + body.reach[second]
                if gap < apart[0]:
                    for link in (first, second):
                        if not placed[link]:
                            _place_link(body, turns, origins, link, spheres)
                            placed[link] = True
                    gap = _nearest_pair(body, g, m, spheres, middles, apart)
                wait_pair[g] = moved + gap - apart[0]
            wait_pairs = min(wait_pairs, most + wait_pair[g] - moved)


@inlined
def _measured(
    body, objects, k, link, m, turns, origins, middles, spheres, placed, closest, core, depth,
    deepest,
):  # fmt: skip
    """Distance [m] by which a link may come nearer to object ``k`` before a figure changes.

    The figures (see :func:`advance`) are updated where the link is near enough to change one now.
    """
    role, kind, size = objects.role[k], objects.kind[k], objects.size[k]
    row = AVOID_BY_TOOL if role == AVOID and body.distal[link] else role
    wanted = max(closest[row], 0.0 if role >= PUSHABLE else core[0], 0.0)
    far = apart_by(middles, link, objects.position, k) - objects.bound[k] - body.reach[link]
    if far < wanted:
        x, y, z = inside(objects.rotation, objects.position, k, middles, link)
        far = max(far, to_surface(kind, size[0], size[1], size[2], x, y, z) - body.reach[link])
    if far >= wanted:
        return far - wanted
    if not placed[link]:
        _place_link(body, turns, origins, link, spheres)
        placed[link] = True
    gap, gap_core = math.inf, math.inf
    for b in range(body.start[link], body.start[link + 1]):
        x, y, z = inside(objects.rotation, objects.position, k, spheres, b)
        d = to_surface(kind, size[0], size[1], size[2], x, y, z) - body.radius[b]
        gap = min(gap, d)
        if role < PUSHABLE:
            gap_core = min(gap_core, to_core(kind, size[0], size[1], size[2], x, y, z))
        if row != AVOID_BY_TOOL and d < depth[k]:
            depth[k], deepest[0, k], deepest[1, k] = d, b, m
    closest[row] = min(closest[row], gap)
    spare = gap - max(closest[row], 0.0)
    if role < PUSHABLE:
        core[0] = min(core[0], gap_core)
        spare = min(spare, gap_core - core[0])
    return spare


@inlined
def _move(body, q, begin, before, turns, origins, middles, travel):
    """Move the segments and the links' middles to ``q``; the largest step it adds to ``travel``.

    A turn by the angle θ moves a point at distance h from the middle by at most 2 sin(θ/2) h about
    it, and 2 sin(θ/2) is the Frobenius norm of the change of the rotation over √2: from ``before``
    (S, 3, 3) to ``turns``, which with ``origins`` (S, 3) is updated.
    """
    segments(body, q, turns, origins)
    largest = 0.0
    for link in range(middles.shape[0]):
        s, step = body.carrier[body.start[link]], 0.0
        if s >= 0:
            for i in range(3):
                for j in range(3):
                    step += (turns[s, i, j] - before[s, i, j]) ** 2
            step = math.sqrt(0.5 * step) * body.reach[link]
        x, y, z = carried(turns, origins, s, body.middle, link)
        dx, dy, dz = x - middles[link, 0], y - middles[link, 1], z - middles[link, 2]
        step += math.sqrt(dx * dx + dy * dy + dz * dz)
        middles[link, 0], middles[link, 1], middles[link, 2] = x, y, z
        if not begin:
            step = step * (1.0 + 1e-9) + 1e-12  # rounding
            travel[link] += step
            largest = max(largest, step)
    return largest


@inlined
def _wanted(role, closest, core):
    """Distance [m] from which on objects of a role change no figure."""
    if role == STATIC:
        return max(closest[STATIC], core[0], 0.0)
    if role == AVOID:
        return max(closest[AVOID], closest[AVOID_BY_TOOL], core[0], 0.0)
    return max(closest[role], 0.0)


@inlined
def _to_block(objects, c, middles, reach):
    """Distance [m] from block ``c`` to the nearest of the balls about ``middles`` (L, 3)."""
    gap = math.inf
    for link in range(middles.shape[0]):
        gap = min(gap, apart_by(objects.block_middle, c, middles, link) - reach[link])
    return gap - objects.block_bound[c]


@inlined
def _nearest_pair(body, group, check, spheres, middles, apart):
    """The distance [m] between two links; updates ``apart`` where it is the least so far."""
    second = body.groups[group, 1]
    last, skip, gap = -1, False, math.inf
    for i in range(body.groups[group, 2], body.groups[group, 3]):
        a, b = body.pairs[i, 0], body.pairs[i, 1]
        if a != last:
            last = a
            far = apart_by(spheres, a, middles, second) - body.radius[a] - body.reach[second]
            skip = far >= gap
        if skip:
            continue
        x, y = spheres[a, 0] - spheres[b, 0], spheres[a, 1] - spheres[b, 1]
        z = spheres[a, 2] - spheres[b, 2]
        squared = x * x + y * y + z * z
        reach = gap + body.radius[a] + body.radius[b] - body.slack[i]
        if reach < 0.0 or squared > reach * reach * (1.0 + 1e-12):
            continue  # no nearer, and no root needed to see it
        d = math.sqrt(squared) - body.radius[a] - body.radius[b] + body.slack[i]
        gap = min(gap, d)
        if d < apart[0]:
            apart[0], apart[1], apart[2], apart[3] = d, a, b, check
    return gap


@inlined
def _place_link(body, turns, origins, link, spheres):
    """World centres of one link's spheres, in place."""
    for b in range(body.start[link], body.start[link + 1]):
        spheres[b, 0], spheres[b, 1], spheres[b, 2] = carried(
            turns, origins, body.carrier[b], body.local, b
        )
