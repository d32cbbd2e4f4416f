"""The law of a course: how the arm follows a path that moves with the plant."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from optipromp.core.arrays import FloatArray, frozen, lengths
from optipromp.core.execution.streaming import Stretch
from optipromp.core.planning.result import Plan
from optipromp.core.planning.task import spaced
from optipromp.core.planning.timing import needs
from optipromp.core.pushing.model import PushModel
from optipromp.core.robots import ik
from optipromp.core.robots.model import Robot
from optipromp.core.scenes.scene import Scene
from optipromp.core.trajectory import Motion, State, Trajectory
from optipromp.core.values import Unlimited
from optipromp_loop.control.parameters import CONTROL, LoopParameters

TRACKED = 2e-4  # [m] largest error of a followed tool point: a choice
Moves = Callable[[FloatArray], FloatArray]  # Displacements (M, F, 3) of F fruits at times (M,) [s]


@dataclass(frozen=True, eq=False)
class Displacement:
    """The displacement of the plant against a plan's scene."""

    places: FloatArray  # (F, 3) rest positions in the plan's scene [m]
    # displacements of the fruits from these places over time, by the controller's clock
    moves: Moves
    length: float = CONTROL.field  # over which the displacement of a fruit counts [m]

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
        pushes: the model of the pushes on the way; None: nothing is pushed.
        came: of a way out, the route that it leads back from, and the time in that route.
    """

    robot: Robot
    trajectory: Trajectory
    points: FloatArray
    axes: FloatArray
    weight: FloatArray
    scene: Scene
    plan: Plan | None = None
    pushes: PushModel | None = None
    came: tuple[Route, float] | None = None

    @classmethod
    def of(cls, plan: Plan) -> Route:
        """The route of a plan."""
        begin = float(plan.trajectory.times[plan.first])
        made = cls.along(plan.robot, plan.trajectory, plan.scene, begin)
        return replace(made, plan=plan, pushes=plan.push_model)

    @classmethod
    def along(
        cls, robot: Robot, trajectory: Trajectory, scene: Scene, begin: float = 0.0,
        came: tuple[Route, float] | None = None,
    ) -> Route:  # fmt: skip
        """The route of a motion that was planned in a ``scene``; from the time ``begin`` [s] on the
        whole motion of the plant counts; infinite: it does not count at all."""
        points, axes = robot.tool_pose(trajectory.positions)
        share = np.clip(trajectory.times / begin, 0.0, 1.0) if begin > 0.0 else 1.0
        weight = np.broadcast_to(share * share * (3.0 - 2.0 * share), len(points))
        return cls(robot, trajectory, points, axes, frozen(weight), scene, came=came)

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
    """A stretch that follows a route."""

    phase: float  # time in the route at ``begins`` [s]
    rate: Unlimited  # time of the curve over time of the route; infinite for an arm that waits

    def phase_at(self, time: float) -> float:
        """Time in the route at a ``time`` [s]."""
        return self.phase + max(time - self.begins, 0.0) / self.rate


def follow(
    route: Route, phase: float, state: State, begins: float, field: Displacement,
    parameters: LoopParameters = CONTROL,
) -> Course | None:  # fmt: skip
    """The course along a route from ``phase`` on, beginning in ``state`` at the time ``begins``.

    The curve is the path, moved with the plant, and the state's error beside it, which fades in the
    time of a blend: however often the path is moved anew, the error shrinks. Of several rates and
    blends, in order, the first counts with which the curve keeps the robot's limits. A blend that
    is longer than what is left of the path would swing past its end. None: with none of them, or
    the arm cannot reach the moved path.
    """
    ways = [(parameters.rates[0], parameters.blends[:3])]
    ways += [(rate, parameters.blends[1:]) for rate in parameters.rates[1:]]
    left, robot = route.duration - phase, route.robot
    for rate, blends in ways:
        path = _path(route, phase, begins, field, rate, parameters)
        if path is None:
            continue
        times, q, motion = path
        away = [np.subtract(*pair) for pair in zip(vars(state).values(), motion, strict=True)]
        for blend in blends:
            if left > 0.0 and blend > max(left * rate, parameters.blends[0]):
                continue
            knots = np.vstack([state.q, q + faded(away, blend, times)])
            at = np.append(0.0, times)
            curve = Trajectory.through(knots, at, robot.joint_names, begin=state)
            inside = (curve.positions >= robot.lower) & (curve.positions <= robot.upper)
            if inside.all() and needs(robot, curve).max() <= 1.0:
                return Course(curve, begins, phase, rate)
    return None


def faded(away: Sequence[FloatArray], blend: float, times: FloatArray) -> FloatArray:
    """The error (m, n) at ``times`` (m,) [s], of one that fades in the time ``blend`` [s].

    The quintic from ``away``, three (n,): the error, its velocity and its acceleration at 0, to a
    rest at 0.
    """
    s = np.clip(times / blend, 0.0, 1.0)[:, None]
    value = 1.0 - s**3 * (10.0 - 15.0 * s + 6.0 * s**2)
    rate = s - s**3 * (6.0 - 8.0 * s + 3.0 * s**2)
    bend = 0.5 * s**2 * (1.0 - s) ** 3
    return np.asarray(value * away[0] + blend * rate * away[1] + blend**2 * bend * away[2])


GAP = 0.025  # [s] from the begin of a curve to its next waypoint, at least: a choice
STEP = 0.02  # [s] of the differences that tell how the moved path moves: a choice


def _path(
    route: Route, phase: float, begins: float, field: Displacement, rate: float,
    parameters: LoopParameters,
) -> tuple[FloatArray, FloatArray, Motion] | None:  # fmt: skip
    """Times (m,) [s] after ``begins`` and configurations (m, n) of the rest of a route, moved with
    the plant, and how it moves at ``begins``; None: the arm cannot reach it."""
    made, robot, tail = route.trajectory, route.robot, parameters.tail
    rows = (made.times - phase) * rate
    end = max(float(rows[-1]), parameters.blends[0])
    rest = tail * np.array([1.0, 2.0, 3.0]) / 3.0  # the plant's motion fades in the tail
    times = np.append(rows[(rows > GAP) & (rows < end - GAP)], [end, *(end + rest)])
    at = np.concatenate([[-STEP, 0.0, STEP], times])
    late = np.clip(at - end, 0.0, tail)
    q, _, _ = made.sample(phase + at / rate)
    points, axes = robot.tool_pose(q)
    weight = np.interp(phase + at / rate, made.times, route.weight)
    shift = weight[:, None] * field.at(points, begins + at - 0.5 * late**2 / tail)
    q, errors = ik.each(robot, points + shift, axes, q)
    if errors.max() > TRACKED:
        return None
    before, now, after = q[:3]
    moves = (after - before) / (2.0 * STEP), (after - 2.0 * now + before) / STEP**2
    return times, q[3:], (now, *moves)


AHEAD = np.array([0.1, 0.3, 0.6, 1.0])  # [s] at which the plant's motion is compared: a choice


def ahead(route: Route, phase: float, begins: float, field: Displacement) -> FloatArray:
    """Displacements (4, 3) of the next points of a route [m]."""
    times = np.clip(phase + AHEAD, 0.0, route.duration)
    row = np.searchsorted(route.trajectory.times, times).clip(max=len(route.points) - 1)
    shift = field.at(route.points[row], begins + np.maximum(times - phase, 0.0))
    return route.weight[row, None] * shift


MOVED = 1e-4  # [m] of a predicted push, below which a fruit counts as free: a choice


def pushed_by(route: Route, phase: float) -> dict[str, FloatArray]:
    """Displacement (3,) of each fruit that the push of a route moves until ``phase`` [m], by id.

    A way out goes on with the push of the approach before it. None is moved before the approach,
    and while the tool surely touches nothing.
    """
    inward, until = route.came or (route, phase)
    model, times = inward.pushes, inward.trajectory.times
    rows = np.flatnonzero((times >= inward.approach) & (times <= until))
    if model is None or len(rows) < 2:
        return {}
    points, axes = inward.points[rows], inward.axes[rows]
    if route.came is not None:
        out = route.trajectory.times <= phase
        points, axes = np.vstack([points, route.points[out]]), np.vstack([axes, route.axes[out]])
    motion = spaced(points, axes)
    if model.clear(*motion):
        return {}
    found = model.moved(*motion)
    places = {item.id: item.position for item in route.scene.objects}
    pushed = {
        name: position - places[name]
        for name, position in zip(found.ids, found.positions, strict=True)
        if name in places
    }
    return {name: by for name, by in pushed.items() if float(np.linalg.norm(by)) > MOVED}


def path_back(robot: Robot, q: FloatArray, speed: float) -> Trajectory:
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
