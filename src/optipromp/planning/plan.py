"""``plan``: the one way in, for all three planners."""

import contextlib
import functools
import math
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, get_args

import numpy as np
from threadpoolctl import ThreadpoolController

from optipromp import metrics
from optipromp.errors import Code, InvalidRequestError
from optipromp.metrics import Contact, Judgement, Metrics
from optipromp.planning import foresight, goals, joint, movement, ploughing
from optipromp.planning.options import Planner, PlanOptions, Strategy
from optipromp.planning.primitives import PAPER_BASIS, learnt
from optipromp.planning.setup import Setup, bind
from optipromp.planning.stages import Outcome, Stage, value_of
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
    """Every matrix here is small: BLAS threads would spend their time waiting for one another."""
    before = [(library, library.get_num_threads()) for library in _threads()]
    many = [(library, count) for library, count in before if count != 1]
    for library, _ in many:
        library.set_num_threads(1)
    try:
        yield
    finally:
        for library, count in many:
            library.set_num_threads(count)


@dataclass(frozen=True)
class Term:
    """One functional of a plan, without its weight.

    Attributes:
        initial: value at the beginning of the stage that optimises it.
        final: value of the returned trajectory.
        history: over the iterations of that stage, the initial value first.
        stage: name of that stage; empty where nothing optimises the term.
    """

    initial: float
    final: float
    history: tuple[float, ...]
    stage: str


class Terms(Mapping[str, Term]):
    """Functionals by name, computed when they are first read: few who plan do."""

    def __init__(self, compute: Callable[[], dict[str, Term]]) -> None:
        self._compute: Callable[[], dict[str, Term]] | None = compute
        self._values: dict[str, Term] = {}

    def _known(self) -> dict[str, Term]:
        if self._compute is not None:
            self._values, self._compute = self._compute(), None
        return self._values

    def __getitem__(self, name: str) -> Term:
        return self._known()[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._known())

    def __len__(self) -> int:
        return len(self._known())

    def __repr__(self) -> str:
        return repr(self._known())

    def __reduce__(self) -> tuple[type[dict[str, Term]], tuple[dict[str, Term]]]:
        return dict, (self._known(),)


@dataclass(frozen=True, eq=False)
class Plan:
    """What a planner returns: a trajectory, what it does, and whether it is valid.

    Attributes:
        scene: what was planned for.
        robot: the scene's robot with its tool.
        planner: ``promp``, ``i-promp`` or ``opti-promp``.
        strategy: of opti-promp.
        seed: of everything random.
        status: ``success`` only where the independent check found nothing wrong.
        message: why, in words.
        trajectory: the best found, whatever the status.
        initial: the conditioned ProMP it began from.
        metrics: see :class:`optipromp.metrics.Metrics`.
        terms: ``static``, ``avoid``, ``push``, ``velocity``; computed when first read.
        stages: optimisation stages in the order they ran.
        contacts: things that touch and must not.
        time: ``total`` and per stage [s].
    """

    scene: Scene
    robot: Robot
    planner: Planner
    strategy: Strategy | None
    seed: int
    status: Code
    message: str
    trajectory: Trajectory
    initial: Trajectory
    metrics: Metrics
    terms: Mapping[str, Term]
    stages: tuple[Stage, ...]
    contacts: tuple[Contact, ...]
    time: Mapping[str, float] = field(default_factory=dict)

    @property
    def success(self) -> bool:
        """Whether the trajectory is valid."""
        return self.status == Code.SUCCESS

    def to_dict(self) -> dict[str, Any]:
        """Everything but the trajectories, as plain values for JSON."""
        return {
            "scene": self.scene.name,
            "planner": self.planner,
            "strategy": self.strategy,
            "seed": self.seed,
            "status": str(self.status),
            "message": self.message,
            "metrics": self.metrics.to_dict(),
            "terms": {
                name: {
                    "initial": t.initial,
                    "final": t.final,
                    "history": list(t.history),
                    "stage": t.stage,
                }
                for name, t in self.terms.items()
            },
            "contacts": [
                {"link": c.link, "other": c.other, "role": c.role, "depth": c.depth}
                for c in self.contacts
            ],
            "time": dict(self.time),
        }


def plan(
    scene: Scene | str | Path,
    *,
    planner: Planner = "opti-promp",
    strategy: Strategy = "joint",
    demonstrations: ProMP | str | Path | None = None,
    seed: int = 0,
    options: PlanOptions | None = None,
    progress: Callable[[str], None] | None = None,
) -> Plan:
    """Plan a reach in a scene.

    Args:
        scene: a scene, a built-in scene's name, or a scene file.
        planner: ``promp`` (conditioned on start, camera point and target), ``i-promp`` (pushes by
            geometry) or ``opti-promp`` (optimises the whole arm's trajectory).
        strategy: of opti-promp: ``joint`` or, as the paper does, ``sequential``.
        demonstrations: a ProMP or a file to learn it from; None: the robot's built-in ones.
        seed: of everything random; the same input gives the same plan.
        options: see :class:`PlanOptions`.
        progress: called with a word on what is being done.

    Returns:
        A plan. One that fails is returned too, with its code, best trajectory and metrics.

    Raises:
        InvalidSceneError, InvalidRobotError, InvalidDemonstrationError, InvalidRequestError,
        StartInvalidError: wrong input.
    """
    with _one_thread():
        return _plan(scene, planner, strategy, demonstrations, seed, options, progress)


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


def warm_up() -> None:
    """Compile every kernel, or load it from the cache, so that no plan's time pays for that."""
    plan("scenario-3", options=PlanOptions(timeout=math.inf))


def _plan(
    scene: Scene | str | Path,
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
    setup = bind(scene)
    opti = planner == "opti-promp" and strategy == "joint"
    paper = planner == "opti-promp" and strategy == "sequential"
    basis = {"basis": PAPER_BASIS} if paper else {}
    promp = learnt(setup, demonstrations, **basis)
    clock = {"setup": time.perf_counter() - began}
    deadline = began + options.timeout

    def finish(outcome: Outcome, status: Code | None = None, message: str = "") -> Plan:
        start = time.perf_counter()
        verdict = outcome.judgement
        if verdict is None:
            verdict = metrics.judge(
                scene, setup.robot, outcome.trajectory, setup.start,
                stem_side=not (opti and foresight.applies(setup, options)),
            )  # fmt: skip
        if status is None:
            status, message = _verdict(verdict, outcome, options, deadline)
        elif status == Code.GOAL_IN_COLLISION:
            message += "; the trajectory that comes nearest: " + "; ".join(verdict.violations)
        now = time.perf_counter()
        times = {**clock, **outcome.time, "check": now - start, "total": now - began}
        return Plan(
            scene=scene, robot=setup.robot, planner=planner,
            strategy=strategy if planner == "opti-promp" else None, seed=seed, status=status,
            message=message, trajectory=outcome.trajectory, initial=outcome.initial,
            metrics=verdict.metrics,
            terms=Terms(functools.partial(_terms, setup, options, outcome, paper)),
            stages=outcome.stages, contacts=verdict.contacts, time=times,
        )  # fmt: skip

    _, touching = metrics.clearances(scene, setup.robot, setup.start[None])
    if touching:
        return finish(
            _stay(setup), Code.START_IN_COLLISION,
            "at the start " + "; ".join(map(str, touching)),
        )  # fmt: skip
    if _at_goal(setup):
        return finish(_stay(setup))

    say("inverse kinematics")
    before = time.perf_counter()
    hasty = planner != "opti-promp" or before > deadline
    starts = goals.FEW_STARTS if hasty else goals.STARTS
    ploughed = opti and ploughing.applies(setup)
    room = ploughing.without_packs(setup) if ploughed else setup
    begin = movement.end(promp) if planner != "opti-promp" else None
    chosen, is_free, reason = goals.choose(room, seed, starts, begin, deadline)
    clock["inverse kinematics"] = time.perf_counter() - before
    if not len(chosen):
        return finish(_stay(setup), Code.GOAL_UNREACHABLE, reason)
    if planner != "opti-promp":
        say(planner)
        return finish(movement.plan_movement(setup, promp, options, chosen, planner, seed))

    say(f"optimising ({strategy})")
    if strategy == "sequential":
        from optipromp.planning import sequential  # with SciPy's optimisers

        outcome = sequential.solve(setup, promp, options, chosen, deadline)
    elif ploughed:
        outcome = ploughing.plan_ploughed(setup, promp, options, chosen, seed, deadline)
    else:
        outcome = joint.plan_joint(setup, promp, options, chosen, seed, deadline)
    return finish(outcome) if is_free else finish(outcome, Code.GOAL_IN_COLLISION, reason)


def _verdict(
    verdict: Judgement, outcome: Outcome, options: PlanOptions, deadline: float
) -> tuple[Code, str]:
    late = time.perf_counter() > deadline
    note = "" if outcome.optimised else " (not optimised)"
    if late and not outcome.optimised and options.iterations != 0:
        found = "; ".join(verdict.violations) or "valid"
        return (
            Code.TIMEOUT,
            f"time ran out before any optimisation; the initial trajectory: {found}",
        )
    if not verdict.violations:
        message = "reaches the target, keeps all limits, touches nothing it must not" + note
        return Code.SUCCESS, "; ".join([message, *(f"note: {n}" for n in verdict.notes)])
    message = "; ".join(verdict.violations) + note
    if late:
        return Code.TIMEOUT, f"time ran out; the best so far: {message}"
    return Code.INVALID_PLAN, message


def _terms(setup: Setup, options: PlanOptions, outcome: Outcome, paper: bool) -> dict[str, Term]:
    """Each functional: over the stage that optimises it, and at the returned trajectory."""
    q0, q1 = outcome.initial.positions, outcome.trajectory.positions
    last = outcome.values
    if last is None:
        last = value_of(setup, options, outcome.knots, q1, paper)
    names = ("static", "avoid", "push", "velocity")
    stages = [next((s for s in outcome.stages if name in s.terms), None) for name in names]
    first = last
    if q1 is not q0 and any(
        s is None and name in last for name, s in zip(names, stages, strict=True)
    ):
        first = value_of(setup, options, outcome.knots, q0, paper)
    out = {}
    for name, stage in zip(names, stages, strict=True):
        if stage is None:
            history: tuple[float, ...] = ()
            begin = first.get(name, 0.0)
        else:
            history = tuple(values.get(name, 0.0) for values in stage.history)
            begin = history[0]
        out[name] = Term(begin, last.get(name, 0.0), history, "" if stage is None else stage.name)
    return out


def _stay(setup: Setup) -> Outcome:
    """A trajectory that does not move."""
    q = np.tile(setup.start, (3, 1))
    trajectory = Trajectory(q, 0.1, setup.robot.joint_names)
    return Outcome(trajectory, trajectory, movement.knots_without_vias(3), (), False, {})


def _at_goal(setup: Setup) -> bool:
    if setup.goal_joints is not None:
        return bool(np.max(np.abs(setup.start - setup.goal_joints)) < metrics.GOAL_TOLERANCE)
    assert setup.goal_position is not None
    assert setup.goal_axis is not None
    point, axis = setup.robot.tool_pose(setup.start)
    near = np.linalg.norm(point - setup.goal_position) < metrics.GOAL_TOLERANCE
    return bool(near and axis @ setup.goal_axis > np.cos(metrics.AXIS_TOLERANCE))
