"""Goal configurations: found by inverse kinematics, ranked by clearance, checked for contacts."""

import math
from collections.abc import Iterator

import numpy as np

from optipromp.core import judging
from optipromp.core.arrays import FloatArray, rotation
from optipromp.core.budget import Budget
from optipromp.core.optimization.costs.obstacles import self_overlap
from optipromp.core.optimization.evaluation import Evaluation
from optipromp.core.planning import collision
from optipromp.core.planning.parameters import GOAL
from optipromp.core.planning.task import Task
from optipromp.core.robots import ik
from optipromp.core.robots.ik import level, rolled
from optipromp.core.scenes.scene import JointGoal, PoseGoal, RegionGoal


def clearance(task: Task, q: FloatArray) -> FloatArray:
    """Clearance (m,) of configurations ``q`` (m, n) [m], at most ``GOAL.room``.

    It is the smallest distance of the body to static objects, of B_d to the other objects, and
    between links.
    """
    e = Evaluation(task.robot, task.body, len(q), 1.0)
    e.move_to(q)
    task.surroundings.measure(e, GOAL.room)
    proximal = ~np.asarray(task.body.distal)
    room = np.minimum(
        e.static.distance.min(axis=1, initial=GOAL.room),
        e.dynamic.distance[:, proximal].min(axis=1, initial=GOAL.room),
    )
    overlap = 2.0 * self_overlap(e, GOAL.self_margin)
    apart = np.minimum(room, GOAL.self_margin - np.sqrt(overlap))
    return np.asarray(np.where(overlap > 0.0, apart, room))


def find(task: Task, seed: int, starts: int = GOAL.starts) -> FloatArray:
    """Goal configurations (m, n), best first.

    Two configurations differ in a joint by at least ``GOAL.distinct``; with ``GOAL.many_starts``
    starts, by at least ``GOAL.distinct_many``.
    """
    if isinstance(task.goal, JointGoal):
        return task.goal.joints[None]
    if isinstance(task.goal, RegionGoal):
        found = [_solved(task, *pose, seed, starts) for pose in poses(task.goal, seed)]
        margin, room = (
            np.concatenate([getattr(one, key) for one in found]) for key in ("margin", "clearance")
        )
        order = np.argsort(-np.minimum(margin / ik.WIDE, room / ik.ROOMY), kind="stable")
        return _rolled_level(task, np.concatenate([one.joints for one in found])[order])
    solved = _solved(task, task.goal.position, task.goal.axis, seed, starts)
    return _rolled_level(task, solved.joints)


def _rolled_level(task: Task, q: FloatArray) -> FloatArray:
    """Configurations with the hand level, unless the goal tells its roll."""
    if isinstance(task.goal, RegionGoal) and task.goal.orientation is not None:
        return q
    return level(task.robot, q, task.scene.frame[0])


def _solved(
    task: Task, position: FloatArray, axis: FloatArray | None, seed: int, starts: int
) -> ik.Solutions:
    """Configurations at a pose; see :func:`optipromp.core.robots.ik.solve`."""
    return ik.solve(
        task.robot,
        position,
        axis,
        starts=starts,
        seed=seed,
        near=task.start[None],
        rest=task.start,
        distinct=GOAL.distinct_many if starts >= GOAL.many_starts else GOAL.distinct,
        clearance=lambda q: clearance(task, _rolled_level(task, q)),
    )


def nearest(task: Task, begin: FloatArray) -> FloatArray | None:
    """The goal configuration (1, n) on the branch of ``begin`` (n,); None where it is not free.

    Inverse kinematics follows the approach line to the goal. The line begins before the camera
    point, by the distance of the camera point to the lowest fruit.
    """
    if not isinstance(task.goal, PoseGoal):
        return None
    robot, approach = task.robot, task.scene.approach
    before = task.camera - approach.camera_distance * task.scene.frame[2]
    line, axes = np.array([before, task.goal.position]), np.array([task.goal.axis] * 2)
    found, errors = ik.track(robot, line, axes, begin)
    if errors.max() > GOAL.nearest_error:
        return None
    goal = level(robot, found[1:], task.scene.frame[0])
    if np.minimum(goal - robot.lower, robot.upper - goal).min() < GOAL.nearest_margin:
        return None
    return goal if len(collision.free(task, goal)) else None


def free(task: Task, goals: FloatArray) -> tuple[FloatArray, str]:
    """The best goal configurations that touch nothing, and else the contacts of the first goal.

    The judge decides where no goal is free to the planner: a goal beside a mesh or a point cloud
    may touch the distance grid and not the object.
    """
    clear = collision.free(task, goals, GOAL.enough)
    if len(clear):
        return clear, ""
    contacts = [judging.clearances(task.scene, task.robot, goal[None])[1] for goal in goals]
    sure = [i for i, touching in enumerate(contacts) if not touching]
    blocked = next((touching for touching in contacts if touching), [])
    return goals[sure[: GOAL.enough]], "; ".join(map(str, blocked))


def choose(
    task: Task,
    seed: int,
    starts: int = GOAL.starts,
    begin: FloatArray | None = None,
    budget: Budget | None = None,
) -> tuple[FloatArray, str]:
    """Goal configurations to plan to.

    ``seed``: of the random starts of inverse kinematics. ``starts``: their number at first; more
    are tried where too few goals are free, while the ``budget`` lasts. ``begin``: (n,) a
    configuration; a free goal configuration on its branch is the only one.

    Returns: Configurations (m, n), at most ``GOAL.enough`` where they are free; and the reason
    where all of them touch an object or none exists, else empty.
    """
    branch = None if begin is None else nearest(task, begin)
    if branch is not None:
        return branch, ""
    goals = find(task, seed, starts)
    clear, blocked = free(task, goals)
    budget = Budget() if budget is None else budget
    if (
        len(clear) < GOAL.spare
        and (starts >= GOAL.starts or not len(goals))
        and not isinstance(task.goal, JointGoal)
        and not (len(goals) and budget.spent())
    ):
        goals = find(task, seed, GOAL.more_starts)
        clear, blocked = free(task, goals)
    if not len(goals):
        assert not isinstance(task.goal, JointGoal)
        at, how = task.goal.position, " along its axis"
        if isinstance(task.goal, RegionGoal) and task.goal.axis is None:
            how = "" if task.goal.orientation is None else " in its orientation"
        return goals, (
            f"no configuration within the joint limits has the tool at {np.round(at, 4).tolist()}"
            f"{how} ({np.linalg.norm(at):.3g} m from the base)"
        )
    if not len(clear) and not isinstance(task.goal, JointGoal) and not budget.spent():
        goals = find(task, seed, GOAL.many_starts)
        clear, blocked = free(task, goals)
        if not len(clear) and not task.scene.pushables:  # a tool that pushes is not rolled
            turned = rolled(task.robot, goals)
            order = np.argsort(-clearance(task, turned), kind="stable")
            clear, _ = free(task, turned[order[: GOAL.many_starts]])
    if len(clear):
        return clear, ""
    told = f"every one of {len(goals)} configurations found at the goal touches: {blocked}"
    return goals[: GOAL.enough], told


def poses(goal: RegionGoal, seed: int) -> Iterator[tuple[FloatArray, FloatArray | None]]:
    """Poses in a region: its middle first, then ``GOAL.poses`` of a uniform distribution.

    Each is a tool point (3,) and what :func:`optipromp.core.robots.ik.solve` takes for its axis.
    There is the middle alone where the goal has no tolerances.
    """
    frame = goal.rotation
    yield goal.position, _axes(goal, np.eye(3))
    if goal.within is None and goal.angle is None:
        return
    rng = np.random.default_rng(seed)
    for _ in range(GOAL.poses):
        off, box = rng.uniform(-1.0, 1.0, 3), goal.extents
        if goal.within is None:
            off = np.zeros(3)
        elif box is not None:
            off = box[1] @ (box[0] * off)
        else:
            off *= goal.radius * rng.random() ** (1.0 / 3.0) / math.hypot(*off)
        about = rng.standard_normal(3)
        if frame is None and goal.axis is not None:  # the roll about the axis is free
            about -= (about @ goal.axis) * goal.axis
        tilt = 0.0 if goal.angle is None else goal.tilt * rng.random()
        turn = rotation(about / math.hypot(*about), GOAL.inside * tilt)
        yield goal.position + GOAL.inside * off, _axes(goal, turn)


def _axes(goal: RegionGoal, turn: FloatArray) -> FloatArray | None:
    """Tool axis (3,), or z and y of the tool's frame (2, 3), turned; None: free."""
    if goal.rotation is not None:
        return np.asarray((turn @ goal.rotation).T[[2, 1]])
    return None if goal.axis is None else np.asarray(turn @ goal.axis)
