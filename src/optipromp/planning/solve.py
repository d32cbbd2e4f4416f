"""The optimisation of a followed path in the default planner, and the judgement of its result.

Costs: nearness to obstacles (F_s and F_d), joint accelerations, and the user's own costs.
Constraints, as stiff penalties: joint limits, clearances, the goal, and the tool on its path.
"""

import time
from dataclasses import dataclass, replace

import numpy as np

from optipromp import judging
from optipromp.arrays import FloatArray
from optipromp.judging import Judgement
from optipromp.optimization import gauss_newton
from optipromp.optimization.costs import Cost
from optipromp.optimization.costs.joints import LimitCost, SmoothnessCost, StepCost
from optipromp.optimization.costs.obstacles import ClearanceCost, ObstacleCost, SelfCost
from optipromp.optimization.costs.tool import CorridorCost, GoalCost, LevelCost, UprightCost
from optipromp.optimization.evaluation import Evaluation
from optipromp.optimization.problem import Problem
from optipromp.planning.follow import Start
from optipromp.planning.options import PlanOptions
from optipromp.planning.parameters import SOLVE
from optipromp.planning.task import Task
from optipromp.planning.timing import timed
from optipromp.scenes.scene import JointGoal, PoseGoal, Scene
from optipromp.trajectory import Trajectory


@dataclass(frozen=True, eq=False)
class Attempt:
    """A start and the trajectory that was optimised from it.

    Attributes:
        start: of the optimisation.
        trajectory: the optimised one, with its timing.
        judgement: of the trajectory.
        merit: value of the objective.
        history: value of each cost after each iteration, the start first.
        message: why the solver stopped.
    """

    start: Start
    trajectory: Trajectory
    judgement: Judgement
    merit: float
    history: tuple[dict[str, float], ...]
    message: str

    @property
    def valid(self) -> bool:
        """Whether the judge found no violation."""
        return not self.judgement.violations


class Solver:
    """Optimises starts of one task; keeps its arrays from one start to the next.

    Args:
        task: scene and robot.
        options: see :class:`PlanOptions`.
        deadline: of ``time.perf_counter()``.
        scene: in which the result is judged.
        stem_side: whether passing a stem on its side is a fault; see :func:`judging.judge`.
    """

    def __init__(
        self, task: Task, options: PlanOptions, deadline: float, scene: Scene, *, stem_side: bool
    ) -> None:
        self.task, self.options, self.deadline = task, options, deadline
        self.scene, self.stem_side = scene, stem_side
        self._arrays: dict[int, Evaluation] = {}

    def late(self) -> bool:
        """Whether time has run out."""
        return time.perf_counter() > self.deadline

    def solve(self, start: Start) -> Attempt:
        """Optimise a start and judge the result."""
        settings = schedule(self.options)
        task, count = self.task, start.waypoints.count
        if count not in self._arrays:
            self._arrays[count] = Evaluation(task.robot, task.body, count, 1.0 / (count - 1))
        problem = following(task, self.options, start, self._arrays[count])
        value = problem.evaluate(start.followed, settings.stages[-1])
        if self.options.iterations == 0 or self.late():
            return self._judged(start, start.followed, value.merit, (value.costs,), "")
        if settings.keeps(value):
            last = slice(-1, None)
            result = gauss_newton.solve(
                problem, start.followed, settings, self.deadline, last, value
            )
        else:
            settings = replace(settings, damping=SOLVE.far_damping, tolerance=SOLVE.far_tolerance)
            result = gauss_newton.solve(problem, start.followed, settings, self.deadline)
        history = (value.costs, *result.history[1:])
        return self._judged(start, result.q, result.value.merit, history, result.message)

    def _judged(
        self, start: Start, q: FloatArray, merit: float, history: tuple[dict[str, float], ...],
        message: str,
    ) -> Attempt:  # fmt: skip
        task = self.task
        slow = None if start.path is None else q[start.waypoints.first :]
        speed = np.inf if start.path is None else self.options.approach_speed or start.path.speed
        trajectory = timed(task.robot, q, self.options.duration, slow, speed)
        verdict = judging.judge(
            self.scene, task.robot, trajectory, task.start, stem_side=self.stem_side
        )
        return Attempt(start, trajectory, verdict, merit, history, message)


def following(task: Task, options: PlanOptions, start: Start, arrays: Evaluation) -> Problem:
    """The problem of a start: obstacles, smoothness, limits, the user's costs, the tool path."""
    robot, first = task.robot, start.waypoints.first
    costs: list[Cost] = [
        ObstacleCost("static", 1.0, SOLVE.safety, "sum"),
        ObstacleCost("avoid", 1.0, SOLVE.safety, "sum"),
        SmoothnessCost(options.smoothness),
        *options.costs,
    ]
    touch = ClearanceCost("touch", "static", SOLVE.must, SOLVE.touch_margin)
    constraints = limits_and_clearances(task, options, touch)
    if isinstance(task.goal, PoseGoal):
        constraints.append(GoalCost(SOLVE.must, task.goal.position, task.goal.axis))
    if start.path is not None and isinstance(task.goal, PoseGoal):
        points, _ = robot.tool_pose(start.followed)
        constraints += [
            CorridorCost(SOLVE.kept, points, np.eye(3), options.corridor, first, SOLVE.within),
            UprightCost(SOLVE.lean, task.goal.axis, np.deg2rad(SOLVE.upright), first),
        ]
        if robot.tool is not None and robot.tool.fingers:
            pair = opposite(task)
            constraints.append(LevelCost(SOLVE.wish, pair, task.scene.frame[0], first))
    return Problem(
        robot, task.surroundings, costs, constraints, start.waypoints.count,
        cutoff=max(SOLVE.safety, options.static_clearance, options.avoid_clearance) + 1e-3,
        end_fixed=isinstance(task.goal, JointGoal), body=task.body, evaluation=arrays,
    )  # fmt: skip


def limits_and_clearances(task: Task, options: PlanOptions, *further: Cost) -> list[Cost]:
    """Constraints of every problem of a task: joint limits, steps, ``further`` ones, clearances."""
    robot, proximal = task.robot, ~np.asarray(task.body.distal)
    margin = np.minimum(options.limit_margin, 0.25 * (robot.upper - robot.lower))
    return [
        LimitCost(SOLVE.must, robot.lower + margin, robot.upper - margin),
        StepCost(SOLVE.firm, np.full(robot.n_joints, options.max_step)),
        *further,
        ClearanceCost("clearance", "static", 2 * SOLVE.kept, options.static_clearance),
        ClearanceCost("avoid", "dynamic", SOLVE.firm, options.avoid_clearance, proximal),
        ClearanceCost("tool avoid", "dynamic", SOLVE.wish, 0.0, ~proximal),
        SelfCost(SOLVE.firm, options.self_clearance),
    ]


def opposite(task: Task) -> tuple[int, int]:
    """Two spheres of a tool with fingers, one on either side, which are to stand level.

    The two that are farthest apart along the opening, and alike otherwise.
    """
    robot = task.robot
    assert robot.tool is not None
    mine = np.flatnonzero(robot.spheres.link == len(robot.link_names) - 1)
    opens = robot.flange_rotation @ robot.tool.rotation[:, 1]
    center = robot.spheres.center[mine]
    between = center - center[:, None]
    along = between @ opens
    aside = np.linalg.norm(between - along[..., None] * opens, axis=-1)
    low, high = np.unravel_index(np.argmax(along - 10.0 * aside), along.shape)
    first = task.body.tool - len(mine)  # the tool's spheres come last
    return first + int(low), first + int(high)


def schedule(options: PlanOptions) -> gauss_newton.GaussNewtonOptions:
    """The solver's own schedule, or ``options.iterations`` divided over its stages."""
    usual = gauss_newton.GaussNewtonOptions()
    if options.iterations is None:
        return usual
    share = [options.iterations // len(usual.stages)] * len(usual.stages)
    share[-1] += options.iterations - sum(share)
    return replace(usual, iterations=tuple(share))
