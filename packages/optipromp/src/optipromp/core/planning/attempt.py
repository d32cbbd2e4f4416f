"""One attempt: a planner's answer to one task, judged."""

import functools
from collections.abc import Callable

import numpy as np

from optipromp.core import judging
from optipromp.core.budget import Budget, clock
from optipromp.core.errors import Code, InvalidRequestError, others_code
from optipromp.core.planning import planners
from optipromp.core.planning.options import PlanOptions
from optipromp.core.planning.result import Answer, Failed, Plan, Planned, Proposal, Said
from optipromp.core.planning.task import Task
from optipromp.core.planning.timing import stopped
from optipromp.core.planning.verdict import Verdict, judged, predicted
from optipromp.core.trajectory import Trajectory

STILL = 0.0, 0.1, 0.2  # [s] times of a plan that stays at its start: a choice
JUDGING = 0.03  # [s] that a planner leaves for prediction and judge: measured, they take 35 ms
JUDGED_SHARE = 0.1  # of a time limit that is left for them at most: a choice


def late(end: float, options: PlanOptions) -> float:
    """The time at which a plan that ends at ``end`` begins nothing new [s]."""
    return end - min(JUDGING, JUDGED_SHARE * options.timeout)


def attempt(
    task: Task, planner: planners.Planner, options: PlanOptions, late: float,
    say: Callable[[str], object],
) -> Plan | Proposal[Plan]:  # fmt: skip
    """The judged plan of one task; nothing new begins after ``late`` [s].

    Where the planner's answer is a proposal of a path that harms, following the path gives the
    plan. The planner is not asked where the arm touches something at the start, breaks the path's
    constraints there, or rests at the goal.
    """
    began, theirs = clock(), others_code(f"planner {planners.label(planner)} failed")
    budget = Budget(late, np.inf if options.effort is None else options.effort, say)
    stay = _stay(task)
    touching = judging.touching(task.scene, task.robot, task.start, begun=task.underway.begun)
    resting = task.underway.running is None and task.scene.waypoints is None
    there = resting and all(task.at_goal(q) for q in stay.trajectory.positions)
    answer: Answer = stay
    if touching:
        told = "at the start " + "; ".join(map(str, touching))
        if any(x.role == "the robot itself" and "tool" in (x.link, x.other) for x in touching):
            told += ": start elsewhere, or turn the tool by its 'mount' if flange z points inward"
        answer = Failed(Code.START_IN_COLLISION, told)
    elif astray := judging.left_path(task.scene, task.robot, np.zeros(1), task.start[None]):
        told = f"{'; '.join(map(str, astray))}: choose a start that keeps the path, or widen it"
        answer = Failed(Code.START_INVALID, f"at the start {told}")
    elif not there:
        answer = theirs(planner.solve)(task, budget)
    finish = functools.partial(_finished, task, planner, budget, began, stay)
    if isinstance(answer, Proposal):
        made = theirs(answer.made)
        return Proposal(answer.rank, lambda: finish(made()))
    return finish(answer)


def _finished(
    task: Task, planner: planners.Planner, budget: Budget, began: float, stay: Planned,
    answer: Planned | Failed,
) -> Plan:  # fmt: skip
    """The judged plan of a planner's answer; ``stay``: in place of a motion that there is not."""
    if not isinstance(answer, Planned | Failed):
        raise InvalidRequestError(
            f"planner {planners.label(planner)} returned {type(answer).__name__}: "
            "solve must return Planned, Failed or Proposal"
        )
    outcome = answer if isinstance(answer, Planned) else answer.nearest or stay
    start = clock()
    prediction = outcome.prediction or predicted(task, outcome.trajectory)
    judgement = outcome.judgement or judged(task, outcome.trajectory, stem_side=prediction is None)
    if isinstance(answer, Planned):
        idle = getattr(planner, "iterations", None) == 0
        status, said = _status(Verdict(judgement, prediction), outcome, idle, budget)
    else:
        status, reason, notes = answer.code, answer.message, tuple[str, ...]()
        if answer.nearest is not None:
            reason += f"; the trajectory that comes nearest: {judgement.message}"
            notes = _cut(budget)
        elif broken := [
            str(v) for v in judgement.violations if v.kind in ("limit", *judging.RATES)
        ]:
            reason += "; on the way to rest " + "; ".join(broken)
        said = Said(reason, more=notes)
    now = clock()
    return Plan(
        task=task, planner=planners.label(planner), seed=task.seed, status=status, said=said,
        trajectory=outcome.trajectory, initial=outcome.begin,
        followed=outcome.followed or outcome.begin, prediction=prediction, judgement=judgement,
        stages=outcome.stages, time={**outcome.time, "check": now - start, "total": now - began},
        first=outcome.first, via=outcome.via, terms=outcome.terms,
    )  # fmt: skip


def _status(verdict: Verdict, outcome: Planned, idle: bool, budget: Budget) -> tuple[Code, Said]:
    """Status, reason and notes of an outcome; ``idle``: no optimisation was asked for."""
    raw = "" if outcome.optimised else " (not optimised)"
    wrong = verdict.judgement.message
    if budget.cut and not outcome.optimised and not idle:
        so_far = f"before any optimisation; the initial trajectory: {wrong or 'valid'}"
        return Code.TIMEOUT, Said(f"{budget.ending} {so_far}")
    if budget.cut and wrong:
        return Code.TIMEOUT, Said(f"{budget.ending}; the best so far: {wrong}{raw}")
    notes, push = _cut(budget), verdict.prediction
    if push is not None and push.harmful and push.harm > outcome.beyond:
        notes = (f"a path of harm {outcome.beyond:.2f} is out of the arm's reach", *notes)
    return verdict.status, Said("", verdict, raw, notes)


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
