import numpy as np
import pytest

from optipromp.core import judging
from optipromp.core.errors import Code, InvalidRequestError
from optipromp.core.planning import IProMP, plan
from optipromp.core.planning.task import resolve
from optipromp.core.pushing import rule_paths
from optipromp.core.pushing.parameters import KNOWN
from optipromp.core.scenes import JointGoal, load_scene
from optipromp_bench.experiments.trials import STUDY_PLANNERS, attempt
from optipromp_paper.obstacles import Chomp, as_obstacles
from optipromp_sim.generate import generate


@pytest.mark.parametrize("preset", ["cluster", "shelf"])
def test_straight_goes_to_the_camera_point_and_then_along_the_approach(preset: str) -> None:
    scene = generate(preset, 7)
    made = attempt(scene, "straight")
    setup = resolve(scene)
    q = made.trajectory.positions
    np.testing.assert_array_equal(q[0], setup.start)
    tips, axes = setup.robot.tool_pose(q)
    assert np.linalg.norm(tips[-1] - scene.target.position) < 1e-4
    assert axes[-1] @ scene.frame[2] > np.cos(1e-3)
    camera = setup.camera
    stop = int(np.argmin(np.linalg.norm(tips - camera, axis=1)))
    assert np.linalg.norm(tips[stop] - camera) < 1e-4
    off = tips[stop:] - scene.target.position
    along = off @ scene.frame[2]
    aside = np.linalg.norm(off - along[:, None] * scene.frame[2], axis=1)
    assert aside.max() < 1e-3
    assert (np.diff(along) > -1e-6).all()


def test_straight_keeps_the_limits_and_says_what_it_touches() -> None:
    for seed in range(4):
        made = attempt(generate("table-top", seed), "straight")
        setup = resolve(generate("table-top", seed))
        verdict = judging.judge(
            setup.scene, setup.robot, made.trajectory, setup.state, stem_side=made.harm is None
        )
        assert verdict.metrics.velocity_ratio <= 1.0 + 1e-6
        assert verdict.metrics.acceleration_ratio <= 1.0 + 1e-6
        assert verdict.metrics.goal_error < 1e-3
        assert (made.status is Code.INVALID_PLAN) == bool(verdict.violations)
        if not verdict.violations:
            assert made.harm is not None
            harmful = made.harm > KNOWN.allowed(0.03)
            assert made.status is (Code.HARM_PREDICTED if harmful else Code.SUCCESS)


def test_straight_says_when_it_cannot_get_there() -> None:
    from dataclasses import replace

    scene = load_scene("scenario-3")
    far = replace(scene.target, position=np.array([2.0, 0.0, 0.5]), stem=None)
    made = attempt(replace(scene, objects=(far,)), "straight")
    assert made.status is Code.GOAL_UNREACHABLE
    assert made.trajectory is None
    no_target = replace(scene, objects=(), goal=JointGoal(scene.start + 0.05))
    with pytest.raises(InvalidRequestError, match="position and axis"):
        attempt(no_target, "straight")


def test_obstacles_and_chomp_see_obstacles_where_others_see_pushables() -> None:
    scene = generate("cluster", 3)
    copy = as_obstacles(scene)
    assert not copy.pushables
    assert {obj.id for obj in copy.avoid} == {obj.id for obj in scene.pushables}
    assert copy.target is scene.target


@pytest.mark.parametrize("seed", [0, 3])
def test_chomp_takes_the_tool_away_from_the_fruits(seed: int) -> None:
    """From the ProMP, whose start and goal configuration it keeps; the nearness to fruits falls."""
    scene = generate("cluster", seed)
    primitive, made = plan(scene, planner="promp").trajectory, attempt(scene, "chomp")
    begin, end = primitive.positions, made.trajectory.positions
    np.testing.assert_allclose(end[[0, -1]], begin[[0, -1]], atol=1e-12)
    problem = Chomp().problem(resolve(scene), len(begin))
    before, after = (problem.evaluate(q).costs["tool avoid"] for q in (begin, end))
    assert 0.0 < after < 0.4 * before
    other = attempt(scene, "obstacles")
    assert not np.array_equal(other.trajectory.positions, end)


@pytest.mark.parametrize(("preset", "seed"), [("cluster", 0), ("table-top", 0), ("table-top", 1)])
def test_obstacles_come_as_the_scene_says(preset: str, seed: int) -> None:
    """The judge finds nothing wrong with the motion: it comes along the scene's own approach."""
    made = attempt(generate(preset, seed), "obstacles")
    assert made.status in (Code.SUCCESS, Code.HARM_PREDICTED), made.message
    assert made.failure is not None


@pytest.mark.parametrize(
    "planner",
    [pytest.param(p, marks=pytest.mark.slow if p == "paper" else ()) for p in STUDY_PLANNERS],
)
def test_every_planner_answers(planner: str) -> None:
    made = attempt(generate("cluster", 1), planner, seed=1)
    assert made.planner == planner
    assert made.trajectory is not None
    assert made.seconds > 0.0
    assert made.message


def test_a_guard_is_led_under_the_fruits_and_opens_after_the_last_push() -> None:
    scene = generate("cluster", 1)
    open_, closed = (plan(scene, planner=IProMP(guard=guard)) for guard in (False, True))
    drop = {item.id: 0.02 + item.radius for item in scene.pushables}
    for one, other in zip(open_.via[1:-1], closed.via[1:-1], strict=True):
        below = (one.position - other.position) @ scene.frame[2]
        assert below == pytest.approx(drop[one.name.split()[0]])
    made = attempt(scene, "i-promp-guard")
    assert 0.3 * made.trajectory.duration < made.guard < made.trajectory.duration
    assert attempt(scene, "i-promp").guard == 0.0


def test_the_drift_rule_passes_along_y() -> None:
    """On either side of the line, the tool leaves it along y_g by R_gripper and more."""
    scene = generate("cluster", 1)
    task = resolve(scene)
    for corners in rule_paths(scene, task.neighbours, task.robot, task.camera, "paper"):
        off = (corners - scene.target.position) @ scene.frame[:2].T
        assert np.abs(off[:, 1]).max() > 0.5 * task.robot.gripper_radius
        fruits = [
            (item.position - scene.target.position) @ scene.frame[0] for item in task.neighbours
        ]
        assert np.abs(off[:, 0]).max() <= np.abs(fruits).max() + 1e-9
