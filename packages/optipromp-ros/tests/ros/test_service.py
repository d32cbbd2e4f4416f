"""Requests of MoveIt and their answers, from recorded messages to recorded messages."""

from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from tests.robots.arms import TWO, robot
from tests.robots.groups import along, groups

from optipromp import judge, plan
from optipromp.core import judging
from optipromp.core.errors import Code
from optipromp.core.planning.task import resolve
from optipromp.core.robots.library import Choice
from optipromp.core.scenes import JointGoal, Pose, PoseGoal, RegionGoal, Scene, load_scene
from optipromp_ros import (
    LiveScene,
    Recorded,
    answer,
    message,
    planning_scene,
    read_bag,
    read_trajectories,
    write_bag,
)
from optipromp_ros.live import read_goal
from optipromp_ros.loop import MOVEIT
from optipromp_ros.scenes import pose_message
from optipromp_ros.types import constants

SCENE = load_scene("scenario-3")
ROBOT = resolve(SCENE).robot
CODES = constants("moveit_msgs/msg/MoveItErrorCodes")
PREFIX = "fr3_"


def request(**fields):
    return message("moveit_msgs/msg/MotionPlanRequest", **fields)


def joint_state(q, names=ROBOT.joint_names):
    return message("sensor_msgs/msg/JointState", name=names, position=q)


def test_a_recorded_session_is_answered(tmp_path: Path) -> None:
    """What the topics said, and the request, from a bag; the answers to another."""
    start = SCENE.start + 0.01
    names = [PREFIX + name for name in reversed(ROBOT.joint_names)]
    write_bag(
        tmp_path / "session",
        [
            Recorded("/planning_scene", planning_scene(SCENE, PREFIX), 1),
            Recorded("/joint_states", joint_state(start[::-1], names), 2),
            Recorded("/request", request(group_name="arm"), 3),
        ],
    )
    # the world begins with another scene of the same robot and tool
    world, answers = LiveScene.of(load_scene("scenario-4"), PREFIX), []
    for item in read_bag(tmp_path / "session"):
        if item.topic == "/request":
            answers.append(answer(world, item.message, rate=100.0, prefix=PREFIX))
        else:
            world = world.heard(item.message)
    (found,) = answers
    assert found.response.error_code.val == CODES["SUCCESS"]
    assert found.plan.scene.name == SCENE.name
    write_bag(
        tmp_path / "answers.mcap",
        [
            Recorded("/response", found.response),
            Recorded("/trajectory", found.trajectory),
            Recorded("/display_planned_path", found.display),
        ],
    )
    with (tmp_path / "answers.mcap").open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        seen = {c.topic: item for _, c, _, item in reader.iter_decoded_messages()}
    response = seen["/response"]
    assert response.group_name == "arm"
    assert response.planning_time == pytest.approx(found.plan.time["total"])
    wanted = found.plan.trajectory.resample(100.0)
    for item in (
        response.trajectory.joint_trajectory,
        seen["/trajectory"],
        seen["/display_planned_path"].trajectory[0].joint_trajectory,
    ):
        assert list(item.joint_names) == [PREFIX + name for name in ROBOT.joint_names]
        points = np.array([list(point.positions) for point in item.points])
        np.testing.assert_allclose(points, wanted.positions, atol=1e-9)
    np.testing.assert_allclose(points[0], start, atol=1e-9)
    (back,) = read_trajectories(found.trajectory, ROBOT.joint_names)
    assert judge(found.plan.scene, back).status == Code.SUCCESS


def test_the_answer_is_the_plan_of_the_scene() -> None:
    found = answer(LiveScene.of(SCENE), request())
    (back,) = read_trajectories(found.trajectory, ROBOT.joint_names)
    assert np.array_equal(back.positions, plan(SCENE).trajectory.positions)


def test_the_start_of_the_request_comes_before_that_of_the_topics() -> None:
    start = SCENE.start + 0.02
    state = message("moveit_msgs/msg/RobotState", joint_state=joint_state(start))
    found = answer(LiveScene.of(SCENE), request(start_state=state))
    assert found.trajectory.points[0].positions.tolist() == start.tolist()
    assert found.response.trajectory_start.joint_state.position.tolist() == start.tolist()


def test_a_start_that_moves_is_joined_without_a_jump() -> None:
    running = plan(SCENE).trajectory
    now = running.at(0.3 * running.duration)
    state = joint_state(now.q)
    state.velocity = np.array(now.velocity)
    begin = message("moveit_msgs/msg/RobotState", joint_state=state)
    found = answer(LiveScene.of(SCENE), request(start_state=begin))
    assert found.response.error_code.val == CODES["SUCCESS"], found.response.error_code.message
    first = found.trajectory.points[0]
    np.testing.assert_allclose(first.positions, now.q, atol=1e-9)
    np.testing.assert_allclose(first.velocities, now.velocity, atol=1e-9)
    start = found.response.trajectory_start.joint_state
    np.testing.assert_allclose(start.velocity, now.velocity, atol=1e-9)


def test_a_start_whose_velocities_are_noise_is_at_rest() -> None:
    state = joint_state(SCENE.start)
    state.velocity = np.full(7, 0.004)
    begin = message("moveit_msgs/msg/RobotState", joint_state=state)
    found = answer(LiveScene.of(SCENE), request(start_state=begin))
    assert not found.trajectory.points[0].velocities.any()
    state.velocity = np.zeros(3)
    refused = answer(LiveScene.of(SCENE), request(start_state=begin)).response.error_code
    assert "3 velocities for 7 names: must be as many, or none" in refused.message


@pytest.mark.parametrize(
    ("velocity", "acceleration"), [(0.5, 0.0), (0.5, 0.0625), (0.0, 0.25), (1.0, 1.0)]
)
def test_scaling_factors_are_shares_of_the_limits(velocity: float, acceleration: float) -> None:
    asked = request(
        max_velocity_scaling_factor=velocity, max_acceleration_scaling_factor=acceleration
    )
    found = answer(LiveScene.of(SCENE), asked)
    assert found.response.error_code.val == CODES["SUCCESS"], found.response.error_code.message
    (motion,) = read_trajectories(found.trajectory)
    assert motion.duration == pytest.approx(found.plan.trajectory.duration)
    used = judging.extremes(motion).largest
    assert (used[0] <= (velocity or 1.0) * (1 + 1e-6) * ROBOT.velocity).all()
    assert (used[1] <= (acceleration or 1.0) * (1 + 1e-6) * ROBOT.acceleration).all()
    assert (used[2] <= (acceleration or 1.0) * (1 + 1e-6) * ROBOT.jerk).all()


def joint_goal(q, names=ROBOT.joint_names):
    constraints = [
        message("moveit_msgs/msg/JointConstraint", joint_name=name, position=value)
        for name, value in zip(names, q, strict=True)
    ]
    return message("moveit_msgs/msg/Constraints", joint_constraints=constraints)


def test_a_goal_in_joints_leaves_the_target_to_be_avoided() -> None:
    goal = SCENE.start + np.array([0.2, 0.1, 0, 0, 0, 0, 0])
    found = answer(LiveScene.of(SCENE), request(goal_constraints=[joint_goal(goal)]))
    assert found.response.error_code.val == CODES["SUCCESS"]
    np.testing.assert_allclose(found.trajectory.points[-1].positions, goal, atol=1e-3)
    assert SCENE.target.id in {item.id for item in found.plan.scene.avoid}


def pose_goal(position, rotation, link: str, offset=(0.0, 0.0, 0.0), frame: str = ""):
    header = message("std_msgs/msg/Header", frame_id=frame)
    where = pose_message(Pose(np.asarray(position), np.asarray(rotation)))
    region = message("moveit_msgs/msg/BoundingVolume", primitive_poses=[where])
    x, y, z = offset
    place = message(
        "moveit_msgs/msg/PositionConstraint", header=header, link_name=link,
        target_point_offset=message("geometry_msgs/msg/Vector3", x=x, y=y, z=z),
        constraint_region=region,
    )  # fmt: skip
    turn = message(
        "moveit_msgs/msg/OrientationConstraint", header=header, link_name=link,
        orientation=where.orientation,
    )  # fmt: skip
    return message(
        "moveit_msgs/msg/Constraints", position_constraints=[place], orientation_constraints=[turn]
    )


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("offset", [(0.0, 0.0, 0.0), (0.02, -0.01, 0.1)])
def test_a_pose_of_the_flange_is_that_of_the_tool(seed: int, offset) -> None:
    """The flange at its pose in a configuration: point and axis of the tool there."""
    q = np.random.default_rng(seed).uniform(ROBOT.lower, ROBOT.upper)
    origins, rotations = ROBOT.segment_frames(q)
    flange = rotations[-1] @ ROBOT.flange_rotation
    place = origins[-1] + rotations[-1] @ ROBOT.flange_translation + flange @ offset
    goal = read_goal(
        [pose_goal(place, flange, "fr3_flange", offset)], LiveScene.of(SCENE, PREFIX), PREFIX
    )
    assert isinstance(goal, RegionGoal)
    point, axis = ROBOT.tool_pose(q)
    np.testing.assert_allclose(goal.position, point, atol=1e-9)
    np.testing.assert_allclose(goal.rotation, rotations[-1] @ ROBOT.tool_rotation, atol=1e-9)
    np.testing.assert_allclose(goal.direction, axis, atol=1e-9)


def test_a_pose_of_the_tool_is_reached() -> None:
    point, axis = ROBOT.tool_pose(SCENE.start)
    side = np.cross(axis, (0.3, 0.5, 0.1))
    side /= np.linalg.norm(side)
    turn = np.stack([side, np.cross(axis, side), axis], axis=1)
    wanted = point + (0.05, -0.05, -0.05)
    asked = request(goal_constraints=[pose_goal(wanted, turn, "tool")])
    found = answer(LiveScene.of(SCENE), asked)
    assert found.response.error_code.val == CODES["SUCCESS"], found.response.error_code.message
    at, along = ROBOT.tool_pose(found.trajectory.points[-1].positions)
    assert np.linalg.norm(at - wanted) < 2e-3
    assert along @ axis > 0.999
    last = ROBOT.segment_frames(found.trajectory.points[-1].positions)[1][-1]
    np.testing.assert_allclose(last @ ROBOT.tool_rotation, turn, atol=0.04)


def test_a_wide_tolerance_about_z_frees_the_roll() -> None:
    asked = pose_goal((0.3, 0.1, 0.5), np.eye(3), "tool")
    world = LiveScene.of(SCENE)
    assert isinstance(read_goal([asked], world), RegionGoal)
    asked.orientation_constraints[0].absolute_z_axis_tolerance = 3.15
    goal = read_goal([asked], world)
    assert isinstance(goal, PoseGoal)
    np.testing.assert_allclose(goal.axis, [0.0, 0.0, 1.0], atol=1e-12)


@pytest.mark.parametrize(
    ("fields", "code", "words"),
    [
        ({"planner_id": "RRT"}, "INVALID_GOAL_CONSTRAINTS", "planner_id is 'RRT'; valid: promp"),
        (
            {"max_velocity_scaling_factor": 1.5},
            "INVALID_GOAL_CONSTRAINTS", "max_velocity_scaling_factor is 1.5: must be above 0",
        ),
        (
            {"path_constraints": joint_goal(SCENE.start), "max_cartesian_speed": 0.1},
            "INVALID_GOAL_CONSTRAINTS",
            "path_constraints.joint_constraints, max_cartesian_speed: must be empty",
        ),
        (
            {"start_state": message("moveit_msgs/msg/RobotState", joint_state=joint_state(
                SCENE.start + 9.0))},
            "START_STATE_INVALID", "START_INVALID: start: joint2 is",
        ),
        (
            {"goal_constraints": [pose_goal((3.0, 0, 0), np.eye(3), "tool")]},
            "NO_IK_SOLUTION", "GOAL_UNREACHABLE",
        ),
        ({"goal_constraints": [joint_goal(SCENE.start)] * 2}, "INVALID_GOAL_CONSTRAINTS",
         "goal_constraints has 2 entries: must have one"),
        ({"goal_constraints": [message("moveit_msgs/msg/Constraints")]}, "INVALID_GOAL_CONSTRAINTS",
         "has 0 joint, 0 position and 0 orientation constraints: must have"),
        ({"goal_constraints": [pose_goal((0, 0, 0), np.eye(3), "hand")]},
         "INVALID_GOAL_CONSTRAINTS", "link_name is 'hand': both constraints must name 'tool'"),
        ({"goal_constraints": [pose_goal((0, 0, 0), np.eye(3), "tool", frame="camera")]},
         "INVALID_GOAL_CONSTRAINTS", "frame_id is 'camera': must be '' or 'link0' or 'world'"),
    ],
)  # fmt: skip
def test_what_cannot_be_planned_is_answered_with_a_code(fields, code: str, words: str) -> None:
    found = answer(LiveScene.of(SCENE), request(group_name="arm", **fields))
    error = found.response.error_code
    assert error.val == CODES[code]
    assert words in error.message
    assert found.trajectory is None
    assert not found.response.trajectory.joint_trajectory.points
    assert found.response.group_name == "arm"


def test_a_world_without_a_target_is_answered() -> None:
    empty = message("moveit_msgs/msg/CollisionObject", operation=1)
    found = answer(LiveScene.of(SCENE).heard(empty), request())
    assert found.response.error_code.val == CODES["INVALID_OBJECT_NAME"]
    assert "no target" in found.response.error_code.message


def test_time_that_is_too_short_is_said_and_the_motion_shown() -> None:
    found = answer(LiveScene.of(SCENE), request(allowed_planning_time=1e-6))
    assert found.response.error_code.val == CODES["TIMED_OUT"]
    assert found.trajectory is None
    assert found.display.trajectory[0].joint_trajectory.points


@pytest.mark.parametrize("code", [code for code in Code if code is not Code.INVALID_DEMONSTRATION])
def test_every_code_of_a_plan_has_one_of_moveit(code: Code) -> None:
    assert MOVEIT[code] in CODES


@pytest.mark.filterwarnings("ignore:no built-in demonstrations")
def test_a_group_of_other_joints_than_the_arms_is_refused(tmp_path: Path) -> None:
    """The groups are those of the SRDF that chose the arm; without one any name is taken."""
    (tmp_path / "two.urdf").write_text(robot(*TWO))
    own = along("arm", "column", "leftlink5"), along("arm_with_torso", "foot", "leftlink5")
    (tmp_path / "own.srdf").write_text(groups(*own))
    choice = Choice(srdf="own.srdf")
    two = Scene(
        "two", "two.urdf", (), goal=JointGoal(np.zeros(5)), base_dir=tmp_path, choice=choice
    )
    world = LiveScene.of(two)
    for name in ("arm_with_torso", "none"):
        refused = answer(world, request(group_name=name))
        assert refused.plan is None
        assert refused.trajectory is None
        told = refused.response.error_code.message
        assert f"group_name is '{name}': this node plans for arm (" in told
    for name in ("arm", ""):
        assert answer(world, request(group_name=name)).plan is not None
    assert answer(LiveScene.of(SCENE), request(group_name="panda_arm")).plan is not None
