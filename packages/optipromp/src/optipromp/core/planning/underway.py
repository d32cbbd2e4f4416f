"""Plans for an arm that moves already, and plans among objects that move.

A tool that stands upright between camera point and target has begun its approach. Then the new tool
path begins at the tool point, and fruits below the tool's rim are passed. The rest of a running
plan is the first candidate of the new plan. A new trajectory starts at rest; one quintic polynomial
from the arm's state to a waypoint ahead replaces its beginning
(:func:`optipromp.core.planning.timing.joined`).

Among objects that move, the planner sees objects that stand: first the moving objects at all the
places of their curves (the swept volume), then none of them, then those at the ends of their
curves. A pushable that moves is seen where the last plan's tool passes it, until that place hardly
changes. A motion from rest waits as long as the judge, which knows where each object is at each
time, finds a contact. An arm that moves cannot wait: where no motion on from its state is valid, it
brakes and plans from rest.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import compress
from operator import itemgetter

import numpy as np

from optipromp.core.arrays import FloatArray, frozen, lengths
from optipromp.core.budget import clock
from optipromp.core.errors import Code, InvalidRequestError
from optipromp.core.optimization.problem import reach
from optipromp.core.planning.follow import Start, Waypoints, braked
from optipromp.core.planning.options import Searched
from optipromp.core.planning.parameters import FOLLOW, IN_TIME, TIMING, UNDERWAY
from optipromp.core.planning.result import Plan, Said, best_of
from optipromp.core.planning.task import Task, as_of, changed, passages, tool_motion
from optipromp.core.planning.timing import hurried, intervals, paced, slowly, stopped, tool_speeds
from optipromp.core.planning.verdict import verdict
from optipromp.core.pushing.packs import standing
from optipromp.core.pushing.parameters import PUSH
from optipromp.core.pushing.path import STEP, ToolPath, evenly, length
from optipromp.core.robots import ik
from optipromp.core.scenes.scene import PoseGoal, Scene, SceneObject
from optipromp.core.trajectory import State, Trajectory, chained

Moving = State | Sequence[FloatArray]


def begun(start_state: Moving | None, previous: Plan | None, at: float | None) -> State | None:
    """The state that a plan begins from: ``start_state``, or that of ``previous`` at ``at``."""
    if (previous is None) != (at is None):
        raise InvalidRequestError("previous and at go together: the running plan, and its time [s]")
    if previous is not None and at is not None:
        end = getattr(getattr(previous, "trajectory", None), "duration", None)
        if end is None or not isinstance(at, int | float):
            raise InvalidRequestError("previous must be a Plan, and at a time in it [s]")
        if not 0.0 <= at <= end:
            raise InvalidRequestError(f"at is {at:g} s; the running plan lasts from 0 to {end:g} s")
        if start_state is None:
            return previous.trajectory.at(at)
    if start_state is None or isinstance(start_state, State):
        return start_state
    try:
        return State(*start_state)
    except (TypeError, ValueError) as error:
        raise InvalidRequestError(
            f"start_state must be a State, or (q, velocity, acceleration): {error}"
        ) from None


def underway(task: Task, previous: Plan | None, at: float | None, unpushed: bool = False) -> Task:
    """The task of an arm that moves, at time ``at`` of ``previous`` [s]; see the module.

    ``unpushed``: the scene has each fruit where it hung before the push of ``previous``.
    """
    if not isinstance(task.goal, PoseGoal):
        return changed(task, running=running(previous, at))
    up, (point, axis) = task.scene.frame[2], task.robot.tool_pose(task.start)
    ahead = float((task.goal.position - point) @ up)
    aside = math.dist(task.goal.position - ahead * up, point)
    upright = float(axis @ task.goal.axis) > math.cos(np.deg2rad(UNDERWAY.upright))
    height = float((point - task.camera) @ up)
    if upright and height >= -UNDERWAY.before and ahead > 0.0 and aside < UNDERWAY.aside:
        depth = 0.0 if task.robot.tool is None else task.robot.tool.depth
        rim = float(point @ up) + depth
        above = [float(fruit.position @ up) + fruit.radius > rim for fruit in task.neighbours]
        left = tuple(compress(task.neighbours, above))
        passed = tuple(compress(task.neighbours, [not is_left for is_left in above]))
        task = changed(replace(task, neighbours=left), passed=passed, entry=frozen(point))
    if previous is None or at is None:
        return task
    task = changed(
        task,
        running=running(previous, at),
        kept=remaining(task, previous, at),
        same=same(task, previous),
    )
    if not (task.underway.same or unpushed):  # a scene perceived anew has pushed fruits elsewhere
        return task
    return changed(task, pushed=pushed(task, previous, at))


def running(previous: Plan | None, at: float | None) -> Trajectory | None:
    """The rest of the running trajectory, with the same curve; None where nothing is left."""
    if previous is None or at is None:
        return None
    curve = previous.trajectory
    times = np.append(at, curve.times[curve.times > at + UNDERWAY.left])
    if len(times) < 2:
        return None
    while len(times) < UNDERWAY.fewest:
        longest = int(np.argmax(np.diff(times)))
        times = np.insert(times, longest + 1, times[longest : longest + 2].mean())
    return Trajectory(times - at, *curve.sample(times), curve.joint_names)


def rest(task: Task, options: Searched) -> Iterator[Start]:
    """The running motion from the arm's state on, led to the target's present position.

    The curve stays the same where the arm is on it and the target has not moved. Otherwise a new
    curve leads through moved waypoints. It is timed anew where the tool would be too fast. There is
    no start where the tool cannot follow the moved path, or the options ask for a duration.
    """
    made, path = task.underway.running, task.underway.kept
    if made is None or options.duration is not None:
        return
    on_curve = task.state.near(State(*made.rows(0)), UNDERWAY.exact)
    if not isinstance(task.goal, PoseGoal):
        q, last = made.positions, made.n_waypoints - 1
        if on_curve and task.at_goal(q[-1]):
            yield Start(q, q, Waypoints(last + 1, last), None, made)
        return
    if path is None:
        return
    robot = task.robot
    points, _ = robot.tool_pose(made.positions)
    first = 0
    if task.underway.entry is None:
        first = int(np.argmin(np.linalg.norm(points - path.points[0], axis=1)))
    moved = task.goal.position - points[-1]
    if math.hypot(*moved) > FOLLOW.tracked or not on_curve:
        gap = (1.0 - _begun(made.times / made.duration)) * (task.start - made.positions[0])
        q = made.positions + gap
        points, axes = robot.tool_pose(q)
        gone = np.append(0.0, np.cumsum(lengths(np.diff(points[first:], axis=0))))
        wanted = points[first:] + _begun(gone / max(gone[-1], 1e-9)) * moved
        q[first:], errors = ik.each(robot, wanted, axes[first:], q[first:])
        if errors.max() > FOLLOW.tracked:
            return
        q[0], wide = task.start, np.full(len(q), True)
        wide[1] = 2.0 * made.times[1] > made.times[2] - made.times[1]  # else too short an interval
        first -= int(first > 1 and not wide[1])
        made = Trajectory.through(q[wide], made.times[wide], made.joint_names, begin=task.state)
    limit = options.approach_speed or path.speed
    q = made.positions
    slow = intervals(slowly(task, q, first), len(q)) & ~hurried(task, options, q)
    if tool_speeds(robot, made, slow, TIMING.parts).max() > limit * (1.0 + TIMING.spare):
        made = paced(task, options, q, first, path.speed)
    yield Start(q, q, Waypoints(len(q), first), path, made)


def _begun(share: FloatArray) -> FloatArray:
    """Shares (m, 1) that grow from 0 to 1 and begin gently: :func:`braked` reversed."""
    return np.asarray(1.0 - braked(1.0 - share))[:, None]


def same(task: Task, previous: Plan) -> bool:
    """Whether every pushable is where the running plan's scene has it, and stands."""
    before = {o.id: o.position for o in previous.scene.pushables}
    return all(
        o.course is None and o.id in before and math.dist(o.position, before[o.id]) < UNDERWAY.same
        for o in task.scene.pushables
    )


def pushed(task: Task, previous: Plan, at: float) -> tuple[FloatArray, FloatArray] | None:
    """Tool points and axes (P, 3) of the running plan's push so far.

    None before the approach, and where a pushable moves.
    """
    begin = float(previous.trajectory.times[previous.first])
    if task.underway.entry is None or at <= begin or task.scene.drifting:
        return None
    q, _, _ = previous.trajectory.sample(np.linspace(begin, at, UNDERWAY.rows))
    now = tool_motion(task.robot, q)
    before = previous.task.underway.pushed
    if before is None:
        return now
    points, axes = (np.concatenate(both) for both in zip(before, now, strict=True))
    return points, axes


def remaining(task: Task, previous: Plan, at: float) -> ToolPath | None:
    """The rest of a running plan's approach, moved with the target.

    None where the target, or the tool from the path, is over ``UNDERWAY.moved`` away.
    """
    assert isinstance(task.goal, PoseGoal)
    curve = previous.trajectory
    begin = max(at, float(curve.times[previous.first]))
    q, _, _ = curve.sample(np.linspace(begin, curve.duration, UNDERWAY.rows))
    points, _ = task.robot.tool_pose(q)
    moved = task.goal.position - points[-1]
    gap = np.zeros(3) if task.underway.entry is None else task.underway.entry - points[0]
    if max(math.hypot(*moved), math.hypot(*gap)) > UNDERWAY.moved:
        return None
    share = np.linspace(0.0, 1.0, len(points))[:, None]
    points = points + share * moved + (1.0 - share) * gap
    points = evenly(points, max(2, math.ceil(length(points) / STEP) + 1))
    packs = standing.applies(task.scene, task.robot.tool)
    return ToolPath(frozen(points), PUSH.standing.speed if packs else PUSH.hanging.speed)


def straight(task: Task) -> ToolPath:
    """The straight tool path from the camera point (on the approach: the tool) to the target."""
    assert isinstance(task.goal, PoseGoal)
    ends = np.array([task.camera, task.goal.position])
    points = evenly(ends, max(2, math.ceil(length(ends) / STEP) + 1))
    return ToolPath(frozen(points), PUSH.hanging.speed)


JUDGED = Code.SUCCESS, Code.INVALID_PLAN, Code.HARM_PREDICTED  # statuses that the judge gives anew


def later(scene: Scene, time: float) -> Scene:
    """The scene for one to whom ``time`` [s] is time 0: objects are where they are by then."""
    motions = {item.id: course.later(time) for item, course in scene.movers}
    if not motions:
        return scene
    there = scene.standing(dict.fromkeys(motions, time))
    return there.each(lambda item: replace(item, motion=motions.get(item.id, item.motion)))


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
        return replace(best, said=Said("", best.said, f"; the arm brakes too late: {met[0]}"))
    made = _in(task, _among(_stood(task, brake), made_for, late), brake)
    if made.success:
        note = f"the arm brakes first, {brake.duration:.2f} s; without, {best.message}"
        return replace(made, said=Said("", made.said, more=(note,)))
    return replace(best, said=Said("", best.said, f"; with a brake first, {made.message}"))


def _among(task: Task, made_for: Callable[[Task], Plan], late: float) -> Plan:
    """:func:`plan_in_time` without a brake."""
    ended = task.scene.standing({item.id: np.inf for item, _ in task.scene.movers})
    scenes = [_swept(task), ended]
    if len(task.scene.movers) > len(task.scene.drifting):
        scenes.insert(1, replace(task.scene, objects=_standing(task.scene)))
    longest = 0.0 if task.state.moving else IN_TIME.longest  # an arm that moves cannot wait
    waits = np.arange(0.0, longest + 1e-9, IN_TIME.wait).tolist()  # at the start [s]
    cut = False

    def judged() -> Iterator[tuple[tuple[bool, bool, bool], Plan]]:
        """Plans and their ranks: room, success, and success where nothing moves."""
        nonlocal cut
        for scene in scenes:
            seen, when = replace(task, scene=scene), dict.fromkeys(scene.drifting, IN_TIME.met)
            for _ in range(IN_TIME.rounds if when else 1):
                made = made_for(as_of(seen, when))
                for wait in waits:
                    q, names = made.trajectory.positions[0], made.trajectory.joint_names
                    stay = Trajectory.still(q, (0.0, wait), names) if wait else None
                    one = _in(task, made, stay)
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
        said = Said("time ran out; the best so far: ", best[1].said)
        return replace(best[1], status=Code.TIMEOUT, said=said)
    return best[1]


def _near(scene: Scene, when: Mapping[str, float], other: Mapping[str, float]) -> bool:
    """Whether pushables are at the same places at two times each [s], by id."""
    places = (scene.drifting[k].at(np.array([t, other[k]])) for k, t in when.items())
    return all(math.dist(*two) < IN_TIME.same for two in places)


def _stood(task: Task, brake: Trajectory) -> Task:
    """The task of the arm that has braked: nothing runs, and objects are where they are by then."""
    rest = State(brake.positions[-1])
    entry = None if task.underway.entry is None else frozen(task.robot.tool_pose(rest.q)[0])
    task = replace(task, scene=later(task.scene, brake.duration), state=rest)
    return changed(task, entry=entry, running=None, kept=None, same=False)


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


def _in(task: Task, made: Plan, before: Trajectory | None) -> Plan:
    """A plan, judged among the objects that move, after the motion ``before`` it; None: none."""
    curves, first = [made.trajectory, made.initial, made.followed], made.first
    if before is not None:
        curves = [chained([before, curve]) for curve in curves]
        first += before.n_waypoints - 1
    trajectory, initial, followed = curves
    if made.task.scene.approach is not task.scene.approach:  # another was chosen
        scene = task.scene.approached(made.task.scene.approach)
        task = replace(task, scene=scene, goal=made.task.goal)
    judged = verdict(task, trajectory)
    mine = judged.status is Code.SUCCESS or made.status in JUDGED
    return replace(
        made, task=task, trajectory=trajectory, initial=initial, followed=followed, first=first,
        status=judged.status if mine else made.status, said=Said("", judged) if mine else made.said,
        judgement=judged.judgement, prediction=judged.prediction,
    )  # fmt: skip
