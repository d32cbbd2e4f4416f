"""The paper's functionals F_s, F_d, F_p and F_v of a task, and their values along a trajectory."""

import numpy as np

from optipromp.arrays import FloatArray
from optipromp.optimization.costs import Cost
from optipromp.optimization.costs.joints import VelocityCost
from optipromp.optimization.costs.obstacles import ObstacleCost, Reduction
from optipromp.optimization.costs.tool import PushCost, PushForm
from optipromp.optimization.problem import Problem
from optipromp.planning.paper_options import PaperOptions
from optipromp.planning.task import Task
from optipromp.scenes.scene import PoseGoal


def functionals(
    task: Task, options: PaperOptions, first: int, reduction: Reduction, push: PushForm
) -> list[Cost]:
    """F_s, F_d, F_p (from waypoint ``first`` on) and F_v with their weights.

    There is no F_p without neighbours to push past.
    """
    a = options.alphas
    terms: list[Cost] = [
        ObstacleCost("static", a[0], options.epsilon, reduction),
        ObstacleCost("avoid", a[1], options.epsilon, reduction),
    ]
    if task.neighbours and isinstance(task.goal, PoseGoal):
        terms.append(
            PushCost(
                a[2], task.goal.position, task.scene.frame, first,
                np.asarray(options.push_weights, dtype=np.float64), push,
            )
        )  # fmt: skip
    terms.append(VelocityCost(a[3]))
    return terms


def values(
    task: Task, options: PaperOptions, first: int, q: FloatArray, paper: bool
) -> dict[str, float]:
    """The functionals at one trajectory (T, n), by their names."""
    reduction: Reduction = options.reduction or ("max" if paper else "sum")
    push: PushForm = options.push or ("reciprocal" if paper else "quadratic")
    terms = functionals(task, options, first, reduction, push)
    problem = Problem(
        task.robot, task.surroundings, terms, (), len(q), cutoff=options.epsilon, body=task.body
    )
    return problem.evaluate(q).costs
