"""The joint strategy: all terms and constraints in one constrained solve, from several starts.

Starts (:mod:`.starts`) are solved together: all through the first stage of penalty stiffness, those
close to the best to the end. A start that keeps the constraints already is solved to the end at
once.
"""

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from optipromp import metrics
from optipromp.arrays import FloatArray, lengths
from optipromp.metrics import Judgement
from optipromp.optimization.evaluation import Evaluation
from optipromp.optimization.problem import Problem, Value
from optipromp.optimization.solvers import gauss_newton
from optipromp.planning import foresight
from optipromp.planning.build import joint_problem
from optipromp.planning.options import PlanOptions
from optipromp.planning.setup import Setup
from optipromp.planning.stages import Outcome, Stage
from optipromp.planning.starts import Start, Starts, sides, tool_path
from optipromp.promp.model import ProMP
from optipromp.pushing.sides import Drift
from optipromp.trajectory import Trajectory, shortest_dt

INVALID = 2.5  # added to the score of a push whose trajectory is not valid; less than hopeless
TRIES = 6  # ways that are planned while no trajectory is valid
FAR_DAMPING, FAR_TOLERANCE = 1e-2, 1e-2  # of the solver, for a start that breaks constraints
CLOSE = 1.3  # a start within this factor of the best one after the first stage goes on

T = TypeVar("T")


@dataclass(frozen=True, eq=False)
class Attempt:
    """A start and what became of it."""

    start: Start
    problem: Problem
    q: FloatArray
    value: Value
    history: tuple[dict[str, float], ...]
    message: str = ""
    done: bool = False


def plan_joint(
    setup: Setup,
    promp: ProMP,
    options: PlanOptions,
    goals: FloatArray,
    seed: int,
    deadline: float,
) -> Outcome:
    """Solve several starts together and keep the best.

    Args:
        setup: scene and robot.
        promp: supplies the initial trajectories.
        options: see :class:`PlanOptions`.
        goals: (m, n) goal configurations, best first.
        seed: of the samples of the ProMP.
        deadline: ``time.perf_counter()`` to stop at.
    """
    began = time.perf_counter()

    heard: dict[int, tuple[Trajectory, Judgement]] = {}
    foreseen = foresight.applies(setup, options)
    starts = Starts(setup, promp, options, goals)
    solver = Solver(setup, options, deadline)

    def verify(trajectory: Trajectory, a: Attempt) -> bool:
        verdict = metrics.judge(
            setup.scene, setup.robot, trajectory, setup.start, stem_side=not foreseen
        )
        heard[id(a)] = trajectory, verdict
        return not verdict.violations

    if foreseen:
        best = _foreseen(solver, starts, verify)
    else:
        rng = np.random.default_rng(seed)
        best, _ = solver.solve(verify, starts.batches(sides(setup, options), rng=rng))
    seconds = time.perf_counter() - began
    first = best.start.knots.first
    initial = trajectory_of(setup, options, best.start.initial, first)
    judgement: Judgement | None = None
    if id(best) in heard:
        trajectory, judgement = heard[id(best)]
    else:
        trajectory = trajectory_of(setup, options, best.q, first)
    return outcome_of(best, initial, trajectory, seconds, {"joint": seconds}, judgement)


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
        initial, trajectory, best.start.knots, stages, optimised, time_of, judgement,
        best.value.terms if optimised else None,
    )  # fmt: skip


def _foreseen(
    solver: "Solver", starts: Starts, verify: Callable[[Trajectory, Attempt], bool]
) -> Attempt:
    """The attempt, over choices of sides, whose push is foreseen to do least harm."""
    setup, options, deadline = solver.setup, solver.options, solver.deadline
    model = foresight.foresight(setup)
    ruled = sides(setup, options)[0]
    made: dict[bytes, tuple[Attempt, bool]] = {}

    def way(drift: Drift) -> FloatArray:
        return tool_path(setup, options, drift)

    def attempt(drift: Drift) -> tuple[float, Attempt]:
        corners = way(drift)
        key = corners.tobytes()
        if key not in made:
            # samples of the ProMP would have to be led back to the way that was tried
            made[key] = solver.solve(verify, starts.batches((drift,), (corners,)))
        best, holds = made[key]
        value = model.of_trajectory(best.q[best.start.knots.first :])
        return value + (0.0 if holds else INVALID), best

    # what is known well may be passed as the rule says, if that does no harm
    hopeful = True
    if not model.detected:
        hopeful = model.of_path(way(ruled), 0) < foresight.HOPELESS
        if hopeful:
            value, made_of = attempt(ruled)
            if value < model.good or time.perf_counter() > deadline:
                return made_of
    least, best = np.inf, None
    for expected, drift in model.choices(ruled, options, way, deadline, hopeful):
        if expected < least:
            value, made_of = attempt(drift)
            if best is None or value < least:
                least, best = value, made_of
        none = len(made) >= TRIES and not any(holds for _, holds in made.values())
        if least < model.good or none or time.perf_counter() > deadline:
            break
    assert best is not None  # every score is finite
    return best


class Solver:
    """Solves starts of one setup; keeps its arrays from one to the next.

    Args:
        setup: scene and robot.
        options: see :class:`PlanOptions`.
        deadline: ``time.perf_counter()`` to stop at.
    """

    def __init__(self, setup: Setup, options: PlanOptions, deadline: float) -> None:
        self.setup, self.options, self.deadline = setup, options, deadline
        self.schedule = _schedule(options)
        self._arrays: dict[int, Evaluation] = {}

    def solve(
        self, verify: Callable[[Trajectory, Attempt], bool], made: Iterator[list[Start]]
    ) -> tuple[Attempt, bool]:
        """The best attempt over batches of starts, and whether it is valid.

        The first that ``verify`` finds valid ends it.
        """
        best: Attempt | None = None
        for batch in made:
            attempts = self._while_time(self._begun, batch)
            if self.options.iterations == 0:
                least = min(attempts, key=self._early)
                return replace(least, q=least.start.initial), False
            attempts.sort(key=self._early)
            close = CLOSE * self._early(attempts[0])
            near = [a for a in attempts if self._early(a) <= close]
            ahead = self._while_time(self._ended, near)
            done = sorted(ahead, key=lambda a: a.value.merit)
            for a in done:
                q, first = a.q, a.start.knots.first
                if verify(trajectory_of(self.setup, self.options, q, first), a):
                    return a, True
                if self._late():
                    break
            if best is None or done[0].value.merit < best.value.merit:
                best = done[0]
            if self._late():
                return best, False
        assert best is not None  # there is at least one goal configuration
        return best, False

    def _late(self) -> bool:
        return time.perf_counter() > self.deadline

    def _while_time(self, work: Callable[[T], Attempt], items: Sequence[T]) -> list[Attempt]:
        """What becomes of the first of the ``items``, and of the others while there is time."""
        out = [work(items[0])]
        for item in items[1:]:
            if self._late():
                break
            out.append(work(item))
        return out

    def _early(self, a: Attempt) -> float:
        """The objective as the first stage has it."""
        return a.value.cost + self.schedule.stages[0] * a.value.penalty

    def _begun(self, start: Start) -> Attempt:
        """A start after the first stage, or to the end where it needs no first stage."""
        setup, knots, schedule = self.setup, start.knots, self.schedule
        if knots.count not in self._arrays:
            dt = 1.0 / (knots.count - 1)
            self._arrays[knots.count] = Evaluation(setup.robot, setup.body, knots.count, dt)
        reference, _ = setup.robot.tool_pose(start.q)
        problem = joint_problem(
            setup, self.options, knots, start.drift, reference, self._arrays[knots.count]
        )
        value = problem.evaluate(start.q, schedule.stages[-1])
        a = Attempt(start, problem, start.q, value, (value.terms,))
        if self.options.iterations == 0 or self._late():
            return a
        if schedule.keeps(value):
            return replace(self._advanced(a, slice(-1, None), value), done=True)
        return self._advanced(a, slice(0, -1))

    def _ended(self, a: Attempt) -> Attempt:
        return a if a.done or self._late() else self._advanced(a, slice(-1, None))

    def _advanced(self, a: Attempt, stages: slice, value: Value | None = None) -> Attempt:
        schedule = (
            self.schedule
            if value
            else replace(self.schedule, damping=FAR_DAMPING, tolerance=FAR_TOLERANCE)
        )
        result = gauss_newton.solve(
            a.problem, a.q, schedule, self.deadline, stages, value
        )  # fmt: skip
        history = a.history + result.history[1:]
        return Attempt(a.start, a.problem, result.q, result.value, history, result.message)


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
            step = float(lengths(points[1:] - points[:-1]).max(initial=0.0))
            dt = max(dt, step / options.approach_speed)
    return Trajectory(q, dt, robot.joint_names)
