"""The stages of the closed loop: each says what the arm does next, and which stage follows.

A stage is made when it begins and holds what only it needs. :data:`AFTER` is the table of what may
follow what.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum
from functools import partial
from typing import Any, ClassVar

import numpy as np

from optipromp.core.arrays import FloatArray
from optipromp.core.errors import OptiPrompError
from optipromp.core.execution.streaming import Stretch
from optipromp.core.planning import Picked, Plan
from optipromp.core.planning.result import RETREAT
from optipromp.core.scenes.look import Look
from optipromp.core.scenes.scene import Scene
from optipromp_loop.control import courses, driver, plant
from optipromp_loop.control.common import Common
from optipromp_loop.control.courses import Displacement, Route
from optipromp_loop.control.picks import (
    Choice,
    committed,
    compared,
    excess,
    foreseen,
    to_camera_point,
)
from optipromp_loop.control.slices import Sliced
from optipromp_loop.control.tracker import Tracked
from optipromp_loop.control.wayout import ways_out


class LoopStage(StrEnum):
    """What the controller does."""

    OBSERVE = "observe"  # it stands and looks, or plans
    TRAVEL = "travel"  # the tool goes to a view or to the camera point
    PUSH = "push"  # the tool comes to the target, moved with the plant
    TAKE = "take"  # the tool is at the target, and takes it in
    LEAVE = "leave"  # the tool leaves the plant, with the target or without
    DONE = "done"  # the tool is outside with the target; one that cannot leave, at the target
    GAVE_UP = "gave_up"  # the tool stands away from the fruits


OBSERVE, TRAVEL, PUSH, TAKE, LEAVE, DONE, GAVE_UP = LoopStage
AFTER: Mapping[LoopStage, frozenset[LoopStage]] = {
    OBSERVE: frozenset({OBSERVE, TRAVEL, PUSH, GAVE_UP}),
    TRAVEL: frozenset({OBSERVE, GAVE_UP}),
    PUSH: frozenset({TAKE, LEAVE}),
    TAKE: frozenset({LEAVE, DONE}),
    LEAVE: frozenset({OBSERVE, DONE, GAVE_UP}),
    DONE: frozenset(),
    GAVE_UP: frozenset(),
}
"""The stages that may follow a stage."""
STANDS = "the camera's pictures stand still"
BLOCKED = "something that nobody told stands in the way"
FALLS = "the target falls: its stem broke"
OUTSIDE = "outside with the target"


@dataclass(frozen=True)
class Next:
    """The stage that follows, and why."""

    stage: Stage
    why: str


Step = tuple[Stretch | None, Next | None]
"""The stretch that takes over, and the stage that follows; None: what runs goes on."""


class Stage(ABC):
    """A stage; ``among`` tells whether the tool may be among fruits in it."""

    name: ClassVar[LoopStage]
    among: ClassVar[bool] = False
    job: Sliced[Any] | None = None

    @abstractmethod
    def cycle(self, loop: Common, now: float, tracked: Tracked) -> Step:
        """One cycle at the time ``now`` [s], with the fruits as they are ``tracked``."""

    def held(self, loop: Common, now: float, why: str) -> None:
        """The arm comes to rest, for a fault outside of the stage."""
        self.drop()

    def ends(self, loop: Common, now: float, why: str) -> Step:
        """The pick must not go on: away from the fruits the arm stands."""
        begins = now + loop.parameters.lead
        stop = None if loop.driver.rests(now) else loop.driver.brake(begins)
        return stop, Next(Stand(GAVE_UP), why)

    def drop(self) -> None:
        """Leave the work that is not done."""
        if self.job is not None:
            self.job.drop()
            self.job = None

    def worked(self, loop: Common, standing: bool = False) -> Any:
        """The result of the job when it is done, else None; an arm that stands gives more time."""
        assert self.job is not None
        p = loop.parameters
        steps = p.standing_steps if standing else p.slice_steps
        if not self.job.lend(steps, p.slice_seconds * steps / p.slice_steps):
            return None
        done, self.job = self.job, None
        return done.result()


@dataclass
class Observe(Stage):
    """It stands, looks until it knows enough, and makes the pick from where it stands.

    Attributes:
        near: whether it stands at the camera point.
        views: configurations (n,) for other views that are left; None: none was needed.
        since: time from which looks count [s].
        seen: looks since.
        refused: the scene of the last pick that was refused; the next wants another.
    """

    name = OBSERVE
    near: bool = False
    views: list[FloatArray] | None = None
    since: float = math.inf
    seen: int = 0
    refused: Scene | None = None
    why: str = "the target is not seen"
    scene: Scene | None = None

    def held(self, loop: Common, now: float, why: str) -> None:
        super().held(loop, now, why)
        self.since, self.seen = now, 0

    def cycle(self, loop: Common, now: float, tracked: Tracked) -> Step:
        if not loop.driver.rests(now):
            self.since, self.seen = now, 0
            return None, None
        self.since = min(self.since, now)
        loop.felt.stands_empty(now, self.since)
        if loop.looks.newest == -math.inf:
            return None, None
        if self.job is None:
            if not self._knows(loop, now, tracked):
                p = loop.parameters
                longest = p.longest_look if self.views is None else p.look
                if self.refused is not None and self.views is None:
                    longest = p.patient
                late = now - self.since > longest
                return self._elsewhere(loop, now, tracked) if late else (None, None)
            self.scene = plant.tracked_scene(loop.scene, tracked, start=loop.driver.state(now).q)
            before = loop.picks[-1] if loop.picks and self.near else None
            work = partial(committed, self.scene, loop.robot, loop.seed, before)
            self.job = Sliced(partial(work, loop.parameters.budget))
        made = self.worked(loop, standing=True)
        return (None, None) if made is None else self._made(loop, now, tracked, made)

    def _made(
        self, loop: Common, now: float, tracked: Tracked, made: Picked | OptiPrompError
    ) -> Step:
        if isinstance(made, OptiPrompError):
            return None, self._again(loop, made.message)
        told = f"{made.status}, {excess(made):.2f} of the harm that is allowed"
        told += loop.left_out(tracked, self.since)
        begins = not self.near and made.reach.valid
        ahead = to_camera_point(made.reach) if begins else None
        if ahead is not None:
            loop.picks.append(made)
            route = Route.along(loop.robot, ahead, made.reach.scene, math.inf)
            begun = loop.driver.set_out(route, now, tracked)
            return begun, Next(Travel(Observe(near=True), "at the camera point"), told)
        kept = self.near and bool(loop.picks) and loop.picks[-1].success
        if made.success or (kept and excess(made) <= loop.parameters.budget):
            loop.picks.append(made)
            return loop.driver.set_out(Route.of(made.reach), now, tracked), Next(Push(made), told)
        return None, self._again(loop, made.message)

    def _again(self, loop: Common, why: str) -> Next:
        """Look again; a pick is made anew where something differs."""
        why = f"no pick: {why}"
        then = Observe(self.near, self.views, refused=self.scene, why=why)
        return _tried(loop, then, why, why)

    def _knows(self, loop: Common, now: float, tracked: Tracked) -> bool:
        """Whether it has looked for long enough, and something differs from what was refused."""
        p, looked = loop.parameters, now - self.since
        if plant.target_row(tracked) is None:
            return False
        if self.refused is not None and plant.moved_by(self.refused, tracked) < p.changed:
            return False
        if not self.near:
            return (self.seen >= 3 and loop.known) or (
                looked >= p.first_look and (self.seen >= 3 or loop.known)
            )
        if looked < p.look or self.seen < 3:
            return False
        return looked > p.patient or plant.rests_known(tracked, p.settled)

    def _elsewhere(self, loop: Common, now: float, tracked: Tracked) -> Step:
        """Go to another view; give up where none is left, or another shows no more."""
        drive, q, p = loop.driver, loop.driver.state(now).q, loop.parameters
        why = STANDS if loop.camera.standing is not None else self.why
        if self.refused is not None and not loop.hidden(tracked, self.since):
            return None, Next(Stand(GAVE_UP), why)
        left = driver.views(loop.robot, q, p) if self.views is None else self.views
        if self.refused is not None and self.views is None:
            left = left[: len(left) // len(p.views)]  # of the first turn: what hides is near
        if self.near and self.refused is None:  # from here it would be seen
            left = []
        for k, view in enumerate(left):
            turn = courses.path_back(loop.robot, np.array([q, view]), p.retreat_speed)
            if drive.safe(turn):
                then = Observe(self.near, left[k + 1 :], refused=self.refused, why=self.why)
                out = drive.set_out(Route.along(loop.robot, turn, drive.still), now, tracked)
                return out, Next(Travel(then, "at another view"), f"{why}: to another view")
        return None, Next(Stand(GAVE_UP), why)


def _tried(loop: Common, then: Observe, told: str, why: str) -> Next:
    """Look again, as it is ``told``; where no try is left, give up, and say ``why``."""
    if loop.over or loop.tries <= 0:
        return Next(Stand(GAVE_UP), loop.over or why)
    loop.tries -= 1
    return Next(then, told)


@dataclass
class Travel(Stage):
    """The tool goes where it looks again, and comes to rest there.

    Attributes:
        then: the stage after it.
        told: where the tool is by then.
        passed: the fruits that were first seen on the way and are clear of it.
    """

    name = TRAVEL
    then: Observe
    told: str
    passed: frozenset[str] = frozenset()

    def cycle(self, loop: Common, now: float, tracked: Tracked) -> Step:
        drive, begins = loop.driver, now + loop.parameters.lead
        route = drive.route
        if drive.stuck(now):
            return None, Next(Observe(), "nothing leads onto the path")
        if loop.blocked():
            return drive.brake(begins), Next(Observe(), BLOCKED)
        if drive.phase(begins) >= route.duration:
            return drive.brake(begins), Next(self.then, self.told)
        new = frozenset(plant.appeared(route.scene, tracked))
        if route.scene.target is not None and new - self.passed:  # it is not on the way to a view
            if not drive.clear(tracked, new):
                return drive.brake(begins), Next(Observe(), f"in the way: {', '.join(sorted(new))}")
            self.passed = new
        return drive.go_on(now, tracked), None


@dataclass
class Push(Stage):
    """The tool comes to the target by the committed pick, moved with the plant.

    Attributes:
        pick: that is followed.
        trail: (k, n) configurations on the way from the camera, by picks before.
        checked: when the rest of the pick was predicted last [s].
        fell: time and place (3,) of the target in the last look.
    """

    name = PUSH
    among = True
    pick: Picked
    trail: list[FloatArray] = field(default_factory=list)
    checked: float = -math.inf
    fell: tuple[float, FloatArray] | None = None
    going: float = 0.0  # harm of going on, over what a success may do
    at: tuple[float, float] | None = None  # where another would take over: phase, and time [s]

    def cycle(self, loop: Common, now: float, tracked: Tracked) -> Step:
        p, drive = loop.parameters, loop.driver
        begins, since = now + p.lead, loop.camera.standing
        phase = drive.phase(begins)
        if drive.stuck(now):
            return self.ends(loop, now, "nothing leads onto the path")
        if loop.blocked():
            return self.ends(loop, now, BLOCKED)
        if phase >= drive.route.duration:
            return drive.go_on(now, tracked), Next(Take(self), "at the target")
        if since is not None and now - since > p.picture_still:
            return None if drive.waits else drive.brake(begins), None
        if plant.target_row(tracked) is None:
            return self.ends(loop, now, "the target is no longer where it must be seen")
        made = self._watch(loop, now, tracked, phase)
        return made if made is not None else (drive.go_on(now, tracked), None)

    def ends(self, loop: Common, now: float, why: str) -> Step:
        """Stop, and leave without the target."""
        stop = loop.driver.brake(now + loop.parameters.lead)
        q = np.vstack([self.passed(stop.phase), stop.curve.positions[-1]])
        return stop, Next(Leave(Sliced(partial(ways_out, self.pick.reach, q)), why), why)

    def passed(self, phase: float) -> FloatArray:
        """Configurations (k, n) of the approach until a ``phase`` of the route."""
        made = self.pick.reach
        passed = made.trajectory.positions[made.trajectory.times <= phase]
        if not self.trail:
            passed = passed[min(made.first, len(passed) - 1) :]
        return np.concatenate([*self.trail, passed])

    def _watch(self, loop: Common, now: float, tracked: Tracked, phase: float) -> Step | None:
        """Predict the rest of the pick, and compare what may be done, where something changed."""
        p, made = loop.parameters, self.pick.reach
        if self.job is None:
            late = phase >= made.trajectory.duration - 2.0 * p.allowance
            if late or now - self.checked < p.checked:
                return None
            if plant.moved_by(made.scene, tracked, apart=True) < p.changed:
                return None
            self.checked, self.at = now, None
            scene, shift = _beside(loop, made, tracked)
            self.job = Sliced(partial(foreseen, self.pick, scene, shift))
        found = self.worked(loop)
        if found is None:
            return None
        if not isinstance(found, Choice):
            self.going = found
            if found > p.budget:
                self.at = phase + p.allowance, now + p.lead + p.allowance
                scene, _ = _beside(loop, made, tracked)
                passed = self.passed(phase)
                self.job = Sliced(partial(compared, self.pick, scene, self.at[0], passed))
            return None
        return self._chosen(loop, now, tracked, found)

    def _chosen(self, loop: Common, now: float, tracked: Tracked, found: Choice) -> Step | None:
        """The least harmful of going on, another pick, and leaving now; ties go on."""
        assert self.at is not None
        p, made = loop.parameters, self.pick.reach
        if isinstance(found.pick, Picked) and found.excess <= min(p.budget, self.going):
            since = max(now + p.lead - self.at[1], 0.0)
            taken = loop.driver.take(Route.of(found.pick.reach), since, now, tracked)
            if taken is not None:
                rows = made.trajectory.times <= self.at[0]
                self.trail.append(made.trajectory.positions[rows])
                self.pick = found.pick
                loop.picks.append(found.pick)
                return taken, None
        if found.leaving < self.going:
            told = f"going on would do {self.going:.2f} of the harm that is allowed"
            return self.ends(loop, now, f"{told}, leaving {found.leaving:.2f}")
        return None

    def falls(self, loop: Common, look: Look) -> bool:
        """Whether the look shows the target below its place, and faster down than a plant moves."""
        p, up = loop.parameters, loop.scene.up
        tracked = loop.tracker.at(look.time)
        row = plant.target_row(tracked)
        seen = [look.camera @ item.position for item in look.detections if item.role == "target"]
        if row is None or not seen:
            return False
        expected, before = tracked.positions[row], self.fell
        place = min(seen, key=lambda at: float(np.linalg.norm(at - expected)))
        self.fell = look.time, place
        if before is None or not 0.0 < look.time - before[0] < p.picture_still:
            return False
        drop = float((expected - place) @ up)
        aside = float(np.linalg.norm(expected - place - drop * up))
        speed = float((before[1] - place) @ up) / (look.time - before[0])
        return speed > p.fall and drop > max(p.dropped, aside)


def _beside(loop: Common, made: Plan, tracked: Tracked) -> tuple[Scene, Displacement]:
    """The scene of now as seen from the target of a plan, and how fruits moved against it."""
    places, moved, _ = plant.displaced(made.scene, tracked)
    target = made.scene.target
    row = plant.target_row(tracked)
    assert row is not None
    assert target is not None
    offset = tracked.rest[row] - target.position
    scene = plant.tracked_scene(loop.scene, tracked, offset)
    apart = moved - offset
    return replace(scene, approach=made.scene.approach), Displacement(
        places, lambda times: np.tile(apart, (len(times), 1, 1))
    )


@dataclass
class Take(Stage):
    """The tool is at the target, moves with the plant, and takes the target in.

    Attributes:
        push: the stage before.
        since: time from which the tool is there [s].
        caught: whether a look showed a target that fell inside the tool.
    """

    name = TAKE
    among = True
    push: Push
    since: float = math.inf
    fallen: bool = False
    caught: bool = False

    def cycle(self, loop: Common, now: float, tracked: Tracked) -> Step:
        drive, self.since = loop.driver, min(self.since, now)
        if now - self.since < loop.parameters.hold:
            return drive.halt(now) if self.fallen else drive.go_on(now, tracked), None
        target, route = self.push.pick.reach.scene.target, drive.route
        planned = np.zeros(3) if target is None else target.position - route.points[-1]
        outside = plant.outside(loop.robot, drive.state(now).q, tracked, planned)
        if not self.caught if self.fallen else outside:
            return self.push.ends(loop, now, FALLS if self.fallen else "the target is not inside")
        if loop.robot.tool is None:  # nothing is taken out
            return drive.brake(now + loop.parameters.lead), Next(Stand(DONE), "at the target")
        return self._out(loop, now, tracked)

    def ends(self, loop: Common, now: float, why: str) -> Step:
        if self.fallen:
            return self.cycle(loop, now, loop.tracker.at(now))
        return self.push.ends(loop, now, why)

    def sees(self, loop: Common, look: Look) -> None:
        """Note whether a look shows the fallen target inside the tool."""
        q = loop.camera.configuration(look.time)
        seen = [look.camera @ item.position for item in look.detections if item.role == "target"]
        self.caught |= any(plant.inside(loop.robot, q, place) for place in seen)

    def _out(self, loop: Common, now: float, tracked: Tracked) -> Step:
        """Leave with the target as the pick says; where that does not lead out, search."""
        drive, legs, told = loop.driver, self.push.pick.legs, "out with the target"
        route = drive.route
        drive.hold(now, tracked)
        if RETREAT in legs and not self.fallen:
            curve, came = legs[RETREAT].trajectory, (route, route.duration)
            out = Route.along(loop.robot, curve, route.scene, came=came)
            if (begun := drive.take(out, 0.0, now, tracked)) is not None:
                return begun, Next(Leave(None, holding=True), told)
        q = self.push.passed(drive.phase(now))
        work = Sliced(partial(ways_out, self.push.pick.reach, q, True))
        return None, Next(Leave(work, holding=True), told)


@dataclass
class Leave(Stage):
    """The tool leaves the plant, by the least harmful way that is free.

    Attributes:
        job: the search of ways out; None: the way out runs.
        why: the reason to leave without the target.
        holding: whether the target is in the tool.
        stood: time from which the tool stands outside with it [s].
    """

    name = LEAVE
    among = True
    job: Sliced[Any] | None
    why: str = ""
    holding: bool = False
    stood: float = math.inf

    def held(self, loop: Common, now: float, why: str) -> None:
        """The search goes on when the arm may."""

    def ends(self, loop: Common, now: float, why: str) -> Step:
        return self.cycle(loop, now, loop.tracker.at(now))

    def cycle(self, loop: Common, now: float, tracked: Tracked) -> Step:
        drive, begins = loop.driver, now + loop.parameters.lead
        route = drive.route
        if self.job is not None:
            ready = self.holding or drive.rests(now)
            ways = self.worked(loop, not self.holding) if ready else None
            for q, _ in ways or ():
                back = courses.path_back(loop.robot, q, loop.parameters.retreat_speed)
                if drive.safe(back):
                    came = route, drive.phase(now)
                    out = Route.along(loop.robot, back, route.scene, came=came)
                    return drive.set_out(out, now, tracked), None
            if ways:
                return None, Next(Stand(GAVE_UP), "no way out is free")
            return None, None
        if drive.phase(begins) >= route.duration or drive.stuck(now):
            stop = None if drive.waits else drive.brake(begins)
            if self.holding:
                return stop, self._weighed(loop, now)
            return stop, _tried(loop, Observe(), "looking again after a retreat", self.why)
        return drive.go_on(now, tracked), None

    def _weighed(self, loop: Common, now: float) -> Next | None:
        """Whether the target is free in the tool, by its weight; None: the arm has not felt it for
        long enough. Where nothing can be felt, the looks have told."""
        target, done = loop.picks[-1].reach.scene.target, Next(Stand(DONE), OUTSIDE)
        assert target is not None
        weight = loop.felt.weight(target)
        if not loop.felt.tells(weight):
            return done
        self.stood = min(self.stood, now) if loop.driver.rests(now) else math.inf
        mean = loop.felt.mean(now, self.stood)
        if mean is None:
            return done if now - self.stood > 2.0 * loop.parameters.weighed else None
        why = loop.felt.against(mean, weight)
        return Next(Stand(GAVE_UP), why) if why else Next(Stand(DONE), f"{OUTSIDE}, by its weight")


@dataclass
class Stand(Stage):
    """It stands, for good: the pick is done, or given up."""

    name: LoopStage  # type: ignore[misc]

    def cycle(self, loop: Common, now: float, tracked: Tracked) -> Step:
        return None, None
