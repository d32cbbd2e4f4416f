"""The judge's extremes of a curve are exact: never below a dense sample, never far above."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import BPoly
from tests.judging.builders import to

from optipromp.core import judging
from optipromp.core.robots.model import Robot
from optipromp.core.scenes import JointGoal
from optipromp.core.trajectory import State, Trajectory


@given(seed=st.integers(0, 100_000), wild=st.floats(0.01, 50.0))
@settings(max_examples=80, deadline=None)
def test_extremes_bound_a_dense_sample_and_are_reached(seed: int, wild: float) -> None:
    rng = np.random.default_rng(seed)
    times = np.append(0.0, rng.uniform(0.05, 0.5, 4).cumsum())
    rows = rng.normal(size=(3, 5, 2)) * np.array([1.0, wild, wild**2])[:, None, None]
    curve = Trajectory(times, *rows, ("a", "b"))
    found = judging.extremes(curve)
    pieces = BPoly.from_derivatives(times, list(rows.transpose(1, 0, 2)))
    dense = np.concatenate(
        [np.linspace(a, b, 2001)[:-1] for a, b in pairwise(times)] + [times[-1:]]
    )
    values = pieces(dense)
    scale = np.ptp(values, axis=0)
    assert (found.lowest <= values.min(axis=0) + 1e-9 * scale).all()
    assert (found.highest >= values.max(axis=0) - 1e-9 * scale).all()
    missed = 0.5 * found.largest[1] * (0.5 * np.diff(dense).max()) ** 2  # by the sample, at most
    assert (found.lowest >= values.min(axis=0) - missed).all()
    assert (found.highest <= values.max(axis=0) + missed).all()
    for order in (1, 2, 3):
        largest = np.abs(pieces.derivative(order)(dense)).max(axis=0)
        assert (found.largest[order - 1] >= largest * (1.0 - 1e-9)).all()
        np.testing.assert_allclose(found.largest[order - 1], largest, rtol=5e-3)
        for joint in range(2):  # and they occur when it says
            at = np.clip(found.when[order + 1, joint] + np.array([-1e-13, 1e-13]), 0, times[-1])
            there = np.abs(pieces.derivative(order)(at)[:, joint]).max()
            assert there == pytest.approx(found.largest[order - 1, joint], rel=1e-6)


def smooth(robot: Robot, dt: float) -> Trajectory:
    share = np.linspace(0.0, 1.0, 20)[:, None]
    q = robot.home + (0.3 * share**3 * (10 - 15 * share + 6 * share**2)) * np.eye(robot.n_joints)[0]
    return Trajectory.through(q, dt, robot.joint_names)


def judged(robot: Robot, curve: Trajectory, start: State | None = None) -> judging.Judgement:
    return judging.judge(to(JointGoal(curve.positions[-1])), robot, curve, start)


def test_a_limit_that_is_broken_between_waypoints_only(panda: Robot) -> None:
    """At the waypoints velocities and accelerations are zero; between them they are not."""
    slow = smooth(panda, 0.05)
    assert not judged(panda, slow).violations
    q = panda.home + np.linspace(0.0, 0.4, 3)[:, None] * np.eye(7)[1]
    stops = Trajectory(
        0.22 * np.arange(3), q, np.zeros((3, 7)), np.zeros((3, 7)), panda.joint_names
    )
    found = {v.kind: v for v in judged(panda, stops).violations}
    assert set(found) == {"acceleration"}
    peak = 10.0 / np.sqrt(3.0) * 0.2 / 0.22**2  # of the quintic from rest to rest
    assert found["acceleration"].amount == pytest.approx(peak / panda.acceleration[1], rel=1e-9)
    assert found["acceleration"].subject == panda.joint_names[1]


def test_a_motion_that_does_not_begin_in_its_state_or_end_at_rest(panda: Robot) -> None:
    curve = smooth(panda, 0.05)
    half = curve.resample(200.0)
    cut = len(half.times) // 2
    rows = [values[: cut + 1] for values in (half.positions, half.velocities, half.accelerations)]
    early = Trajectory(half.times[: cut + 1], *rows, panda.joint_names)
    (end,) = [v for v in judged(panda, early).violations if v.kind == "motion"]
    assert end.time == early.duration
    assert "ends with velocity" in end.message
    rows = [values[cut:] for values in (half.positions, half.velocities, half.accelerations)]
    late = Trajectory(half.times[cut:] - half.times[cut], *rows, panda.joint_names)
    assert {v.kind for v in judged(panda, late).violations} == {"motion"}
    assert not judged(panda, late, half.at(half.times[cut])).violations
    moved = State(half.positions[cut] + 1e-3, half.velocities[cut], half.accelerations[cut])
    assert {v.kind for v in judged(panda, late, moved).violations} == {"start"}
