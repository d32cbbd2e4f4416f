"""Objects that move are avoided in time; where one appears, the arm brakes and plans from there."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.judging.builders import gap

import optipromp
from optipromp.core.budget import Budget, pause
from optipromp.core.errors import Code
from optipromp.core.geometry.shapes import Box, Sphere
from optipromp.core.planning import Plan, PlanOptions
from optipromp.core.planning.planners import OptiProMP
from optipromp.core.planning.result import Answer
from optipromp.core.planning.task import Task
from optipromp.core.planning.underway import later
from optipromp.core.scenes import Scene, SceneObject
from optipromp.core.scenes.io import save_scene
from optipromp.core.scenes.objects import ObjectMotion
from optipromp.core.scenes.scene import JointGoal

OUT = np.array([0.5, 0.35, 0.0])  # [m] away from the arm's base


@pytest.fixture(scope="module")
def direct(bare: Scene) -> Plan:
    return optipromp.plan(bare, options=PlanOptions(duration=2.0))


@pytest.fixture(scope="module")
def middle(direct: Plan) -> np.ndarray:
    """The tool point half-way."""
    return direct.robot.tool_pose(direct.trajectory.at(1.0).q[None])[0][0]


def place(motion: ObjectMotion, t: Any) -> np.ndarray:
    """Position (3,) at a time or positions (T, 3) at times, by an interpolation of their own."""
    return np.stack([np.interp(t, motion.times, one) for one in motion.positions.T], axis=-1)


def poking(middle: np.ndarray, at: float = 1.0) -> SceneObject:
    """A ball that comes from outside, is at ``middle`` at a time, and goes back."""
    motion = ObjectMotion(
        np.array([0.0, at, 2.0 * at]), np.array([middle + OUT, middle, middle + OUT])
    )
    return SceneObject("ball", "static", Sphere(0.06), middle + OUT, motion=motion)


def gate(middle: np.ndarray) -> SceneObject:
    """A wall through ``middle`` that rises between 3 s and 4 s."""
    places = np.array([middle, middle, middle + [0.0, 0.0, 3.0]])
    motion = ObjectMotion(np.array([0.0, 3.0, 4.0]), places)
    return SceneObject("gate", "static", Box((2.0, 0.05, 2.5)), middle, motion=motion)


def test_the_judge_pads_what_moves_and_minds_no_pair_that_may_touch(bare, direct, middle):
    ball = poking(middle)
    curve = direct.trajectory
    met = optipromp.judge(replace(bare, objects=(ball,)), curve).judgement
    touched = {contact.link for contact in met.contacts}
    assert touched
    wide = optipromp.judge(replace(bare, objects=(ball,), padding=0.02), curve).judgement
    assert wide.metrics.clearance_static == pytest.approx(met.metrics.clearance_static - 0.02)
    free = replace(bare, objects=(ball,))
    for _ in range(8):  # each time the nearest link, until none is left that touches
        found = optipromp.judge(free, curve).judgement
        if not found.contacts:
            break
        free = replace(free, may_touch=(*free.may_touch, (found.contacts[0].link, "ball")))
    assert not found.contacts
    assert found.metrics.clearance_static > 0.0
    assert touched <= {link for link, _ in free.may_touch}


def test_a_ball_that_pokes_is_avoided_in_time(bare, direct, middle):
    ball = poking(middle)
    scene = replace(bare, objects=(ball,))
    assert gap(direct.robot, direct.trajectory, ball) < -0.02
    made = optipromp.plan(scene)
    assert made.success, made.message
    assert gap(made.robot, made.trajectory, ball) > 0.0
    assert made.scene.objects == (ball,)


def test_the_arm_waits_for_a_gate_that_leaves_no_way_round(bare: Scene, middle: np.ndarray) -> None:
    wall = gate(middle)
    made = optipromp.plan(replace(bare, objects=(wall,)))
    assert made.success, made.message
    assert gap(made.robot, made.trajectory, wall) > 0.0
    assert 3.0 < made.trajectory.duration < 6.0
    early = made.trajectory.at(2.9)
    assert np.abs(early.q - made.task.start).max() < 1.0  # it has not passed yet
    shut = ObjectMotion(np.array([0.0, 1.0]), np.array([middle, middle]))
    closed = optipromp.plan(replace(bare, objects=(replace(wall, motion=shut),)))
    assert not closed.success


def test_a_thing_that_moves_may_be_touched_wherever_it_comes(bare, direct, middle):
    """The hand ends in a cushion that moves, and goes round a post: one plan minds the two."""
    end = direct.robot.tool_pose(direct.trajectory.positions[-1:])[0][0]
    rise = ObjectMotion(np.array([0.0, 30.0]), np.array([end, end + [0.0, 0.0, 0.02]]))
    stay = ObjectMotion(np.array([0.0, 60.0, 62.0]), np.array([middle, middle, middle + 3 * OUT]))
    cushion = SceneObject("cushion", "static", Sphere(0.05), end, motion=rise)
    post = SceneObject("post", "static", Sphere(0.06), middle, motion=stay)
    pairs = tuple((link, "cushion") for link in direct.robot.link_names)
    scene = replace(bare, objects=(cushion, post), may_touch=pairs)
    made = optipromp.plan(scene)
    assert made.success, made.message
    assert made.scene == scene
    room = gap(direct.robot, made.trajectory, post)
    assert room > 0.01
    assert gap(direct.robot, made.trajectory, cushion) < -0.05
    wide = optipromp.plan(replace(scene, objects=(cushion, replace(post, padding=0.03))))
    assert wide.success, wide.message
    assert gap(direct.robot, wide.trajectory, post) > 0.03
    free = optipromp.judge(replace(scene, objects=(cushion,)), direct.trajectory).judgement
    assert free.metrics.clearance_static is None


def test_a_plan_underway_knows_how_late_it_is(bare, direct, middle):
    ball = poking(middle, at=1.4)
    scene = replace(bare, objects=(ball,))
    at = 0.5
    made = optipromp.plan(scene, previous=direct, at=at)
    shifted = later(scene, at).objects[0]
    assert shifted.motion is not None
    assert np.allclose(shifted.position, place(ball.motion, at))  # type: ignore[arg-type]
    assert made.success == (gap(direct.robot, made.trajectory, shifted) > 0.0)
    assert made.trajectory.at(0.0).near(direct.trajectory.at(at), 1e-6)


def test_an_arm_that_moves_brakes_before_a_gate_and_waits(bare: Scene, direct: Plan) -> None:
    """From a running motion, too: it begins as that motion is, and stops in its limits."""
    at = 0.5
    wall = gate(direct.robot.tool_pose(direct.trajectory.at(1.3).q[None])[0][0])
    scene = replace(bare, objects=(wall,))
    made = optipromp.plan(scene, previous=direct, at=at)
    assert made.success, made.message
    assert "brakes first" in made.message
    curve, shifted = made.trajectory, later(scene, at).objects[0]
    assert curve.at(0.0).near(direct.trajectory.at(at), 1e-9)
    assert gap(direct.robot, curve, shifted) > 0.0
    assert 2.5 < curve.duration < 6.0
    assert not curve.at(1.0).moving
    _, velocity, acceleration = curve.sample(np.linspace(0.0, curve.duration, 20_000))
    assert (np.abs(velocity) <= direct.robot.velocity * 1.001).all()
    assert (np.abs(acceleration) <= direct.robot.acceleration * 1.001).all()


def test_a_plan_that_brakes_too_late_says_so(bare: Scene, direct: Plan) -> None:
    wall = gate(direct.robot.tool_pose(direct.trajectory.at(1.3).q[None])[0][0])
    made = optipromp.plan(replace(bare, objects=(wall,)), previous=direct, at=0.9)
    assert not made.success
    assert "brakes too late: link5 enters gate" in made.message


def test_a_moving_object_in_files(tmp_path: Path) -> None:
    """A box crosses the way to the fruit: written, planned, judged again and simulated."""
    scene = optipromp.load_scene("scenario-3")
    usual = optipromp.plan(scene)
    half = usual.trajectory.at(0.3 * usual.trajectory.duration)
    point = usual.robot.tool_pose(half.q[None])[0][0]
    at = 0.3 * usual.trajectory.duration
    away = np.array([0.0, -0.6, 0.0])
    motion = ObjectMotion(
        np.array([0.0, at, 2.0 * at]), np.array([point + away, point, point + away])
    )
    box = SceneObject("cart", "static", Box((0.06, 0.06, 0.06)), point + away, motion=motion)
    crossed = replace(scene, name="crossed", objects=(*scene.objects, box))
    path = tmp_path / "crossed.yaml"
    save_scene(crossed, path)
    hit = optipromp.simulate(usual.trajectory, crossed, robot=usual.robot)
    assert not hit.success
    assert {c.other for c in hit.outcome.static_contacts} == {"cart"}
    optipromp.write_plan(optipromp.plan(optipromp.load_scene(path)), tmp_path / "plan")
    kept = optipromp.load_plan(tmp_path / "plan")
    assert kept.success
    assert optipromp.simulate(kept).success


class Slow:
    """A planner that takes a second of the plan's clock for a goal more than it does."""

    def __init__(self) -> None:
        self.asked = 0

    def solve(self, task: Task, budget: Budget) -> Answer:
        self.asked += 1
        pause(-1.0)
        return OptiProMP().solve(task, budget)


@pytest.mark.parametrize("what", ["stands", "moves"])
def test_time_holds_for_several_goals_and_what_was_not_tried_is_told(bare, what):
    away = [JointGoal(bare.goal.joints + 0.01 * np.eye(7)[0] * k) for k in range(30)]
    motion = ObjectMotion(np.array([0.0, 60.0]), np.array([4.0 * OUT, 5.0 * OUT]))
    ball = SceneObject("ball", "static", Sphere(0.06), 4.0 * OUT)
    ball = replace(ball, motion=motion if what == "moves" else None)
    slow = Slow()
    try:
        made = optipromp.plan(
            replace(bare, goal=tuple(away), objects=(ball,)), planner=slow, timeout=4.5
        )
    finally:
        pause(float(slow.asked))
    assert 2 <= slow.asked <= 5
    assert made.success
    assert f"{30 - slow.asked} of 30 goals were not tried, time ran out" in made.message


def test_a_search_among_what_moves_that_time_cuts_is_a_timeout(bare: Scene, direct: Plan) -> None:
    end = direct.robot.tool_pose(direct.trajectory.positions[-1:])[0][0]
    leaves = ObjectMotion(np.array([0.0, 3.0]), np.array([end, end + OUT]))
    ball = SceneObject("ball", "static", Sphere(0.06), end, motion=leaves)
    scene = replace(bare, objects=(ball,))
    assert optipromp.plan(scene).success
    slow = Slow()
    try:
        made = optipromp.plan(scene, planner=slow, timeout=0.5)
    finally:
        pause(float(slow.asked))
    assert slow.asked <= 1
    assert made.status is Code.TIMEOUT
    assert made.message.startswith("time ran out; the best so far: ")
