"""Following a tool path: exact, at rest at both ends, smooth, and as it was demonstrated."""

from collections.abc import Callable, Iterator
from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from optipromp.core.errors import Code
from optipromp.core.planning import Plan, PlanOptions, goals, plan
from optipromp.core.planning.follow import FOLLOW, Start, braked, conditioned, starts
from optipromp.core.planning.primitive import learnt
from optipromp.core.planning.task import Task, resolve
from optipromp.core.promp.model import ProMP
from optipromp.core.pushing.path import ToolPath, through
from optipromp.core.pushing.rules import rule_paths
from optipromp.core.scenes import PoseGoal, load_scene
from optipromp.core.trajectory import Trajectory
from optipromp_sim.generate import generate

SCENES = ("scenario-3", "scenario-4", ("cluster", 10), ("table-top", 2))


@cache
def task_of(which: str | tuple[str, int]) -> Task:
    return resolve(load_scene(which) if isinstance(which, str) else generate(*which))


def tool_path(task: Task) -> ToolPath:
    """The rule's path, or, where nothing is in the way, the approach line."""
    if not task.neighbours:
        return through(np.array([task.camera, task.goal.position]), 0.1)
    return through(rule_paths(task.scene, task.neighbours, task.robot, task.camera)[0], 0.1)


def followed(task: Task, promp: ProMP | None = None) -> Iterator[Start]:
    """Along every goal configuration from which the path can be followed."""
    assert isinstance(task.goal, PoseGoal)
    found, *_ = goals.choose(task, 0)
    return starts(task, tool_path(task), learnt(task, promp), PlanOptions(), found)


@cache
def first(which: str | tuple[str, int]) -> Start:
    return next(followed(task_of(which)))


# --- the path ----------------------------------------------------------------------------------


@pytest.mark.parametrize("which", SCENES)
def test_the_tool_is_on_its_path_with_the_axis_of_the_approach(which: str) -> None:
    task, start = task_of(which), first(which)
    on_path = start.followed[start.waypoints.first :]
    points, axes = task.robot.tool_pose(on_path)
    fine = start.path.at(np.linspace(0.0, 1.0, 20_000))
    away = np.linalg.norm(points[:, None] - fine[None], axis=2).min(axis=1)
    assert away.max() < FOLLOW.tracked == 1e-4
    assert (axes @ task.goal.axis).min() > np.cos(1e-3)
    # it begins where the path does, and goes on without turning back
    np.testing.assert_allclose(points[0], start.path.points[0], atol=1e-4)
    where = np.argmin(np.linalg.norm(points[:, None] - fine[None], axis=2), axis=1)
    assert (np.diff(where) >= 0).all()


@pytest.mark.parametrize("which", SCENES)
def test_a_followed_trajectory_begins_at_the_start_and_ends_at_the_goal(which: str) -> None:
    task, start = task_of(which), first(which)
    np.testing.assert_array_equal(start.followed[0], task.start)
    point, axis = task.robot.tool_pose(start.followed[-1])
    assert np.linalg.norm(point - task.goal.position) < 1e-6
    assert axis @ task.goal.axis > 1.0 - 1e-9
    np.testing.assert_array_equal(start.primitive[0], task.start)
    np.testing.assert_allclose(start.primitive[-1], start.followed[-1], atol=1e-9)
    q, robot = start.followed, task.robot
    assert (robot.lower <= q).all()
    assert (q <= robot.upper).all()


@pytest.mark.parametrize("which", SCENES)
def test_it_begins_and_ends_at_rest(which: str) -> None:
    for q in (first(which).primitive, first(which).followed):
        steps = np.abs(np.diff(q, axis=0)).max(axis=1)
        assert steps[0] < 0.1 * steps.max()
        assert steps[-1] < 0.1 * steps.max()


@given(st.integers(2, 400))
def test_a_braked_tool_comes_to_rest_at_the_end(count: int) -> None:
    """At constant speed at first; then speed and acceleration go to nothing."""
    share = np.linspace(0.0, 1.0, count)
    gone = braked(share)
    np.testing.assert_allclose(gone[[0, -1]], [0.0, 1.0], atol=1e-12)
    assert (np.diff(gone) > 0.0).all()
    near = braked(np.array([1.0 - 1e-4, 1.0]))
    assert near[1] - near[0] < 1e-7
    early = braked(np.array([0.1, 0.2, 0.3]))
    np.testing.assert_allclose(np.diff(early, 2), 0.0, atol=1e-12)


@pytest.mark.parametrize("which", SCENES[:2])
def test_the_conditioned_primitive_passes_its_stations_within_millimetres(which: str) -> None:
    """Ends exactly and at rest; tool points and axes nearly: inverse kinematics does the rest."""
    task, start = task_of(which), first(which)
    promp = learnt(task, None)
    share = np.linspace(0.0, 1.0, FOLLOW.stations)
    z0 = start.waypoints.phases[start.waypoints.first]
    phases = z0 + (1.0 - z0) * share
    goal = start.followed[-1]
    near = start.followed[np.rint(phases * (len(start.followed) - 1)).astype(int)]
    weights = conditioned(
        task.robot, promp, task.start, goal, start.path.at(share), task.axes(share), near, phases
    )
    q = promp.basis.evaluate(np.concatenate([[0.0], phases])) @ weights.T
    np.testing.assert_allclose(q[0], task.start, atol=1e-4)
    np.testing.assert_allclose(q[-1], goal, atol=1e-4)
    points, axes = task.robot.tool_pose(q[1:])
    assert np.linalg.norm(points - start.path.at(share), axis=1).max() < 0.01
    assert (axes @ task.goal.axis).min() > np.cos(np.deg2rad(3.0))
    slopes = promp.basis.evaluate(np.array([0.0, 1.0]), 1) @ weights.T
    assert np.abs(slopes).max() < 0.05 * np.abs(np.diff(q, axis=0)).max() / np.diff(phases).max()


# --- demonstrations ----------------------------------------------------------------------------


def elbow_out(task: Task) -> ProMP:
    """Motions like the built-in ones, shown ten times alike, with joint 3 half a turn further."""
    promp = learnt(task, None)
    mean = promp.mean.copy()
    mean[2] += 0.5 * np.pi * np.sin(np.linspace(0.0, np.pi, promp.mean.shape[1]))
    return promp.with_weights(mean, 0.1 * promp.covariance)


def scrambled(task: Task) -> ProMP:
    """The same motions with joints 1, 3, 5 and 7 told as one another's."""
    promp = learnt(task, None)
    order = np.array([2, 1, 4, 3, 6, 5, 0])
    n, k = promp.mean.shape
    covariance = promp.covariance.reshape(n, k, n, k)[order][:, :, order].reshape(n * k, n * k)
    return promp.with_weights(promp.mean[order], covariance)


@pytest.mark.parametrize("shown", [elbow_out, scrambled])
def test_other_demonstrations_make_another_plan(shown: Callable[[Task], ProMP]) -> None:
    """On the last 60 % of the motion, all the way through the solve."""
    apart, z = [], np.linspace(0.4, 1.0, 61)
    for which in ("scenario-3", "scenario-4", *[("cluster", seed) for seed in range(8, 13)]):
        task = task_of(which)
        own, other = plan(task.scene), plan(task.scene, demonstrations=shown(task))
        assert own.success
        assert other.success
        one, two = (
            np.array([np.interp(z, np.linspace(0.0, 1.0, len(q)), joint) for joint in q.T])
            for q in (own.trajectory.positions, other.trajectory.positions)
        )
        apart.append(np.abs(one - two).max())
    assert np.median(apart) > 0.08
    assert min(apart) > 0.03


# --- smoothness --------------------------------------------------------------------------------


def rms_acceleration(trajectory: Trajectory, duration: float = 1.0) -> float:
    """Root mean square acceleration of all joints, at a given duration [rad/s²]."""
    q = trajectory.positions
    return float(np.sqrt(np.mean(np.diff(q, 2, axis=0) ** 2))) * ((len(q) - 1) / duration) ** 2


@cache
def generated() -> tuple[Plan, ...]:
    """Twelve scenes of the three presets in which something hangs or stands before an arm."""
    chosen = [(preset, seed) for preset in ("cluster", "table-top") for seed in range(6)]
    return tuple(plan(generate(preset, seed)) for preset, seed in chosen)


def test_a_plan_is_about_as_smooth_as_the_primitive_that_it_came_from() -> None:
    plans = [made for made in generated() if made.status is not Code.GOAL_UNREACHABLE]
    assert len(plans) == 12
    ratios = [rms_acceleration(p.trajectory) / rms_acceleration(p.initial) for p in plans]
    assert np.median(ratios) <= 2.0


def test_three_trajectories_have_the_same_waypoints_and_ends() -> None:
    for made in generated():
        q = made.initial.positions, made.followed.positions, made.trajectory.positions
        assert q[0].shape == q[1].shape == q[2].shape
        for positions in q:
            np.testing.assert_array_equal(positions[0], made.scene.start)
        np.testing.assert_allclose(q[0][-1], q[1][-1], atol=1e-9)
