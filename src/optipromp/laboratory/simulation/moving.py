"""Where the objects of a world are at a record of a run, for pictures and replays."""

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from optipromp.core.arrays import FloatArray
from optipromp.core.scenes.scene import SceneObject
from optipromp.laboratory.simulation.engine import engine
from optipromp.laboratory.simulation.world import World


class Displaced(NamedTuple):
    """An object at its place of a moment."""

    item: SceneObject
    position: FloatArray  # (3,) [m]
    rotation: FloatArray  # (3, 3)
    stem: FloatArray | None  # (k, 3) points, root first [m]


class Moving:
    """The objects of a ``world`` that move."""

    def __init__(self, world: World) -> None:
        self.world, self._data = world, world.data(world.robot.home)
        self._items = {item.id: item for item in world.scene.objects}

    def at(self, state: FloatArray) -> Iterator[Displaced]:
        """The objects where MuJoCo's generalised positions are ``state`` (nq,)."""
        data = self._data
        data.qpos[:] = state
        engine().mj_kinematics(self.world.model, data)
        for fruit in self.world.shown:
            place, turn = np.array(data.xpos[fruit.body]), data.xmat[fruit.body].reshape(3, 3)
            yield Displaced(self._items[fruit.id], place, turn, self._stem(fruit))

    def _stem(self, fruit: Any) -> FloatArray | None:
        """The present points (k, 3) of a fruit's stem, root first [m]; None without a stem."""
        world, data = self.world, self._data
        if fruit.stem_entity < 0:
            return None
        geoms = np.flatnonzero(world.geom_entity == fruit.stem_entity)
        turns = data.geom_xmat[geoms].reshape(-1, 3, 3)
        half = world.model.geom_size[geoms, 1:2] * turns[:, :, 2]
        ends = np.stack([data.geom_xpos[geoms] - half, data.geom_xpos[geoms] + half], axis=1)
        root = fruit.built.nodes[0]
        flipped = np.linalg.norm(ends[0, 1] - root) < np.linalg.norm(ends[0, 0] - root)
        ends = ends[:, ::-1] if flipped else ends
        return np.asarray(np.concatenate([ends[:, 0], ends[-1:, 1]]))
