"""Contacts of a run: the entities, the forces and the times."""

from typing import Any

import numpy as np

from optipromp.core.arrays import FloatArray
from optipromp.laboratory.simulation.kernels import log_contacts
from optipromp.laboratory.simulation.world import World

_PAIR = np.dtype(
    [
        ("peak", np.float64),
        ("recent", np.float64),  # largest force since it was last set to 0
        ("time", np.float64),
        ("hard", np.float64),
        ("first", np.float64),
        ("spell", np.float64),  # length of the last spell above the threshold
        ("pressed", np.int64),  # last step of that spell
    ]
)


class ContactLog:
    """Peak force, time in touch and first touch of every pair of entities, step by step.

    The force of an instant is the length of the sum of the pair's contact forces [N].
    """

    def __init__(self, world: World, threshold: float) -> None:
        count = len(world.entities)
        self._owners, self._timestep = world.geom_entity, float(world.model.opt.timestep)
        self._threshold = threshold
        self._pairs = np.zeros((count, count), _PAIR)
        self._pairs["first"] = np.nan
        self._steps = 0

    @property
    def peak(self) -> FloatArray:
        """(E, E) largest force, symmetric as everything here."""
        return self._of_pairs("peak")

    @property
    def time(self) -> FloatArray:
        """(E, E) time in touch [s]."""
        return self._of_pairs("time")

    @property
    def hard(self) -> FloatArray:
        """(E, E) longest spell above the threshold [s]."""
        return self._of_pairs("hard")

    @property
    def first(self) -> FloatArray:
        """(E, E) when the pair first touched [s]; NaN where it never did."""
        return self._of_pairs("first")

    def _of_pairs(self, name: str) -> FloatArray:
        values: FloatArray = self._pairs[name]
        return values

    def add(self, data: Any) -> None:
        """Count the contacts of ``data`` at the next step."""
        self._steps += 1
        if data.ncon:
            contact = data.contact
            log_contacts(
                contact.geom, contact.efc_address, contact.frame, data.efc_force, self._owners,
                self._pairs, self._steps, data.time, self._timestep, self._threshold,
            )  # fmt: skip

    def take_recent(self) -> FloatArray:
        """(E, E) largest force since this was last asked."""
        recent = self._of_pairs("recent").copy()
        self._pairs["recent"] = 0.0
        return recent
