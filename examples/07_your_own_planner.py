"""A planner of your own: planned with, judged, simulated, and compared in a study.

A planner is any object with `solve(task, budget)`. The task has the scene, the robot with its tool,
the state it starts in, the goal and the push model; `plan` does the rest: it judges the motion,
predicts the push and tells the status. Here the arm goes straight in its joints to each goal
configuration in turn, slowly, and the best by the library's own verdict is taken.

`register` makes it known in this process. A package makes its planner known to everyone who
installs it by an entry point in its pyproject.toml; it then appears in `optipromp list`,
`optipromp plan --planner line`, `optipromp bench study` and on the page too, with its settings:

    [project.entry-points."optipromp.planners"]
    line = "my_package.planner:Line"

    python examples/07_your_own_planner.py
"""

import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np

from optipromp import plan
from optipromp.core.budget import Budget
from optipromp.core.planning import Failed, Planned, register
from optipromp.core.planning.planners import goal_configurations
from optipromp.core.planning.task import Task
from optipromp.core.planning.timing import shortest
from optipromp.core.planning.verdict import verdict
from optipromp_bench.experiments.study import Study, run_study


@dataclass(frozen=True)
class Line:
    """Straight in the joints to the goal configuration whose motion is judged best.

    Attributes:
        speed: largest speed of the tool [m/s].
        waypoints: of the line.
    """

    speed: float = 0.1
    waypoints: int = 60
    name: ClassVar[str] = "line"  # that its plans tell

    def solve(self, task: Task, budget: Budget) -> Planned | Failed:
        """The harmless motion that ends soonest; without one the first."""
        goals = goal_configurations(task, budget)
        if not len(goals.q):
            return goals.failed
        share = np.linspace(0.0, 1.0, self.waypoints)[:, None]
        best, rank = None, (True, np.inf)
        for goal in goals.q:
            line = task.start + share * (goal - task.start)
            motion = shortest(task.robot, line, 0, self.speed)
            found = verdict(task, motion).status != "success", motion.duration
            if best is None or found < rank:
                best, rank = motion, found
            if budget.spent():
                break
        return Planned(best)


if __name__ == "__main__":
    made = plan("scenario-3", planner=Line(speed=0.15))
    print(made.planner, made.status, made.message)
    print(f"{made.trajectory.duration:.1f} s, predicted harm {made.prediction.harm:.2f}")

    register("line", Line)  # by its name, from now on
    assert plan("scenario-3", planner="line").planner == "line"

    try:
        from optipromp import simulate

        print("simulated:", simulate(made).outcome.message)
        with tempfile.TemporaryDirectory() as folder:
            study = Study(("cluster",), ("line", "opti-promp"), (0, 2))
            for row in run_study(study, Path(folder), workers=1):
                print(row.preset, row.seed, row.planner, row.plan_status, row.success)
    except ImportError:
        print("for the simulation: install packages/optipromp-sim")
