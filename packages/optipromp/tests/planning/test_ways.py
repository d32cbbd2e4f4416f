"""Ways round obstacles: the search, its shortcuts, and the plans that begin on them."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.furniture import FURNITURE, Furniture, generate
from optipromp.core import judging
from optipromp.core.arrays import FloatArray
from optipromp.core.compiled import kernel
from optipromp.core.geometry.shapes import Cylinder
from optipromp.core.planning import PlanOptions, collision, follow, plan
from optipromp.core.planning.parameters import TREE, WAYPOINT
from optipromp.core.planning.task import Task, resolve
from optipromp.core.scenes.pose import Pose
from optipromp.core.scenes.scene import JointGoal, PoseGoal, Scene, SceneObject
from optipromp_sim import generate as scenes

NONE = np.zeros((0, 7))
COUNT = 8  # scenes of a family


@kernel
def all_blocked(body, q, out):  # type: ignore[no-untyped-def]
    for i in range(len(q)):
        out[i] = collision.blocked(body, q[i])


def task_of(family: Furniture, seed: int) -> Task:
    return resolve(generate(family, seed))


def way_of(task: Task, seed: int = 0) -> FloatArray:
    found = collision.way(task, task.goal.joints[None], NONE, np.random.default_rng(seed))
    assert found is not None
    return found


def length(corners: FloatArray) -> float:
    return float(np.linalg.norm(np.diff(corners, axis=0), axis=1).sum())


@pytest.mark.parametrize("family", FURNITURE)
def test_goals_among_furniture_are_reached(family: Furniture) -> None:
    for seed in range(7000, 7000 + COUNT):
        scene = generate(family, seed)
        made = plan(scene)
        assert made.success, (family, seed, made.message)
        np.testing.assert_allclose(made.trajectory.positions[-1], scene.goal.joints, atol=1e-9)


@pytest.mark.parametrize("family", FURNITURE)
def test_poses_of_the_tool_among_furniture_are_reached_on_any_branch(family: Furniture) -> None:
    for seed in range(7050, 7050 + COUNT):
        scene = generate(family, seed)
        point, axis = resolve(scene).robot.tool_pose(scene.goal.joints)
        made = plan(replace(scene, goal=PoseGoal(point, axis)))
        assert made.success, (family, seed, made.message)
        there, along = made.robot.tool_pose(made.trajectory.positions[-1])
        np.testing.assert_allclose(there, point, atol=1e-3)
        assert along @ axis > np.cos(np.deg2rad(1.0))


@pytest.mark.parametrize("family", FURNITURE)
def test_the_search_calls_blocked_what_the_judge_finds_in_contact(family: Furniture) -> None:
    task = task_of(family, 7100)
    rng = np.random.default_rng(1)
    q = rng.uniform(task.robot.lower, task.robot.upper, (400, 7))
    found = np.empty(len(q), dtype=np.bool_)
    all_blocked(collision.collider(task, task.surroundings.shared), q, found)
    judged = [bool(judging.clearances(task.scene, task.robot, one[None])[1]) for one in q]
    assert found.tolist() == judged
    assert 0 < found.sum() < len(q)


@pytest.mark.parametrize("family", FURNITURE)
def test_a_way_leads_from_the_start_to_the_goal_through_free_places(family: Furniture) -> None:
    task = task_of(family, 7200)
    corners = way_of(task)
    np.testing.assert_array_equal(corners[0], task.start)
    np.testing.assert_array_equal(corners[-1], task.goal.joints)
    fine = np.vstack([a + u * (b - a) for a, b in itertools.pairwise(corners)
                      for u in np.linspace(0.0, 1.0, 30)[:, None]]).reshape(-1, 7)  # fmt: skip
    _, contacts = judging.clearances(task.scene, task.robot, fine)
    # between the places that are checked the body moves by TREE.step at most
    assert max((contact.depth for contact in contacts), default=0.0) < 0.5 * TREE.step


def test_the_same_seed_gives_the_same_way() -> None:
    task = task_of("cage", 7300)
    np.testing.assert_array_equal(way_of(task, 3), way_of(task, 3))


def test_shortcuts_shorten_and_keep_both_ends() -> None:
    for seed in range(7400, 7410):
        task = task_of("under-table", seed)
        body, rng = collision.collider(task, 0), np.random.default_rng(seed)
        grown = collision._grown(
            body, task.robot, task.start, task.goal.joints[None], NONE, rng, None
        )
        places = np.sort(rng.random((collision.TREE.shortcuts, 2)), axis=1)
        short = collision.shorten(body, grown, places, np.empty(grown.shape[1]))
        np.testing.assert_array_equal(short[[0, -1]], grown[[0, -1]])
        straight = float(np.linalg.norm(grown[-1] - grown[0]))
        assert straight - 1e-9 <= length(short) <= length(grown) + 1e-9


def test_where_no_way_leads_the_plan_says_what_it_touches() -> None:
    post = SceneObject("post", "static", Cylinder(0.02, 3.0), np.array([0.03, 0.22, 0.0]))
    start, goal = np.array([0.1, 0.2, 0.0]), JointGoal(np.array([0.1, 2.9, 0.0]))
    scene = Scene(name="no way", robot="scara", objects=(post,), start=start, goal=goal)
    assert (
        collision.way(resolve(scene), goal.joints[None], NONE[:, :3], np.random.default_rng(0))
        is None
    )
    made = plan(scene)
    assert made.status == "INVALID_PLAN"
    assert "post (static)" in made.message


@pytest.mark.parametrize("family", ["under-table", "cage", "box"])
def test_most_arms_that_start_in_furniture_come_out_and_pick(family: Furniture) -> None:
    picked = 0
    for seed in range(504, 509):
        made = plan(from_furniture(family, seed))
        picked += made.success
        assert 0 < made.first < len(made.trajectory.positions) - 1
    assert picked >= 4


def from_furniture(family: Furniture, seed: int) -> Scene:
    """A cluster, and furniture behind the robot in which the arm begins."""
    cluster, other = scenes.generate("cluster", 2500 + seed), generate(family, seed)
    turn = 2.0 if other.goal.joints[0] < 0 else -2.0
    start = np.array(other.goal.joints)
    start[0] += turn
    half = Pose(np.zeros(3), np.array([np.cos(0.5 * turn), 0.0, 0.0, np.sin(0.5 * turn)]))
    moved = (replace(item, id=f"f-{item.id}") for item in other.transformed(half).objects)
    return replace(cluster, objects=(*cluster.objects, *moved), start=start)


@given(st.integers(2, 6), st.integers(0, 2**31), st.integers(20, 300), st.booleans())
@settings(max_examples=50)
def test_waypoints_along_a_way_start_slowly_and_stay_on_it(count, seed, waypoints, stop):
    corners = np.random.default_rng(seed).uniform(-2.0, 2.0, (count, 5))
    q = follow.along_corners(corners, waypoints, stop=stop)
    np.testing.assert_allclose(q[[0, -1]], corners[[0, -1]], atol=1e-12)
    steps = np.abs(np.diff(q, axis=0)).max(axis=1)
    turns = float(np.abs(np.diff(corners, axis=0)).max(axis=1).sum())
    assert steps.max() <= turns / (waypoints - 1) / (1.0 - TREE.ramp) + 1e-9
    assert steps[0] <= steps.max()
    a, b = corners[:-1, None], corners[1:, None]
    share = np.clip(((q - a) * (b - a)).sum(-1) / ((b - a) ** 2).sum(-1), 0.0, 1.0)
    off = np.linalg.norm(a + share[..., None] * (b - a) - q, axis=-1).min(axis=0)
    assert off.max() < 1e-9


def test_no_joint_steps_farther_than_asked() -> None:
    options = PlanOptions(max_step=0.03)
    corners = way_of(task_of("bookshelf", 7600))
    q = follow.along_corners(corners, int(follow.way_count(corners, options)) + 1)
    assert np.abs(np.diff(q, axis=0)).max() <= options.max_step * WAYPOINT.share * (1 + 1e-9)


def test_a_way_out_has_no_more_waypoints_than_any_motion() -> None:
    options = PlanOptions(max_step=1e-4, iterations=0)
    made = plan(from_furniture("under-table", 503), options=options)
    assert made.first > 0
    assert len(made.trajectory.positions) <= WAYPOINT.most + WAYPOINT.fewest_reach


def test_levers_bound_how_far_a_joint_moves_the_body() -> None:
    task = task_of("box", 0)
    robot, lever = task.robot, collision.levers(task.robot)
    rng = np.random.default_rng(0)
    for _ in range(200):
        q = rng.uniform(robot.lower, robot.upper)
        joint, by = int(rng.integers(7)), float(rng.uniform(-0.3, 0.3))
        other = q + by * np.eye(7)[joint]
        moved = np.linalg.norm(robot.sphere_centers(other) - robot.sphere_centers(q), axis=1).max()
        assert moved <= lever[joint] * abs(by) + 1e-12
