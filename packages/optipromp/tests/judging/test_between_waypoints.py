"""What the judge sees between the waypoints: fine enough to meet everything, and no more."""

from pathlib import Path

import numpy as np
import pytest
from tests.judging.balls import ball, joint
from tests.judging.builders import TURN, moving, obj, to

from optipromp.core import judging
from optipromp.core.geometry import Box, Capsule, Cylinder, HalfSpace, Sphere
from optipromp.core.robots.library import load_robot
from optipromp.core.robots.model import Robot
from optipromp.core.scenes import JointGoal
from optipromp.core.trajectory import Trajectory


def smooth(robot: Robot, q: np.ndarray) -> Trajectory:
    return Trajectory.through(q, 0.3, robot.joint_names)


@pytest.mark.parametrize("name", ["panda", "gantry", "wheel"])
@pytest.mark.parametrize("size", [0.02, 0.5, 3.0])
@pytest.mark.parametrize("curve", [moving, smooth])
def test_no_sphere_moves_over_half_its_radius_between_checks(name, size, curve, request):
    robot: Robot = request.getfixturevalue(name)
    q = size * np.random.default_rng(1).uniform(-1.0, 1.0, (4, robot.n_joints)).cumsum(axis=0)
    _, fine, rows, complete = judging.refined(robot, curve(robot, q))
    assert complete
    moved = np.linalg.norm(np.diff(robot.sphere_centers(fine), axis=0), axis=2)
    assert (moved <= 0.5 * np.asarray(robot.spheres.radius)).all()
    np.testing.assert_array_equal(fine[rows], q)  # the waypoints themselves are checked


def test_a_thin_wall_between_two_waypoints_is_met(gantry: Robot) -> None:
    """A sheet of paper across the path; at the waypoints the arm is 0.3 m from it."""
    q = np.array([[0.0, 0.0, 0.0], [0.6, 0.0, 0.0], [1.2, 0.0, 0.0]])
    for at in (0.3, 0.9):
        wall = obj("static", Box((1e-4, 2.0, 3.0)), [at, 0.0, 0.0], name="wall")
        scene = to(JointGoal(q[-1]), wall)
        _, at_waypoints = judging.clearances(scene, gantry, q)
        assert not at_waypoints
        judgement = judging.judge(scene, gantry, moving(gantry, q))
        assert {c.other for c in judgement.contacts} == {"wall"}
        assert "wall" in judgement.message
        assert judgement.metrics.clearance_static < -0.009
    beside = obj("static", Box((1e-4, 2.0, 3.0)), [1.3, 0.0, 0.0])
    slow = moving(gantry, q, dt=2.0)
    assert not judging.judge(to(JointGoal(q[-1]), beside), gantry, slow).violations


@pytest.mark.parametrize("radius", [0.02, 0.1, 0.3])
def test_what_a_large_ball_grazes_between_two_checks_is_met(radius: float, tmp_path: Path) -> None:
    """A pin beside its way, 1 mm deep, wherever along the way it stands."""
    text = (
        '<robot name="slide"><link name="base"/>' + ball("z", radius)
        + joint("x", "prismatic", "base", "z", "1 0 0",
                '<limit lower="-5" upper="5" velocity="9" effort="1"/>') + "</robot>"
    )  # fmt: skip
    path = tmp_path / "slide.urdf"
    path.write_text(text, encoding="utf-8")
    slide = load_robot(str(path))
    curve = smooth(slide, np.linspace([0.0], [2.0], 5))
    for along in np.random.default_rng(0).uniform(0.5, 1.5, 50):
        pin = obj("static", Sphere(1e-3), [along, radius, 0.0], name="pin")
        judgement = judging.judge(to(JointGoal(np.array([2.0])), pin), slide, curve)
        assert [c.other for c in judgement.contacts] == ["pin"]


@pytest.mark.parametrize("step", [0.5, np.pi, 2.0 * np.pi, 7.0])
def test_a_wall_inside_a_large_turn_is_met(wheel: Robot, step: float) -> None:
    """After a whole turn the ball is back where it was: its chord is nothing, its path is not."""
    q = np.array([[0.0], [step], [2.0 * step]])
    middle = 0.5 * step
    at = 0.5 * np.array([np.cos(middle), np.sin(middle), 0.0])
    wall = obj("static", Sphere(0.004), at, name="pin")
    _, at_waypoints = judging.clearances(to(JointGoal(q[-1]), wall), wheel, q)
    assert not at_waypoints
    judgement = judging.judge(to(JointGoal(q[-1]), wall), wheel, moving(wheel, q, 9.0))
    assert {c.other for c in judgement.contacts} == {"pin"}
    assert judgement.metrics.clearance_static == pytest.approx(-0.024, abs=0.006)


def test_what_cannot_be_checked_finely_enough_is_no_success(gantry, monkeypatch):
    q = np.linspace([0.0, 0.0, 0.0], [1.0, 0.0, 0.0], 5)
    scene = to(JointGoal(q[-1]))
    assert not judging.judge(scene, gantry, moving(gantry, q)).violations
    monkeypatch.setattr("optipromp.core.judging.kinematics.MOST_CHECKS", 50)
    (violation,) = judging.judge(scene, gantry, moving(gantry, q)).violations
    assert "too far to be checked" in str(violation)
    _, fine, _, complete = judging.refined(gantry, moving(gantry, q))
    assert len(fine) <= 50 + len(q)
    assert not complete


@pytest.mark.parametrize("seed", range(4))
def test_what_is_skipped_on_the_way_is_what_cannot_matter(seed, panda, scara):
    """The sweep over a motion finds what a look at each of its configurations finds."""
    rng = np.random.default_rng(seed)
    robot = (panda, scara)[seed % 2]
    shapes = [Sphere(0.05), Box((0.3, 0.02, 0.1)), Capsule(0.03, 0.3), Cylinder(0.02, 0.2)]
    roles = ("static", "avoid", "pushable")
    objects = [
        obj(roles[i % 3], shapes[i % 4], rng.uniform(-0.7, 0.7, 3), TURN, name=f"t{i}")
        for i in range(14)
    ]
    objects.append(obj("static", HalfSpace(), np.array([0.0, 0.0, -0.2]), name="floor"))
    corners = rng.uniform(robot.lower, robot.upper, (4, robot.n_joints))
    share = np.linspace(0.0, 3.0, 120)
    q = np.array([np.interp(share, range(4), column) for column in corners.T]).T
    scene = to(JointGoal(q[-1]), *objects)
    together, contacts = judging.clearances(scene, robot, q)
    alone = [judging.clearances(scene, robot, one[None]) for one in q]
    for key, value in together.items():
        assert value == min(found[key] for found, _ in alone), key
    deepest: dict[str, float] = {}
    for contact in (contact for _, found in alone for contact in found):
        other = "itself" if contact.role == "the robot itself" else contact.other
        deepest[other] = max(deepest.get(other, 0.0), contact.depth)
    found = {"itself" if c.role == "the robot itself" else c.other: c.depth for c in contacts}
    assert found == deepest
