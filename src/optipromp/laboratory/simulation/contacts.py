"""Contacts of a run: forces and times of each pair of entities."""

from typing import Any, NamedTuple

import numpy as np

from optipromp.core.arrays import BoolArray, FloatArray, IntArray
from optipromp.laboratory.simulation.kernels import log_contacts
from optipromp.laboratory.simulation.world import World

_PAIR = np.dtype(
    [
        ("peak", np.float64),
        ("recent", np.float64),  # largest force since :meth:`ContactLog.take_recent`
        ("time", np.float64),
        ("hard", np.float64),
        ("first", np.float64),
        ("spell", np.float64),  # length of the last spell above the threshold
        ("pressed", np.int64),  # last step of that spell
    ]
)


class ContactLog:
    """Forces and times of contact of every pair of E entities, counted step by step.

    The force of an instant is the length of the sum of the pair's contact forces [N]. All arrays
    are symmetric.

    ``world``: of the entities. ``threshold``: of the spells in ``hard`` [N].

    Attributes:
        peak: (E, E) largest force [N].
        time: (E, E) time in touch [s].
        hard: (E, E) longest spell above the threshold [s].
        first: (E, E) time of the first touch [s]; NaN where there was none.
    """

    def __init__(self, world: World, threshold: float) -> None:
        count = len(world.entities)
        self._owners, self._timestep = world.geom_entity, float(world.model.opt.timestep)
        self._threshold = threshold
        self._pairs = pairs = np.zeros((count, count), _PAIR)
        pairs["first"] = np.nan
        self.peak: FloatArray = pairs["peak"]
        self.time: FloatArray = pairs["time"]
        self.hard: FloatArray = pairs["hard"]
        self.first: FloatArray = pairs["first"]
        self._steps = 0

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
        """(E, E) largest force since the last call [N]."""
        recent: FloatArray = self._pairs["recent"].copy()
        self._pairs["recent"] = 0.0
        return recent


class Pressing(NamedTuple):
    """Contact points of one instant that carry force, C of them."""

    rows: IntArray  # (C,) in MuJoCo's list
    pairs: IntArray  # (C, 2) indices of entities
    points: FloatArray  # (C, 3) [m]
    forces: FloatArray  # (C, 3) of the first entity on the second [N]


def pressing(data: Any, world: World, among: BoolArray | None = None) -> Pressing:
    """The contact points of ``data`` between entities of ``world``.

    ``data``: of MuJoCo. ``world``: of the entities. ``among``: (E,) which entities count; None:
    all.
    """
    found, force = data.contact, data.efc_force
    at = np.asarray(found.efc_address)
    owners = world.geom_entity[np.asarray(found.geom)].reshape(-1, 2)
    counted = (at >= 0) & (owners >= 0).all(axis=1)
    if among is not None:
        counted &= among[owners].all(axis=1)
    rows = np.flatnonzero(counted)
    own = force[at[rows, None] + np.arange(3)] if len(rows) else np.zeros((0, 3))
    frames = np.asarray(found.frame).reshape(-1, 3, 3)[rows]
    forces = np.einsum("ci,cij->cj", own, frames)
    return Pressing(rows, owners[rows], np.asarray(found.pos)[rows], forces)
