"""Plans that begin in a motion: no jump, nothing begun again, and what runs is kept."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from tests.planning.builders import block

from optipromp import judging
from optipromp.errors import Code, InvalidRequestError, StartInvalidError
from optipromp.geometry import Box
from optipromp.planning import Plan, plan
from optipromp.planning.task import resolve
from optipromp.planning.timing import joined
from optipromp.scenes import Scene, load_scene
from optipromp.scenes.generate import generate
from optipromp.trajectory import State

SHARES = (0.03, 0.2, 0.45, 0.7, 0.95)


@pytest.fixture(scope="module", params=["scenario-3", 61200, 61204])
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


@pytest.mark.parametrize("share", SHARES)
def test_where_nothing_changed_the_motion_runs_on(before: Plan, share: float) -> None:
    at = share * before.trajectory.duration
    after = plan(before.scene, previous=before, at=at)
    assert after.success
    assert_begins(after, before.trajectory.at(at))
    assert after.trajectory.duration == pytest.approx(before.trajectory.duration - at)
    t = np.linspace(0.0, after.trajectory.duration, 300)
    was, now = before.trajectory.sample(t + at)[0], after.trajectory.sample(t)[0]
    np.testing.assert_allclose(now, was, atol=1e-4)


def test_planning_again_and_again_arrives_no_later(before: Plan) -> None:
    made, passed, every = before, 0.0, before.trajectory.duration / 12
    while made.trajectory.duration > every:
        made = plan(before.scene, previous=made, at=every)
        assert made.success
        passed += every
    assert passed + made.trajectory.duration <= 1.001 * before.trajectory.duration + 0.02


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
        assert after.metrics.clearance_static is not None
        assert after.metrics.clearance_static > 0.0


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


def test_refusals(before: Plan) -> None:
    scene, end = before.scene, before.trajectory.duration
    for more, message in (
        ({"previous": before}, "go together"),
        ({"at": 1.0}, "go together"),
        ({"previous": before, "at": end + 1.0}, "lasts from 0 to"),
        ({"previous": before, "at": -0.1}, "lasts from 0 to"),
        ({"start_state": (np.zeros(7), np.zeros(3))}, "velocity of a state has shape"),
        ({"start_state": 3.0}, "start_state must be"),
    ):
        with pytest.raises(InvalidRequestError, match=message):
            plan(scene, **more)  # type: ignore[arg-type]
    fast = np.eye(7)[0] * 9.0
    with pytest.raises(StartInvalidError, match="joint1 moves at 9"):
        plan(scene, start_state=State(resolve(scene).start, fast))
    with pytest.raises(StartInvalidError, match="has 3 values"):
        plan(scene, start_state=State(np.zeros(3)))
