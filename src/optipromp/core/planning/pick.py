"""The default planner: pick a tool path, follow it with the whole arm, optimise and judge.

The optimisation of a followed path has these costs: nearness to obstacles (F_s and F_d), joint
accelerations, and the user's own. Constraints, as stiff penalties: joint limits, clearances, the
goal, and the tool on its path.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np

from optipromp.core.arrays import FloatArray
from optipromp.core.budget import Budget, clock
from optipromp.core.judging import Judgement
from optipromp.core.optimization import gauss_newton
from optipromp.core.optimization.costs import Cost
from optipromp.core.optimization.costs.joints import LimitCost, SmoothnessCost, StepCost
from optipromp.core.optimization.costs.obstacles import ClearanceCost, ObstacleCost, SelfCost
from optipromp.core.optimization.costs.tool import CorridorCost, GoalCost, LevelCost, UprightCost
from optipromp.core.optimization.evaluation import Evaluation
from optipromp.core.optimization.problem import Problem
from optipromp.core.planning import follow, ways
from optipromp.core.planning.follow import Start
from optipromp.core.planning.goals import clearance, narrow, passed_over
from optipromp.core.planning.options import PlanOptions
from optipromp.core.planning.parameters import SOLVE
from optipromp.core.planning.result import Harmful, Planned, Stage
from optipromp.core.planning.task import Task, pushed_aside
from optipromp.core.planning.timing import slowly, timed
from optipromp.core.planning.underway import rest, straight
from optipromp.core.planning.verdict import Led, harm_of, judged, led, prediction
from optipromp.core.promp.model import ProMP
from optipromp.core.pushing.model import Prediction, PushModel
from optipromp.core.pushing.parameters import PUSH
from optipromp.core.pushing.path import ToolPath, through
from optipromp.core.pushing.rules import DriftRule, rule_paths
from optipromp.core.pushing.searching import search
from optipromp.core.scenes.scene import JointGoal, PoseGoal, Scene
from optipromp.core.trajectory import Trajectory

INVALID = 2.5  # harm added where the trajectory is not valid; less than that of a swallowed fruit
GOALS = 3  # goal configurations that a path is followed to, at most
FEW_TRIES = 2  # paths that are followed on one approach of several
TRIES = 6  # paths that are followed while no trajectory is valid
RULE_SPEED = PUSH.hanging.speed  # of the tool along a path that the rule gives


def pick(
    task: Task, promp: ProMP, options: PlanOptions, goals: FloatArray, budget: Budget,
    sparing: bool = False,
) -> Planned | Harmful:  # fmt: skip
    """The valid trajectory of least predicted harm; without a valid one, the best of the others.

    Args:
        task: to be solved.
        promp: the primitive.
        options: see :class:`PlanOptions`.
        goals: configurations (m, n), best first.
        budget: of the plan.
        sparing: paths that do harm by themselves are not followed.
    """
    began = clock()
    rng = np.random.default_rng(task.seed)
    model = task.push_model(goals[0])
    solver = Solver(pushed_aside(task), options, budget, task.scene, stem_side=model is None)
    best: tuple[Attempt, tuple[PushModel, Led] | None, float] | None = None
    least, tries = np.inf, 0
    known = model if options.prediction else None
    found: Iterable[tuple[ToolPath, float]] = (
        [(task.only, np.inf)]
        if task.only is not None
        else tool_paths(task, known, rng, budget, options.rule, lambda good: least <= good)
    )
    spared: list[ToolPath] = []
    for path, good in found:
        if sparing and known is not None and path.harm > known.threshold:
            spared.append(path)
            continue
        begin: Iterator[Start] = follow.starts(task, path, promp, options, goals, GOALS)
        if path is task.kept:
            begin = chain(rest(task, options), begin)
        attempt = first_valid(solver, begin)
        if attempt is None:
            continue
        done = attempt.valid or solver.budget.spent()
        if not done and clearance(solver.task, attempt.reach).min() < 0.0:
            begin = ways.led_round(solver.task, attempt.start, options, rng, budget)
            attempt = first_valid(solver, begin) or attempt
        tries += 1
        harm, push = 0.0, None
        if model is not None:
            own = task.push_model(attempt.trajectory.positions[-1]) or model
            push = own, led(task, own, attempt.trajectory)
            harm = harm_of(*push)
        score = harm if options.prediction else 0.0
        if path is task.kept:  # another one must be better by as much
            unchanged = task.same and attempt.trajectory is task.running
            score = max(score - (model.threshold if model and unchanged else good), 0.0)
        if attempt.narrow:  # worse than all that keep the margin, better than what does harm
            score = max(score, 0.0 if model is None else model.threshold) + attempt.narrow
        score += 0.0 if attempt.valid else INVALID
        if best is None or score < least:
            best, least = (attempt, push, harm), score
        enough = tries >= (FEW_TRIES if sparing else TRIES) and (sparing or not best[0].roomy)
        if least <= good or solver.budget.spent() or enough:
            break
    if best is not None:
        attempt, push, harm = best
        attempt = replace(attempt, judgement=passed_over(attempt.judgement, solver.left))
        told = None if push is None else prediction(*push, harm)
        return outcome(attempt, told, clock() - began)
    if spared:
        least_harm = min(spared, key=lambda path: path.harm)
        return Harmful(replace(task, only=least_harm, sparing=False))
    free = ways.free_starts(solver.task, options, promp, goals, rng, budget)
    attempt = first_valid(solver, chain(rest(task, options), free))
    assert attempt is not None  # there is at least one goal configuration
    return outcome(attempt, None, clock() - began)


def outcome(attempt: Attempt, prediction: Prediction | None, seconds: float) -> Planned:
    """The outcome of the best attempt."""
    start, made = attempt.start, attempt.trajectory
    history = attempt.history
    stage = Stage("joint", "gauss-newton", tuple(history[0]), history, seconds, attempt.message)
    optimised = len(history) > 1 or start.running is not None  # or it was, as it began
    primitive, followed = (
        Trajectory.through(q, made.times, made.joint_names)
        for q in (start.primitive, start.followed)
    )
    return Planned(
        made, start.waypoints.first, primitive, followed, (stage,) if optimised else (), optimised,
        {"joint": seconds}, attempt.judgement, prediction,
    )  # fmt: skip


def tool_paths(
    task: Task,
    model: PushModel | None,
    rng: np.random.Generator,
    budget: Budget,
    rule: DriftRule,
    serves: Callable[[float], bool],
) -> Iterator[tuple[ToolPath, float]]:
    """Tool paths to the target, each with the harm that is good; none where nothing is in the way.

    The path that runs already comes first. Others come from the search in the push model, or from
    the ``rule`` where there is no model.
    """
    if task.kept is not None:
        yield task.kept, PUSH.harm.good
    if task.entry is not None and not task.neighbours:
        yield straight(task), PUSH.harm.good
    elif model is not None:
        yield from search(model, task.axes, rng, budget, serves)
    elif task.neighbours:
        for corners in rule_paths(task.scene, task.neighbours, task.robot, task.camera, rule):
            yield through(corners, RULE_SPEED), 0.0


def first_valid(solver: Solver, starts: Iterable[Start]) -> Attempt | None:
    """The first valid attempt that keeps the margin from static objects.

    Without one the best of the first ones that are valid, or before time runs out; None without
    starts.
    """
    best: Attempt | None = None
    for count, start in enumerate(starts, 1):
        attempt = solver.solve(start)
        if best is None or attempt.rank < best.rank:
            best = attempt
        if best.roomy or solver.budget.spent() or (best.valid and count >= GOALS):
            break
    return best


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
        narrow: what it lacks of the margin from static objects, where another goal configuration
            may have more room [m].
        fast: whether the tool may be too fast among fruits.
    """

    start: Start
    trajectory: Trajectory
    judgement: Judgement
    merit: float
    history: tuple[dict[str, float], ...]
    message: str
    fast: bool
    narrow: float = 0.0

    @property
    def valid(self) -> bool:
        """Whether the judge found no violation, but for a speed that is asked for."""
        return all(self.fast and v.kind == "speed" for v in self.judgement.violations)

    @property
    def roomy(self) -> bool:
        """Whether it is valid and keeps the margin from static objects."""
        return self.valid and not self.narrow

    @property
    def rank(self) -> tuple[bool, float]:
        """Sort key: valid before invalid; then by the margin, or by the objective."""
        return not self.valid, self.narrow if self.valid else self.merit

    @property
    def reach(self) -> FloatArray:
        """Waypoints (T, n) up to the first on the path."""
        return self.trajectory.positions[: self.start.waypoints.first + 1]


class Solver:
    """Optimises starts of one task; keeps its arrays from one start to the next.

    Of valid trajectories without the margin from static objects the judgements are in ``left``.

    Args:
        task: scene and robot.
        options: see :class:`PlanOptions`.
        budget: of the plan.
        scene: in which the result is judged.
        stem_side: whether passing a stem on its side is a fault; see :func:`judging.judge`.
    """

    def __init__(
        self, task: Task, options: PlanOptions, budget: Budget, scene: Scene, *, stem_side: bool
    ) -> None:
        self.task, self.options, self.budget = task, options, budget
        self.scene, self.stem_side = scene, stem_side
        self.left: list[Judgement] = []
        self._arrays: dict[int, Evaluation] = {}

    def solve(self, start: Start) -> Attempt:
        """Optimise a start and judge the result."""
        settings = schedule(self.options)
        task, count = self.task, start.waypoints.count
        if count not in self._arrays:
            self._arrays[count] = Evaluation(task.robot, task.body, count, 1.0 / (count - 1))
        problem = following(task, self.options, start, self._arrays[count])
        value = problem.evaluate(start.followed, settings.stages[-1])
        if self.options.iterations == 0 or self.budget.spent() or start.running is not None:
            return self._judged(start, start.followed, value.merit, (value.costs,), "")
        if settings.keeps(value):
            last = slice(-1, None)
            result = gauss_newton.solve(problem, start.followed, settings, self.budget, last, value)
        else:
            settings = replace(settings, damping=SOLVE.far_damping, tolerance=SOLVE.far_tolerance)
            result = gauss_newton.solve(problem, start.followed, settings, self.budget)
        history = (value.costs, *result.history[1:])
        return self._judged(start, result.q, result.value.merit, history, result.message)

    def _judged(
        self, start: Start, q: FloatArray, merit: float, history: tuple[dict[str, float], ...],
        message: str,
    ) -> Attempt:  # fmt: skip
        task, path = self.task, start.path
        first, speed = (None, None) if path is None else (start.waypoints.first, path.speed)
        slow = slowly(task, q, first)
        trajectory = start.running or timed(task, self.options, q, slow, speed)
        verdict = judged(replace(task, scene=self.scene), trajectory, stem_side=self.stem_side)
        short, fast = narrow(task, verdict, q[-1]), self.options.timed
        self.left += [] if verdict.violations or not short else [verdict]
        return Attempt(start, trajectory, verdict, merit, history, message, fast, short)


def following(task: Task, options: PlanOptions, start: Start, arrays: Evaluation) -> Problem:
    """The problem of a start: obstacles, smoothness, limits, the user's costs, the tool path."""
    robot, first = task.robot, start.waypoints.first
    costs: list[Cost] = [
        ObstacleCost("static", 1.0, SOLVE.safety, "sum"),
        ObstacleCost("avoid", 1.0, SOLVE.safety, "sum"),
        ObstacleCost("tool avoid", 1.0, SOLVE.safety, "sum"),
        SmoothnessCost(options.smoothness),
        *options.costs,
    ]
    touch = ClearanceCost("touch", "static", SOLVE.must, SOLVE.touch_margin)
    constraints = limits_and_clearances(task, options, touch)
    if isinstance(task.goal, PoseGoal):
        constraints.append(GoalCost(SOLVE.must, task.goal.position, task.goal.axis))
    if start.path is not None and isinstance(task.goal, PoseGoal):
        points, axes = robot.tool_pose(start.followed)
        if task.scene.approach.lead is None:
            axes = task.goal.axis[None]
        constraints += [
            CorridorCost(SOLVE.kept, points, np.eye(3), options.corridor, first, SOLVE.within),
            UprightCost(SOLVE.lean, axes, np.deg2rad(SOLVE.upright), first),
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
