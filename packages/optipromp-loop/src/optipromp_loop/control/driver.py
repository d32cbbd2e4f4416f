"""The arm's side of the controller: the course that runs, and the next one."""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import replace

import numpy as np

from optipromp.core import judging
from optipromp.core.arrays import FloatArray, frame_along, rotation
from optipromp.core.execution.streaming import Stretch
from optipromp.core.planning.timing import stopped
from optipromp.core.robots import ik
from optipromp.core.robots.model import Robot
from optipromp.core.scenes.scene import Scene
from optipromp.core.trajectory import State, Trajectory
from optipromp_loop.control.courses import Course, Displacement, Route, ahead, follow
from optipromp_loop.control.parameters import LoopParameters
from optipromp_loop.control.plant import displaced, without_fruits
from optipromp_loop.control.tracker import Tracked


class Driver:
    """Keeps the course of the arm, and moves routes with the plant.

    Attributes:
        course: that runs; None: the arm has not moved.
        route: that the course follows, or that the arm waits for; unset before the first.
        still: the scene of what stands still; its goal is the begin.
        held: whether the target moves with the tool.
    """

    def __init__(
        self, scene: Scene, robot: Robot, state: State, parameters: LoopParameters
    ) -> None:
        self.still = without_fruits(scene, state.q)
        self.robot, self._rest, self._parameters = robot, State(state.q), parameters
        self.course: Course | None = None
        self.route: Route
        self.held = False
        self._offset: FloatArray | None = None  # (1, 3) of the plant when the target was taken [m]
        self._shift = np.zeros((0, 3))
        self._followed = 0.0

    def stands(self, scene: Scene) -> None:
        """Take over what stands still in a scene."""
        self.still = replace(self.still, objects=without_fruits(scene).objects)

    def stands_at(self, q: FloatArray, begins: float | None = None) -> None:
        """Note where an arm that has not moved yet stands, ``q`` (n,).

        ``begins``: also of an arm that has, which from this time on waits there in its route [s].
        """
        if self.course is None:
            self._rest = State(q)
        elif begins is not None:
            phase = self.phase(begins)
            self.course = Course(self._standing(q), begins, phase, math.inf)

    def state(self, time: float) -> State:
        """Commanded state at a ``time`` [s]."""
        return self._rest if self.course is None else self.course.at(time)

    def rests(self, time: float) -> bool:
        """Whether the course has come to its end."""
        return self.course is None or self.course.ended(time)

    def phase(self, time: float) -> float:
        """Time in the route at a ``time`` [s]."""
        return 0.0 if self.course is None else self.course.phase_at(time)

    @property
    def waits(self) -> bool:
        """Whether the arm comes to rest, or stands, beside its route."""
        return self.course is not None and math.isinf(self.course.rate)

    def stuck(self, now: float) -> bool:
        """Whether the arm waits, and for long nothing has led onto its route."""
        return self.waits and now - self._followed > self._parameters.stuck

    def stand(self, begins: float) -> Stretch:
        """The curve of an arm that stands."""
        return Stretch(self._standing(self.state(begins).q), begins)

    def _standing(self, q: FloatArray) -> Trajectory:
        return Trajectory.still(q, (0.0, self._parameters.tail), self.robot.joint_names)

    def halt(self, now: float) -> Stretch | None:
        """Come to rest at once, and wait there for as long as this is asked; None: it does."""
        self._followed = now
        return None if self.waits or self.rests(now) else self.brake(now + self._parameters.lead)

    def brake(self, begins: float, state: State | None = None) -> Course:
        """The curve that comes to rest at once; the arm then waits where it is in its route.

        ``state``: to begin in; None: that of the course.
        """
        curve = stopped(self.robot, state or self.state(begins))
        self.course = Course(curve, begins, self.phase(begins), math.inf)
        self._followed = begins
        return self.course

    def set_out(self, route: Route, now: float, tracked: Tracked) -> Stretch:
        """Begin a route; where nothing leads onto it yet, come to rest and wait."""
        self.route = route
        taken = self.take(route, 0.0, now, tracked)
        if taken is None:
            self.course = taken = replace(self.brake(now + self._parameters.lead), phase=0.0)
            self._followed = now
        return taken

    def take(self, route: Route, phase: float, now: float, tracked: Tracked) -> Stretch | None:
        """Follow a route from ``phase`` [s] on; None: nothing leads onto it, the course goes on."""
        begins, field = now + self._parameters.lead, self._field(route, tracked)
        course = follow(route, phase, self.state(begins), begins, field, self._parameters)
        if course is None or not self.safe(course.curve):
            return None
        self._shift = ahead(route, phase, begins, field)
        self.course, self.route, self._followed = course, route, now
        return course

    def hold(self, now: float, tracked: Tracked) -> None:
        """From now on the target moves with the tool, and the common sway of the plant counts.

        What is seen of fruits that the tool presses is its own motion: a way out that follows them
        follows itself.
        """
        route, self.held = self.route, True
        places, moved, _ = displaced(route.scene, tracked)
        rest = Displacement(places, lambda times: moved[None], self._parameters.field)
        self._offset = rest.at(route.points[-1:], np.zeros(1))

    def _field(self, route: Route, tracked: Tracked) -> Displacement:
        if (offset := self._offset) is not None:
            return Displacement(offset, lambda times: (offset + tracked.sway(times))[:, None])
        places, moved, rows = displaced(route.scene, tracked)
        length = self._parameters.field
        return Displacement(places, lambda times: moved + tracked.moves(times)[:, rows], length)

    def go_on(self, now: float, tracked: Tracked) -> Stretch | None:
        """Follow the route where the plant is now; None: the course goes on as it is."""
        route, begins = self.route, now + self._parameters.lead
        phase = self.phase(begins)
        if not self.waits and phase < route.duration:
            shift = ahead(route, phase, begins, self._field(route, tracked))
            if np.abs(shift - self._shift).max() < self._parameters.still:
                return None
        return self.take(route, phase, now, tracked)

    def clear(self, tracked: Tracked, names: Collection[str]) -> bool:
        """Whether the course touches none of the tracked fruits of some ``names``."""
        seen = [item for item in tracked.objects() if item.id in names]
        solid = tuple(replace(item, role="static", stem=None, covariance=None) for item in seen)
        scene, course = replace(self.still, objects=(*self.still.objects, *solid)), self.course
        assert course is not None
        found = judging.judge(scene, self.robot, course.curve, course.curve.at(0.0), begun=True)
        return not any(contact.other in names for contact in found.contacts)

    def safe(self, curve: Trajectory) -> bool:
        """Whether a curve keeps the limits and touches nothing that stands, by the judge."""
        found = judging.judge(self.still, self.robot, curve, curve.at(0.0), begun=True)
        return all(v.kind in ("goal", "start", "motion") for v in found.violations)


TURNS = 8  # parts of a turn, each at most 7 degrees: inverse kinematics stays on its branch
MISS = 1e-6  # [m] error above which a configuration is none: a choice


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
            part = np.linspace(0.0, math.radians(angle), TURNS + 1)[1:]
            axes = np.array([rotation(side, one) @ axis for one in part])
            path, errors = ik.track(robot, np.tile(point, (TURNS, 1)), axes, q)
            if errors.max() <= MISS:
                found.append(path[-1])
    return found
