"""Conservative advancement (Mirtich, 1996): closest approaches of a robot in motion.

The distance of two bodies shrinks by no more than the bodies move. A pair of bodies that is too far
apart to change a figure is measured again only after the robot has moved by the excess. The figures
equal those of measuring every pair at every configuration.
"""

import math

import numpy as np

from optipromp.core.compiled import inlined, kernel
from optipromp.core.judging.distances import (
    AVOID,
    AVOID_BY_TOOL,
    PUSHABLE,
    STATIC,
    apart_by,
    inside,
    to_core,
    to_surface,
)
from optipromp.core.judging.kinematics import carried, segments


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
    :class:`optipromp.core.judging.distances.Objects`. ``q``: configurations. ``points``, ``axes``:
    (M, 3) tool points [m] and tool axes. ``closest``: (5,) smallest distances [m]: of all spheres
    to static objects, of B_d to avoid objects, of the last link and the tool to avoid objects, of
    B_d to pushables and stems. ``core``: (1,) the paper's M_c [m] over static and avoid objects.
    ``depth``: (K,) smallest distance [m] of each object to the spheres that must not touch the
    object; exact where negative. ``deepest``: (2, K) index of the sphere and of the configuration
    at that distance. ``apart``: (4,) smallest distance [m] between links that are not neighbours,
    the indices of the two spheres and of the configuration.
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
