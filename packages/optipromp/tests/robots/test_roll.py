"""A hand is rolled level by the joint that does nothing else, and only by that."""

import numpy as np
import pytest
from tests.robots.builders import Spoon, mesh_cup

from optipromp.core.robots import Cup, FingerGripper, FrankaHand, Scissor, ik, with_tool
from optipromp.core.robots.ik import level, rolls
from optipromp.core.robots.library import load_robot

DOWN = np.array([0.0, 0.0, -1.0])


@pytest.fixture(
    scope="module", params=[FrankaHand(), FingerGripper(0.06, turn=0.4), Scissor(0.05)],
    ids=lambda tool: type(tool).__name__,
)  # fmt: skip
def panda(request):
    return with_tool(load_robot("panda"), request.param)


def opening(robot, q):
    """(m, 3) directions in which the hand opens."""
    _, turns = robot.segment_frames(q)
    return (turns[:, -1] @ robot.flange_rotation @ robot.tool.rotation)[:, :, 1]


def sampled(robot, count=200):
    rng = np.random.default_rng(3)
    return rng.uniform(robot.lower, robot.upper, (count, robot.n_joints))


def test_the_hand_opens_level_and_the_tool_stays(panda):
    q = sampled(panda)
    out = level(panda, q, DOWN)
    assert np.abs(opening(panda, out) @ DOWN).max() < 1e-9
    assert (panda.lower <= out).all()
    assert (out <= panda.upper).all()
    for before, after in zip(panda.tool_pose(q), panda.tool_pose(out), strict=True):
        np.testing.assert_allclose(after, before, atol=1e-9)
    np.testing.assert_array_equal(out[:, :-1], q[:, :-1])
    np.testing.assert_allclose(level(panda, out, DOWN), out, atol=1e-9)


def test_a_path_keeps_its_roll(panda):
    line = np.array([0.4, -0.1, 0.5]) + np.linspace(0, 1, 60)[:, None] * [0.2, 0.25, 0.0]
    begin = ik.solve(panda, line[0], np.array([1.0, 0.0, 0.0])).joints[0]
    q, errors = ik.track(panda, line, np.tile([1.0, 0.0, 0.0], (60, 1)), begin)
    assert errors.max() < 1e-6
    out = level(panda, q, DOWN, path=True)
    assert np.abs(opening(panda, out) @ DOWN).max() < 1e-9
    assert np.abs(np.diff(out[:, -1])).max() < 0.2


def test_a_round_tool_and_a_bare_arm_stay_as_they_are():
    panda = load_robot("panda")
    for robot in (panda, *(with_tool(panda, tool) for tool in (Cup(0.05), mesh_cup(), Spoon()))):
        q = sampled(robot, 5)
        np.testing.assert_array_equal(level(robot, q, DOWN), q)


def test_a_joint_that_moves_the_tool_is_no_roll():
    assert rolls(with_tool(load_robot("panda"), FrankaHand()))
    assert not rolls(load_robot("scara"))
