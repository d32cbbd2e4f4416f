"""Goals of scene files: orientation, free axis, tolerances, several goals, their refusals."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.refusals import assert_refused

from optipromp.core.errors import InvalidSceneError
from optipromp.core.scenes import (
    JointGoal,
    Pose,
    PoseGoal,
    RegionGoal,
    Scene,
    scene_from_dict,
    scene_to_dict,
)
from optipromp.core.scenes.rotations import from_quaternion

HALF = math.sqrt(0.5)
AT = {"position": [0.4, 0.1, 0.6]}
BOX = {"position": [0.1, 0.02, 0.05]}


def scene(goal: Any, **more: Any) -> Scene:
    return scene_from_dict({"name": "s", "robot": "panda", "goal": goal, **more})


def test_a_position_alone_is_refused_with_what_can_be_said() -> None:
    offers = "goal: has position alone", "axis: [x, y, z]", "[w, x, y, z]", "axis: free"
    assert_refused(InvalidSceneError, offers, scene, AT)


def test_what_a_goal_of_the_tool_may_say() -> None:
    assert isinstance(scene(AT | {"axis": [0, 0, 2]}).goal, PoseGoal)
    free = scene(AT | {"axis": "free"}).goal
    assert isinstance(free, RegionGoal)
    assert free.direction is None
    turned = scene(AT | {"orientation": [0, 1, 0, 0]}).goal
    assert isinstance(turned, RegionGoal)
    assert turned.direction is not None
    np.testing.assert_allclose(turned.direction, [0.0, 0.0, -1.0], atol=1e-15)
    assert (turned.radius, turned.tilt) == (1e-3, pytest.approx(math.radians(2.0)))
    ball = scene(AT | {"axis": [0, 0, 1], "tolerance": {"position": 0.02, "angle": 30}}).goal
    assert isinstance(ball, RegionGoal)
    assert (ball.within, ball.angle, ball.extents) == (0.02, 30.0, None)


@pytest.mark.parametrize(
    ("goal", "words"),
    [
        (AT | {"axis": "fre"}, "goal.axis: is 'fre': must be [x, y, z] or free"),
        (AT | {"axis": [0, 1]}, "goal.axis: has 2 entries: must have 3"),
        (AT | {"axis": [0, 0, 1], "orientation": [1, 0, 0, 0]}, "has axis and orientation"),
        (AT | {"orientation": [1, 1, 0, 0]}, "must be a unit quaternion"),
        (AT | {"axis": "free", "tolerance": {"angle": 3}}, "goes with an axis or an orientation"),
        (AT | {"axis": "free", "tolerance": {"position": [1, 2]}}, "three half extents"),
        (AT | {"axis": "free", "tolerance": {"positon": 1}}, "did you mean 'position'"),
        (
            AT | {"axis": "free", "tolerance": {"position": 1, "orientation": [1, 0, 0, 0]}},
            "goes with half extents",
        ),
        ({"joints": [0.0], "tolerance": {}}, "has joints and tolerance"),
        ([], "goal has 0 entries: must have at least 1"),
    ],
)
def test_refusals_say_what_would_be_right(goal: Any, words: str) -> None:
    assert_refused(InvalidSceneError, words, scene, goal)


@pytest.mark.parametrize(
    "goal",
    [
        AT | {"axis": "free"},
        AT | {"orientation": [HALF, 0, HALF, 0]},
        AT | {"orientation": [HALF, 0, HALF, 0], "tolerance": BOX | {"angle": 5.0}},
        AT | {"axis": [0, 1, 0], "tolerance": BOX | {"orientation": [0, 1, 0, 0]}},
        [AT | {"axis": "free", "tolerance": {"position": 0.1}}, {"joints": [0.0, 1.0]}],
        [AT | {"axis": [0.0, 0.0, 1.0]}],
    ],
)
@pytest.mark.parametrize("frame", ["world", "base"])
def test_a_saved_goal_is_the_same_goal(goal: Any, frame: str) -> None:
    base = {"position": [1.0, 2.0, 0.5], "orientation": [HALF, HALF, 0, 0]}
    told = scene_to_dict(scene(goal, base=base, frame=frame))
    assert scene_to_dict(scene_from_dict(told)) == told
    assert isinstance(told["goal"], list) == isinstance(goal, list)


quaternions = st.tuples(*[st.floats(-1.0, 1.0)] * 4).filter(lambda q: math.hypot(*q) > 0.1)


@settings(max_examples=30, deadline=None)
@given(quaternions)
def test_a_box_turns_with_its_frame(turn: tuple[float, ...]) -> None:
    pose = Pose(np.array([0.3, -0.2, 0.1]), np.array(turn) / math.hypot(*turn))
    off = np.array([0.09, 0.015, -0.045])
    for goal in (
        RegionGoal(np.array([0.4, 0.1, 0.6]), within=np.array(BOX["position"])),
        RegionGoal(
            np.array([0.4, 0.1, 0.6]), orientation=np.array([HALF, 0, HALF, 0]),
            within=np.array(BOX["position"]),
        ),
    ):  # fmt: skip
        moved = goal.transformed(pose)
        corner = goal.position + goal.extents[1] @ off
        np.testing.assert_allclose(
            (pose @ corner - moved.position) @ moved.extents[1], off, atol=1e-12
        )
        if goal.rotation is not None:
            assert moved.orientation is not None
            np.testing.assert_allclose(
                from_quaternion(moved.orientation), pose.rotation @ goal.rotation, atol=1e-12
            )


def test_a_scale_reaches_the_tolerances() -> None:
    goal = {"position": [400, 0, 600], "axis": "free", "tolerance": {"position": [100, 20, 50]}}
    found = scene(goal, scale=0.001).goal
    assert isinstance(found, RegionGoal)
    np.testing.assert_allclose(np.asarray(found.within), [0.1, 0.02, 0.05])


def test_several_goals_are_those_of_the_scene() -> None:
    goals = scene([AT | {"axis": "free"}, {"joints": [0.0] * 7}]).goals
    assert [type(goal) for goal in goals] == [RegionGoal, JointGoal]
    with pytest.raises(InvalidSceneError, match="goal has 0 entries: must have 1 to 1000"):
        Scene("s", "panda", (), goal=())
    with pytest.raises(InvalidSceneError, match=r"goal has 1001 entries: must have 1 to 1000"):
        Scene("s", "panda", (), goal=(goals[1],) * 1001)
