"""Timing: every limit kept at every instant, and little time wasted."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from optipromp.core import judging
from optipromp.core.planning.timing import shortest
from optipromp.core.robots.library import load_robot
from optipromp.core.robots.model import Robot
from optipromp.core.trajectory import Trajectory

ARMS = {name: load_robot(name) for name in ("panda", "scara")}


def reach(robot: Robot, seed: int, count: int) -> np.ndarray:
    """Waypoints of a smooth random motion, evenly spaced in its own time, with moving ends."""
    rng = np.random.default_rng(seed)
    share = np.linspace(0.0, 1.0, count)[:, None]
    shapes = np.hstack([share, share**2, np.sin(3.0 * share), share**3])
    return robot.home + rng.uniform(0.02, 0.5) * shapes @ rng.normal(size=(4, robot.n_joints))


def shares(robot: Robot, curve: Trajectory) -> np.ndarray:
    limits = np.stack([robot.velocity, robot.acceleration, robot.jerk])
    return np.asarray((judging.extremes(curve).largest / limits).max(axis=1))


@given(seed=st.integers(0, 100_000), arm=st.sampled_from(sorted(ARMS)), count=st.integers(10, 150))
@settings(max_examples=60, deadline=None)
def test_no_limit_is_exceeded_and_one_is_nearly_reached(seed: int, arm: str, count: int) -> None:
    robot = ARMS[arm]
    q = reach(robot, seed, count)
    curve = shortest(robot, q)
    np.testing.assert_array_equal(curve.positions, q)
    assert not curve.velocities[[0, -1]].any()
    assert not curve.accelerations[[0, -1]].any()
    use = shares(robot, curve)
    assert (use <= 1.0).all()
    assert (use ** np.array([1.0, 1.0 / 2.0, 1.0 / 3.0])).max() > 0.8  # the hull is near the curve
    even = Trajectory.through(q, 1.0, robot.joint_names)
    stretch = (shares(robot, even) ** (1.0 / np.arange(1, 4))).max()
    assert curve.duration <= 1.02 * even.duration * stretch


@pytest.mark.parametrize("arm", sorted(ARMS))
def test_the_tool_stays_slow_where_it_is_asked_to(arm: str) -> None:
    robot = ARMS[arm]
    for seed in range(5):
        q = reach(robot, seed, 50)
        for speed in (0.02, 0.3):
            curve = shortest(robot, q, 20, speed)
            points, _ = robot.tool_pose(curve.positions[20:])
            mean = np.linalg.norm(np.diff(points, axis=0), axis=1) / np.diff(curve.times[20:])
            assert mean.max() <= speed * (1.0 + 1e-9)
            assert (shares(robot, curve) <= 1.0).all()


def toppra_duration(robot: Robot, q: np.ndarray) -> float:
    """Duration of the time-optimal motion along waypoints (T, n), as TOPP-RA finds it [s].

    TOPP-RA knows no limit of jerk, so that no motion that keeps all limits is shorter.
    """
    ta = pytest.importorskip("toppra")
    gone = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(q, axis=0), axis=1)))
    both = np.array([-1.0, 1.0])
    limits = [
        ta.constraint.JointVelocityConstraint(robot.velocity[:, None] * both),
        ta.constraint.JointAccelerationConstraint(robot.acceleration[:, None] * both),
    ]
    optimum = ta.algorithm.TOPPRA(
        limits,
        ta.SplineInterpolator(gone, q),
        parametrizer="ParametrizeConstAccel",
        gridpoints=np.linspace(0.0, gone[-1], 400),
    )
    return float(optimum.compute_trajectory(0.0, 0.0).duration)


@pytest.mark.parametrize("seed", range(4))
def test_a_free_motion_beside_topp_ra(seed: int) -> None:
    """Longer than the optimum without a limit of jerk, by less than half; measured: 1.2 to 1.35."""
    robot = load_robot("panda")
    q = reach(robot, seed, 60)
    ratio = shortest(robot, q).duration / toppra_duration(robot, q)
    assert 0.99 < ratio < 1.5


def test_no_motion_and_no_limits_have_some_timing() -> None:
    robot = ARMS["panda"]
    still = shortest(robot, np.tile(robot.home, (4, 1)))
    assert still.duration > 0.0
    none = np.full(7, np.inf)
    free = replace(robot, velocity=none, acceleration=none, jerk=none)
    assert 0.0 < shortest(free, reach(robot, 0, 10)).duration < 0.1
