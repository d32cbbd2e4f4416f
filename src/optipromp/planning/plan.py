"""``plan``, the entry point of all planners; ``plan_many``; and compiling beforehand."""

import functools
import itertools
import math
import subprocess
import sys
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path
from typing import get_args

import numpy as np
from threadpoolctl import ThreadpoolController

from optipromp import judging
from optipromp.budget import Budget, clock
from optipromp.compiled import in_cache
from optipromp.errors import Code, InvalidRequestError
from optipromp.optimization.kernels import add_stiffness
from optipromp.planning import approaches, goals, primitive, tree
from optipromp.planning.options import Planner, PlanOptions, Strategy
from optipromp.planning.paper_problem import functional_values
from optipromp.planning.parameters import GOAL, UNDERWAY
from optipromp.planning.pick import Harmful, pick
from optipromp.planning.primitive import PAPER_BASIS, learnt
from optipromp.planning.result import Plan, Planned, Term, Terms
from optipromp.planning.task import Task, pushed_aside, resolve
from optipromp.planning.timing import stopped
from optipromp.planning.underway import Moving, begun, underway
from optipromp.planning.verdict import Verdict, judged, predicted
from optipromp.processes import cores
from optipromp.promp.model import ProMP
from optipromp.pushing.path import ToolPath
from optipromp.robots.model import Robot
from optipromp.scenes.io import load_scene
from optipromp.scenes.scene import Scene
from optipromp.trajectory import Trajectory

DEFAULTS = PlanOptions()
WARM_UP = "scenario-3"
RETRIED = Code.HARM_PREDICTED, Code.INVALID_PLAN, Code.GOAL_IN_COLLISION, Code.GOAL_UNREACHABLE


_threads = functools.cache(ThreadpoolController)  # knows the BLAS libraries that are loaded


def plan(
    scene: Scene | str | Path,
    *,
    robot: Robot | None = None,
    planner: Planner = "opti-promp",
    strategy: Strategy = "joint",
    demonstrations: ProMP | str | Path | None = None,
    seed: int = 0,
    options: PlanOptions | None = None,
    progress: Callable[[str], None] | None = None,
    start_state: Moving | None = None,
    previous: Plan | None = None,
    at: float | None = None,
) -> Plan:
    """Plan a reach in a scene, from rest or from a motion that runs.

    Args:
        scene: a scene, the name of a built-in scene, or the path of a scene file.
        robot: with its tool (:func:`optipromp.robots.tools.with_tool`), in place of the scene's.
        planner: ``promp`` conditions the primitive on start, camera point and target; ``i-promp``
            also on every neighbour and its pushed pose; ``opti-promp`` picks a tool path, follows
            it with the whole arm and optimises the result.
        strategy: of opti-promp. ``joint`` solves for everything at once; ``sequential`` runs the
            paper's stages.
        demonstrations: a ProMP, or a file to learn one from; None: the robot's built-in
            demonstrations.
        seed: of everything random. The same input and seed give the same plan.
        options: see :class:`PlanOptions`.
        progress: called with a short text as each step begins.
        start_state: that the arm is in, in place of the scene's start: a :class:`State` or (q,
            velocity, acceleration). The plan begins in it without a jump.
        previous: the plan that runs; its path is kept unless another is better by a margin.
        at: the time in ``previous`` at which the new plan takes over [s]. Without ``start_state``
            the arm is where ``previous`` has it then.

    Returns:
        The plan. A plan that fails is returned too: with its code, the best trajectory found and
        its metrics.

    Raises:
        InvalidSceneError: a scene that cannot be used.
        InvalidRobotError: a robot that cannot be used.
        InvalidDemonstrationError: demonstrations that cannot be used.
        InvalidRequestError: an argument or option outside what it may be.
        StartInvalidError: a start outside the joint limits, or of the wrong size.
    """
    options = options or DEFAULTS
    check_planner(planner, strategy, seed)
    if not isinstance(options, PlanOptions):
        raise InvalidRequestError(f"options are {type(options).__name__}; they must be PlanOptions")
    _compiled()  # before the plan's clock starts
    with _threads().limit(limits=1, user_api="blas"):  # on small matrices threads only wait
        state = begun(start_state, previous, at)
        scene = scene if isinstance(scene, Scene) else load_scene(scene)
        began = clock()
        end = began + options.timeout
        task = replace(resolve(scene, robot, state), risk=options.risk)
        if state is not None:
            task = underway(task, previous, at)
            if task.same and previous is not None and previous.success:
                task = replace(task, risk=max(task.risk, UNDERWAY.risk))

        def attempt(other: Task, path: ToolPath | None, sparing: bool) -> Plan | Harmful:
            return _plan(
                other, planner, strategy, demonstrations, seed, options, end, progress, sparing,
                path,
            )  # fmt: skip

        ways: Iterable[Task] = ()
        default = planner == "opti-promp" and not _as_in_the_paper(options, strategy)
        if default and options.prediction and state is None:
            ways = approaches.others(task)
        return _best_way(task, ways, attempt, end, options.timed, began)


def _as_in_the_paper(options: PlanOptions, strategy: Strategy) -> bool:
    return strategy == "sequential" or options.constraints == "paper"


def _best_way(
    task: Task, ways: Iterable[Task],
    attempt: Callable[[Task, ToolPath | None, bool], Plan | Harmful], end: float, timed: bool,
    began: float,
) -> Plan:  # fmt: skip
    """The first harmless plan: straight, or else by the other approaches that the scene allows.

    Only paths that do no harm by themselves are followed with the arm. Without a harmless plan the
    best is given, or the path of least harm is followed. What is too fast because it was ``timed``
    so is too fast on any way.
    """
    made: list[Plan] = []
    harmful: list[Harmful] = []
    for other in itertools.chain([task], ways):
        if (made or harmful) and clock() > end:
            break
        found = attempt(other, None, True)
        if isinstance(found, Harmful):
            harmful.append(found)
            continue
        made.append(found)
        fast = timed and judging.too_fast(found.metrics.approach_speed)
        if fast or found.status not in RETRIED:
            break
    if harmful and not any(one.success for one in made):
        least = min(harmful, key=lambda one: one.path.harm)
        found = attempt(least.task, least.path, False)
        assert isinstance(found, Plan)
        made.append(found)
    best = min(made, key=_badness)
    return replace(best, time={**best.time, "total": clock() - began})


def _badness(made: Plan) -> tuple[bool, float]:
    """What ranks plans of different approaches: validity, then harm."""
    valid = made.success or made.status == Code.HARM_PREDICTED
    return not valid, np.inf if made.prediction is None else made.prediction.harm


def check_planner(planner: str, strategy: str, seed: int = 0) -> None:
    """Refuse names of planners and strategies that do not exist, and seeds that are none.

    Raises:
        InvalidRequestError: naming the valid ones.
    """
    if isinstance(seed, bool) or not isinstance(seed, int | np.integer) or seed < 0:
        raise InvalidRequestError(f"seed is {seed!r}; it must be a whole number >= 0")
    for what, name, valid in (
        ("planner", planner, get_args(Planner)),
        ("strategy", strategy, get_args(Strategy)),
    ):
        if name not in valid:
            raise InvalidRequestError(f"{what} is {name!r}; valid: {', '.join(valid)}")


def warm_up(scene: Scene | str = WARM_UP) -> None:
    """Compile every kernel, or load it from the cache, before a plan's time counts."""
    task = resolve(scene if isinstance(scene, Scene) else load_scene(scene))
    with _threads().limit(limits=1, user_api="blas"):
        made = _plan(task, "opti-promp", "joint", None, 0, DEFAULTS, math.inf, None)
        home = task.robot.home[None]
        tree.way(task, home, home, np.random.default_rng(0))
    assert isinstance(made, Plan)
    len(made.terms)  # computed when read


@functools.cache
def _compiled() -> None:
    """Compile what most plans need, once in a process, where Numba's cache has none of it.

    What only some need is compiled when they do; a plan's clock stands still meanwhile.
    """
    if not (in_cache(add_stiffness) and in_cache(tree.shorten)):
        warm_up()


def compile_kernels() -> None:
    """Fill Numba's cache.

    The push model takes nearly as long to compile as all other kernels. Where there is a second
    core, another process compiles it, while this one plans where nothing hangs.
    """
    scene = load_scene(WARM_UP)
    bare = tuple(replace(o, stem=None) for o in scene.objects if o.role != "pushable")
    other = None
    if cores() > 1:
        code = f"from {__name__} import compile_push_model as run; run()"
        other = subprocess.Popen([sys.executable, "-c", code], stderr=subprocess.DEVNULL)
    try:
        warm_up(replace(scene, objects=bare))
        if other is not None:
            other.wait()
    finally:
        if other is not None:
            other.kill()  # where the wait was interrupted
            other.wait()
    warm_up()  # the kernels that are still missing


def compile_push_model() -> None:
    """Compile what predicts a push."""
    task = resolve(load_scene(WARM_UP))
    model = task.push_model(task.robot.home)
    assert model is not None
    path = model.path(model.spread(0)[0])  # the first candidate
    model.predict(path.points, path.points)


def _plan(
    task: Task, planner: Planner, strategy: Strategy, demonstrations: ProMP | str | Path | None,
    seed: int, options: PlanOptions, end: float, progress: Callable[[str], None] | None,
    sparing: bool = False, path: ToolPath | None = None,
) -> Plan | Harmful:  # fmt: skip
    say = progress or (lambda _: None)
    began = clock()
    paper = planner == "opti-promp" and _as_in_the_paper(options, strategy)
    default = planner == "opti-promp" and not paper
    promp = learnt(task, demonstrations, **({"basis": PAPER_BASIS} if paper else {}))
    so_far = {"setup": clock() - began}
    budget = Budget(end, np.inf if options.effort is None else options.effort)

    def finish(outcome: Planned, status: Code | None = None, message: str = "") -> Plan:
        start = clock()
        prediction = outcome.prediction or predicted(task, outcome.trajectory)
        verdict = outcome.judgement or judged(
            task, outcome.trajectory, stem_side=prediction is None
        )
        if status is None:
            status, message = _status(Verdict(verdict, prediction), outcome, options, budget)
        elif status == Code.GOAL_IN_COLLISION:
            message += f"; the trajectory that comes nearest: {verdict.message}{_cut(budget)}"
        elif broken := [str(v) for v in verdict.violations if v.kind in ("limit", *judging.RATES)]:
            message += "; on the way to rest " + "; ".join(broken)
        now = clock()
        times = {**so_far, **outcome.time, "check": now - start, "total": now - began}
        return Plan(
            task=task, planner=planner,
            strategy=strategy if planner == "opti-promp" else None, seed=seed, status=status,
            message=message, trajectory=outcome.trajectory, initial=outcome.primitive,
            followed=outcome.followed, prediction=prediction, metrics=verdict.metrics,
            terms=Terms(functools.partial(_terms, task, options, outcome, paper, strategy)),
            stages=outcome.stages, contacts=verdict.contacts, time=times,
            first=outcome.first, via=outcome.via,
        )  # fmt: skip

    stay = _stay(task)
    touching = judging.touching(task.scene, task.robot, task.start, begun=task.begun)
    if touching:
        told = "at the start " + "; ".join(map(str, touching))
        return finish(stay, Code.START_IN_COLLISION, told)
    if task.running is None and all(task.at_goal(q) for q in stay.trajectory.positions):
        return finish(stay)

    say("inverse kinematics")
    before = clock()
    hasty = planner != "opti-promp" or budget.spent()
    near = primitive.end(promp) if planner != "opti-promp" else None
    chosen, is_free, reason = goals.choose(
        pushed_aside(task) if default else task, seed, GOAL.few_starts if hasty else GOAL.starts,
        near if task.entry is None else task.start, budget,
    )  # fmt: skip
    so_far["inverse kinematics"] = clock() - before
    if not len(chosen):
        return finish(stay, Code.GOAL_UNREACHABLE, reason)
    if planner != "opti-promp":
        say(planner)
        return finish(primitive.plan_primitive(task, promp, options, chosen, planner, seed))
    say(f"optimising ({strategy})")
    outcome: Planned | Harmful
    if paper:
        from optipromp.planning.paper import solve  # with SciPy's optimisers

        outcome = solve(task, promp, options, strategy, chosen, seed, budget)
    else:
        outcome = pick(task, promp, options, chosen, seed, budget, sparing and is_free, path)
    if isinstance(outcome, Harmful):
        return outcome
    return finish(outcome) if is_free else finish(outcome, Code.GOAL_IN_COLLISION, reason)


def _status(
    found: Verdict, outcome: Planned, options: PlanOptions, budget: Budget
) -> tuple[Code, str]:
    """Status and message of an outcome, from its verdict and whether the budget cut the search."""
    late = budget.cut
    note = "" if outcome.optimised else " (not optimised)"
    wrong = found.judgement.message
    if late and not outcome.optimised and options.iterations != 0:
        return (
            Code.TIMEOUT,
            f"{budget.ending} before any optimisation; the initial trajectory: {wrong or 'valid'}",
        )
    if wrong and late:
        return Code.TIMEOUT, f"{budget.ending}; the best so far: {wrong}{note}"
    message, comma, notes = found.message.partition("; note: ")
    return found.status, message + note + comma + notes + _cut(budget)


def _cut(budget: Budget) -> str:
    """That a search was cut, and where: with more time its result may be another."""
    return f"; note: the search was cut after {budget.used} steps" if budget.cut else ""


def _terms(
    task: Task, options: PlanOptions, outcome: Planned, paper: bool, strategy: Strategy
) -> dict[str, Term]:
    """Each functional at the three trajectories, and over the stage that minimises it."""

    first, second, last = (
        functional_values(
            task, options.paper, outcome.first, made.positions, paper and strategy == "sequential"
        )
        for made in (outcome.primitive, outcome.followed, outcome.trajectory)
    )
    out = {}
    for name in ("static", "avoid", "push", "velocity"):
        stage = next((s for s in outcome.stages if name in s.terms), None)
        out[name] = Term(
            first.get(name, 0.0), second.get(name, 0.0), last.get(name, 0.0),
            () if stage is None else tuple(item.get(name, 0.0) for item in stage.history),
            "" if stage is None else stage.name,
        )  # fmt: skip
    return out


def _stay(task: Task) -> Planned:
    """A trajectory that does not move; where the arm moves, one that comes to rest."""
    if task.state.moving:
        still = stopped(task.robot, task.state)
    else:
        rest, times = np.zeros((3, task.robot.n_joints)), np.array([0.0, 0.1, 0.2])
        still = Trajectory(times, task.start + rest, rest, rest, task.robot.joint_names)
    return Planned(still, still, still, 1, (), False, {})
