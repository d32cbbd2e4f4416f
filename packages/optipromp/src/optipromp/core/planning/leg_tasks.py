"""The legs after a reach: their scenes, tasks and push models.

On the *retreat* and on the *carry* the picked fruit is attached to the tool and its stem is cut.
A target that stands on a board has a *lift* before the retreat: straight up, then back along the
reach, higher by the lift. Dragged back it would rub on the board and push what stands before it.
Lifted, the target and the tool leave by the corridor that the reach has pushed free. The packs
stand where the push model says that the reach left them.
The carry is a motion in free space, in which the fruits that still hang are static.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Collection, Iterator, Mapping
from dataclasses import replace
from itertools import chain

import numpy as np

from optipromp.core import judging
from optipromp.core.arrays import FloatArray, lengths, rotation
from optipromp.core.planning.cutting import hung
from optipromp.core.planning.parameters import LIFTING
from optipromp.core.planning.result import CARRY, LIFT, REACH, RETREAT, Plan, Said
from optipromp.core.planning.task import (
    Task,
    Underway,
    cuts,
    from_side,
    laden,
    resolve,
    tool_motion,
)
from optipromp.core.planning.timing import among_fruits
from optipromp.core.planning.verdict import Verdict, judged, led, predicted
from optipromp.core.pushing.stems.cup import flange_of
from optipromp.core.pushing.stems.hanging import Hanging, Leaving
from optipromp.core.robots import ik
from optipromp.core.robots.model import Robot, letting_touch
from optipromp.core.robots.mounted import Mounted
from optipromp.core.scenes.held import RETREAT as RETREAT_LENGTH
from optipromp.core.scenes.held import Attached, Place, pairs_among
from optipromp.core.scenes.objects import mass_of, rooted
from optipromp.core.scenes.rotations import to_quaternion
from optipromp.core.scenes.scene import PoseGoal, Role, Scene, SceneObject
from optipromp.core.trajectory import State, Trajectory


def leg(task: Task, trajectory: Trajectory, seconds: float) -> Plan:
    """The judged plan of a motion that no planner made, in a time of ``seconds`` [s]."""
    push = predicted(task, trajectory)
    outcome = Verdict(judged(task, trajectory, stem_side=push is None), push)
    return Plan(
        task=task, planner="retreat", seed=task.seed, status=outcome.status,
        said=Said("", outcome), trajectory=trajectory, initial=trajectory, followed=trajectory,
        prediction=outcome.prediction, judgement=outcome.judgement, stages=(),
        time={"total": seconds},
    )  # fmt: skip


def leg_task(reach: Plan, name: str, curve: Trajectory) -> Task:
    """The task of a lift or a retreat that is to end where the ``curve`` ends."""
    scene, robot = held(reach)
    lifts = stands(reach.scene)
    if lifts:
        scene = settled(reach, scene)
    if lifts and name == RETREAT:
        scene = replace(scene, may_touch=lifted_pairs(reach.scene, scene))
    begin, end = curve.positions[[0, -1]]
    goal = PoseGoal(*robot.tool_pose(end))
    scene = replace(scene, goal=goal, start=begin, name=f"{reach.scene.name}-{name}")
    back = None if lifts else retreat_model(reach)
    if back is not None:
        back = back.at(among_fruits(robot, curve, reach.scene.pushables))
    return Task(
        scene, robot, State(begin), goal, (), Underway(begun=True), risk=reach.risk,
        seed=reach.seed, back=back,
    )  # fmt: skip


def task_of(name: str, legs: Mapping[str, Plan], curve: Trajectory) -> Task:
    """The task of a leg after those of ``legs``, by which its ``curve`` is judged again."""
    reach = legs[REACH]
    if name == CARRY:
        return replace(resolve(*carry_scene(legs)), risk=reach.risk)
    return leg_task(reach, name, curve)


def carry_scene(legs: Mapping[str, Plan]) -> tuple[Scene, Robot]:
    """The scene and the robot of the carry after the other legs."""
    reach = legs[REACH]
    assert reach.scene.place is not None
    scene, robot = carried(legs[RETREAT], reach.scene.place)
    if LIFT in legs or scene.path is not None:  # the tool is out from among what it pushes
        scene = replace(scene, may_touch=reach.scene.may_touch)
    return scene, robot


@functools.lru_cache(maxsize=4)  # by identity: all legs of a reach ask for it
def held(reach: Plan) -> tuple[Scene, Robot]:
    """The scene without the picked fruit, and the robot whose tool holds the fruit.

    The fruit is where the tool met it: its pose in the tool axes at the end of the reach. What
    blades cut hangs from them (:func:`optipromp.core.planning.cutting.hung`), all fruits of a
    truss. Below blades that came from the side, other fruits are static to it; the tool may touch
    them, whose push its model predicts. The scene has the end of the reach as start and as goal.
    What the target stood on, or leant on, may be touched by the target from then on.
    """
    target, robot, q = reach.scene.target, reach.robot, reach.trajectory.positions[-1]
    names = {item.id for item in reach.scene.taken}
    assert target is not None
    assert robot.tool is not None
    tip, _ = robot.tool_pose(q)
    _, turns = robot.segment_frames(q)
    axes = turns[-1] @ robot.tool_rotation
    fruit, path = Attached(
        target.id, target.shape, axes.T @ (target.position - tip),
        to_quaternion(axes.T @ target.rotation), mass_of(target),
    ), None  # fmt: skip
    fruits: tuple[Attached, ...] = (fruit,)
    pairs = reach.scene.may_touch
    objects = rooted(item for item in reach.scene.objects if item.id not in names)
    if cuts(reach.scene, robot.tool):
        fruits, path = hung(reach.scene, robot, q)
    if path is not None and from_side(reach.scene):  # from below it is between the blades
        fixed = [(item, part) for item in objects for part in _fixed(item)]
        objects = tuple(part for _, part in fixed)
        hang = [part.id for item, part in fixed if item.role != "static"]
        pairs = (*pairs, *((name, id_) for name in _near(robot) for id_ in hang))
    scene = replace(
        reach.scene,
        objects=objects,
        goal=PoseGoal(*robot.tool_pose(q)),
        start=q,
        attached=(*reach.scene.attached, *fruits),
        place=None,
        path=path,
        may_touch=pairs,
    )
    robot = letting_touch(laden(robot, fruits), pairs)
    stood = [c for c in judging.touching(scene, robot, q, begun=True) if c.link in names]
    known = {item.id for item in reach.scene.static}
    pairs = (*pairs, *((one.link, one.other) for one in stood if one.other in known))
    return replace(scene, may_touch=pairs), robot


def distance_of(reach: Plan) -> float:
    """Distance of the retreat [m]."""
    return RETREAT_LENGTH if reach.scene.place is None else reach.scene.place.retreat


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


@functools.lru_cache(maxsize=2048)  # by identity: every way out asks for it
def _fixed(item: SceneObject) -> tuple[SceneObject, ...]:
    """A static object in the place of a fruit or a thing, and one for each piece of its stem."""
    if item.role == "static":
        return (item,)
    stem = enumerate(() if item.stem is None else item.stem.pieces())
    pieces = ((f"{item.id}:stem:{k}", one, at, to_quaternion(turn)) for k, (one, at, turn) in stem)
    return tuple(
        SceneObject(name, "static", shape, at, turn, padding=0.0)
        for name, shape, at, turn in chain(
            [(item.id, item.shape, item.position, item.orientation)], pieces
        )
    )


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
    holders = [*_near(robot), *(item.id for item in scene.attached)]
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


def _near(robot: Robot) -> list[str]:
    """Names of the last link and of what is beyond it, which may touch what is pushed."""
    first = robot.spheres.link[robot.spheres.distal].min()
    return [*dict.fromkeys(str(name) for name in robot.link_names[first:])]


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


@functools.lru_cache(maxsize=4)
def retreat_model(reach: Plan) -> Leaving | None:
    """The push model of the retreat, which knows the push of the reach; see :func:`full_model`."""
    model, before = full_model(reach, held(reach)[1]), reach.push_model
    if model is None:
        return None
    if before is None:
        return Leaving(model, *tool_motion(reach.robot, reach.trajectory.positions[reach.first :]))
    points, axes, *_ = led(reach.task, before, reach.trajectory)
    return Leaving(model, points, axes, reach.prediction)


def full_model(reach: Plan, robot: Robot) -> Hanging | None:
    """The model of a tool that is full, and so a solid body among fruits; ``robot`` holds it.

    None where nothing else hangs.
    """
    scene, target = reach.scene, reach.scene.target
    assert target is not None
    picked = {item.id for item in scene.taken}
    hanging = [o for o in scene.pushables if o.stem is not None and o.id not in picked]
    tool = reach.robot.tool
    if target.stem is None or not hanging or tool is None or robot.tool is None:
        return None

    first = min(hanging, key=lambda item: math.dist(item.position, target.position))
    seen = aimed(replace(scene, place=None) if scene.place else scene, first.id, picked)
    left = tuple(item for item in reach.task.neighbours if item.id not in {first.id, *picked})
    full = replace(Mounted.of(robot.tool), full=True)
    return Hanging(
        seen, full, left, reach.task.camera, robot.gripper_radius, flange_of(robot), reach.risk,
    )  # fmt: skip


def aimed(scene: Scene, target: str, picked: Collection[str] = ()) -> Scene:
    """A scene with this ``target``, without ``picked`` fruits; other fruits are pushables."""
    roles: dict[str, Role] = {i.id: "pushable" for i in scene.objects if i.role == "target"}
    roles[target] = "target"
    left = [item for item in scene.objects if item.id not in picked]
    return replace(
        scene,
        name=f"{scene.name}-{target}",
        objects=rooted(
            replace(item, role=roles[item.id]) if item.id in roles else item for item in left
        ),
        goal=None,
        may_touch=pairs_among(scene.may_touch, picked),
    )
