"""Requests of MoveIt and their answers, from recorded messages to recorded messages."""

from pathlib import Path

import numpy as np
import pytest
from tests.robots.arms import TWO, robot
from tests.robots.groups import along, groups
from tests.ros.camera_messages import states

from optipromp import judge, plan
from optipromp.core import judging
from optipromp.core.errors import Code, InvalidRequestError, StartInvalidError
from optipromp.core.planning.task import resolve
from optipromp.core.robots.library import Choice
from optipromp.core.scenes import JointGoal, Pose, PoseGoal, RegionGoal, Scene, load_scene
from optipromp.core.trajectory import State
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


def joint_state(q, names=ROBOT.joint_names, velocity=(), stamp: int = 0):
    return states(names, q, stamp, velocity)


def world_of(scene, q=None):
    """The world of a scene whose arm was heard, with a prefix that nobody stated, at its start."""
    arm = resolve(scene)
    names = [PREFIX + name for name in arm.robot.joint_names]
    state = joint_state(arm.start if q is None else q, names)
    return LiveScene.of(scene).heard(state)


def test_a_recorded_session_is_answered(tmp_path: Path) -> None:
    """What the topics said, and the request, from a bag."""
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
    wanted = found.plan.trajectory.resample(100.0)
    shown = found.display.trajectory[0].joint_trajectory
    for item in (found.response.trajectory.joint_trajectory, found.trajectory, shown):
        assert list(item.joint_names) == [PREFIX + name for name in ROBOT.joint_names]
        points = np.array([list(point.positions) for point in item.points])
        np.testing.assert_allclose(points, wanted.positions, atol=1e-9)
    np.testing.assert_allclose(points[0], start, atol=1e-9)
    (back,) = read_trajectories(found.trajectory, ROBOT.joint_names)
    assert judge(found.plan.scene, back).status == Code.SUCCESS


def planned(**fields):
    """The answer to a request that is met, with the arm at the scene's start."""
    found = answer(world_of(SCENE), request(**fields))
    assert found.response.error_code.val == CODES["SUCCESS"], found.response.error_code.message
    assert found.trajectory.joint_names == [PREFIX + name for name in ROBOT.joint_names]
    return found


def begin(q, velocity=(), names=ROBOT.joint_names):
    """A stated start."""
    return message("moveit_msgs/msg/RobotState", joint_state=joint_state(q, names, velocity))


def test_the_answer_is_the_plan_of_the_scene() -> None:
    (back,) = read_trajectories(planned().trajectory, ROBOT.joint_names)
    assert np.array_equal(back.positions, plan(SCENE).trajectory.positions)


def test_the_start_of_the_request_comes_before_that_of_the_topics() -> None:
    """One that moves is joined without a jump; velocities that are noise are none."""
    running = plan(SCENE).trajectory
    now = running.at(0.3 * running.duration)
    for q, velocity, wanted in (
        (SCENE.start + 0.02, (), 0.0),
        (now.q, now.velocity, now.velocity),
        (SCENE.start, np.full(7, 0.004), 0.0),
    ):
        found = planned(start_state=begin(q, velocity))
        first, start = found.trajectory.points[0], found.response.trajectory_start.joint_state
        for positions, velocities in (
            (first.positions, first.velocities), (start.position, start.velocity),
        ):  # fmt: skip
            np.testing.assert_allclose(positions, q, atol=1e-9)
            np.testing.assert_allclose(velocities, wanted, atol=1e-9)


@pytest.mark.parametrize(
    ("velocity", "acceleration"), [(0.5, 0.0), (0.5, 0.0625), (0.0, 0.25), (1.0, 1.0)]
)
def test_scaling_factors_are_shares_of_the_limits(velocity: float, acceleration: float) -> None:
    found = planned(
        max_velocity_scaling_factor=velocity, max_acceleration_scaling_factor=acceleration
    )
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


def test_without_joint_states_only_a_stated_start_is_planned_from() -> None:
    refused = answer(LiveScene.of(SCENE), request()).response.error_code
    assert refused.val == CODES["START_STATE_INVALID"]
    assert "no joint states were heard; or state the start_state" in refused.message
    stated = request(start_state=begin(SCENE.start))
    assert answer(LiveScene.of(SCENE), stated).trajectory is not None
    nameless = request(start_state=begin(SCENE.start, names=()))
    refused = answer(world_of(SCENE), nameless).response.error_code
    assert "start_state.joint_state: name is empty" in refused.message


SECOND = 1_000_000_000  # [ns]


@pytest.mark.parametrize(
    ("stamp", "came", "asked", "words"),
    [
        (100.0, 100.0, 100.9, ""),
        (0.0, 100.0, 100.9, ""),  # without a stamp
        (100.0, None, 100.9, ""),
        (100.0, 100.0, 101.1, "are 1.10 s old: must be at most 1 s"),
        (0.0, 100.0, 101.1, "are 1.10 s old"),
        (98.0, 100.0, 100.0, "are 2.00 s old"),  # a driver that says again what it knows
        (102.0, 100.0, 100.0, "are 2.00 s ahead of the clock"),
        (100.0, 100.0, 90.0, "are 10.00 s ahead of the clock"),  # the clock was set back
        (0.0, None, 100.0, "are 100.00 s old"),
    ],
)
def test_states_of_the_arm_count_for_a_second(stamp, came, asked, words: str) -> None:
    item = joint_state(SCENE.start, velocity=np.zeros(7), stamp=round(stamp * SECOND))
    arrival = None if came is None else round(came * SECOND)
    world = LiveScene.of(SCENE).heard(item, arrival)
    far = [pose_goal((3.0, 0, 0), np.eye(3), "tool")]
    found = answer(world, request(goal_constraints=far), now=round(asked * SECOND))
    told = found.response.error_code.message
    assert (words in told) if words else told.startswith("GOAL_UNREACHABLE")


@pytest.mark.parametrize(("speed", "rests"), [(0.0, True), (0.005, True), (0.02, False)])
def test_states_without_velocities_tell_of_a_motion(speed: float, rests: bool) -> None:
    """By where the arm was in the last second; noise of an encoder is no motion."""
    world, now, noise = LiveScene.of(SCENE), SECOND, np.random.default_rng(0)
    for k in range(75):
        now = SECOND + k * SECOND // 50
        q = SCENE.start + speed * k / 50 + noise.normal(0.0, 3e-4, 7)
        speeds = np.where(np.arange(7) == 3, np.nan, 0.0) if k % 2 else ()  # of one joint unknown
        world = world.heard(joint_state(q, stamp=now, velocity=speeds), now)
    if rests:
        assert not world.arm.at_rest(now).moving
    else:
        with pytest.raises(StartInvalidError, match="have no velocities, and by their positions"):
            world.arm.at_rest(now)


def test_a_state_that_is_not_understood_makes_the_one_before_unknown() -> None:
    lost = world_of(SCENE).heard(joint_state(np.where(np.arange(7) == 3, np.inf, SCENE.start)))
    told = answer(lost, request()).response.error_code
    assert told.val == CODES["START_STATE_INVALID"]
    assert "joint4 is inf" in told.message
    assert not lost.heard(joint_state(SCENE.start)).arm.why


def test_an_arm_of_two_drivers_is_known_while_both_speak() -> None:
    names, world = ROBOT.joint_names, LiveScene.of(SCENE)
    with pytest.raises(StartInvalidError, match=r"^no joint states$"):
        world.heard(joint_state(SCENE.start[:4], names[:4])).arm.known(None)
    for k in range(60):
        now = SECOND + k * SECOND // 50
        for part in (slice(4), slice(4, 7)) if k < 30 else (slice(4),):
            q = SCENE.start[part]
            world = world.heard(joint_state(q, names[part], 0.0 * q), now)
        if k == 0 or k == 29:
            np.testing.assert_array_equal(world.arm.at_rest(now).q, SCENE.start)
    with pytest.raises(StartInvalidError, match=r"are 1\.02 s old"):
        world.arm.known(now + SECOND * 21 // 50)


def test_the_arm_of_the_prefix_is_heard() -> None:
    both = [f"{arm}_joint{k}" for arm in ("left", "fr3") for k in range(1, 8)]
    q = np.concatenate([SCENE.start + 0.3, SCENE.start])
    world = LiveScene.of(SCENE, PREFIX).heard(joint_state(q, both))
    assert world.arm.known(None).q.tolist() == SCENE.start.tolist()
    other = joint_state(q[:7], both[:7])
    assert "joint fr3_joint1, " in LiveScene.of(SCENE, PREFIX).heard(other).arm.why
    with pytest.raises(InvalidRequestError, match=r"fr3_joint1, .* is missing"):
        world.heard(other)
    for fields in (
        {"start_state": begin(q[:7], names=both[:7])},
        {"goal_constraints": [joint_goal(q[:7], both[:7])]},
    ):
        refused = answer(world, request(**fields), prefix=PREFIX).response.error_code.message
        assert "joint fr3_joint1, fr3_joint2" in refused


@pytest.mark.parametrize(
    ("q", "velocity", "words"),
    [
        (0.009, 0.0, ""),
        (0.011, 0.0, "the plan begins 0.011 from where joint"),
        (0.0, 0.5, "the plan begins with a velocity 0.5 from where joint"),
        (0.0, None, ""),  # nothing is said of velocities
        (0.0, np.nan, ""),
    ],
)
def test_a_plan_begins_where_the_arm_is(q: float, velocity, words: str) -> None:
    state = joint_state(SCENE.start + q, velocity=() if velocity is None else np.full(7, velocity))
    arm, begin = LiveScene.of(SCENE).heard(state).arm, State(SCENE.start)
    if words:
        with pytest.raises(StartInvalidError, match=words):
            arm.begins(begin, None)
    else:
        arm.begins(begin, None)


def test_an_obstacle_that_is_not_understood_is_a_refusal() -> None:
    header = message("std_msgs/msg/Header", frame_id="camera")
    crate = message("moveit_msgs/msg/CollisionObject", id="crate", header=header)
    world = world_of(SCENE).heard(crate)
    told = answer(world, request()).response.error_code
    assert told.val == CODES["INVALID_OBJECT_NAME"]
    assert "INVALID_SCENE: not understood: collision object 'crate': header.frame_id" in (
        told.message
    )
    goal = [joint_goal(SCENE.start + 0.1)]
    assert answer(world, request(goal_constraints=goal)).plan is None
    both = LiveScene.of(SCENE).heard(crate)  # and no joint states
    assert "'crate'" in answer(both, request()).response.error_code.message
    crate.operation = 1
    assert answer(world.heard(crate), request()).trajectory is not None


@pytest.mark.parametrize("count", [2, 7])
def test_of_several_goals_that_of_some_joints_is_reached(count: int) -> None:
    """The first goal is out of reach, the other joints stay, and the target is avoided."""
    wanted = SCENE.start + (0.2, 0.1, 0, 0, 0, 0, 0)
    far = pose_goal((3.0, 0, 0), np.eye(3), "tool")
    near = joint_goal(wanted[:count], ROBOT.joint_names[:count])
    found = planned(goal_constraints=[far, near])
    np.testing.assert_allclose(found.trajectory.points[-1].positions, wanted, atol=1e-3)
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
    asked = pose_goal(place, flange, "fr3_flange", offset)
    (goal,) = read_goal([asked], LiveScene.of(SCENE, PREFIX))
    assert isinstance(goal, RegionGoal)
    point, axis = ROBOT.tool_pose(q)
    np.testing.assert_allclose(goal.position, point, atol=1e-9)
    np.testing.assert_allclose(goal.rotation, rotations[-1] @ ROBOT.tool_rotation, atol=1e-9)
    np.testing.assert_allclose(goal.direction, axis, atol=1e-9)


@pytest.mark.parametrize("alone", [False, True])
def test_a_place_of_the_tool_is_reached(alone: bool) -> None:
    """A pose, or a position alone."""
    point, axis = ROBOT.tool_pose(SCENE.start)
    side = np.cross(axis, (0.3, 0.5, 0.1))
    side /= np.linalg.norm(side)
    turn = np.stack([side, np.cross(axis, side), axis], axis=1)
    wanted = point + (0.05, -0.05, -0.05)
    goal = pose_goal(wanted, turn, "tool")
    last = planned(goal_constraints=[without(goal) if alone else goal]).trajectory.points[-1]
    at, along = ROBOT.tool_pose(last.positions)
    assert np.linalg.norm(at - wanted) < 2e-3
    if not alone:
        assert along @ axis > 0.999
        turned = ROBOT.segment_frames(last.positions)[1][-1] @ ROBOT.tool_rotation
        np.testing.assert_allclose(turned, turn, atol=0.04)


def test_a_wide_tolerance_about_z_frees_the_roll() -> None:
    asked = pose_goal((0.3, 0.1, 0.5), np.eye(3), "tool")
    world = LiveScene.of(SCENE)
    assert isinstance(read_goal([asked], world)[0], RegionGoal)
    asked.orientation_constraints[0].absolute_z_axis_tolerance = 3.15
    (goal,) = read_goal([asked], world)
    assert isinstance(goal, PoseGoal)
    np.testing.assert_allclose(goal.axis, [0.0, 0.0, 1.0], atol=1e-12)


def without(goal):
    """The goal without an orientation."""
    goal.orientation_constraints = []
    return goal


def unturned(goal):
    """The goal whose orientation is a quaternion of zeros."""
    goal.orientation_constraints[0].orientation = message("geometry_msgs/msg/Quaternion", w=0.0)
    return goal


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
            {"start_state": begin(SCENE.start + 9.0)},
            "START_STATE_INVALID", "START_INVALID: start: joint2 is",
        ),
        (
            {"goal_constraints": [pose_goal((3.0, 0, 0), np.eye(3), "tool")]},
            "NO_IK_SOLUTION", "GOAL_UNREACHABLE",
        ),
        ({"goal_constraints": [message("moveit_msgs/msg/Constraints")]}, "INVALID_GOAL_CONSTRAINTS",
         "has 0 joint, 0 position and 0 orientation constraints: must have"),
        ({"goal_constraints": [without(pose_goal((0, 0, 0), np.eye(3), "flange"))]},
         "INVALID_GOAL_CONSTRAINTS", "without an orientation constraint it must be of 'tool'"),
        ({"goal_constraints": [unturned(pose_goal((0.4, 0, 0.5), np.eye(3), "tool"))]},
         "INVALID_GOAL_CONSTRAINTS", "must be a unit quaternion"),
        ({"goal_constraints": [joint_goal([np.nan] * 7)]}, "INVALID_GOAL_CONSTRAINTS", "joints"),
        ({"goal_constraints": [joint_goal([0.1], ["left_joint1"])]}, "INVALID_GOAL_CONSTRAINTS",
         "joint_constraints: joint joint1"),
        ({"allowed_planning_time": np.nan}, "INVALID_GOAL_CONSTRAINTS",
         "allowed_planning_time is nan: must be above 0 s"),
        ({"allowed_planning_time": -1.0}, "INVALID_GOAL_CONSTRAINTS", "planning_time is -1"),
        ({"max_cartesian_speed": np.nan}, "INVALID_GOAL_CONSTRAINTS", "max_cartesian_speed: must"),
        ({"start_state": message("moveit_msgs/msg/RobotState", multi_dof_joint_state=message(
            "sensor_msgs/msg/MultiDOFJointState", joint_names=["floating"]))},
         "INVALID_GOAL_CONSTRAINTS", "start_state.multi_dof_joint_state: must be empty"),
        ({"goal_constraints": [pose_goal((0, 0, 0), np.eye(3), "hand")]},
         "INVALID_GOAL_CONSTRAINTS", "link_name is 'hand': both constraints must name 'tool'"),
        ({"goal_constraints": [pose_goal((0, 0, 0), np.eye(3), "tool", frame="camera")]},
         "INVALID_GOAL_CONSTRAINTS", "frame_id is 'camera': must be '' or 'link0' or 'link1'"),
    ],
)  # fmt: skip
def test_what_cannot_be_planned_is_answered_with_a_code(fields, code: str, words: str) -> None:
    found = answer(world_of(SCENE), request(group_name="arm", **fields))
    error = found.response.error_code
    assert error.val == CODES[code]
    assert words in error.message
    assert found.trajectory is None
    assert not found.response.trajectory.joint_trajectory.points
    assert found.response.group_name == "arm"


def test_time_that_is_too_short_is_said_and_the_motion_shown() -> None:
    found = answer(world_of(SCENE), request(allowed_planning_time=1e-6))
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
    world = world_of(two)
    for name in ("arm_with_torso", "none"):
        refused = answer(world, request(group_name=name))
        assert refused.plan is None
        assert refused.trajectory is None
        told = refused.response.error_code.message
        assert f"group_name is '{name}': this node plans for arm (" in told
    for name in ("arm", ""):
        assert answer(world, request(group_name=name)).plan is not None
    assert answer(world_of(SCENE), request(group_name="panda_arm")).plan is not None
