"""Goal configurations: found by inverse kinematics, ranked by room, checked by the judge."""

import time

import numpy as np

from optipromp import metrics
from optipromp.arrays import FloatArray
from optipromp.optimization import kernels
from optipromp.optimization.evaluation import Evaluation
from optipromp.planning.primitives import camera_point
from optipromp.planning.setup import Setup
from optipromp.robots import ik
from optipromp.robots.roll import level

FEW_STARTS, STARTS, MORE_STARTS, MANY_STARTS = 12, 24, 48, 320  # of the inverse kinematics
ENOUGH = 6  # free configurations to choose among
SPARE = 3  # fewer free ones are reason to look for more
ROOM = 0.06  # [m] beyond which more clearance is not better
SELF_MARGIN = 0.01  # [m]
NEAREST_ERROR = 1e-6  # [m] of a goal that is followed to
NEAREST_MARGIN = 0.05  # [rad or m] that it keeps from the joint limits


def clearance(setup: Setup, q: FloatArray) -> FloatArray:
    """Room (m,) of configurations ``q`` (m, n) to static things, and of B_d to the others [m]."""
    e = Evaluation(setup.robot, setup.body, len(q), 1.0)
    e.move_to(q)
    around = setup.surroundings
    e.static.measure(e, around.static, len(around.static.kind), ROOM)
    e.dynamic.measure(e, around.dynamic, around.shared, ROOM)
    proximal = ~np.asarray(setup.body.distal)
    room = np.minimum(
        e.static.distance.min(axis=1, initial=ROOM),
        e.dynamic.distance[:, proximal].min(axis=1, initial=ROOM),
    )
    body = setup.body
    overlap = kernels.self_penalties(
        e.points,
        body.radius,
        body.groups,
        body.pairs,
        body.link_bound,
        SELF_MARGIN,
        e.force,
        e.stiffness,
    )
    apart = np.minimum(room, SELF_MARGIN - np.sqrt(overlap))
    return np.asarray(np.where(overlap > 0.0, apart, room))


def find(setup: Setup, seed: int, starts: int = STARTS) -> FloatArray:
    """Goal configurations (m, n), best first; empty where there is none.

    With :data:`MANY_STARTS`, solutions that are closer to one another are kept.
    """
    if setup.goal_joints is not None:
        return setup.goal_joints[None]
    assert setup.goal_position is not None
    solutions = ik.solve(
        setup.robot,
        setup.goal_position,
        setup.goal_axis,
        starts=starts,
        seed=seed,
        near=setup.start[None],
        rest=setup.start,
        distinct=0.1 if starts >= MANY_STARTS else 0.25,
        clearance=lambda q: clearance(setup, level(setup.robot, q, setup.scene.frame[0])),
    )
    return level(setup.robot, solutions.joints, setup.scene.frame[0])


def nearest(setup: Setup, begin: FloatArray) -> FloatArray | None:
    """The goal configuration (1, n) on the branch of ``begin`` (n,); None where it is not free.

    It is come to as the arm comes to it: along the approach, from as far before the camera point
    as that is before the lowest fruit.
    """
    if setup.goal_joints is not None:
        return None
    assert setup.goal_position is not None
    assert setup.goal_axis is not None
    robot, approach = setup.robot, setup.scene.approach
    before = camera_point(setup) - approach.camera_distance * setup.scene.frame[2]
    way, axes = np.array([before, setup.goal_position]), np.array([setup.goal_axis] * 2)
    found, errors = ik.track(robot, way, axes, begin)
    if errors.max() > NEAREST_ERROR:
        return None
    goal = level(robot, found[1:], setup.scene.frame[0])
    if np.minimum(goal - robot.lower, robot.upper - goal).min() < NEAREST_MARGIN:
        return None
    _, touching = metrics.clearances(setup.scene, robot, goal)
    return None if touching else goal


def free(setup: Setup, goals: FloatArray) -> tuple[FloatArray, str]:
    """The best goal configurations that touch nothing, and what the first other one touches."""
    best = goals[:ENOUGH]
    if len(best) and not metrics.clearances(setup.scene, setup.robot, best)[1]:
        return best, ""
    kept, blocked = [], ""
    for i, goal in enumerate(goals):
        _, touching = metrics.clearances(setup.scene, setup.robot, goal[None])
        if not touching:
            kept.append(i)
            if len(kept) == ENOUGH:
                break
        elif not blocked:
            blocked = "; ".join(map(str, touching))
    return goals[kept], blocked


def choose(
    setup: Setup,
    seed: int,
    starts: int = STARTS,
    begin: FloatArray | None = None,
    deadline: float = np.inf,
) -> tuple[FloatArray, bool, str]:
    """Goal configurations to plan to, whether they are free, and a word where they are not.

    Args:
        setup: scene and robot.
        seed: of the random starts.
        starts: how many of them.
        begin: (n,) where one configuration is enough, and is looked for from here before all.
        deadline: of ``time.perf_counter()``, from when on those that were found first must do.

    Returns:
        (m, n) configurations, at most :data:`ENOUGH` where they are free; whether they touch
        nothing; and, where none does, or none exists, why.
    """
    only = None if begin is None else nearest(setup, begin)
    if only is not None:
        return only, True, ""
    goals = find(setup, seed, starts)
    kept, blocked = free(setup, goals)
    late = len(goals) > 0 and time.perf_counter() > deadline
    if (
        len(kept) < SPARE
        and not late
        and (starts >= STARTS or not len(goals))
        and setup.goal_joints is None
    ):
        goals = find(setup, seed, MORE_STARTS)
        kept, blocked = free(setup, goals)
    if not len(goals):
        return goals, False, unreachable(setup)
    late = time.perf_counter() > deadline
    if not len(kept) and not late and setup.goal_joints is None:
        goals = find(setup, seed, MANY_STARTS)
        kept, blocked = free(setup, goals)
    if len(kept):
        return kept, True, ""
    return (
        goals[:ENOUGH],
        False,
        f"every one of {len(goals)} configurations found at the goal touches: {blocked}",
    )


def unreachable(setup: Setup) -> str:
    """Why there is no goal configuration."""
    assert setup.goal_position is not None
    away = float(np.linalg.norm(setup.goal_position))
    return (
        f"no configuration within the joint limits has the tool at "
        f"{np.round(setup.goal_position, 4).tolist()} along its axis ({away:.3g} m from the base)"
    )
