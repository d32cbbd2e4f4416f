"""Every entry of ours answers scenes by their seeds, with motions that a controller takes."""

import re

import numpy as np
import pytest

from optipromp import Trajectory, plan, robot_of
from optipromp.core.arrays import FloatArray, lengths
from optipromp.core.errors import InvalidRequestError
from optipromp.core.planning.task import posed
from optipromp.core.pushing.parameters import PUSH
from optipromp.core.scenes.scene import bare_robot
from optipromp.timing import NEAR, gentle
from optipromp_bench.entrant import Refused, loaded, motion_of
from optipromp_bench.entries import ENTRIES
from optipromp_bench.sets import scene_of
from optipromp_bench.tracks import against

PLAN = [name for name, each in ENTRIES.items() if each.track == "plan"]


def curve(answer: object) -> Trajectory | None:
    made = motion_of(answer)
    return None if isinstance(made, Refused) else made.reach


@pytest.mark.parametrize("name", PLAN)
def test_an_entry_answers_alike_each_time(name: str) -> None:
    if name == "rrt":
        pytest.importorskip("ompl")
    scene, _ = scene_of("cluster", 110_000)
    one, other = (curve(loaded(name, "plan").plan(scene, 3)) for _ in range(2))
    assert (one is None) == (other is None)
    if one is not None and other is not None:
        assert np.array_equal(one.positions, other.positions)
        assert against(one, scene) == ""


@pytest.mark.parametrize("name", ["push-aside", "mppi", "receding"])
def test_an_entry_pushes_something_aside(name: str) -> None:
    """In a scene that the straight way does not solve, the path is off the straight line."""
    scene, _ = scene_of("cluster", 110_001)
    told = curve(loaded(name, "plan").plan(scene, 0))
    robot, _ = posed(scene)
    points, _ = robot.tool_pose(told.positions)
    off = (points - scene.target.position) @ scene.frame.T
    low = (off[:, 2] > -0.15) & (off[:, 2] < 0.0)
    assert np.hypot(*off[low, :2].T).max() > 0.01


def test_a_refusal_names_joint_value_limit_time_and_remedy() -> None:
    scene, _ = scene_of("field", 110_002)
    robot, q = robot_of(scene), np.array(posed(scene)[1].q)
    near = np.array([1.0, -1.0, 1.0, -1.0, 1.0, -1.0, 1.0]) * 0.3

    def words(rows: FloatArray, duration: float) -> str:
        times = np.linspace(0.0, duration, len(rows))
        return against(Trajectory.through(rows, times, robot.joint_names[: rows.shape[1]]), scene)

    rows = q + np.linspace(0.0, 1.0, 9)[:, None] * near
    joint, value, unit, when, limit = re.fullmatch(
        r"(joint\d) reaches ([\d.]+) (\S+) at ([\d.]+) s; its limit is ([\d.]+): time it with "
        r"optipromp\.timing", words(rows, 0.3)
    ).groups()  # type: ignore[union-attr]  # fmt: skip
    k = int(joint[-1]) - 1
    if unit == "rad/s²":
        assert float(limit) == robot.acceleration[k]
    else:
        assert (unit, float(limit)) == ("rad/s", robot.velocity[k])
    assert float(value) > float(limit)
    assert 0.0 <= float(when) <= 0.3
    assert against(gentle(scene, rows), scene) == ""
    assert "begins at" in words(rows + 0.1, 9.0)
    assert f"the start is {q[0]:.6g}" in words(rows + 0.1, 9.0)
    assert "6 joints; panda has 7: joint1, joint2" in words(rows[:, :6], 9.0)
    far = np.zeros(7)
    far[3] = robot.upper[3] + 0.2 - q[3]
    told = words(q + np.linspace(0.0, 1.0, 9)[:, None] * far, 30.0)
    assert told.startswith(
        f"joint4 reaches {robot.upper[3] + 0.2:.4g} rad at 30.00 s; its limit is"
    )
    assert "range" in told


def test_a_scene_s_robot_has_its_tool() -> None:
    scene, _ = scene_of("field", 110_002)
    robot = robot_of(scene)
    made = plan(scene)
    point, _ = robot.tool_pose(made.trajectory.positions[-1])
    bare, _ = bare_robot(scene).tool_pose(made.trajectory.positions[-1])
    assert np.linalg.norm(point - scene.target.position) < 1e-3
    assert np.linalg.norm(bare - scene.target.position) > 0.1
    assert robot is posed(scene)[0]


def test_few_waypoints_are_joined_before_they_are_slowed() -> None:
    """Five waypoints, with the first fruit between two of them."""
    scene, _ = scene_of("field", 110_002)
    robot, made = robot_of(scene), plan(scene)
    q = made.trajectory.sample(np.linspace(0.0, made.trajectory.duration, 5))[0]
    motion = gentle(scene, q)
    assert against(motion, scene) == ""
    assert np.array_equal(motion.positions[[0, -1]], q[[0, -1]])
    assert np.abs(motion.positions[:, None] - q[None]).max(axis=2).min(axis=0).max() < 0.01
    times = np.linspace(0.0, motion.duration, 800)
    points, _ = robot.tool_pose(motion.sample(times)[0])
    away = np.min(
        [lengths(points - item.position) - item.radius for item in scene.objects if item.stem], 0
    )
    near, speed = away[1:] < NEAR, lengths(np.diff(points, axis=0)) / np.diff(times)
    assert near.any()
    assert speed[near].max() < 1.1 * PUSH.hanging.speed
    assert speed.max() > 1.5 * PUSH.hanging.speed
    for wrong in (q[:1], q[:, :6], q * np.nan, q[[0, 0]]):
        with pytest.raises(InvalidRequestError):
            gentle(scene, wrong)
