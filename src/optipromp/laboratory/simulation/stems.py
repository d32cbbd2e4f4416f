"""Stems that hold their fruits up to a pull at which they tear."""

from typing import Any

import numpy as np

from optipromp.core.arrays import BoolArray, FloatArray
from optipromp.laboratory.simulation.grasps import between_blades, carried_by
from optipromp.laboratory.simulation.kernels import note_pulls
from optipromp.laboratory.simulation.rollout import StemCut
from optipromp.laboratory.simulation.trusses import tops
from optipromp.laboratory.simulation.world import Fruit, World

_SIGN = -1.0  # of a pull up the stem in the rows of MuJoCo's weld


class StemWatch:
    """The stems that hold a fruit, the largest pull along each, and the fruits that came off.

    Attributes:
        torn: time at which each torn fruit came off, by key [s].
    """

    def __init__(self, world: World) -> None:
        self._world = world
        self.torn: dict[str, float] = {}
        self._torn_by: dict[str, float] = {}
        fruits = [fruit for fruit in world.fruits if fruit.weld >= 0]
        self._by_id = {fruit.id: fruit for fruit in fruits}
        self._tops = tops(world.scene.objects)
        self._truss_force = world.parameters.stem.truss_force
        self._hold(fruits, np.zeros(len(fruits)))

    def _hold(self, fruits: list[Fruit], tension: FloatArray) -> None:
        self._fruits, self._tension = fruits, tension
        self._last = np.array([f.last for f in fruits], dtype=np.int64)
        self._along = np.array([f.along for f in fruits]).reshape(-1, 3, 1)
        self._abscission = np.array([f.built.abscission for f in fruits], dtype=np.float64)
        names = [self._tops.get(f.id, "") for f in fruits]
        self._trusses = [
            np.array([name == top for name in names]) for top in sorted({*names} - {""})
        ]

    @property
    def tension(self) -> dict[str, float]:
        """Largest pull along each stem, by key [N]."""
        keys = [fruit.built.key for fruit in self._fruits]
        return self._torn_by | dict(zip(keys, self._tension.tolist(), strict=True))

    def tear(self, data: Any) -> None:
        """Cut the stem of each fruit that is pulled beyond its threshold."""
        count = len(self._fruits)
        if not count:
            return
        up = data.xmat.take(self._last, axis=0).reshape(-1, 3, 3) @ self._along
        # welds are the only equalities, six rows each, in order, the active ones first
        forces = data.efc_force[: 6 * count].reshape(-1, 1, 6)[:, :, :3]
        pulls = _SIGN * (forces @ up).ravel()
        torn = note_pulls(pulls, self._abscission, self._tension)
        gone = pulls > self._abscission
        for mine in self._trusses:  # a truss comes off whole where none of its fruits does
            if not (gone & mine).any() and float(pulls[mine].sum()) > self._truss_force:
                gone, torn = gone | mine, True
        if torn:
            self._cut(data, gone)

    def close(self, data: Any) -> StemCut:
        """Close the blades of the scissor: fruits beyond the stems between them come off."""
        pieces, between = between_blades(self._world, data)
        beyond = carried_by(self._world, pieces)
        bodies = {
            fruit.body for fruit, is_off in zip(self._world.fruits, beyond, strict=True) if is_off
        }
        gone = np.array([fruit.body in bodies for fruit in self._fruits], dtype=np.bool_)
        off = [self._fruits[i].built.key for i in np.flatnonzero(gone)]
        if off:
            self._cut(data, gone)
            self.torn = {key: time for key, time in self.torn.items() if key not in off}
        return StemCut(tuple(off), tuple(between), float(data.time))

    def cut(self, data: Any, fruit: Fruit) -> None:
        """Cut the stem of a fruit on purpose: it does not count as torn."""
        mine = np.array([one.built.key == fruit.built.key for one in self._fruits], dtype=np.bool_)
        if mine.any():
            self._cut(data, mine)
            del self.torn[fruit.built.key]

    def _cut(self, data: Any, gone: BoolArray) -> None:
        for i in np.flatnonzero(gone):
            fruit, key = self._fruits[i], self._fruits[i].built.key
            data.eq_active[fruit.weld] = 0
            data.qfrc_applied[fruit.dofs] -= (fruit.built.grown - fruit.built.bare).ravel()
            for carrier, torque in fruit.built.carried_by.items():
                data.qfrc_applied[self._by_id[carrier].dofs] -= torque.ravel()
            self.torn[key] = float(data.time)
            self._torn_by[key] = float(self._tension[i])
        held = np.flatnonzero(~gone)
        self._hold([self._fruits[i] for i in held], self._tension[held])
