"""Robot files, the built-in robots, and which spheres are kept apart."""

import warnings

import numpy as np
import pytest
import yaml
from tests.refusals import assert_refused
from tests.robots.links import Writer, joint

from optipromp.core.errors import InvalidRobotError
from optipromp.core.robots.library import load_robot


def test_panda_limits() -> None:
    panda = load_robot("panda")
    assert panda.n_joints == 7
    np.testing.assert_array_equal(
        panda.lower, [-2.8973, -1.7628, -2.8973, -3.0718, -2.8973, -0.0175, -2.8973]
    )
    np.testing.assert_array_equal(
        panda.upper, [2.8973, 1.7628, 2.8973, -0.0698, 2.8973, 3.7525, 2.8973]
    )
    np.testing.assert_array_equal(panda.velocity, [2.175] * 4 + [2.61] * 3)
    np.testing.assert_array_equal(panda.acceleration, [15, 7.5, 10, 12.5, 15, 20, 20])
    np.testing.assert_array_equal(panda.jerk, [7500, 3750, 5000, 6250, 7500, 10000, 10000])


def test_scara_dimensions() -> None:
    scara = load_robot("scara")
    np.testing.assert_allclose(scara.upper - scara.lower, [0.51, 3.14, 3.14])
    point, axis = scara.tool_pose(np.array([0.2, 0.0, 0.0]))
    np.testing.assert_allclose(point, [0.035 + 0.210 + 0.1407 + 0.0893, 0.105, 0.2], atol=1e-12)
    np.testing.assert_allclose(axis, [0, 0, 1])
    point, _ = scara.tool_pose(np.array([0.2, np.pi / 2, 0.0]))
    assert point[1] > 0.5


@pytest.mark.parametrize("name", ["panda", "scara"])
def test_values_are_read_only(name: str) -> None:
    robot = load_robot(name)
    for array in (robot.lower, robot.home, robot.self_pairs, *robot.spheres, *robot.kinematics):
        assert not array.flags.writeable


@pytest.mark.parametrize("name", ["panda", "scara"])
def test_distal_is_the_last_segment(name: str) -> None:
    robot = load_robot(name)
    assert robot.spheres.distal.any()
    np.testing.assert_array_equal(
        robot.spheres.distal, robot.spheres.segment == robot.n_segments - 1
    )


def test_panda_clear_of_itself_at_ordinary_poses() -> None:
    panda = load_robot("panda")
    poses = [panda.home, [0, -0.3, 0, -2.2, 0, 3.0, 0.8], [0, 0, 0, -0.1, 0, 0, 0.8]]
    assert (panda.self_gaps(np.array(poses)) > 0.05).all()
    middle, half = (panda.lower + panda.upper) / 2, (panda.upper - panda.lower) / 2
    q = np.random.default_rng(0).uniform(middle - half, middle + half, (2000, 7))
    assert (panda.self_gaps(q) < 0.0).any(axis=1).mean() < 0.05
    assert (panda.self_gaps(middle + 0.7 * (q - middle)) < 0.0).any(axis=1).mean() < 0.002
    assert (panda.self_gaps(middle + 0.6 * (q - middle)) > 0.0).all()


def test_panda_folded_into_its_base_is_seen() -> None:
    panda = load_robot("panda")
    assert panda.self_gaps(np.array([0, 1.2, 0, -3.0, 0, 1.0, 0])).min() < 0.0


def test_panda_stands_on_its_plane() -> None:
    """A table at z = 0 does not touch the base."""
    panda = load_robot("panda")
    base = panda.spheres.segment <= 0
    assert (panda.sphere_centers(panda.home)[base, 2] - panda.spheres.radius[base]).min() > 0.0


def test_scara_never_touches_itself() -> None:
    scara = load_robot("scara")
    q = np.random.default_rng(0).uniform(scara.lower, scara.upper, (1000, 3))
    assert (scara.self_gaps(q) > 0.0).all()


@pytest.mark.parametrize("name", ["panda", "scara"])
def test_pairs_are_of_links_two_joints_apart(name: str) -> None:
    robot = load_robot(name)
    segments = robot.spheres.segment[robot.self_pairs]
    assert (np.abs(segments[:, 0] - segments[:, 1]) >= 2).all()
    assert len(np.unique(robot.self_pairs, axis=0)) == len(robot.self_pairs)


def test_covers_that_always_meet_are_not_pairs(write: Writer) -> None:
    """Three joints at one place, with fat links: the first and the last always overlap."""
    ball = '<collision><geometry><sphere radius="0.3"/></geometry></collision>'
    place = '<origin xyz="0 0 -0.45"/>'
    far = f'<collision>{place}<geometry><sphere radius="0.1"/></geometry></collision>'
    links = "".join(f'<link name="l{i}">{ball}</link>' for i in range(4))
    joints = "".join(joint(f"j{i}", f"l{i}", f"l{i + 1}") for i in range(4))
    path = write(f'<robot name="r">{links}<link name="l4">{far}</link>{joints}</robot>')
    robot = load_robot(path)
    pairs = {
        (robot.link_names[a], robot.link_names[b]) for a, b in robot.spheres.link[robot.self_pairs]
    }
    assert ("l0", "l2") not in pairs
    assert ("l0", "l4") in pairs


def entry(**changes: object) -> str:
    content: dict[str, object] = {"format": 1, "name": "mine", "urdf": "robot.urdf"}
    return yaml.safe_dump({**content, **changes})


def test_a_robot_file(write: Writer, urdf: Writer) -> None:
    urdf()
    text = entry(
        acceleration=[1, 2],
        jerk=[3, 4],
        home=[0.5, -0.5],
        spheres={"a": [[0, 0, 0, 0.1]], "b": [], "c": [[0, 0, 0.1, 0.05]]},
        flange="c",
    )
    robot = load_robot("robot.yaml", base_dir=write(text, "robot.yaml").parent)
    assert robot.name == "mine"
    np.testing.assert_array_equal(robot.home, [0.5, -0.5])
    np.testing.assert_array_equal(robot.jerk, [3, 4])
    assert set(robot.spheres.link) == {0, 2}  # b is declared empty


def test_limits_that_no_file_states_are_assumed_and_told_of(write: Writer, urdf: Writer) -> None:
    """10 rad/s² and 2 m/s², ten times as much a second; a robot file states others, or none."""
    path = urdf(joint("ab", "a", "b") + joint("bc", "b", "c", kind="prismatic"))
    with pytest.warns(UserWarning, match="robot.urdf states no limits of acceleration"):
        robot = load_robot(path)
    np.testing.assert_array_equal(robot.acceleration, [10, 2])
    np.testing.assert_array_equal(robot.jerk, [100, 20])
    with warnings.catch_warnings(record=True) as told:
        assert load_robot(path) is robot
        part = load_robot(write(entry(acceleration=[1, 3]), "part.yaml"))
        none = load_robot(write(entry(acceleration="none"), "none.yaml"))
    assert not told
    np.testing.assert_array_equal(part.jerk, [10, 30])
    assert np.isinf(none.acceleration).all()
    assert np.isinf(none.jerk).all()


def test_declared_scale(write: Writer, urdf: Writer) -> None:
    """A URDF in millimetres, declared so, equals the one in metres."""
    q = np.array([0.3, 0.2])
    slide = joint("bc", "b", "c", kind="prismatic")
    metres = load_robot(urdf(joint("ab", "a", "b", origin='<origin xyz="0.5 0 0"/>') + slide))
    big = joint("bc", "b", "c", kind="prismatic", limit='<limit lower="-1000" upper="1000"/>')
    big = big.replace('xyz="0.1 0 0.2"', 'xyz="100 0 200"')
    urdf(joint("ab", "a", "b", origin='<origin xyz="500 0 0"/>') + big)
    scaled = load_robot(write(entry(scale=0.001), "robot.yaml"))
    np.testing.assert_allclose(scaled.tool_pose(q), metres.tool_pose(q), atol=1e-12)
    np.testing.assert_allclose(scaled.upper, metres.upper)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", ["is empty: must hold a robot file"]),
        ("a: [", ["robot.yaml: line 1: ", "did not find expected node content"]),
        ("format: 1\nformat: 1", ["line 2: key 'format' stands twice"]),
        (entry(colour="red"), ["unknown key 'colour'", "acceleration"]),
        (entry(format=2), ["format", "2"]),
        ("name: x", ["'format' is missing"]),
        (entry(flange="z"), ["'z'", "a, b, c"]),
        (entry(flange="a"), ["no movable joint"]),
        (entry(urdf="none.urdf"), ["none.urdf", "cannot be read"]),
        (entry(acceleration=[1]), ["acceleration has 1", "2 joints", "ab, bc"]),
        (entry(acceleration=[1, 0]), ["acceleration.1", "greater than 0", "0"]),
        (entry(home=[0, 2]), ["home of joint 'bc'", "2", "[-1, 1]"]),
        (entry(spheres={"a": [[0, 0, 0, 0]]}), ["spheres.a.0.3", "greater than 0"]),
        (entry(spheres={"a": [[0, 0, 400, 0.1]]}), ["spheres.a.0.2", "400"]),
        (entry(allow_self=[["a", "z"]]), ["unknown link 'z'"]),
    ],
)
def test_refused(write: Writer, urdf: Writer, text: str, words: list[str]) -> None:
    urdf()
    path = write(text, "robot.yaml")
    assert_refused(InvalidRobotError, words, load_robot, path)
