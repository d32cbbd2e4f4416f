"""The controller: looks and states in, the next stretch of an executable curve out.

The tool goes to the camera point and comes to rest there, looks, commits itself to a pick with its
way out, and comes to the target along its path, moved with the plant. The pick is predicted again
as looks come in; its work takes the time that the cycles leave over (:class:`Sliced`). What each
stage does is in :mod:`optipromp_loop.control.stages`.
"""

from __future__ import annotations

import math
import time as wall
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from optipromp.core.arrays import FloatArray
from optipromp.core.execution.streaming import Stretch
from optipromp.core.planning.warming import compile_once
from optipromp.core.pushing.path import length
from optipromp.core.robots.model import Robot
from optipromp.core.scenes.look import Look
from optipromp.core.scenes.scene import Scene
from optipromp.core.trajectory import State, Trajectory
from optipromp_loop.control import courses, plant
from optipromp_loop.control.common import Common
from optipromp_loop.control.courses import Course, Route
from optipromp_loop.control.parameters import CONTROL, LoopParameters
from optipromp_loop.control.slices import Sliced
from optipromp_loop.control.stages import (
    AFTER,
    FALLS,
    STANDS,
    Leave,
    LoopStage,
    Next,
    Observe,
    Push,
    Stage,
    Step,
    Take,
)
from optipromp_loop.control.wayout import led_back


@dataclass(frozen=True)
class Decision:
    """A decision: its time by the controller's clock [s], the stage that begins, and the reason."""

    time: float
    stage: LoopStage
    why: str


class Controller(Common):
    """A closed loop for one pick.

    Args:
        scene: robot, tool, approach, the objects that stand still, and fruits that were seen
            before, if there are any. Without fruits, the arm looks for some before its first plan.
        robot: with its tool; None: the scene's.
        seed: of the plans.
        parameters: see :class:`LoopParameters`.
        real_time: whether a cycle's share of a search is cut by the clock as well as by its steps.

    Attributes:
        events: all decisions so far.
        noticed: what was noticed of the camera and of the target, each in the stage that it was in.
        fault: why the arm is held where it is, whatever the stage; empty: it is not.
        lost: whether that is for good, as the arm did not follow its curve.
        cycles: wall time of each cycle [s].
        doing: the stage.
    """

    def __init__(
        self,
        scene: Scene,
        *,
        robot: Robot | None = None,
        seed: int = 0,
        parameters: LoopParameters = CONTROL,
        real_time: bool = False,
    ) -> None:
        compile_once()
        limit = parameters.slice_seconds if real_time else math.inf
        super().__init__(scene, robot, seed, replace(parameters, slice_seconds=limit))
        self.doing: Stage = Observe()
        self.events, self.noticed, self.cycles = list[Decision](), list[Decision](), list[float]()
        self.fault, self.lost = "", False

    def see(self, look: Look) -> None:
        """Take a look in; looks may come late and out of order.

        A look of a camera whose clock is ahead waits until its time has come.
        """
        self.looks.inbox.append(look)

    def feel(self, time: float, force: FloatArray) -> None:
        """Take a measured force in, which tells at the end whether the target is in the tool.

        Args:
            time: by the clock of the looks [s].
            force: (3,) of the world on the tool, in the frame of the base, without the weight of
                the tool itself [N]. The way in and the way out do without.

        Raises:
            InvalidRequestError: no three finite values.
        """
        self.felt.feel(time, force)

    def goes_on(self, time: float, curve: Trajectory, came: Route | None, why: str) -> None:
        """Begin with an arm that comes to rest on a ``curve`` from a ``time`` on [s].

        ``came``: the way of a tool that rests among fruits, and leaves them first; None: it is free
        of fruits. ``why``: it leaves.
        """
        phase = 0.0 if came is None else came.duration
        self.driver.course = Course(curve, time, phase, math.inf)
        if came is not None:
            self.driver.route = came
            q, far = came.trajectory.positions, length(came.points)
            work = Sliced(partial(led_back, self.robot, came.pushes, q, far))
            self.doing = Leave(work, why)
            self.events.append(Decision(time, self.stage, why))

    @property
    def stage(self) -> LoopStage:
        """What the controller does now."""
        return self.doing.name

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
        measured = replace(measured, q=self.robot.turns.onto(measured.q, reference.q))
        self.driver.stands_at(reference.q)
        self.camera.follow(time, measured.q)
        for look in self.looks.due(time):
            self._take(look, time)
        made, age = None, self.parameters.look_age
        assert self.looks.came is not None
        if self.ended:
            pass
        elif away := self._away(measured, reference):
            made = self._stop(time, measured, away)
        elif self.lost:
            pass
        elif time - self.looks.came > age:
            made = self._hold(time, f"no look has come for {age:g} s")
        else:
            self.fault = ""
            made, after = self._cycle(time)
            if after is not None:
                self._enter(time, after)
        if made is None and not self.ended and self.driver.rests(time):
            made = self.driver.stand(time + self.parameters.lead)
        self.cycles.append(wall.perf_counter() - began)
        return made

    def _cycle(self, time: float) -> Step:
        """The cycle of the stage, or its end where the arm must not go on."""
        standing, p = self.camera.standing, self.parameters
        self.over = self.over or self.camera.refused
        pushing = isinstance(self.doing, Push)
        still = standing is not None and time - standing > p.picture_still + p.picture_wait
        why = self.over or (STANDS if pushing and still else "")
        if why:
            return self.doing.ends(self, time, why)
        return self.doing.cycle(self, time, self.tracker.at(time))

    def _enter(self, now: float, after: Next) -> None:
        assert after.stage.name in AFTER[self.stage], f"{after.stage.name} after {self.stage}"
        self.doing.drop()
        self.doing = after.stage
        self.events.append(Decision(now, self.stage, after.why))

    # -- holds

    def hold(self, time: float, why: str) -> Stretch | None:
        """A cycle without a state of the arm: come to rest on the running curve, and wait.

        Looks that come meanwhile are dropped. The next cycle goes on.

        Args:
            time: as for a cycle [s].
            why: for :attr:`fault`.
        """
        if self.looks.inbox:
            self.looks.came = time
        self.looks.inbox.clear()
        return None if self.ended or self.lost else self._hold(time, why)

    def begin_anew(self, time: float, measured: State) -> None:
        """Let the next curve of an arm at rest begin where it is measured, at a ``time`` [s]."""
        self.driver.stands_at(measured.q, time)

    def _hold(self, now: float, why: str) -> Stretch | None:
        if why != self.fault:
            self._notice(now, why)
        self.fault = why
        self.doing.held(self, now, why)
        return self.driver.halt(now)

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
        self.doing.drop()
        fastest = self.robot.velocity
        state = State(measured.q, np.clip(measured.velocity, -fastest, fastest))
        return self.driver.brake(now + self.parameters.lead, state)

    # -- looks

    def _take(self, look: Look, now: float) -> None:
        """Fold a look in, if it tells anything."""
        shift = self.camera.shift
        seen = self.camera.checked(look, still=not self.doing.among)
        if self.camera.shift != shift:  # stamps are corrected from here on
            self.know_what_was_told()
            self.doing.held(self, now, "")
        while self.camera.news:
            self._notice(now, self.camera.news.pop(0))
        if seen is None:
            return
        seen = plant.untold(seen, self.scene, self.parameters.reach)
        pushed = dict[str, FloatArray]()
        if self.doing.among:
            pushed = courses.pushed_by(self.driver.route, self.driver.phase(seen.time))
        self.looks.eye = seen.camera.position
        if isinstance(self.doing, Take):
            self.doing.sees(self, seen)
        elif isinstance(self.doing, Push) and not self.over and self.doing.falls(self, seen):
            self.over = FALLS
            self._notice(now, FALLS)
            self._enter(now, Next(Take(self.doing, fallen=True), FALLS))
        self.tracker.add(seen, pushed)
        self.stands(seen, self.doing.among)
        if isinstance(self.doing, Observe):
            self.doing.seen += seen.time >= self.doing.since

    def _notice(self, now: float, what: str) -> None:
        self.noticed.append(Decision(now, self.stage, what))
