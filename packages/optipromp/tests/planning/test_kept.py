"""Constraints of the way to a goal: a cup held upright, a plane; what the judge says of them."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.planning.builders import assert_success, beside_a_box
from tests.refusals import assert_refused

from optipromp import load_plan, load_scene, write_plan
from optipromp.core.errors import Code, InvalidRequestError, InvalidSceneError
from optipromp.core.planning import Plan, judge, plan
from optipromp.core.scenes import Pose, Scene, save_scene, scene_from_dict, scene_to_dict
from optipromp_paper.paper import Paper

DOWN = [0, 0, -1]
ASIDE = {"position": [0.3, 0.5, 0.4], "axis": DOWN}
LEVEL = {"position": [0.45, 0.5, 0.502], "axis": "free"}
CUP = {"upright": {"axis": DOWN, "angle": 5}}
PLANE = {"plane": {"point": [0, 0, 0.504], "normal": [0, 0, 1], "within": 0.006}}


def scene(goal: Any, path: Any = None) -> Scene:
    return beside_a_box(goal, **({} if path is None else {"path": path}))


WAYS = {"points": [{"position": [0.45, 0.3, 0.4], "axis": DOWN}], "speed": 0.1}


def said(**way: Any) -> Scene:
    """Nothing in the way, and what a scene says of it."""
    return scene_from_dict(scene_to_dict(scene(ASIDE)) | {"objects": []} | way)


@pytest.mark.parametrize("settings", [
    {"planner": "promp"}, {"planner": "i-promp"}, {"planner": "i-promp-guard"},
    {"planner": "straight"}, {"planner": "chomp"}, {"planner": "paper"},
    {"planner": Paper(strategy="joint")},
])  # fmt: skip
@pytest.mark.parametrize("way", [{"path": CUP}, {"waypoints": WAYS}])
def test_a_planner_that_ignores_the_way_is_refused(settings: Any, way: Any) -> None:
    bound, (name,) = said(**way), way
    with pytest.raises(InvalidRequestError, match=f"ignores what the scene says in '{name}'"):
        plan(bound, **settings)


def test_the_planners_that_keep_to_the_way_are_asked() -> None:
    for name in ("drift", "obstacles"):
        assert_success(plan(said(path=CUP), planner=name))
    assert_success(plan(said(waypoints=WAYS), planner="drift"))
    with pytest.raises(InvalidRequestError, match=r"planner obstacles .* 'waypoints'"):
        plan(said(waypoints=WAYS), planner="obstacles")


def frames(made: Plan) -> tuple[np.ndarray, np.ndarray]:
    """Tool points (m, 3) and axes of the tool's frame (m, 3, 3), every 5 ms."""
    count = int(made.trajectory.duration / 0.005)
    q, _, _ = made.trajectory.sample(np.linspace(0.0, made.trajectory.duration, count))
    _, turns = made.robot.segment_frames(q)
    return made.robot.tool_pose(q)[0], turns[:, -1] @ made.robot.flange_rotation


@pytest.mark.parametrize(
    ("goal", "path", "kind"),
    [
        (ASIDE, CUP, "upright"),
        (
            {"position": [0.3, -0.5, 0.4], "orientation": [0, 1, 0, 0]},
            {"upright": {"axis": [0, 1, 0], "direction": [-0.717, -0.697, 0], "angle": 50}},
            "",
        ),
        (LEVEL, PLANE, "plane"),
        (ASIDE, CUP | {"plane": {"point": [0, 0, 0.45], "normal": [0, 0, 1], "within": 0.06}}, ""),
    ],
)
def test_what_the_path_says_is_kept_on_the_whole_way(goal: Any, path: Any, kind: str) -> None:
    free, bound = scene(goal), scene(goal, path)
    made = plan(bound)
    assert_success(made)
    points, axes = frames(made)
    if "upright" in path:
        told = path["upright"]
        up = np.array(told.get("direction", [0, 0, 1])) / np.linalg.norm(told.get("direction", 1))
        lean = np.arccos(np.clip(axes @ np.array(told["axis"]) @ up, -1.0, 1.0))
        assert np.rad2deg(lean.max()) < told["angle"]
    if "plane" in path:
        off = np.abs(points[:, 2] - path["plane"]["point"][2])
        assert off.max() < path["plane"]["within"]
    if kind:  # without the path another motion is planned, in which the judge finds it
        found = judge(bound, plan(free).trajectory)
        assert found.status is Code.INVALID_PLAN
        assert [v.kind for v in found.judgement.violations] == [kind]
        assert f"path.{kind}" in found.message
        assert found.judgement.violations[0].time is not None


@pytest.mark.parametrize("path", [
    {"upright": {"axis": [0, 0, 1], "angle": 20}},
    {"plane": {"point": [0, 0, 0.9], "normal": [0, 0, 1], "within": 0.006}},
])  # fmt: skip
def test_a_start_that_breaks_the_path_is_told_at_once(path: Any) -> None:
    asked = []

    class Asked:
        """A planner that is not to be asked."""

        keeps_path = True

        def solve(self, task: Any, budget: Any) -> Any:
            asked.append(task)
            raise AssertionError

    for planner in ("opti-promp", Asked()):
        made = plan(scene(ASIDE, path), planner=planner)
        assert made.status is Code.START_INVALID
        (kind,) = path
        assert f"path.{kind}" in made.message
        assert "choose a start that keeps the path" in made.message
    assert not asked


def test_a_saved_path_is_the_same_path_and_turns_with_the_frame(tmp_path: Path) -> None:
    bound = scene(ASIDE, CUP | PLANE)
    told = scene_to_dict(bound)
    assert scene_to_dict(scene_from_dict(told)) == told
    half = math.sqrt(0.5)
    moved = bound.transformed(Pose(np.array([0.1, 0.2, 0.3]), np.array([half, half, 0.0, 0.0])))
    np.testing.assert_allclose(moved.path.upright.direction, [0.0, -1.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(moved.path.upright.axis, DOWN)
    np.testing.assert_allclose(moved.path.plane.point, [0.1, -0.304, 0.3], atol=1e-12)
    save_scene(scene(ASIDE, CUP), tmp_path / "s.yaml")
    write_plan(plan(load_scene(tmp_path / "s.yaml")), tmp_path / "out")
    assert load_plan(tmp_path / "out").success


@pytest.mark.parametrize(
    ("path", "words"),
    [
        ({}, "path: must have upright, plane or both"),
        (
            {"upright": {"angle": 120}},
            "path.upright.angle is 120.0: must be above 0 and at most 90",
        ),
        ({"upright": {}}, "path.upright.angle is missing"),
        ({"upright": {"angle": 5, "axes": DOWN}}, "did you mean 'axis'"),
        (
            {"plane": {"point": [0, 0, 0], "normal": [0, 0, 0], "within": 1}},
            "must have a direction",
        ),
        ({"upright": {"angle": 5, "axis": [0, 0, 0]}}, "path.upright.axis is"),
    ],
)
def test_refusals_of_a_path(path: Any, words: str) -> None:
    assert_refused(InvalidSceneError, words, scene, ASIDE, path)
