"""Clearances and contacts of a robot in motion: without pairs that may touch, with padding.

Simple shapes are measured by conservative advancement (Mirtich, 1996), meshes and point clouds at
every configuration.

The distance of two bodies shrinks by no more than the bodies move. A pair of bodies that is too far
apart to change a figure is measured again only after the robot has moved by the excess. The figures
equal those of measuring every pair at every configuration.
"""

import functools
import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from optipromp.core.arrays import BoolArray, FloatArray
from optipromp.core.compiled import called, inlined, kernel
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
from optipromp.core.robots.model import BodySpheres, Robot
from optipromp.core.scenes.rotations import to_quaternion
from optipromp.core.scenes.scene import Scene, SceneObject, Stem


@kernel
def advance(body, objects, q, points, axes, closest, core, depth, deepest, apart):
    """Update the closest approaches over configurations ``q`` (M, n), in place.

    ``travel`` (L,) bounds the motion of each link's spheres from above [m]. ``farthest`` sums the
    largest motion of any link at each step [m]. A link and an object are measured again when the
    link's ``travel`` reaches their ``wait``, an object when ``farthest`` reaches ``wait_object``, a
    block of objects when ``farthest`` reaches ``wait_block``. Two links are measured again when the
    joints between them have ``turned`` (S,) far enough to bring them together. The first
    configuration comes first, then all others from the last backwards: a motion ends near objects,
    and a small distance that is found early spares later measurements.

    ``body``: see :class:`optipromp.core.judging.kinematics.Body`. ``objects``: see
    :class:`optipromp.core.judging.distances.Objects`. ``points``, ``axes``: (M, 3) tool points [m]
    and tool axes. ``closest``: (5,) smallest distances [m]: of all spheres to static objects, of
    B_d to avoid objects, of the last link and the tool to avoid objects, of B_d to pushables, of
    B_d to stems and a target that hangs. ``core``: (1,) the paper's M_c [m] over static and avoid
    objects. ``depth``: (K,) smallest distance [m] of each object to the spheres that must not touch
    the object; exact where negative. ``deepest``: (2, K) index of the sphere and of the
    configuration at that distance.
    ``apart``: (4,) smallest distance [m] between links that are not neighbours, the indices of the
    two spheres and of the configuration.
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
            step = step * (1.0 + 1e-9) + 1e-12  # [rad or m] no less for rounding
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
    """Distance [m] by which a link may approach object ``k`` before a figure changes.

    A link that is near enough to change a figure of :func:`advance` updates the figure.
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
    """Move the segments and the links' middles to ``q``; return the largest increase of ``travel``.

    A rotation by θ moves a point at distance h from the link's middle by at most 2 sin(θ/2) h about
    the middle. The rotation matrices ``before`` and after it (``turns``, both (S, 3, 3)) differ by
    2√2 sin(θ/2) in Frobenius norm. All other arrays are updated in place.
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
            step = step * (1.0 + 1e-9) + 1e-12  # [m] no less for rounding
            travel[link] += step
            largest = max(largest, step)
    return largest


@inlined
def _wanted(role, closest, core):
    """Smallest distance [m] at which an object of ``role`` changes no figure."""
    if role == STATIC:
        return max(closest[STATIC], core[0], 0.0)
    if role == AVOID:
        return max(closest[AVOID], closest[AVOID_BY_TOOL], core[0], 0.0)
    return max(closest[role], 0.0)


@inlined
def _to_block(objects, c, middles, reach):
    """Distance [m] from block ``c`` to the nearest bounding ball of a link."""
    gap = math.inf
    for link in range(middles.shape[0]):
        gap = min(gap, apart_by(objects.block_middle, c, middles, link) - reach[link])
    return gap - objects.block_bound[c]


@inlined
def _nearest_pair(body, group, check, spheres, middles, apart):
    """Distance [m] between two links; ``apart`` is updated where the distance is the smallest."""
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
            continue  # not nearer: the squares tell, without a root
        d = math.sqrt(squared) - body.radius[a] - body.radius[b] + body.slack[i]
        gap = min(gap, d)
        if d < apart[0]:
            apart[0], apart[1], apart[2], apart[3] = d, a, b, check
    return gap


@inlined
def _place_link(body, turns, origins, link, spheres):
    """Write the world centres [m] of one link's spheres to ``spheres`` (B, 3)."""
    for b in range(body.start[link], body.start[link + 1]):
        spheres[b, 0], spheres[b, 1], spheres[b, 2] = carried(
            turns, origins, body.carrier[b], body.local, b
        )


CONFIGURATIONS = 4_000  # measured together: 10 MB of sphere centres, of at most 200,000


@dataclass(frozen=True)
class Overlap:
    """A forbidden contact of a link.

    Args:
        link: name of the link.
        other: id of the object, or name of the other link.
        role: of the object; ``"the robot itself"`` for a link.
        depth: of penetration [m]; a negative depth is a distance.
        time: of the largest depth [s]; None where no times are known.
    """

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

    Forbidden are contacts of any sphere with a static object, of B_d (all links but the last,
    without the tool) with an avoid object, a pushable or a stem, and of two links that are not
    neighbours. The distances have the keys of :class:`optipromp.core.judging.Metrics`; None where
    there is nothing to measure.
    """
    distances, contacts, _, _ = swept(scene, robot, q)
    return distances, contacts


def swept(
    scene: Scene, robot: Robot, q: FloatArray, times: FloatArray | None = None
) -> tuple[dict[str, float | None], list[Overlap], FloatArray, FloatArray]:
    """:func:`clearances`, then tool points (M, 3) [m] and tool axes (M, 3).

    With the ``times`` (M,) of the configurations [s], each contact has the time of its largest
    depth.
    """
    closest, core, apart = np.full(STEM + 1, np.inf), np.full(1, np.inf), np.full(4, np.inf)
    q = np.array(q, dtype=np.float64, order="C")  # always writable: kernels compile once
    points, axes = np.empty((len(q), 3)), np.empty((len(q), 3))

    def when(at: float) -> float | None:
        return None if times is None else float(times[int(at)])

    contacts: list[Overlap] = []
    for part in parts_of(scene.world, robot):
        body, (objects, rest) = body_of(part.robot), objects_of(scene.world, part.rows)
        count = len(objects.kind)
        depth, deepest = np.full(count, np.inf), np.zeros((2, count), dtype=np.int64)
        advance(body, objects, q, points, axes, closest, core, depth, deepest, apart)
        met = np.flatnonzero(depth < 0.0)
        met = met[np.lexsort((depth[met], objects.rows[met]))]
        met = met[np.diff(objects.rows[met], prepend=-1) > 0]  # of each stem the deepest piece
        contacts += [
            Overlap(_link(part.robot, deepest[0, k]), *other, -float(depth[k]), when(deepest[1, k]))
            for k, other in zip(met.tolist(), names_of(scene, objects.rows[met]), strict=True)
        ]
        if rest:
            contacts += _other_shapes(rest, part.robot, q, closest, core, when)
    if apart[0] < 0.0:
        pair = _link(robot, apart[1]), _link(robot, apart[2])
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


def _link(robot: Robot, sphere: float) -> str:
    """The name of the link of a sphere in the order of the judge's :class:`Body`."""
    return str(robot.link_names[robot.spheres.link[body_of(robot).original[int(sphere)]]])


def _other_shapes(
    items: Sequence[SceneObject], robot: Robot, q: FloatArray, closest: FloatArray,
    core: FloatArray, when: Callable[[float], float | None],
) -> list[Overlap]:  # fmt: skip
    """Contacts with meshes and point clouds; ``closest`` and ``core`` are updated in place."""
    radius, distal = np.array(robot.spheres.radius), np.array(robot.spheres.distal)
    sets = {
        STATIC: np.arange(len(radius)),
        AVOID: np.flatnonzero(~distal),
        AVOID_BY_TOOL: np.flatnonzero(distal),
        PUSHABLE: np.flatnonzero(~distal),
        STEM: np.flatnonzero(~distal),
    }
    asked = [
        (item, row, sets[row])
        for item in items
        for row in (
            (AVOID, AVOID_BY_TOOL) if item.role == "avoid" else (ROLES.get(item.role, STEM),)
        )
        if len(sets[row])
    ]
    deepest = dict[int, tuple[float, int, int]]()
    for start in range(0, len(q), CONFIGURATIONS):
        spheres = centers(robot, q[start : start + CONFIGURATIONS])
        for n, (item, row, chosen) in enumerate(asked):
            d, sphere, at = nearest(item, spheres[:, chosen], radius[chosen], closest[row])
            closest[row] = min(closest[row], d)
            if row != AVOID_BY_TOOL and d < deepest.get(n, (0.0,))[0]:
                deepest[n] = d, int(chosen[sphere]), start + at
        for item in items:
            if item.role in ("static", "avoid") and len(radius):  # the core of M_c is the surface
                core[0] = min(core[0], nearest(item, spheres, np.zeros_like(radius), core[0])[0])
    names = [str(robot.link_names[link]) for link in robot.spheres.link]
    return [
        Overlap(names[sphere], asked[n][0].id, asked[n][0].role, -d, when(at))
        for n, (d, sphere, at) in sorted(deepest.items())
    ]


def pushed_away(
    scene: Scene, robot: Robot, q: FloatArray, contacts: Sequence[Overlap]
) -> tuple[list[Overlap], list[str]]:
    """Remove contacts with pushables that the tool has pushed away before.

    A pushable without a stem stays where the tool has pushed it. A tool that has entered the
    pushable's first place has moved the pushable by at least the depth of the tool. An arm link
    that enters the first place later, and no deeper, touches nothing. Contacts with meshes and
    point clouds stay.

    Returns: The other contacts, and a note on each one removed.
    """
    met = {contact.other for contact in contacts if contact.role == "pushable"}
    if not met:
        return list(contacts), []
    objects, _ = objects_of(scene.world)
    indices = np.flatnonzero(objects.role == PUSHABLE)
    loose = {
        item.id: k
        for k, item in zip(indices.tolist(), scene.objects_at(objects.rows[indices]), strict=True)
        if item.id in met and item.stem is None
    }
    if not loose:
        return list(contacts), []
    found = {k: np.zeros(3) for k in loose.values()}
    radius, distal = np.array(robot.spheres.radius), np.array(robot.spheres.distal)
    by_id = {item.id: item for item in scene.pushables}
    own = {k: np.where(distal, radius, radii(scene, robot, by_id[i])) for i, k in loose.items()}
    for start in range(0, len(q), CONFIGURATIONS):
        spheres = centers(robot, q[start : start + CONFIGURATIONS])
        for place, so_far in found.items():
            enter(objects, place, spheres, own[place], distal, so_far)
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


@called
def enter(objects, k, spheres, radius, distal, so_far):
    """Update the largest depth of the arm in object ``k`` that the tool has not reached before.

    ``objects``: see :class:`optipromp.core.judging.distances.Objects`. ``spheres``: (M, B, 3)
    centres at successive configurations [m]. ``radius``, ``distal``: (B,) radii [m]; whether a
    sphere is of the last link or the tool. ``so_far``: (3,) largest depth of the tool [m]; largest
    depth of the arm where the tool had not been so deep before [m]; index of that sphere of the
    arm.
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


def nearest_static(
    scene: Scene, robot: Robot, q: FloatArray, times: FloatArray | None = None
) -> Overlap | None:
    """The moving link that comes nearest to a static object over configurations ``q`` (M, n).

    The depth is minus the distance [m]: negative where link and object are apart. Links of a fixed
    base do not count: no motion changes their distance. None where no object is static or no link
    moves.
    """
    q, unused = np.array(q, dtype=np.float64, order="C"), np.empty((len(q), 3))
    found: list[tuple[float, int, int, tuple[str, str]]] = []
    for part in parts_of(scene.world, robot):
        mine, (objects, rest) = _moving(part.robot), objects_of(scene.world, part.rows)
        if not scene.static or not len(mine.spheres.radius):
            continue
        body, count = body_of(mine), len(objects.kind)
        depth, deepest = np.full(count, np.inf), np.zeros((2, count), dtype=np.int64)
        advance(
            body, objects, q, unused, unused, np.full(STEM + 1, np.inf), np.full(1, np.inf), depth,
            deepest, np.full(4, np.inf),
        )  # fmt: skip
        depth[objects.role != STATIC] = np.inf
        if count and np.isfinite(depth.min()):
            k = int(np.argmin(depth))
            (named,) = names_of(scene, objects.rows[k : k + 1])
            link = int(mine.spheres.link[body.original[deepest[0, k]]])
            found.append((float(depth[k]), link, int(deepest[1, k]), named))
        radius = np.array(mine.spheres.radius)
        for item in rest:
            if item.role == "static":
                d, sphere, at = nearest(item, centers(mine, q), radius, np.inf)
                found.append((d, int(mine.spheres.link[sphere]), at, (item.id, item.role)))
    if not found:
        return None
    d, which, at, named = min(found)
    time = None if times is None else float(times[at])
    return Overlap(str(robot.link_names[which]), *named, -d, time)


@functools.lru_cache(maxsize=16)
def _moving(robot: Robot) -> Robot:
    """The robot without the spheres of its fixed base, and without pairs of spheres."""
    return of_spheres(robot, np.asarray(robot.spheres.segment) >= 0)


class BodyPart(NamedTuple):
    """Objects that a scene treats alike, and the robot that must not touch them."""

    robot: Robot  # without links that may touch the objects; its spheres are larger by the padding
    rows: frozenset[int] | None  # indices of the objects in the scene; None: all objects


@functools.lru_cache(maxsize=8)
def parts_of(scene: Scene, robot: Robot) -> tuple[BodyPart, ...]:
    """The parts of a scene. The first has the whole robot, with its pairs of spheres."""
    if scene.touches_alike:
        return (BodyPart(robot, None),)
    groups: dict[tuple[frozenset[str], float], list[int]] = {(frozenset(), 0.0): []}
    for row, item in enumerate(scene.objects):
        key = spared(scene, robot, item), scene.padding_of(item)
        groups.setdefault(key, []).append(row)
    out = []
    for (links, padding), rows in groups.items():
        if not links and not padding:
            out.append(BodyPart(robot, frozenset(rows)))
            continue
        kept = _without(robot, links, padding)
        if len(kept.spheres.radius):
            out.append(BodyPart(kept, frozenset(rows)))
    return tuple(out)


def spared(scene: Scene, robot: Robot, item: SceneObject) -> frozenset[str]:
    """The links that may touch an object and its stem."""
    if not scene.may_touch:
        return frozenset()
    return frozenset(name for name in robot.link_names if scene.may_meet(name, item.id))


def pieces(item: SceneObject, stem: Stem) -> list[SceneObject]:
    """The straight pieces of a ``stem`` of ``item``, as objects that stand."""
    return [
        replace(item, shape=shape, position=middle, orientation=to_quaternion(turn), stem=None,
                motion=None)
        for shape, middle, turn in stem.pieces()
    ]  # fmt: skip


def radii(scene: Scene, robot: Robot, item: SceneObject) -> FloatArray:
    """Radii (B,) of the robot's spheres [m], minus infinity where they may touch an object."""
    radius, links = np.array(robot.spheres.radius), spared(scene, robot, item)
    if links:
        radius[_of(robot, links)] = -np.inf
    return radius


def _of(robot: Robot, links: Collection[str]) -> BoolArray:
    indices = [k for k, name in enumerate(robot.link_names) if name in links]
    return np.isin(robot.spheres.link, indices)


@functools.lru_cache(maxsize=32)
def _without(robot: Robot, links: frozenset[str], padding: float) -> Robot:
    return of_spheres(robot, ~_of(robot, links), padding)


def of_spheres(robot: Robot, kept: BoolArray, padding: float = 0.0) -> Robot:
    """The robot of the spheres ``kept`` (B,), larger by ``padding`` [m], without pairs of them."""
    spheres = BodySpheres._make(part[kept] for part in robot.spheres)
    spheres = spheres._replace(radius=spheres.radius + padding)
    pairs = np.zeros((0, 2), dtype=np.int64)
    return replace(robot, spheres=spheres, self_pairs=pairs, self_slack=np.zeros(0))
