"""The paper's functionals F_s, F_d, F_p and F_v, which every plan reports."""

import numpy as np

from optipromp.core.arrays import FloatArray
from optipromp.core.optimization.costs import Cost
from optipromp.core.optimization.costs.joints import VelocityCost
from optipromp.core.optimization.costs.obstacles import ObstacleCost
from optipromp.core.optimization.costs.tool import PushCost
from optipromp.core.optimization.problem import Problem
from optipromp.core.planning.options import PaperOptions
from optipromp.core.planning.task import Task
from optipromp.core.scenes.scene import PoseGoal


def functionals(task: Task, options: PaperOptions, first: int, authors: bool) -> list[Cost]:
    """F_s, F_d, F_p (from waypoint ``first`` on) and F_v with their weights.

    Where the options leave the reduction and the form of F_p open, ``authors`` chooses those of the
    authors' sequential runs, or else those of the joint strategy. Without neighbours there is no
    F_p.
    """
    a = options.alphas
    reduction = options.reduction or ("max" if authors else "sum")
    push = options.push or ("reciprocal" if authors else "quadratic")
    terms: list[Cost] = [
        ObstacleCost("static", a[0], options.epsilon, reduction),
        ObstacleCost("avoid", a[1], options.epsilon, reduction),
    ]
    if task.neighbours and isinstance(task.goal, PoseGoal):
        weights = np.asarray(options.push_weights, dtype=np.float64)
        terms.append(PushCost(a[2], task.goal.position, task.scene.frame, first, weights, push))
    terms.append(VelocityCost(a[3]))
    return terms


def functional_values(
    task: Task, options: PaperOptions, first: int, q: FloatArray, authors: bool
) -> dict[str, float]:
    """The values of the functionals at a trajectory ``q`` (T, n), by name."""
    terms, cutoff = functionals(task, options, first, authors), options.epsilon
    problem = Problem(
        task.robot, task.surroundings, terms, (), len(q), cutoff=cutoff, body=task.body
    )
    return problem.evaluate(q).costs
