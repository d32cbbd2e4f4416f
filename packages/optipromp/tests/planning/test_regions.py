"""Goals with an orientation, a free axis, tolerances; several goals; turns of endless joints."""

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.cli.fixtures import invoke
from tests.planning.builders import assert_success

from optipromp.core.errors import Code
from optipromp.core.output import load_plan, write_plan
from optipromp.core.planning import Plan, judge, plan
from optipromp.core.scenes import JointGoal, Scene, load_scene, save_scene, scene_from_dict

HALF = math.sqrt(0.5)
AT = {"position": [0.45, -0.2, 0.5]}
BLOCK = {
    "id": "box", "role": "static", "shape": {"box": {"size": [0.2, 0.2, 0.4]}},
    "position": [0.5, 0.2, 0.2],
}  # fmt: skip


def scene(goal: Any, **more: Any) -> Scene:
    given = {"name": "s", "robot": "panda", "objects": [BLOCK], "goal": goal}
    return scene_from_dict(given | more)


def tool_frame(made: Plan) -> np.ndarray:
    """Axes of the tool's frame at the end, in columns."""
    _, turns = made.robot.segment_frames(made.trajectory.positions[-1])
    tool = np.eye(3) if made.robot.tool is None else made.robot.tool.rotation
    return np.asarray(turns[-1] @ made.robot.flange_rotation @ tool)


@pytest.mark.parametrize("tool", [None, {"kind": "franka_hand"}])
@pytest.mark.parametrize(
    ("orientation", "fingers"),
    [([0, 1, 0, 0], [0.0, -1.0, 0.0]), ([0, HALF, HALF, 0], [1.0, 0.0, 0.0])],
)
def test_a_whole_orientation_is_reached(orientation, fingers, tool):
    made = plan(scene(AT | {"orientation": orientation}, **({"tool": tool} if tool else {})))
    assert_success(made)
    frame = tool_frame(made)
    np.testing.assert_allclose(frame[:, 2], [0.0, 0.0, -1.0], atol=1e-6)
    np.testing.assert_allclose(frame[:, 1], fingers, atol=1e-6)
    point, _ = made.robot.tool_pose(made.trajectory.positions[-1])
    np.testing.assert_allclose(point, AT["position"], atol=1e-6)


def test_a_motion_to_another_roll_is_refused_by_the_judge() -> None:
    one, other = (scene(AT | {"orientation": q}) for q in ([0, 1, 0, 0], [0, HALF, HALF, 0]))
    made = plan(one)
    found = judge(other, made.trajectory)
    assert [v.kind for v in found.judgement.violations] == ["axis"]
    assert "the tool ends 90.0 degrees off the goal (at most 2)" in found.message
    assert judge(one, made.trajectory).status is Code.SUCCESS


def test_a_free_axis_is_nearer_than_a_given_one() -> None:
    free, down = plan(scene(AT | {"axis": "free"})), plan(scene(AT | {"axis": [1, 0, 0]}))
    assert_success(free)
    assert_success(down)
    assert free.metrics.goal_axis_error is None
    assert free.metrics.goal_error < 1e-6
    assert free.metrics.path_length < down.metrics.path_length


@pytest.mark.parametrize("within", [0.2, [0.2, 0.25, 0.05]])
def test_a_region_is_reached_where_its_middle_is_blocked(within: Any) -> None:
    middle = {"position": [0.5, 0.2, 0.3], "axis": [0, 0, -1]}  # inside the box
    assert plan(scene(middle)).status is Code.GOAL_IN_COLLISION
    made = plan(scene(middle | {"tolerance": {"position": within, "angle": 30.0}}))
    assert made.success, made.message
    point, axis = made.robot.tool_pose(made.trajectory.positions[-1])
    off = np.abs(point - middle["position"])
    assert (off < within).all() if isinstance(within, list) else np.linalg.norm(off) < within
    assert -axis[2] > math.cos(math.radians(30.0))
    assert made.metrics.goal_axis_error < math.radians(30.0)


def test_the_border_of_a_region() -> None:
    """The judge measures in the goal's box, not in the base's."""
    turned = [math.cos(math.pi / 8), 0.0, 0.0, math.sin(math.pi / 8)]  # 45 degrees about z
    free = scene(AT | {"axis": "free"})
    made = plan(free)
    for shift, fits in ((0.029, True), (0.031, False)):  # along x of the box
        middle = np.array(AT["position"]) - shift * np.array([HALF, HALF, 0.0])
        box = {"position": [0.03, 0.001, 0.001], "orientation": turned}
        other = scene({"position": middle.tolist(), "axis": "free", "tolerance": box})
        found = judge(other, made.trajectory)
        assert (found.status is Code.SUCCESS) is fits
        assert fits or [v.kind for v in found.judgement.violations] == ["goal"]


def test_the_shortest_of_several_plans_wins_and_is_named() -> None:
    goals = [
        {"position": [0.5, 0.2, 0.3], "axis": [0, 0, -1]},  # inside the box
        {"joints": [1.8, 0.0, 0.0, -2.2, 0.0, 2.0, 0.8]},
        AT | {"axis": "free"},
    ]
    made = plan(scene(goals))
    assert_success(made)
    assert made.goal == 2
    assert "ends at goal 3 of 3" in made.message
    assert made.to_dict()["goal"] == 2
    alone = [plan(scene(goal)) for goal in goals[1:]]
    assert made.trajectory.duration == min(one.trajectory.duration for one in alone)
    assert "goal" not in alone[0].to_dict()
    assert judge(made.scene, alone[0].trajectory).status is Code.SUCCESS


def test_several_goals_that_cannot_be_reached() -> None:
    far = {"position": [9.0, 0.0, 0.5], "axis": "free"}
    made = plan(scene([far, {"position": [0.5, 0.2, 0.3], "axis": [0, 0, -1]}]))
    assert made.status in (Code.GOAL_UNREACHABLE, Code.GOAL_IN_COLLISION)
    assert made.message.startswith("goal ")
    assert made.goal is None


def test_a_goal_of_several_is_kept_in_files(tmp_path: Path) -> None:
    goals: list[Any] = [
        AT | {"orientation": [0, 1, 0, 0], "tolerance": {"position": [0.02, 0.02, 0.02]}}
    ]
    goals.append({"joints": [1.8, 0.0, 0.0, -2.2, 0.0, 2.0, 0.8]})
    save_scene(scene(goals), tmp_path / "s.yaml")
    told = invoke("check", tmp_path / "s.yaml", "--json")
    assert json.loads(told.stdout)["goal"] == "RegionGoal, JointGoal"
    write_plan(plan(load_scene(tmp_path / "s.yaml")), tmp_path / "out")
    assert load_plan(tmp_path / "out").goal == 0


TURNING = """<robot name="turning">
<link name="base"/>
<link name="a"><collision><origin xyz="0.2 0 0"/><geometry><box size="0.3 0.05 0.05"/></geometry>
</collision></link>
<link name="b"><collision><origin xyz="0.15 0 0"/><geometry><box size="0.2 0.04 0.04"/></geometry>
</collision></link>
<joint name="j1" type="continuous"><parent link="base"/><child link="a"/><axis xyz="0 0 1"/>
<limit velocity="1" effort="9"/></joint>
<joint name="j2" type="revolute"><parent link="a"/><child link="b"/><origin xyz="0.4 0 0"/>
<axis xyz="0 0 1"/><limit lower="-6.5" upper="6.5" velocity="1" effort="9"/></joint></robot>"""


@pytest.mark.filterwarnings("ignore:no built-in demonstrations")
@pytest.mark.parametrize("turns", [-3, 0, 1])
def test_an_endless_joint_takes_the_shortest_of_its_equal_goals(turns: int, tmp_path: Path) -> None:
    (tmp_path / "turning.urdf").write_text(TURNING)
    goal = JointGoal(np.array([3.0 + 2.0 * math.pi * turns, 0.4]))
    start = np.array([-2.9, -0.3])
    bound = Scene("t", "turning.urdf", (), goal=goal, start=start, base_dir=tmp_path)
    made = plan(bound)
    assert_success(made)
    np.testing.assert_allclose(made.trajectory.positions[-1], [3.0 - 2.0 * math.pi, 0.4], atol=1e-9)
    assert made.metrics.goal_error < 1e-9
    limited = replace(bound, goal=JointGoal(np.array([-2.9, 0.4 - 2.0 * math.pi])))
    far = plan(limited)  # j2 has limits: its turns count
    assert far.trajectory.positions[-1][1] == pytest.approx(0.4 - 2.0 * math.pi)
    again = judge(replace(limited, goal=JointGoal(np.array([-2.9, 0.4]))), far.trajectory)
    assert [v.kind for v in again.judgement.violations] == ["goal"]


def test_an_arm_that_is_in_the_region_stays() -> None:
    bound = scene(AT | {"axis": "free"})
    point, _ = plan(bound).robot.tool_pose(plan(bound).task.start)
    near = {"position": (point + 0.01).tolist(), "axis": "free", "tolerance": {"position": 0.02}}
    made = plan(scene(near))
    assert made.success, made.message
    assert made.metrics.path_length == 0.0


def test_a_moving_arm_goes_on_to_a_region() -> None:
    bound = scene(AT | {"orientation": [0, 1, 0, 0]})
    first = plan(bound)
    again = plan(bound, previous=first, at=0.3)
    assert_success(again)
    assert again.trajectory.duration == pytest.approx(first.trajectory.duration - 0.3)
