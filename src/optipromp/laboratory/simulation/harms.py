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
from collections.abc import Mapping
from typing import Any

import numpy as np

from optipromp.core.arrays import BoolArray, FloatArray, lengths
from optipromp.core.compiled import kernel
from optipromp.core.robots.tools import WALL
from optipromp.core.scenes.crops import Crop
from optipromp.laboratory.simulation.contacts import ContactLog, contact_forces
from optipromp.laboratory.simulation.grasps import scissor_of, suction_of
from optipromp.laboratory.simulation.world import World

BEARABLE = "impact_energy", "pressed_force", "edge_force"
"""Rows of a crop that tell what a fruit bears in its contacts."""
DETACHING = "abscission", "abscission_moment"
"""Rows that tell what detaches it; the figure of the first is the pull along the stem that would
come as near to it [N]."""


@kernel
def log_harms(
    geoms, addresses, frames, forces, owners, points, rates, resting, softness, timestep, keep,
    edged, edge, log, step,
):  # fmt: skip
    """Add the C contacts of step number ``step`` to ``log`` (E, E) in place.

    The first five arguments are those of :func:`contact_forces`. ``points`` (C, 3) [m]. Of the rows
    in ``forces``: ``rates``, velocities at the begin of the step, ``resting``, MuJoCo's reference
    accelerations, and ``softness``, its regularisation R; a row accelerates by resting - R f.
    ``keep``: share of the lasting force that is left after a step. ``edged`` (E,): whose edges
    count; ``edge``: a point (3,), an axis (3,), and the height along it from which on there is
    edge.
    """
    pairs, strengths = contact_forces(geoms, addresses, frames, forces, owners)
    for k in range(len(pairs)):
        a, b = pairs[k]
        power = sharp = 0.0
        for c in range(len(addresses)):
            at, one, other = addresses[c], owners[geoms[c, 0]], owners[geoms[c, 1]]
            if at < 0 or min(one, other) != a or max(one, other) != b:
                continue
            force = forces[at]
            middle = rates[at] + 0.5 * timestep * (resting[at] - softness[at] * force)
            power -= force * middle
            height = 0.0
            for j in range(3):
                height += (points[c, j] - edge[j]) * edge[3 + j]
            if (edged[a] or edged[b]) and height > edge[6]:
                sharp += force
        pair = log[a, b]
        gap = step - pair.last
        pair.work = max((pair.work if gap == 1 else 0.0) + power * timestep, 0.0)
        if power <= 0.0:
            pair.work = 0.0
        pair.yielding = keep**gap * pair.yielding + (1.0 - keep) * strengths[k]
        pair.impact_energy = max(pair.impact_energy, pair.work)
        pair.pressed_force = max(pair.pressed_force, pair.yielding)
        pair.edge_force = max(pair.edge_force, sharp)
        pair.last = step


_PAIR = np.dtype(
    [(name, np.float64) for name in ("work", "yielding", *BEARABLE)] + [("last", np.int64)]
)


class HarmLog(ContactLog):
    """Contacts, and the figures of a run that a crop's rows limit, counted step by step.

    ``world``, ``threshold``: see :class:`ContactLog`. ``crop``: of the scene.

    Attributes:
        torn: why each torn fruit came off, in words, by key.
    """

    def __init__(self, world: World, threshold: float, crop: Crop) -> None:
        super().__init__(world, threshold)
        self.crop, self.torn, self._world = crop, dict[str, str](), world
        self._keep = math.exp(-self._timestep / crop["pressed_time"])
        self._harms = np.zeros((len(world.entities),) * 2, _PAIR)
        self._pulled: dict[str, dict[str, float]] = {}
        tool = world.robot.tool
        has_edge = tool is not None and suction_of(world) is None  # a lip is soft
        self._edged = np.array([has_edge and e.kind == "tool" for e in world.entities])
        self._body, self._edge = -1, np.zeros(7)
        if tool is not None and has_edge:
            self._body = world.model.body("tool").id
            self._axis = tool.rotation[:, 2]
            self._edge[6] = tool.front if scissor_of(world) is not None else tool.tip - WALL

    def add(self, data: Any) -> None:
        """Count the contacts of ``data`` at the next step."""
        super().add(data)
        if not data.ncon:
            return
        if self._body >= 0:
            turn = data.xmat[self._body].reshape(3, 3)
            self._edge[:3], self._edge[3:6] = data.xpos[self._body], turn @ self._axis
        contact = data.contact
        log_harms(
            contact.geom, contact.efc_address, contact.frame, data.efc_force,
            self._world.geom_entity, contact.pos, data.efc_vel, data.efc_aref, data.efc_R,
            self._timestep, self._keep, self._edged, self._edge, self._harms, self._steps,
        )  # fmt: skip

    def pull(
        self, keys: list[str], forces: FloatArray, up: FloatArray, moments: FloatArray,
        own: FloatArray,
    ) -> BoolArray:  # fmt: skip
        """Count the loads of W stems; returns which fruits (W,) come off.

        ``keys``: of the fruits. ``forces`` (W, 3): of each stem on its fruit [N]. ``up`` (W, 3):
        unit, up the stem. ``moments`` (W, 3): about the calyx [N m]; what turns about the stem is
        left out. ``own`` (W,): pulls along the stem that detach the fruits [N].
        """
        size, along = lengths(forces), np.einsum("wi,wi->w", forces, up)
        angles = np.rad2deg(np.arccos(np.clip(along / np.maximum(size, 1e-12), -1.0, 1.0)))
        usual = self.crop["abscission"]
        pulls = size / self.crop.detaching(angles) * usual**2 / own
        twist = np.einsum("wi,wi->w", moments, up)
        bends = lengths(moments - twist[:, None] * up)
        gone = np.zeros(len(keys), dtype=np.bool_)
        for w, key in enumerate(keys):
            before = self._pulled.setdefault(key, dict.fromkeys(DETACHING, 0.0))
            told = dict(zip(DETACHING, (float(pulls[w]), float(bends[w])), strict=True))
            self._pulled[key] = {name: max(before[name], told[name]) for name in DETACHING}
            if told["abscission"] > self.crop["abscission"]:
                gone[w] = True
                self.torn[key] = f"pulled with {size[w]:.1f} N at {angles[w]:.0f} degrees"
            elif told["abscission_moment"] > self.crop["abscission_moment"]:
                gone[w] = True
                self.torn[key] = f"bent with {bends[w]:.2g} N m"
        return gone

    def figures(self) -> Mapping[str, Mapping[str, float]]:
        """The largest figure of each of :data:`BEARABLE`, of each fruit that was shown, by id."""
        out = {}
        for fruit in self._world.shown:
            row, column = self._harms[fruit.entity], self._harms[:, fruit.entity]
            mine = {each: float(max(row[each].max(), column[each].max())) for each in BEARABLE}
            out[fruit.id] = mine | self._pulled.get(fruit.built.key, {})
        return out

    def pressed(self, fruits: list[int], most: float) -> float:
        """The largest figure of :data:`BEARABLE` over what a fruit bears."""
        shares = (f[each] / self.crop[each] for f in self.figures().values() for each in BEARABLE)
        return max(shares, default=0.0)
