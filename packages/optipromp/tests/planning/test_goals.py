"""Where a plan may be asked to go, and what goals and starts get that are trivial or hopeless."""

import time
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from tests.planning.builders import END, UP, assert_success, block, without

from optipromp.core import judging
from optipromp.core.errors import Code
from optipromp.core.geometry import Box, Sphere
from optipromp.core.planning import PLANNERS, PlanOptions, collision, goals, plan
from optipromp.core.planning.task import resolve
from optipromp.core.scenes import JointGoal, PoseGoal, Scene, Stem, load_scene
from optipromp_paper.paper import Paper
from optipromp_sim.generate import Preset, generate

EITHER = "opti-promp", Paper(constraints="push-model")

# --- goals -----------------------------------------------------------------------------------


def test_a_goal_in_joints_is_met_exactly_around_an_obstacle(obstructed: Scene) -> None:
    result = plan(obstructed)
    assert_success(result)
    np.testing.assert_allclose(result.trajectory.positions[-1], END, atol=1e-12)
    before = plan(obstructed, planner="promp")
    assert before.status is Code.INVALID_PLAN  # the way there is not free by itself
    assert "block" in before.message
    assert (result.metrics.clearance_static or 0.0) > 0.0
    assert result.metrics.goal_axis_error is None
    assert result.metrics.M_p == {}


@pytest.mark.parametrize("planner", PLANNERS)
@pytest.mark.parametrize("kind", ["joints", "pose"])
def test_every_planner_goes_to_a_goal(planner: Any, kind: str, three: Scene) -> None:
    goal: Any = JointGoal(END) if kind == "joints" else PoseGoal(np.array([0.45, 0.05, 0.75]), UP)
    clusters = tuple(o for o in three.objects if o.role == "avoid")
    result = plan(replace(three, objects=clusters, goal=goal), planner=planner)
    assert_success(result)
    if kind == "pose":
        assert result.metrics.goal_axis_error <= np.deg2rad(2.0)


def test_the_goal_outranks_what_the_tool_may_brush(three: Scene) -> None:
    """Half the mouth is in the cluster at the goal. The tool may brush it; it must arrive."""
    clusters = tuple(o for o in three.objects if o.role == "avoid")
    goal = PoseGoal(np.array([0.45, 0.1, 0.75]), UP)
    assert_success(plan(replace(three, objects=clusters, goal=goal)))


@pytest.mark.parametrize("planner", EITHER)
def test_a_pose_with_a_slanted_axis(planner: Any, three: Scene) -> None:
    axis = np.array([0.5, 0.2, 1.0])
    scene = replace(three, objects=(), goal=PoseGoal(np.array([0.45, 0.1, 0.7]), axis))
    result = plan(scene, planner=planner)
    assert_success(result)
    _, along = result.robot.tool_pose(result.trajectory.positions[-1])
    assert along @ axis / np.linalg.norm(axis) > np.cos(np.deg2rad(2.0))


def test_nothing_but_a_target(three: Scene) -> None:
    for planner in EITHER:
        result = plan(without(three, "pushable", "avoid"), planner=planner)
        assert_success(result)
        for term in (result.terms[name] for name in ("static", "avoid", "push") if result.terms):
            assert term.initial == term.final == 0.0
        assert result.metrics.clearance_static is None
        assert result.metrics.clearance_avoid is None
        assert result.metrics.M_c is None


@pytest.mark.parametrize("stem", ["none", "vertical"])
def test_without_sides_one_is_chosen(stem: str, three: Scene) -> None:
    objects = []
    for o in three.objects:
        hung = None
        if o.stem is not None and stem == "vertical":
            hung = Stem(np.array([o.position, o.position + 0.2 * UP]))
        objects.append(replace(o, stem=hung))
    scene = replace(three, objects=tuple(objects))
    assert_success(plan(scene))
    result = plan(scene, options=PlanOptions(prediction=False, risk=0.1))
    assert_success(result)
    for offset in result.metrics.M_p.values():
        assert abs(offset) >= 0.05
    projections = set(result.metrics.stem_projection.values())
    assert projections == ({None} if stem == "none" else {0.0})


def test_an_undecided_pushable_is_passed_where_there_is_room(three: Scene) -> None:
    """One side is blocked for the arm and the tool: both are tried, the free one is kept."""
    n2 = next(o for o in three.objects if o.id == "n2")
    target = next(o for o in three.objects if o.role == "target")
    for side, away in ((-1.0, 0.062), (1.0, 0.075)):  # nearer, the arm finds no way past it
        wall = block("static", Box((0.3, 0.01, 0.1)), n2.position + [0.0, side * away, -0.02])
        scene = replace(three, objects=(target, replace(n2, stem=None), wall))
        result = plan(scene)
        assert_success(result)
        offset = result.metrics.M_p["n2"]
        assert offset * side < 0.0


# --- trivial and hopeless --------------------------------------------------------------------


@pytest.mark.parametrize("planner", PLANNERS)
@pytest.mark.parametrize("kind", ["joints", "pose", "target"])
def test_start_at_the_goal_is_a_trivial_plan(kind: str, planner: Any, three: Scene) -> None:
    task = resolve(three)
    point, axis = task.robot.tool_pose(task.start)
    if kind == "joints":
        scene = replace(three, objects=(), goal=JointGoal(task.start))
    elif kind == "pose":
        scene = replace(three, objects=(), goal=PoseGoal(point, axis))
    else:
        scene = replace(
            three, objects=(block("target", Sphere(0.015), point),),
            approach=replace(three.approach, direction=axis, lateral=np.array([0.3, 1.0, 0.1])),
        )  # fmt: skip
    result = plan(scene, planner=planner)
    assert_success(result)
    q = result.trajectory.positions
    np.testing.assert_array_equal(q, np.tile(task.start, (len(q), 1)))
    assert result.metrics.path_length == 0.0


@pytest.mark.parametrize("planner", PLANNERS)
def test_out_of_reach_is_said_at_once(planner: Any, three: Scene) -> None:
    far = replace(three, objects=(), goal=PoseGoal(np.array([10_000.0, 0.0, 0.0]), UP))
    began = time.perf_counter()
    result = plan(far, planner=planner)
    assert time.perf_counter() - began < 1.0
    assert result.status is Code.GOAL_UNREACHABLE
    assert not result.success
    assert "10000" in result.message
    np.testing.assert_array_equal(result.trajectory.positions[-1], three.start)


def test_an_axis_no_joint_can_turn_to_is_unreachable() -> None:
    scara = load_scene("scenario-1")
    goal = PoseGoal(np.array([0.0, 0.5, 0.2]), np.array([1.0, 0.0, 0.0]))
    result = plan(replace(scara, objects=scara.static, goal=goal))
    assert result.status is Code.GOAL_UNREACHABLE


@pytest.mark.parametrize("planner", PLANNERS)
def test_start_in_collision(planner: Any, three: Scene) -> None:
    assert three.start is not None
    tool = resolve(three).robot.tool_pose(three.start)[0]
    result = plan(
        replace(three, objects=(*three.objects, block("static", Sphere(0.05), tool))),
        planner=planner,
    )
    assert result.status is Code.START_IN_COLLISION
    assert "tool enters block (static)" in result.message
    assert ("tool", "block") in {(c.link, c.other) for c in result.contacts}


def test_the_papers_start_is_in_collision_with_itself(three: Scene) -> None:
    result = plan(replace(three, start=np.array([0.0, 0.0, 0.0, -0.1, 0.0, 0.0, 0.8])))
    assert result.status is Code.START_IN_COLLISION
    assert "tool (the robot itself)" in result.message
    assert "turn the tool by its 'mount'" in result.message  # flanges may point into the wrist


def test_goal_in_collision_names_what_it_touches_and_comes_as_near_as_it_can(three: Scene) -> None:
    lid = block("static", Box((0.3, 0.3, 0.05)), [0.45, 0.0, 0.93], "lid")
    result = plan(replace(three, objects=(*three.objects, lid)))
    assert result.status is Code.GOAL_IN_COLLISION
    assert not result.success
    assert "lid" in result.message
    assert 1e-3 < result.metrics.goal_error < 0.05


@pytest.mark.parametrize("preset", ["cluster", "mixed", "truss", "shelf"])
def test_the_planner_and_the_judge_call_the_same_configurations_free(preset: Preset) -> None:
    """Stems and avoided objects, which the tool alone may touch, among them."""
    task = resolve(generate(preset, 7300))
    rng = np.random.default_rng(0)
    q = rng.uniform(task.robot.lower, task.robot.upper, (300, task.robot.n_joints))
    near = goals.find(task, 0)  # among the fruits and their stems
    q = np.vstack([q, *(near + 0.1 * rng.standard_normal(near.shape) for _ in range(30))])
    touched = [bool(judging.clearances(task.scene, task.robot, one[None])[1]) for one in q]
    np.testing.assert_array_equal(collision.free(task, q), q[~np.array(touched)])
    assert 0 < sum(touched) < len(q)
    np.testing.assert_array_equal(collision.free(task, q, 2), q[~np.array(touched)][:2])
