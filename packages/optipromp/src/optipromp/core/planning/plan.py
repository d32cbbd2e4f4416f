"""``plan``, the entry point of all planners: one search over approaches, cheapest first."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, fields, replace
from itertools import chain
from pathlib import Path
from typing import Any, Self

import numpy as np

from optipromp.core import judging
from optipromp.core.budget import clock
from optipromp.core.errors import Code, InvalidRequestError
from optipromp.core.planning import planners
from optipromp.core.planning.approaches import other_approaches
from optipromp.core.planning.attempt import attempt, late
from optipromp.core.planning.options import DEFAULTS, PlanOptions, stated
from optipromp.core.planning.parameters import BACK, UNDERWAY
from optipromp.core.planning.result import Plan, Proposal, Said, cheapest
from optipromp.core.planning.task import Task, goals_of, resolve
from optipromp.core.planning.underway import Moving, begun, later, plan_in_time, underway
from optipromp.core.planning.warming import compile_once, one_thread
from optipromp.core.promp.model import ProMP
from optipromp.core.robots.model import Robot
from optipromp.core.scenes.io import load_scene
from optipromp.core.scenes.scene import Scene

RETRIED = Code.HARM_PREDICTED, Code.INVALID_PLAN, Code.GOAL_IN_COLLISION, Code.GOAL_UNREACHABLE
"""Statuses with which other approaches are tried."""


def plan(
    scene: Scene | str | Path,
    *,
    robot: Robot | None = None,
    planner: planners.Planner | str = "opti-promp",
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
            ``Planned``, ``Failed`` or ``Proposal``.
        StartInvalidError: a start outside the joint limits, or of the wrong size.
    """
    options = stated(options, settings, plan)
    asked = Request(
        planner, demonstrations, seed, options, robot, progress, start_state, previous, at,
        unpushed,
    )  # fmt: skip
    with one_thread():
        search = asked.search(scene)
        made = next(cheapest(search.reaches(), search.late))
    return replace(made, time={**made.time, "total": clock() - search.began})


@dataclass(frozen=True)
class Request:
    """What :func:`plan` is asked for, beside the scene: its arguments have the same names."""

    planner: planners.Planner | str = "opti-promp"
    demonstrations: ProMP | str | Path | None = None
    seed: int = 0
    options: PlanOptions = DEFAULTS
    robot: Robot | None = None
    progress: Callable[[str], None] | None = None
    start_state: Moving | None = None
    previous: Plan | None = None
    at: float | None = None
    unpushed: bool = False

    @classmethod
    def of(cls, verb: Callable[..., object], **given: Any) -> Self:
        """The request of a call of ``verb``, which takes the arguments of :func:`plan`."""
        mine = {item.name for item in fields(cls)} & given.keys()
        kept = {name: given.pop(name) for name in mine}
        return cls(**kept | {"options": stated(kept.get("options"), given, verb)})

    def search(self, scene: Scene | str | Path) -> Search:
        """The search for a plan of a scene; its clock starts."""
        solver = check_request(self.planner, self.options, self.seed)
        compile_once()  # before the plan's clock starts
        say = self.progress or str
        say("reading scene and robot")
        state = begun(self.start_state, self.previous, self.at)
        scene = scene if isinstance(scene, Scene) else load_scene(scene)
        planners.check_way(solver, scene)
        scene = scene if self.at is None else later(scene, self.at)
        began = clock()
        task = resolve(scene, self.robot, state)
        task = replace(
            task, risk=self.options.risk, seed=self.seed, demonstrations=self.demonstrations
        )
        tasks = [replace(task, goal=goal) for goal in goals_of(task.scene, task.robot, task.start)]
        if state is not None:
            tasks = [underway(each, self.previous, self.at, self.unpushed) for each in tasks]
            if tasks[0].underway.same and self.previous is not None and self.previous.success:
                risk = max(task.risk, UNDERWAY.risk)
                tasks = [replace(each, risk=risk) for each in tasks]
        return Search(scene, tuple(tasks), solver, self.options, began, say)


@dataclass(frozen=True)
class Search:
    """A search for a plan.

    Attributes:
        scene: of the request.
        tasks: one for each goal of the scene.
        planner: that solves them.
        options: of the request.
        began: time of the plan's clock [s].
        say: called with a short text as each step begins.
    """

    scene: Scene
    tasks: tuple[Task, ...]
    planner: planners.Planner
    options: PlanOptions
    began: float
    say: Callable[[str], object]

    @property
    def late(self) -> float:
        """The time from which nothing new begins [s]."""
        return late(self.began + self.options.timeout, self.options)

    def reaches(self) -> Iterator[Proposal[Plan]]:
        """Proposals of plans, the best first.

        Of the valid plans to several goals the shortest in time is proposed alone.
        """
        if len(self.tasks) == 1 and not self.scene.movers:
            return self.approaches(self.tasks[0])
        made = [self._to(task) for task in chain(self.tasks[:1], self._until(self.tasks[1:]))]
        best = min(made, key=_slowness)
        return iter([Proposal(_badness(best), self._of_tried(best, len(made)))])

    def approaches(self, task: Task) -> Iterator[Proposal[Plan]]:
        """Proposals of plans: by the straight approach, and by others that the scene allows.

        At first the arm follows only paths that do no harm by themselves. Without a harmless plan,
        paths that harm are followed too, the least harmful first. Other approaches are not tried
        where the tool is too fast because the options ask for a time or a speed.
        """
        tasks: Iterator[Task] = iter([task])
        if getattr(self.planner, "approaches", False) and not task.underway.begun:
            tasks = chain(tasks, self._until(other_approaches(task, self.late)))

        def tried() -> Iterator[Proposal[Plan]]:
            one = next(tasks, None)
            if one is None:
                return
            made = attempt(one, self.planner, self.options, self.late, self.say)
            if isinstance(made, Proposal):
                yield Proposal((True, False, made.rank), lambda: [ranked(made.made())])
            else:
                yield ranked(made)
                speed = made.metrics.approach_speed
                fast = getattr(self.planner, "timed", False) and judging.too_fast(one.scene, speed)
                if not made.success and (fast or made.status not in RETRIED):
                    return
            bound = BACK.good if isinstance(made, Plan) and made.success else 0.0
            yield Proposal((False, False, bound), tried)

        def ranked(made: Plan) -> Proposal[Plan]:
            made = replace(made, time={**made.time, "total": clock() - self.began})
            return Proposal(_badness(made), made)

        return tried()

    def _to(self, task: Task) -> Plan:
        """The best plan to one of several goals, or among objects that move."""

        def best(task: Task) -> Plan:
            return next(cheapest(self.approaches(task), self.late))

        return plan_in_time(task, best, self.late) if self.scene.movers else best(task)

    def _until(self, tasks: Iterable[Task]) -> Iterator[Task]:
        """The tasks that may begin in time."""
        return itertools.takewhile(lambda _: clock() <= self.late, tasks)

    def _of_tried(self, best: Plan, tried: int) -> Plan:
        """The best plan, which says how many of several goals time did not suffice for."""
        count = len(self.tasks)
        if count > 1 and not best.success:
            which = [each.goal for each in self.tasks].index(best.task.goal) + 1
            best = replace(best, said=Said(f"goal {which} of {count}: ", best.said))
        if tried == count:
            return best
        left = f"{count - tried} of {count} goals were not tried, time ran out"
        if best.success:
            return replace(best, said=Said("", best.said, more=(left,)))
        said = Said(f"{left}; the best so far: ", best.said)
        return replace(best, status=Code.TIMEOUT, said=said)


def _slowness(made: Plan) -> tuple[bool, bool, float]:
    """Sort key of the plans to different goals: validity, free configurations, then duration."""
    nowhere = made.status in (Code.GOAL_UNREACHABLE, Code.GOAL_IN_COLLISION)
    return not made.success, nowhere, made.trajectory.duration


def _badness(made: Plan) -> tuple[bool, bool, float]:
    """Rank of a plan by one approach; of a plan that fails, validity, then harm."""
    if made.success:
        return False, False, 0.0
    return True, not made.valid, math.inf if made.prediction is None else made.prediction.harm


def check_request(
    planner: planners.Planner | str, options: PlanOptions, seed: int = 0
) -> planners.Planner:
    """The planner of a request; see :func:`chosen_planner`."""
    if isinstance(seed, bool) or not isinstance(seed, int | np.integer) or seed < 0:
        raise InvalidRequestError(f"seed is {seed!r}; it must be a whole number >= 0")
    if not isinstance(options, PlanOptions):
        raise InvalidRequestError(f"options are {type(options).__name__}; they must be PlanOptions")
    return planners.chosen_planner(planner, options)
