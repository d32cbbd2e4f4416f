"""The default planner: pick a tool path, follow it with the whole arm, optimise and judge.

The costs of the optimisation are nearness to obstacles (F_s and F_d), joint accelerations, and the
user's costs. Its constraints, as stiff penalties, are joint limits, clearances, the goal, and the
tool on its path.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain
from operator import attrgetter

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
from optipromp.core.planning import follow
from optipromp.core.planning.goals import clearance
from optipromp.core.planning.options import Optimised, Searched
from optipromp.core.planning.parameters import PICK, SOLVE
from optipromp.core.planning.result import Planned, Proposal, Stage, best_of
from optipromp.core.planning.task import Task, pushed_aside
from optipromp.core.planning.timing import paced
from optipromp.core.planning.underway import rest, straight
from optipromp.core.planning.verdict import PushMotion, harm_of, judged, led, prediction
from optipromp.core.promp.model import ProMP
from optipromp.core.pushing.model import Prediction, PushModel
from optipromp.core.pushing.parameters import PUSH
from optipromp.core.pushing.path import ToolPath, through
from optipromp.core.pushing.rules import rule_paths
from optipromp.core.pushing.searching import search
from optipromp.core.scenes.scene import PoseGoal
from optipromp.core.trajectory import Trajectory


def pick(
    task: Task, promp: ProMP, options: Searched, goals: FloatArray, budget: Budget,
    sparing: bool = False, only: ToolPath | None = None, beyond: float = np.inf,
) -> Planned | Proposal[Planned]:  # fmt: skip
    """The valid trajectory of least predicted harm; without a valid one, the best of the others.

    ``goals``: configurations (m, n), best first. ``sparing``: a path whose predicted harm is above
    the threshold is not followed. The answer is a proposal where all paths are such.
    ``only``: the tool path to follow; None: a search finds the paths. ``beyond``: the least harm of
    the paths out of the arm's reach so far.
    """
    began = clock()
    rng = np.random.default_rng(task.seed)
    solver = Solver(task, options, budget, task.push_model(goals[0]))
    refused, scores = list[ToolPath](), list[float]()
    most = PICK.few_tries if sparing else PICK.tries
    good = np.inf

    def followed() -> Iterator[Attempt]:
        nonlocal beyond, good
        found = tool_paths(solver, rng, lambda good: min(scores, default=np.inf) <= good)
        for path, good in found if only is None else [(only, np.inf)]:
            if sparing and solver.searched and path.harm > solver.searched.threshold:
                refused.append(path)
                continue
            attempt = follow_path(solver, path, promp, goals, rng)
            if attempt is None:
                beyond = min(beyond, path.harm if solver.searched else np.inf)
                continue
            attempt = scored(solver, attempt, good)
            scores.append(attempt.score)
            yield attempt

    def enough(best: Attempt) -> bool:
        if best.score <= good or budget.spent():
            return True
        return len(scores) >= most and (sparing or not best.valid)

    best = best_of(followed(), attrgetter("score"), enough)
    if best is None and refused:
        path = min(refused, key=lambda path: path.harm)
        again = partial(pick, task, promp, options, goals, budget, False, path, beyond)
        return Proposal(path.harm, again)
    if best is None:
        free = chain(
            rest(task, options),
            follow.free_starts(solver.cleared, options, promp, goals, rng, budget),
        )
        best = first_valid(solver, (follow.constrained(solver.cleared, start) for start in free))
        assert best is not None  # there is at least one goal configuration
    push = None if best.push is None else prediction(*best.push, best.harm)
    return replace(outcome(best, push, clock() - began), beyond=beyond)


def tool_paths(
    solver: Solver, rng: np.random.Generator, serves: Callable[[float], bool]
) -> Iterator[tuple[ToolPath, float]]:
    """Tool paths to the target, each with the harm that counts as good at that time.

    There is none where nothing is in the way. The path of the running plan comes first. The search
    in the push model gives the other paths, or ``options.rule`` where there is no model.
    """
    task, rule = solver.task, solver.options.rule
    if task.underway.kept is not None:
        yield task.underway.kept, PUSH.harm.good
    if task.underway.entry is not None and not task.neighbours:
        yield straight(task), PUSH.harm.good
    elif solver.searched is not None:
        yield from search(solver.searched, task.axes, rng, solver.budget, serves)
    elif task.neighbours:
        for corners in rule_paths(task.scene, task.neighbours, task.robot, task.camera, rule):
            yield through(corners, PUSH.hanging.speed), 0.0


def follow_path(
    solver: Solver, path: ToolPath, promp: ProMP, goals: FloatArray, rng: np.random.Generator
) -> Attempt | None:
    """The best attempt to follow a path with the whole arm; None: the path is out of reach.

    Where the arm touches something before the path, ways round obstacles are tried too.
    """
    task, options, budget = solver.task, solver.options, solver.budget
    starts: Iterator[follow.Start] = follow.starts(task, path, promp, options, goals, PICK.goals)
    if path is task.underway.kept:
        starts = chain(rest(task, options), starts)
    attempt = first_valid(solver, starts)
    if attempt is None or attempt.valid or budget.spent():
        return attempt
    reach = attempt.trajectory.positions[: attempt.start.waypoints.first + 1]
    if clearance(solver.cleared, reach).min() < 0.0:
        round_obstacles = follow.led_round(solver.cleared, attempt.start, options, rng, budget)
        attempt = first_valid(solver, round_obstacles) or attempt
    return attempt


def first_valid(solver: Solver, starts: Iterable[follow.Start]) -> Attempt | None:
    """The first valid attempt, or the best when the budget is spent; None where there is no start.

    Of attempts that are not valid, the one of least objective is the best.
    """
    return best_of(
        map(solver.solve, starts),
        lambda attempt: (not attempt.valid, attempt.merit),
        lambda best: best.valid or solver.budget.spent(),
    )


@dataclass(frozen=True, eq=False)
class Attempt:
    """A start and the trajectory that was optimised from it."""

    start: follow.Start  # of the optimisation
    trajectory: Trajectory  # the optimised one, with its timing
    judgement: Judgement  # of the trajectory
    valid: bool  # whether the judge found no violation; a speed that the options ask for is none
    merit: float  # value of the objective
    # value of each cost after each iteration, the start first
    history: tuple[dict[str, float], ...]
    message: str  # why the solver stopped
    # the push model for where the attempt ends, and the motion that the model predicts; None
    # without a model
    push: tuple[PushModel, PushMotion] | None = None
    harm: float = 0.0  # predicted harm
    # harm by which attempts on several tool paths are compared; see :func:`scored`
    score: float = np.inf


def scored(solver: Solver, attempt: Attempt, good: float) -> Attempt:
    """An attempt with its predicted harm and its score.

    The score is the predicted harm, or 0 without ``options.prediction``. The score of the running
    plan's path is lower by ``good``, or by the model's threshold where nothing changed. The score
    of a trajectory that is not valid is higher by ``PICK.invalid``.
    """
    task, model = solver.task, solver.model
    harm, push = 0.0, None
    if model is not None:
        at_end = task.push_model(attempt.trajectory.positions[-1]) or model
        push = at_end, led(task, at_end, attempt.trajectory)
        harm = harm_of(*push)
    threshold = 0.0 if model is None else model.threshold
    score = harm if solver.options.prediction else 0.0
    if attempt.start.path is task.underway.kept:
        unchanged = task.underway.same and attempt.trajectory is task.underway.running
        score = max(score - (threshold if model is not None and unchanged else good), 0.0)
    if not attempt.valid:
        score += PICK.invalid
    return replace(attempt, push=push, harm=harm, score=score)


def outcome(attempt: Attempt, prediction: Prediction | None, seconds: float) -> Planned:
    """The outcome of the best attempt, of a search that took ``seconds`` [s]."""
    start, made, history = attempt.start, attempt.trajectory, attempt.history
    stage = Stage("joint", "gauss-newton", tuple(history[0]), history, seconds, attempt.message)
    optimised = len(history) > 1 or start.running is not None  # a running motion was optimised
    primitive, followed = (
        Trajectory.through(q, made.times, made.joint_names)
        for q in (start.primitive, start.followed)
    )
    return Planned(
        made, start.waypoints.first, primitive, followed, (stage,) if optimised else (), optimised,
        {"joint": seconds}, attempt.judgement, prediction,
    )  # fmt: skip


class Solver:
    """Optimises starts of one task; keeps its arrays from one start to the next.

    ``task``: to be solved. The optimisation sees it without the objects that the tool pushes aside
    before the arm comes (``cleared``); the judge sees all. ``options``: see :class:`Searched`.
    ``budget``: of the plan. ``model``: of the push. Without a model, passing a stem on its side is
    a fault (:func:`judging.judge`).
    """

    def __init__(
        self, task: Task, options: Searched, budget: Budget, model: PushModel | None
    ) -> None:
        self.task, self.options, self.budget, self.model = task, options, budget, model
        self.searched = model if options.prediction else None  # for tool paths
        self.cleared = follow.uprighted(pushed_aside(task))
        self._arrays: dict[int, Evaluation] = {}

    def solve(self, start: follow.Start) -> Attempt:
        """Optimise a start and judge the result."""
        settings = schedule(self.options)
        task, count = self.cleared, start.waypoints.count
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
        self, start: follow.Start, q: FloatArray, merit: float,
        history: tuple[dict[str, float], ...], message: str,
    ) -> Attempt:  # fmt: skip
        options, path = self.options, start.path
        trajectory = start.running
        if trajectory is None:
            first, speed = (None, None) if path is None else (start.waypoints.first, path.speed)
            trajectory = paced(self.task, options, q, first, speed)
        judgement = judged(self.task, trajectory, stem_side=self.model is None)
        valid = all(options.timed and v.kind == "speed" for v in judgement.violations)
        return Attempt(start, trajectory, judgement, valid, merit, history, message)


def following(task: Task, options: Searched, start: follow.Start, arrays: Evaluation) -> Problem:
    """The optimisation problem of a start: costs and constraints as the module lists them."""
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
    path = task.scene.path
    constraints += follow.path_costs(path, start.waypoints.count)
    fixed = path is not None or not isinstance(task.goal, PoseGoal)
    if isinstance(task.goal, PoseGoal) and not fixed:
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
        cutoff=max(SOLVE.safety, options.static_clearance, options.avoid_clearance) + 1e-3,  # [m]
        end_fixed=fixed, evaluation=arrays,
    )  # fmt: skip


def limits_and_clearances(task: Task, options: Optimised, *further: Cost) -> list[Cost]:
    """Constraints of every problem of a task: joint limits, steps, ``further``, clearances."""
    robot, proximal = task.robot, ~np.asarray(task.body.distal)
    return [
        LimitCost(SOLVE.must, *robot.limits(options.limit_margin)),
        StepCost(SOLVE.firm, np.full(robot.n_joints, options.max_step)),
        *further,
        ClearanceCost("clearance", "static", 2 * SOLVE.kept, options.static_clearance),
        ClearanceCost("avoid", "dynamic", SOLVE.firm, options.avoid_clearance, proximal),
        ClearanceCost("tool avoid", "dynamic", SOLVE.wish, 0.0, ~proximal),
        SelfCost(SOLVE.firm, options.self_clearance),
    ]


def opposite(task: Task) -> tuple[int, int]:
    """Two body spheres of a tool with fingers, which are to stand level.

    They are far apart along the opening of the fingers, and near each other across it.
    """
    robot = task.robot
    assert robot.tool is not None
    mine = np.flatnonzero(robot.spheres.link == len(robot.link_names) - 1)
    opens = robot.flange_rotation @ robot.tool.rotation[:, 1]
    center = robot.spheres.center[mine]
    between = center - center[:, None]
    along = between @ opens
    aside = np.linalg.norm(between - along[..., None] * opens, axis=-1)
    low, high = np.unravel_index(np.argmax(along - PICK.level * aside), along.shape)
    first = task.body.tool - len(mine)  # the tool's spheres come last
    return first + int(low), first + int(high)


def schedule(options: Optimised) -> gauss_newton.GaussNewtonOptions:
    """The solver's default schedule, or ``options.iterations`` divided over its stages."""
    usual = gauss_newton.GaussNewtonOptions()
    if options.iterations is None:
        return usual
    share = [options.iterations // len(usual.stages)] * len(usual.stages)
    share[-1] += options.iterations - sum(share)
    return replace(usual, iterations=tuple(share))
