"""``plan_pick``: a pick in several legs: the reach, the retreat, and the way to a place.

On the *retreat* and on the *carry* the picked fruit is attached to the tool and its stem is cut.
A target that stands on a board has a *lift* before the retreat: straight up, then back along the
reach, higher by the lift. Dragged back it would rub on the board and push what stands before it.
Lifted, the target and the tool leave by the corridor that the reach has pushed free. The packs
stand where the push model says that the reach left them.
The retreat is the way back that does least harm: along the reach, along the tool axis, off that
axis within a cone, or along the axis after a step aside. The carry is a motion in free space, in
which the fruits that still hang are static.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, fields, replace
from itertools import starmap
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np

from optipromp.core import judging
from optipromp.core.arrays import FloatArray, frame_along, lengths, rotation
from optipromp.core.budget import clock
from optipromp.core.errors import Code, InvalidRequestError
from optipromp.core.planning.options import DEFAULTS, PlanOptions, Timed, stated
from optipromp.core.planning.parameters import BACK, LIFTING
from optipromp.core.planning.plan import check_request, other_reaches, plan
from optipromp.core.planning.result import Plan, best_of
from optipromp.core.planning.task import Task, laden, resolve, tool_motion
from optipromp.core.planning.timing import eased, leaving, shortest
from optipromp.core.planning.verdict import led, verdict, whole
from optipromp.core.pushing.model import Continued, PushModel
from optipromp.core.pushing.parameters import PUSH
from optipromp.core.pushing.path import length
from optipromp.core.pushing.stems.cup import flange_of
from optipromp.core.pushing.stems.hanging import Hanging, Leaving
from optipromp.core.robots import ik
from optipromp.core.robots.model import Robot, letting_touch
from optipromp.core.robots.mounted import Mounted
from optipromp.core.scenes.held import RETREAT as RETREAT_LENGTH
from optipromp.core.scenes.held import Attached, Place
from optipromp.core.scenes.io import load_scene
from optipromp.core.scenes.objects import rooted
from optipromp.core.scenes.rotations import to_quaternion
from optipromp.core.scenes.scene import PoseGoal, Scene, SceneObject
from optipromp.core.trajectory import State, Trajectory

REACH, LIFT, RETREAT, CARRY = "reach", "lift", "retreat", "carry"
AFTER = LIFT, RETREAT, CARRY

IDEAL = False, False, BACK.alike  # the rank of a retreat that no other betters


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
    def failure(self) -> float:
        """Probability that the pick is not clean, of all legs; nan where one does not tell."""
        told = [leg.prediction.probability for leg in self.legs.values() if leg.prediction]
        return 1.0 - math.prod(1.0 - each for each in told) if told else math.nan

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
            "failure": None if math.isnan(self.failure) else self.failure,
            "legs": {name: leg.to_dict() for name, leg in self.legs.items()},
        }


def plan_pick(
    scene: Scene | str | Path, *, progress: Callable[[str], None] | None = None, **request: Any
) -> Picked:
    """Plan a pick and what comes after: the reach, the retreat, and the way to ``scene.place``.

    Args:
        scene: a scene, the name of a built-in scene, or the path of a scene file; with a target.
            Without a ``place`` the pick ends with the retreat.
        progress: called with a short text as each step begins.
        request: further arguments of :func:`optipromp.core.planning.plan.plan`.

    Returns:
        The legs. A leg that fails is returned too, with its code; no leg comes after it.

    Raises:
        InvalidRequestError: the scene has no target, objects that move, or a robot without a tool.
        OptiPrompError: an error of :func:`optipromp.core.planning.plan.plan`.
    """
    scene = scene if isinstance(scene, Scene) else load_scene(scene)
    if scene.target is None:
        raise InvalidRequestError(f"{scene.name} has no target: a pick needs one")
    if names := ", ".join(item.id for item, _ in scene.movers):
        told = "the legs of a pick know no motion; leave out the motions, or plan the reach alone"
        raise InvalidRequestError(f"in {scene.name} {names} move: {told}")
    reach = plan(scene, progress=progress, **request)
    return after(reach, progress, scene, **request)


def after(
    reach: Plan, progress: Callable[[str], None] | None = None, scene: Scene | None = None,
    **request: Any,
) -> Picked:  # fmt: skip
    """A pick from its reach, with the legs that come after; see :func:`plan_pick`.

    ``scene``: of which another approach is taken where the way out harms; None: the reach stays.
    """
    legs = {REACH: reach}
    if reach.robot.tool is None:
        raise InvalidRequestError(f"{reach.robot.name} has no tool, which would hold the target")
    if reach.success:
        (progress or str)("retreat")
        legs = reach_and_way_out(reach, scene, **request)
    if RETREAT in legs and legs[RETREAT].success and reach.scene.place is not None:
        scene, robot = carry_scene(legs)
        legs[CARRY] = plan(scene, progress=progress, **request | {"robot": robot})
    return Picked(legs)


def reach_and_way_out(reach: Plan, scene: Scene | None = None, **request: Any) -> dict[str, Plan]:
    """A reach and its way out; where that harms, those by the least harmful other approach.

    Where no other approach is harmless, those of the first. ``scene``, ``request``: see
    :func:`after`.
    """
    names = {item.name for item in fields(PlanOptions)} & request.keys()
    options = stated(request.get("options"), {name: request[name] for name in names}, plan)
    planner = request.get("planner", "opti-promp")
    settings: Timed = planner if isinstance(planner, Timed) else options
    legs = {REACH: reach, **way_out(reach, settings)}
    harms = reach.success and whole(legs)[0] is Code.HARM_PREDICTED
    if scene is None or stands(scene) or not harms:
        return legs
    solver = check_request(planner, request.get("strategy", "joint"), options)
    reaches = other_reaches(reach, scene, solver, options)

    def rank(tried: dict[str, Plan]) -> tuple[bool, float]:
        return whole(tried)[0] is not Code.SUCCESS, Picked(tried).failure

    best = best_of(
        ({REACH: other, **way_out(other, settings, sparing=True)} for other in reaches),
        rank,
        lambda tried: rank(tried) <= (False, BACK.good),
    )
    return legs if best is None or rank(best)[0] else best


def way_out(reach: Plan, options: Timed = DEFAULTS, sparing: bool = False) -> dict[str, Plan]:
    """The legs by which the tool leaves the plant after a reach; see :func:`plan_pick`."""
    if stands(reach.scene):
        return lifted(reach, options)
    return {RETREAT: retreat(reach, options, sparing)}


def retreat(reach: Plan, options: Timed = DEFAULTS, sparing: bool = False) -> Plan:
    """The retreat of least harm from the end of a reach; the best invalid one where none is valid.

    The push model ranks all proposals by a few states; the best of them are judged. Longer retreats
    are tried where all shorter ones harm, or end where the robot or the fruit touches something
    that the carry must not touch; none where ``sparing``.
    """
    began, place = clock(), reach.scene.place
    _, robot = held(reach)
    model = retreat_model(reach, robot)

    def judged(q: FloatArray) -> tuple[tuple[bool, bool, float], Plan]:
        """A retreat and its rank: validity, whether it presses more or ends badly, harm."""
        one = _leg(reach, RETREAT, q, options, began, model)
        worse = pressed(one) < min(pressed(reach), 0.0)
        if place is not None:  # the carry cannot begin where something is touched
            worse |= bool(judging.touching(*carried(one, place), q[-1]))
        return (not one.valid, worse, max(one.harm, BACK.alike)), one

    def pressed(one: Plan) -> float:
        """Distance of the last link and the tool to objects to avoid [m]."""
        least = one.judgement.metrics.clearance_avoid_tool
        return math.inf if least is None else least

    def screened(q: FloatArray) -> float:
        return 0.0 if model is None else model.harm(*tool_motion(robot, q), BACK.screened)

    best = None
    distance = _distance(reach)
    for factor in (1.0, 0.5 * (1.0 + BACK.farther), BACK.farther)[: 1 if sparing else None]:
        path = reach.trajectory.positions
        proposed = sorted(_retreats(reach.robot, path, factor * distance), key=screened)
        for first in range(0, len(proposed), BACK.judged):
            some = map(judged, proposed[first : first + BACK.judged])
            best = best_of(some, itemgetter(0), lambda one: one[0] == IDEAL, best)
            assert best is not None  # the first retreat is always proposed
            if best[0][:2] == IDEAL[:2]:
                break
        if best is not None and best[1].success and best[0][:2] == IDEAL[:2]:
            break
    assert best is not None
    return replace(best[1], time={"total": clock() - began})


def _distance(reach: Plan) -> float:
    """Distance of the retreat [m]."""
    place = reach.scene.place
    return RETREAT_LENGTH if place is None else place.retreat


def lifted(reach: Plan, options: Timed = DEFAULTS) -> dict[str, Plan]:
    """Lift and retreat of a target that stands: the first height of which both are valid.

    Where no height has both, those of the last one, without a retreat after an invalid lift.
    """
    began = clock()
    _, robot = held(reach)

    def judged(up: FloatArray, back: FloatArray) -> dict[str, Plan]:
        made = {LIFT: _leg(reach, LIFT, up, options, began)}
        if made[LIFT].success:
            made[RETREAT] = _leg(reach, RETREAT, back, options, began)
        return made

    proposed = lifts(reach, robot, _distance(reach))
    best = best_of(
        enumerate(starmap(judged, proposed)),
        rank=lambda one: -one[0],  # the last height
        enough=lambda one: RETREAT in one[1] and one[1][RETREAT].success,
    )
    if best is None:
        raise InvalidRequestError(
            f"{reach.scene.name}: the arm cannot lift the target straight up from its grasp"
        )
    return best[1]


def _leg(
    reach: Plan, name: str, q: FloatArray, options: Timed, began: float,
    back: PushModel | None = None,
) -> Plan:  # fmt: skip
    """The judged lift or retreat through waypoints ``q`` (T, n).

    ``began``: the clock's time at which the stage began [s]. ``back``: see :func:`leg_task`.
    """
    task, target = leg_task(reach, name, q[0], q[-1], back), reach.scene.target
    assert target is not None
    if stands(reach.scene):
        made = shortest(eased(task.robot, options), q, 0, LIFTING.speed)
    else:
        made = leaving(task, options, q, (*task.scene.pushables, target))
    return leg(task, made, clock() - began)


def ways_out(reach: Plan, q: FloatArray, holding: bool = False) -> list[FloatArray]:
    """Waypoints (T, n) of ways out of the plant, the least harmful first.

    ``reach``: the plan that was followed. ``q``: (k, n) configurations on it so far. ``holding``:
    whether the tool leaves with its target, else without. Where no model of fruits on stems
    applies, the way back along ``q`` alone.
    """
    model, distance = reach.push_model, length(reach.robot.tool_pose(q)[0])
    if holding:
        model, distance = _full(reach, held(reach)[1]), _distance(reach)
    elif isinstance(model, Continued):
        model = model.lead
    proposed = _retreats(reach.robot, q, distance)
    if not isinstance(model, Hanging) or len(q) < 3:
        return [next(proposed)]
    out = Leaving(model, *tool_motion(reach.robot, q))

    def harm(one: FloatArray, states: int) -> float:
        return out.harm(*tool_motion(reach.robot, one), states)

    ways = sorted(((harm(one, BACK.screened), one) for one in proposed), key=itemgetter(0))
    some = [(harm(one, out.states), one) for _, one in ways[: BACK.judged]]
    return [one for _, one in (*sorted(some, key=itemgetter(0)), *ways[BACK.judged :])]


def _retreats(robot: Robot, q: FloatArray, distance: float) -> Iterator[FloatArray]:
    """Waypoints (T, n) of retreats by ``distance`` [m], from the end of a motion ``q`` (k, n).

    Back along the motion, straight along the tool axis, off that axis within a cone, and along the
    axis after a step aside: from behind the tool's floor, fruits slide off it to the side.
    """
    tips, axes = robot.tool_pose(q)
    axis, turn = axes[-1], frame_along(axes[-1])

    def through(*corners: FloatArray) -> Iterator[FloatArray]:
        """The way of the tool point through corners (3,) from its place."""
        points = tips[-1:]
        for corner in corners:
            off = tips[-1] + corner - points[-1]
            parts = max(2, math.ceil(float(np.linalg.norm(off)) / BACK.step))
            points = np.vstack(
                [points, points[-1] + off * np.linspace(0.0, 1.0, parts + 1)[1:, None]]
            )
        made, errors = ik.track(robot, points, np.tile(axis, (len(points), 1)), q[-1])
        if errors.max() < judging.GOAL_TOLERANCE:
            yield np.vstack([q[-1:], made[1:]])

    yield back_along(q, tips, distance)
    yield from through(-distance * axis)
    around = 2.0 * np.pi * np.arange(BACK.around) / BACK.around
    sides = [turn @ np.array([math.cos(one), math.sin(one), 0.0]) for one in around]
    for lean in np.deg2rad([0.5 * BACK.cone, BACK.cone]):
        for side in sides:
            yield from through(-distance * (math.sin(lean) * side + math.cos(lean) * axis))
    wide = 0.0 if robot.tool is None else robot.tool.mouth[1]
    for size in BACK.aside:
        for side in sides:
            yield from through(size * wide * side, size * wide * side - distance * axis)


def back_along(q: FloatArray, tips: FloatArray, distance: float) -> FloatArray:
    """The end of a motion ``q`` (k, n) backwards, by ``distance`` [m] of its ``tips`` (k, 3)."""
    gone = np.append(0.0, np.cumsum(lengths(np.diff(tips[::-1], axis=0))))
    last = min(int(np.searchsorted(gone, distance)) + 1, len(q))
    return q[::-1][: max(last, 3)]


def leg(task: Task, trajectory: Trajectory, seconds: float) -> Plan:
    """The judged plan of a motion that no planner made."""
    outcome = verdict(task, trajectory)
    return Plan(
        task=task, planner="retreat", strategy=None, seed=task.seed, status=outcome.status,
        reason=outcome.reason, notes=outcome.notes, trajectory=trajectory, initial=trajectory,
        followed=trajectory, prediction=outcome.prediction, judgement=outcome.judgement,
        stages=(), time={"total": seconds},
    )  # fmt: skip


def leg_task(
    reach: Plan, name: str, begin: FloatArray, end: FloatArray, back: PushModel | None = None
) -> Task:
    """The task of a lift or a retreat between two configurations (n,).

    ``back``: the model of :func:`retreat_model`; None: it is made.
    """
    scene, robot = held(reach)
    lifts = stands(reach.scene)
    if lifts:
        scene = settled(reach, scene)
    if lifts and name == RETREAT:
        scene = replace(scene, may_touch=lifted_pairs(reach.scene, scene))
    goal = PoseGoal(*robot.tool_pose(end))
    scene = replace(scene, goal=goal, start=begin, name=f"{reach.scene.name}-{name}")
    return Task(
        scene, robot, State(begin), goal, (), risk=reach.risk, begun=True, seed=reach.seed,
        back=None if lifts else back or retreat_model(reach, robot),
    )  # fmt: skip


def task_of(name: str, legs: Mapping[str, Plan], curve: Trajectory) -> Task:
    """The task of a leg after those of ``legs``, by which its ``curve`` is judged again."""
    reach = legs[REACH]
    if name == CARRY:
        return replace(resolve(*carry_scene(legs)), risk=reach.risk)
    *_, before = legs.values()
    return leg_task(reach, name, before.trajectory.positions[-1], curve.positions[-1])


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


def stands(scene: Scene) -> bool:
    """Whether the target stands and is reached from the side."""
    target, slope = scene.target, abs(float(scene.frame[2] @ scene.up))
    return target is not None and target.stem is None and slope < np.sin(np.deg2rad(LIFTING.level))


def settled(reach: Plan, scene: Scene) -> Scene:
    """The ``scene`` of the way back, with the packs where the reach has left them, as static.

    Packs that the reach has pushed may be touched by the tool, the last link and what they hold.
    """
    places: dict[str, tuple[FloatArray, float]] = {}
    model, robot = reach.push_model, reach.robot
    if model is not None:
        points, axes, *_ = led(reach.task, model, reach.trajectory)
        left = model.moved(points, axes)
        ends = zip(left.ids, left.positions, left.turns, strict=True)
        places = {id_: (place, float(turn)) for id_, place, turn in ends}
    objects, pairs = list[SceneObject](), list(scene.may_touch)
    near = [
        str(name) for name in robot.link_names[robot.spheres.link[robot.spheres.distal].min() :]
    ]
    holders = [*dict.fromkeys(near), *(item.id for item in scene.attached)]
    for item in scene.objects:
        if item.role == "static" or item.stem is not None:
            objects.append(item)
            continue
        place, turn = places.get(item.id, (item.position, 0.0))
        orientation = to_quaternion(rotation(-scene.frame[0], turn) @ item.rotation)
        objects.append(SceneObject(item.id, "static", item.shape, place, orientation, padding=0.0))
        if np.linalg.norm(place - item.position) > LIFTING.pushed or abs(turn) > LIFTING.pushed:
            pairs += [(name, item.id) for name in holders]
    return replace(scene, objects=tuple(objects), may_touch=tuple(pairs))


def lifted_pairs(before: Scene, scene: Scene) -> tuple[tuple[str, str], ...]:
    """The pairs of a ``scene`` that may touch, less those of the target with the board it left.

    ``before`` is the scene of the reach.
    """
    target, static = before.target, {item.id for item in before.static}
    assert target is not None
    return tuple(
        pair
        for pair in scene.may_touch
        if pair in before.may_touch or not (target.id in pair and static & set(pair))
    )


def lifts(reach: Plan, robot: Robot, distance: float) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Waypoints (T, n) of the lift and (U, n) of the way back, for each height.

    The way back ends ``distance`` [m] along the reach from its end, and at least where the approach
    begins.
    """
    q = reach.trajectory.positions
    tips, axes = robot.tool_pose(q)
    gone = np.append(0.0, np.cumsum(lengths(np.diff(tips[::-1], axis=0))))
    first = len(q) - 1 - reach.first
    last = max(min(int(np.searchsorted(gone, distance)), len(q) - 1), first, 2)
    for height in LIFTING.heights:
        rise = np.linspace(0.0, height, max(3, int(np.ceil(height / LIFTING.step)) + 1))
        points = tips[-1] + rise[:, None] * reach.scene.up
        up, off = ik.track(robot, points, np.tile(axes[-1], (len(rise), 1)), q[-1])
        level = (tips - tips[-1]) @ reach.scene.up  # the way back is nowhere lower than the lift
        over = tips + (height - np.minimum(level, 0.0))[:, None] * reach.scene.up
        above = over[::-1][: last + 1]
        back, missed = ik.track(robot, above, axes[::-1][: last + 1], up[-1])
        if max(off.max(), missed.max()) < judging.GOAL_TOLERANCE:
            yield np.vstack([q[-1:], up[1:]]), np.vstack([up[-1:], back[1:]])


def retreat_model(reach: Plan, robot: Robot) -> PushModel | None:
    """The push model of the retreat, which knows the push of the reach; see :func:`_full`."""
    model, before = _full(reach, robot), reach.push_model
    if model is None or before is None:
        q = reach.trajectory.positions[reach.first :]
        return model and Leaving(model, *tool_motion(reach.robot, q))
    points, axes, *_ = led(reach.task, before, reach.trajectory)
    return Leaving(model, points, axes)


def _full(reach: Plan, robot: Robot) -> Hanging | None:
    """The model of a tool that is full, and so a solid body among fruits; ``robot`` holds it.

    None where nothing else hangs.
    """
    scene, target = reach.scene, reach.scene.target
    assert target is not None
    hanging = [item for item in scene.pushables if item.stem is not None]
    tool = reach.robot.tool
    if target.stem is None or not hanging or tool is None or robot.tool is None:
        return None

    first = min(hanging, key=lambda item: math.dist(item.position, target.position))
    seen = replace(scene.aimed(first.id, [target.id]), place=None)
    left = tuple(item for item in reach.task.neighbours if item.id not in (first.id, target.id))
    full = replace(Mounted.of(robot.tool), full=True)
    return Hanging(
        seen, full, left, reach.task.camera, robot.gripper_radius, flange_of(robot), reach.risk,
    )  # fmt: skip
