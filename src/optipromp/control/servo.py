r"""The path of a plan, moved with the plant, as a curve from the arm's present state.

A plan is made for fruits at rest at places :math:`x_i`. At time t the fruits are at
:math:`x_i + d_i(t)`. A tool point :math:`p` of the plan at time t moves by

.. math:: w \frac{\sum_i k_i d_i(t)}{\sum_i k_i}, \qquad k_i = e^{-|p - x_i|^2 / l^2}

with a weight w that grows from 0 to 1 until the approach begins. Inverse kinematics near the plan's
configurations gives waypoints. One quintic spline leads from the state of the arm through them, so
position, velocity and acceleration are continuous where the curve takes over.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from optipromp.control.parameters import CONTROL, LoopParameters
from optipromp.core.arrays import FloatArray, frozen
from optipromp.core.execution.streaming import Stretch
from optipromp.core.planning.result import Plan
from optipromp.core.planning.timing import needs
from optipromp.core.robots import ik
from optipromp.core.robots.model import Robot
from optipromp.core.scenes.scene import Scene
from optipromp.core.trajectory import State, Trajectory

TRACKED = 2e-4  # [m] largest error of a followed tool point: a choice
Moves = Callable[[FloatArray], FloatArray]
"""Displacements (M, F, 3) of F fruits at times (M,) [s]."""


@dataclass(frozen=True, eq=False)
class Displacement:
    """The displacement of the plant against a plan's scene.

    Attributes:
        places: (F, 3) rest positions in the plan's scene [m].
        moves: displacements of the fruits from these places over time, by the controller's clock.
        length: over which the displacement of a fruit counts [m].
    """

    places: FloatArray
    moves: Moves
    length: float = CONTROL.field

    def at(self, points: FloatArray, times: FloatArray) -> FloatArray:
        """Displacement (M, 3) of tool points (M, 3) at times (M,) [s]."""
        if not len(self.places):
            return np.zeros_like(points)
        away = np.square(points[:, None] - self.places[None]).sum(axis=2) / self.length**2
        share = np.exp(away.min(axis=1, keepdims=True) - away)
        share /= share.sum(axis=1, keepdims=True)
        return np.asarray(np.einsum("mf,mfi->mi", share, self.moves(times)))


@dataclass(frozen=True, eq=False)
class Route:
    """A plan's trajectory with its tool poses.

    Attributes:
        plan: the plan, or None for a way back.
        trajectory: T waypoints.
        points, axes: (T, 3) of the tool.
        weight: (T,) share of the plant's displacement.
        scene: of the plan.
    """

    robot: Robot
    trajectory: Trajectory
    points: FloatArray
    axes: FloatArray
    weight: FloatArray
    scene: Scene
    plan: Plan | None = None

    @classmethod
    def of(cls, plan: Plan) -> Route:
        """The route of a plan."""
        return cls._made(plan.robot, plan.trajectory, plan.first, plan.scene, plan)

    @classmethod
    def back(cls, robot: Robot, trajectory: Trajectory, scene: Scene) -> Route:
        """The route of a way back, that was planned in a ``scene``."""
        return cls._made(robot, trajectory, 0, scene, None)

    @classmethod
    def _made(
        cls, robot: Robot, trajectory: Trajectory, first: int, scene: Scene, plan: Plan | None
    ) -> Route:
        """The route of a trajectory whose approach begins at waypoint ``first``."""
        points, axes = robot.tool_pose(trajectory.positions)
        begin = float(trajectory.times[first])
        share = np.clip(trajectory.times / begin, 0.0, 1.0) if begin > 0.0 else 1.0
        weight = np.broadcast_to(share * share * (3.0 - 2.0 * share), len(points))
        return cls(robot, trajectory, points, axes, frozen(weight), scene, plan)

    @property
    def approach(self) -> float:
        """Time in the route at which the approach begins [s]."""
        first = 0 if self.plan is None else self.plan.first
        return float(self.trajectory.times[first])

    @property
    def duration(self) -> float:
        """Duration of the trajectory [s]."""
        return self.trajectory.duration


@dataclass(frozen=True, eq=False)
class Course(Stretch):
    """A stretch that follows a route.

    Attributes:
        phase: time in the route at ``begins`` [s].
        rate: time of the curve over time of the route; infinite for an arm that waits.
    """

    phase: float
    rate: float

    def phase_at(self, time: float) -> float:
        """Time in the route at a ``time`` [s]."""
        return self.phase + max(time - self.begins, 0.0) / self.rate


def follow(
    route: Route, phase: float, state: State, begins: float, field: Displacement,
    parameters: LoopParameters = CONTROL,
) -> Course | None:  # fmt: skip
    """The course along a route from ``phase`` on, beginning in ``state`` at the time ``begins``.

    Of several times of the blend and rates, in order, the first counts with which the curve keeps
    the robot's limits. None: with none of them, or the arm cannot reach the moved path.
    """
    ways = [(blend, parameters.rates[0]) for blend in parameters.blends[:3]]
    ways += [(blend, rate) for rate in parameters.rates[1:] for blend in parameters.blends[1:]]
    for blend, rate in ways:
        curve = _curve(route, phase, state, begins, field, blend, rate, parameters.tail)
        if curve is not None:
            return Course(curve, begins, phase, rate)
    return None


def _curve(
    route: Route, phase: float, state: State, begins: float, field: Displacement, blend: float,
    rate: float, tail: float,
) -> Trajectory | None:  # fmt: skip
    made, robot = route.trajectory, route.robot
    rows = np.flatnonzero((made.times - phase) * rate > blend)
    times = (made.times[rows] - phase) * rate
    end = max((made.duration - phase) * rate, blend)
    near, points, axes = made.positions[rows], route.points[rows], route.axes[rows]
    weight = route.weight[rows]
    rest = tail * np.array([1.0, 2.0, 3.0]) / 3.0  # the plant's motion fades in the tail
    late = end + (rest if len(rows) else np.append(0.0, rest))
    count = len(late)
    last = np.full(count, made.n_waypoints - 1)
    asked = np.append(times, end + np.minimum(late - end, tail) * (1.0 - 0.5 * (late - end) / tail))
    times = np.append(times, late)
    near = np.concatenate([near, made.positions[last]])
    points = np.concatenate([points, route.points[last]])
    axes = np.concatenate([axes, route.axes[last]])
    weight = np.append(weight, route.weight[last])
    shift = weight[:, None] * field.at(points, begins + asked)
    q, errors = ik.each(robot, points + shift, axes, near)
    if errors.max() > TRACKED:
        return None
    curve = Trajectory.through(
        np.vstack([state.q, q]), np.append(0.0, times), robot.joint_names, begin=state
    )
    inside = (curve.positions >= robot.lower) & (curve.positions <= robot.upper)
    return curve if inside.all() and needs(robot, curve).max() <= 1.0 else None
