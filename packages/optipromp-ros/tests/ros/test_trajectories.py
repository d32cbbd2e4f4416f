"""Trajectories as messages: round trips, other programs' messages, an independent reader."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import CubicHermiteSpline
from tests.ros.camera_messages import sent

from optipromp.core.errors import InvalidRequestError
from optipromp.core.trajectory import Trajectory
from optipromp_ros import (
    Recorded,
    display_trajectory,
    joint_trajectory,
    message,
    read_trajectories,
    read_trajectory,
    robot_trajectory,
    write_bag,
)
from optipromp_ros.trajectories import time_message

NAMES = ("a", "b", "c")


def moving(rows: int = 12, seed: int = 0, mean: float = 0.05) -> Trajectory:
    """Rows at random times, with random derivatives."""
    random = np.random.default_rng(seed)
    times = np.append(0.0, np.cumsum(random.uniform(0.2, 2.0, rows - 1) * mean))
    q, velocity, acceleration = random.uniform(-3.0, 3.0, (3, rows, 3))
    return Trajectory(times, q, velocity, acceleration, NAMES)


def same(one: Trajectory, other: Trajectory, atol: float = 1e-9) -> None:
    assert one.joint_names == other.joint_names
    for what in ("times", "positions", "velocities", "accelerations"):
        np.testing.assert_allclose(getattr(other, what), getattr(one, what), atol=atol, rtol=0)


@settings(max_examples=30)
@given(rows=st.integers(2, 40), seed=st.integers(0, 99), mean=st.floats(1e-3, 1e4))
def test_rows_round_trip(rows: int, seed: int, mean: float) -> None:
    trajectory = moving(rows, seed, mean)
    (back,) = read_trajectories(sent(joint_trajectory(trajectory)))
    same(trajectory, back)


def test_every_kind_of_message_round_trips() -> None:
    one, two = moving(seed=1), moving(seed=2)
    (back,) = read_trajectories(sent(robot_trajectory(one)))
    same(one, back)
    display = sent(display_trajectory([one, two], "arm"))
    assert display.model_id == "arm"
    assert display.trajectory_start.joint_state.position.tolist() == one.positions[0].tolist()
    for before, after in zip((one, two), read_trajectories(display), strict=True):
        same(before, after)


@pytest.mark.parametrize("rate", [10.0, 100.0, 1000.0])
def test_points_at_a_rate_are_on_the_curve(rate: float) -> None:
    trajectory = Trajectory.through(moving().positions, 0.1, NAMES)
    item = joint_trajectory(trajectory, rate)
    (back,) = read_trajectories(item)
    np.testing.assert_allclose(np.diff(back.times)[:-1], 1.0 / rate, atol=1e-9)
    wanted = trajectory.sample(back.times)
    for what, values in zip(("positions", "velocities", "accelerations"), wanted, strict=True):
        # a time is off by half a nanosecond at most, and a spline through noise is fast
        np.testing.assert_allclose(getattr(back, what), values, rtol=1e-6, atol=1e-4)


def test_joints_are_matched_by_name() -> None:
    trajectory = moving()
    item = joint_trajectory(trajectory, prefix="left_")
    assert item.joint_names == ["left_a", "left_b", "left_c"]
    (back,) = read_trajectories(item, ("c", "a"))
    assert back.joint_names == ("c", "a")
    assert np.array_equal(back.positions, trajectory.positions[:, [2, 0]])
    assert np.array_equal(back.accelerations, trajectory.accelerations[:, [2, 0]])
    (as_it_is,) = read_trajectories(item)
    assert as_it_is.joint_names == ("left_a", "left_b", "left_c")


def without(item, *fields: str):
    for point in item.points:
        for field in fields:
            setattr(point, field, np.zeros(0))
    return item


def test_positions_alone_get_the_smoothest_curve() -> None:
    trajectory = Trajectory.through(moving().positions, moving().times, NAMES)
    item = without(joint_trajectory(trajectory), "velocities", "accelerations")
    (back,) = read_trajectories(sent(item))
    np.testing.assert_allclose(back.times, trajectory.times, atol=1e-9)
    for what in ("velocities", "accelerations"):
        values = getattr(trajectory, what)
        np.testing.assert_allclose(getattr(back, what), values, atol=1e-5 * np.abs(values).max())


@pytest.mark.parametrize("rows", [2, 3, 9])
def test_missing_accelerations_are_those_of_the_cubics(rows: int) -> None:
    trajectory = moving(rows)
    (back,) = read_trajectories(without(joint_trajectory(trajectory), "accelerations"))
    spline = CubicHermiteSpline(back.times, back.positions, back.velocities)
    near = 1e-9
    before, after = (spline(np.clip(back.times + d, 0.0, back.duration), 2) for d in (-near, near))
    wanted = 0.5 * (before + after)
    wanted[0], wanted[-1] = after[0], before[-1]
    scale = np.abs(wanted).max()
    np.testing.assert_allclose(back.accelerations, wanted, atol=1e-4 * scale)


@pytest.mark.parametrize(
    ("k", "field", "value", "words"),
    [
        (3, "positions", np.zeros(2), r"points\[3\].positions has 2 values: must have 3$"),
        (4, "velocities", np.zeros(0), r"points\[4\].velocities has 0 .* 3, or none in any point"),
        (2, "velocities", np.array([0, np.nan, 0]), r"velocities\[2, 1\] is nan: must be"),
        (2, "time_from_start", time_message(5, "Duration"), "times do not grow"),
    ],
)
def test_a_point_that_is_wrong_is_named(k: int, field: str, value, words: str) -> None:
    item = joint_trajectory(moving())
    setattr(item.points[k], field, value)
    with pytest.raises(InvalidRequestError, match=words):
        read_trajectories(item)


SEVERAL = message(
    "trajectory_msgs/msg/MultiDOFJointTrajectory", joint_names=["base"],
    points=[message("trajectory_msgs/msg/MultiDOFJointTrajectoryPoint")],
)  # fmt: skip


@pytest.mark.parametrize(
    ("item", "words"),
    [
        (without(joint_trajectory(moving()), "positions"), r"points\[0\].positions has 0 values"),
        (
            without(joint_trajectory(moving()), "velocities"),
            "accelerations and no velocities: must",
        ),
        (message("trajectory_msgs/msg/JointTrajectory"), "has 0 points: must have 2"),
        (
            message("moveit_msgs/msg/RobotTrajectory", multi_dof_joint_trajectory=SEVERAL),
            "moves base: must be empty",
        ),
        (message("std_msgs/msg/String"), "a std_msgs/msg/String is no trajectory"),
    ],
)
def test_what_is_no_trajectory_is_refused_by_name(item, words: str) -> None:
    with pytest.raises(InvalidRequestError, match=words):
        read_trajectories(item)


def test_time_begins_at_the_first_point() -> None:
    item = joint_trajectory(moving())
    for point in item.points:
        point.time_from_start.sec += 2
    (back,) = read_trajectories(item)
    same(moving(), back)


def test_a_joint_that_is_missing_is_named() -> None:
    with pytest.raises(InvalidRequestError, match="joint elbow is missing; it names a, b, c"):
        read_trajectories(joint_trajectory(moving()), ("a", "elbow"))


def test_no_trajectories_cannot_be_displayed() -> None:
    with pytest.raises(InvalidRequestError, match="must be one at least"):
        display_trajectory([], "arm")


def test_the_one_trajectory_of_a_bag(tmp_path: Path) -> None:
    one, two = moving(seed=1), moving(seed=2)
    shown = Recorded("/shown", display_trajectory([one], "arm"))
    write_bag(tmp_path / "shown.mcap", [shown])
    same(one, read_trajectory(tmp_path / "shown.mcap"))
    write_bag(
        tmp_path / "two.mcap",
        [shown, *(Recorded(f"/{k}", joint_trajectory(t)) for k, t in enumerate((one, two)))],
    )
    with pytest.raises(InvalidRequestError, match=r"2 trajectories of .* on /0, /1: must have"):
        read_trajectory(tmp_path / "two.mcap")
    same(two, read_trajectory(tmp_path / "two.mcap", topic="/1"))
    write_bag(tmp_path / "none.mcap", [Recorded("/text", message("std_msgs/msg/String"))])
    with pytest.raises(InvalidRequestError, match="has no trajectory: must have a message of type"):
        read_trajectory(tmp_path / "none.mcap")
