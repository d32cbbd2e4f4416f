"""Inverse kinematics: reached by Pinocchio's forward kinematics, and what else it promises."""

from importlib import resources

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.robots.links import BALL, Writer, joint

from optipromp.core.errors import InvalidRequestError
from optipromp.core.robots import ik
from optipromp.core.robots.library import load_robot
from optipromp.core.robots.model import Robot
from optipromp.core.robots.tools import Cup, with_tool

pin = pytest.importorskip("pinocchio")

CUPS = {"panda": Cup(0.05), "scara": Cup(0.03, length=0.0616)}
UP = np.array([0.0, 0.0, 1.0])


@pytest.fixture(scope="module")
def robots() -> dict[str, Robot]:
    return {name: with_tool(load_robot(name), cup) for name, cup in CUPS.items()}


def oracle(name: str, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Tool point and axis by Pinocchio, from the robot's file and the cup's stated length."""
    with resources.as_file(
        resources.files("optipromp.core.robots") / "data" / f"{name}.urdf"
    ) as path:
        model = pin.buildModelFromUrdf(str(path))
    data, frame = model.createData(), model.getFrameId("flange")
    points, axes = [], []
    for configuration in q:
        pin.framesForwardKinematics(model, data, configuration)
        pose = data.oMf[frame]
        points.append(pose.translation + CUPS[name].reach * pose.rotation[:, 2])
        axes.append(pose.rotation[:, 2].copy())
    return np.array(points).reshape(-1, 3), np.array(axes).reshape(-1, 3)


def configurations(robot: Robot, count: int, seed: int, margin: float = 0.1) -> np.ndarray:
    low, high = robot.lower, robot.upper
    room = margin * (high - low)
    return np.random.default_rng(seed).uniform(low + room, high - room, (count, robot.n_joints))


@pytest.mark.parametrize("name", ["panda", "scara"])
def test_every_reachable_pose_is_reached(name: str, robots: dict[str, Robot]) -> None:
    robot = robots[name]
    points, axes = oracle(name, configurations(robot, 40, seed=1))
    for point, axis in zip(points, axes, strict=True):
        found = ik.solve(robot, point, axis)
        assert len(found) > 0
        reached, along = oracle(name, found.joints)
        assert np.linalg.norm(reached - point, axis=1).max() < 1e-6
        assert np.linalg.norm(np.cross(along, axis), axis=1).max() < 2e-6
        assert (along @ axis > 0.0).all()
        assert (found.joints >= robot.lower).all()
        assert (found.joints <= robot.upper).all()


def test_solutions_are_distinct_and_ranked(robots: dict[str, Robot]) -> None:
    robot = robots["panda"]

    def clearance(q: np.ndarray) -> np.ndarray:
        return np.asarray(0.03 + 0.02 * np.sin(7.0 * q.sum(axis=1)))

    found = ik.solve(robot, np.array([0.45, 0.0, 0.8]), UP, clearance=clearance)
    q = found.joints
    assert len(found) >= 4  # a redundant arm, and nothing in the way
    apart = np.abs(q[:, None] - q[None]).max(axis=2) + np.eye(len(q))
    assert apart.min() > 0.25
    margin = np.minimum(q - robot.lower, robot.upper - q).min(axis=1)
    np.testing.assert_allclose(found.margin, margin, atol=1e-12)
    np.testing.assert_allclose(found.clearance, clearance(q), atol=1e-12)
    rank = np.minimum(found.margin / 0.3, found.clearance / 0.05)
    assert (np.diff(rank) <= 1e-12).all()
    plain = ik.solve(robot, np.array([0.45, 0.0, 0.8]), UP)
    assert np.isinf(plain.clearance).all()
    assert (np.diff(plain.margin) <= 1e-12).all()


def test_the_elbows_of_a_scara_are_both_found(robots: dict[str, Robot]) -> None:
    robot = robots["scara"]
    q = np.array([0.2, 0.9, 0.7])
    point, axis = robot.tool_pose(q)
    found = ik.solve(robot, point, axis)
    assert len(found) == 2
    assert np.sort(found.joints[:, 2])[0] < 0.0 < np.sort(found.joints[:, 2])[1]
    assert np.abs(found.joints - q).max(axis=1).min() < 1e-5


@pytest.mark.parametrize(
    ("name", "position", "axis"),
    [
        ("panda", [10_000.0, 0.0, 0.0], UP),
        ("panda", [0.0, 0.0, 3.0], UP),
        ("panda", [1.2, 0.0, 0.4], -UP),
        ("scara", [0.2, 0.3, 0.3], [1.0, 0.0, 0.0]),
        ("scara", [0.2, 0.3, 2.0], UP),
    ],
)
def test_out_of_reach_is_empty(name, position, axis, robots):
    found = ik.solve(robots[name], np.array(position), np.array(axis))
    assert len(found) == 0
    assert found.joints.shape == (0, robots[name].n_joints)
    assert found.margin.shape == found.clearance.shape == (0,)


def test_a_free_axis_is_free(robots: dict[str, Robot]) -> None:
    point = np.array([0.3, 0.4, 0.5])
    found = ik.solve(robots["panda"], point, None)
    reached, axes = oracle("panda", found.joints)
    assert np.linalg.norm(reached - point, axis=1).max() < 1e-6
    assert len(found) >= 8
    assert np.ptp(axes @ axes[0]) > 0.5


def test_a_given_start_leads_to_the_nearest_branch(robots: dict[str, Robot]) -> None:
    robot = robots["panda"]
    for q in configurations(robot, 10, seed=3, margin=0.2):
        point, axis = robot.tool_pose(q)
        found = ik.solve(robot, point, axis, near=q[None], rest=q)
        assert np.abs(found.joints - q).max(axis=1).min() < 0.25


def test_what_does_not_matter_rests(robots: dict[str, Robot]) -> None:
    """The last joint of the Panda turns the tool about its own axis."""
    robot = robots["panda"]
    rest = robot.home + 0.123
    found = ik.solve(robot, np.array([0.45, 0.0, 0.8]), UP, rest=rest)
    np.testing.assert_array_equal(found.joints[:, 6], rest[6])
    assert np.abs(found.joints[:, 5] - rest[5]).min() > 0.0


def test_the_length_of_the_axis_does_not_matter(robots: dict[str, Robot]) -> None:
    point = np.array([0.45, 0.0, 0.8])
    one, long = (ik.solve(robots["panda"], point, s * UP).joints for s in (1.0, 40.0))
    np.testing.assert_allclose(one, long, atol=1e-9)


@pytest.mark.parametrize(
    ("position", "axis", "message"),
    [
        ([np.nan, 0.0, 0.0], UP, "position"),
        ([0.1, np.inf, 0.0], UP, "position"),
        ([0.1, 0.2], UP, "position"),
        ([0.1, 0.2, 0.3], [0.0, np.nan, 1.0], "axis"),
        ([0.1, 0.2, 0.3], [0.0, 0.0, 0.0], "axis has no length"),
        ([0.1, 0.2, 0.3], [1.0], "axis"),
    ],
)
def test_bad_goals_are_refused(position, axis, message, robots):
    with pytest.raises(InvalidRequestError, match=message):
        ik.solve(robots["panda"], np.array(position), np.array(axis))


def test_starts_of_another_robot_are_refused(robots: dict[str, Robot]) -> None:
    with pytest.raises(InvalidRequestError, match="7 joints"):
        ik.solve(robots["panda"], np.array([0.4, 0.0, 0.8]), UP, near=np.zeros((1, 6)))


def test_prismatic_and_mimic_joints(urdf: Writer) -> None:
    links = "".join(f'<link name="{n}">{BALL}</link>' for n in "abcdefg")
    limit = '<limit lower="-1.2" upper="1.4" velocity="1"/>'
    mimic = '<mimic joint="bc" multiplier="-0.6" offset="0.1"/>'
    joints = (
        joint("ab", "a", "b", "prismatic", limit, '<axis xyz="0 0.6 0.8"/>')
        + joint("bc", "b", "c", limit=limit, axis='<axis xyz="0 1 0"/>')
        + joint("cd", "c", "d", limit=limit, axis='<axis xyz="1 0 0"/>', more=mimic)
        + joint("de", "d", "e", "continuous", "", '<axis xyz="0 0 1"/>')
        + joint("ef", "e", "f", limit=limit, axis='<axis xyz="0 1 0"/>')
        + joint("fg", "f", "g", limit=limit, axis='<axis xyz="1 0 0"/>')
    )
    robot = load_robot(str(urdf(joints, links)))
    assert robot.n_joints == 5
    rng = np.random.default_rng(0)
    for q in rng.uniform(-1.0, 1.0, (12, 5)):
        point, axis = robot.tool_pose(q)
        found = ik.solve(robot, point, axis, near=q[None])
        assert len(found) > 0
        reached, along = robot.tool_pose(found.joints)
        assert np.linalg.norm(reached - point, axis=1).max() < 1e-6
        assert np.linalg.norm(along - axis, axis=1).max() < 2e-6
        assert (found.joints >= robot.lower).all()
        assert (found.joints <= robot.upper).all()


def test_a_full_turn_apart_is_the_same_configuration(urdf: Writer) -> None:
    links = "".join(f'<link name="{n}">{BALL}</link>' for n in "abcd")
    joints = (
        joint("ab", "a", "b", "continuous", "", '<axis xyz="0 0 1"/>')
        + joint("bc", "b", "c", "continuous", "", '<axis xyz="0 1 0"/>')
        + joint("cd", "c", "d", "continuous", "", '<axis xyz="0 1 0"/>')
    )
    robot = load_robot(str(urdf(joints, links)))
    q = np.array([3.1, 3.05, 0.8])
    point, _ = robot.tool_pose(q)
    starts = [q, q + [2 * np.pi, 0, 0], q - [0, 2 * np.pi, 0], q + [0.0, 0.0, 4 * np.pi]]
    found = ik.solve(robot, point, None, near=np.array(starts))
    assert len(found) > 0
    apart = found.joints[:, None] - found.joints[None]
    apart = np.abs((apart + np.pi) % (2 * np.pi) - np.pi).max(axis=2)
    assert (apart + np.eye(len(found))).min() > 0.25


def test_tracking_stays_on_its_branch(robots: dict[str, Robot]) -> None:
    robot = robots["panda"]
    begin = ik.solve(robot, np.array([0.45, 0.0, 0.8]), UP).joints[0]
    heights = np.linspace(0.8, 0.6, 9)
    points = np.array([[0.45, 0.02 * i, h] for i, h in enumerate(heights)])
    q, errors = ik.track(robot, points, np.tile(UP, (9, 1)), begin)
    reached, along = oracle("panda", q)
    assert errors.max() < 1e-6
    assert np.linalg.norm(reached - points, axis=1).max() < 1e-6
    assert (along @ UP > 1.0 - 1e-9).all()
    assert np.abs(np.diff(np.vstack([begin, q]), axis=0)).max() < 0.3
    assert (q >= robot.lower).all()
    assert (q <= robot.upper).all()


def test_tracking_says_where_it_misses(robots: dict[str, Robot]) -> None:
    robot = robots["panda"]
    points = np.array([[0.45, 0.0, 0.7], [5.0, 0.0, 0.7]])
    begin = ik.solve(robot, points[0], UP).joints[0]
    _, errors = ik.track(robot, points, np.tile(UP, (2, 1)), begin)
    assert errors[0] < 1e-6
    assert errors[1] > 1.0


@settings(max_examples=50, deadline=None)
@given(st.integers(1, 8), st.integers(0, 10**6))
def test_the_linear_solve(n: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    a = rng.standard_normal((n, n))
    a, b = a @ a.T + np.eye(n), rng.standard_normal(n)
    x = b.copy()
    lower = np.tril(a)  # nothing else is read
    ik.cholesky_solve(lower, x)
    np.testing.assert_allclose(a @ x, b, atol=1e-9)
