"""The arm's side of the controller: the course that runs, and the next one."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from optipromp.control.parameters import LoopParameters
from optipromp.control.plant import field_of
from optipromp.control.servo import Course, Displacement, Route, follow
from optipromp.control.tracked import Tracked
from optipromp.core import judging
from optipromp.core.arrays import FloatArray, lengths
from optipromp.core.execution.streaming import Stretch
from optipromp.core.planning.task import posed
from optipromp.core.planning.timing import needs, stopped
from optipromp.core.robots.model import Robot
from optipromp.core.scenes.scene import JointGoal, Scene
from optipromp.core.trajectory import State, Trajectory

AHEAD = np.array([0.1, 0.3, 0.6, 1.0])  # [s] at which the plant's motion is compared: a choice


class Driver:
    """Keeps the course of the arm, and moves routes with the plant.

    ``scene``: with the objects that stand still. ``robot``: with its tool. ``state``: of the arm at
    the begin. ``parameters``: see :class:`LoopParameters`.

    Attributes:
        course: that runs; None: the arm has not moved.
        route: that the course follows, or that the arm waits for; None: there is none.
        still: the scene of what stands still; its goal is the begin.
        blind: whether routes are followed as they are, whatever the plant does.
    """

    def __init__(
        self, scene: Scene, robot: Robot, state: State, parameters: LoopParameters
    ) -> None:
        self.still = without_fruits(scene, state.q)
        self.robot, self._rest, self._parameters = robot, State(state.q), parameters
        self.course: Course | None = None
        self.route: Route | None = None
        self.blind = False
        self._shift = np.zeros((0, 3))
        self._followed = 0.0

    def stands_at(self, q: FloatArray) -> None:
        """Note where an arm that has not moved yet stands, ``q`` (n,)."""
        if self.course is None:
            self._rest = State(q)

    def state(self, time: float) -> State:
        """Commanded state at a ``time`` [s]."""
        return self._rest if self.course is None else self.course.at(time)

    def rests(self, time: float) -> bool:
        """Whether the course has come to its end."""
        return self.course is None or self.course.ended(time)

    def phase(self, time: float) -> float:
        """Time in the route at a ``time`` [s]."""
        return 0.0 if self.course is None else self.course.phase_at(time)

    def stuck(self, now: float) -> bool:
        """Whether the arm waits, and for long nothing has led onto its route."""
        waits = self.course is not None and math.isinf(self.course.rate)
        return waits and now - self._followed > self._parameters.stuck

    def stand(self, begins: float) -> Stretch:
        """The curve of an arm that stands."""
        q = self.state(begins).q
        still = np.zeros((2, len(q)))
        curve = Trajectory(
            np.array([0.0, self._parameters.tail]), q + still, still, still, self.robot.joint_names
        )
        return Stretch(curve, begins)

    def brake(self, begins: float) -> Stretch:
        """The curve that comes to rest at once; the arm then waits at the begin of its route."""
        curve = stopped(self.robot, self.state(begins))
        self.course = Course(curve, begins, 0.0, math.inf)
        return self.course

    def set_out(self, route: Route, now: float, tracked: Tracked) -> Stretch:
        """Begin a route; where nothing leads onto it yet, come to rest and wait."""
        self._followed = now
        self.route = route
        taken = self.take(route, 0.0, now, tracked)
        return taken or self.brake(now + self._parameters.lead)

    def take(self, route: Route, phase: float, now: float, tracked: Tracked) -> Stretch | None:
        """Follow a route from ``phase`` [s] on; None: nothing leads onto it, the course goes on."""
        begins = now + self._parameters.lead
        field = field_of(route.scene, tracked, self._parameters.field)
        return self._taken(route, phase, now, field, _ahead(route, phase, begins, field))

    def go_on(self, now: float, tracked: Tracked) -> Stretch | None:
        """Follow the route where the plant is now; None: the course goes on as it is."""
        route, begins = self.route, now + self._parameters.lead
        assert route is not None
        waits = self.course is None or math.isinf(self.course.rate)
        if self.blind and not waits:
            return None
        phase = self.phase(begins)
        field = field_of(route.scene, tracked, self._parameters.field)
        shift = _ahead(route, phase, begins, field)
        follows = not waits and phase < route.duration
        if follows and np.abs(shift - self._shift).max() < self._parameters.still:
            return None
        return self._taken(route, phase, now, field, shift)

    def _taken(
        self, route: Route, phase: float, now: float, field: Displacement, shift: FloatArray
    ) -> Stretch | None:
        """The course along a route in a ``field``; ``shift`` (4, 3): its displacements ahead."""
        begins = now + self._parameters.lead
        if self.blind:
            course: Course | None = Course(route.trajectory, begins, phase, 1.0)
        else:
            course = follow(route, phase, self.state(begins), begins, field, self._parameters)
        if course is None or not (self.blind or self.safe(course.curve)):
            return None
        self._shift = shift
        self.course, self.route, self._followed = course, route, now
        return course

    def safe(self, curve: Trajectory) -> bool:
        """Whether a curve keeps the limits and touches nothing that stands, by the judge."""
        found = judging.judge(self.still, self.robot, curve, curve.at(0.0), begun=True)
        return all(v.kind in ("goal", "start", "motion") for v in found.violations)


def without_fruits(scene: Scene, q: FloatArray | None = None) -> Scene:
    """The scene with robot and what stands still, and no fruits.

    Args:
        scene: with fruits, or without.
        q: (n,) its goal; None: its start.
    """
    still = tuple(item for item in scene.objects if item.role in ("static", "avoid"))
    rest = JointGoal(posed(scene)[1].q if q is None else q)
    return replace(scene, objects=still, goal=rest, waypoints=None, place=None)


def _ahead(route: Route, phase: float, begins: float, field: Displacement) -> FloatArray:
    """Displacements (4, 3) of the next points of a route [m]."""
    times = np.clip(phase + AHEAD, 0.0, route.duration)
    row = np.searchsorted(route.trajectory.times, times).clip(max=len(route.points) - 1)
    return field.at(route.points[row], begins + np.maximum(times - phase, 0.0))


def way_back(robot: Robot, q: FloatArray, speed: float) -> Trajectory:
    """The trajectory through configurations ``q`` (k, n) at a ``speed`` of the tool [m/s]."""
    points, _ = robot.tool_pose(q)
    gone = np.append(0.0, np.cumsum(lengths(np.diff(points, axis=0)))) + 1e-6 * np.arange(len(q))
    count = max(math.ceil(gone[-1] / 0.01), 4)  # [m] between waypoints
    at = np.linspace(0.0, gone[-1], count + 1)
    even = np.stack([np.interp(at, gone, joint) for joint in q.T], axis=1)
    widths = np.full(count, max(gone[-1], 0.01) / count / speed)
    widths[[0, -1]] *= 2.0  # it begins and ends at rest
    back = Trajectory.through(even, np.append(0.0, np.cumsum(widths)), robot.joint_names)
    return back.slowed(max(float(needs(robot, back).max()), 1.0))
