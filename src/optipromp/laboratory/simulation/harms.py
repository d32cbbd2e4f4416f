"""Harm of fruits by the laws of a crop (:mod:`optipromp.core.scenes.crops`).

- A blow: the work of the contact's normal force while the contact closes, without a pause [J]. It
  is the energy that the flesh takes up; of a fruit that falls, its kinetic energy.
- Pressing: the force that lasts, the contact's force F through a first-order lag,
  :math:`T y' = F - y`, as flesh creeps [N].
- An edge: the normal force of the contact points on the rim of a cup, finger tips or blades [N].
- Abscission: the stem's force on the fruit over the one that detaches it at its angle to the stem,
  and the bending moment at the calyx over that which detaches it.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from optipromp.core.arrays import BoolArray, FloatArray, IntArray, lengths
from optipromp.core.robots.tools import WALL
from optipromp.core.scenes.crops import Crop
from optipromp.laboratory.simulation.contacts import ContactLog, pressing
from optipromp.laboratory.simulation.grasps import scissor_of, suction_of
from optipromp.laboratory.simulation.world import Fruit, World

BEARABLE = "impact_energy", "pressed_force", "edge_force"
"""Rows of a crop that limit what a fruit bears in its contacts."""
DETACHING = "abscission", "abscission_moment"
"""Rows that limit the load of a stem; the figure of the first is the pull along the stem that is as
near to detaching as the true one [N]."""


class HarmLog(ContactLog):
    """Contacts, and the figures of a run that the rows of a ``crop`` limit, step by step."""

    def __init__(self, world: World, threshold: float, crop: Crop) -> None:
        super().__init__(world, threshold)
        self.crop, count, tool = crop, len(world.entities), world.robot.tool
        self._keep = math.exp(-self._timestep / crop["pressed_time"])  # of y, after a step
        # of pairs, by E times the first entity plus the second
        self._work, self._lasting = np.zeros((2, count**2))
        self._last = np.zeros(count**2, dtype=np.int64)  # step of their last touch
        self._worst = np.zeros((count, len(BEARABLE) + len(DETACHING)))
        self._of_tool = np.array([each.kind == "tool" for each in world.entities])
        self._edge: FloatArray | None = None  # axis of the tool, and height from which it is edge
        if tool is not None and suction_of(world) is None:  # whose lip is soft
            height = tool.front if scissor_of(world) is not None else tool.tip - WALL
            self._edge = np.append(tool.rotation[:, 2], height)

    def add(self, data: Any) -> None:
        """Count the contacts of ``data`` at the next step."""
        super().add(data)
        if not data.nefc:
            return
        rows, pairs, points, forces = pressing(data, self._world)
        at = np.asarray(data.contact.efc_address)[rows]
        normal = data.efc_force[at]
        # a row accelerates by MuJoCo's reference, less its regularisation R times its force
        gain = data.efc_aref[at] - data.efc_R[at] * normal
        power = -normal * (data.efc_vel[at] + 0.5 * self._timestep * gain)
        sharp = normal * self._on_edge(data, pairs, points)
        forces[pairs[:, 0] > pairs[:, 1]] *= -1.0
        ends = np.sort(pairs, axis=1)
        keys, of = np.unique(ends @ [len(self._of_tool), 1], return_inverse=True)
        power, sharp, *force = (np.bincount(of, each) for each in (power, sharp, *forces.T))
        gap = self._steps - self._last[keys]
        before = np.where((power > 0.0) & (gap == 1), self._work[keys], 0.0)
        self._work[keys] = before + np.maximum(power, 0.0) * self._timestep
        fresh = (1.0 - self._keep) * lengths(np.stack(force, axis=1))
        self._lasting[keys] = self._keep**gap * self._lasting[keys] + fresh
        self._last[keys] = self._steps
        figures = np.stack([self._work[keys], self._lasting[keys], sharp], axis=1)
        for side in ends.T:
            np.maximum.at(self._worst[:, : len(BEARABLE)], side, figures[of])

    def _on_edge(self, data: Any, pairs: IntArray, points: FloatArray) -> BoolArray:
        """Which contacts (C,) of ``pairs`` (C, 2) at ``points`` (C, 3) are of the tool's edge."""
        if self._edge is None:
            return np.zeros(len(pairs), dtype=np.bool_)
        body = data.body("tool")
        heights = (points - body.xpos) @ (body.xmat.reshape(3, 3) @ self._edge[:3])
        return np.asarray(self._of_tool[pairs].any(axis=1) & (heights > self._edge[3]))

    def pull(
        self, fruits: Sequence[Fruit], forces: FloatArray, up: FloatArray, moments: FloatArray,
        own: FloatArray,
    ) -> BoolArray:  # fmt: skip
        """Count the loads of the stems of W fruits; returns which fruits (W,) come off.

        ``forces`` (W, 3): of each stem on its fruit [N]. ``up`` (W, 3): unit, up the stem.
        ``moments`` (W, 3): about the calyx [N m]; what turns about the stem is left out. ``own``
        (W,): pulls along the stem that detach the fruits [N].
        """
        size, most = lengths(forces), [self.crop[name] for name in DETACHING]
        along = np.einsum("wi,wi->w", forces, up)
        angles = np.rad2deg(np.arccos(np.clip(along / np.maximum(size, 1e-12), -1.0, 1.0)))
        pulls = size / self.crop.detaching(angles) * most[0] ** 2 / own
        bends = lengths(np.cross(up, moments))
        loads, entities = np.column_stack([pulls, bends]), [fruit.entity for fruit in fruits]
        np.maximum.at(self._worst[:, len(BEARABLE) :], entities, loads)
        gone = loads > most
        for w in np.flatnonzero(gone.any(axis=1)).tolist():
            pulled = f"pulled with {size[w]:.1f} N at {angles[w]:.0f} degrees"
            bent = f"bent with {bends[w]:.2g} N m"
            self.torn[fruits[w].built.key] = pulled if gone[w, 0] else bent
        return np.asarray(gone.any(axis=1))

    def figures(self) -> Mapping[str, Mapping[str, float]]:
        """The largest figure of each law, of each fruit that was shown, by id."""
        laws, worst = (*BEARABLE, *DETACHING), self._worst.tolist()
        return {f.id: dict(zip(laws, worst[f.entity], strict=True)) for f in self._world.shown}

    def borne(self) -> Iterator[tuple[str, str, float, float]]:
        """See :class:`ContactLog`."""
        for id_, mine in self.figures().items():
            yield from ((id_, name, mine[name], self.crop[name]) for name in BEARABLE)
