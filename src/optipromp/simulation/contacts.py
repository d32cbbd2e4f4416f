"""Who touched whom, how hard and how long."""

from typing import Any

import numpy as np

from optipromp.arrays import FloatArray, IntArray
from optipromp.simulation.world import World


class ContactLog:
    """Peak force, time in touch and first touch of every pair of entities, step by step.

    The force of an instant is the length of the sum of the pair's contact forces [N].

    Attributes:
        peak: (E, E) largest force, symmetric.
        time: (E, E) time in touch [s].
        hard: (E, E) longest spell above ``threshold`` [s].
        first: (E, E) when the pair first touched [s]; NaN where it never did.
    """

    def __init__(self, world: World, threshold: float) -> None:
        count = len(world.entities)
        self._owners, self._step = world.geom_entity, float(world.model.opt.timestep)
        self._threshold, self._count = threshold, count
        self.peak: FloatArray = np.zeros((count, count))
        self.time: FloatArray = np.zeros((count, count))
        self.hard: FloatArray = np.zeros((count, count))
        self.first: FloatArray = np.full((count, count), np.nan)
        self._spell: dict[int, float] = {}
        self.now: dict[int, float] = {}

    def add(self, data: Any) -> None:
        """Count the contacts of ``data`` at this step."""
        self.now = {}
        if data.ncon == 0:
            self._spell = {}
            return
        pairs, forces = contact_forces(data, self._owners)
        keys, inverse = np.unique(pairs[:, 0] * self._count + pairs[:, 1], return_inverse=True)
        total = np.zeros((len(keys), 3))
        np.add.at(total, inverse, forces)
        strength = np.sqrt((total**2).sum(axis=1))
        spell: dict[int, float] = {}
        for key, force in zip(keys.tolist(), strength.tolist(), strict=True):
            if force <= 0.0:
                continue
            a, b = divmod(key, self._count)
            self.now[key] = force
            if not self.peak[a, b] > force:
                self.peak[a, b] = self.peak[b, a] = force
            if np.isnan(self.first[a, b]):
                self.first[a, b] = self.first[b, a] = data.time
            self.time[a, b] = self.time[b, a] = self.time[a, b] + self._step
            if force > self._threshold:
                spell[key] = self._spell.get(key, 0.0) + self._step
                if spell[key] > self.hard[a, b]:
                    self.hard[a, b] = self.hard[b, a] = spell[key]
        self._spell = spell


def contact_forces(data: Any, owners: IntArray) -> tuple[IntArray, FloatArray]:
    """Pairs of owners (C, 2), the smaller first, and world forces (C, 3) from first to second."""
    contact = data.contact
    address = contact.efc_address
    live = address >= 0
    geoms, address = contact.geom[live], address[live]
    frames = contact.frame[live].reshape(-1, 3, 3)
    force = data.efc_force
    # elliptic cones: normal, then the tangential components
    local = np.stack([force[address], force[address + 1], force[address + 2]], axis=1)
    world = np.einsum("cij,ci->cj", frames, local)
    pairs = owners[geoms]
    swap = pairs[:, 0] > pairs[:, 1]
    world[swap] *= -1.0
    pairs = np.sort(pairs, axis=1)
    return pairs, world
