"""Goals as the planners take them: poses in a region, joints a full turn away, what is reached."""

import math
from collections.abc import Iterator

import numpy as np

from optipromp.core.arrays import FloatArray, rotation
from optipromp.core.errors import InvalidRequestError
from optipromp.core.planning.parameters import GOAL
from optipromp.core.robots import ik
from optipromp.core.robots.model import Robot
from optipromp.core.scenes.goals import ANGLE, WITHIN, Goal, JointGoal, PoseGoal, RegionGoal

LIMIT_TOLERANCE = 1e-9  # [rad or m] a joint this little beyond its limit is within it: rounding


def goals_of(goals: tuple[Goal, ...], robot: Robot, start: FloatArray) -> tuple[Goal, ...]:
    """The goals of a scene for an arm at ``start`` (n,).

    A joint that may turn without end goes to the nearest of its equal values.
    """
    return tuple(
        _turned(goal, robot, start) if isinstance(goal, JointGoal) else goal for goal in goals
    )


def _turned(goal: JointGoal, robot: Robot, start: FloatArray) -> JointGoal:
    joints = robot.check_configuration(goal.joints)
    within_limits(robot, joints, "goal", InvalidRequestError)
    turns = np.where(ik.turning(robot), np.round((joints - start) / (2.0 * np.pi)), 0.0)
    return JointGoal(joints - 2.0 * np.pi * turns) if turns.any() else goal


def within_limits(robot: Robot, q: FloatArray, what: str, error: type) -> None:
    """Refuse a configuration (n,) outside the joint limits; ``what`` begins the ``error``."""
    over = np.maximum(robot.lower - q, q - robot.upper)
    worst = int(np.argmax(over))
    if over[worst] > LIMIT_TOLERANCE:
        degrees = " (degrees? radians are needed)" if abs(q[worst]) > 4.0 * np.pi else ""
        raise error(
            f"{what}: {robot.joint_names[worst]} is {q[worst]:.4f}, outside its limits "
            f"[{robot.lower[worst]:.4f}, {robot.upper[worst]:.4f}]{degrees}"
        )


def at_goal(robot: Robot, goal: Goal, q: FloatArray) -> bool:
    """Whether configuration ``q`` (n,) is at a goal, within its tolerances."""
    if isinstance(goal, JointGoal):
        off = q - goal.joints
        turns = np.where(ik.turning(robot), np.round(off / (2.0 * np.pi)), 0.0)
        return bool(np.max(np.abs(off - 2.0 * np.pi * turns)) < WITHIN)
    point, axis = robot.tool_pose(q)
    if isinstance(goal, PoseGoal):
        near = np.linalg.norm(point - goal.position) < WITHIN
        return bool(near and axis @ goal.axis > math.cos(math.radians(ANGLE)))
    off, box = point - goal.position, goal.extents
    inside = math.hypot(*off) < goal.radius
    if box is not None:
        inside = bool((np.abs(off @ box[1]) < box[0]).all())
    if goal.rotation is not None:
        turn = robot.segment_frames(q)[1][-1] @ robot.tool_rotation
        cosine = 0.5 * (float(np.sum(turn * goal.rotation)) - 1.0)
    else:
        cosine = 1.0 if goal.axis is None else float(axis @ goal.axis)
    return inside and cosine > math.cos(goal.tilt)


def reached(robot: Robot, goals: tuple[Goal, ...], q: FloatArray) -> int | None:
    """The index of the first goal that configuration ``q`` (n,) is at; None: it is at none."""
    return next((k for k, goal in enumerate(goals) if at_goal(robot, goal, q)), None)


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
