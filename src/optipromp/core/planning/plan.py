"""``plan``, the entry point of all planners, and compilation before the first plan."""

from __future__ import annotations

import functools
import itertools
import math
import subprocess
import sys
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import ThreadpoolController

from optipromp.core import judging
from optipromp.core.arrays import FloatArray, lengths, rotation
from optipromp.core.budget import Budget, clock
from optipromp.core.compiled import in_cache
from optipromp.core.errors import Code, InvalidRequestError
from optipromp.core.optimization.kernels import add_stiffness
from optipromp.core.planning import collision, planners
from optipromp.core.planning.options import PlanOptions, Strategy, stated
from optipromp.core.planning.parameters import APPROACH, UNDERWAY
from optipromp.core.planning.result import Failed, Harmful, Plan, Planned, best_of
from optipromp.core.planning.task import Task, approached, resolve
from optipromp.core.planning.timing import stopped
from optipromp.core.planning.underway import Moving, begun, later, plan_in_time, running, underway
from optipromp.core.planning.verdict import Verdict, judged, predicted
from optipromp.core.processes import cores
from optipromp.core.promp.model import ProMP
from optipromp.core.pushing.model import PushModel
from optipromp.core.pushing.parameters import PUSH
from optipromp.core.pushing.stems.cup import fits
from optipromp.core.robots.model import Robot
from optipromp.core.scenes.io import load_scene
from optipromp.core.scenes.scene import Scene
from optipromp.core.trajectory import Trajectory, chained

DEFAULTS = PlanOptions()
WARM_UP = "scenario-3"
SAME = 1e-6  # 1 less the cosine between two directions that are one: 0.1 degrees
RETRIED = Code.HARM_PREDICTED, Code.INVALID_PLAN, Code.GOAL_IN_COLLISION, Code.GOAL_UNREACHABLE
"""Statuses with which other approaches are tried."""

_threads = functools.cache(ThreadpoolController)  # it finds the BLAS libraries once

STILL = 0.0, 0.1, 0.2  # [s] times of a plan that stays at its start: a choice
JUDGING = 0.03  # [s] that a planner leaves for prediction and judge: measured, they take 35 ms
JUDGED_SHARE = 0.1  # of a time limit that is left for them at most: a choice


def plan(
    scene: Scene | str | Path,
    *,
    robot: Robot | None = None,
    planner: planners.Planner | str = "opti-promp",
    strategy: Strategy = "joint",
    demonstrations: ProMP | str | Path | None = None,
    seed: int = 0,
    options: PlanOptions | None = None,
    progress: Callable[[str], None] | None = None,
    start_state: Moving | None = None,
    previous: Plan | None = None,
    at: float | None = None,
    unpushed: bool = False,
    **settings: Any,
) -> Plan:
    """Plan a reach in a scene, from rest or from a motion that runs.

    Args:
        scene: a scene, the name of a built-in scene, or the path of a scene file. The motion of its
            objects begins with the plan, or with ``previous`` where that is given.
        robot: with its tool (:func:`optipromp.core.robots.tools.with_tool`), in place of the
            scene's.
        planner: a planner with its settings, such as :class:`OptiProMP`, or any object that
            solves a task (:class:`optipromp.core.planning.planners.Planner`); or a name: ``promp``
            conditions the primitive on start, camera point and target; ``i-promp`` also on every
            neighbour and its pushed pose; ``opti-promp`` picks a tool path, follows it with the
            whole arm and optimises the result; others are registered.
        strategy: of the planner named opti-promp: ``joint`` solves for everything at once,
            ``sequential`` runs the paper's stages.
        demonstrations: a ProMP, or a file to learn one from; None: the robot's built-in
            demonstrations.
        seed: of everything random. The same input and seed give the same plan.
        options: cost and risk that are allowed, and the settings of a planner that is named.
        progress: called with a short text as each step begins.
        start_state: state of the arm, in place of the scene's start: a :class:`State` or (q,
            velocity, acceleration). The plan begins in this state without a jump.
        previous: the plan that runs; its path is kept unless another path is better by a margin.
        at: the time in ``previous`` at which the new plan takes over [s]. Without ``start_state``
            the new plan begins in the state of ``previous`` at this time.
        unpushed: the scene has each fruit where it hung before the push of ``previous``, as a
            tracker gives it; otherwise a scene that differs has each fruit where it is now.
        settings: fields of :class:`PlanOptions` that differ from ``options``, named as on the
            command line: ``timeout=5.0``, ``duration=4.0``, ``risk=0.1``.

    Returns:
        The plan. A plan that fails is returned too, with its code, the best trajectory and the
        metrics of that trajectory.

    Raises:
        InvalidSceneError, InvalidRobotError, InvalidDemonstrationError: wrong input.
        InvalidRequestError: an argument or an option that is not allowed; a planner that ignores
            the scene's ``path`` or ``waypoints``, or that returns an object of another type than
            ``Planned``, ``Failed`` or ``Harmful``.
        StartInvalidError: a start outside the joint limits, or of the wrong size.
    """
    options = stated(options, settings, plan)
    solver = check_request(planner, strategy, options, seed)
    compile_once()  # before the plan's clock starts
    with _threads().limit(limits=1, user_api="blas"):  # small matrices gain nothing from threads
        say = progress or str
        say("reading scene and robot")
        state = begun(start_state, previous, at)
        scene = scene if isinstance(scene, Scene) else load_scene(scene)
        planners.check_way(solver, scene)
        scene = scene if at is None else later(scene, at)
        began = clock()
        task = replace(resolve(scene, robot, state), risk=options.risk, seed=seed)
        task = replace(task, demonstrations=demonstrations)
        tasks = [replace(task, goal=goal, others=()) for goal in (task.goal, *task.others)]
        if state is not None:
            tasks = [underway(each, previous, at, unpushed) for each in tasks]
            if tasks[0].same and previous is not None and previous.success:
                risk = max(task.risk, UNDERWAY.risk)
                tasks = [replace(each, risk=risk) for each in tasks]
        best = functools.partial(_best, planner=solver, options=options, began=began, say=say)
        if not scene.movers:
            return best(tasks)
        late = _late(began + options.timeout, options)
        made = [
            plan_in_time(each, lambda one: best([one]), late)
            for each in chain(tasks[:1], _until(late, tasks[1:]))
        ]
        return _of_tried(min(made, key=_slowness), len(made), len(tasks))


def _best(
    tasks: list[Task], planner: planners.Planner, options: PlanOptions, began: float,
    say: Callable[[str], object],
) -> Plan:  # fmt: skip
    """The first harmless plan: by the straight approach, or by another that the scene allows.

    There are several ``tasks`` where the scene has several goals: all are tried, and of the valid
    plans the shortest in time wins.

    At first the arm follows only paths that do no harm by themselves. Without a harmless plan, the
    path of least harm is followed too, and the best of all plans is returned. Other approaches are
    not tried where the tool is too fast because the options ask for a time or a speed.
    """
    end = began + options.timeout
    late = _late(end, options)
    attempt = functools.partial(_plan, planner=planner, options=options, end=end, say=say)
    first, several = tasks[0], len(tasks) > 1
    others: Iterable[Task] = tasks[1:]
    if not several and getattr(planner, "approaches", False) and not first.begun:
        others = other_approaches(first, late)
    tried = 0

    def judged() -> Iterator[Plan]:
        nonlocal tried
        harmful, success = list[Harmful](), False
        for task in chain([first], _until(late, others)):
            tried += 1
            made = attempt(task)
            if isinstance(made, Harmful):
                harmful.append(made)
                continue
            yield made
            success |= made.success
            speed = made.metrics.approach_speed
            fast = getattr(planner, "timed", False) and judging.too_fast(task.scene, speed)
            if not several and (fast or made.status not in RETRIED):
                break
        if harmful and not success:
            yield min(harmful, key=lambda answer: answer.harm).follow()

    best = best_of(judged(), _slowness if several else _badness)
    assert best is not None  # the first task gives a plan, or is harmful
    if several and not best.success:
        which = [each.goal for each in tasks].index(best.task.goal) + 1
        best = replace(best, reason=f"goal {which} of {len(tasks)}: {best.reason}")
    best = _of_tried(best, tried, len(tasks))
    return replace(best, time={**best.time, "total": clock() - began})


def _late(end: float, options: PlanOptions) -> float:
    """The time at which a plan that ends at ``end`` begins nothing new [s]."""
    return end - min(JUDGING, JUDGED_SHARE * options.timeout)


def _until(late: float, tasks: Iterable[Task]) -> Iterable[Task]:
    """The tasks that may begin: none after the time ``late`` [s]."""
    return itertools.takewhile(lambda _: clock() <= late, tasks)


def _of_tried(best: Plan, tried: int, goals: int) -> Plan:
    """The best plan, which says how many of several goals time did not suffice for."""
    if tried >= goals:
        return best
    left = f"{goals - tried} of {goals} goals were not tried, time ran out"
    if best.success:
        return replace(best, notes=(*best.notes, left))
    return replace(best, status=Code.TIMEOUT, reason=f"{left}; the best so far: {best.reason}")


def _slowness(made: Plan) -> tuple[bool, bool, float]:
    """Sort key of the plans to different goals: validity, free configurations, then duration."""
    nowhere = made.status in (Code.GOAL_UNREACHABLE, Code.GOAL_IN_COLLISION)
    return not made.success, nowhere, made.trajectory.duration


def _badness(made: Plan) -> tuple[bool, float]:
    """Sort key of the plans of different approaches: validity, then harm."""
    return not made.valid, np.inf if made.prediction is None else made.prediction.harm


def check_request(
    planner: planners.Planner | str, strategy: str, options: PlanOptions, seed: int = 0
) -> planners.Planner:
    """The planner of a request; see :func:`chosen_planner`."""
    if isinstance(seed, bool) or not isinstance(seed, int | np.integer) or seed < 0:
        raise InvalidRequestError(f"seed is {seed!r}; it must be a whole number >= 0")
    if not isinstance(options, PlanOptions):
        raise InvalidRequestError(f"options are {type(options).__name__}; they must be PlanOptions")
    return planners.chosen_planner(planner, strategy, options)


def warm_up(scene: Scene | str = WARM_UP) -> None:
    """Compile every kernel, or load it from the cache, before a plan's time counts."""
    task = resolve(scene if isinstance(scene, Scene) else load_scene(scene))
    with _threads().limit(limits=1, user_api="blas"):
        made = _plan(task, planner=planners.OptiProMP(), options=DEFAULTS, end=math.inf, say=str)
        made = made.follow() if isinstance(made, Harmful) else made
        home = task.robot.home[None]
        collision.way(task, home, home, np.random.default_rng(0))
    assert isinstance(made, Plan)
    len(made.terms)  # computed when read


@functools.cache
def compile_once() -> None:
    """Compile the kernels of most plans, once in a process, where Numba's cache lacks them.

    Kernels of few plans are compiled when they are called; a plan's clock stops meanwhile.
    """
    if not (in_cache(add_stiffness) and in_cache(collision.shorten)):
        warm_up()


def compile_kernels(progress: Callable[[str], object] = str) -> None:
    """Fill Numba's cache.

    ``progress`` is called with a short text as each part begins.

    The kernels of the push model take nearly as long to compile as all others. With a second core,
    another process compiles them, while this process plans in a scene where nothing hangs.
    """
    scene = load_scene(WARM_UP)
    bare = tuple(replace(o, stem=None) for o in scene.objects if o.role != "pushable")
    other = None
    if cores() > 1:
        code = f"from {__name__} import compile_push_model as run; run()"
        other = subprocess.Popen([sys.executable, "-c", code], stderr=subprocess.DEVNULL)
    try:
        progress("compiling the kernels of arm and obstacles")
        warm_up(replace(scene, objects=bare))
        if other is not None:
            progress("compiling the kernels of the push")
            other.wait()
    finally:
        if other is not None:
            other.kill()  # where the wait was interrupted
            other.wait()
    progress("compiling the last kernels")
    warm_up()  # the kernels that are still missing


def compile_push_model() -> None:
    """Compile the kernels of the push model."""
    task = resolve(load_scene(WARM_UP))
    model = task.push_model(task.robot.home)
    assert model is not None
    path = model.candidates.path(model.candidates.spread(0)[0])
    model.predict(path.points, path.points)


def _plan(
    task: Task,
    *,
    planner: planners.Planner,
    options: PlanOptions,
    end: float,
    say: Callable[[str], object],
) -> Plan | Harmful:
    """The judged plan of one task.

    Where the planner's answer is :class:`Harmful`, following its path gives the plan. The planner
    is not asked where the arm touches something at the start, breaks the path's constraints there,
    or rests at the goal.
    """
    began = clock()
    budget = Budget(_late(end, options), np.inf if options.effort is None else options.effort, say)
    stay = _stay(task)
    touching = judging.touching(task.scene, task.robot, task.start, begun=task.begun)
    resting = task.running is None and task.scene.waypoints is None
    there = resting and all(task.at_goal(q) for q in stay.trajectory.positions)
    answer: Planned | Failed | Harmful = stay
    if touching:
        told = "at the start " + "; ".join(map(str, touching))
        if any(x.role == "the robot itself" and "tool" in (x.link, x.other) for x in touching):
            told += ": start elsewhere, or turn the tool by its 'mount' if flange z points inward"
        answer = Failed(Code.START_IN_COLLISION, told)
    elif astray := judging.left_path(task.scene, task.robot, np.zeros(1), task.start[None]):
        told = f"{'; '.join(map(str, astray))}: choose a start that keeps the path, or widen it"
        answer = Failed(Code.START_INVALID, f"at the start {told}")
    elif not there:
        answer = planner.solve(task, budget)
    finish = functools.partial(_finished, task, planner, options, budget, began, stay)
    if isinstance(answer, Harmful):
        follow = answer.follow
        return replace(answer, follow=lambda: finish(follow()))
    return finish(answer)


def _finished(
    task: Task, planner: planners.Planner, options: PlanOptions, budget: Budget, began: float,
    stay: Planned, answer: Planned | Failed,
) -> Plan:  # fmt: skip
    """The judged plan of a planner's answer; ``stay``: in place of a motion that there is not."""
    if not isinstance(answer, Planned | Failed):
        raise InvalidRequestError(
            f"planner {planners.label(planner)} returned {type(answer).__name__}: "
            "solve must return Planned, Failed or Harmful"
        )
    outcome = answer if isinstance(answer, Planned) else answer.nearest or stay
    start = clock()
    prediction = outcome.prediction or predicted(task, outcome.trajectory)
    judgement = outcome.judgement or judged(task, outcome.trajectory, stem_side=prediction is None)
    if isinstance(answer, Planned):
        idle = getattr(planner, "iterations", None) == 0
        status, reason, notes = _status(Verdict(judgement, prediction), outcome, idle, budget)
    else:
        status, reason, notes = answer.code, answer.message, ()
        if answer.nearest is not None:
            reason += f"; the trajectory that comes nearest: {judgement.message}"
            notes = _cut(budget)
        elif broken := [
            str(v) for v in judgement.violations if v.kind in ("limit", *judging.RATES)
        ]:
            reason += "; on the way to rest " + "; ".join(broken)
    now = clock()
    return Plan(
        task=task, planner=planners.label(planner), strategy=getattr(planner, "strategy", None),
        seed=task.seed, status=status, reason=reason, notes=notes, trajectory=outcome.trajectory,
        initial=outcome.begin, followed=outcome.followed or outcome.begin, prediction=prediction,
        judgement=judgement, stages=outcome.stages,
        functionals=functools.partial(planners.functionals, task, planner, options, outcome),
        time={**outcome.time, "check": now - start, "total": now - began},
        first=outcome.first, via=outcome.via,
    )  # fmt: skip


def _status(
    verdict: Verdict, outcome: Planned, idle: bool, budget: Budget
) -> tuple[Code, str, tuple[str, ...]]:
    """Status, reason and notes of an outcome; ``idle``: no optimisation was asked for."""
    raw = "" if outcome.optimised else " (not optimised)"
    wrong = verdict.judgement.message
    if budget.cut and not outcome.optimised and not idle:
        so_far = f"before any optimisation; the initial trajectory: {wrong or 'valid'}"
        return Code.TIMEOUT, f"{budget.ending} {so_far}", ()
    if budget.cut and wrong:
        return Code.TIMEOUT, f"{budget.ending}; the best so far: {wrong}{raw}", ()
    notes, push = verdict.notes, verdict.prediction
    if push is not None and push.harmful and push.harm > outcome.beyond:
        notes += (f"a path of harm {outcome.beyond:.2f} is out of the arm's reach",)
    return verdict.status, verdict.reason + raw, notes + _cut(budget)


def _cut(budget: Budget) -> tuple[str, ...]:
    """A note where the budget cut the search: with more time the result may differ."""
    return (f"the search was cut after {budget.used} steps",) if budget.cut else ()


def _stay(task: Task) -> Planned:
    """A trajectory that stays at the start; where the arm moves, a trajectory that stops it."""
    if task.state.moving:
        made = stopped(task.robot, task.state)
    else:
        made = Trajectory.still(task.start, STILL, task.robot.joint_names)
    return Planned(made, 1, optimised=False)


def other_reaches(
    reach: Plan, scene: Scene, planner: planners.Planner, options: PlanOptions
) -> Iterator[Plan]:
    """Successes by other approaches to the target of a ``scene`` than that of a ``reach``.

    The most promising come first. The time of ``options`` begins anew.
    """
    straight = approached(reach.task, scene)
    if not getattr(planner, "approaches", False) or straight.begun or not reach.success:
        return
    late = _late(clock() + options.timeout, options)
    for task in _until(late, other_approaches(straight, late, APPROACH.ways)):
        if task.scene.frame[2] @ reach.scene.frame[2] > 1.0 - SAME:
            continue
        made = _plan(task, planner=planner, options=options, end=late, say=str)
        if isinstance(made, Plan) and made.success:
            yield made


def other_approaches(task: Task, end: float = np.inf, most: int = APPROACH.tried) -> Iterator[Task]:
    """The task with each of the ``most`` promising approaches that its scene allows.

    The tool ends no farther beside the target's centre than its mouth leaves room, so that the cup
    stays round the target. To a long target that does not fit in every state, it comes only from
    where the target fits, from where that is narrowest first; it ends at the middle of its outline,
    as low as its length asks for. To a target that stands the tool comes level, from a little to
    either side. Where the scene states no cone or no lateral distance, ``APPROACH`` does. No
    approach is looked at after ``end`` [s], a time of the plan's clock.
    """
    scene = task.scene
    tool, target = task.robot.tool, scene.target
    if tool is None or target is None:
        return
    cone, aside = scene.approach.cone, scene.approach.aside
    cone = np.deg2rad(APPROACH.cone if cone is None else cone)
    aside = APPROACH.aside if aside is None else aside
    reach = min(aside, max(tool.mouth[0] - target.radius - APPROACH.room, 0.0))
    x_g, y_g, z_g = scene.frame
    around = np.arange(APPROACH.around) * 2.0 * np.pi / APPROACH.around
    flats = [np.cos(turn) * x_g + np.sin(turn) * y_g for turn in around]
    shares: tuple[float, ...] = (1.0, APPROACH.inner)
    if target.stem is None:
        side = np.cross(scene.up, z_g)
        level = float(np.linalg.norm(side))
        flats = [side / level, -side / level] if level > 0.5 else []  # over 30° off the vertical
        shares, reach = (APPROACH.inner,), 0.0
    tilts = [
        rotation(np.cross(z_g, flat), float(share * cone)) @ z_g
        for share in shares
        if cone > 0.0
        for flat in flats
    ]
    straight = None if target.stem is None else task.push_model(task.robot.home)
    if straight is not None and straight.least > 0.0 and not scene.approach.shift.any():
        first = narrowest(scene, cone)
        axes = np.array([first, *(axis for axis in (z_g, *tilts) if axis @ first < 1.0 - SAME)])
        width, floor, shifts = fits(target, axes, tool)
        shifts = shifts - np.maximum(APPROACH.room - floor, 0.0)[:, None] * axes
        shifts *= np.minimum(1.0, aside / np.maximum(lengths(shifts), 1e-9))[:, None]
        floor += PUSH.harm.fit - np.einsum("mi,mi->m", shifts, axes)
        other = (axes != z_g).any(axis=1) | shifts.any(axis=1)
        fit = other & (np.minimum(width, floor) > 0.0)
        directions = list(zip(axes[fit], shifts[fit], strict=True))
    else:
        directions = [(axis, scene.approach.shift) for axis in tilts]
        beside = (reach * flat for flat in flats if reach > 0.0)
        directions += [(z_g, scene.approach.shift + shift) for shift in beside]
    left, best = most, list[tuple[float, int, Task]]()
    for k, (direction, shift) in enumerate(directions):
        if clock() > end:
            return
        approach = replace(scene.approach, direction=direction, shift=shift)
        other = approached(task, replace(scene, approach=approach))
        model = other.push_model(task.robot.home)
        if model is None:
            continue
        harm = _least_harm(other.scene, model, best[-1][0] if len(best) == left else np.inf)
        if harm < APPROACH.promising * model.threshold:
            yield other
            left -= 1
            best = best[:left]
            if not left:
                return
        else:
            best = sorted([*best, (harm, k, other)])[:left]
    yield from (other for _, _, other in best)


def narrowest(scene: Scene, cone: float) -> FloatArray:
    """The direction (3,) of a cone of ``cone`` [rad] across which the target is narrowest."""
    assert scene.target is not None
    turns = 2.0 * np.pi / APPROACH.turns * np.arange(APPROACH.turns)
    tilt, turn = np.meshgrid(np.linspace(0.0, cone, APPROACH.rings + 1), turns, indexing="ij")
    local = np.stack([np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), np.cos(tilt)])
    axes = local.reshape(3, -1).T @ np.array(scene.frame)
    radius, _, _ = scene.target.shape.outlines(axes @ scene.target.rotation)
    return np.asarray(axes[np.argmin(radius.round(6))])  # of equal ones that of the least tilt


def misfit(task: Task) -> str:
    """In words, how much wider a hanging target is than a round mouth, and what fits; else empty.

    The room that it needs is that of the push model.
    """
    scene, tool, target = task.scene, task.robot.tool, task.scene.target
    if target is None or target.stem is None or tool is None or tool.fingers:
        return ""
    cone, opening, needed = scene.approach.cone, 2e3 * tool.mouth[0], 2e3 * PUSH.harm.fit
    cone = np.deg2rad(APPROACH.cone if cone is None else cone)
    axes = np.array([scene.frame[2], narrowest(scene, cone)])
    here, least = 2e3 * target.shape.outlines(axes @ target.rotation)[0]
    if opening <= 0.0 or here + needed <= opening:
        return ""
    off = f"in the cone of the approach it is nowhere narrower than {least:.1f} mm"
    if least + needed <= opening:
        tilt = np.rad2deg(np.arccos(axes[0] @ axes[1]))
        off = f"{tilt:.0f} degrees off the approach it is {least:.1f} mm wide: fits"
    return (
        f"{target.id} is {here:.1f} mm wide across the approach, the tool's opening "
        f"{opening:.1f} mm is too narrow: one of {here + needed:.1f} mm fits; {off}"
    )


def _least_harm(scene: Scene, model: PushModel, most: float) -> float:
    """The least harm of the model's first candidate paths, in the perceived state.

    A harm above ``most`` is returned as any number that is not below ``most``.
    """
    axis, least = scene.frame[2], most
    for x in model.candidates.first()[: APPROACH.candidates]:
        path = model.candidates.path(x)
        away = model.candidates.aside(x, path)
        if away < least:
            axes = np.tile(axis, (len(path.points), 1))
            least = min(least, model.harm(path.points, axes, 1, least - away) + away)
    return least


@dataclass(frozen=True, eq=False)
class Detour:
    """What the arm does from a time of a running plan on.

    Attributes:
        trajectory: from the state of the running plan at that time; time 0 is that time.
        plan: from where the arm stopped; None where the running motion is free and goes on.
        brake: the curve from motion to rest, the first part of ``trajectory``; None likewise.
        contacts: what the brake's curve touches: the obstacle appeared too late or too near.
    """

    trajectory: Trajectory
    plan: Plan | None
    brake: Trajectory | None
    contacts: tuple[judging.Overlap, ...] = ()

    @property
    def success(self) -> bool:
        """Whether the arm arrives and touches nothing that it must not."""
        return not self.contacts and (self.plan is None or self.plan.success)


def detour(scene: Scene, previous: Plan, at: float, options: PlanOptions | None = None) -> Detour:
    """Go on with a running plan where its rest is free in a scene; else brake and plan anew.

    The arm brakes by the shortest curve within all limits, and plans from where it stopped.

    Args:
        scene: as it is seen at the time ``at``: objects that move are as in the scene of
            ``previous``, with times that begin with that plan.
        previous: the plan that runs.
        at: time in ``previous`` at which the obstacle is known [s].
        options: of the new plan.

    Raises:
        InvalidRequestError: a time outside of the running plan.
        OptiPrompError: what :func:`plan` raises.
    """
    state = begun(None, previous, at)
    assert state is not None  # that of the running plan
    robot, now = previous.robot, later(scene, at)
    left = running(previous, at)
    if left is not None and not _contacts(now, previous, left):
        return Detour(left, None, None)
    if not state.moving:
        made = plan(now, robot=robot, start_state=state, options=options)
        return Detour(made.trajectory, made, None)
    brake = stopped(robot, state)
    then = later(now, brake.duration)
    made = plan(then, robot=robot, start_state=brake.at(brake.duration), options=options)
    return Detour(chained([brake, made.trajectory]), made, brake, _contacts(now, previous, brake))


def _contacts(scene: Scene, previous: Plan, curve: Trajectory) -> tuple[judging.Overlap, ...]:
    return judging.judge(scene, previous.robot, curve, curve.at(0.0), begun=True).contacts
