"""Entries of ours for the tracks ``policy`` and ``picture``."""

import numpy as np

from optipromp.core.arrays import FloatArray
from optipromp.core.errors import InvalidRequestError
from optipromp.core.execution.streaming import Stretch
from optipromp.core.planning import Plan, plan
from optipromp.core.scenes.scene import Scene
from optipromp.core.trajectory import State, Trajectory
from optipromp_bench.entrant import Motion, Refused
from optipromp_bench.entries.planners import picked
from optipromp_bench.episode import Observation
from optipromp_eyes.pictures import DepthPicture
from optipromp_loop.control.controller import Controller

PERIOD = 0.02  # [s] between two calls
GAIN = 2.0  # [1/s] of the joints' error of position: a choice


class Blind:
    """Plan once in what was seen first, and follow that plan whatever is seen later."""

    def reset(self, scene: Scene, seed: int) -> None:
        self.motion: Trajectory = plan(scene, seed=seed).trajectory

    def act(self, seen: Observation) -> FloatArray:
        now = min(seen.time, self.motion.duration)
        q, velocity, _ = (row[0] for row in self.motion.sample(now))
        return np.asarray(velocity + GAIN * (q - seen.q))


class Closed:
    """The closed loop: look, plan, go, look again, and follow the plant to the end and out."""

    leaves = True

    def reset(self, scene: Scene, seed: int) -> None:
        self.controller = Controller(scene, seed=seed)
        self.running: Stretch | None = None
        self.coming: list[Stretch] = []
        self.newest = -np.inf

    def act(self, seen: Observation) -> FloatArray:
        if seen.look is not None and seen.look.time > self.newest:
            self.controller.see(seen.look)
            self.newest = seen.look.time
        state = State(seen.q, seen.velocity)
        reference = state if self.running is None else self.running.at(seen.time)
        made = self.controller(seen.time, state, reference)
        if made is not None:
            self.coming.append(made)
        then = seen.time + PERIOD
        while self.coming and self.coming[0].begins <= then:
            self.running = self.coming.pop(0)
        if self.running is None:
            return np.zeros(len(seen.q))
        ahead = self.running.at(then)
        return np.asarray(ahead.velocity + GAIN * (ahead.q - seen.q - PERIOD * seen.velocity))


class ByEyes:
    """See one picture by geometry, and plan in the scene that it shows."""

    def plan(
        self, picture: DepthPicture, known: Scene, seed: int
    ) -> Plan | Motion | Refused | None:
        from optipromp_eyes.eyes import look_at, seen_scene

        try:
            scene, _ = seen_scene(look_at(picture, up=known.up), known)
        except InvalidRequestError:  # no ripe fruit is seen
            return None
        return picked(scene, seed)
