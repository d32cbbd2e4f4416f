"""Registered planners as entries."""

from typing import Any, ClassVar

from optipromp.bench.entries.motions import gentle_plan
from optipromp.core.planning import Plan, plan
from optipromp.core.scenes.scene import Scene
from optipromp.core.trajectory import Trajectory

PREDICTING = "opti-promp", "obstacles"
"""Planners that predict harm, and refuse by it. The others know no harm: their motion is executed
whatever the judge of this library says, as slow near fruits as ours."""


class OfPlanner:
    """A registered planner as an entry."""

    planner: ClassVar[str]

    def plan(self, scene: Scene, seed: int) -> Plan | Trajectory | None:
        """See :class:`optipromp.bench.tracks.Planning`."""
        made = plan(scene, planner=self.planner, seed=seed)
        return made if self.planner in PREDICTING else gentle_plan(made, scene)


def __getattr__(name: str) -> Any:
    from optipromp.bench.entries import PLANNERS

    for planner in PLANNERS:
        if planner.title().replace("-", "") == name:
            return type(name, (OfPlanner,), {"planner": planner})
    raise AttributeError(name)
