"""What else may be asked of a plan: its budget, its seed, what it hands over, what it refuses."""

import json
import time
import warnings
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numba import njit
from tests.planning.builders import END, assert_success, block

from optipromp.core import judging
from optipromp.core.errors import Code, InvalidRequestError, StartInvalidError
from optipromp.core.geometry import Box, Sphere
from optipromp.core.optimization import kernels
from optipromp.core.optimization.costs import Cost
from optipromp.core.optimization.evaluation import Evaluation
from optipromp.core.planning import (
    ConditionedProMP,
    IProMP,
    OptiProMP,
    Plan,
    Planner,
    PlanOptions,
    plan,
)
from optipromp.core.planning.task import resolve
from optipromp.core.pushing.path import through
from optipromp.core.pushing.rules import rule_paths
from optipromp.core.pushing.stems import hanging as hanging_model
from optipromp.core.robots.library import load_robot
from optipromp.core.scenes import JointGoal, Scene, SceneObject, Stem
from optipromp_paper.paper import Paper
from optipromp_sim.generate import generate

# --- iterations and time ---------------------------------------------------------------------


def test_a_plan_has_its_whole_budget_where_a_kernel_is_compiled_on_the_way(obstructed, monkeypatch):
    """What only some plans need is compiled when they do. In the process's own time."""
    monkeypatch.setattr(time, "perf_counter", time.process_time)
    usual = plan(obstructed)
    whole = 2.0 * usual.time["total"]
    for name in ("clearance_in_cells", "clearance_field"):
        anew = njit(error_model="numpy")(getattr(kernels, name).py_func)
        monkeypatch.setattr(kernels, name, anew)
    began = time.process_time()
    first = plan(obstructed, options=PlanOptions(timeout=whole))
    assert time.process_time() - began > 2.0 * whole  # most of it to compile
    assert first.time["total"] < whole
    assert first.message == usual.message
    np.testing.assert_array_equal(first.trajectory.positions, usual.trajectory.positions)


@pytest.mark.parametrize(
    "planner",
    [OptiProMP(), *(Paper(constraints="push-model", waypoints=count) for count in (None, 2000))],
)
def test_time_running_out_on_the_way_keeps_to_its_budget(planner, three, monkeypatch):
    """A problem without a solution: the target is under a lid, so every start is tried.

    In the process's own time: what else the machine does counts for nothing.
    """
    monkeypatch.setattr(time, "perf_counter", time.process_time)
    lid = block("static", Box((0.3, 0.3, 0.05)), [0.45, 0.0, 0.93], "lid")
    scene = replace(three, objects=(*three.objects, lid))
    plan(scene, planner=planner, timeout=1e-6)  # makes the robot
    took = []
    while len(took) < 3 and min(took, default=1.0) > 0.33:  # what disturbs it only adds
        began = time.perf_counter()
        result = plan(scene, planner=planner, timeout=0.3)
        took.append(time.perf_counter() - began)
        assert not result.success
        assert result.status in (Code.TIMEOUT, Code.GOAL_IN_COLLISION)
    assert min(took) <= 0.33


def crowd(count: int, role: Any) -> tuple[SceneObject, ...]:
    """Small balls in a shell about the arm's work, some of them within its reach."""
    rng = np.random.default_rng(0)
    directions = rng.normal(size=(count, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    places = rng.uniform(1.1, 2.0, (count, 1)) * directions + [0.0, 0.0, 0.4]
    shape = Sphere(0.01)
    return tuple(SceneObject(f"c{i}", role, shape, at) for i, at in enumerate(places))


def test_more_fruits_than_can_be_tried_are_passed_as_the_rule_says(three: Scene) -> None:
    """Where even the neighbours are too many for the model of the push, there is none."""
    target = three.target

    def hanging(name: str, at: np.ndarray) -> SceneObject:
        stem = Stem(np.array([at, at + [0.0, 0.0, 0.1]]))
        return SceneObject(name, "pushable", Sphere(0.005), at, stem=stem)

    close = [
        hanging(f"close-{i}", target.position - [0.002 * (i % 6), 0.002 * (i // 6), 0.1])
        for i in range(hanging_model.HANGING.most + 1)
    ]
    task = resolve(three)
    assert task.push_model(END) is not None
    crowded = resolve(replace(three, objects=(*three.objects, *close)))
    assert len(crowded.neighbours) > hanging_model.HANGING.most
    assert crowded.push_model(END) is None
    result = plan(crowded.scene, options=PlanOptions(iterations=0))
    assert result.prediction is None
    corners = rule_paths(crowded.scene, crowded.neighbours, crowded.robot, crowded.camera)
    ways = [through(way, 0.1).at(np.linspace(0.0, 1.0, 10_000)) for way in corners]
    tools = result.robot.tool_pose(result.followed.positions[-40:])[0]
    away = [np.linalg.norm(tools[:, None] - way[None], axis=2).min(axis=1).max() for way in ways]
    assert min(away) < 2e-4


def test_a_hundred_thousand_obstacles(three: Scene) -> None:
    scene = replace(three, objects=(*three.objects, *crowd(100_000, "static")))
    result = plan(scene, options=PlanOptions(timeout=20.0))
    assert result.status in (Code.SUCCESS, Code.TIMEOUT), result.message
    assert result.time["total"] < 20.0


def test_effort_cuts_a_plan_at_the_same_place_however_slow_the_machine(three, monkeypatch):
    """Work that takes ten times as long, and a clock that says so, changes nothing but the time."""
    whole = plan(three)
    judge, clock = judging.judge, time.perf_counter
    for effort in (1, 3, 10, 30):
        options = PlanOptions(effort=effort, timeout=float("inf"))
        fast = plan(three, options=options)
        with monkeypatch.context() as slower:
            slower.setattr(judging, "judge", lambda *a, **k: time.sleep(0.02) or judge(*a, **k))
            slower.setattr(time, "perf_counter", lambda: 10.0 * clock())
            slow = plan(three, options=options)
        np.testing.assert_array_equal(slow.trajectory.positions, fast.trajectory.positions)
        assert (slow.status, slow.message) == (fast.status, fast.message)
        assert fast.success or "effort ran out" in fast.message
        assert (
            not fast.success
            or f"cut after {effort + 1} steps" in fast.message
            or (fast.message == whole.message)
        )
    first = plan(three, options=PlanOptions(effort=1))
    assert first.status is Code.TIMEOUT
    enough = plan(three, options=PlanOptions(effort=100_000))
    np.testing.assert_array_equal(enough.trajectory.positions, whole.trajectory.positions)
    assert enough.message == whole.message


def test_what_a_timeout_cut_short_says_so(three: Scene) -> None:
    """Robustness 24: a plan that more time might have bettered is not as one that was finished."""
    lid = block("static", Box((0.3, 0.3, 0.05)), [0.45, 0.0, 0.93], "lid")
    for scene in (three, replace(three, objects=(*three.objects, lid))):
        messages = [plan(scene, options=PlanOptions(effort=n)).message for n in (1, 10**6)]
        assert ["ran out" in m or "was cut after 2 steps" in m for m in messages] == [True, False]
    late = plan(three, options=PlanOptions(timeout=1e-6))
    assert "time ran out" in late.message


# --- repeatability ---------------------------------------------------------------------------


@pytest.mark.parametrize(
    "planner",
    [
        ConditionedProMP(), IProMP(direction_deviation=0.2), OptiProMP(),
        Paper(constraints="push-model"), Paper(strategy="joint"),
    ],
)  # fmt: skip
def test_the_same_seed_gives_the_same_plan_bit_for_bit(planner: Planner, three: Scene) -> None:
    assert_the_same(*(plan(three, planner=planner, seed=3) for _ in range(2)))


@pytest.mark.parametrize("which", [("cluster", 9), ("table-top", 2), ("shelf", 7)])
def test_the_same_generated_scene_gives_the_same_plan(which: Any) -> None:
    assert_the_same(*(plan(generate(*which)) for _ in range(2)))


def assert_the_same(first: Plan, again: Plan) -> None:
    np.testing.assert_array_equal(first.trajectory.positions, again.trajectory.positions)
    np.testing.assert_array_equal(first.trajectory.times, again.trajectory.times)
    assert first.metrics == again.metrics
    assert first.terms == again.terms
    assert first.message == again.message
    assert first.prediction == again.prediction


def test_another_seed_pushes_another_way(three: Scene) -> None:
    ends = [plan(three, planner=IProMP(direction_deviation=0.5), seed=s) for s in (1, 2)]
    assert not np.array_equal(ends[0].trajectory.positions, ends[1].trajectory.positions)
    sure = [plan(three, planner="i-promp", seed=s) for s in (1, 2)]
    assert sure[0].metrics.path_length == pytest.approx(sure[1].metrics.path_length, rel=0.2)


# --- what is handed over ---------------------------------------------------------------------


def test_to_dict_is_a_json_document(planned: Callable[..., Plan]) -> None:
    result = planned("scenario-3")
    document = result.to_dict()
    assert json.loads(json.dumps(document, allow_nan=False)) == document
    assert document["scene"] == "scenario-3"
    assert document["planner"] == "opti-promp"
    assert document["terms"] == {}
    assert result.prediction is not None
    assert document["predicted_harm"] == result.prediction.to_dict()
    assert document["stages"][0]["name"] == "joint"
    assert document["status"] == "success"
    assert document["time"]["total"] > 0.0
    assert set(planned("scenario-3", "paper").to_dict()["terms"]) >= {"static", "avoid", "push"}


class Low(Cost):
    """½ ∫ max(0, z − h)² dt of the tool point: written as a user would."""

    def __init__(self, weight: float, height: float) -> None:
        super().__init__("low", weight)
        self.height = height

    def add(self, e: Evaluation, scale: float) -> float:
        over = np.maximum(e.tool_points[:, 2] - self.height, 0.0)
        e.force[:, e.tool, 2] += scale * e.dt * over
        return 0.5 * e.dt * float(np.sum(over**2))


def test_costs_of_ones_own_are_minimised_with_the_others(three: Scene) -> None:
    scene = replace(three, objects=(), goal=JointGoal(END))
    plain = plan(scene)
    heights = plain.robot.tool_pose(plain.trajectory.positions)[0][:, 2]
    limit = float(max(heights[0], heights[-1])) - 0.05
    lowered = plan(scene, options=PlanOptions(costs=(Low(50.0, limit),)))
    assert_success(lowered)
    lower = lowered.robot.tool_pose(lowered.trajectory.positions)[0][:, 2]
    assert np.mean(np.maximum(lower - limit, 0.0)) < 0.8 * np.mean(np.maximum(heights - limit, 0.0))


# --- refusals --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("start", "message"),
    [
        (np.zeros(6), "start has 6 values; panda has 7 joints"),
        (np.array([0.0, 0.0, 0.0, 0.5, 0.0, 1.0, 0.0]), "start: joint4 is 0.5000"),
        (np.array([0.0, -0.3, 0.0, -3.0748, 0.0, 3.0, 0.8]), r"joint4 is -3.0748, .* than 0.002"),
    ],
)
def test_bad_starts(start: np.ndarray, message: str, three: Scene) -> None:
    with pytest.raises(StartInvalidError, match=message) as caught:
        plan(replace(three, start=start))
    assert caught.value.code is Code.START_INVALID


@pytest.mark.parametrize("beyond", [1e-9, 1e-4, 1.9e-3])
def test_a_start_or_a_goal_beyond_a_limit_by_noise_is_at_the_limit(three, beyond):
    """The start was refused with two equal numbers; the goal was searched for, and invalid."""
    robot = load_robot("panda")
    inner = np.array([0.0, -0.5, 0.0, -2.0, 0.0, 1.6, 0.0])
    outer = np.array([0.0, -0.3, 0.0, robot.lower[3] - beyond, 0.0, 3.0, 0.8])
    for start, goal in ((outer, inner), (inner, outer)):
        asked = replace(three, objects=(), start=start, goal=JointGoal(goal))
        with warnings.catch_warnings(record=True) as told:
            warnings.simplefilter("always")
            task = resolve(asked)
        words = " ".join(str(each.message) for each in told)
        assert ("joint4 is" in words and "moved to the limit" in words) == (beyond > 1e-6)
        assert robot.lower[3] in (task.start[3], task.goal.joints[3])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        assert_success(plan(replace(three, objects=(), start=outer, goal=JointGoal(inner))))


def test_bad_goals_in_joints(three: Scene) -> None:
    outside = END.copy()
    outside[3] = 1.0
    with pytest.raises(InvalidRequestError, match=r"goal: joint4 is 1\.0"):
        plan(replace(three, objects=(), goal=JointGoal(outside)))
    with pytest.raises(InvalidRequestError, match="7 joints"):
        plan(replace(three, objects=(), goal=JointGoal(np.zeros(3))))


@pytest.mark.parametrize(
    "request_",
    [
        {"scene": 5}, {"seed": -1}, {"seed": "0"}, {"seed": True}, {"options": 3},
        {"demonstrations": 3}, {"planner": []}, {"strategy": None}, {"previous": 3, "at": 0.0},
    ],
)  # fmt: skip
def test_wrong_types_are_refused(request_: dict[str, Any]) -> None:
    with pytest.raises(InvalidRequestError):
        plan(**({"scene": "scenario-3"} | request_))
