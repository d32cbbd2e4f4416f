"""The default planner: pick a tool path, follow it with the whole arm, judge the result."""

import time
from collections.abc import Iterator

import numpy as np

from optipromp.arrays import FloatArray
from optipromp.planning.follow import Start, Waypoints, branches, follow
from optipromp.planning.options import PlanOptions
from optipromp.planning.parameters import WAYPOINT
from optipromp.planning.prediction import push_model, pushed_aside, tool_motion
from optipromp.planning.primitive import led_through
from optipromp.planning.result import Planned, Stage
from optipromp.planning.solve import Attempt, Solver
from optipromp.planning.task import Task
from optipromp.promp.conditioning import condition
from optipromp.promp.model import ProMP
from optipromp.promp.points import JointPoint
from optipromp.pushing.model import Prediction, PushModel, search
from optipromp.pushing.parameters import PUSH
from optipromp.pushing.path import ToolPath, through
from optipromp.pushing.rules import rule_paths
from optipromp.scenes.scene import PoseGoal
from optipromp.trajectory import Trajectory

INVALID = 2.5  # harm added where the trajectory is not valid; less than that of a swallowed fruit
GOALS = 3  # goal configurations that a path is followed to, at most
TRIES = 6  # paths that are followed while no trajectory is valid
SAMPLE_ROUNDS = 4  # rounds of samples of the primitive, where no motion to a goal is valid
RULE_SPEED = PUSH.hanging.speed  # of the tool along a path that the rule gives
FEWEST, PEAK = WAYPOINT.fewest, WAYPOINT.peak


def pick(
    task: Task,
    promp: ProMP,
    options: PlanOptions,
    goals: FloatArray,
    seed: int,
    deadline: float,
) -> Planned:
    """The valid trajectory of least predicted harm; without a valid one, the best of the others.

    Args:
        task: scene and robot.
        promp: the movement primitive.
        options: see :class:`PlanOptions`.
        goals: (m, n) goal configurations, best first.
        seed: of everything random.
        deadline: of ``time.perf_counter()`` to stop at.
    """
    began = time.perf_counter()
    rng = np.random.default_rng(seed)
    model = push_model(task, goals[0])
    solver = Solver(pushed_aside(task), options, deadline, task.scene, stem_side=model is None)
    best: tuple[Attempt, Prediction | None] | None = None
    least, tries = np.inf, 0
    for path, good in tool_paths(task, model if options.prediction else None, rng, deadline):
        attempt = along(solver, path, promp, goals)
        if attempt is None:
            continue
        tries += 1
        prediction = None if model is None else _of(model, task, attempt)
        score = prediction.harm if prediction and options.prediction else 0.0
        score += 0.0 if attempt.valid else INVALID
        if best is None or score < least:
            best, least = (attempt, prediction), score
        if least <= good or solver.late() or (tries >= TRIES and not best[0].valid):
            break
    attempt, prediction = best or (freely(solver, promp, goals, rng), None)
    return outcome(attempt, prediction, time.perf_counter() - began)


def _of(model: PushModel, task: Task, attempt: Attempt) -> Prediction:
    q = attempt.trajectory.positions[attempt.start.waypoints.first :]
    return model.predict(*tool_motion(task.robot, q))


def outcome(attempt: Attempt, prediction: Prediction | None, seconds: float) -> Planned:
    """The outcome of the best attempt."""
    start, made = attempt.start, attempt.trajectory
    history = attempt.history
    stage = Stage("joint", "gauss-newton", tuple(history[0]), history, seconds, attempt.message)
    optimised = len(history) > 1
    primitive, followed = (
        Trajectory(q, made.dt, made.joint_names) for q in (start.primitive, start.followed)
    )
    return Planned(
        primitive, followed, made, start.waypoints.first, (stage,) if optimised else (), optimised,
        {"joint": seconds}, attempt.judgement, prediction,
    )  # fmt: skip


def tool_paths(
    task: Task, model: PushModel | None, rng: np.random.Generator, deadline: float
) -> Iterator[tuple[ToolPath, float]]:
    """Tool paths to the target, each with the harm that is good; none where nothing is in the way.

    The paths come from the search in the push model, or from the rule where there is no model.
    """
    if model is not None:
        assert isinstance(task.goal, PoseGoal)
        yield from search(model, task.goal.axis, rng, deadline)
    elif task.neighbours:
        for corners in rule_paths(task.scene, task.neighbours, task.robot, task.camera):
            yield through(corners, RULE_SPEED), 0.0


def along(solver: Solver, path: ToolPath, promp: ProMP, goals: FloatArray) -> Attempt | None:
    """The first valid attempt to follow a path, over the goals to which it can be followed.

    Without a valid attempt, the best one. None where the path cannot be followed.
    """
    task, options = solver.task, solver.options
    assert isinstance(task.goal, PoseGoal)
    found = branches(
        task.robot, task.start, path, task.goal.axis, goals, options.max_step, options.waypoints
    )
    best: Attempt | None = None
    for branch in found[:GOALS]:
        start = follow(
            task.robot, task.start, path, task.goal.axis, task.scene.frame[0], promp, branch
        )
        if start is None:
            continue
        attempt = solver.solve(start)
        if attempt.valid:
            return attempt
        if best is None or attempt.merit < best.merit:
            best = attempt
        if solver.late():
            break
    return best


def freely(solver: Solver, promp: ProMP, goals: FloatArray, rng: np.random.Generator) -> Attempt:
    """The first valid attempt of a reach whose tool is free on its way, or else the best."""
    best: Attempt | None = None
    for start in free_starts(solver.task, solver.options, promp, goals, rng):
        attempt = solver.solve(start)
        if best is None or attempt.valid or attempt.merit < best.merit:
            best = attempt
        if best.valid or solver.late():
            break
    assert best is not None  # there is at least one goal configuration
    return best


def free_starts(
    task: Task, options: PlanOptions, promp: ProMP, goals: FloatArray, rng: np.random.Generator
) -> Iterator[Start]:
    """The primitive conditioned on start and goal, the nearest goal first; then samples of it."""
    robot = task.robot
    order = np.argsort(np.abs(goals - task.start).max(axis=1), kind="stable")
    counts = {}
    for k in order.tolist():
        far = PEAK * float(np.abs(goals[k] - task.start).max()) / (0.8 * options.max_step)
        counts[k] = options.waypoints or int(np.clip(np.ceil(far) + 1, FEWEST, 600))
        q = led_through(promp, task.start, np.array([1.0]), goals[k][None], np.zeros(1), counts[k])
        yield Start(q, q, Waypoints(counts[k], counts[k] - 1), None)
    for _ in range(SAMPLE_ROUNDS):
        for k in order.tolist():
            ends = [JointPoint(0.0, task.start), JointPoint(1.0, goals[k])]
            (q,) = condition(promp, ends).sample(rng, 1, counts[k])
            q = np.clip(q, robot.lower, robot.upper)
            q[0], q[-1] = task.start, goals[k]
            yield Start(q, q, Waypoints(counts[k], counts[k] - 1), None)
