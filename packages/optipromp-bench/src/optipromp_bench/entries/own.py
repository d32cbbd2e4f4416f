"""Entries of ours for the tracks ``policy`` and ``picture``."""

import numpy as np

from optipromp.core.arrays import FloatArray
from optipromp.core.errors import InvalidRequestError
from optipromp.core.planning import Plan, plan
from optipromp.core.scenes.scene import Scene
from optipromp.core.trajectory import Trajectory
from optipromp_bench.entrant import Motion, Refused
from optipromp_bench.entries.planners import picked
from optipromp_bench.episode import Observation
from optipromp_eyes.pictures import DepthPicture
from optipromp_loop.pilot import GAIN, Pilot

PERIOD = 0.02  # [s] between two calls


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
        self.pilot = Pilot(scene, seed=seed)

    def act(self, seen: Observation) -> FloatArray:
        line = self.pilot.lead(seen.time, seen.q, seen.look, seen.velocity)
        ahead = line.at(seen.time + PERIOD)
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
