"""OMPL's RRT-Connect in joint space, on our collision checker, its path simplified."""

from typing import Any

import numpy as np

from benchmarks.peers.common import Answer, Checker, Planner, goal_configurations, timed
from benchmarks.registry import NotAvailableError
from optipromp.core.planning.task import resolve
from optipromp.core.scenes.scene import Scene

LONGEST = 5.0  # [s] of search


def rrt_connect(fruits: bool) -> Planner:
    """RRT-Connect to our goal configurations.

    Args:
        fruits: whether pushables are obstacles to the whole robot; else only to all but the last
            link and the tool, which may push.

    Raises:
        NotAvailableError: OMPL is not installed.
    """
    try:
        from ompl import base, geometric, util
    except ImportError as error:
        raise NotAvailableError(f"ompl is not installed ({error})") from error
    util.setLogLevel(util.LOG_NONE)

    def solve(scene: Scene, seed: int) -> Answer:
        util.RNG.setSeed(seed + 1)
        setup = resolve(scene)
        goals = goal_configurations(setup, seed)
        free = Checker(setup, fruits)
        ends = [goal for goal in goals if free(goal)]
        if not ends:
            return Answer(None, "every goal configuration touches a fruit" if fruits else "no goal")
        n = setup.robot.n_joints
        space = base.RealVectorStateSpace(n)
        bounds = base.RealVectorBounds(n)
        for j in range(n):
            bounds.setLow(j, float(setup.robot.lower[j]))
            bounds.setHigh(j, float(setup.robot.upper[j]))
        space.setBounds(bounds)
        problem = geometric.SimpleSetup(space)
        problem.setStateValidityChecker(lambda state: free(_values(state, n)))
        problem.getSpaceInformation().setStateValidityCheckingResolution(0.005)
        problem.setStartState(_state(space, setup.start))
        states = base.GoalStates(problem.getSpaceInformation())
        for end in ends:
            states.addState(_state(space, end))
        problem.setGoal(states)
        problem.setPlanner(geometric.RRTConnect(problem.getSpaceInformation()))
        if not problem.solve(LONGEST) or not problem.haveExactSolutionPath():
            return Answer(None, f"no path within {LONGEST:g} s")
        problem.simplifySolution()
        path = np.array([_values(state, n) for state in problem.getSolutionPath().getStates()])
        return Answer(timed(setup, path))

    return solve


def _values(state: Any, n: int) -> Any:
    return np.array([state[j] for j in range(n)])


def _state(space: Any, q: Any) -> Any:
    state = space.allocState()
    for j, value in enumerate(q):
        state[j] = float(value)
    return state
