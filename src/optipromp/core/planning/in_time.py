"""Plans among objects that move: round all their places, or after they have passed.

The planner sees objects that stand: first the moving objects at all the places of their curves (the
swept volume), then none of them, then those at the ends of their curves. A pushable that moves is
seen where the last plan's tool passes it, until that place hardly changes. A motion from rest waits
as long as the judge, which knows where each object is at each time, finds a contact. An arm that
moves cannot wait: where no motion on from its state is valid, it brakes and plans from rest.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from operator import itemgetter

import numpy as np

from optipromp.core.arrays import frozen
from optipromp.core.budget import clock
from optipromp.core.errors import Code
from optipromp.core.planning.parameters import IN_TIME
from optipromp.core.planning.result import Plan, best_of
from optipromp.core.planning.task import Task, as_of, passages, reach
from optipromp.core.planning.timing import stopped
from optipromp.core.planning.verdict import verdict
from optipromp.core.scenes.scene import Scene, SceneObject
from optipromp.core.trajectory import State, Trajectory, chained

JUDGED = Code.SUCCESS, Code.INVALID_PLAN, Code.HARM_PREDICTED
"""Statuses that the judge gives anew."""


def later(scene: Scene, time: float) -> Scene:
    """The scene for one to whom ``time`` [s] is time 0: objects are where they are by then."""
    motions = {item.id: course.later(time) for item, course in scene.movers}
    if not motions:
        return scene
    there = scene.standing(dict.fromkeys(motions, time))
    objects = (replace(o, motion=motions.get(o.id, o.motion)) for o in there.objects)
    return replace(scene, objects=tuple(objects))


def plan_in_time(task: Task, made_for: Callable[[Task], Plan], late: float = np.inf) -> Plan:
    """The first valid plan with ``IN_TIME.room`` among objects that move; else the best plan.

    ``made_for`` plans a task in which nothing moves. Nothing new is tried after ``late`` [s], a
    time of the plan's clock.
    """
    best = _among(task, made_for, late)
    if best.success or not task.state.moving or clock() > late:
        return best
    brake = stopped(task.robot, task.state)
    if met := verdict(task, brake).judgement.contacts:
        return replace(best, reason=f"{best.reason}; the arm brakes too late: {met[0]}")
    made = _in(task, _among(_stood(task, brake), made_for, late), brake)
    if made.success:
        note = f"the arm brakes first, {brake.duration:.2f} s; without, {best.message}"
        return replace(made, notes=(*made.notes, note))
    return replace(best, reason=f"{best.reason}; with a brake first, {made.message}")


def _among(task: Task, made_for: Callable[[Task], Plan], late: float) -> Plan:
    """:func:`plan_in_time` without a brake."""
    ended = task.scene.standing({item.id: np.inf for item, _ in task.scene.movers})
    scenes = [_swept(task), ended]
    if len(task.scene.movers) > len(task.scene.drifting):
        scenes.insert(1, replace(task.scene, objects=_standing(task.scene)))
    cut = False

    def judged() -> Iterator[tuple[tuple[bool, bool, bool], Plan]]:
        """Plans and their ranks: room, success, and success where nothing moves."""
        nonlocal cut
        for scene in scenes:
            seen, when = replace(task, scene=scene), dict.fromkeys(scene.drifting, IN_TIME.met)
            for _ in range(IN_TIME.rounds if when else 1):
                made = made_for(as_of(seen, when))
                for wait in _waits(task):
                    one = _in(task, made, _still(made, wait) if wait else None)
                    roomy = one.success and _room(one) >= min(_room(made), IN_TIME.room)
                    yield (not roomy, not one.success, not made.success), one
                    cut = clock() > late
                    if cut or not made.success:
                        break
                    if any((met.time or wait) < wait for met in one.contacts):
                        break  # what is met while the arm waits is met in a longer wait too
                    if when and not one.contacts:
                        break  # what is pushed is elsewhere after a longer wait
                before, when = when, passages(seen, one.trajectory)
                if cut or one.contacts or _near(seen.scene, before, when):
                    break
            if cut:
                return

    best = best_of(judged(), itemgetter(0), lambda one: not one[0][0])
    assert best is not None  # each scene gives a plan
    if cut and not best[1].success:
        reason = f"time ran out; the best so far: {best[1].reason}"
        return replace(best[1], status=Code.TIMEOUT, reason=reason)
    return best[1]


def _near(scene: Scene, when: Mapping[str, float], other: Mapping[str, float]) -> bool:
    """Whether pushables are at the same places at two times each [s], by id."""
    places = (scene.drifting[k].at(np.array([t, other[k]])) for k, t in when.items())
    return all(math.dist(*two) < IN_TIME.same for two in places)


def _stood(task: Task, brake: Trajectory) -> Task:
    """The task of the arm that has braked: nothing runs, and objects are where they are by then."""
    rest = State(brake.positions[-1])
    entry = None if task.entry is None else frozen(task.robot.tool_pose(rest.q)[0])
    return replace(
        task, scene=later(task.scene, brake.duration), state=rest, entry=entry, running=None,
        kept=None, same=False,
    )  # fmt: skip


def _room(made: Plan) -> float:
    """Smallest distance from static objects and those that move [m]."""
    room = made.metrics.clearance_static
    return np.inf if room is None else room


def _standing(scene: Scene) -> tuple[SceneObject, ...]:
    """The objects that stand, and the pushables."""
    return tuple(o for o in scene.objects if o.course is None or o.role == "pushable")


def _swept(task: Task) -> Scene:
    """The scene whose moving objects, but pushables, are at all places within the arm's reach.

    Each place has the padding of its object, and may be touched by what may touch the object.
    """
    out, pairs = list(_standing(task.scene)), list(task.scene.may_touch)
    for item, course in task.scene.movers:
        if item.role == "pushable":
            continue
        last = min(float(course.times[-1]), IN_TIME.horizon)
        spacing = IN_TIME.spacing * (item.radius if np.isfinite(item.radius) else 1.0)
        count = int(np.ceil(course.fastest * max(last, 0.0) / spacing)) + 1
        places = course.at(np.linspace(0.0, max(last, 0.0), min(count, IN_TIME.most)))
        near = np.linalg.norm(places, axis=1) - item.radius < reach(task.robot)
        copies = [
            replace(item, motion=None).at(place, f"{item.id}~{k}")
            for k, place in enumerate(places[near])
        ]
        touching = [name for pair in pairs if item.id in pair for name in pair if name != item.id]
        pairs += [(name, copy.id) for name in touching for copy in copies]
        out += copies
    return replace(task.scene, objects=tuple(out), may_touch=tuple(pairs))


def _waits(task: Task) -> Iterator[float]:
    """Times to wait at the start [s]; an arm that moves cannot wait."""
    yield 0.0
    if not task.state.moving:
        yield from np.arange(IN_TIME.wait, IN_TIME.longest + 1e-9, IN_TIME.wait).tolist()


def _in(task: Task, made: Plan, before: Trajectory | None) -> Plan:
    """A plan, judged among the objects that move, after the motion ``before`` it; None: none."""
    curves, first = [made.trajectory, made.initial, made.followed], made.first
    if before is not None:
        curves = [chained([before, curve]) for curve in curves]
        first += before.n_waypoints - 1
    trajectory, initial, followed = curves
    if made.task.scene.approach is not task.scene.approach:  # another was chosen
        scene = replace(task.scene, approach=made.task.scene.approach)
        task = replace(task, scene=scene, goal=made.task.goal)
    found = verdict(task, trajectory)
    told = found if found.status is Code.SUCCESS or made.status in JUDGED else made
    return replace(
        made, task=task, trajectory=trajectory, initial=initial, followed=followed, first=first,
        status=told.status, reason=told.reason, notes=told.notes, judgement=found.judgement,
        prediction=found.prediction,
    )  # fmt: skip


def _still(made: Plan, wait: float) -> Trajectory:
    """A stay at the start of a plan for the time ``wait`` [s]."""
    q = np.tile(made.trajectory.positions[0], (2, 1))
    zero = np.zeros_like(q)
    return Trajectory(np.array([0.0, wait]), q, zero, zero, made.trajectory.joint_names)
