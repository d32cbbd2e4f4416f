"""Masses, inertias and torque limits of a URDF, against Pinocchio."""

import numpy as np
import pytest
from tests.cli.fixtures import completed
from tests.robots.links import Writer, joint

from optipromp.core.errors import InvalidRobotError
from optipromp.core.parameters import GRAVITY
from optipromp.core.robots import load_robot
from optipromp.core.robots.model import gravity_load, warn_of_gravity

INERTIAL = (
    '<inertial><origin xyz="0.02 {0} 0.1" rpy="0.3 0.2 {0}"/><mass value="{1}"/>'
    '<inertia ixx="0.02" ixy="0.001" ixz="0.002" iyy="0.03" iyz="-0.001" izz="0.025"/></inertial>'
)
BALL = '<collision><geometry><sphere radius="0.05"/></geometry></collision>'


def test_what_segments_carry(write: Writer) -> None:
    """A fixed link and a held finger count to the segment that carries them."""
    pin = pytest.importorskip("pinocchio")
    links = "".join(
        f'<link name="{name}">{INERTIAL.format(0.01 * k, 1.0 + k)}{BALL}</link>'
        for k, name in enumerate(("a", "b", "c", "mount", "finger"))
    )
    limit = '<limit lower="-1" upper="1" velocity="2" effort="{}"/>'
    joints = (
        joint("ab", "a", "b", limit=limit.format(40))
        + joint("bc", "b", "c", limit=limit.format(0))
        + joint("fix", "c", "mount", kind="fixed", limit="")
        + joint("grip", "mount", "finger", limit='<limit velocity="0" effort="1"/>')
    )
    path = write(f'<robot name="r">{links}{joints}</robot>')
    robot = load_robot(path, tip="mount")
    assert robot.joint_names == ("ab", "bc")
    assert robot.dynamics.effort.tolist() == [40.0, np.inf]
    model = pin.buildModelFromUrdf(str(path))
    held = pin.buildReducedModel(model, [model.getJointId("grip")], pin.neutral(model))
    for segment in range(2):
        theirs = held.inertias[segment + 1]
        assert robot.dynamics.mass[segment] == pytest.approx(theirs.mass)
        assert np.allclose(robot.dynamics.center[segment], theirs.lever, atol=1e-12)
        assert np.allclose(robot.dynamics.inertia[segment], theirs.inertia, atol=1e-12)


def test_a_mass_without_a_tensor(write: Writer) -> None:
    mass = '<inertial><mass value="2"/></inertial>'
    links = f'<link name="a"/><link name="b">{mass}{BALL}</link><link name="c">{BALL}</link>'
    robot = load_robot(
        write(f'<robot name="r">{links}{joint("ab", "a", "b")}{joint("bc", "b", "c")}</robot>')
    )
    assert robot.dynamics.mass.tolist() == [2.0, 0.0]
    assert not robot.dynamics.inertia.any()


def test_a_negative_mass_is_refused(write: Writer) -> None:
    mass = '<inertial><mass value="-2"/></inertial>'
    links = f'<link name="a"/><link name="b">{mass}{BALL}</link>'
    with pytest.raises(InvalidRobotError, match="mass is -2 kg"):
        load_robot(write(f'<robot name="r">{links}{joint("ab", "a", "b")}</robot>'))


@pytest.mark.parametrize("limit", ["", '<limit lower="-1" upper="1" velocity="-2"/>'])
def test_a_joint_that_is_held_needs_no_limits(write: Writer, limit: str) -> None:
    links = "".join(f'<link name="{name}">{BALL}</link>' for name in ("a", "b", "c", "wheel"))
    joints = joint("ab", "a", "b") + joint("bc", "b", "c") + joint("w", "a", "wheel", limit=limit)
    path = write(f'<robot name="r">{links}{joints}</robot>')
    assert load_robot(path, tip="c").held_joints == ("w",)
    with pytest.raises(InvalidRobotError, match=r"robot\.urdf:1.*'w'"):
        load_robot(path, tip="wheel")


def heavy(effort: float) -> str:
    links = "".join(
        f'<link name="{name}">{INERTIAL.format(0.01 * k, 1.0 + k)}{BALL}</link>'
        for k, name in enumerate("abcd")
    )
    limit = f'<limit lower="-1" upper="1" velocity="2" effort="{effort}"/>'
    joints = (
        joint("ab", "a", "b", limit=limit, axis='<axis xyz="0 1 0"/>')
        + joint("slide", "b", "c", kind="prismatic", limit=limit)
        + joint("cd", "c", "d", limit=limit, axis='<axis xyz="1 0 0"/>')
    )
    return f'<robot name="r">{links}{joints}</robot>'


def test_what_gravity_needs(write: Writer) -> None:
    pin = pytest.importorskip("pinocchio")
    path = write(heavy(50.0))
    robot, model = load_robot(path), pin.buildModelFromUrdf(str(path))
    up = np.array([0.6, 0.0, 0.8])  # of a base that leans
    model.gravity.linear = -GRAVITY * up
    q = np.random.default_rng(0).uniform(-1.0, 1.0, (20, 3))
    theirs = [pin.computeGeneralizedGravity(model, model.createData(), row) for row in q]
    np.testing.assert_allclose(gravity_load(robot, q, up), theirs, atol=1e-9)


def test_an_arm_too_weak_for_its_weight_is_told_of(write, recwarn):
    up = np.array([0.0, 0.0, 1.0])
    strong = load_robot(write(heavy(200.0), "strong.urdf"))
    recwarn.clear()
    warn_of_gravity(strong, strong.home[None], up, "at home")
    assert not recwarn
    path = write(heavy(5.0), "weak.urdf")
    weak = load_robot(path)
    recwarn.clear()
    need = np.abs(gravity_load(weak, weak.home[None], up))[0]
    warn_of_gravity(weak, weak.home[None], up, "at home")
    (told,) = [str(each.message) for each in recwarn]
    for name, load, unit in zip(weak.joint_names, need, ("N m", "N", "N m"), strict=True):
        assert (f"{name} needs {load:.3g} {unit} (at most 5)" in told) == (load > 5.0)
    assert (need > 5.0).any()
    result = completed("check", str(path))
    assert "r cannot hold itself at home" in " ".join(result.output.split())
