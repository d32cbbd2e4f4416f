"""The controller: looks and states in, the next stretch of an executable curve out.

The tool goes to the camera point, looks, plans, and comes to the target along the plan's path,
moved with the plant. A prediction of the push under way, and where it asks for it a search, take
the time that the cycles leave over (:mod:`optipromp.control.slices`). A tool whose push has become
hopeless retreats along its own path, looks again and tries again. After the last try it gives up.
"""

from __future__ import annotations

import math
import time as wall
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any

import numpy as np

from optipromp.control.look import Look
from optipromp.control.parameters import CONTROL, LoopParameters
from optipromp.control.plant import (
    changed,
    deviation,
    displaced,
    field_of,
    has_target,
    pushed_by,
    scene_of,
    target_row,
)
from optipromp.control.servo import Course, Route, follow
from optipromp.control.slices import Sliced
from optipromp.control.tracked import Tracked
from optipromp.control.tracker import Tracker
from optipromp.core import judging
from optipromp.core.arrays import FloatArray, lengths
from optipromp.core.errors import Code
from optipromp.core.execution.streaming import Stretch
from optipromp.core.planning import Plan, PlanOptions, plan
from optipromp.core.planning.plan import compile_once
from optipromp.core.planning.task import posed
from optipromp.core.planning.timing import needs, stopped
from optipromp.core.robots.model import Robot
from optipromp.core.scenes.scene import JointGoal, Scene, SceneObject
from optipromp.core.trajectory import State, Trajectory

LOST = "the target is lost"


class LoopStage(StrEnum):
    """What the controller does."""

    LOOK = "look"  # it stands and looks, or plans
    GO = "go"  # the tool follows a plan, moved with the plant
    RETREAT = "retreat"  # the tool goes back along its path
    DONE = "done"  # the tool is at the target
    GAVE_UP = "gave_up"  # the tool stands away from the fruits


ENDED = LoopStage.DONE, LoopStage.GAVE_UP


@dataclass(frozen=True)
class Decision:
    """A decision: its time by the controller's clock [s], the stage that begins, and the reason."""

    time: float
    stage: LoopStage
    why: str


@dataclass(frozen=True, eq=False)
class _Job:
    """A plan in the making.

    ``takeover`` is the time of the state that it begins in [s]; None: at rest.
    """

    work: Sliced[Plan]
    takeover: float | None


class Controller:
    """A closed loop for one pick.

    Args:
        scene: robot, tool, approach, the objects that stand still, and fruits that were seen
            before, if there are any. Without fruits, the arm looks for some before its first plan.
        robot: with its tool; None: the scene's.
        seed: of the plans.
        parameters: see :class:`LoopParameters`.
        servo: whether the tool follows the plant from the camera point on, and the push under way
            is predicted again; False: the plan made at the camera point is executed blind.
        real_time: whether a cycle's share of a search is cut by the clock as well as by its steps.

    Attributes:
        stage: what the controller does now.
        events: all decisions so far.
        cycles: wall time of each cycle [s].
        tracker: of the fruits.
        plans: the plans that were followed.
    """

    def __init__(
        self,
        scene: Scene,
        *,
        robot: Robot | None = None,
        seed: int = 0,
        parameters: LoopParameters = CONTROL,
        servo: bool = True,
        real_time: bool = False,
    ) -> None:
        compile_once()
        self.robot, state = posed(scene, robot)
        still = tuple(item for item in scene.objects if item.role in ("static", "avoid"))
        self._still = replace(scene, objects=still, goal=JointGoal(state.q))
        self.scene, self.seed, self.parameters, self.servo = scene, seed, parameters, servo
        self._seconds = parameters.slice_seconds if real_time else math.inf
        known = [item for item in scene.objects if item.role in ("target", "pushable")]
        self.tracker = Tracker(scene, first=[_sure(item, parameters) for item in known])
        self._known = bool(known)
        self.stage, self.events, self.cycles = LoopStage.LOOK, list[Decision](), list[float]()
        self.plans: list[Plan] = []
        self.tries = parameters.tries
        self._inbox: list[Look] = []
        self._why = ""
        self._seen = 0  # looks since the stage began
        self._since = 0.0
        self._checked = -math.inf
        self._at_camera = False
        self._course: Course | None = None
        self._route: Route | None = None
        self._job: _Job | None = None
        self._trail: list[FloatArray] = []  # (k, n) configurations on the way from the camera
        self._shift = np.zeros((0, 3))
        self._fallback = State(state.q)

    def see(self, look: Look) -> None:
        """Take a look in; looks may come late and out of order."""
        self._inbox.append(look)

    @property
    def ended(self) -> bool:
        """Whether the controller is done with the pick, or gave up."""
        return self.stage in ENDED

    def __call__(self, time: float, measured: State, reference: State) -> Stretch | None:
        """One cycle: the stretch that takes over at ``time`` + ``parameters.lead``.

        Args:
            time: by the clock of the looks [s].
            measured: state of the arm.
            reference: the last commanded state.

        Returns:
            The stretch; None: the running curve goes on.
        """
        began = wall.perf_counter()
        if self._course is None:
            self._fallback = State(reference.q)
        for look in self._inbox:
            self.tracker.add(look, self._pushed(look.time))
            self._seen += look.time >= self._since
        self._inbox.clear()
        made = self._cycle(time, self.tracker.at(time))
        self.cycles.append(wall.perf_counter() - began)
        return made

    # -- stages

    def _cycle(self, now: float, tracked: Tracked) -> Stretch | None:
        if self.stage is LoopStage.LOOK:
            return self._look(now, tracked)
        if self.stage is LoopStage.GO or self.stage is LoopStage.RETREAT:
            return self._go(now, tracked)
        return None

    def _enter(self, stage: LoopStage, now: float, why: str) -> None:
        self.stage, self._since, self._seen, self._why = stage, now, 0, why
        self.events.append(Decision(now, stage, why))
        if self._job is not None:
            self._job.work.drop()
            self._job = None

    def _look(self, now: float, tracked: Tracked) -> Stretch | None:
        p, course = self.parameters, self._course
        if course is not None and now < course.begins + course.curve.duration:
            self._since, self._seen = now, 0  # still in motion
            return None
        if self._job is None:
            looked = now - self._since
            enough = looked >= (p.look if self._at_camera else p.first_look) and self._seen >= 3
            enough |= self._known and not self._at_camera
            if not enough or not has_target(tracked):
                if looked > p.longest_look:
                    self._give_up(now, "the target is not seen")
                return None
            scene = scene_of(self.scene, tracked)
            self._plan_in(scene, start_state=State(self._state(now).q))
        made = self._worked()
        if made is None:
            return None
        harm = excess(made)
        enough = made.success or (harm < math.inf and not self._at_camera)  # it stops there
        if not (enough or (self.tries <= 0 and harm <= p.accepted)):
            self._again(now, f"no plan: {made.message}")
            return None
        self._trail = []
        self._take(made)
        self._enter(LoopStage.GO, now, f"{made.status}, {harm:.2f} of the harm that is allowed")
        return self._set_out(now, tracked)

    def _again(self, now: float, why: str) -> None:
        """Look again, or give up after the last try."""
        if self.tries <= 0:
            self._give_up(now, why)
            return
        self.tries -= 1
        self._enter(LoopStage.LOOK, now, why)

    def _give_up(self, now: float, why: str) -> None:
        self._enter(LoopStage.GAVE_UP, now, why)

    def _go(self, now: float, tracked: Tracked) -> Stretch | None:
        p, route, course = self.parameters, self._route, self._course
        assert route is not None
        assert course is not None
        begins = now + p.lead
        phase = course.phase_at(begins)
        if self.stage is LoopStage.RETREAT:
            if self._found_again(now, tracked, phase):
                self._again(now, "the target is seen again")
                return self._brake(begins)
            if phase >= route.duration:
                self._at_camera = True
                self._again(now, "looking again after a retreat")
                return None
            return self._moved(now, tracked, phase)
        made = route.plan
        assert made is not None
        if not self._at_camera and phase >= self._stop_at(route):
            self._at_camera = True
            self._enter(LoopStage.LOOK, now, "at the camera point")
            return self._brake(begins)
        if phase >= route.duration + p.hold:
            if not self._missed(now, tracked):
                self._enter(LoopStage.DONE, now, "at the target")
                return self._brake(begins)
            return self._retreat(now, tracked, route, route.duration, "the target is not inside")
        if self._at_camera and self.servo:
            if route.left(phase) < p.last and phase < route.duration and self._unsure(tracked):
                return self._retreat(now, tracked, route, phase, LOST)
            turn = self._watch(now, tracked, route, phase)
            if turn is not None:
                return turn
            if self._route is not route:
                return self._moved(now, tracked, self._phase)
        return self._moved(now, tracked, phase)

    def _found_again(self, now: float, tracked: Tracked, phase: float) -> bool:
        """Whether a target that was lost is well known again, some way back."""
        row, p = target_row(tracked), self.parameters
        if self._why != LOST or row is None or phase * p.retreat_speed < p.back:
            return False
        return (
            self.tries > 0
            and now - tracked.last_seen[row] < 0.2
            and deviation(tracked, row) < 0.5 * p.unsure
        )

    def _unsure(self, tracked: Tracked) -> bool:
        """Whether nobody knows well enough where the target is now."""
        row = target_row(tracked)
        return row is None or deviation(tracked, row) > self.parameters.unsure

    def _missed(self, now: float, tracked: Tracked) -> bool:
        """Whether the target is outside of the tool, or may be."""
        tool, row = self.robot.tool, target_row(tracked)
        if tool is None:
            return False
        if row is None or self._unsure(tracked):
            return True
        point, axis = self.robot.tool_pose(self._state(now).q)
        away = tracked.positions[row] - point
        along = float(away @ axis)
        aside = float(np.linalg.norm(away - along * axis))
        spread = deviation(tracked, row)
        return aside > max(tool.mouth[1], 0.01) + spread or along > tool.depth + spread

    def _stop_at(self, route: Route) -> float:
        """The phase at which the tool stops to look."""
        made = route.plan
        assert made is not None
        return max(float(route.trajectory.times[made.first]) - 0.15, 0.0)  # [s] of braking

    def _watch(self, now: float, tracked: Tracked, route: Route, phase: float) -> Stretch | None:
        """Predict the push under way, and plan anew where something changed."""
        p, made = self.parameters, route.plan
        assert made is not None
        if self._job is None:
            if now - self._checked < p.checked or phase >= route.duration - 2.0 * p.allowance:
                return None
            if not has_target(tracked) or changed(made.scene, tracked) < p.changed:
                return None
            _, moved, _ = displaced(made.scene, tracked)
            offset = moved.mean(axis=0) if len(moved) else np.zeros(3)
            at = phase + p.allowance
            self._checked, self._planned_at = now, at
            self._plan_in(
                scene_of(self.scene, tracked, offset), takeover=now + p.lead + p.allowance,
                previous=made, at=at, unpushed=True,
            )  # fmt: skip
        job = self._job
        assert job is not None
        found = self._worked()
        if found is None:
            return None
        if excess(found) <= p.hopeless:
            rows = route.trajectory.times <= self._planned_at
            self._trail.append(route.trajectory.positions[rows])
            self._take(found)
            assert job.takeover is not None
            self._phase = max(now + p.lead - job.takeover, 0.0)
            return None
        return self._retreat(now, tracked, route, phase, f"{found.status}: {found.message}")

    def _retreat(
        self, now: float, tracked: Tracked, route: Route, phase: float, why: str
    ) -> Stretch | None:
        """Go back along the path to the camera point."""
        passed = route.trajectory.positions[route.trajectory.times <= phase]
        if not self._trail:
            assert route.plan is not None
            passed = passed[min(route.plan.first, len(passed) - 1) :]
        q = np.concatenate([*self._trail, passed])[::-1]
        self._enter(LoopStage.RETREAT, now, why)
        if len(q) < 3:
            return self._brake(now + self.parameters.lead)
        back = way_back(self.robot, q, self.parameters.retreat_speed)
        scene = None if route.plan is None else route.plan.scene
        self._route, self._back_scene = Route.of(self.robot, back, 0, None), scene
        return self._set_out(now, tracked)

    # -- curves

    def _state(self, time: float) -> State:
        return self._fallback if self._course is None else self._course.state_at(time)

    def _take(self, made: Plan) -> None:
        self._route = Route.of(self.robot, made.trajectory, made.first, made)
        self._back_scene = made.scene
        self._shift = np.zeros((0, 3))
        self.plans.append(made)

    def _moved(self, now: float, tracked: Tracked, phase: float) -> Stretch | None:
        """The route from ``phase`` on, moved with the plant; None: the running curve goes on."""
        p, route = self.parameters, self._route
        assert route is not None
        begins = now + p.lead
        scene = self._back_scene
        assert scene is not None
        if not self.servo and self._at_camera:
            if phase > 0.0:
                return None
            self._course = Course(route.trajectory, begins, 0.0, 1.0)
            return Stretch(route.trajectory, begins)
        field = field_of(scene, tracked, p.field)
        ahead = np.clip(phase + np.array([0.1, 0.3, 0.6, 1.0]), 0.0, route.duration)
        row = np.searchsorted(route.trajectory.times, ahead).clip(max=len(route.points) - 1)
        shift = field.at(route.points[row], begins + np.maximum(ahead - phase, 0.0))
        if (
            self._shift.shape == shift.shape
            and phase < route.duration
            and np.abs(shift - self._shift).max() < p.still
        ):
            return None
        course = follow(route, phase, self._state(begins), begins, field, p)
        if course is None or not self._safe(course.curve):
            return None
        self._shift, self._course = shift, course
        return Stretch(course.curve, begins)

    def _set_out(self, now: float, tracked: Tracked) -> Stretch:
        """The begin of a route; where nothing leads onto it yet, the curve to rest."""
        begins = now + self.parameters.lead
        self._shift = np.zeros((0, 3))
        return self._moved(now, tracked, 0.0) or self._brake(begins)

    def _brake(self, begins: float) -> Stretch:
        """The curve that comes to rest at once; the arm then waits at the begin of its route."""
        curve = stopped(self.robot, self._state(begins))
        self._course = Course(curve, begins, 0.0, math.inf)
        return Stretch(curve, begins)

    def _safe(self, curve: Trajectory) -> bool:
        """Whether a curve keeps the limits and touches nothing that stands, by the judge."""
        found = judging.judge(self._still, self.robot, curve, curve.at(0.0), begun=True)
        return all(v.kind in ("goal", "start", "motion") for v in found.violations)

    # -- plans

    def _plan_in(self, scene: Scene, takeover: float | None = None, **begin: Any) -> None:
        options = PlanOptions()

        def work() -> Plan:
            return plan(scene, robot=self.robot, seed=self.seed, options=options, **begin)

        self._job = _Job(Sliced(work), takeover)

    def _worked(self) -> Plan | None:
        """The plan in the making, when it is done."""
        job = self._job
        assert job is not None
        if not job.work.lend(self.parameters.slice_steps, self._seconds):
            return None
        self._job = None
        return job.work.result()

    def _pushed(self, time: float) -> dict[str, FloatArray]:
        """Displacement of each fruit by the tool at a ``time`` [s], as the push model predicts."""
        route, course = self._route, self._course
        if route is None or route.plan is None or course is None or self.stage is not LoopStage.GO:
            return {}
        return pushed_by(route, course.phase_at(time))


def way_back(robot: Robot, q: FloatArray, speed: float) -> Trajectory:
    """The trajectory through configurations ``q`` (k, n) at a ``speed`` of the tool [m/s]."""
    points, _ = robot.tool_pose(q)
    gone = np.append(0.0, np.cumsum(lengths(np.diff(points, axis=0)))) + 1e-6 * np.arange(len(q))
    count = max(math.ceil(gone[-1] / 0.01), 4)  # [m] between waypoints
    at = np.linspace(0.0, gone[-1], count + 1)
    even = np.stack([np.interp(at, gone, joint) for joint in q.T], axis=1)
    widths = np.full(count, gone[-1] / count / speed)
    widths[[0, -1]] *= 2.0
    back = Trajectory.through(even, np.append(0.0, np.cumsum(widths)), robot.joint_names)
    return back.slowed(max(float(needs(robot, back).max()), 1.0))


def _sure(item: SceneObject, parameters: LoopParameters) -> SceneObject:
    """A fruit that was seen before, with a covariance."""
    if item.covariance is not None:
        return item
    return replace(item, covariance=parameters.known**2 * np.eye(3))


def excess(made: Plan) -> float:
    """Predicted harm over what a success may have; 0 without a model, infinite without a motion."""
    if made.status not in (Code.SUCCESS, Code.HARM_PREDICTED):
        return math.inf
    return 0.0 if made.prediction is None else made.prediction.harm / made.prediction.threshold
