"""Another planner on our scenes: OMPL's RRT-Connect in joint space, its path simplified and timed.

It is a peer of the suite, called as its user would call it, and an entry of the benchmark.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.registry import NotAvailableError
from optipromp.core.arrays import FloatArray
from optipromp.core.planning import goals
from optipromp.core.planning.collision import collider, open_edge
from optipromp.core.planning.options import Timed
from optipromp.core.planning.task import Task, resolve
from optipromp.core.planning.timing import paced, shortest, slowly
from optipromp.core.pushing.parameters import PUSH
from optipromp.core.scenes.scene import Scene
from optipromp.core.trajectory import Trajectory

LONGEST = 5.0  # [s] of search: a choice; ours takes 0.2 s at most
FINE = 0.005  # share of the space between two checked configurations: a choice
STEP = 0.045  # [rad or m] between the waypoints of a timed path, as ours has
WANTED = "OMPL is not installed: pip install ompl"


@dataclass(frozen=True, eq=False)
class Answer:
    """What a planner gave for a scene: a trajectory, or why it has none.

    ``scene`` is set by ours, which may lean the tool: with the approach that it took.
    """

    trajectory: Trajectory | None
    reason: str = ""
    scene: Scene | None = None


Planner = Callable[[Scene, int], Answer]  # a scene and a seed


def grown(
    task: Task, ends: Sequence[FloatArray], free: Callable[[FloatArray], bool], seed: int
) -> FloatArray | None:
    """Corners (k, n) of a simplified way from the start to one of the free ``ends`` (n,).

    Args:
        task: with robot and start.
        ends: goal configurations, at least one.
        free: whether a configuration (n,) touches nothing that it must not.
        seed: of all random numbers of OMPL.

    Returns: None: no way was found within :data:`LONGEST`.

    Raises:
        NotAvailableError: OMPL is not installed.
    """
    try:
        from ompl import base, geometric, util
    except ImportError:
        raise NotAvailableError(WANTED) from None
    util.setLogLevel(util.LOG_NONE)
    util.RNG.setSeed(seed + 1)
    robot, n = task.robot, task.robot.n_joints
    space = base.RealVectorStateSpace(n)
    bounds = base.RealVectorBounds(n)
    for j in range(n):
        bounds.setLow(j, float(robot.lower[j]))
        bounds.setHigh(j, float(robot.upper[j]))
    space.setBounds(bounds)

    def state(q: FloatArray) -> Any:
        out = space.allocState()
        for j, value in enumerate(q):
            out[j] = float(value)
        return out

    def values(at: Any) -> FloatArray:
        return np.array([at[j] for j in range(n)])

    search = geometric.SimpleSetup(space)
    search.setStateValidityChecker(lambda at: free(values(at)))
    search.getSpaceInformation().setStateValidityCheckingResolution(FINE)
    search.setStartState(state(task.start))
    goal = base.GoalStates(search.getSpaceInformation())
    for q in ends:
        goal.addState(state(q))
    search.setGoal(goal)
    search.setPlanner(geometric.RRTConnect(search.getSpaceInformation()))
    if not search.solve(LONGEST) or not search.haveExactSolutionPath():
        return None
    search.simplifySolution()
    return np.array([values(at) for at in search.getSolutionPath().getStates()])


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


def checker(task: Task) -> Callable[[FloatArray], bool]:
    """Whether a configuration (n,) touches nothing that it must not, by our compiled check.

    The last link and the tool may touch pushables.
    """
    body, room = collider(task, task.surroundings.shared), np.empty(task.robot.n_joints)
    return lambda q: bool(open_edge(body, q, q, room))


def rrt_connect(scene: Scene, seed: int) -> Answer:
    """RRT-Connect to our goal configurations, on our collision checker; raises as :func:`grown`."""
    setup = resolve(scene)
    found, touching = goals.choose(setup, seed)  # a part of its time
    free = checker(setup)
    ends = [goal for goal in found if not touching and free(goal)]
    if not ends:
        return Answer(None, "no goal")
    path = grown(setup, ends, free, seed)
    if path is None:
        return Answer(None, f"no path within {LONGEST:g} s")
    return Answer(timed(setup, path))
