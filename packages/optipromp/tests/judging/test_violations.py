"""What the judge must refuse, and how it measures a good trajectory."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from tests.judging.builders import UP, moving, obj, to

from optipromp.core import judging
from optipromp.core.geometry import Sphere
from optipromp.core.robots.model import Robot
from optipromp.core.scenes import JointGoal, PoseGoal, Scene
from optipromp.core.trajectory import State, Trajectory

STOPS = 1.875  # largest over mean speed of the quintic from stop to stop


def reach(gantry: Robot, end: Any = (0.4, 0.0, 0.0), waypoints: int = 9) -> Trajectory:
    return moving(gantry, np.linspace(np.zeros(3), end, waypoints))


def violations(scene: Scene, robot: Robot, trajectory: Trajectory, **more: Any) -> str:
    return judging.judge(scene, robot, trajectory, **more).message


def test_a_good_trajectory_has_none_and_is_measured(gantry: Robot) -> None:
    trajectory = moving(gantry, np.linspace([0, 0, 0], [0.4, 0.3, 0.0], 5), dt=0.5)
    judgement = judging.judge(
        to(JointGoal(np.array([0.4, 0.3, 0.0]))), gantry, trajectory, State(np.zeros(3))
    )
    assert judgement.violations == judgement.contacts == ()
    m = judgement.metrics
    assert (m.goal_error, m.goal_axis_error) == (pytest.approx(0.0, abs=1e-12), None)
    assert m.duration == 2.0
    assert m.limit_violation == 0.0
    assert m.max_step == pytest.approx(0.1)
    assert m.path_length == pytest.approx(0.5)
    assert m.velocity_ratio == pytest.approx(0.2 * STOPS)
    assert m.acceleration_ratio == m.jerk_ratio == 0.0  # this robot has no such limits


def test_limits(gantry: Robot) -> None:
    q = np.linspace([0, 0, 0], [0, 2.0, 0], 9)
    scene = to(JointGoal(q[-1]))
    assert violations(scene, gantry, moving(gantry, q)) == ""
    q[4, 1] = 2.0 + 1e-9
    q[5, 2] = -2.25
    judgement = judging.judge(scene, gantry, moving(gantry, q, dt=99.0))
    assert judgement.metrics.limit_violation == pytest.approx(0.25)
    assert "jz leaves its limits by 0.25" in judgement.message
    q[5, 2] = 0.0
    assert "jy leaves its limits" in violations(scene, gantry, moving(gantry, q, dt=99.0))


def test_velocity_and_acceleration(gantry: Robot) -> None:
    scene = to(JointGoal(np.array([0.4, 0.0, 0.0])))
    q = reach(gantry).positions
    assert violations(scene, gantry, moving(gantry, q, dt=0.1)) == ""
    fast = judging.judge(scene, gantry, moving(gantry, q, dt=0.05 * STOPS / 1.25))
    assert fast.metrics.velocity_ratio == pytest.approx(1.25)
    assert [*map(str, fast.violations)] == ["velocity of jx reaches 1.250 of its limit"]
    peak = 10.0 / np.sqrt(3.0) * 0.05 / 0.1**2  # of the quintic from stop to stop
    limited = replace(gantry, acceleration=np.full(3, 1.001 * peak))
    assert violations(scene, limited, moving(gantry, q, dt=0.1)) == ""
    tight = replace(gantry, acceleration=np.full(3, 0.8 * peak))
    found = judging.judge(scene, tight, moving(gantry, q, dt=0.1))
    assert found.metrics.acceleration_ratio == pytest.approx(1.25)
    assert [*map(str, found.violations)] == ["acceleration of jx reaches 1.250 of its limit"]
    rough = replace(gantry, jerk=np.full(3, 60.0 * 0.05 / 0.1**3 / 1.25))
    found = judging.judge(scene, rough, moving(gantry, q, dt=0.1))
    assert [*map(str, found.violations)] == ["jerk of jx reaches 1.250 of its limit"]


def test_start(gantry: Robot) -> None:
    scene, trajectory = to(JointGoal(np.array([0.4, 0.0, 0.0]))), reach(gantry)
    assert violations(scene, gantry, trajectory, start=State(np.zeros(3))) == ""
    assert violations(scene, gantry, trajectory, start=None) == ""
    late = violations(scene, gantry, trajectory, start=State(np.array([2e-6, 0.0, 0.0])))
    assert "does not begin at the start" in late


def test_goal_in_joints(gantry: Robot) -> None:
    for off, fine in ((0.9e-3, True), (1.1e-3, False)):
        scene = to(JointGoal(np.array([0.4, off, 0.0])))
        judgement = judging.judge(scene, gantry, reach(gantry))
        assert judgement.metrics.goal_error == pytest.approx(off)
        assert (judgement.violations == ()) == fine


def test_goal_of_the_tool(gantry: Robot) -> None:
    tip = np.array([0.4, 0.0, 0.13])  # the cup holds a fruit 0.13 above the flange
    for off, fine in ((0.9e-3, True), (1.1e-3, False)):
        for goal in (
            to(PoseGoal(tip + [0.0, 0.0, off], UP)),
            to(None, obj("target", Sphere(0.015), tip + [0.0, off, 0.0])),
        ):
            judgement = judging.judge(goal, gantry, reach(gantry))
            assert judgement.metrics.goal_error == pytest.approx(off)
            assert judgement.metrics.goal_axis_error == pytest.approx(0.0, abs=1e-9)
            assert (judgement.violations == ()) == fine


@pytest.mark.parametrize(("degrees", "fine"), [(1.9, True), (2.1, False), (180.0, False)])
def test_axis(degrees: float, fine: bool, gantry: Robot) -> None:
    angle = np.deg2rad(degrees)
    axis = np.array([np.sin(angle), 0.0, np.cos(angle)])
    judgement = judging.judge(to(PoseGoal(np.array([0.4, 0, 0.13]), axis)), gantry, reach(gantry))
    assert judgement.metrics.goal_axis_error == pytest.approx(angle, abs=1e-9)
    assert (judgement.violations == ()) == fine
    assert ("axis" in judgement.message) != fine


@pytest.mark.parametrize(
    ("role", "by_arm", "by_tool"),
    [("static", True, True), ("avoid", True, False), ("pushable", True, False)],
)
def test_who_may_touch_what(role: str, by_arm: bool, by_tool: bool, gantry: Robot) -> None:
    """B_d keeps off everything; the last link and the tool may brush what hangs."""
    end = np.array([0.4, 0.0, 0.0])
    on_arm = obj(role, Sphere(0.05), [0.2, 0.0, -0.5])
    on_tool = obj(role, Sphere(0.05), [0.2, 0.0, 0.1])
    for obstacle, fault in ((on_arm, by_arm), (on_tool, by_tool)):
        judgement = judging.judge(to(JointGoal(end), obstacle), gantry, reach(gantry))
        assert bool(judgement.contacts) == fault
        assert bool(judgement.violations) == fault
    m = judging.judge(to(JointGoal(end), on_arm), gantry, reach(gantry)).metrics
    key = {
        "static": "clearance_static",
        "avoid": "clearance_avoid",
        "pushable": "clearance_pushable",
    }
    assert getattr(m, key[role]) == pytest.approx(-0.07, abs=0.01)
    (contact,) = judging.judge(to(JointGoal(end), on_arm), gantry, reach(gantry)).contacts
    assert (contact.link, contact.other, contact.role) == ("y", "object", role)
    assert str(contact).startswith(f"y enters object ({role}) by ")
    if role == "avoid":
        brushed = judging.judge(to(JointGoal(end), on_tool), gantry, reach(gantry)).metrics
        assert brushed.clearance_avoid_tool < 0.0 < (brushed.clearance_avoid or 0.0)


def test_every_contact_is_named(gantry: Robot) -> None:
    objects = [obj("static", Sphere(0.03), [0.1 * i, 0.0, -0.5], name=f"s{i}") for i in range(1, 4)]
    judgement = judging.judge(to(JointGoal(np.array([0.4, 0, 0])), *objects), gantry, reach(gantry))
    assert [c.other for c in judgement.contacts] == ["s1", "s2", "s3"]


def test_a_violation_is_data_too(gantry: Robot) -> None:
    """What kind, what about, where first and by how much; as text it is a sentence."""
    q = np.linspace([0.0, 0.0, 0.0], [0.4, 0.0, 0.0], 9)
    q[4:6, 2] = -2.1, -2.25
    wall = obj("static", Sphere(0.05), [0.2, 0.0, -0.5], name="wall")
    goal = to(JointGoal(q[-1] + [0.0, 0.01, 0.0]), wall)
    judgement = judging.judge(goal, gantry, moving(gantry, q, dt=0.5), State(q[0] + 0.1))
    found = {v.kind: v for v in judgement.violations}
    assert set(found) == {"contact", "goal", "limit", "velocity", "start"}
    assert [v.kind for v in judgement.violations].count("contact") == len(judgement.contacts)
    assert found["limit"].subject == "jz"
    assert found["limit"].time == 2.5
    assert found["limit"].amount == pytest.approx(0.25)
    assert (found["goal"].amount, found["goal"].unit) == (pytest.approx(0.01), "rad")
    assert found["goal"].time == 4.0
    assert found["velocity"].subject == "jz"
    assert found["velocity"].time == 2.75  # in the middle of the interval from waypoint 5 to 6
    assert found["velocity"].amount == judgement.metrics.velocity_ratio
    assert found["start"].amount == pytest.approx(0.1)
    (contact,) = judgement.contacts
    assert (found["contact"].subject, found["contact"].amount) == (contact.link, contact.depth)
    assert judgement.message == "; ".join(str(v) for v in judgement.violations)


def test_a_start_may_be_reported_a_turn_off_and_a_goal_only_of_a_joint_without_limits(wheel):
    turn = 2.0 * np.pi
    for low, high, kinds in (
        (-np.inf, np.inf, []), (-turn, turn, ["goal"]), (-3.3, 2.9, ["start", "goal"]),
    ):  # fmt: skip
        robot = replace(wheel, lower=np.array([low]), upper=np.array([high]))
        scene = to(JointGoal(np.array([3.0])))
        made = moving(robot, np.linspace([-3.0], [3.0 - turn], 5))
        found = judging.judge(scene, robot, made, State(np.array([turn - 3.0]))).violations
        assert sorted(one.kind for one in found) == sorted(kinds)
