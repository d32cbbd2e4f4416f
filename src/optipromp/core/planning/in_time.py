"""Plans among objects that move: round all their places, or after they have passed.

The planner sees objects that stand: first the moving objects at all the places of their curves (the
swept volume), then none of them, then those at the ends of their curves. A motion from rest waits
as long as the judge, which knows where each object is at each time, finds a contact.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from optipromp.core.errors import Code
from optipromp.core.planning.parameters import IN_TIME
from optipromp.core.planning.result import Plan
from optipromp.core.planning.task import Task, reach
from optipromp.core.planning.verdict import verdict
from optipromp.core.scenes.scene import Scene, SceneObject
from optipromp.core.trajectory import Trajectory, chained

JUDGED = Code.SUCCESS, Code.INVALID_PLAN, Code.HARM_PREDICTED
"""Statuses that the judge gives anew."""


def moves(scene: Scene) -> bool:
    """Whether any object of the scene moves."""
    return any(item.motion is not None for item in scene.objects)


def later(scene: Scene, time: float) -> Scene:
    """The scene for one to whom ``time`` [s] is time 0: objects are where they are by then."""
    if not moves(scene):
        return scene
    objects = []
    for item in scene.objects:
        if item.motion is not None:
            motion = item.motion.later(time)
            item = replace(item, motion=motion, position=motion.at(np.zeros(1))[0])
        objects.append(item)
    return replace(scene, objects=tuple(objects))


def plan_in_time(task: Task, made_for: Callable[[Task], Plan]) -> Plan:
    """The first valid plan with ``IN_TIME.room`` among objects that move; else the best plan.

    ``made_for`` plans a task in which nothing moves.
    """
    best: tuple[tuple[bool, bool], Plan] | None = None
    for objects in (_swept(task), _standing(task.scene), _ended(task.scene)):
        made = made_for(replace(task, scene=replace(task.scene, objects=objects)))
        for wait in _waits(task):
            found = _in(task, made, wait)
            rank = found.success, made.success
            if best is None or rank > best[0]:
                best = rank, found
            if found.success and _room(found) >= min(_room(made), IN_TIME.room):
                return found
            if not made.success:
                break
    assert best is not None
    return best[1]


def _room(made: Plan) -> float:
    """Smallest distance from static objects and those that move [m]."""
    room = made.metrics.clearance_static
    return np.inf if room is None else room


def _standing(scene: Scene) -> tuple[SceneObject, ...]:
    return tuple(item for item in scene.objects if item.motion is None)


def _ended(scene: Scene) -> tuple[SceneObject, ...]:
    """The objects, those that move at the ends of their curves."""
    return tuple(
        item
        if item.motion is None
        else replace(item, position=item.motion.positions[-1], motion=None)
        for item in scene.objects
    )


def _swept(task: Task) -> tuple[SceneObject, ...]:
    """The objects, those that move at all places of their curves within the arm's reach."""
    out = list(_standing(task.scene))
    for item in task.scene.objects:
        if item.motion is None:
            continue
        last = min(float(item.motion.times[-1]), IN_TIME.horizon)
        spacing = IN_TIME.spacing * (item.radius if np.isfinite(item.radius) else 1.0)
        count = int(np.ceil(item.motion.fastest * max(last, 0.0) / spacing)) + 1
        places = item.motion.at(np.linspace(0.0, max(last, 0.0), min(count, IN_TIME.most)))
        near = np.linalg.norm(places, axis=1) - item.radius < reach(task.robot)
        out += [
            replace(item, id=f"{item.id}~{k}", position=place, motion=None)
            for k, place in enumerate(places[near])
        ]
    return tuple(out)


def _waits(task: Task) -> Iterator[float]:
    """Times to wait at the start [s]; an arm that moves cannot wait."""
    yield 0.0
    if not task.state.moving:
        yield from np.arange(IN_TIME.wait, IN_TIME.longest + 1e-9, IN_TIME.wait).tolist()


def _in(task: Task, made: Plan, wait: float) -> Plan:
    """A plan, judged among the objects that move, after a time to ``wait`` [s]."""
    curves, first = [made.trajectory, made.initial, made.followed], made.first
    if wait > 0.0:
        curves, first = [waited(curve, wait) for curve in curves], first + 1
    trajectory, initial, followed = curves
    found = verdict(task, trajectory)
    status, message = found.status, found.message
    if status is not Code.SUCCESS and made.status not in JUDGED:
        status, message = made.status, made.message
    return replace(
        made, task=task, trajectory=trajectory, initial=initial, followed=followed, first=first,
        status=status, message=message, metrics=found.judgement.metrics,
        contacts=found.judgement.contacts, prediction=found.prediction,
    )  # fmt: skip


def waited(trajectory: Trajectory, wait: float) -> Trajectory:
    """A trajectory from rest that begins after the time ``wait`` [s]."""
    q = np.tile(trajectory.positions[0], (2, 1))
    still = np.zeros_like(q)
    stay = Trajectory(np.array([0.0, wait]), q, still, still, trajectory.joint_names)
    return chained([stay, trajectory])
