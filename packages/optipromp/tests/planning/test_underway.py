"""Plans that begin in a motion: no jump, nothing begun again, and what runs is kept."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from tests.planning.builders import block, tool_speed

from optipromp.core import judging
from optipromp.core.errors import Code, InvalidRequestError, StartInvalidError
from optipromp.core.geometry import Box
from optipromp.core.planning import Plan, PlanOptions, plan
from optipromp.core.planning.parameters import TIMING
from optipromp.core.planning.task import resolve
from optipromp.core.planning.timing import joined, shortest, stopped
from optipromp.core.pushing.parameters import PUSH
from optipromp.core.robots.library import load_robot
from optipromp.core.scenes import JointGoal, Scene, load_scene
from optipromp.core.trajectory import State
from optipromp_sim.generate import generate


@pytest.fixture(scope="module", params=["scenario-3", 61200])
def before(request: pytest.FixtureRequest) -> Plan:
    which = request.param
    made = plan(load_scene(which) if isinstance(which, str) else generate("cluster", which))
    assert made.success
    return made


def shifted(scene: Scene, by: Any) -> Scene:
    """The scene with its target seen elsewhere."""
    objects = tuple(
        replace(o, position=o.position + by) if o.role == "target" else o for o in scene.objects
    )
    return replace(scene, objects=objects)


def assert_begins(made: Plan, state: State) -> None:
    first = made.trajectory.at(0.0)
    for name in ("q", "velocity", "acceleration"):
        np.testing.assert_allclose(getattr(first, name), getattr(state, name), atol=1e-7)
    assert not [v for v in judging.judge(
        made.scene, made.robot, made.trajectory, state, stem_side=False
    ).violations if v.kind in ("start", "motion", "velocity", "acceleration", "jerk")]  # fmt: skip


def test_a_hundred_plans_of_a_still_scene_are_one_curve(before: Plan) -> None:
    made, passed, every = before, 0.0, before.trajectory.duration / 101.5
    for _ in range(100):
        made = plan(before.scene, previous=made, at=every)
        assert made.success
        passed += every
        t = np.linspace(0.0, made.trajectory.duration, 20)
        was, now = before.trajectory.sample(t + passed), made.trajectory.sample(t)
        np.testing.assert_allclose(now[0], was[0], atol=1e-11)
        np.testing.assert_allclose(now[1], was[1], atol=1e-9)
    left = before.trajectory.duration - passed
    assert made.trajectory.duration == pytest.approx(left, abs=1e-9)


def test_a_motion_to_joints_runs_on_too() -> None:
    scene = load_scene("scenario-4")
    goal = JointGoal(resolve(scene).robot.home + [0.6, 0.2, -0.2, 0.2, 0.1, -0.2, 0.3])
    objects = tuple(o for o in scene.objects if o.role == "static")
    scene = replace(scene, objects=objects, goal=goal)
    first = plan(scene)
    assert first.success
    after = plan(scene, previous=first, at=0.5)
    assert after.success
    t = np.linspace(0.0, after.trajectory.duration, 50)
    was, now = first.trajectory.sample(t + 0.5)[0], after.trajectory.sample(t)[0]
    np.testing.assert_allclose(now, was, atol=1e-12)


def among(made: Plan, begin: float = 0.0) -> float:
    """Largest speed of the tool from its approach on, after ``begin`` [s]."""
    return tool_speed(made, max(begin, float(made.trajectory.times[made.first])))


@pytest.mark.parametrize("share", [0.3, 0.5, 0.8, 0.93])
@pytest.mark.parametrize("by", [(0.01, 0.0, 0.0), (0.0, -0.01, 0.0), (0.0, 0.0, 0.009)])
def test_the_tool_stays_slow_among_fruits(before: Plan, share: float, by: Any) -> None:
    """Whether what runs is led to a target that moved, or another motion begins."""
    at = share * before.trajectory.duration
    scene = shifted(before.scene, np.array(by))
    again = (plan(scene, previous=before, at=at), plan(scene, start_state=before.trajectory.at(at)))
    for after in again:
        speed = after.metrics.approach_speed
        assert speed is None or speed <= PUSH.hanging.speed * 1.08
        assert not [v for v in after.message.split("; ") if "among fruits" in v]
        assert among(after) <= PUSH.hanging.speed * 1.1


def test_a_slower_approach_is_begun_on_the_way(before: Plan) -> None:
    at, slow = 0.5 * before.trajectory.duration, PlanOptions(approach_speed=0.04, risk=0.1)
    for more in ({"previous": before, "at": at}, {"start_state": before.trajectory.at(at)}):
        after = plan(before.scene, options=slow, **more)  # type: ignore[arg-type]
        assert after.success or "previous" not in more  # alone, the state tells of no push so far
        assert among(after) <= PUSH.hanging.speed * 1.05
        assert among(after, 0.3) <= 0.04 * 1.1


def test_a_tool_that_goes_back_among_fruits_is_slow() -> None:
    """The target is seen below the tool, which leaves the fruits and comes again."""
    scene = generate("table-top", 50001)
    first = plan(scene)
    state = first.trajectory.at(first.trajectory.duration - 0.25)
    seen = shifted(scene, np.array([0.007, 0.0, -0.0065]))
    after = plan(seen, start_state=state, options=PlanOptions(risk=0.1))
    assert after.first > 0  # it begins its approach again
    assert after.success
    assert after.metrics.approach_speed < PUSH.hanging.speed * 1.08


@pytest.mark.parametrize("seed", range(8))
def test_a_join_keeps_the_tools_speed_and_its_path(seed: int, before: Plan) -> None:
    """From a state on the approach, at up to its speed and in another direction."""
    rng, robot, curve = np.random.default_rng(seed), before.robot, before.trajectory
    row = int(rng.integers(before.first + 2, curve.n_waypoints - 20))
    q = curve.positions[row:]
    made = shortest(robot, q, 0, PUSH.hanging.speed)
    jacobian = robot.tool_jacobian(q[0])[0]
    aside = rng.normal(size=3) * 0.02
    velocity = rng.uniform(0.2, 0.9) * curve.velocities[row] + np.linalg.pinv(jacobian) @ aside
    state = State(q[0], velocity)
    speed = float(np.linalg.norm(jacobian @ velocity))
    path, _ = robot.tool_pose(made.sample(np.linspace(0.0, made.duration, 4000))[0])
    lead = joined(robot, state, made, 0, 0.002)
    times = np.arange(0.0, min(lead.duration, 1.0), 2e-3)
    points, _ = robot.tool_pose(lead.sample(times)[0])
    fastest = float(np.linalg.norm(np.diff(points, axis=0), axis=1).max() / 2e-3)
    assert fastest <= max(PUSH.hanging.speed * (1.0 + TIMING.spare), speed) * 1.02
    away = np.linalg.norm(points[:, None] - path, axis=2).min(axis=1)
    assert away.max() < 0.0025


@pytest.mark.parametrize("share", [0.2, 0.45, 0.7])
def test_a_target_that_moved_is_reached_without_beginning_again(before: Plan, share: float) -> None:
    at = share * before.trajectory.duration
    scene = shifted(before.scene, np.array([0.004, -0.004, 0.002]))
    after = plan(scene, previous=before, at=at)
    assert after.success
    assert after.metrics.goal_error < 1e-3
    assert_begins(after, before.trajectory.at(at))
    assert after.trajectory.duration < 1.4 * (before.trajectory.duration - at)
    tip, _ = after.robot.tool_pose(after.trajectory.resample(100).positions)
    height = tip @ scene.frame[2]
    if share > 0.4:  # on its approach the tool does not go back
        assert (np.maximum.accumulate(height) - height).max() < 2e-3
    for name, side in after.metrics.M_p.items():
        was = before.metrics.M_p[name]
        if side is not None and was is not None and abs(was) > 0.01:
            assert np.sign(side) == np.sign(was)


def test_what_came_into_the_way_is_gone_round(before: Plan) -> None:
    at = 0.1 * before.trajectory.duration
    ahead, _, _ = before.trajectory.sample(0.25 * before.trajectory.duration)
    wrist = before.robot.sphere_centers(ahead[0])[before.robot.spheres.link == 5].mean(axis=0)
    radius = float(np.max(before.robot.spheres.radius[before.robot.spheres.link == 5]))
    wall = block("static", Box((0.02, 0.02, 0.02)), wrist + [0.0, 0.0, -radius - 0.005])
    scene = replace(before.scene, objects=(*before.scene.objects, wall))
    after = plan(scene, previous=before, at=at)
    assert_begins(after, before.trajectory.at(at))
    if after.success:  # and where it is not, the judge says so
        assert (after.metrics.clearance_static or 0.0) > 0.0


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("planner", ["opti-promp", "promp"])
def test_a_state_of_ones_own(planner: Any, seed: int) -> None:
    scene = generate("cluster", 61200)
    robot, rng = resolve(scene).robot, np.random.default_rng(seed)
    q = resolve(scene).start
    state = State(q, rng.uniform(-0.2, 0.2, 7) * robot.velocity, rng.uniform(-1.0, 1.0, 7))
    made = plan(scene, planner=planner, start_state=(state.q, state.velocity, state.acceleration))
    assert_begins(made, state)
    if planner == "opti-promp":
        assert made.success


@pytest.mark.parametrize("seed", range(20))
def test_a_join_keeps_the_limits_the_rows_and_the_rest(seed: int, before: Plan) -> None:
    rng, robot = np.random.default_rng(seed), before.robot
    state = State(
        before.trajectory.positions[0], rng.uniform(-0.3, 0.3, 7) * robot.velocity,
        rng.uniform(-0.1, 0.1, 7) * robot.acceleration,
    )  # fmt: skip
    made = joined(robot, state, before.trajectory)
    assert made.n_waypoints == before.trajectory.n_waypoints
    np.testing.assert_allclose(made.velocities[0], state.velocity, atol=1e-12)
    np.testing.assert_array_equal(made.positions[-40:], before.trajectory.positions[-40:])
    found = judging.extremes(made)
    limits = np.stack([robot.velocity, robot.acceleration, robot.jerk])
    assert (found.largest <= limits * (1.0 + 1e-9)).all()


@pytest.mark.parametrize("share", [0.1, 0.3])
def test_a_plan_that_begins_in_motion_keeps_the_shares_of_the_limits(share: float) -> None:
    scene = load_scene("scenario-3")
    asked = {"velocity_scaling": share, "acceleration_scaling": share}
    first = plan(scene, **asked)  # type: ignore[arg-type]
    state = first.trajectory.at(0.3 * first.trajectory.duration)
    made = plan(shifted(scene, np.array([0.01, 0.0, 0.0])), start_state=state, **asked)  # type: ignore[arg-type]
    assert np.abs(state.velocity).max() > 0.0
    assert_begins(made, state)
    used = made.metrics
    assert max(used.velocity_ratio, used.acceleration_ratio, used.jerk_ratio) <= share * (1 + 1e-6)


@pytest.mark.parametrize("seed", range(5))
def test_without_a_plan_a_moving_arm_comes_to_rest(seed: int) -> None:
    scene, rng = load_scene("scenario-3"), np.random.default_rng(seed)
    robot = resolve(scene).robot
    bare = replace(scene, objects=tuple(replace(o, stem=None) for o in scene.objects))
    far = shifted(bare, np.array([2.0, 0.0, 0.0]))
    state = State(resolve(scene).start, rng.uniform(-0.3, 0.3, 7) * robot.velocity)
    made = plan(far, start_state=state)
    assert made.status is Code.GOAL_UNREACHABLE
    assert_begins(made, state)
    assert not made.trajectory.velocities[-1].any()
    assert made.trajectory.duration < 1.0


@pytest.mark.parametrize("arm", ["panda", "scara"])
def test_a_stop_is_as_hard_as_the_limits_allow(arm: str) -> None:
    """From a joint's limit, moving out: it leaves the limit by the least; in other states too."""
    robot = load_robot(arm)
    limits = np.stack([robot.velocity, robot.acceleration, robot.jerk])
    for seed in range(60):
        rng = np.random.default_rng(seed)
        joint = int(rng.integers(robot.n_joints))
        velocity = rng.uniform(-0.7, 0.7, robot.n_joints) * robot.velocity
        velocity[joint] = abs(velocity[joint])
        gain = rng.uniform(-0.3, 0.3, robot.n_joints) * robot.acceleration * (seed % 2)
        q = rng.uniform(robot.lower, robot.upper)
        q[joint] = robot.upper[joint]
        made = stopped(robot, State(q, velocity, gain))
        np.testing.assert_allclose(made.velocities[0], velocity, atol=1e-12)
        np.testing.assert_allclose(made.accelerations[0], gain, atol=1e-12)
        assert not made.velocities[-1].any()
        assert not made.accelerations[-1].any()
        found = judging.extremes(made)
        assert (found.largest[1:] <= limits[1:] * (1.0 + 1e-6)).all()
        if not gain.any():  # ½ v²/a, and as long as the acceleration takes to grow and to vanish
            v, a, j = velocity, robot.acceleration, robot.jerk
            best = np.where(
                np.abs(v) > a * a / j, 0.5 * v * v / a + 0.5 * np.abs(v) * a / j,
                np.abs(v) * np.sqrt(np.abs(v) / j),
            )  # fmt: skip
            excess = (found.highest - robot.upper)[joint]
            tick = max(1e-3, 2.5 * float((a / j).max()) / 100)
            assert best[joint] * 0.999 <= excess <= best[joint] + 3.0 * tick * abs(v[joint])


def test_a_plan_says_that_its_stop_leaves_the_limits() -> None:
    scene = load_scene("scenario-3")
    robot, q = resolve(scene).robot, np.array(resolve(scene).start)
    q[1] = robot.upper[1]
    bare = replace(scene, objects=tuple(replace(o, stem=None) for o in scene.objects))
    made = plan(shifted(bare, np.array([2.0, 0.0, 0.0])), start_state=State(q, np.eye(7)[1] * 0.5))
    assert made.status is Code.GOAL_UNREACHABLE
    assert made.metrics.limit_violation < 0.5**2 / 2.0 / robot.acceleration[1] + 0.002
    assert "; on the way to rest joint2 leaves its limits by 0.01" in made.message


def test_refusals(before: Plan) -> None:
    scene, end = before.scene, before.trajectory.duration
    for more, message in (
        ({"previous": before}, "go together"),
        ({"at": 1.0}, "go together"),
        ({"previous": before, "at": end + 1.0}, "lasts from 0 to"),
        ({"previous": before, "at": -0.1}, "lasts from 0 to"),
        ({"start_state": (np.zeros(7), np.zeros(3))}, r"state\.velocity has shape"),
        ({"start_state": 3.0}, "start_state must be"),
    ):
        with pytest.raises(InvalidRequestError, match=message):
            plan(scene, **more)  # type: ignore[arg-type]
    fast = np.eye(7)[0] * 9.0
    with pytest.raises(StartInvalidError, match="joint1 moves at 9"):
        plan(scene, start_state=State(resolve(scene).start, fast))
    with pytest.raises(StartInvalidError, match="has 3 values"):
        plan(scene, start_state=State(np.zeros(3)))


@pytest.mark.parametrize("share", [0.5, 0.8])
def test_fruits_seen_elsewhere_before_their_push_keep_the_push_so_far(before, share):
    """2 mm each; a tracker gives them as they hung, another scene as they are."""
    at = share * before.trajectory.duration
    moved = tuple(
        replace(o, position=o.position + [0.0, 0.002, 0.0], stem=replace(
            o.stem, points=o.stem.points + [0.0, 0.002, 0.0],
        )) if o.stem is not None else o
        for o in before.scene.objects
    )  # fmt: skip
    scene = replace(before.scene, objects=moved)
    kept = plan(scene, previous=before, at=at, unpushed=True)
    anew = plan(scene, previous=before, at=at)
    assert not kept.task.underway.same
    assert not anew.task.underway.same
    assert anew.task.underway.pushed is None
    points, axes = kept.task.underway.pushed
    first = float(before.trajectory.times[before.first])
    tip, way = before.robot.tool_pose(before.trajectory.sample(np.array([first, at]))[0])
    np.testing.assert_allclose(points[[0, -1]], tip, atol=1e-9)
    np.testing.assert_allclose(axes[[0, -1]], way, atol=1e-9)
    assert_begins(kept, before.trajectory.at(at))
    again = plan(scene, previous=kept, at=0.1, unpushed=True)
    np.testing.assert_allclose(again.task.underway.pushed[0][: len(points)], points, atol=1e-12)
    assert len(again.task.underway.pushed[0]) > len(points)


def test_before_the_approach_nothing_was_pushed(before: Plan) -> None:
    at = 0.5 * float(before.trajectory.times[before.first])
    assert plan(before.scene, previous=before, at=at, unpushed=True).task.underway.pushed is None
