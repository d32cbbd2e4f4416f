"""The simulated arm as an executor: curves are followed in the physics of a scene."""

import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress

from optipromp.core.errors import ExecutionError
from optipromp.core.execution.executor import Follower, Guard
from optipromp.core.robots.model import Robot
from optipromp.core.scenes.scene import Scene
from optipromp.core.trajectory import State
from optipromp.laboratory.simulation.outcome import Outcome
from optipromp.laboratory.simulation.parameters import SimulationParameters
from optipromp.laboratory.simulation.simulation import Simulation


class SimulatedArm(Follower):
    """An arm in the simulation of a scene; fruits hang, swing and tear as in ``simulate``.

    Args:
        scene: in which the arm moves, from the scene's start.
        robot: with its tool; None: the scene's.
        parameters: of the physics.
        guard: when to refuse a motion and when to stop.
        seed: of everything random.
        real_time: whether a simulated second takes a second; else it takes as long as it needs.

    Attributes:
        simulation: in which the arm moves.

    Raises:
        InvalidRequestError: MuJoCo is not installed.
        InvalidSceneError: something in the scene cannot be built.
    """

    def __init__(
        self,
        scene: Scene,
        robot: Robot | None = None,
        parameters: SimulationParameters | None = None,
        guard: Guard | None = None,
        *,
        seed: int = 0,
        real_time: bool = False,
    ) -> None:
        self.simulation = Simulation(scene, seed, parameters, robot=robot)
        super().__init__(self.simulation.robot, guard)
        self._real_time = real_time

    @property
    def time(self) -> float:
        """Simulated time [s]."""
        return self.simulation.time

    def state(self) -> State:
        """Simulated positions and velocities; the acceleration is the commanded one."""
        return self.simulation.state()

    @contextmanager
    def stream(self) -> Iterator[Iterator[float]]:
        """See :class:`Follower`."""
        yield self._ticks()

    def command(self, reference: State) -> None:
        """See :class:`Follower`."""
        self.simulation.reference = reference

    def _ticks(self) -> Iterator[float]:
        began, wall = self.time, time.perf_counter()
        while True:
            yield self.time - began
            with suppress(ExecutionError):
                self.simulation.step(self.simulation.reference)
            if self.simulation.broken:
                return
            if self._real_time:
                time.sleep(max(0.0, self.time - began - (time.perf_counter() - wall)))

    def outcome(self) -> Outcome:
        """Stand still for ``control.hold``, then judge all that happened so far."""
        return self.simulation.outcome()
