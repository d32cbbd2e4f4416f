"""Ways out of the plant: proposals of the tool's motion, each with its speed, cheapest first.

The tool leaves back along its way in, straight along its axis, off that axis within a cone, or
along the axis after a step aside: from behind the tool's floor, fruits slide off it to the side. A
way that harms is proposed again, slower: the floor's blow goes with the speed
(:func:`optipromp.core.pushing.stems.cup.wedged`).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from optipromp.core import judging
from optipromp.core.arrays import FloatArray, frame_along, lengths
from optipromp.core.budget import clock
from optipromp.core.planning.cutting import steady
from optipromp.core.planning.leg_tasks import (
    carried,
    distance_of,
    held,
    leg,
    leg_task,
    retreat_model,
)
from optipromp.core.planning.options import Timed
from optipromp.core.planning.parameters import BACK
from optipromp.core.planning.result import REACH, RETREAT, Plan, Proposal
from optipromp.core.planning.task import cuts, spaced
from optipromp.core.planning.timing import eased, leaving, shortest
from optipromp.core.pushing.parameters import PUSH
from optipromp.core.pushing.stems.hanging import Leaving
from optipromp.core.robots import ik
from optipromp.core.robots.grippers import Scissor
from optipromp.core.robots.ik import level
from optipromp.core.robots.model import Robot
from optipromp.core.robots.mounted import unmounted

Legs = dict[str, Plan]
"""Judged legs by name, in the order of the motion."""


@dataclass(frozen=True, eq=False)
class Way:
    """A way out.

    Attributes:
        points: (T, 3) of the tool, from where it stands [m].
        axes: (T, 3) of the tool.
        speed: largest of the tool among fruits [m/s].
        q: (T, n) waypoints; None: inverse kinematics gives them.
    """

    points: FloatArray
    axes: FloatArray
    speed: float
    q: FloatArray | None = None

    def harm(self, model: Leaving, states: int, limit: float = np.inf) -> float:
        """The predicted harm in some ``states``; any number above ``limit`` where it is above."""
        return model.at(self.speed).harm(*spaced(self.points, self.axes), states, limit)

    def followed(self, robot: Robot, begin: FloatArray) -> FloatArray | None:
        """Waypoints (T, n) of an arm that stands at ``begin`` (n,); None: out of reach."""
        if self.q is not None:
            return self.q
        made, errors = ik.track(robot, self.points, self.axes, begin)
        if errors.max() >= judging.GOAL_TOLERANCE:
            return None
        return np.vstack([begin, made[1:]])


def ways(
    robot: Robot, q: FloatArray, distance: float, speed: float = PUSH.hanging.speed
) -> Iterator[Way]:
    """Ways out by ``distance`` [m], from the end of a motion ``q`` (k, n), the way back first."""
    tips, axes = robot.tool_pose(q)
    axis, turn = axes[-1], frame_along(axes[-1])
    back = back_along(q, tips, distance)
    yield Way(*robot.tool_pose(back), speed, back)

    def through(*corners: FloatArray) -> Way:
        """The way of the tool point through corners (3,) from its place."""
        points = np.zeros((1, 3))
        for corner in corners:
            parts = max(2, math.ceil(math.dist(corner, points[-1]) / BACK.step))
            share = np.linspace(0.0, 1.0, parts + 1)[1:, None]
            points = np.vstack([points, points[-1] + (corner - points[-1]) * share])
        return Way(tips[-1] + points, np.tile(axis, (len(points), 1)), speed)

    yield through(-distance * axis)
    around = 2.0 * np.pi * np.arange(BACK.around) / BACK.around
    sides = [turn @ np.array([math.cos(one), math.sin(one), 0.0]) for one in around]
    wide = 0.0 if robot.tool is None else robot.tool.mouth[1]
    stump = isinstance(unmounted(robot.tool), Scissor)  # between the open blades: none goes aside
    for size in () if stump else BACK.aside:
        for side in sides:
            yield through(size * wide * side, size * wide * side - distance * axis)
    for lean in np.deg2rad([0.5 * BACK.cone, BACK.cone]):
        for side in sides:
            yield through(-distance * (math.sin(lean) * side + math.cos(lean) * axis))


def back_along(q: FloatArray, tips: FloatArray, distance: float) -> FloatArray:
    """The end of a motion ``q`` (k, n) backwards, by ``distance`` [m] of its ``tips`` (k, 3)."""
    gone = np.append(0.0, np.cumsum(lengths(np.diff(tips[::-1], axis=0))))
    last = min(int(np.searchsorted(gone, distance)) + 1, len(q))
    return q[::-1][: max(last, 3)]


def retreats(reach: Plan, options: Timed) -> Iterator[Proposal[Legs]]:
    """Proposals of a reach with each retreat after it, judged.

    The rank is the validity of the retreat, whether it presses more than the reach or ends where
    the carry cannot begin, and the harm of both. Longer retreats are proposed where six shorter
    ones end badly.
    """
    began, place, target = clock(), reach.scene.place, reach.scene.target
    robot, model = held(reach)[1], retreat_model(reach)
    assert target is not None
    distance = distance_of(reach)
    usual = min(options.approach_speed or math.inf, PUSH.hanging.speed)
    best, judged = math.inf, 0
    far = [BACK.farther, 0.5 * (1.0 + BACK.farther)]

    def proposed(factor: float) -> Iterator[Proposal[Legs]]:
        nonlocal judged
        judged = 0
        back, *others = ways(reach.robot, reach.trajectory.positions, factor * distance, usual)
        yield Proposal((False, False, BACK.alike), partial(screened, back))
        yield Proposal((False, False, BACK.alike), partial(glimpsed, others))
        if far:
            yield Proposal((False, True, 0.0), lambda: proposed(far.pop()))

    def glimpsed(others: list[Way]) -> Iterator[Proposal[Legs]]:
        for way in others:
            harm = 0.0 if model is None else way.harm(model, 1)
            yield Proposal((False, False, max(harm, BACK.alike)), partial(screened, way))

    def screened(way: Way) -> Iterator[Proposal[Legs]]:
        nonlocal best
        if judged == BACK.judged:
            return
        harm = 0.0 if model is None else way.harm(model, BACK.screened, 2.0 * best)
        best = min(best, max(harm, BACK.alike))
        yield Proposal((False, False, max(harm, BACK.alike)), partial(followed, way))
        slower = BACK.slower * way.speed
        if harm > BACK.alike and slower > BACK.slowest:
            bound = False, False, max(BACK.slower * harm, BACK.alike)
            yield Proposal(bound, partial(screened, replace(way, speed=slower)))

    def followed(way: Way) -> Iterator[Proposal[Legs]]:
        nonlocal judged
        q = way.followed(robot, reach.trajectory.positions[-1])
        if q is None or judged == BACK.judged:
            return
        fruits = (*reach.scene.pushables, target)
        if cuts(reach.scene, robot.tool):
            q = level(robot, q, reach.scene.frame[0], path=True)
            made = steady(reach.scene, robot, shortest(eased(robot, options), q, 0, way.speed))
        else:
            made = leaving(robot, options, q, fruits, way.speed)
        one = leg(leg_task(reach, RETREAT, made), made, clock() - began)
        worse = pressed(one) < min(pressed(reach), 0.0)
        if place is not None:  # the carry cannot begin where something is touched
            worse |= bool(judging.touching(*carried(one, place), q[-1]))
        judged += one.valid
        yield Proposal(
            (not one.valid, worse, max(one.harm, BACK.alike)), {REACH: reach, RETREAT: one}
        )

    return proposed(1.0)


def pressed(one: Plan) -> float:
    """Distance of the last link and the tool to objects to avoid [m]."""
    least = one.judgement.metrics.clearance_avoid_tool
    return math.inf if least is None else least
