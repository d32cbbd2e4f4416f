"""Contacts of a run: forces and times of each pair of entities."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from optipromp.core.arrays import BoolArray, FloatArray, IntArray
from optipromp.core.compiled import kernel
from optipromp_sim.simulation.world import Fruit, World


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

    ``threshold``: of the spells in ``hard`` [N].
    """

    def __init__(self, world: World, threshold: float) -> None:
        count = len(world.entities)
        self._owners, self._timestep = world.geom_entity, float(world.model.opt.timestep)
        self._world, self._threshold = world, threshold
        # why fruits came off, in words, by key; empty without a crop
        self.torn: dict[str, str] = {}
        self._pairs = pairs = np.zeros((count, count), _PAIR)
        pairs["first"] = np.nan
        self.peak: FloatArray = pairs["peak"]  # (E, E) largest force [N]
        self.time: FloatArray = pairs["time"]  # (E, E) time in touch [s]
        self.hard: FloatArray = pairs["hard"]  # (E, E) longest spell above the threshold [s]
        self.first: FloatArray = pairs["first"]  # (E, E) first touch [s]; NaN where there was none
        self._steps = 0
        self.before: ContactLog = self  # by the definition of 0.3.0, counted too

    def add(self, data: Any) -> None:
        """Count the contacts of ``data`` at the next step."""
        self._steps += 1
        if self.before is not self:
            self.before.add(data)
        if data.ncon:
            contact = data.contact
            log_contacts(
                contact.geom, contact.efc_address, contact.frame, data.efc_force, self._owners,
                self._pairs, self._steps, data.time, self._timestep, self._threshold,
            )  # fmt: skip

    def borne(self) -> Iterator[tuple[str, str, float, float]]:
        """Of each fruit: its id, the name of a limit, the largest figure, and what it bears."""
        most = self._world.parameters.thresholds.fruit_force
        for fruit in self._world.shown:
            yield fruit.id, "peak_force", float(self.peak[fruit.entity].max()), most

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

    ``among``: (E,) which entities count; None: all.
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


BARE = 0.02  # [m] without a tool, an object this near the tool point counts as picked: a choice


@dataclass(frozen=True)
class HarmSoFar:
    """What was harmed so far; each share is 1 where the thing bears no more."""

    fruit: float = 0.0  # largest force on a fruit over what it bears
    stem: float = 0.0  # longest time for which a stem was pressed over what it bears
    static: float = 0.0  # largest force on a static object over what counts as a contact
    torn: int = 0  # number of fruits that came off
    swallowed: int = 0  # number of other fruits that the tool keeps; an episode counts them

    @property
    def worst(self) -> float:
        """The largest share; at least 1 where a fruit came off or was swallowed."""
        return max(self.fruit, self.stem, self.static, float(self.torn + self.swallowed))

    @property
    def done(self) -> bool:
        """Whether the pick can no longer be clean."""
        return max(self.fruit, self.stem, self.static) > 1.0 or self.torn + self.swallowed > 0


def harm_so_far(world: World, log: ContactLog, torn: int) -> HarmSoFar:
    """The harm of a run by its contacts, as the judgement at the end counts them."""
    limits, entities = world.parameters.thresholds, world.entities
    robot = [k for k, each in enumerate(entities) if each.kind in ("link", "tool")]
    stems = [fruit.stem_entity for fruit in world.shown if fruit.stem_entity >= 0]
    static = [k for k, each in enumerate(entities) if each.kind == "static"]
    return HarmSoFar(
        max((figure / most for _, _, figure, most in log.borne()), default=0.0),
        float(log.hard[np.ix_(stems, robot)].max(initial=0.0)) / limits.stem_time,
        float(log.peak[np.ix_(static, robot)].max(initial=0.0)) / limits.static_force,
        torn,
    )


def in_tool(world: World, q: FloatArray, states: FloatArray, fruit: Fruit) -> BoolArray:
    """Whether the tool holds a fruit, or, without a tool, the fruit is near the tool point.

    ``q``: (R, n) configurations of the joints. ``states``: (R, nq) of MuJoCo at these.

    Returns: (R,).
    """
    robot = world.robot
    points, _ = robot.tool_pose(q)
    tool = robot.tool
    if tool is None:
        away = states[:, fruit.position : fruit.position + 3] - points
        return np.asarray(np.linalg.norm(away, axis=1) < BARE)
    _, turns = robot.segment_frames(q)
    axes = turns[:, -1] @ robot.flange_rotation @ tool.rotation
    begin, end = (np.einsum("rij,ri->rj", axes, at - points) for at in fruit.ends(states))
    below = np.array([0.0, 0.0, world.parameters.thresholds.inside_margin])
    return tool.holds(begin, end) & tool.holds(begin + below, end + below)
