"""What an FR3 would abort: one motion that is allowed, and one that breaks each condition."""

from itertools import pairwise
from pathlib import Path

import numpy as np
import pinocchio
import pytest

import optipromp
from optipromp.core.arrays import FloatArray
from optipromp.core.errors import InvalidRequestError
from optipromp.core.robots.library import load_robot
from optipromp.core.trajectory import Trajectory
from optipromp_loop.control import fr3
from optipromp_loop.control.fr3 import Foreseen, foreseen

PANDA = load_robot("panda")
URDF = Path(optipromp.__file__).parent / "core/robots/data/panda.urdf"
UP = np.array([0.0, 0.0, 1.0])
STILL = np.zeros(7)
MIDDLE = np.array([0.3, -0.2, 0.1, -1.9, 0.1, 1.7, 0.6])
VELOCITY, ACCELERATION = "joint_velocity_violation", "joint_motion_generator_velocity_discontinuity"
JERK = "joint_motion_generator_acceleration_discontinuity"


def of(joint: int, value: float) -> FloatArray:
    return value * np.eye(7)[joint - 1]


def rows(*states: tuple[float, FloatArray, FloatArray, FloatArray]) -> Trajectory:
    """A curve of times, positions, velocities and accelerations."""
    times, *motion = (np.array(column) for column in zip(*states, strict=True))
    return Trajectory(times, *motion, PANDA.joint_names)


def step(by: FloatArray, duration: float, begin: FloatArray = MIDDLE) -> Trajectory:
    return rows((0.0, begin, STILL, STILL), (duration, begin + by, STILL, STILL))


def jerked(joint: int, q: FloatArray, *accelerations: float) -> Trajectory:
    """Of a joint from rest at ``q``: accelerations after each millisecond, linear in between."""
    states, v = [(0.0, q, STILL, STILL)], STILL
    for k, (before, after) in enumerate(pairwise((0.0, *accelerations))):
        q = q + 0.001 * v + of(joint, 1e-6 * (before / 3.0 + after / 6.0))
        v = v + of(joint, 0.0005 * (before + after))
        states.append((0.001 * (k + 1), q, v, of(joint, after)))
    return rows(*states)


def at_speed(joint: int, q: float, speed: float) -> Trajectory:
    """0.02 s at a constant velocity, the joint at ``q`` midway."""
    begin = np.array(MIDDLE)
    begin[joint - 1] = q - 0.01 * speed
    moves = of(joint, speed)
    return rows((0.0, begin, moves, STILL), (0.02, begin + 0.02 * moves, moves, STILL))


def told(curve: Trajectory) -> Foreseen:
    return foreseen(PANDA, curve, UP)


def kinds(curve: Trajectory) -> set[tuple[str, str]]:
    return {(each.kind, each.subject) for each in told(curve).violations}


def test_a_slow_motion_is_allowed() -> None:
    found = told(step(np.full(7, 0.2), 2.0))
    assert found.violations == ()
    assert all(0.0 < share < 1.0 for share in found.shares.values())
    assert found.shares["velocity"] == pytest.approx(1.875 * 0.1 / 2.62, rel=0.01)
    assert found.shares["acceleration"] == pytest.approx(5.7735 * 0.2 / 4.0 / 10.0, rel=0.01)
    assert found.shares["jerk"] == pytest.approx(60.0 * 0.2 / 8.0 / 5000.0, rel=0.01)


@pytest.mark.parametrize(
    ("joint", "end"), [(1, 2.75), (2, -1.785), (4, -0.15), (4, -3.05), (6, 0.54), (7, -3.02)]
)
def test_a_position_beyond_a_limit(joint: int, end: float) -> None:
    """The built-in Panda allows joints 4 and 6 more than an FR3 does."""
    begin = np.array(MIDDLE)
    begin[joint - 1] = end - np.sign(end - MIDDLE[joint - 1]) * 0.1
    found = told(step(of(joint, end - begin[joint - 1]), 5.0, begin)).violations
    (one,) = [each for each in found if each.kind == "joint_position_limits_violation"]
    assert one.subject == f"joint{joint}"
    assert one.time == pytest.approx(5.0)
    lower, upper = fr3.LOWER[joint - 1], fr3.UPPER[joint - 1]
    assert one.amount == pytest.approx(max(lower - end, end - upper))
    assert f"the position of joint{joint} is {end:.5g} rad at 5.000 s" in one.message
    assert one.message.endswith(f"an FR3 allows {lower:.5g} to {upper:.5g} rad")


@pytest.mark.parametrize("joint", range(1, 8))
def test_the_velocity_that_is_allowed_falls_towards_a_limit(joint: int) -> None:
    """The formula of libfranka's rate_limiting.h, for a position 0.1 rad before the end."""
    factor = [12.0, 5.17, 7.0, 8.0, 34.0, 11.0, 34.0][joint - 1]
    offset = [0.30, 0.20, 0.20, 0.30, 0.35, 0.35, 0.35][joint - 1]
    upper = [2.7501, 1.7918, 2.9065, -0.1458, 2.8101, 4.5205, 3.0196][joint - 1]
    lower = [-2.7501, -1.7918, -2.9065, -3.0481, -2.8101, 0.54092, -3.0196][joint - 1]
    most = (factor * 0.1) ** 0.5 - offset
    for q, way in ((upper - 0.1, 1.0), (lower + 0.1, -1.0)):
        assert kinds(at_speed(joint, q, way * 0.9 * most)) == set()
        assert (VELOCITY, f"joint{joint}") in kinds(at_speed(joint, q, way * 1.1 * most))
        assert kinds(at_speed(joint, q, -way * 1.1 * most)) == set()  # away from the limit
    middle = 0.5 * (lower + upper)
    assert (VELOCITY, f"joint{joint}") in kinds(
        at_speed(joint, middle, 1.01 * fr3.VELOCITY[joint - 1])
    )


def test_a_velocity_is_told_with_its_place_and_limit() -> None:
    (one,) = told(at_speed(1, 2.6501, 1.0)).violations
    assert one.message.startswith(
        "the velocity of joint1 is 1 rad/s at 0.020 s and 2.6601 rad; an FR3 allows -2.62 to 0.7"
    )
    assert one.time == pytest.approx(0.02)


def test_an_acceleration_beyond_the_limit() -> None:
    """5.77 h / T^2 of a quintic: 10.1 rad/s^2; its jerk is 60 h / T^3 = 240 rad/s^3."""
    assert kinds(step(of(7, 0.3), (5.7735 * 0.3 / 9.9) ** 0.5)) == set()
    found = told(step(of(7, 0.3), (5.7735 * 0.3 / 10.1) ** 0.5)).violations
    assert [(each.kind, each.subject) for each in found] == [(ACCELERATION, "joint7")]
    assert "an FR3 allows -10 to 10 rad/s^2" in found[0].message


def test_a_jerk_beyond_the_limit() -> None:
    """The acceleration rises to 6 rad/s^2 within 1 ms: 6,000 rad/s^3."""
    for a, expected in ((4.0, set()), (6.0, {(JERK, "joint7")})):
        assert kinds(jerked(7, MIDDLE, a, a, 0.0)) == expected


def test_a_torque_beyond_the_limit() -> None:
    """Stretched out level, joint 2 carries the arm; braking its fall at 9.9 rad/s^2 is too much."""
    level = np.array([0.0, 1.2, 0.0, -0.2, 0.0, 1.8, 0.0])
    moves = of(2, 0.4)
    assert kinds(step(moves, 2.0, level)) == set()
    found = told(step(moves, (5.7735 * 0.4 / 9.9) ** 0.5, level)).violations
    torque = [each for each in found if each.kind == "tau_J_range_violation"]
    assert [each.subject for each in torque] == ["joint2"]
    assert "an FR3 allows -87 to 87 N m" in torque[0].message


def test_a_torque_that_changes_too_fast() -> None:
    """4,000 rad/s^3 at joint 2 is within its limit; the torque's rate is not."""
    stretched = np.array([0.0, 1.2, 0.0, -0.2, 0.0, 1.8, 0.0])
    found = kinds(jerked(2, stretched, 4.0, 4.0, 0.0, 0.0))
    assert ("controller_torque_discontinuity", "joint2") in found
    assert JERK not in {kind for kind, _ in found}


def test_torques_are_those_of_pinocchio() -> None:
    model = pinocchio.buildModelFromUrdf(str(URDF))
    for joint in range(7):
        model.inertias[joint + 1] = pinocchio.Inertia.Zero()
    for body, joint in enumerate(fr3.CARRIES):
        mass, centre = fr3.BODIES[body, 0], fr3.BODIES[body, 1:4]
        model.inertias[int(joint) + 1] += pinocchio.Inertia(mass, centre, fr3.TENSORS[body])
    data = model.createData()
    curve = step(np.array([0.5, -0.4, 0.6, -0.5, 0.7, 0.4, -0.8]), 0.7)
    times = np.arange(0.0, 0.7, 0.001)
    motion = curve.sample(times)
    found = fr3.torques(PANDA, times, motion[0], motion[1], UP)
    wanted = np.array([pinocchio.rnea(model, data, *state) for state in zip(*motion, strict=True)])
    assert np.abs(wanted).max() > 10.0
    inner = slice(3, -3)  # at the ends differences are one-sided
    assert np.abs(found - wanted)[inner].max() < 0.01


def test_no_other_arm_is_a_franka() -> None:
    scara = load_robot("scara")
    still_scara = Trajectory.still(scara.home, (0.0, 1.0), scara.joint_names)
    with pytest.raises(InvalidRequestError, match=r"scara has 3 joints.*franka moves 7 joints"):
        foreseen(scara, still_scara, UP)
