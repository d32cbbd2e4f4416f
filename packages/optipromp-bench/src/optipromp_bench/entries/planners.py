"""Registered planners as entries."""

from typing import Any, ClassVar

import numpy as np

from optipromp.core.planning import Plan, plan
from optipromp.core.planning.legs import plan_pick
from optipromp.core.planning.planners import Planner
from optipromp.core.planning.result import RETREAT
from optipromp.core.scenes.scene import Scene
from optipromp.core.trajectory import Trajectory
from optipromp.timing import LEAST, gentle
from optipromp_bench.entrant import Motion, Refused

PREDICTING = "opti-promp", "obstacles"
"""Planners that predict harm, and refuse by it. The others know no harm: their motion is executed
whatever the judge of this library says, as slow near fruits as ours."""


def gentle_plan(made: Plan, scene: Scene) -> Trajectory | None:
    """A plan's motion made gentle; None where the plan stands still."""
    own = made.trajectory
    if float(np.ptp(own.positions, axis=0).max()) == 0.0:
        return None
    q, _, _ = own.sample(np.linspace(0.0, own.duration, LEAST))
    return gentle(scene, q)


UNLIKELY = 0.5  # of a failed pick, which costs as much as a clean one counts


def picked(
    scene: Scene, seed: int, planner: str | Planner = "opti-promp"
) -> Plan | Motion | Refused:
    """A pick that leaves by the way of least harm; refused where it is rather not clean."""
    legs = plan_pick(scene, planner=planner, seed=seed)
    if len(legs.legs) == 1:
        return legs.reach
    if legs.failure > UNLIKELY:
        return Refused(f"{legs.status}: {legs.message}")
    back = legs.legs.get(RETREAT)
    return Motion(legs.reach.trajectory, back.trajectory if back and back.valid else None)


class OfPlanner:
    """A planner as an entry: one that is registered, or one of its own."""

    planner: ClassVar[str | Planner]

    def plan(self, scene: Scene, seed: int) -> Plan | Motion | Refused | Trajectory | None:
        if self.planner in PREDICTING:
            return picked(scene, seed, self.planner)
        return gentle_plan(plan(scene, planner=self.planner, seed=seed), scene)


def __getattr__(name: str) -> Any:
    from optipromp_bench.entries import PLANNERS

    for planner in PLANNERS:
        if planner.title().replace("-", "") == name:
            return type(name, (OfPlanner,), {"planner": planner})
    raise AttributeError(name)
