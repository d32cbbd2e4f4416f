r"""A primitive of the tool's path: a few weights of bumps off the straight approach.

With the height h from 0 at the entry (the camera point) to 1 at the target, and bumps
:math:`\phi_k(h)` that vanish at both ends, the path is off the straight line by

.. math:: \sum_k \phi_k(h)\,(w_{1k}\, x_g + w_{2k}\, y_g) .

The arm follows the path as it follows every path of a search, and the judge judges the motion.
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from optipromp.core.arrays import FloatArray, frozen
from optipromp.core.budget import Budget
from optipromp.core.errors import InvalidRequestError
from optipromp.core.planning.planners import OptiProMP
from optipromp.core.planning.result import Answer, Plan
from optipromp.core.planning.task import Task, tool_motion
from optipromp.core.pushing.parameters import PUSH
from optipromp.core.pushing.path import ToolPath, through

COUNT = 5  # bumps on each of two axes: a choice
REACH = 0.06  # [m] of a weight of 1: a choice; searched paths stay within
POINTS = 60  # of a path: a choice


def bumps(height: FloatArray) -> FloatArray:
    """Values (m, COUNT) of the bumps at heights (m,) between 0 and 1."""
    centers = np.linspace(0.15, 0.85, COUNT)
    width = 0.6 * (centers[1] - centers[0])
    values = np.exp(-0.5 * ((height[:, None] - centers) / width) ** 2)
    return np.asarray(values * np.minimum(1.0, 8.0 * height * (1.0 - height))[:, None])


def path_of(task: Task, weights: FloatArray) -> ToolPath:
    """The tool path of weights (2, COUNT) for a task."""
    weights = np.asarray(weights, dtype=np.float64)
    if weights.shape != (2, COUNT) or not np.isfinite(weights).all():
        raise InvalidRequestError(f"weights have shape {weights.shape}; must be (2, {COUNT})")
    height = np.linspace(0.0, 1.0, POINTS)
    line = task.camera + height[:, None] * (task.goal.position - task.camera)  # type: ignore[union-attr]
    off = REACH * bumps(height) @ weights.T
    return through(line + off @ task.scene.frame[:2], PUSH.hanging.speed)


def weights_of(plan: Plan) -> FloatArray:
    """The weights (2, COUNT) whose path is nearest to the tool's in a plan (least squares)."""
    task = plan.task
    points, _ = tool_motion(plan.robot, plan.trajectory.positions[plan.first :])
    line = task.goal.position - task.camera  # type: ignore[union-attr]
    height = (points - task.camera) @ line / (line @ line)
    within = (height > 0.0) & (height < 1.0)
    if within.sum() < COUNT:
        return np.zeros((2, COUNT))
    off = points[within] - task.camera - height[within, None] * line
    rows = REACH * bumps(height[within])
    flat = off @ task.scene.frame[:2].T
    ridge = rows.T @ rows + 1e-6 * np.eye(COUNT)
    return frozen(np.linalg.solve(ridge, rows.T @ flat).T)


@dataclass(frozen=True, eq=False)
class OfWeights(OptiProMP):
    """A planner that follows the path of given ``weights`` (2, COUNT), and searches none."""

    weights: FloatArray | None = None
    name: ClassVar[str] = "primitive"

    @property
    def approaches(self) -> bool:
        """No other approach is tried: the weights are of this one."""
        return False

    def solve(self, task: Task, budget: Budget, only: ToolPath | None = None) -> Answer:
        given = np.zeros((2, COUNT)) if self.weights is None else self.weights
        return super().solve(task, budget, only or path_of(task, given))
