"""What every peer shares: its answer, the timing of a path, our goal configurations and checker."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from optipromp.core.arrays import FloatArray
from optipromp.core.optimization.costs.obstacles import self_overlap
from optipromp.core.optimization.evaluation import Evaluation
from optipromp.core.planning import goals
from optipromp.core.planning.options import Timed
from optipromp.core.planning.task import Task
from optipromp.core.planning.timing import paced, shortest, slowly
from optipromp.core.pushing.parameters import PUSH
from optipromp.core.scenes.scene import Scene
from optipromp.core.trajectory import Trajectory

STEP = 0.045  # [rad or m] between the waypoints of a timed path, as ours has


@dataclass(frozen=True, eq=False)
class Answer:
    """What a planner gave for a scene: a trajectory, or why it has none.

    ``scene`` is set by ours, which may lean the tool: with the approach that it took.
    """

    trajectory: Trajectory | None
    reason: str = ""
    scene: Scene | None = None


Planner = Callable[[Scene, int], Answer]  # a scene and a seed


def goal_configurations(setup: Task, seed: int) -> FloatArray:
    """Our inverse kinematics (m, n): a planner in joint space needs somewhere to go.

    Its time counts for whoever calls it. Goals that touch what they must not are left out.
    """
    found, touching = goals.choose(setup, seed)
    return found[:0] if touching else found


def timed(setup: Task, path: FloatArray) -> Trajectory:
    """A geometric path (m, n) as a trajectory: least-jerk along it, as fast as the limits allow.

    From where the tool comes near the first hanging fruit, it keeps the speed of our own plans.
    """
    lengths = np.linalg.norm(np.diff(path, axis=0), axis=1)
    along = np.concatenate([[0.0], np.cumsum(np.maximum(lengths, 1e-12))])
    count = max(20, int(np.ceil(1.9 * along[-1] / STEP)))
    tau = np.linspace(0.0, 1.0, count + 1)
    share = along[-1] * tau**3 * (10.0 - 15.0 * tau + 6.0 * tau**2)
    q = np.stack([np.interp(share, along, column) for column in path.T], axis=1)
    near = slowly(setup, q, None)
    if not (isinstance(near, np.ndarray) and near.any()):
        return shortest(setup.robot, q)
    return paced(setup, Timed(), q, int(near.argmax()), PUSH.hanging.speed)


class Checker:
    """Our collision checker for one configuration, on the kernels of the planning loop.

    What must not touch is what the judge asks: any part of the robot and static objects; B_d (all
    links but the last and the tool) and the other objects; links that are not neighbours.
    """

    def __init__(self, setup: Task) -> None:
        self.setup = setup
        self.evaluation = Evaluation(setup.robot, setup.body, 1, 1.0)
        self.proximal = ~np.asarray(setup.body.distal)

    def __call__(self, q: FloatArray) -> bool:
        """Whether the robot at ``q`` (n,) touches nothing that it must not."""
        e, around = self.evaluation, self.setup.surroundings
        e.move_to(q[None])
        e.static.measure(e, around.static, len(around.static.kind), 0.0)
        if e.static.distance.min(initial=0.0) < 0.0:
            return False
        e.dynamic.measure(e, around.dynamic, around.shared, 0.0)
        if e.dynamic.distance[:, self.proximal].min(initial=0.0) < 0.0:
            return False
        return not self_overlap(e, 0.0).any()
