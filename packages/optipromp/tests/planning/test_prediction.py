"""What the push of a plan is predicted to do, whoever planned it; and which path that chooses."""

from dataclasses import replace

import numpy as np
import pytest

from optipromp import judge
from optipromp.core import judging
from optipromp.core.errors import Code
from optipromp.core.planning import Plan, PlanOptions, plan
from optipromp.core.planning.task import Task, resolve, tool_motion
from optipromp.core.pushing.model import PushModel
from optipromp.core.pushing.packs.standing import Standing
from optipromp.core.pushing.stems.hanging import Hanging
from optipromp.core.scenes import Scene, ToolSpec
from optipromp_sim.generate import generate

HARMFUL = (1, 9)  # clusters in which the rule's path does harm
RULE = PlanOptions(prediction=False)


def model_of(task: Task) -> PushModel:
    found = task.push_model(plan(task.scene).trajectory.positions[-1])
    assert found is not None
    return found


def approach(result: Plan) -> np.ndarray:
    """Configurations from the camera point on."""
    tools = result.robot.tool_pose(result.trajectory.positions)[0]
    camera = resolve(result.scene).camera
    return result.trajectory.positions[int(np.argmin(np.linalg.norm(tools - camera, axis=1))) :]


def same(one: Plan, other: Plan) -> bool:
    first, second = one.trajectory, other.trajectory
    return np.array_equal(first.times, second.times) and np.array_equal(
        first.positions, second.positions
    )


# --- no success that is not one ----------------------------------------------------------------


@pytest.mark.parametrize(
    ("planner", "harmed"),
    [("promp", "n1 and n2 are swallowed"), ("i-promp", "n1 and n2 are swallowed")],
)
def test_a_plan_that_is_predicted_to_do_harm_is_no_success(planner, harmed, planned):
    """The judge finds nothing wrong with scenario 3; the model of the push names the fruit."""
    result = planned("scenario-3", planner)
    assert result.status is Code.HARM_PREDICTED
    assert not result.success
    verdict = judging.judge(result.scene, result.robot, result.trajectory, stem_side=False)
    assert verdict.violations == ()
    prediction = result.prediction
    assert prediction.harm > prediction.threshold
    assert f"{prediction.object} {prediction.cause}".startswith(harmed)
    assert result.message.startswith(f"harm is predicted: {harmed}")


def test_where_no_model_knows_the_push_nothing_is_predicted(three: Scene) -> None:
    objects = (replace(o, stem=None) for o in three.objects if o.role != "pushable")
    result = plan(replace(three, objects=tuple(objects)))
    assert result.success
    assert result.prediction is None
    assert result.to_dict()["predicted_harm"] is None


def test_the_judge_predicts_the_push_that_the_plan_does() -> None:
    """Not that of the whole motion, which may come near a fruit before the path begins."""
    apart = []
    for seed in range(20120, 20144):
        made = plan(generate("table-top", seed), seed=seed)
        task = resolve(made.scene)
        whole = tool_motion(task.robot, made.trajectory.positions)
        model, told = model_of(task), judge(made.scene, made.trajectory)
        assert told.status == made.status
        assert told.prediction.harm == made.prediction.harm
        apart.append(abs(model.harm(*whole, model.states) - made.prediction.harm))
    assert max(apart) > 0.05


# --- which model -------------------------------------------------------------------------------


def test_a_cup_meets_fruits_that_hang_and_a_hand_packs_that_stand(three: Scene) -> None:
    assert isinstance(model_of(resolve(three)), Hanging)
    assert isinstance(model_of(resolve(generate("shelf", 1))), Standing)

    def known(scene: Scene) -> PushModel | None:
        task = resolve(scene)
        return task.push_model(task.start)

    def stemless(role: str) -> Scene:
        objects = [replace(t, stem=None) if t.role == role else t for t in three.objects]
        return replace(three, objects=tuple(objects))

    assert known(stemless("target")) is None
    assert isinstance(known(stemless("pushable")), Hanging)  # it knows the target, which hangs
    assert isinstance(known(replace(three, tool=ToolSpec("franka_hand", {}))), Hanging)
    alone = tuple(o for o in three.objects if o.role != "pushable")
    assert isinstance(known(replace(three, objects=alone)), Hanging)


def test_where_no_model_applies_a_stems_side_is_a_fault(three: Scene) -> None:
    """And where one does, it is a remark."""
    result = plan(three)
    assert "note: the tool passes n2 on the side of its stem" in result.message
    strict = judging.judge(three, result.robot, result.trajectory)
    assert any("n2 on the side of its stem" in str(found) for found in strict.violations)
    target = replace(three.target, stem=None)  # type: ignore[type-var]
    others = tuple(o for o in three.objects if o.role != "target")
    unknown = plan(replace(three, objects=(target, *others)))
    assert unknown.prediction is None
    assert unknown.success
    assert "side of its stem" not in unknown.message


# --- which path --------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", HARMFUL)
def test_where_the_rules_path_harms_another_is_found(seed: int) -> None:
    scene = generate("cluster", seed)
    rule, own = plan(scene, options=RULE), plan(scene)
    assert own.success, own.message
    assert not same(own, rule)
    assert rule.prediction.harmful
    assert own.prediction.harm < 0.5 * rule.prediction.harm


@pytest.mark.parametrize("seed", HARMFUL)
def test_the_arm_goes_the_way_that_was_chosen(seed: int) -> None:
    """In the corridor, as wide along each of three axes: as predicted, so done."""
    result = plan(generate("cluster", seed))
    low = len(result.trajectory.positions) - len(approach(result))
    chosen = result.robot.tool_pose(result.followed.positions[low - 1 :])[0]
    share = np.linspace(0.0, 1.0, 10_000)
    at = np.linspace(0.0, 1.0, len(chosen))
    fine = np.stack([np.interp(share, at, column) for column in chosen.T], axis=1)
    tools = result.robot.tool_pose(approach(result))[0]
    off = np.linalg.norm(tools[:, None] - fine[None], axis=2).min(axis=1).max()
    assert off < np.sqrt(3.0) * PlanOptions().corridor
