"""Goal configurations: found by inverse kinematics, ranked by room, checked by the judge."""

import time

import numpy as np

from optipromp import judging
from optipromp.arrays import FloatArray
from optipromp.optimization.costs.obstacles import self_overlap
from optipromp.optimization.evaluation import Evaluation
from optipromp.planning.task import Task
from optipromp.robots import ik
from optipromp.robots.roll import level
from optipromp.scenes.scene import JointGoal, PoseGoal

FEW_STARTS, STARTS, MORE_STARTS, MANY_STARTS = 12, 24, 48, 320  # of the inverse kinematics
ENOUGH = 6  # free configurations to choose among
SPARE = 3  # fewer free ones are reason to look for more
ROOM = 0.06  # [m] beyond which more clearance is not better
SELF_MARGIN = 0.01  # [m]
NEAREST_ERROR = 1e-6  # [m] of a goal that is followed to
NEAREST_MARGIN = 0.05  # [rad or m] that it keeps from the joint limits


def clearance(task: Task, q: FloatArray) -> FloatArray:
    """Room (m,) of configurations ``q`` (m, n) to static things, and of B_d to the others [m]."""
    e = Evaluation(task.robot, task.body, len(q), 1.0)
    e.move_to(q)
    around = task.surroundings
    e.static.measure(e, around.static, len(around.static.kind), ROOM)
    e.dynamic.measure(e, around.dynamic, around.shared, ROOM)
    proximal = ~np.asarray(task.body.distal)
    room = np.minimum(
        e.static.distance.min(axis=1, initial=ROOM),
        e.dynamic.distance[:, proximal].min(axis=1, initial=ROOM),
    )
    overlap = 2.0 * self_overlap(e, SELF_MARGIN)
    apart = np.minimum(room, SELF_MARGIN - np.sqrt(overlap))
    return np.asarray(np.where(overlap > 0.0, apart, room))


def find(task: Task, seed: int, starts: int = STARTS) -> FloatArray:
    """Goal configurations (m, n), best first; empty where there is none.

    With :data:`MANY_STARTS`, solutions that are closer to one another are kept.
    """
    if isinstance(task.goal, JointGoal):
        return task.goal.joints[None]
    solutions = ik.solve(
        task.robot,
        task.goal.position,
        task.goal.axis,
        starts=starts,
        seed=seed,
        near=task.start[None],
        rest=task.start,
        distinct=0.1 if starts >= MANY_STARTS else 0.25,
        clearance=lambda q: clearance(task, level(task.robot, q, task.scene.frame[0])),
    )
    return level(task.robot, solutions.joints, task.scene.frame[0])


def nearest(task: Task, begin: FloatArray) -> FloatArray | None:
    """The goal configuration (1, n) on the branch of ``begin`` (n,); None where it is not free.

    It is come to as the arm comes to it: along the approach, from as far before the camera point
    as that is before the lowest fruit.
    """
    if isinstance(task.goal, JointGoal):
        return None
    robot, approach = task.robot, task.scene.approach
    before = task.camera - approach.camera_distance * task.scene.frame[2]
    way, axes = np.array([before, task.goal.position]), np.array([task.goal.axis] * 2)
    found, errors = ik.track(robot, way, axes, begin)
    if errors.max() > NEAREST_ERROR:
        return None
    goal = level(robot, found[1:], task.scene.frame[0])
    if np.minimum(goal - robot.lower, robot.upper - goal).min() < NEAREST_MARGIN:
        return None
    _, touching = judging.clearances(task.scene, robot, goal)
    return None if touching else goal


def free(task: Task, goals: FloatArray) -> tuple[FloatArray, str]:
    """The best goal configurations that touch nothing, and what the first other one touches."""
    best = goals[:ENOUGH]
    if len(best) and not judging.clearances(task.scene, task.robot, best)[1]:
        return best, ""
    kept, blocked = [], ""
    for i, goal in enumerate(goals):
        _, touching = judging.clearances(task.scene, task.robot, goal[None])
        if not touching:
            kept.append(i)
            if len(kept) == ENOUGH:
                break
        elif not blocked:
            blocked = "; ".join(map(str, touching))
    return goals[kept], blocked


def choose(
    task: Task,
    seed: int,
    starts: int = STARTS,
    begin: FloatArray | None = None,
    deadline: float = np.inf,
) -> tuple[FloatArray, bool, str]:
    """Goal configurations to plan to, whether they are free, and a word where they are not.

    Args:
        task: scene and robot.
        seed: of the random starts.
        starts: how many of them.
        begin: (n,) where one configuration is enough, and is looked for from here before all.
        deadline: of ``time.perf_counter()``, from when on those that were found first must do.

    Returns:
        (m, n) configurations, at most :data:`ENOUGH` where they are free; whether they touch
        nothing; and, where none does, or none exists, why.
    """
    only = None if begin is None else nearest(task, begin)
    if only is not None:
        return only, True, ""
    goals = find(task, seed, starts)
    kept, blocked = free(task, goals)
    late = len(goals) > 0 and time.perf_counter() > deadline
    if (
        len(kept) < SPARE
        and not late
        and (starts >= STARTS or not len(goals))
        and isinstance(task.goal, PoseGoal)
    ):
        goals = find(task, seed, MORE_STARTS)
        kept, blocked = free(task, goals)
    if not len(goals):
        return goals, False, unreachable(task)
    late = time.perf_counter() > deadline
    if not len(kept) and not late and isinstance(task.goal, PoseGoal):
        goals = find(task, seed, MANY_STARTS)
        kept, blocked = free(task, goals)
    if len(kept):
        return kept, True, ""
    return (
        goals[:ENOUGH],
        False,
        f"every one of {len(goals)} configurations found at the goal touches: {blocked}",
    )


def unreachable(task: Task) -> str:
    """Why there is no goal configuration."""
    assert isinstance(task.goal, PoseGoal)
    away = float(np.linalg.norm(task.goal.position))
    return (
        f"no configuration within the joint limits has the tool at "
        f"{np.round(task.goal.position, 4).tolist()} along its axis ({away:.3g} m from the base)"
    )
