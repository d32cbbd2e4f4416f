"""Figures of a plan."""

import numpy as np
import pytest

from optipromp.planning import Plan, plan
from optipromp.viewer.figures import cost_figure, joint_figure, plan_figures, png
from optipromp.viewer.reach import passing_knot

SIGNATURE = b"\x89PNG\r\n\x1a\n"


@pytest.fixture(scope="module")
def result() -> Plan:
    return plan("scenario-3")


def test_every_figure_is_a_picture(result: Plan) -> None:
    figures = plan_figures(result)
    assert set(figures) == {"reach.png", "joints.png", "cost.png"}
    for content in figures.values():
        assert content.startswith(SIGNATURE)
        assert len(content) > 10_000


def test_a_plan_that_was_not_optimised_has_no_cost_figure() -> None:
    figures = plan_figures(plan("scenario-1", planner="promp"))
    assert set(figures) == {"reach.png", "joints.png"}


def test_the_joint_figure_has_a_panel_for_every_joint_with_its_limits(result: Plan) -> None:
    figure = joint_figure(result)
    panels = {panel.get_title(loc="left"): panel for panel in figure.axes if panel.get_visible()}
    assert set(panels) == {f"{name} [rad]" for name in result.robot.joint_names}
    for joint, name in enumerate(result.robot.joint_names):
        panel = panels[f"{name} [rad]"]
        heights = [np.asarray(line.get_ydata()) for line in panel.lines]
        np.testing.assert_array_equal(heights[0], result.initial.positions[:, joint])
        np.testing.assert_array_equal(heights[1], result.trajectory.positions[:, joint])
        assert {result.robot.lower[joint], result.robot.upper[joint]} == {
            float(height[0]) for height in heights[2:]
        }


def test_the_cost_figure_shows_each_history(result: Plan) -> None:
    figure = cost_figure(result)
    shown = [panel for panel in figure.axes if panel.get_visible()]
    histories = [
        term.history
        for term in result.terms.values()
        if len(term.history) > 1 and any(term.history)
    ]
    assert len(shown) == len(histories)
    for panel, history in zip(shown, histories, strict=True):
        np.testing.assert_array_equal(panel.lines[0].get_ydata(), history)


def test_the_arm_is_drawn_where_it_passes_the_last_pushable(result: Plan) -> None:
    knot = passing_knot(result, result.trajectory.positions)
    point, _ = result.robot.tool_pose(result.trajectory.positions[knot])
    assert point[2] == pytest.approx(0.8286, abs=0.02)


def test_pictures_are_the_same_each_time(result: Plan) -> None:
    assert png(joint_figure(result)) == png(joint_figure(result))
