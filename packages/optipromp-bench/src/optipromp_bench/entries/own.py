"""Entries of ours for the tracks ``policy`` and ``picture``."""

import numpy as np

from optipromp.core.arrays import FloatArray
from optipromp.core.errors import InvalidRequestError
from optipromp.core.execution.executor import standing
from optipromp.core.execution.streaming import Line
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
        self.line: Line | None = None
        self.newest = -np.inf

    def act(self, seen: Observation) -> FloatArray:
        if seen.look is not None and seen.look.time > self.newest:
            self.controller.see(seen.look)
            self.newest = seen.look.time
        line, controller = self.line, self.controller
        line = line or Line.of(standing(controller.robot, State(seen.q)), seen.time)
        made = controller(seen.time, State(seen.q, seen.velocity), line.at(seen.time))
        if made is not None:
            line = line.take(made, seen.time, anew=controller.lost)
        self.line, ahead = line, line.at(seen.time + PERIOD)
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
