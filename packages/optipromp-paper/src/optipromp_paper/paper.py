"""The paper's own planner as a value; :mod:`optipromp_paper.paper_stages` solves."""

from dataclasses import dataclass, replace
from typing import ClassVar

from optipromp.core.budget import Budget
from optipromp.core.planning.planners import WAY, goal_configurations
from optipromp.core.planning.primitive import learnt
from optipromp.core.planning.result import Answer
from optipromp.core.planning.task import Task, pushed_aside
from optipromp.core.promp.basis import Basis
from optipromp_paper.paper_costs import PaperSettings, reported
from optipromp_paper.paper_costs import PushCost as PushCost

PAPER_BASIS = Basis(count=5, width=4.0, outside=1)


@dataclass(frozen=True)
class Paper(PaperSettings):
    """OptI-ProMP as the paper has it: its functionals under its constraints."""

    name: ClassVar[str] = "paper"
    ignores: ClassVar[tuple[str, ...]] = WAY

    def solve(self, task: Task, budget: Budget) -> Answer:
        from optipromp_paper.paper_stages import solve  # with SciPy's optimisers

        promp = learnt(task, task.demonstrations, PAPER_BASIS)
        chosen = goal_configurations(pushed_aside(task), budget)
        if not len(chosen.q):
            return chosen.failed
        budget.say(f"optimising ({self.strategy})")
        made = solve(task, promp, self, chosen.q, budget)
        return chosen.told(replace(made, terms=reported(task, self, made)))
