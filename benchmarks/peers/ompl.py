"""OMPL's RRT-Connect in joint space, its path simplified: for a peer and for entries."""

from collections.abc import Callable, Sequence
from importlib.util import find_spec
from typing import Any

import numpy as np

from benchmarks.peers.common import Answer, Checker, Planner, goal_configurations, timed
from benchmarks.registry import NotAvailableError
from optipromp.core.arrays import FloatArray
from optipromp.core.planning.task import Task, resolve
from optipromp.core.scenes.scene import Scene

LONGEST = 5.0  # [s] of search: a choice; ours takes 0.2 s at most
FINE = 0.005  # share of the space between two checked configurations: a choice
WANTED = "OMPL is not installed: pip install ompl"


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


def rrt_connect() -> Planner:
    """RRT-Connect to our goal configurations, on our collision checker.

    Raises:
        NotAvailableError: OMPL is not installed.
    """
    if find_spec("ompl") is None:
        raise NotAvailableError(WANTED)

    def solve(scene: Scene, seed: int) -> Answer:
        setup = resolve(scene)
        goals = goal_configurations(setup, seed)
        free = Checker(setup)
        ends = [goal for goal in goals if free(goal)]
        if not ends:
            return Answer(None, "no goal")
        path = grown(setup, ends, free, seed)
        if path is None:
            return Answer(None, f"no path within {LONGEST:g} s")
        return Answer(timed(setup, path))

    return solve
