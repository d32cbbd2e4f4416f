"""``plan_pick``: a pick in several legs: the reach, the retreat, and the way to the place.

On the *retreat* and on the *carry* the picked fruit is attached to the tool and its stem is cut.
A target that stands on a board has a *lift* before the retreat; see
:mod:`optipromp.core.planning.lifting`.
The retreat is the way back that does least harm: along the reach, along the tool axis, or off that
axis within a cone. The carry is a motion in free space, in which the fruits that still hang are
static.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from optipromp.core import judging
from optipromp.core.arrays import FloatArray, frame_along, lengths
from optipromp.core.budget import clock
from optipromp.core.errors import Code, InvalidRequestError
from optipromp.core.parameters import Checked, parameter
from optipromp.core.planning import lifting
from optipromp.core.planning.plan import plan
from optipromp.core.planning.result import Plan, Terms
from optipromp.core.planning.task import Task, laden, resolve
from optipromp.core.planning.timing import shortest
from optipromp.core.planning.verdict import verdict, whole
from optipromp.core.planning.way_back import way_back
from optipromp.core.pushing.parameters import PUSH
from optipromp.core.robots import ik
from optipromp.core.robots.model import Robot
from optipromp.core.robots.self_collision import letting_touch
from optipromp.core.scenes.held import Attached, Place
from optipromp.core.scenes.io import load_scene
from optipromp.core.scenes.rotations import to_quaternion
from optipromp.core.scenes.scene import PoseGoal, Scene, SceneObject
from optipromp.core.scenes.trusses import rooted
from optipromp.core.trajectory import State, Trajectory

REACH, LIFT, RETREAT, CARRY = "reach", "lift", "retreat", "carry"
AFTER = LIFT, RETREAT, CARRY


@dataclass(frozen=True)
class RetreatParameters(Checked):
    """Numbers of the retreat."""

    step: float = parameter(0.005, "m", "choice", "between the waypoints of a straight retreat")
    cone: float = parameter(25.0, "deg", "choice", "off the tool axis: as that of an approach")
    around: int = parameter(6, "1", "choice", "directions about the tool axis that are tried")
    farther: float = parameter(
        2.0, "1", "choice", "retreats so much longer are tried where the shorter ends among fruits"
    )
    alike: float = parameter(
        0.05, "1", "measured", "harms below it are equal: 1 % of such plans fail (docs/studies.md)"
    )


BACK = RetreatParameters()


@dataclass(frozen=True, eq=False)
class Picked:
    """A pick as a plan of several legs, each judged.

    Attributes:
        legs: by name, in the order of the motion: ``reach``, for what stands ``lift``,
            ``retreat``, ``carry``. A failed leg is the last one.
    """

    legs: dict[str, Plan]

    @property
    def reach(self) -> Plan:
        """The first leg."""
        return self.legs[REACH]

    @property
    def status(self) -> Code:
        """The status of the whole; see :func:`optipromp.core.planning.verdict.whole`."""
        return whole(self.legs)[0]

    @property
    def message(self) -> str:
        """The reasons for the status."""
        return whole(self.legs)[1]

    @property
    def success(self) -> bool:
        """Whether every leg is a success."""
        return self.status == Code.SUCCESS

    @property
    def duration(self) -> float:
        """Of all legs [s]."""
        return sum(leg.trajectory.duration for leg in self.legs.values())

    @property
    def end(self) -> FloatArray:
        """(n,) configuration at the end of the last leg."""
        *_, last = self.legs.values()
        return np.asarray(last.trajectory.positions[-1])

    def to_dict(self) -> dict[str, Any]:
        """Everything but the trajectories, as plain values for JSON: the reach, and the legs."""
        return self.reach.to_dict() | {
            "status": self.status,
            "message": self.message,
            "legs": {name: leg.to_dict() for name, leg in self.legs.items()},
        }


def plan_pick(
    scene: Scene | str | Path, *, progress: Callable[[str], None] | None = None, **request: Any
) -> Picked:
    """Plan a pick and what comes after: the reach, the retreat, and the way to ``scene.place``.

    Args:
        scene: a scene, the name of a built-in scene, or the path of a scene file; with a target and
            a ``place``.
        progress: called with a short text as each step begins.
        request: further arguments of :func:`optipromp.core.planning.plan.plan`.

    Returns:
        The legs. A leg that fails is returned too, with its code; no leg comes after it.

    Raises:
        InvalidRequestError: the scene has no target, no place, objects that move, or a robot
            without a tool.
        OptiPrompError: an error of :func:`optipromp.core.planning.plan.plan`.
    """
    scene = scene if isinstance(scene, Scene) else load_scene(scene)
    if scene.place is None or scene.target is None:
        what = "place" if scene.target is not None else "target"
        raise InvalidRequestError(f"{scene.name} has no {what}: a pick needs a target and a place")
    if names := ", ".join(item.id for item, _ in scene.movers):
        told = "the legs of a pick know no motion; leave out the motions, or plan the reach alone"
        raise InvalidRequestError(f"{scene.name} has a place, and {names} move: {told}")
    reach = plan(scene, progress=progress, **request)
    return after(reach, progress, **request)


def after(reach: Plan, progress: Callable[[str], None] | None = None, **request: Any) -> Picked:
    """A pick from its reach, with the legs that come after; see :func:`plan_pick`."""
    legs = {REACH: reach}
    if reach.robot.tool is None:
        raise InvalidRequestError(f"{reach.robot.name} has no tool, which would hold the target")
    if reach.success:
        (progress or str)("retreat")
        legs |= lifted(reach) if lifting.stands(reach.scene) else {RETREAT: retreat(reach)}
    if RETREAT in legs and legs[RETREAT].success:
        scene, robot = carry_scene(legs)
        legs[CARRY] = plan(scene, progress=progress, **request | {"robot": robot})
    return Picked(legs)


def retreat(reach: Plan) -> Plan:
    """The retreat of least harm from the end of a reach; the best invalid one where none is valid.

    Longer retreats are tried where all shorter ones harm, or end where the robot or the fruit
    touches something that the carry must not touch.
    """
    began, found = clock(), list[tuple[tuple[bool, bool, float], Plan]]()
    place = reach.scene.place
    assert place is not None
    for factor in (1.0, 0.5 * (1.0 + BACK.farther), BACK.farther):
        for q in _ways(reach, factor * place.retreat):
            task = retreat_task(reach, q[-1])
            made = shortest(task.robot, q, 0, PUSH.hanging.speed)
            one = leg(task, made, clock() - began)
            scene, robot = carried(one, place)
            blocked = bool(judging.touching(scene, robot, q[-1]))
            valid = one.success or one.status is Code.HARM_PREDICTED
            harm = 0.0 if one.prediction is None else one.prediction.harm
            found.append(((not valid, blocked, max(harm, BACK.alike)), one))
            if found[-1][0] == (False, False, BACK.alike):
                break
        rank, best = min(found, key=lambda item: item[0])
        if best.success and rank[:2] == (False, False):
            break
    return replace(best, time={"total": clock() - began})


def lifted(reach: Plan) -> dict[str, Plan]:
    """Lift and retreat of a target that stands: the first height of which both are valid.

    Where no height has both, those of the last one, without a retreat after an invalid lift.
    """
    began = clock()
    assert reach.scene.place is not None
    _, robot = held(reach)
    found: dict[str, Plan] = {}
    for up, back in lifting.ways(reach, robot, reach.scene.place.retreat):
        found = {}
        for name, q in ((LIFT, up), (RETREAT, back)):
            task = lift_task(reach, name, q[0], q[-1])
            made = shortest(task.robot, q, 0, lifting.LIFT.speed)
            found[name] = leg(task, made, clock() - began)
            if not found[name].success:
                break
        if len(found) == 2 and found[RETREAT].success:
            return found
    if not found:
        raise InvalidRequestError(
            f"{reach.scene.name}: the arm cannot lift the target straight up from its grasp"
        )
    return found


def _ways(reach: Plan, distance: float) -> Iterator[FloatArray]:
    """Waypoints (T, n) of retreats by ``distance`` [m], from the end of the reach.

    First back along the reach, then straight along the tool axis, then off the tool axis. Among
    simulated retreats, the way along the reach was never worse than the straight one.
    """
    robot, q = reach.robot, reach.trajectory.positions
    tips, axes = robot.tool_pose(q)
    steps = np.linspace(0.0, distance, max(3, math.ceil(distance / BACK.step) + 1))

    def straight(direction: FloatArray) -> Iterator[FloatArray]:
        points = tips[-1] - steps[:, None] * direction
        made, errors = ik.track(robot, points, np.tile(axes[-1], (len(points), 1)), q[-1])
        if errors.max() < judging.GOAL_TOLERANCE:
            yield np.vstack([q[-1:], made[1:]])

    gone = np.append(0.0, np.cumsum(lengths(np.diff(tips[::-1], axis=0))))
    last = min(int(np.searchsorted(gone, distance)) + 1, len(q))
    yield q[::-1][: max(last, 3)]
    yield from straight(axes[-1])
    turn = frame_along(axes[-1])
    for lean in np.deg2rad([0.5 * BACK.cone, BACK.cone]):
        for angle in 2.0 * np.pi * np.arange(BACK.around) / BACK.around:
            flat = math.sin(lean) * np.array([math.cos(angle), math.sin(angle)])
            yield from straight(turn @ np.append(flat, math.cos(lean)))


def leg(task: Task, trajectory: Trajectory, seconds: float) -> Plan:
    """The judged plan of a motion that no planner made."""
    found = verdict(task, trajectory)
    return Plan(
        task=task, planner="retreat", strategy=None, seed=task.seed, status=found.status,
        message=found.message, trajectory=trajectory, initial=trajectory, followed=trajectory,
        prediction=found.prediction, metrics=found.judgement.metrics, terms=Terms(dict), stages=(),
        contacts=found.judgement.contacts, time={"total": seconds},
    )  # fmt: skip


def retreat_task(reach: Plan, end: FloatArray) -> Task:
    """The task of a retreat from the end of a reach to the configuration ``end`` (n,)."""
    scene, robot = held(reach)
    point, axis = robot.tool_pose(end)
    scene = replace(scene, goal=PoseGoal(point, axis), name=f"{reach.scene.name}-{RETREAT}")
    q = reach.trajectory.positions[-1]
    return Task(
        scene, robot, State(q), PoseGoal(point, axis), (), risk=reach.risk, begun=True,
        seed=reach.seed, back=way_back(reach, robot),
    )  # fmt: skip


def lift_task(reach: Plan, name: str, begin: FloatArray, end: FloatArray) -> Task:
    """The task of the lift, or of the retreat after it, between two configurations (n,)."""
    scene, robot = held(reach)
    scene = lifting.settled(reach, scene)
    if name == RETREAT:
        scene = replace(scene, may_touch=lifting.lifted_pairs(reach.scene, scene))
    goal = PoseGoal(*robot.tool_pose(end))
    scene = replace(scene, goal=goal, start=begin, name=f"{reach.scene.name}-{name}")
    return Task(
        scene, robot, State(begin), goal, (), risk=reach.risk, begun=True, seed=reach.seed
    )  # fmt: skip


def task_of(name: str, legs: Mapping[str, Plan], curve: Trajectory) -> Task:
    """The task of a leg after those of ``legs``, by which its ``curve`` is judged again."""
    reach, end = legs[REACH], curve.positions[-1]
    if name == CARRY:
        return replace(resolve(*carry_scene(legs)), risk=reach.risk)
    if lifting.stands(reach.scene):
        before = legs[REACH] if name == LIFT else legs[LIFT]
        return lift_task(reach, name, before.trajectory.positions[-1], end)
    return retreat_task(reach, end)


def carry_scene(legs: Mapping[str, Plan]) -> tuple[Scene, Robot]:
    """The scene and the robot of the carry after the other legs."""
    reach = legs[REACH]
    assert reach.scene.place is not None
    scene, robot = carried(legs[RETREAT], reach.scene.place)
    if LIFT in legs:  # the tool is out from among the packs
        scene = replace(scene, may_touch=reach.scene.may_touch)
    return scene, robot


def held(reach: Plan) -> tuple[Scene, Robot]:
    """The scene without the picked fruit, and the robot whose tool holds the fruit.

    The fruit is where the tool met it: its pose in the tool axes at the end of the reach. The scene
    has the end of the reach as start and as goal. What the target stood on, or leant on, may be
    touched by the target from then on.
    """
    target, robot, q = reach.scene.target, reach.robot, reach.trajectory.positions[-1]
    assert target is not None
    assert robot.tool is not None
    tip, _ = robot.tool_pose(q)
    _, turns = robot.segment_frames(q)
    axes = turns[-1] @ robot.tool_rotation
    mass = target.physical.get("mass")
    if mass is None:
        mass = target.physical.get("density", PUSH.beam.fruit_density) * target.shape.volume
    fruit = Attached(
        target.id, target.shape, axes.T @ (target.position - tip),
        to_quaternion(axes.T @ target.rotation), mass,
    )  # fmt: skip
    pairs = reach.scene.may_touch
    scene = replace(
        reach.scene,
        objects=rooted(item for item in reach.scene.objects if item.id != target.id),
        goal=PoseGoal(*robot.tool_pose(q)),
        start=q,
        attached=(*reach.scene.attached, fruit),
        place=None,
    )
    robot = letting_touch(laden(robot, (fruit,)), pairs)
    stood = [c.other for c in judging.touching(scene, robot, q, begun=True) if c.link == target.id]
    known = {item.id for item in scene.static}
    pairs = (*pairs, *((target.id, name) for name in stood if name in known))
    return replace(scene, may_touch=pairs), robot


def carried(before: Plan, place: Place) -> tuple[Scene, Robot]:
    """The scene and the robot of the carry after a retreat, to a place.

    Fruits that still hang, and their stems, are static; so are things that stand. The padding of
    the scene does not apply to them.
    """
    scene, robot = before.scene, before.robot
    objects = [part for item in scene.objects for part in _fixed(item)]
    return replace(
        scene, name=scene.name.replace(RETREAT, CARRY), objects=tuple(objects),
        goal=PoseGoal(place.position, place.axis), start=before.trajectory.positions[-1],
    ), robot  # fmt: skip


def _fixed(item: SceneObject) -> Iterator[SceneObject]:
    """A static object in the place of a fruit or a thing, and one for each piece of its stem."""
    if item.role == "static":
        yield item
        return
    yield SceneObject(item.id, "static", item.shape, item.position, item.orientation, padding=0.0)
    for k, (shape, middle, turn) in enumerate(() if item.stem is None else item.stem.pieces()):
        id_ = f"{item.id}:stem:{k}"
        yield SceneObject(id_, "static", shape, middle, to_quaternion(turn), padding=0.0)
