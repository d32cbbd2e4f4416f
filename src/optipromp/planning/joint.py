"""The joint strategy: all terms and constraints in one constrained solve, from several starts.

Starts differ in the inverse-kinematics branch of the goal, in the side on which undecided pushables
are passed and, where those are not enough, in samples of the ProMP. They are solved together: all
through the first stage of penalty stiffness, those close to the best to the end.
"""

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from optipromp import metrics
from optipromp.arrays import FloatArray
from optipromp.metrics import Judgement
from optipromp.optimization.evaluation import Evaluation
from optipromp.optimization.problem import Problem, Value
from optipromp.optimization.solvers import gauss_newton
from optipromp.planning.build import Knots, joint_problem
from optipromp.planning.options import PlanOptions
from optipromp.planning.primitives import conditioned, detection_variance, on_branch, via_points
from optipromp.planning.setup import Setup
from optipromp.planning.stages import Outcome, Stage
from optipromp.promp.model import ProMP
from optipromp.pushing.sides import Drift, drift_choices
from optipromp.trajectory import Trajectory, shortest_dt

LEVER_ARM = 0.4  # [m] turns a deviation of the tool into one of the joints
PEAK = 1.9  # largest over mean speed of a smooth reach
FEWEST, MOST = 60, 600  # knots
CLOSE = 1.3  # a start within this factor of the best one after the first stage goes on


@dataclass(frozen=True, eq=False)
class Start:
    """An initial trajectory (T, n) with the sides it is to pass pushables on."""

    q: FloatArray
    drift: Drift
    knots: Knots


@dataclass(frozen=True, eq=False)
class Attempt:
    """A start and what became of it."""

    start: Start
    problem: Problem
    q: FloatArray
    value: Value
    history: tuple[dict[str, float], ...]
    message: str = ""


def knots_for(
    setup: Setup, options: PlanOptions, start: FloatArray, via: FloatArray | None, goal: FloatArray
) -> Knots:
    """Knots such that no joint moves much over the wanted step, before t_1 and after alike."""
    step = 0.8 * options.max_step
    if via is None or len(via) < 2:
        reach = PEAK * float(np.max(np.abs(goal - start))) / step
        count = options.knots or int(np.clip(np.ceil(reach) + 1, FEWEST, MOST))
        return Knots(count, options.camera_phase or 0.5)
    reach = PEAK * float(np.max(np.abs(via[0] - start))) / step
    approach = 1.6 * float(np.max(np.abs(np.diff(via, axis=0)), axis=1).sum()) / step
    reach, approach = max(reach, 25.0), max(approach, 50.0)
    count = options.knots or int(np.clip(10 * np.ceil((reach + approach) / 10), FEWEST, MOST))
    phase = options.camera_phase or float(np.clip(reach / (reach + approach), 0.3, 0.75))
    return Knots(count, phase)


def starts(setup: Setup, promp: ProMP, options: PlanOptions, goals: FloatArray) -> Iterator[Start]:
    """A start for each goal configuration (m, n) and each choice of sides, in that order."""
    choices = sides(setup, options)
    for goal in goals:
        q, knots = initial(setup, promp, options, goal)
        for drift in choices:
            yield Start(q, drift, knots)


def sides(setup: Setup, options: PlanOptions) -> tuple[Drift, ...]:
    """Every choice of sides for the neighbours of a setup."""
    return drift_choices(
        setup.scene,
        setup.neighbours,
        options.drift,
        window=options.window,
        depth=getattr(setup.robot.tool, "depth", 0.0),
    )


def initial(
    setup: Setup, promp: ProMP, options: PlanOptions, goal: FloatArray
) -> tuple[FloatArray, Knots]:
    """The ProMP conditioned on start, camera point, pushables and one goal configuration."""
    posterior, knots = conditioned_on_goal(setup, promp, options, goal)
    return settled(posterior.mean_trajectory(knots.count), setup.start, goal), knots


def conditioned_on_goal(
    setup: Setup, promp: ProMP, options: PlanOptions, goal: FloatArray
) -> tuple[ProMP, Knots]:
    """The conditioned ProMP of one goal configuration, and the knots it asks for."""
    branch = None
    if setup.neighbours:
        positions = [thing.position for thing in setup.neighbours]
        via = via_points(setup, positions, 0.5, options.via_deviation)
        branch = on_branch(setup, via, goal)
    knots = knots_for(setup, options, setup.start, branch, goal)
    if branch is None:
        return conditioned(
            promp, setup.start, np.array([1.0]), goal[None], np.zeros(1)
        ), knots  # fmt: skip
    phases = np.linspace(knots.camera_phase, 1.0, len(branch))
    variances = (via.deviations / LEVER_ARM) ** 2
    variances[1:-1] += [detection_variance(t) / LEVER_ARM**2 for t in setup.neighbours]
    return conditioned(promp, setup.start, phases, branch, variances), knots


def settled(q: FloatArray, start: FloatArray, goal: FloatArray) -> FloatArray:
    """``q`` with exact ends (a conditioned ProMP meets them to rounding)."""
    out = np.array(q)
    out[0], out[-1] = start, goal
    return out


def sampled_starts(
    setup: Setup,
    promp: ProMP,
    options: PlanOptions,
    goals: FloatArray,
    rng: np.random.Generator,
    rounds: int = 4,
) -> Iterator[Start]:
    """Starts drawn from the ProMP conditioned on its ends, for each goal and choice of sides."""
    choices = sides(setup, options)
    for _ in range(rounds):
        for goal in goals:
            _, knots = conditioned_on_goal(setup, promp, options, goal)
            ends = conditioned(promp, setup.start, np.array([1.0]), goal[None], np.zeros(1))
            (q,) = ends.sample(rng, 1, knots.count)
            robot = setup.robot
            q = np.clip(q, robot.lower, robot.upper)
            for drift in choices:
                yield Start(settled(q, setup.start, goal), drift, knots)


def plan_joint(
    setup: Setup,
    promp: ProMP,
    options: PlanOptions,
    goals: FloatArray,
    rng: np.random.Generator,
    deadline: float,
) -> Outcome:
    """Solve several starts together and keep the best.

    Args:
        setup: scene and robot.
        promp: supplies the initial trajectories.
        options: see :class:`PlanOptions`.
        goals: (m, n) goal configurations, best first.
        rng: for samples of the ProMP.
        deadline: ``time.perf_counter()`` to stop at.
    """
    began = time.perf_counter()

    heard: dict[int, Judgement] = {}

    def verify(trajectory: Trajectory, a: Attempt) -> bool:
        heard[id(a)] = metrics.judge(setup.scene, setup.robot, trajectory, setup.start)
        return not heard[id(a)].violations

    best = solve(setup, promp, options, goals, rng, deadline, verify)
    seconds = time.perf_counter() - began
    optimised = len(best.history) > 1
    names = tuple(term.name for term in best.problem.terms)
    stage = Stage("joint", "gauss-newton", names, best.history, seconds, best.message)
    return Outcome(
        trajectory_of(setup, options, best.start.q),
        trajectory_of(setup, options, best.q),
        best.start.knots,
        (stage,) if optimised else (),
        optimised,
        {"joint": seconds},
        heard.get(id(best)),
    )


def solve(
    setup: Setup,
    promp: ProMP,
    options: PlanOptions,
    goals: FloatArray,
    rng: np.random.Generator,
    deadline: float,
    verify: Callable[[Trajectory, Attempt], bool],
) -> Attempt:
    """The best attempt over all starts; the first that ``verify`` finds valid ends the search."""
    workspaces: dict[int, Evaluation] = {}
    schedule = _schedule(options)
    best: Attempt | None = None

    def attempt(start: Start) -> Attempt:
        knots = start.knots
        if knots.count not in workspaces:
            dt = 1.0 / (knots.count - 1)
            workspaces[knots.count] = Evaluation(setup.robot, setup.body, knots.count, dt)
        reference, _ = setup.robot.tool_pose(start.q)
        problem = joint_problem(
            setup, options, knots, start.drift, reference, workspaces[knots.count]
        )
        value = problem.evaluate(start.q, schedule.stages[0])
        return Attempt(start, problem, start.q, value, (value.terms,))

    def advance(a: Attempt, stages: slice) -> Attempt:
        result = gauss_newton.solve(a.problem, a.q, schedule, deadline, stages)
        history = a.history + result.history[1:]
        return Attempt(a.start, a.problem, result.q, result.value, history, result.message)

    sources: list[Iterator[Start]] = [
        starts(setup, promp, options, goals),
        sampled_starts(setup, promp, options, goals, rng),
    ]
    for source in sources:
        waiting = sorted((attempt(s) for s in source), key=lambda a: a.value.merit)
        for low in range(0, len(waiting), options.starts):
            batch = waiting[low : low + options.starts]
            if options.iterations == 0:
                return batch[0]
            batch = [advance(a, slice(0, 1)) for a in batch]
            batch.sort(key=lambda a: a.value.merit)
            ahead = [a for a in batch if a.value.merit < CLOSE * batch[0].value.merit]
            done = [advance(a, slice(1, None)) for a in ahead]
            done.sort(key=lambda a: a.value.merit)
            for a in done:
                if verify(trajectory_of(setup, options, a.q), a):
                    return a
            if best is None or done[0].value.merit < best.value.merit:
                best = done[0]
            if time.perf_counter() > deadline:
                return best
    assert best is not None  # there is at least one goal configuration
    return best


def _schedule(options: PlanOptions) -> gauss_newton.GaussNewtonOptions:
    if options.iterations is None:
        return gauss_newton.GaussNewtonOptions()
    stages = gauss_newton.GaussNewtonOptions().stages
    share = [options.iterations // len(stages)] * len(stages)
    share[-1] += options.iterations - sum(share)
    return gauss_newton.GaussNewtonOptions(iterations=tuple(share))


def trajectory_of(setup: Setup, options: PlanOptions, q: FloatArray) -> Trajectory:
    """The trajectory at the asked for duration, or the shortest that the limits allow."""
    robot = setup.robot
    if options.duration is not None:
        dt = options.duration / (len(q) - 1)
    else:
        dt = shortest_dt(q, robot.velocity, robot.acceleration)
    return Trajectory(q, dt, robot.joint_names)
