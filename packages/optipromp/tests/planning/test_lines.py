"""Way points before a goal: straight lines of the tool, what the judge says of them, refusals."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.planning.builders import assert_success, beside_a_box
from tests.refusals import assert_refused

from optipromp import load_plan, load_scene, write_plan
from optipromp.core.errors import Code, InvalidRequestError, InvalidSceneError
from optipromp.core.planning import Plan, judge, plan
from optipromp.core.planning.options import PlanOptions
from optipromp.core.scenes import Lines, Pose, Scene, save_scene, scene_from_dict, scene_to_dict
from optipromp.core.trajectory import Trajectory

HALF = math.sqrt(0.5)
DOWN = [0, 0, -1]
CORNERS = [[0.35, 0.3, 0.5], [0.55, 0.3, 0.5]]
LAST = [0.5, 0.3, 0.3]
GOAL = {"position": LAST, "axis": DOWN}
POINTS = [{"position": at, "axis": DOWN} for at in CORNERS]


def scene(waypoints: Any, goal: Any = GOAL, **more: Any) -> Scene:
    return beside_a_box(goal, **({"waypoints": waypoints} if waypoints else {}) | more)


def tool(made: Plan) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times (m,) every 2 ms, tool points (m, 3), axes of the tool's frame (m, 3, 3)."""
    times = np.linspace(0.0, made.trajectory.duration, int(made.trajectory.duration / 0.002))
    q, _, _ = made.trajectory.sample(times)
    turns = made.robot.segment_frames(q)[1][:, -1] @ made.robot.flange_rotation
    return times, made.robot.tool_pose(q)[0], turns


@pytest.mark.parametrize("stated", [scene(POINTS), load_scene("scenario-3"), scene(None)])
def test_shares_of_the_limits_are_kept(stated: Scene) -> None:
    """Half the velocity, a quarter of acceleration and jerk, of any motion; as a user of MoveIt."""
    usual = plan(stated)
    slower = plan(stated, velocity_scaling=0.5, acceleration_scaling=0.25)
    assert_success(slower)
    used = slower.metrics
    assert used.velocity_ratio <= 0.5 * (1.0 + 1e-9)
    assert max(used.acceleration_ratio, used.jerk_ratio) <= 0.25 * (1.0 + 1e-9)
    assert slower.trajectory.duration > usual.trajectory.duration
    assert slower.robot is usual.robot
    with pytest.raises(InvalidRequestError, match="velocity_scaling is 2: must be 1e-06 to 1"):
        plan(stated, velocity_scaling=2)


def test_the_tool_goes_along_straight_lines_from_the_first_way_point_on() -> None:
    made = plan(scene(POINTS))
    assert_success(made)
    _, points, turns = tool(made)
    near = [np.linalg.norm(points - at, axis=1) for at in (*CORNERS, LAST)]
    rows = [int(np.argmin(one)) for one in near]
    assert rows == sorted(rows)
    assert max(one.min() for one in near) < 5e-4
    for a, b, i, j in zip((*CORNERS,), (CORNERS[1], LAST), rows[:-1], rows[1:], strict=True):
        way = (np.array(b) - a) / np.linalg.norm(np.array(b) - a)
        off = points[i : j + 1] - a
        assert np.linalg.norm(off - np.outer(off @ way, way), axis=1).max() < 5e-4
        assert np.diff(off @ way).min() > -1e-4  # forward
    assert turns[rows[0] :, 2, 2].max() < -math.cos(math.radians(0.5))


def test_the_orientation_turns_evenly_and_the_tool_is_no_faster_than_asked() -> None:
    begin, end = [0.35, -0.3, 0.5], [0.5, -0.3, 0.3]
    points = [{"position": begin, "orientation": [0, HALF, HALF, 0]}]
    asked = scene({"points": points, "speed": 0.1}, {"position": end, "orientation": [0, 1, 0, 0]})
    made = plan(asked)
    assert_success(made)
    times, points_, turns = tool(made)
    first = int(np.argmin(np.linalg.norm(points_ - begin, axis=1)))
    gone = np.linalg.norm(points_[first:] - begin, axis=1) / 0.25
    angle = np.arctan2(turns[first:, 0, 1], -turns[first:, 1, 1])  # of the fingers, from -y to x
    np.testing.assert_allclose(angle, (1.0 - gone) * math.pi / 2.0, atol=0.01)
    speeds = np.linalg.norm(np.diff(points_[first:], axis=0), axis=1) / np.diff(times)[0]
    assert 0.09 < speeds.max() < 0.102
    quick = plan(scene(points, {"position": end, "orientation": [0, 1, 0, 0]}))
    assert quick.trajectory.duration < made.trajectory.duration
    found = judge(asked, quick.trajectory)
    assert [v.kind for v in found.judgement.violations] == ["line speed"]
    assert "waypoints.speed: at most 0.1" in found.message


def test_a_turn_in_place() -> None:
    """The whole turn is a line too, although the tool point stays."""
    turned = [{"position": LAST, "orientation": [0, HALF, HALF, 0]}]
    asked = scene({"points": turned, "speed": 0.1}, {"position": LAST, "orientation": [0, 1, 0, 0]})
    made = plan(asked)
    assert_success(made)
    _, points, turns = tool(made)
    way = turns[np.linalg.norm(points - LAST, axis=1) < 1e-4]
    assert way[:, 0, 1].max() > 0.999  # the fingers turn from x to -y
    assert way[:, 1, 1].min() < -0.999
    tipped = math.sin(math.radians(10.0)), -math.cos(math.radians(10.0))  # of half turns
    other = scene(
        [turned[0] | {"orientation": [0, *tipped, 0]}],
        {"position": LAST, "orientation": [0, 1, 0, 0]},
    )
    assert "is turned" in judge(other, made.trajectory).message


def test_a_free_axis_and_a_duration() -> None:
    free = scene([{"position": CORNERS[0], "axis": "free"}], {"position": LAST, "axis": "free"})
    made = plan(free, options=PlanOptions(duration=6.0))
    assert_success(made)
    assert made.trajectory.duration == pytest.approx(6.0)
    assert made.metrics.goal_axis_error is None


def test_a_start_at_the_first_way_point_and_at_the_goal() -> None:
    """The tool goes to the way point and comes back; then only the way back is left."""
    there = plan(scene(None, GOAL))
    back = replace(scene(POINTS[:1]), start=there.trajectory.positions[-1])
    made = plan(back)
    assert_success(made)
    _, points, _ = tool(made)
    assert np.linalg.norm(points - CORNERS[0], axis=1).min() < 5e-4
    begin = made.trajectory.positions[made.first]
    short = plan(replace(back, start=begin))
    assert_success(short)
    assert short.first == 0
    assert short.metrics.path_length < 0.6 * made.metrics.path_length


def test_the_judge_names_line_way_point_amount_and_time() -> None:
    asked, made = scene(POINTS), plan(scene(POINTS))
    free = plan(scene(None, GOAL))
    found = judge(asked, free.trajectory)
    assert [v.kind for v in found.judgement.violations] == ["line"]
    assert "waypoints[" in found.message
    other_order = judge(scene(POINTS[::-1]), made.trajectory).judgement.violations
    assert [v.kind for v in other_order] == ["line"]
    assert (other_order[0].amount or 0.0) > 0.05
    q = np.array(made.trajectory.positions)
    middle = made.first + 15
    q[middle - 4 : middle + 5, 3] += 0.01 * np.hanning(9)
    bent = Trajectory.through(q, made.trajectory.times * 3.0, made.trajectory.joint_names)
    (wrong,) = judge(asked, bent).judgement.violations
    points, _ = made.robot.tool_pose(q)
    way = np.array(CORNERS[1]) - CORNERS[0]
    off = np.linalg.norm(np.cross(points - CORNERS[0], way / np.linalg.norm(way)), axis=1)
    assert wrong.kind == "line"
    assert "off the line from waypoints[0] to waypoints[1]" in str(wrong)
    assert wrong.amount == pytest.approx(off[middle], rel=0.1)
    assert wrong.time == pytest.approx(bent.times[middle], abs=0.1)
    wide = replace(asked, waypoints=Lines(asked.waypoints.points, within=0.02))  # type: ignore[union-attr]
    assert judge(wide, bent).status is Code.SUCCESS
    turned = scene(
        [{"position": at, "axis": [0.1, 0, -1]} for at in CORNERS],
        GOAL | {"axis": [0.1, 0, -1], "tolerance": {"angle": 10}},
    )
    (wrong,) = judge(turned, made.trajectory).judgement.violations
    assert "is turned 5.7 degrees off" in str(wrong)
    assert wrong.unit == "rad"


@pytest.mark.parametrize(
    ("begin", "end", "words"),
    [
        ([0.5, -0.3, 0.3], LAST, "from waypoints[0] to the goal: "),
        ([0.5, -0.3, 0.3], LAST, "enters box"),
        ([0.4, 0.3, 0.5], [0.9, 0.3, 0.5], "is at its limit"),
        ([0.4, 0.3, 0.5], [0.9, 0.3, 0.5], "no straight line from waypoints[0] to the goal"),
        ([2.0, 0.3, 0.5], LAST, "waypoints[0]: no configuration within the joint limits"),
        ([0.5, 0.0, 0.2], LAST, "waypoints[0]: every one of "),
    ],
)
def test_a_line_that_cannot_be_followed_is_refused(begin: Any, end: Any, words: str) -> None:
    made = plan(scene([{"position": begin, "axis": DOWN}], GOAL | {"position": end}))
    blocked = "every one" in words
    assert made.status is (Code.GOAL_IN_COLLISION if blocked else Code.GOAL_UNREACHABLE)
    assert words in made.message


def test_an_upright_tool_is_kept_so_on_lines_too() -> None:
    cup = {"upright": {"axis": DOWN, "angle": 6}}
    assert_success(plan(scene(POINTS, path=cup)))
    tilted = [0.2, 0, -1]  # 11 degrees
    made = plan(scene([POINTS[0], POINTS[1] | {"axis": tilted}], path=cup))
    assert made.status is Code.GOAL_UNREACHABLE
    assert "waypoints[0] to waypoints[1]" in made.message
    assert "the path's constraints are broken" in made.message


def test_a_running_motion_is_not_planned_anew() -> None:
    made = plan(scene(POINTS))
    with pytest.raises(InvalidRequestError, match="waypoints"):
        plan(made.scene, previous=made, at=0.2)


def test_saved_way_points_are_the_same_and_turn_with_the_frame(tmp_path: Path) -> None:
    asked = scene({"points": POINTS, "speed": 0.2, "within": 0.001})
    told = scene_to_dict(asked)
    assert scene_to_dict(scene_from_dict(told)) == told
    assert told["waypoints"]["speed"] == 0.2
    moved = asked.transformed(Pose(np.array([0.1, 0.2, 0.3]), np.array([HALF, HALF, 0.0, 0.0])))
    np.testing.assert_allclose(moved.waypoints.points[0].position, [0.45, -0.3, 0.6], atol=1e-12)
    np.testing.assert_allclose(moved.waypoints.points[0].axis, [0.0, 1.0, 0.0], atol=1e-12)
    based = scene(POINTS, base={"position": [0, 0, 0.3]}, scale=1.0)
    np.testing.assert_allclose(based.waypoints.points[0].position, [0.35, 0.3, 0.2])
    save_scene(asked, tmp_path / "s.yaml")
    write_plan(plan(load_scene(tmp_path / "s.yaml")), tmp_path / "out")
    assert load_plan(tmp_path / "out").success


@pytest.mark.parametrize(
    ("waypoints", "goal", "words"),
    [
        ([], GOAL, "waypoints"),
        ([{"position": LAST}], GOAL, "waypoints.points[0]: has position alone: must have one of"),
        ([{"position": LAST, "axes": DOWN}], GOAL, "did you mean 'axis'"),
        ({"points": POINTS, "sped": 1}, GOAL, "did you mean 'speed'"),
        ({"points": POINTS, "speed": 0}, GOAL, "waypoints.speed is 0: must be above 0"),
        (POINTS, {"joints": [0, 0, 0, -1, 0, 1, 0]}, "goal has joints: waypoints go with one goal"),
        (POINTS, [GOAL, GOAL], "goal has 2 entries: waypoints go with one goal"),
        (POINTS, {"position": LAST, "axis": "free"}, "has axis and the goal axis: free"),
        (POINTS, GOAL | {"axis": [0, 0, 1]}, "turns by 180 degrees from waypoints[1] to the goal"),
        ([*POINTS, POINTS[1]], GOAL, "waypoints[2] is where waypoints[1] is: must be another"),
        ([{"position": [350, 300, 500], "axis": DOWN}], GOAL, "waypoints[0].position"),
        ([{"position": LAST, "axis": [0, 0, 0]}], GOAL, "waypoints[0].axis is"),
    ],
)  # fmt: skip
def test_refusals_of_way_points(waypoints: Any, goal: Any, words: str) -> None:
    stated = {"name": "s", "robot": "panda", "goal": goal, "waypoints": waypoints, "objects": []}
    assert_refused(InvalidSceneError, words, scene_from_dict, stated)


@pytest.mark.parametrize(
    ("way", "words"),
    [
        ({"waypoints": POINTS}, "no goal: waypoints go with one goal"),
        ({"path": {"upright": {"axis": DOWN, "angle": 5}}}, "path goes with a goal"),
    ],
)
def test_what_a_scene_says_of_the_way_goes_with_a_goal(way: Any, words: str) -> None:
    fruit = {"id": "f", "role": "target", "shape": {"sphere": {"radius": 0.02}},
             "position": [0.4, 0.0, 0.6]}  # fmt: skip
    with pytest.raises(InvalidSceneError, match=words):
        scene_from_dict({"name": "s", "robot": "panda", "objects": [fruit], **way})
