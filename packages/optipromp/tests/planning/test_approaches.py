"""Ways to come at an angle and beside the target's centre, where the straight way harms."""

from dataclasses import replace

import numpy as np
import pytest

from optipromp import load_scene, save_scene
from optipromp.core.errors import Code, InvalidSceneError
from optipromp.core.judging import judge
from optipromp.core.planning import plan, plan_many
from optipromp.core.planning.approaches import other_approaches
from optipromp.core.planning.parameters import APPROACH
from optipromp.core.planning.task import Task, resolve
from optipromp.core.pushing.parameters import PUSH
from optipromp.core.pushing.stems.cup import fits
from optipromp.core.scenes import Approach, Pose, Scene
from optipromp_sim.generate import generate
from optipromp_sim.generate.plants import untold
from optipromp_sim.simulation import simulate

REFUSED = "cluster", 32018  # harm is predicted on the straight way
STRAIGHT = {"cone": 0.0, "aside": 0.0}


@pytest.fixture(scope="module")
def refused() -> Scene:
    return allowed(generate(*REFUSED), **STRAIGHT)


def allowed(scene: Scene, cone: float | None = 25.0, aside: float | None = 0.01) -> Scene:
    return replace(scene, approach=replace(scene.approach, cone=cone, aside=aside))


def test_a_refused_plan_becomes_harmless_at_an_angle(refused: Scene) -> None:
    straight = plan(refused)
    assert straight.status == Code.HARM_PREDICTED
    made = plan(allowed(refused))
    assert made.success
    assert made.prediction.harm < straight.prediction.harm
    away = np.degrees(np.arccos(made.scene.frame[2] @ refused.frame[2]))
    assert 0.0 < away <= 25.0 + 1e-6
    _, axes = made.robot.tool_pose(made.trajectory.positions)
    np.testing.assert_allclose(axes[-1], made.scene.frame[2], atol=1e-3)
    assert not judge(made.scene, made.robot, made.trajectory, stem_side=False).violations
    assert simulate(made).outcome.success
    (one,) = plan_many([allowed(refused)], workers=1)
    np.testing.assert_array_equal(one.trajectory.positions, made.trajectory.positions)


def test_a_scene_that_says_nothing_leaves_the_approach_to_the_planner(refused: Scene) -> None:
    chosen, told = plan(allowed(refused, None, None)), plan(allowed(refused))
    assert chosen.success
    np.testing.assert_array_equal(chosen.trajectory.positions, told.trajectory.positions)


def test_a_scene_that_allows_none_or_needs_none_is_planned_straight(refused: Scene) -> None:
    scene = load_scene("scenario-4")
    one, two = plan(allowed(scene, **STRAIGHT)), plan(scene)
    np.testing.assert_array_equal(one.trajectory.positions, two.trajectory.positions)
    assert list(other_approaches(resolve(refused, one.robot))) == []


def test_approaches_stay_in_the_cone_and_the_target_in_the_mouth(refused: Scene) -> None:
    robot = plan(refused).robot
    room = robot.tool.mouth[0] - refused.target.radius
    for cone, aside in ((25.0, 0.0), (0.0, 0.5), (10.0, 0.003), (None, None)):
        task = resolve(allowed(refused, cone, aside), robot)
        assert next(other_approaches(task, end=0.0), None) is None  # the time is over
        found = [one.scene for one in other_approaches(task)]
        assert found
        for scene in found:
            angle = np.degrees(np.arccos(min(scene.frame[2] @ refused.frame[2], 1.0)))
            assert angle <= (APPROACH.cone if cone is None else cone) + 1e-6
            off = np.linalg.norm(scene.approach.shift)
            assert off <= min(APPROACH.aside if aside is None else aside, room) + 1e-12
            assert angle > 0.1 or off > 0.0
            assert abs(scene.approach.shift @ scene.frame[2]) < 1e-12


def test_to_what_stands_the_hand_comes_level_from_either_side() -> None:
    scene = generate("shelf", 3)
    found = [one.scene for one in other_approaches(resolve(scene))]
    assert len(found) == 2
    for one in found:
        assert abs(one.frame[2] @ one.up) < 1e-9
        angle = np.degrees(np.arccos(one.frame[2] @ scene.frame[2]))
        assert angle == pytest.approx(APPROACH.inner * APPROACH.cone)
    assert list(other_approaches(resolve(allowed(scene, **STRAIGHT)))) == []


def test_a_shifted_goal_is_reached_and_judged(refused: Scene) -> None:
    shift = np.array([0.002, 0.0, 0.0])
    scene = replace(refused, approach=replace(refused.approach, shift=shift))
    made = plan(scene)
    tip, _ = made.robot.tool_pose(made.trajectory.positions)
    assert scene.aim is not None
    np.testing.assert_allclose(tip[-1], scene.aim, atol=1e-3)
    wrong = judge(refused, made.robot, made.trajectory)
    assert any(item.kind == "goal" for item in wrong.violations)


def test_the_tool_turns_upright_on_its_way(refused: Scene) -> None:
    lead = np.array([np.sin(0.3), 0.0, np.cos(0.3)])
    scene = replace(refused, approach=replace(refused.approach, lead=lead))
    made = plan(scene)
    assert not judge(scene, made.robot, made.trajectory, stem_side=False).violations
    _, axes = made.robot.tool_pose(made.trajectory.positions)
    lean = np.degrees(np.arccos(np.clip(axes @ scene.frame[2], -1.0, 1.0)))[made.first :]
    assert lean[0] == pytest.approx(np.degrees(0.3), abs=2.5)
    assert lean[-1] < 0.5
    assert (np.diff(lean) < 0.5).all()


def test_the_cone_outlives_a_file_and_a_transformation(tmp_path, refused: Scene) -> None:
    scene = replace(
        refused,
        approach=replace(
            allowed(refused).approach,
            shift=np.array([0.001, 0.0, 0.0]),
            lead=np.array([0.1, 0.0, 1.0]),
        ),
    )
    save_scene(scene, tmp_path / "s.yaml")
    again = load_scene(tmp_path / "s.yaml").approach
    assert (again.cone, again.aside) == (25.0, 0.01)
    np.testing.assert_allclose(again.shift, scene.approach.shift)
    assert again.lead is not None
    np.testing.assert_allclose(again.lead, scene.approach.lead)
    turned = scene.transformed(Pose(np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]))).approach
    np.testing.assert_allclose(turned.shift, [-0.001, 0.0, 0.0], atol=1e-12)
    assert turned.lead is not None
    np.testing.assert_allclose(turned.lead, scene.approach.lead * [-1.0, -1.0, 1.0], atol=1e-12)
    assert turned.cone == 25.0


@pytest.mark.parametrize(("name", "value"), [("cone", 61.0), ("cone", np.nan), ("aside", -0.1)])
def test_what_no_approach_can_be_is_refused(name: str, value: float) -> None:
    with pytest.raises(InvalidSceneError, match=f"approach.{name}"):
        Approach(**{name: value})


def fitted(task: Task) -> tuple[float, float]:
    """Room of the target in the mouth, aside and over the floor, at the end of an approach [m]."""
    scene, tool = task.scene, task.robot.tool
    assert scene.target is not None
    assert tool is not None
    width, floor, _ = fits(scene.target, scene.frame[2][None], tool)
    return float(width[0]), float(floor[0] - scene.approach.shift @ scene.frame[2])


def test_the_direction_across_which_a_long_target_is_narrowest_comes_first() -> None:
    """It leans by 32 degrees: along the vertical it is wider than the mouth."""
    task = resolve(untold(generate("wild", 175047)))
    assert fitted(task)[0] < 0.0
    first, *others = other_approaches(task)
    room, _ = fitted(first)
    assert room > 0.002
    assert all(fitted(other)[0] <= room + 1e-4 for other in others)
    made = plan(untold(generate("wild", 175047)))
    assert made.success
    assert fitted(made.task)[0] > 0.002
    straight = plan(allowed(untold(generate("wild", 175047)), **STRAIGHT))
    assert straight.status == Code.HARM_PREDICTED or not straight.valid


def test_the_tool_ends_lower_below_a_target_that_is_longer_than_the_cup() -> None:
    scene = untold(generate("wild", 175042))
    _, floor = fitted(resolve(scene))
    assert floor < -0.004
    made = plan(scene)
    assert made.success
    assert fitted(made.task)[1] > -PUSH.harm.fit
    shift, axis = made.scene.approach.shift, made.scene.frame[2]
    assert -APPROACH.aside - 1e-9 <= shift @ axis < 0.0
    assert simulate(made, generate("wild", 175042)).outcome.success


def test_the_room_beside_a_leaning_cone_is_shared() -> None:
    """The tool ends under the middle of the outline, which is not under the target's centre."""
    task = resolve(untold(generate("wild", 175047)))
    target, axis = task.scene.target, task.scene.frame[2]
    middle = fits(target, axis[None], task.robot.tool)[2][0]
    assert np.linalg.norm(middle) > 0.002
    assert middle @ axis == pytest.approx(0.0, abs=1e-9)
    vertices = target.shape.mesh(48).vertices @ target.rotation.T
    centred, as_is = (
        vertices - off - np.outer((vertices - off) @ axis, axis) for off in (middle, 0 * middle)
    )
    assert np.linalg.norm(centred, axis=1).max() < np.linalg.norm(as_is, axis=1).max() - 0.002
