"""``plan``: the entry point of all planners."""

import contextlib
import functools
import math
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, get_args

import numpy as np
from threadpoolctl import ThreadpoolController

from optipromp import judging
from optipromp.compiled import in_cache
from optipromp.errors import Code, InvalidRequestError
from optipromp.optimization.kernels import add_stiffness
from optipromp.planning import functionals, goals, primitive
from optipromp.planning.options import Planner, PlanOptions, Strategy
from optipromp.planning.parameters import GOAL
from optipromp.planning.pick import pick
from optipromp.planning.prediction import pushed_aside
from optipromp.planning.primitive import PAPER_BASIS, learnt
from optipromp.planning.result import Plan, Planned, Term, Terms
from optipromp.planning.task import Task, resolve
from optipromp.planning.verdict import Verdict, predicted
from optipromp.promp.model import ProMP
from optipromp.robots.model import Robot
from optipromp.scenes.io import load_scene
from optipromp.scenes.scene import Scene
from optipromp.trajectory import Trajectory

DEFAULTS = PlanOptions()


@functools.lru_cache(maxsize=1)
def _threads() -> tuple[Any, ...]:
    """The BLAS libraries that are loaded."""
    return tuple(ThreadpoolController().select(user_api="blas").lib_controllers)


@contextlib.contextmanager
def _one_thread() -> Iterator[None]:
    """Run BLAS on one thread: on small matrices its threads only wait for one another."""
    before = [(library, library.get_num_threads()) for library in _threads()]
    many = [(library, count) for library, count in before if count != 1]
    for library, _ in many:
        library.set_num_threads(1)
    try:
        yield
    finally:
        for library, count in many:
            library.set_num_threads(count)


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
) -> Plan:
    """Plan a reach in a scene.

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
    _compiled()  # before the plan's clock starts
    with _one_thread():
        return _plan(scene, robot, planner, strategy, demonstrations, seed, options, progress)


def check_planner(planner: str, strategy: str) -> None:
    """Refuse names of planners and strategies that do not exist.

    Raises:
        InvalidRequestError: naming the valid ones.
    """
    for what, name, valid in (
        ("planner", planner, get_args(Planner)),
        ("strategy", strategy, get_args(Strategy)),
    ):
        if name not in valid:
            raise InvalidRequestError(f"{what} is {name!r}; valid: {', '.join(valid)}")


def warm_up(scene: Scene | str = "scenario-3") -> None:
    """Compile every kernel, or load it from the cache, before a plan's time counts."""
    options = PlanOptions(timeout=math.inf)
    with _one_thread():
        made = _plan(scene, None, "opti-promp", "joint", None, 0, options, None)
    len(made.terms)  # computed when read


@functools.cache
def _compiled() -> None:
    """Compile the kernels, once in a process, where Numba's cache has none of them."""
    if not in_cache(add_stiffness):
        warm_up()


def _plan(
    scene: Scene | str | Path,
    robot: Robot | None,
    planner: Planner,
    strategy: Strategy,
    demonstrations: ProMP | str | Path | None,
    seed: int,
    options: PlanOptions | None,
    progress: Callable[[str], None] | None,
) -> Plan:
    began = time.perf_counter()
    options = options or DEFAULTS
    check_planner(planner, strategy)
    say = progress or (lambda _: None)
    if not isinstance(scene, Scene):
        scene = load_scene(scene)
    task = resolve(scene, robot)
    paper = planner == "opti-promp" and (strategy == "sequential" or options.constraints == "paper")
    default = planner == "opti-promp" and not paper
    promp = learnt(task, demonstrations, **({"basis": PAPER_BASIS} if paper else {}))
    clock = {"setup": time.perf_counter() - began}
    deadline = began + options.timeout

    def finish(outcome: Planned, status: Code | None = None, message: str = "") -> Plan:
        start = time.perf_counter()
        prediction = outcome.prediction or predicted(task, outcome.trajectory, outcome.first)
        verdict = outcome.judgement or judging.judge(
            scene, task.robot, outcome.trajectory, task.start, stem_side=prediction is None
        )
        if status is None:
            status, message = _status(Verdict(verdict, prediction), outcome, options, deadline)
        elif status == Code.GOAL_IN_COLLISION:
            message += "; the trajectory that comes nearest: " + verdict.message
        now = time.perf_counter()
        times = {**clock, **outcome.time, "check": now - start, "total": now - began}
        return Plan(
            scene=scene, robot=task.robot, planner=planner,
            strategy=strategy if planner == "opti-promp" else None, seed=seed, status=status,
            message=message, trajectory=outcome.trajectory, initial=outcome.primitive,
            followed=outcome.followed, prediction=prediction, metrics=verdict.metrics,
            terms=Terms(functools.partial(_terms, task, options, outcome, paper, strategy)),
            stages=outcome.stages, contacts=verdict.contacts, time=times,
            first=outcome.first, via=outcome.via,
        )  # fmt: skip

    _, touching = judging.clearances(scene, task.robot, task.start[None])
    if touching:
        return finish(
            _stay(task), Code.START_IN_COLLISION,
            "at the start " + "; ".join(map(str, touching)),
        )  # fmt: skip
    if task.at_goal(judging.GOAL_TOLERANCE, judging.AXIS_TOLERANCE):
        return finish(_stay(task))

    say("inverse kinematics")
    before = time.perf_counter()
    hasty = planner != "opti-promp" or before > deadline
    chosen, is_free, reason = goals.choose(
        pushed_aside(task) if default else task, seed, GOAL.few_starts if hasty else GOAL.starts,
        primitive.end(promp) if planner != "opti-promp" else None, deadline,
    )  # fmt: skip
    clock["inverse kinematics"] = time.perf_counter() - before
    if not len(chosen):
        return finish(_stay(task), Code.GOAL_UNREACHABLE, reason)
    if planner != "opti-promp":
        say(planner)
        return finish(primitive.plan_primitive(task, promp, options, chosen, planner, seed))
    say(f"optimising ({strategy})")
    if paper:
        from optipromp.planning.paper import solve  # with SciPy's optimisers

        outcome = solve(task, promp, options, strategy, chosen, deadline)
    else:
        outcome = pick(task, promp, options, chosen, seed, deadline)
    return finish(outcome) if is_free else finish(outcome, Code.GOAL_IN_COLLISION, reason)


def _status(
    found: Verdict, outcome: Planned, options: PlanOptions, deadline: float
) -> tuple[Code, str]:
    """Status and message of an outcome, from its verdict and the time that is left."""
    late = time.perf_counter() > deadline
    note = "" if outcome.optimised else " (not optimised)"
    wrong = found.judgement.message
    if late and not outcome.optimised and options.iterations != 0:
        return (
            Code.TIMEOUT,
            f"time ran out before any optimisation; the initial trajectory: {wrong or 'valid'}",
        )
    if wrong and late:
        return Code.TIMEOUT, f"time ran out; the best so far: {wrong}{note}"
    message, comma, notes = found.message.partition("; note: ")
    return found.status, message + note + comma + notes


def _terms(
    task: Task, options: PlanOptions, outcome: Planned, paper: bool, strategy: Strategy
) -> dict[str, Term]:
    """Each functional at the three trajectories, and over the stage that minimises it."""

    def values(trajectory: Trajectory) -> dict[str, float]:
        own = paper and strategy == "sequential"
        return functionals.values(task, options.paper, outcome.first, trajectory.positions, own)

    first, second, last = map(values, (outcome.primitive, outcome.followed, outcome.trajectory))
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
    """A trajectory that does not move."""
    still = Trajectory(np.tile(task.start, (3, 1)), 0.1, task.robot.joint_names)
    return Planned(still, still, still, 1, (), False, {})
