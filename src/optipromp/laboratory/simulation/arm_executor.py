"""The simulated arm as an executor: curves are followed in the physics of a scene."""

import time
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from optipromp.core.execution.executor import Follower, Guard
from optipromp.core.planning.task import posed
from optipromp.core.robots.model import Robot
from optipromp.core.scenes.scene import Scene
from optipromp.core.trajectory import State, Trajectory
from optipromp.laboratory.simulation.outcome import Outcome, judge
from optipromp.laboratory.simulation.parameters import SimulationParameters
from optipromp.laboratory.simulation.rollout import Execution, quiet
from optipromp.laboratory.simulation.world import build


class SimulatedArm(Follower):
    """An arm in the simulation of a scene; fruits hang, swing and tear as in ``simulate``.

    Args:
        scene: in which the arm moves, from the scene's start.
        robot: with its tool; None: the scene's.
        parameters: of the physics.
        guard: when to refuse a motion and when to stop.
        seed: of everything random.
        real_time: whether a simulated second takes a second; else it takes as long as it needs.

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
        robot, state = posed(scene, robot)
        super().__init__(robot, guard)
        self._world = build(scene, robot, parameters or SimulationParameters(), seed)
        still = Trajectory.through(np.tile(state.q, (2, 1)), 1.0, robot.joint_names)
        self._execution, self._real_time = Execution(self._world, still, 100.0), real_time
        self._asked = State(state.q)
        self._execution.record(self._world.drives.segments(state.q[None])[0])

    @property
    def time(self) -> float:
        """Simulated time [s]."""
        return float(self._execution.data.time)

    def state(self) -> State:
        """Simulated positions and velocities; the acceleration is the commanded one."""
        drives, at = self._world.drives, self._execution.at
        q, velocity = drives.joints(at.q[None])[0], drives.joints(at.velocity[None], rates=True)[0]
        return State(q, velocity, self._asked.acceleration)

    @contextmanager
    def stream(self) -> Iterator[Iterator[float]]:
        """See :class:`Follower`."""
        with quiet(self._execution.mujoco):
            yield self._ticks()

    def command(self, reference: State) -> None:
        """See :class:`Follower`."""
        self._asked = reference

    def _ticks(self) -> Iterator[float]:
        began, wall = self.time, time.perf_counter()
        while True:
            yield self.time - began
            if not self._tick():
                return
            if self._real_time:
                time.sleep(max(0.0, self.time - began - (time.perf_counter() - wall)))

    def _tick(self) -> bool:
        """One period of the controller; False after a warning of the engine."""
        drives, asked = self._world.drives, self._asked
        q = drives.segments(asked.q[None])[0]
        rate = drives.segments(asked.velocity[None], rates=True)[0]
        gain = drives.segments(asked.acceleration[None], rates=True)[0]
        return all(self._execution.advance(q, rate, gain, q) for _ in range(self._execution.tick))

    def outcome(self) -> Outcome:
        """Stand still for ``control.hold``, then judge all that happened so far."""
        self._asked = State(self._asked.q)
        moved = self.time
        control = self._world.parameters.control
        with quiet(self._execution.mujoco):
            for _ in range(round(control.hold * control.rate)):
                if not self._tick():
                    break
        return judge(self._world, self._execution.rollout(moved), self._execution.log)
