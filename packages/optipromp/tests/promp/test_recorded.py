"""The recorded Panda demonstrations with the Panda itself."""

import numpy as np
import pytest

from optipromp.core.promp import Demonstrations, JointPoint, TaskPoint, condition_with_report, fit

library = pytest.importorskip("optipromp.core.robots.library")
START = np.array([0.0, 0.0, 0.0, -0.1, 0.0, 0.0, 0.8])


def test_reaches_around_from_below(recorded: Demonstrations) -> None:
    """Scenario III in outline: camera point, two drifts, target with the tool upright."""
    robot = library.load_robot("panda")
    promp = fit(recorded)
    target, up = np.array([0.45, 0.0, 0.89]), np.array([0.0, 0.0, 1.0])
    points = [
        JointPoint(0.0, START),
        TaskPoint(0.5, target - [0.0, 0.0, 0.25], up, covariance=1e-4, axis_covariance=1e-2),
        TaskPoint(0.7, target + [0.0, -0.05, -0.136], covariance=1e-4),
        TaskPoint(0.85, target + [0.0, 0.05, -0.06], covariance=1e-4),
        TaskPoint(1.0, target, up),
    ]
    result, report = condition_with_report(promp, points, robot.tool_map)
    assert report.missed == ()
    np.testing.assert_allclose(result.mean_trajectory([0.0])[0], START, atol=1e-9)
    point, axis = robot.tool_pose(result.mean_trajectory([1.0])[0])
    np.testing.assert_allclose(point, target, atol=1e-6)
    np.testing.assert_allclose(axis, up, atol=1e-6)
    assert (report.position_error[:-1] < 0.1).all()


def test_reaches_poses_all_over(recorded: Demonstrations) -> None:
    robot = library.load_robot("panda")
    promp = fit(recorded)
    rng = np.random.default_rng(0)
    missed = 0
    for q in rng.uniform(robot.lower, robot.upper, size=(40, 7)):
        point, axis = robot.tool_pose(q)
        points = [JointPoint(0.0, START), TaskPoint(1.0, point, axis)]
        _, report = condition_with_report(promp, points, robot.tool_map)
        missed += bool(report.missed)
    assert missed == 0
