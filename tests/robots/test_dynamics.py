"""Masses, inertias and torque limits of a URDF, against Pinocchio."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from optipromp.errors import InvalidRobotError
from optipromp.robots import load_robot

INERTIAL = (
    '<inertial><origin xyz="0.02 {0} 0.1" rpy="0.3 0.2 {0}"/><mass value="{1}"/>'
    '<inertia ixx="0.02" ixy="0.001" ixz="0.002" iyy="0.03" iyz="-0.001" izz="0.025"/></inertial>'
)
BALL = '<collision><geometry><sphere radius="0.05"/></geometry></collision>'


def test_what_segments_carry(write: Callable[..., Path], joint: Callable[..., str]) -> None:
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
    assert robot.dynamics is not None
    assert robot.dynamics.effort.tolist() == [40.0, np.inf]
    model = pin.buildModelFromUrdf(str(path))
    held = pin.buildReducedModel(model, [model.getJointId("grip")], pin.neutral(model))
    for segment in range(2):
        theirs = held.inertias[segment + 1]
        assert robot.dynamics.mass[segment] == pytest.approx(theirs.mass)
        assert np.allclose(robot.dynamics.center[segment], theirs.lever, atol=1e-12)
        assert np.allclose(robot.dynamics.inertia[segment], theirs.inertia, atol=1e-12)


def test_a_mass_without_a_tensor(write: Callable[..., Path], joint: Callable[..., str]) -> None:
    mass = '<inertial><mass value="2"/></inertial>'
    links = f'<link name="a"/><link name="b">{mass}{BALL}</link><link name="c">{BALL}</link>'
    robot = load_robot(
        write(f'<robot name="r">{links}{joint("ab", "a", "b")}{joint("bc", "b", "c")}</robot>')
    )
    assert robot.dynamics is not None
    assert robot.dynamics.mass.tolist() == [2.0, 0.0]
    assert not robot.dynamics.inertia.any()


def test_a_negative_mass_is_refused(write: Callable[..., Path], joint: Callable[..., str]) -> None:
    mass = '<inertial><mass value="-2"/></inertial>'
    links = f'<link name="a"/><link name="b">{mass}{BALL}</link>'
    with pytest.raises(InvalidRobotError, match="mass is -2 kg"):
        load_robot(write(f'<robot name="r">{links}{joint("ab", "a", "b")}</robot>'))


@pytest.mark.parametrize("limit", ["", '<limit lower="-1" upper="1" velocity="-2"/>'])
def test_a_joint_that_is_held_needs_no_limits(
    write: Callable[..., Path], joint: Callable[..., str], limit: str
) -> None:
    links = "".join(f'<link name="{name}">{BALL}</link>' for name in ("a", "b", "c", "wheel"))
    joints = joint("ab", "a", "b") + joint("bc", "b", "c") + joint("w", "a", "wheel", limit=limit)
    path = write(f'<robot name="r">{links}{joints}</robot>')
    assert load_robot(path, tip="c").held_joints == ("w",)
    with pytest.raises(InvalidRobotError, match=r"robot\.urdf:1.*'w'"):
        load_robot(path, tip="wheel")
