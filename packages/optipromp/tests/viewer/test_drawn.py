"""What the pictures of a plan show."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from optipromp.core.planning import Plan, plan, plan_pick
from optipromp.core.planning.options import PlanOptions
from optipromp.core.planning.task import resolve
from optipromp.core.pushing.rules import pushes
from optipromp.looks.viewer import drawn
from optipromp.looks.viewer.reach import reach_figure
from optipromp_paper.paper import Paper


@pytest.fixture(scope="module")
def optimised() -> Plan:
    return plan("scenario-3")


@pytest.fixture(scope="module")
def interactive() -> Plan:
    return plan("scenario-2", planner="i-promp")


def test_three_trajectories_have_three_names(optimised: Plan) -> None:
    found = drawn.motions(optimised)
    assert [motion.name for motion in found] == ["conditioned ProMP", "followed path", "optimised"]
    assert [m.trajectory for m in found] == [
        optimised.initial, optimised.followed, optimised.trajectory,
    ]  # fmt: skip
    assert len({motion.colour for motion in found}) == 3


def test_of_trajectories_that_coincide_one_is_drawn(interactive: Plan) -> None:
    assert [motion.name for motion in drawn.motions(interactive)] == ["conditioned ProMP"]
    followed = plan("scenario-3", options=PlanOptions(iterations=0))
    assert [m.name for m in drawn.motions(followed)] == ["conditioned ProMP", "followed path"]


def test_the_moment_is_when_the_tool_is_level_with_the_last_fruit(optimised: Plan) -> None:
    now = drawn.moment(optimised)
    assert now.event == "as the tool passes n2"
    assert str(now) == f"as the tool passes n2, {now.time:.1f} s"
    assert now.time == pytest.approx(optimised.trajectory.times[now.waypoint])
    point, _ = optimised.robot.tool_pose(optimised.trajectory.positions[now.waypoint])
    (fruit,) = (item for item in optimised.scene.pushables if item.id == "n2")
    assert abs((point - fruit.position) @ optimised.scene.frame[2]) < 0.005


def test_what_was_picked_goes_with_the_tool_and_pushed_fruits_swing_back() -> None:
    made = plan_pick("scenario-4")
    reach, retreat = made.legs.values()
    target, end = reach.scene.target, made.duration
    assert drawn.held(made, reach.duration) == ()
    shown = {time: {one.item.id: one for one in drawn.shown_at(made, time)} for time in (0.0, end)}
    assert shown[0.0].keys() == shown[end].keys() == {item.id for item in reach.scene.objects}
    assert all(one.shift == 0.0 for one in shown[0.0].values())
    tips, axes = reach.robot.tool_pose(retreat.trajectory.positions[[0, -1]])
    before, after = ((p - tip) @ axis for p, tip, axis in zip(
        (target.position, shown[end][target.id].position), tips, axes, strict=True))  # fmt: skip
    assert after == pytest.approx(before, abs=1e-6)
    assert shown[end][target.id].shift > 0.09
    assert next(motion.name for motion in drawn.motions(made)) == "way out"


def test_without_fruits_in_the_way_the_moment_is_the_end(optimised: Plan) -> None:
    kept = tuple(item for item in optimised.scene.objects if item.role != "pushable")
    free = replace(optimised, task=resolve(replace(optimised.scene, objects=kept)))
    now = drawn.moment(free)
    assert (now.waypoint, now.event) == (free.trajectory.n_waypoints - 1, "at the goal")


def test_each_stem_has_a_colour_and_ends_at_its_root_and_its_fruit(optimised: Plan) -> None:
    found = [
        item
        for item in drawn.placed(optimised, drawn.moment(optimised))
        if item.stem is not None and item.item.stem is not None
    ]
    assert len(found) == 3
    assert len({item.colour for item in found}) == 3
    for item in found:
        np.testing.assert_allclose(item.stem[-1], item.item.stem.root, atol=1e-12)
        moved = item.item.stem.points[0] + item.position - item.item.position
        np.testing.assert_allclose(item.stem[0], moved, atol=1e-12)


def test_i_promp_shows_what_it_was_conditioned_on(interactive: Plan) -> None:
    task = resolve(interactive.scene)
    found = {name: point for name, point, _ in drawn.conditioned_on(interactive)}
    assert [*found] == ["start", "camera", "n1", "n1 pushed", "n2", "n2 pushed", "goal"]
    start, _ = interactive.robot.tool_pose(interactive.trajectory.positions[0])
    np.testing.assert_allclose(found["start"], start)
    np.testing.assert_allclose(found["camera"], task.camera)
    np.testing.assert_allclose(found["goal"], task.goal.position, atol=1e-6)
    for push in pushes(task.scene, task.neighbours, interactive.robot.gripper_radius):
        np.testing.assert_allclose(found[push.id], push.position)
        np.testing.assert_allclose(found[f"{push.id} pushed"], push.pushed)
    assert len(drawn.tool_path(interactive)) == 0


@pytest.mark.parametrize("strategy", ["sequential", "joint"])
def test_the_paper_s_planner_shows_what_it_was_conditioned_on(strategy: Any) -> None:
    """As figure 3 of the paper: start, camera point, the unripe fruits, and the target."""
    made = plan("scenario-3", planner=Paper(strategy=strategy))
    found = {name: point for name, point, _ in drawn.conditioned_on(made)}
    assert [*found] == ["start", "camera", "n1", "n2", "goal"]
    np.testing.assert_allclose(found["camera"], made.task.camera, atol=2e-4)
    np.testing.assert_allclose(found["goal"], made.task.goal.position, atol=1e-6)
    for fruit in made.task.neighbours:
        np.testing.assert_allclose(found[fruit.id], fruit.position, atol=2e-4)
    points, _ = made.robot.tool_pose(made.initial.positions)
    for name, most in (("start", 1e-6), ("n1", 0.008), ("n2", 0.008), ("goal", 1e-4)):
        away = np.linalg.norm(points - found[name], axis=1).min()
        assert away < most, f"the conditioned ProMP passes {name} {1e3 * away:.1f} mm away"
    words = {
        text.get_text() for legend in reach_figure(made).legends for text in legend.get_texts()
    }
    assert {"conditioned at: start", "camera", "unripe fruit", "target"} <= words


def test_opti_promp_shows_the_tool_path_that_was_chosen(optimised: Plan) -> None:
    path = drawn.tool_path(optimised)
    np.testing.assert_allclose(path[0], optimised.task.camera, atol=1e-3)
    np.testing.assert_allclose(path[-1], optimised.task.goal.position, atol=1e-3)
    assert drawn.conditioned_on(optimised) == ()
