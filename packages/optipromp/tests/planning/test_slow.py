"""The tool is slow where it pushes or passes what stands, and only there."""

from dataclasses import replace

import numpy as np
import pytest
from tests.planning.fridge import fridge
from tests.robots.stock import stock

import optipromp
from optipromp.core import judging
from optipromp.core.errors import Code
from optipromp.core.geometry.shapes import Box, Cylinder
from optipromp.core.planning import Plan
from optipromp.core.planning.parameters import TIMING
from optipromp.core.planning.timing import quickened, shortest, slowly
from optipromp.core.pushing.parameters import PUSH
from optipromp.core.robots.library import load_robot
from optipromp.core.scenes import SceneObject
from optipromp.core.trajectory import Trajectory
from optipromp_sim.generate import generate
from optipromp_sim.simulation import simulate


@pytest.fixture(scope="module")
def shelf() -> Plan:
    return optipromp.plan(generate("shelf", 60001))


def away(item: SceneObject, points: np.ndarray) -> np.ndarray:
    """Distances of points (..., 3) to an upright can or a box, by their own formula."""
    local = (points - item.position) @ item.rotation
    if isinstance(item.shape, Cylinder):
        flat = np.linalg.norm(local[..., :2], axis=-1) - item.shape.radius
        out = np.stack([flat, np.abs(local[..., 2]) - 0.5 * item.shape.length], axis=-1)
    else:
        assert isinstance(item.shape, Box)
        out = np.abs(local) - 0.5 * np.array(item.shape.size)
    outside = np.linalg.norm(np.maximum(out, 0.0), axis=-1)
    return outside + np.minimum(out.max(axis=-1), 0.0)


def test_the_tool_is_slow_where_something_is_near_and_fast_elsewhere(shelf: Plan) -> None:
    assert shelf.success
    robot, made = shelf.robot, shelf.trajectory
    times = np.linspace(0.0, made.duration, 4000)
    q, _, _ = made.sample(times)
    points, _ = robot.tool_pose(q)
    speed = np.linalg.norm(np.diff(points, axis=0), axis=1) / np.diff(times)
    spheres, radius = robot.sphere_centers(q), robot.spheres.radius
    gaps = [(away(item, spheres) - radius).min(axis=1) for item in shelf.scene.pushables]
    near = np.min(gaps, axis=0)[1:] < 0.01
    assert near.any()
    assert speed[near].max() < PUSH.standing.beside * 1.1
    assert speed[~near].max() > 0.1
    assert shelf.metrics.approach_speed == pytest.approx(speed[near].max(), rel=0.05)
    assert made.times[shelf.first] < 2.0  # it took 9.5 s when the whole motion was slow
    assert made.duration < 0.7 * 56.7  # [s] which it took then


def test_where_it_pushes_it_keeps_the_speed_of_the_model(shelf: Plan) -> None:
    made = shelf.trajectory
    slow = slowly(shelf.task, made.positions, shelf.first)
    assert isinstance(slow, np.ndarray)
    assert 0.2 < slow.mean() < 0.9
    points, _ = shelf.robot.tool_pose(made.positions)
    speed = np.linalg.norm(np.diff(points, axis=0), axis=1) / np.diff(made.times)
    assert speed[slow].max() < PUSH.standing.speed * (1.0 + TIMING.spare)


def test_a_shelf_passed_too_fast_is_no_success(shelf: Plan) -> None:
    quick = shelf.trajectory.slowed(0.5)
    found = optipromp.judge(shelf.scene, quick)
    told = [v for v in found.judgement.violations if v.kind == "speed"]
    assert len(told) == 1
    assert "among objects that stand" in str(told[0])
    assert judging.too_fast(shelf.scene, told[0].amount)
    assert found.status is not Code.SUCCESS


def test_a_rate_changes_no_place_and_no_limit() -> None:
    panda = load_robot("panda")
    rng = np.random.default_rng(5)
    q = np.cumsum(0.02 * rng.standard_normal((40, panda.n_joints)), axis=0) + panda.home
    q = np.clip(q, panda.lower + 0.1, panda.upper - 0.1)
    made = Trajectory.through(q, 0.5, panda.joint_names)
    rate = np.where(np.arange(39) < 20, 8.0, 1.0)
    led = quickened(panda, made, rate)
    assert (led.positions == made.positions).all()
    assert np.diff(led.times)[21:] == pytest.approx(np.diff(made.times)[21:])
    assert led.times[20] < 0.6 * made.times[20]
    times = np.linspace(0.0, led.duration, 20_000)
    _, velocity, acceleration = led.sample(times)
    assert (np.abs(velocity) <= panda.velocity * 1.0001).all()
    assert (np.abs(acceleration) <= panda.acceleration * 1.0001).all()
    assert np.abs(np.diff(velocity, axis=0)).max() < 0.02  # no jump


HOME = np.array([0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785])  # of a Panda, half a metre away


@pytest.mark.parametrize("seed", [440_000, 440_001, 440_002])
def test_a_reach_from_home_takes_two_thirds_of_the_time_by_the_same_way(seed: int) -> None:
    scene = replace(generate("cluster", seed), start=HOME)
    slow, made = (optipromp.plan(scene, unhurried=alone) for alone in (True, False))
    assert made.success, made.message
    assert (made.trajectory.positions == slow.trajectory.positions).all()
    assert made.duration < 0.65 * slow.duration
    assert made.metrics.approach_speed == pytest.approx(slow.metrics.approach_speed, rel=1e-3)
    assert made.metrics.approach_speed < PUSH.hanging.speed * 1.1  # type: ignore[operator]
    assert made.harm == slow.harm


def test_the_free_part_takes_little_longer_than_the_joints_need() -> None:
    scene = replace(generate("cluster", 440_000), start=HOME)
    made = optipromp.plan(scene)
    robot, curve = made.robot, made.trajectory
    fruits = [item for item in scene.objects if item.stem is not None]
    points, _ = robot.tool_pose(curve.positions)
    away = np.min([np.linalg.norm(points - item.position, axis=1) for item in fruits], axis=0)
    last = int(np.argmax(away < 0.20))  # [m] of the tool point
    fastest = shortest(robot, curve.positions[: last + 1])  # which comes to rest there
    assert curve.times[last] < 1.1 * fastest.duration


def test_a_target_alone_is_not_run_into() -> None:
    scene = generate("cluster", 440_000)
    aside = [
        item.shifted([0.0, 0.0, 0.5]) if item.role == "pushable" else item for item in scene.objects
    ]
    made = optipromp.plan(replace(scene, objects=tuple(aside), start=HOME))
    robot, curve = made.robot, made.trajectory
    times = np.linspace(0.0, curve.duration, 4000)
    points, _ = robot.tool_pose(curve.sample(times)[0])
    speed = np.linalg.norm(np.diff(points, axis=0), axis=1) / np.diff(times)
    near = np.linalg.norm(points[1:] - scene.target.position, axis=1) < 0.03
    assert speed[near].max() < PUSH.hanging.speed * 1.1


@pytest.mark.filterwarnings("ignore:no built-in demonstrations")
def test_a_bottle_in_a_fridge_is_reached_in_half_the_time_as_gently() -> None:
    """An xArm7 behind two cups: slow only near, against the same path slow throughout."""
    made = optipromp.plan(fridge(stock("xarm7")))
    assert made.success, made.message
    even = shortest(made.robot, made.trajectory.positions, made.first, PUSH.standing.speed)
    assert made.metrics.duration < 0.5 * even.duration
    near, slow = simulate(made), simulate(even, made.scene, robot=made.robot)
    assert near.success
    hardest = [max(run.outcome.peak_force.values()) for run in (near, slow)]
    assert hardest[0] < 1.15 * hardest[1]
