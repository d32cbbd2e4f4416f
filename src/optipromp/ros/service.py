"""Planning requests of MoveIt and their answers: the node of ROS 2, but for ROS.

:class:`optipromp.ros.LiveScene` holds the scene as the topics state it; :func:`answer` plans in it.
"""

import math
from dataclasses import dataclass, replace
from pathlib import Path

from optipromp.core.errors import Code, InvalidRequestError, OptiPrompError
from optipromp.core.planning import Plan, PlanOptions, plan
from optipromp.core.planning.planner import factory
from optipromp.core.promp.model import ProMP
from optipromp.core.robots.library import load_arm
from optipromp.ros.live import LiveScene, read_goal
from optipromp.ros.trajectories import (
    display_trajectory,
    joint_motion,
    joint_trajectory,
    robot_state,
    robot_trajectory,
)
from optipromp.ros.types import Message, constants, message

RESPONSE = "moveit_msgs/msg/MotionPlanResponse"
ERROR_CODES = "moveit_msgs/msg/MoveItErrorCodes"
MOVEIT: dict[Code, str] = {
    Code.SUCCESS: "SUCCESS",
    Code.INVALID_ROBOT: "INVALID_ROBOT_STATE",
    Code.INVALID_SCENE: "INVALID_OBJECT_NAME",
    Code.INVALID_REQUEST: "INVALID_GOAL_CONSTRAINTS",
    Code.START_INVALID: "START_STATE_INVALID",
    Code.START_IN_COLLISION: "START_STATE_IN_COLLISION",
    Code.GOAL_IN_COLLISION: "GOAL_IN_COLLISION",
    Code.GOAL_UNREACHABLE: "NO_IK_SOLUTION",
    Code.NO_PLAN: "PLANNING_FAILED",
    Code.INVALID_PLAN: "INVALID_MOTION_PLAN",
    Code.HARM_PREDICTED: "INVALID_MOTION_PLAN",
    Code.TIMEOUT: "TIMED_OUT",
    Code.EXECUTION_FAILED: "CONTROL_FAILED",
}
"""MoveIt's name of each code; any other code is a FAILURE."""


@dataclass(frozen=True, eq=False)
class PlanAnswer:
    """The answer to a request.

    Attributes:
        response: ``moveit_msgs/MotionPlanResponse``, with a trajectory only of a success.
        trajectory: ``trajectory_msgs/JointTrajectory`` for a controller; None: no success.
        display: ``moveit_msgs/DisplayTrajectory``, also of a plan that failed; None: the request
            was refused.
        plan: None: the request was refused.
    """

    response: Message
    trajectory: Message | None = None
    display: Message | None = None
    plan: Plan | None = None


def answer(
    world: LiveScene,
    request: Message,
    options: PlanOptions | None = None,
    *,
    demonstrations: ProMP | str | Path | None = None,
    rate: float | None = None,
    prefix: str = "",
) -> PlanAnswer:
    """Plan the motion of a ``moveit_msgs/MotionPlanRequest``.

    Read are ``start_state`` (where it names joints; with velocities the plan begins in motion),
    ``goal_constraints`` (none: the target of the world), ``planner_id`` (empty: opti-promp),
    ``allowed_planning_time``, and the scaling factors of velocity and acceleration (0: 1). A
    ``group_name`` must be one of this arm, where an SRDF states its groups. Workspace, number of
    attempts and pipeline are ignored. Path and trajectory constraints, reference trajectories and a
    Cartesian speed are refused.

    Args:
        world: the scene so far.
        request: the message.
        options: of the plan; the request's planning time replaces its timeout.
        demonstrations: as for :func:`optipromp.plan`.
        rate: of the points of the answer [Hz]; None: the rows of the plan.
        prefix: of joint and link names in ROS.

    Returns:
        The answer; to a request that cannot be used, the code and the message of the error.
    """
    try:
        _refuse_unread(request)
        _refuse_another_arm(request.group_name, world)
        joints, state = request.start_state.joint_state, None
        if joints.name:
            state = joint_motion(joints, world.joints, "start_state.joint_state")
        slowing = _slowing(request)
        options = options or PlanOptions()
        if request.allowed_planning_time > 0.0:
            options = replace(options, timeout=float(request.allowed_planning_time))
        if state is not None:
            world = world.at(state.q)
            if state.moving and slowing != 1.0:
                raise InvalidRequestError(
                    "start_state moves and a scaling factor is below 1: one of them must go; a "
                    "motion that runs cannot be slowed at once"
                )
        scene = world.scene(read_goal(request.goal_constraints, world, prefix))
        planner = request.planner_id or "opti-promp"
        factory(planner, "planner_id")  # refuses an unknown name
        made = plan(
            scene,
            planner=planner,
            demonstrations=demonstrations,
            options=options,
            start_state=state if state is not None and state.moving else None,
        )
    except OptiPrompError as error:
        return PlanAnswer(_response(request, error.code, error.message))
    motion = made.trajectory.slowed(slowing)
    start = robot_state(motion.at(0.0), motion.joint_names, prefix)
    done = {"trajectory_start": start, "planning_time": made.time["total"]}
    if made.success:
        done["trajectory"] = robot_trajectory(motion, rate, prefix)
    return PlanAnswer(
        response=_response(request, made.status, made.message, **done),
        trajectory=joint_trajectory(motion, rate, prefix) if made.success else None,
        display=display_trajectory([motion], made.robot.name, rate, prefix),
        plan=made,
    )


def _refuse_another_arm(group: str, world: LiveScene) -> None:
    """Refuse a group whose joints are not the arm's, or that the arm's SRDF does not have."""
    scene = world.scene()
    _, arm = load_arm(scene.robot, scene.base_dir, scene.choice)
    if not group or not arm.groups or set(arm.groups.get(group, ())) == set(arm.joints):
        return
    mine = [name for name, joints in arm.groups.items() if set(joints) == set(arm.joints)]
    raise InvalidRequestError(
        f"group_name is {group!r}: this node plans for {', '.join(mine) or arm.why} "
        f"({arm.joints[0]} to {arm.joints[-1]}); leave it empty, or ask the node of that arm"
    )


def _response(request: Message, code: Code, words: str, **fields: Message) -> Message:
    values = constants(ERROR_CODES)
    error = message(
        ERROR_CODES,
        val=values[MOVEIT.get(code, "FAILURE")],
        message=f"{code}: {words}" if words else str(code),
        source="optipromp",
    )
    return message(RESPONSE, group_name=request.group_name, error_code=error, **fields)


def _slowing(request: Message) -> float:
    """The factor by which the scaling factors of the request slow the motion."""
    factors = []
    for field in ("max_velocity_scaling_factor", "max_acceleration_scaling_factor"):
        value = float(getattr(request, field)) or 1.0
        if not 0.0 < value <= 1.0:
            raise InvalidRequestError(f"{field} is {value:g}: must be above 0 and at most 1, or 0")
        factors.append(value)
    return max(1.0 / factors[0], 1.0 / math.sqrt(factors[1]))


def _refuse_unread(request: Message) -> None:
    """Refuse constraints that the planner does not keep."""
    path = request.path_constraints
    kinds = ("joint", "position", "orientation", "visibility")
    asked = [
        f"path_constraints.{k}_constraints" for k in kinds if getattr(path, f"{k}_constraints")
    ]
    if request.trajectory_constraints.constraints:
        asked.append("trajectory_constraints")
    if request.reference_trajectories:
        asked.append("reference_trajectories")
    if request.max_cartesian_speed > 0.0:
        asked.append("max_cartesian_speed")
    if request.start_state.attached_collision_objects:
        asked.append("start_state.attached_collision_objects")
    if asked:
        raise InvalidRequestError(f"{', '.join(asked)}: must be empty; the planner keeps none")
