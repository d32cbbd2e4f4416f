"""The second engine in the place of the simulation: what an episode asks of its world."""

import math

import numpy as np

from optipromp.bench.flight import FRUIT_FORCE, STEM_TIME, Flight, Word
from optipromp.core.arrays import BoolArray, FloatArray, frozen
from optipromp.core.errors import ExecutionError, InvalidRequestError
from optipromp.core.planning.task import posed
from optipromp.core.scenes.io import scene_to_dict
from optipromp.core.scenes.scene import Scene
from optipromp.core.trajectory import State
from optipromp.laboratory.simulation.contacts import HarmSoFar
from optipromp.laboratory.simulation.simulation import FruitStates

TICK = 0.001  # [s] of a reference, as of the main simulation's controller


class FlightWorld:
    """A scene in the second engine, with the methods of the simulation that an episode calls.

    The arm is where its reference is. Plants stand still: conditions that move them, or change
    their physics, are of the first engine alone.
    """

    def __init__(self, scene: Scene, seed: int = 0) -> None:
        self.scene, self.tick, self.broken = scene, TICK, False
        self.robot, self.reference = posed(scene)
        try:
            self._flight = Flight(scene_to_dict(scene), self.reference.q, seed)
        except ValueError as error:
            raise InvalidRequestError(f"the second engine: {error}") from None
        self._items = {item.id: item for item in scene.objects}

    @property
    def time(self) -> float:
        """Since the beginning [s]."""
        return self._flight.time

    def step(self, reference: State) -> State:
        """Lead the cup to a reference within one tick; returns the state after it."""
        self.reference = reference
        try:
            self._flight.to(reference.q, TICK)
        except RuntimeError as error:
            self.broken = True
            raise ExecutionError(str(error)) from None
        return self.state()

    def state(self) -> State:
        """The reference."""
        return self.reference

    def fruits(self) -> FruitStates:
        """The targets and pushables now; velocities are not told (zero)."""
        ids = tuple(self._flight.ids)
        places = [self._flight.place(name) for name in ids]
        turns = [
            turn @ self._items[k].rotation for k, (_, turn, _) in zip(ids, places, strict=True)
        ]
        attached: BoolArray = np.ones(len(ids), dtype=np.bool_)
        return FruitStates(
            ids, tuple(self._items[name].role for name in ids),
            frozen(np.array([place for place, _, _ in places]).reshape(-1, 3)),
            frozen(np.array(turns).reshape(-1, 3, 3)),
            frozen(np.zeros((len(ids), 3))), attached, tuple(frozen(s) for _, _, s in places),
        )  # fmt: skip

    def held(self) -> tuple[str, ...]:
        """The fruits in the cup now."""
        return tuple(filter(self._flight.inside, self._flight.ids))

    def wrench(self) -> FloatArray:
        """(6,) of the world on the tool: force [N], and zeros."""
        return np.concatenate([self._flight.pushed(), np.zeros(3)])

    def harm(self) -> HarmSoFar:
        """What was harmed so far."""
        words = self._flight.harm()
        fruit, stem = self._flight.shares()
        static = 2.0 * any(word.endswith("touched") for word in words)
        return HarmSoFar(fruit / FRUIT_FORCE, stem / STEM_TIME, static)

    def outcome(self) -> Word:
        """Stand still for a moment, and judge all that happened."""
        if self.broken or not math.isfinite(self.time):
            return Word(False, (), ("the engine broke down",), math.nan)
        return self._flight.outcome()
