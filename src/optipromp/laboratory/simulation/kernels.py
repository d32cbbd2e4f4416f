"""Kernels that run after every step of the physics."""

import math

import numpy as np

from optipromp.core.compiled import kernel


@kernel
def is_sound(warnings, positions, velocities):
    """Whether there is no warning, and every position and velocity is finite."""
    for count in warnings:
        if count > 0:
            return False
    for values in (positions, velocities):
        for value in values:
            if not math.isfinite(value):
                return False
    return True


@kernel
def note_pulls(pulls, limits, largest):
    """Raise ``largest`` to ``pulls`` in place; whether one is above its limit. All are (W,)."""
    beyond = False
    for w in range(len(pulls)):
        if pulls[w] > largest[w]:
            largest[w] = pulls[w]
        if pulls[w] > limits[w]:
            beyond = True
    return beyond


@kernel
def contact_forces(geoms, addresses, frames, forces, owners):
    """Pairs of owners that touch (K, 2), the smaller first, and the force between them (K,) [N].

    The force is the length of the sum of the pair's contact forces. Of C contacts, ``geoms`` (C, 2)
    are the two geoms, ``addresses`` (C,) the first row in ``forces`` (-1: no force) and ``frames``
    (C, 9) the frames. ``owners`` (G,) are the entities of the geoms; contacts of those below 0 are
    not counted.
    """
    pairs = np.empty((len(addresses), 2), np.int64)
    sums = np.zeros((len(addresses), 3))
    count = 0
    for c in range(len(addresses)):
        at, a, b, sign = addresses[c], owners[geoms[c, 0]], owners[geoms[c, 1]], 1.0
        if a > b:
            a, b, sign = b, a, -1.0
        if at < 0 or a < 0:
            continue
        k = 0
        while k < count and (pairs[k, 0] != a or pairs[k, 1] != b):
            k += 1
        if k == count:
            pairs[k, 0], pairs[k, 1] = a, b
            count += 1
        for j in range(3):
            # elliptic cones: normal, then the tangential components
            sums[k, j] += sign * (
                frames[c, j] * forces[at]
                + frames[c, 3 + j] * forces[at + 1]
                + frames[c, 6 + j] * forces[at + 2]
            )
    strengths = np.empty(count)
    for k in range(count):
        x, y, z = sums[k]
        strengths[k] = math.sqrt(x * x + y * y + z * z)
    return pairs[:count], strengths


@kernel
def log_contacts(geoms, addresses, frames, forces, owners, log, step, now, timestep, threshold):
    """Add the contacts at time ``now`` [s], after step number ``step``, to ``log`` in place.

    The first five arguments are those of :func:`contact_forces`; ``log`` (E, E) is a ContactLog's.
    """
    pairs, strengths = contact_forces(geoms, addresses, frames, forces, owners)
    for k in range(len(strengths)):
        force = strengths[k]
        if force <= 0.0:
            continue
        a, b = pairs[k]
        pair = log[a, b]
        if not pair.peak > force:
            pair.peak = force
        if force > pair.recent:
            pair.recent = force
        if math.isnan(pair.first):
            pair.first = now
        pair.time += timestep
        if force > threshold:
            spell = timestep
            if pair.pressed == step - 1:
                spell += pair.spell
            pair.spell, pair.pressed = spell, step
            pair.hard = max(pair.hard, spell)
        log[b, a] = log[a, b]
