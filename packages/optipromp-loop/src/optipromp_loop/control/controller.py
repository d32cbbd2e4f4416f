"""The controller: looks and states in, the next stretch of an executable curve out.

The tool goes to the camera point, looks, plans, and comes to the target along the plan's path,
moved with the plant. A prediction of the push under way, and where it asks for it a search, take
the time that the cycles leave over (:class:`Sliced`). A tool whose push has become hopeless stops,
leaves by the way of least harm, looks again and tries again. After the last try it gives up.
"""

from __future__ import annotations

import math
import time as wall
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from optipromp.core.arrays import FloatArray, frame_along, rotation
from optipromp.core.errors import InvalidRequestError, OptiPrompError
from optipromp.core.execution.streaming import Stretch
from optipromp.core.planning import Plan, plan
from optipromp.core.planning.legs import led_out
from optipromp.core.planning.task import posed
from optipromp.core.planning.warming import compile_once
from optipromp.core.robots import ik
from optipromp.core.robots.model import Robot
from optipromp.core.scenes.look import Look
from optipromp.core.scenes.scene import Scene
from optipromp.core.trajectory import State
from optipromp_loop.control import driver
from optipromp_loop.control.camera import CameraWatch
from optipromp_loop.control.driver import Driver, Route
from optipromp_loop.control.parameters import CONTROL, LoopParameters
from optipromp_loop.control.slices import Sliced
from optipromp_loop.control.stiffness import Stiffness, by_wrench
from optipromp_loop.control.tracker import Tracked, Tracker
from optipromp_loop.control.tracks import TrackerParameters
from optipromp_loop.control.wayout import ways_out


class LoopStage(StrEnum):
    """What the controller does."""

    LOOK = "look"  # it stands and looks, or plans
    GO = "go"  # the tool follows a plan, moved with the plant
    RETREAT = "retreat"  # the tool leaves, with the target or without
    DONE = "done"  # the tool is at the target, or outside with it
    GAVE_UP = "gave_up"  # the tool stands away from the fruits


@dataclass(frozen=True)
class Decision:
    """A decision: its time by the controller's clock [s], the stage that begins, and the reason."""

    time: float
    stage: LoopStage
    why: str


def excess_harm(made: Plan | OptiPrompError) -> float:
    """Predicted harm over what a success may have; 0 without a model, infinite without a motion."""
    if isinstance(made, OptiPrompError) or not made.valid:
        return math.inf
    return 0.0 if made.prediction is None else made.prediction.harm / made.prediction.threshold


_STEPS = 8  # of a turn, each at most 7 degrees: inverse kinematics stays on its branch
_MISS = 1e-6  # [m] error above which a configuration is none
STANDS = "the camera's pictures stand still"
BRAKING = 0.15  # [s] before the approach, at which the tool begins to stop and look: a choice


class _Made(NamedTuple):
    """A plan, its harm over what a success may have, and what the plan or its harm tells.

    The harm is that of the way in; infinite where a pick may not do that of the way out.
    """

    plan: Plan | OptiPrompError
    harm: float
    why: str


@dataclass(frozen=True, eq=False)
class _Job:
    """A plan in the making, or the ways out of a retreat.

    ``at`` is the phase of the running route in whose state it begins [s], ``takeover`` the time of
    that state [s], and ``factor`` the stiffness of its stems over the assumed one.
    """

    work: Sliced[Any]
    factor: float
    at: float = 0.0
    takeover: float = 0.0


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
        leave: whether the pick ends outside of the plant: at the target the tool searches the way
            out of least harm with what it holds, and follows the plant on that way.

    Attributes:
        holding: whether the tool leaves with the target, from when on its executor may grip.
        fault: why the arm is held where it is, whatever the stage; empty: it is not.
        lost: whether that is for good, as the arm did not follow its curve.
        stage: what the controller does now.
        events: all decisions so far.
        noticed: what was noticed of the camera and of the target, each in the stage that it was in.
        cycles: wall time of each cycle [s].
        tracker: of the fruits.
        stiffness: what the pushes so far told of the stems.
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
        leave: bool = False,
    ) -> None:
        if moving := [item.id for item, _ in scene.movers if item.role != "pushable"]:
            told = "a closed loop follows fruits alone; leave the motion out, or plan without one"
            raise InvalidRequestError(f"{', '.join(moving)} move: {told}")
        compile_once()
        self.robot, state = posed(scene, robot)
        self.seed, self.parameters, self.servo = seed, parameters, servo
        self.fault, self.lost = "", False
        self.holding, self._leave = False, leave and self.robot.tool is not None
        self.scene = scene = driver.tracked_at_most(scene, TrackerParameters.most)
        self._camera = CameraWatch(self.robot, parameters)
        first = driver.first_tracks(scene, parameters.known)
        self.tracker = Tracker(scene, first=first, tool=self._mouth)
        self.noticed = list[Decision]()
        self.stage, self.events, self.cycles = LoopStage.LOOK, list[Decision](), list[float]()
        self.plans: list[Plan] = []
        self.stiffness = Stiffness.prior()
        self.tries = parameters.tries
        self._driver = Driver(scene, self.robot, state, parameters)
        self._seconds = parameters.slice_seconds if real_time else math.inf
        self._known, self._at_camera = bool(first), False
        self._inbox: list[Look] = []
        self._newest = -math.inf  # time of the newest look [s]
        self._looked: float | None = None  # when it came, or the first cycle began [s]
        self._eye: FloatArray | None = None  # place of the camera at the last look
        self._since, self._seen = 0.0, 0  # begin of the stage, and looks since
        self._job: _Job | None = None
        self._checked = -math.inf
        self._factor = 1.0  # of the stems in the plan that is followed
        self._force: FloatArray | None = None
        self._learnt_at = np.full(3, np.inf)  # tool point of the last observation of the stems
        self._views: list[FloatArray] | None = None  # that are left; None: none was needed
        self._trail: list[FloatArray] = []  # (k, n) configurations on the way from the camera
        self._last = ""  # why there is no other try; empty: there may be one
        self._target_at: tuple[float, FloatArray] | None = None  # time, place (3,) of its detection

    def see(self, look: Look) -> None:
        """Take a look in; looks may come late and out of order.

        A look of a camera whose clock is ahead waits until its time has come.
        """
        self._inbox.append(look)

    def feel(self, force: FloatArray) -> None:
        """Take in the force (3,) of the world on the tool, without gravity, in the base frame [N].

        For arms that report one, in every cycle.
        """
        self._force = np.asarray(force, dtype=np.float64)

    @property
    def history(self) -> list[Decision]:
        """Decisions and what was noticed, in order of time."""
        return sorted([*self.noticed, *self.events], key=lambda item: item.time)

    @property
    def ended(self) -> bool:
        """Whether the controller is done with the pick, or gave up."""
        return self.stage in (LoopStage.DONE, LoopStage.GAVE_UP)

    def __call__(self, time: float, measured: State, reference: State) -> Stretch | None:
        """One cycle: the stretch that takes over at ``time`` + ``parameters.lead``.

        Args:
            time: by the clock of the looks [s].
            measured: state of the arm; joints that may turn on any turn.
            reference: the commanded state at the time of the measured one.

        Returns:
            The stretch; None: the running curve goes on. Before the controller has
            :attr:`ended`, an arm that stands gets stretches that stand. Where no look has come for
            ``parameters.look_age`` the arm comes to rest, and waits for one. Where it is farther
            from the reference than ``parameters.off_curve`` it comes to rest where it is measured,
            and stays: :attr:`lost`.
        """
        began = wall.perf_counter()
        on = self.robot.turns.onto(measured.q, reference.q)
        measured = replace(measured, q=on)
        self._driver.stands_at(reference.q)
        self._camera.follow(time, measured.q)
        due = [look for look in self._inbox if look.time <= time]
        self._inbox = [look for look in self._inbox if look.time > time]
        newest = max((look.time for look in due), default=-math.inf)
        if self._looked is None or newest > self._newest:
            self._newest, self._looked = newest, time
        for look in due:
            self._take(look, time)
        made, age = None, self.parameters.look_age
        if self.ended:
            pass
        elif away := self._away(measured, reference):
            made = self._stop(time, measured, away)
        elif self.lost:
            pass
        elif time - self._looked > age:
            made = self._hold(time, f"no look has come for {age:g} s")
        else:
            self.fault = ""
            made = self._staged(time, self.tracker.at(time))
        if made is None and not self.ended and self._driver.rests(time):
            made = self._driver.stand(time + self.parameters.lead)
        self.cycles.append(wall.perf_counter() - began)
        return made

    def _staged(self, time: float, tracked: Tracked) -> Stretch | None:
        """What the stage asks for."""
        if why := self._trouble(time):
            return self._break_off(time, tracked, why)
        if self.stage is LoopStage.LOOK:
            return self._look(time, tracked)
        return (self._go if self.stage is LoopStage.GO else self._go_back)(time, tracked)

    # -- holds

    def hold(self, time: float, why: str) -> Stretch | None:
        """A cycle without a state of the arm: come to rest on the running curve, and wait.

        Looks that come meanwhile are dropped. The next cycle goes on.

        Args:
            time: as for a cycle [s].
            why: for :attr:`fault`.
        """
        if self._inbox:
            self._looked = time
        self._inbox.clear()
        return None if self.ended or self.lost else self._hold(time, why)

    def begin_anew(self, time: float, measured: State) -> None:
        """Let the next curve of an arm at rest begin where it is measured, at a ``time`` [s]."""
        self._driver.stands_at(measured.q, time)

    def _hold(self, now: float, why: str) -> Stretch | None:
        if why != self.fault:
            self._notice(now, why)
        self.fault = why
        if self.stage is LoopStage.GO and self._driver.blind:
            self._enter(LoopStage.LOOK, now, why)  # a blind route has no way back onto it
        if self.stage is not LoopStage.RETREAT:
            self._drop()
        if self.stage is LoopStage.LOOK:
            self._since, self._seen = now, 0
        return self._driver.halt(now)

    def _away(self, measured: State, reference: State) -> str:
        """Which joint is too far from the curve; empty: none is."""
        away, most = np.abs(measured.q - reference.q), self.parameters.off_curve
        joint = int(np.argmax(away))
        name = self.robot.joint_names[joint]
        told = f"{name} is {away[joint]:.3g} from the curve (at most {most:g})"
        return told if away[joint] > most else ""

    def _stop(self, now: float, measured: State, why: str) -> Stretch:
        """Come to rest from where the arm is, and wait for good: it does not follow."""
        if not self.lost:
            self._notice(now, why)
            self.fault, self.lost = why, True
        self._drop()
        fastest = self.robot.velocity
        state = State(measured.q, np.clip(measured.velocity, -fastest, fastest))
        return self._driver.brake(now + self.parameters.lead, state)

    # -- looks

    def _take(self, look: Look, now: float) -> None:
        """Fold a look in, if it tells anything."""
        pushing = self._at_camera and self.stage is LoopStage.GO
        seen = self._camera.checked(look, still=not pushing and self.stage is not LoopStage.RETREAT)
        while self._camera.news:
            self._notice(now, self._camera.news.pop(0))
        if seen is None:
            return
        pushed = self._pushed(seen.time)
        self._eye = seen.camera.position
        if pushing and self.servo and not self._last and self._falls(seen):
            self._last = "the target falls: its stem broke"
            self._notice(now, self._last)
        self.tracker.add(seen, pushed)
        self._learn(seen, pushed)
        self._seen += seen.time >= self._since

    def _notice(self, now: float, what: str) -> None:
        self.noticed.append(Decision(now, self.stage, what))

    def _mouth(self, time: float) -> FloatArray:
        return driver.mouth_balls(self.robot, self._camera.configuration(time), self._eye)

    def _falls(self, look: Look) -> bool:
        """Whether the look shows the target below its place, and faster down than a plant moves."""
        p, up = self.parameters, self.scene.up
        tracked = self.tracker.at(look.time)
        row = driver.target_row(tracked)
        seen = [look.camera @ item.position for item in look.detections if item.role == "target"]
        if row is None or not seen:
            return False
        expected, before = tracked.positions[row], self._target_at
        place = min(seen, key=lambda at: float(np.linalg.norm(at - expected)))
        self._target_at = look.time, place
        if before is None or not 0.0 < look.time - before[0] < p.picture_still:
            return False
        drop = float((expected - place) @ up)
        aside = float(np.linalg.norm(expected - place - drop * up))
        speed = float((before[1] - place) @ up) / (look.time - before[0])
        return speed > p.fall and drop > max(p.dropped, aside)

    def _trouble(self, now: float) -> str:
        """Why the arm must not go on; empty: it may."""
        if self.stage is LoopStage.RETREAT:
            return ""
        since, p = self._camera.standing, self.parameters
        if since is None or now - since <= p.picture_still + p.picture_wait:
            since = None
        self._last = self._last or self._camera.refused
        pushing = self.stage is LoopStage.GO and self._at_camera and self.servo
        return self._last or (STANDS if pushing and since is not None else "")

    def _break_off(self, now: float, tracked: Tracked, why: str) -> Stretch | None:
        """Back out of the fruits; where the tool is outside of them, stand and give up."""
        route, begins = self._driver.route, now + self.parameters.lead
        if self.stage is LoopStage.GO and self._at_camera and route is not None and route.plan:
            return self._retreat(now, self._driver.phase(begins), why)
        self._enter(LoopStage.GAVE_UP, now, why)
        return None if self._driver.rests(now) else self._driver.brake(begins)

    # -- stages: each gives the next stretch, or None

    def _look(self, now: float, tracked: Tracked) -> Stretch | None:
        if not self._driver.rests(now):
            self._since, self._seen = now, 0
            return None
        if math.isinf(self._newest):  # no look has come yet
            return None
        p = self.parameters
        if self._job is None:
            if not self._seen_enough(now, tracked):
                if now - self._since > (p.longest_look if self._views is None else p.look):
                    return self._look_elsewhere(now, tracked)
                return None
            begin = State(self._driver.state(now).q)
            stems, factor = self._stems()
            scene = driver.tracked_scene(self.scene, tracked, None, stems)
            self._job = _Job(self._planning(scene, start_state=begin), factor)
        factor = self._job.factor
        done = self._worked()
        if done is None:
            return None
        made, harm, why = done
        enough = harm <= 1.0 or (harm < math.inf and not self._at_camera)  # it stops there
        ahead = now + np.linspace(0.0, p.patient, 9)
        accepted = p.accepted if driver.restless(tracked, ahead) <= p.restless else 1.0
        if isinstance(made, OptiPrompError) or not (
            enough or (self.tries <= 0 and harm <= accepted)
        ):
            self._again(now, f"no plan: {why}")
            return None
        self._trail, self._factor = [], factor
        self.plans.append(made)
        why = f"{made.status}, {harm:.2f} of the harm that is allowed"
        if self._eye is not None and (missing := driver.unseen(tracked, self._eye, self._since)):
            names = (f"{a} (behind {b})" if b else a for a, b in missing.items())
            why += f"; not seen from here: {', '.join(names)}"
        if self.tracker.left:
            why += f"; {self.tracker.left} that were seen are not tracked, as too many"
        self._enter(LoopStage.GO, now, why)
        self._driver.blind = self._at_camera and not self.servo
        return self._driver.set_out(Route.of(made), now, tracked)

    def _seen_enough(self, now: float, tracked: Tracked) -> bool:
        """Whether the arm has looked for long enough for a plan."""
        p, looked = self.parameters, now - self._since
        if driver.target_row(tracked) is None:
            return False
        if not self._at_camera:
            return (self._seen >= 3 and self._known) or (
                looked >= p.first_look and (self._seen >= 3 or self._known)
            )
        if looked < p.look or self._seen < 3:
            return False
        return looked > p.patient or driver.rests_known(tracked, p.settled)

    def _look_elsewhere(self, now: float, tracked: Tracked) -> Stretch | None:
        """Go to another view of the start; give up where none is left."""
        drive, q = self._driver, self._driver.state(now).q
        if self._views is None:
            self._views = [] if self._at_camera else views(self.robot, q, self.parameters)
        while self._views:
            way = np.array([q, self._views.pop(0)])
            turn = driver.path_back(self.robot, way, self.parameters.retreat_speed)
            if drive.safe(turn):
                self._enter(LoopStage.GO, now, "the target is not seen: to another view")
                return drive.set_out(Route.back(self.robot, turn, drive.still), now, tracked)
        stands = self._camera.standing is not None
        why = STANDS if stands else "the target is not seen"
        self._enter(LoopStage.GAVE_UP, now, why)
        return None

    def _go(self, now: float, tracked: Tracked) -> Stretch | None:
        p, drive = self.parameters, self._driver
        route, begins = drive.route, now + p.lead
        assert route is not None
        phase = drive.phase(begins)
        if drive.stuck(now):
            self._again(now, "nothing leads onto the path")
            return None
        if route.plan is None:  # the way to another view
            if phase < route.duration:
                return drive.go_on(now, tracked)
            self._enter(LoopStage.LOOK, now, "at another view")
            return drive.brake(begins)
        if not self._at_camera and phase >= route.approach - BRAKING:
            self._at_camera = True
            self._enter(LoopStage.LOOK, now, "at the camera point")
            return drive.brake(begins)
        if not self._at_camera and (new := driver.appeared(route.scene, tracked)):
            self._enter(LoopStage.LOOK, now, f"seen on the way: {', '.join(new)}")
            return drive.brake(begins)
        if phase >= route.duration + p.hold:
            if driver.outside(self.robot, drive.state(now).q, tracked):
                return self._retreat(now, route.duration, "the target is not inside")
            if self._leave:
                self.holding = True
                q = self._passed(route, route.duration)
                self._enter(LoopStage.RETREAT, now, "out with the target")
                self._job = _Job(Sliced(partial(ways_out, route.plan, q, True)), 1.0)
                drive.hold(now, tracked)
                return drive.go_on(now, tracked)
            self._enter(LoopStage.DONE, now, "at the target")
            return drive.brake(begins)
        if self._at_camera and self.servo:
            since = self._camera.standing
            if since is not None and now - since > p.picture_still:
                return None if drive.waits else drive.pause(begins)
            if driver.target_row(tracked) is None:
                why = "the target is no longer where it must be seen"
                return self._retreat(now, phase, why)
            turn = self._watch(now, tracked, route.plan, phase)
            if turn is not None:
                return turn
        return drive.go_on(now, tracked)

    def _go_back(self, now: float, tracked: Tracked) -> Stretch | None:
        drive, begins = self._driver, now + self.parameters.lead
        route = drive.route
        assert route is not None
        if self._job is not None:
            ways = self._worked() if self.holding or drive.rests(now) else None
            for q in ways or ():
                back = driver.path_back(self.robot, q, self.parameters.retreat_speed)
                if drive.safe(back):
                    out = Route.back(self.robot, back, route.scene)
                    out = replace(out, came=(route, drive.phase(now)))
                    return drive.set_out(out, now, tracked)
            if ways:
                self._enter(LoopStage.GAVE_UP, now, "no way out is free")
            return drive.go_on(now, tracked) if self.holding and not ways else None
        if drive.phase(begins) >= route.duration or drive.stuck(now):
            if self.holding:
                self._enter(LoopStage.DONE, now, "outside with the target")
                return drive.brake(begins)
            self._again(now, "looking again after a retreat")
            return drive.brake(begins)
        return drive.go_on(now, tracked)

    # -- decisions

    def _enter(self, stage: LoopStage, now: float, why: str) -> None:
        self.stage, self._since, self._seen = stage, now, 0
        self.events.append(Decision(now, stage, why))
        self._drop()

    def _drop(self) -> None:
        """Leave the job."""
        if self._job is not None:
            self._job.work.drop()
            self._job = None

    def _again(self, now: float, why: str) -> None:
        """Look again, or give up after the last try."""
        if self.tries <= 0 or self._last:
            self._enter(LoopStage.GAVE_UP, now, self._last or why)
            return
        self.tries -= 1
        self._enter(LoopStage.LOOK, now, why)

    def _watch(self, now: float, tracked: Tracked, made: Plan, phase: float) -> Stretch | None:
        """Predict the push under way, and plan anew, where something changed."""
        p = self.parameters
        if self._job is None:
            late = phase >= made.trajectory.duration - 2.0 * p.allowance
            if late or now - self._checked < p.checked or driver.target_row(tracked) is None:
                return None
            if driver.changed(made.scene, tracked) < p.changed:
                return None
            _, moved, _ = driver.displaced(made.scene, tracked)
            stems, factor = self._stems()
            offset = moved.mean(axis=0) if len(moved) else None
            scene = driver.tracked_scene(self.scene, tracked, offset, stems)
            at = phase + p.allowance
            work = self._planning(scene, previous=made, at=at, unpushed=True)
            self._job = _Job(work, factor, at, now + p.lead + p.allowance)
            self._checked = now
        job = self._job
        done = self._worked()
        if done is None:
            return None
        found, harm, why = done
        if isinstance(found, OptiPrompError) or harm > p.hopeless:
            return self._retreat(now, phase, why)
        since = max(now + p.lead - job.takeover, 0.0)
        taken = self._driver.take(Route.of(found), since, now, tracked)
        if taken is not None:
            rows = made.trajectory.times <= job.at
            self._trail.append(made.trajectory.positions[rows])
            self.plans.append(found)
            self._factor = job.factor
        return taken

    def _retreat(self, now: float, phase: float, why: str) -> Stretch:
        """Stop, and search the way out of least harm."""
        route = self._driver.route
        assert route is not None
        assert route.plan is not None
        q = self._passed(route, phase)
        self._enter(LoopStage.RETREAT, now, why)
        self._driver.blind = False
        stop = self._driver.pause(now + self.parameters.lead)
        q = np.vstack([q, stop.curve.positions[-1]])
        self._job = _Job(Sliced(partial(ways_out, route.plan, q)), 1.0)
        return stop

    def _passed(self, route: Route, phase: float) -> FloatArray:
        """Configurations (k, n) of the approach until a ``phase`` of the route."""
        assert route.plan is not None
        passed = route.trajectory.positions[route.trajectory.times <= phase]
        if not self._trail:
            passed = passed[min(route.plan.first, len(passed) - 1) :]
        return np.concatenate([*self._trail, passed])

    # -- the stems

    def _stems(self) -> tuple[Stiffness | None, float]:
        """What plans are told of the stems, and the factor in it."""
        known = self.stiffness
        return (known, known.factor) if known.spread < self.parameters.told else (None, 1.0)

    def _learn(self, look: Look, pushed: dict[str, FloatArray]) -> None:
        """Learn the stems' stiffness from the force at the tool and from how fruits gave way."""
        p, route = self.parameters, self._driver.route
        if self._force is None or route is None or not pushed:
            return
        point, _ = self.robot.tool_pose(self._driver.state(look.time).q)
        if np.linalg.norm(point - self._learnt_at) < p.learnt:
            return
        tracked = self.tracker.at(look.time)
        given = driver.gave_way(route.scene, look, tracked, pushed, p)
        if given:
            self._learnt_at = point
            square = by_wrench(given, self._factor, self._force, self.scene.up, p)
            self.stiffness = self.stiffness.after(square)

    # -- plans

    def _planning(self, scene: Scene, **begin: Any) -> Sliced[_Made]:
        hopeless = self.parameters.hopeless
        leaves = self._leave and self._at_camera and self.stage is LoopStage.LOOK

        def work() -> _Made:
            try:
                made = plan(scene, robot=self.robot, seed=self.seed, unhurried=True, **begin)
            except OptiPrompError as error:
                return _Made(error, math.inf, error.message)
            harm = excess_harm(made)
            if leaves and harm <= hopeless:
                for name, leg in led_out(made).items():
                    if leg is not made and excess_harm(leg) > 1.0:
                        return _Made(made, math.inf, f"{name}: {leg.message}")
            return _Made(made, harm, made.message)

        return Sliced(work)

    def _worked(self) -> Any:
        """The result of the job when it is done, else None."""
        job = self._job
        assert job is not None
        if not job.work.lend(self.parameters.slice_steps, self._seconds):
            return None
        self._job = None
        return job.work.result()

    def _pushed(self, time: float) -> dict[str, FloatArray]:
        """Displacement of each fruit by the tool at a ``time`` [s], as the push model predicts."""
        route = self._driver.route
        if route is None or self.stage not in (LoopStage.GO, LoopStage.RETREAT):
            return {}
        return driver.pushed_by(route, self._driver.phase(time))


def views(robot: Robot, q: FloatArray, parameters: LoopParameters) -> list[FloatArray]:
    """Configurations (n,) from which a camera on the tool sees what it does not see from ``q``.

    The tool point stays. The tool axis turns by each of ``parameters.views`` [degrees], to four
    sides each; what the arm does not reach is left out.
    """
    point, axis = robot.tool_pose(q)
    across = frame_along(axis)[:, :2].T
    found = []
    for angle in parameters.views:
        for side in (across[0], across[1], -across[0], -across[1]):
            part = np.linspace(0.0, math.radians(angle), _STEPS + 1)[1:]
            axes = np.array([rotation(side, one) @ axis for one in part])
            path, errors = ik.track(robot, np.tile(point, (_STEPS, 1)), axes, q)
            if errors.max() <= _MISS:
                found.append(path[-1])
    return found
