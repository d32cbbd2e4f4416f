"""The joint strategy: all terms and constraints in one constrained solve, from several starts.

Starts differ in the inverse-kinematics branch of the goal, in the side on which undecided pushables
are passed and, where those are not enough, in samples of the ProMP. They are solved together: all
through the first stage of penalty stiffness, those close to the best to the end.
"""

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from optipromp import metrics
from optipromp.arrays import FloatArray
from optipromp.metrics import Judgement
from optipromp.optimization.evaluation import Evaluation
from optipromp.optimization.problem import Problem, Value
from optipromp.optimization.solvers import gauss_newton
from optipromp.planning import foresight
from optipromp.planning.build import Knots, capture_height, joint_problem, widths
from optipromp.planning.options import PlanOptions
from optipromp.planning.primitives import (
    ViaPoints,
    camera_point,
    conditioned,
    detection_variance,
    on_branch,
    via_points,
)
from optipromp.planning.setup import Setup
from optipromp.planning.stages import Outcome, Stage
from optipromp.promp.model import ProMP
from optipromp.pushing.sides import Drift, drift_choices
from optipromp.pushing.thread import evenly, length, thread
from optipromp.robots import ik
from optipromp.trajectory import Trajectory, shortest_dt

LEVER_ARM = 0.4  # [m] turns a deviation of the tool into one of the joints
TOOL_STEP = 0.005  # [m] of the tool point between knots of the approach
FOLLOWED = 1e-4  # [m] largest error of a followed tool point
PEAK = 1.9  # largest over mean speed of a smooth reach
FEWEST, MOST = 60, 600  # knots
LONGER = 1.5  # a motion with this many times the knots of the shortest waits for a later batch
SAMPLE_ROUNDS = 4
INVALID = 3.0  # added to the score of a push whose trajectory is not valid
CLOSE = 1.3  # a start within this factor of the best one after the first stage goes on


@dataclass(frozen=True, eq=False)
class Start:
    """A conditioned ProMP (T, n), the trajectory to begin from, and the sides to pass on."""

    initial: FloatArray
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
    setup: Setup,
    options: PlanOptions,
    via: FloatArray | None,
    goal: FloatArray,
    path: float,
) -> Knots:
    """Knots such that no joint moves much over the wanted step, before t_1 and after alike.

    ``path`` is the length of the tool's way from the camera point to the goal [m].
    """
    step = 0.8 * options.max_step
    if via is None or len(via) < 2:
        reach = PEAK * float(np.max(np.abs(goal - setup.start))) / step
        count = options.knots or int(np.clip(np.ceil(reach) + 1, FEWEST, MOST))
        return Knots(count, options.camera_phase or 0.5)
    reach = PEAK * float(np.max(np.abs(via[0] - setup.start))) / step
    approach = 1.6 * float(np.max(np.abs(np.diff(via, axis=0)), axis=1).sum()) / step
    reach, approach = max(reach, 25.0), max(approach, 40.0, path / TOOL_STEP)
    count = options.knots or int(np.clip(10 * np.ceil((reach + approach) / 10), FEWEST, MOST))
    phase = options.camera_phase or float(np.clip(reach / (reach + approach), 0.2, 0.75))
    return Knots(count, phase)


@dataclass(frozen=True, eq=False)
class Branch:
    """A goal configuration (n,) and, where they can be followed, those of the via points (m, n)."""

    goal: FloatArray
    via: FloatArray | None
    deviations: FloatArray
    knots: Knots


def branches(
    setup: Setup, options: PlanOptions, goals: FloatArray, paths: Sequence[FloatArray]
) -> list[Branch]:
    """The branches of the goal configurations (m, n), shortest motion first.

    ``paths`` are the tool's ways for every choice of sides, see :func:`tool_path`.
    """
    longest = max(length(path) for path in paths)
    points: ViaPoints | None = None
    if setup.neighbours:
        positions = [thing.position for thing in setup.neighbours]
        points = via_points(setup, positions, 0.5, options.via_deviation)
    out = []
    for goal in goals:
        via = None if points is None else on_branch(setup, points, goal)
        deviations = np.zeros(1) if points is None else points.deviations
        out.append(Branch(goal, via, deviations, knots_for(setup, options, via, goal, longest)))
    return sorted(out, key=lambda branch: branch.knots.count)


def sides(setup: Setup, options: PlanOptions) -> tuple[Drift, ...]:
    """Every choice of sides for the neighbours of a setup."""
    return drift_choices(
        setup.scene,
        setup.neighbours,
        options.drift,
        window=options.window,
        depth=getattr(setup.robot.tool, "depth", 0.0),
        gripper_radius=setup.robot.gripper_radius,
    )


def tool_path(setup: Setup, options: PlanOptions, drift: Drift) -> FloatArray:
    """Corners (k, 3) of the tool's way from the camera point past the neighbours to the goal."""
    if not drift.ids or setup.goal_position is None:
        return np.zeros((1, 3))
    return thread(
        drift,
        widths(setup, options, drift)[1],
        setup.goal_position,
        setup.scene.frame,
        camera_point(setup),
        capture_height(setup),
    )


def threaded(
    setup: Setup, options: PlanOptions, branch: Branch, path: FloatArray, q: FloatArray
) -> FloatArray:
    """``q`` (T, n) with its approach led along the tool ``path`` past the neighbours.

    The approach is followed by inverse kinematics from the goal back, on the branch; the reach
    before it is bent to meet it. ``q`` itself where the path cannot be followed.
    """
    if branch.via is None or options.window == "paper":
        return q
    assert setup.goal_axis is not None
    first = branch.knots.first
    points = evenly(path, len(q) - first)
    axes = np.tile(setup.goal_axis, (len(points) - 1, 1))
    back, errors = ik.track(setup.robot, points[-2::-1], axes, branch.goal)
    if errors.max() > FOLLOWED:
        return q
    out = np.array(q)
    out[first:-1] = back[::-1]
    share = np.linspace(0.0, 1.0, first + 1)[:, None]
    out[: first + 1] = q[: first + 1] + share**2 * (3.0 - 2.0 * share) * (out[first] - q[first])
    return out


def initial(setup: Setup, promp: ProMP, branch: Branch) -> FloatArray:
    """The ProMP conditioned on start, camera point, pushables and one goal configuration (T, n)."""
    if branch.via is None:
        phases, values, variances = np.array([1.0]), branch.goal[None], np.zeros(1)
    else:
        values = branch.via
        phases = np.linspace(branch.knots.camera_phase, 1.0, len(values))
        variances = (branch.deviations / LEVER_ARM) ** 2
        variances[1:-1] += [detection_variance(t) / LEVER_ARM**2 for t in setup.neighbours]
    posterior = conditioned(promp, setup.start, phases, values, variances)
    return settled(posterior.mean_trajectory(branch.knots.count), setup.start, branch.goal)


def settled(q: FloatArray, start: FloatArray, goal: FloatArray) -> FloatArray:
    """``q`` with exact ends (a conditioned ProMP meets them to rounding)."""
    out = np.array(q)
    out[0], out[-1] = start, goal
    return out


def sampled(setup: Setup, promp: ProMP, branch: Branch, rng: np.random.Generator) -> FloatArray:
    """A draw (T, n) from the ProMP conditioned on its ends only."""
    ends = conditioned(promp, setup.start, np.array([1.0]), branch.goal[None], np.zeros(1))
    (q,) = ends.sample(rng, 1, branch.knots.count)
    robot = setup.robot
    return settled(np.clip(q, robot.lower, robot.upper), setup.start, branch.goal)


def batches(
    setup: Setup,
    promp: ProMP,
    options: PlanOptions,
    goals: FloatArray,
    rng: np.random.Generator,
    choices: Sequence[Drift],
) -> Iterator[list[Start]]:
    """Starts to solve together, for every choice of sides, the most promising batch first.

    Branches whose motion is much longer than the shortest one wait for a later batch, and samples
    of the ProMP come when every branch has failed.
    """
    paths = [tool_path(setup, options, drift) for drift in choices]
    waiting = branches(setup, options, goals, paths)
    order = list(waiting)
    while waiting:
        reach = LONGER * waiting[0].knots.count
        batch = [branch for branch in waiting[: options.starts] if branch.knots.count <= reach]
        waiting = waiting[len(batch) :]
        yield [
            Start(q, threaded(setup, options, branch, path, q), drift, branch.knots)
            for branch in batch
            for q in (initial(setup, promp, branch),)
            for drift, path in zip(choices, paths, strict=True)
        ]
    for _ in range(SAMPLE_ROUNDS):
        for low in range(0, len(order), options.starts):
            yield [
                Start(q, q, drift, branch.knots)
                for branch in order[low : low + options.starts]
                for q in (sampled(setup, promp, branch, rng),)
                for drift in choices
            ]


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
    foreseen = foresight.applies(setup, options)

    def made(choices: Sequence[Drift]) -> Iterator[list[Start]]:
        return batches(setup, promp, options, goals, rng, choices)

    def verify(trajectory: Trajectory, a: Attempt) -> bool:
        heard[id(a)] = metrics.judge(
            setup.scene, setup.robot, trajectory, setup.start, stem_side=not foreseen
        )
        return not heard[id(a)].violations

    if foreseen:
        best = _foreseen(setup, options, deadline, verify, made)
    else:
        best = solve(setup, options, deadline, verify, made(sides(setup, options)))
    seconds = time.perf_counter() - began
    first = best.start.knots.first
    return outcome_of(
        best, trajectory_of(setup, options, best.start.initial, first),
        trajectory_of(setup, options, best.q, first), seconds, {"joint": seconds},
        heard.get(id(best)),
    )  # fmt: skip


def outcome_of(
    best: Attempt,
    initial: Trajectory,
    trajectory: Trajectory,
    seconds: float,
    time_of: dict[str, float],
    judgement: Judgement | None,
) -> Outcome:
    """The outcome of the attempt that was kept, optimised in ``seconds`` if at all."""
    optimised = len(best.history) > 1
    names = tuple(term.name for term in best.problem.terms)
    stage = Stage("joint", "gauss-newton", names, best.history, seconds, best.message)
    stages = (stage,) if optimised else ()
    return Outcome(
        initial, trajectory, best.start.knots, stages, optimised, time_of, judgement
    )  # fmt: skip


def _foreseen(
    setup: Setup,
    options: PlanOptions,
    deadline: float,
    verify: Callable[[Trajectory, Attempt], bool],
    made: Callable[[Sequence[Drift]], Iterator[list[Start]]],
) -> Attempt:
    """The attempt, over choices of sides, whose push is foreseen to do least harm."""
    model = foresight.foresight(setup)
    ruled = sides(setup, options)[0]

    def way(drift: Drift) -> FloatArray:
        return tool_path(setup, options, drift)

    def attempt(drift: Drift, seen_well: bool) -> tuple[float, Attempt]:
        valid: set[int] = set()

        def heard(trajectory: Trajectory, a: Attempt) -> bool:
            if verify(trajectory, a):
                valid.add(id(a))
            return id(a) in valid

        made_of = solve(setup, options, deadline, heard, made((drift,)))
        value = model.of_trajectory(made_of.q[made_of.start.knots.first :], seen_well)
        return value + (0.0 if id(made_of) in valid else INVALID), made_of

    # what is known well may be passed as the rule says, if that does no harm
    if not model.detected and model.of_path(way(ruled), 0) < foresight.HOPELESS:
        value, made_of = attempt(ruled, True)
        if value < model.good:
            return made_of
    least, best = np.inf, None
    for expected, drift in model.choices(ruled, options, way, deadline):
        if expected < least:
            value, made_of = attempt(drift, False)
            if best is None or value < least:
                least, best = value, made_of
        if least < model.good or time.perf_counter() > deadline:
            break
    assert best is not None  # every score is finite
    return best


def solve(
    setup: Setup,
    options: PlanOptions,
    deadline: float,
    verify: Callable[[Trajectory, Attempt], bool],
    made: Iterator[list[Start]],
) -> Attempt:
    """The best attempt over batches of starts; the first that ``verify`` finds valid ends it."""
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

    for batch in made:
        attempts = [attempt(start) for start in batch]
        if options.iterations == 0:
            least = min(attempts, key=lambda a: a.value.merit)
            return replace(least, q=least.start.initial)
        attempts = sorted((advance(a, slice(0, 1)) for a in attempts), key=lambda a: a.value.merit)
        ahead = [a for a in attempts if a.value.merit <= CLOSE * attempts[0].value.merit]
        done = sorted((advance(a, slice(1, None)) for a in ahead), key=lambda a: a.value.merit)
        for a in done:
            if verify(trajectory_of(setup, options, a.q, a.start.knots.first), a):
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


def trajectory_of(setup: Setup, options: PlanOptions, q: FloatArray, first: int) -> Trajectory:
    """The trajectory at the asked for duration, or the shortest that the limits allow.

    From knot ``first`` on the tool is among what it pushes, and keeps to ``approach_speed``.
    """
    robot = setup.robot
    if options.duration is not None:
        dt = options.duration / (len(q) - 1)
    else:
        dt = shortest_dt(q, robot.velocity, robot.acceleration)
        if setup.neighbours:
            points, _ = robot.tool_pose(q[first:])
            step = float(np.linalg.norm(np.diff(points, axis=0), axis=1).max(initial=0.0))
            dt = max(dt, step / options.approach_speed)
    return Trajectory(q, dt, robot.joint_names)
