"""Figures of a plan."""

import os
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.colors import to_rgba

from optipromp.core.geometry.shapes import Box
from optipromp.core.planning import Plan, Term, plan
from optipromp.core.trajectory import Trajectory
from optipromp.laboratory.generate import generate
from optipromp.looks.viewer import drawn
from optipromp.looks.viewer.figures import (
    changed_terms,
    cost_figure,
    joint_figure,
    plan_figures,
    png,
    reach_figure,
)

SIGNATURE = b"\x89PNG\r\n\x1a\n"


@pytest.fixture(scope="module")
def result() -> Plan:
    return plan("scenario-3")


@pytest.fixture(scope="module")
def shelf() -> Plan:
    return plan(generate("shelf", 100))


def test_every_figure_is_a_picture(result: Plan) -> None:
    figures = plan_figures(result)
    assert set(figures) == {"reach.png", "joints.png", "cost.png"}
    for content in figures.values():
        assert content.startswith(SIGNATURE)
        assert len(content) > 10_000


def test_a_plan_that_was_not_optimised_has_no_cost_figure() -> None:
    figures = plan_figures(plan("scenario-1", planner="promp"))
    assert set(figures) == {"reach.png", "joints.png"}


@pytest.mark.parametrize(
    ("term", "shown"),
    [
        (Term(0.0, 0.0, 0.0, (0.0, 0.0), "joint"), False),
        (Term(3.0, 3.0, 3.0, (), ""), False),
        (Term(0.01425, 0.01424, 0.01423, (), ""), False),
        (Term(3.0, 3.1, 2.9, (), ""), True),
        (Term(0.0, 2e-5, 0.0, (2e-5, 0.0), "joint"), True),
        (Term(1.0, 1.0, 1.0, (1.0, 0.5, 1.0), "joint"), True),
    ],
)
def test_a_cost_is_drawn_where_it_changed(result: Plan, term: Term, shown: bool) -> None:
    one = replace(result, terms={"velocity": term})
    assert set(changed_terms(one)) == ({"velocity"} if shown else set())
    if shown:
        assert png(cost_figure(one)).startswith(SIGNATURE)


def test_the_cost_figure_shows_the_three_values_and_each_history(result: Plan) -> None:
    panels = [panel for panel in cost_figure(result).axes if panel.get_visible()]
    terms = changed_terms(result)
    assert len(panels) == len(terms) > 0
    for panel, term in zip(panels, terms.values(), strict=True):
        lines = {str(line.get_label()): line for line in panel.lines}
        for name, value in (
            ("conditioned ProMP", term.initial),
            ("followed path", term.followed),
            ("optimised", term.final),
        ):
            assert lines[name].get_ydata() == [value]
        history = term.history if len(term.history) > 1 else (term.followed, term.final)
        np.testing.assert_array_equal(panel.lines[2].get_ydata(), history)


def test_the_iterations_of_a_second_stage_are_drawn(result: Plan) -> None:
    """They begin where the first stage has left the cost, and a third one may change it again."""
    term = Term(1.0, 1.0, 0.2, (3.0, 2.0, 0.5, 0.1), "collision")
    (panel,) = cost_figure(replace(result, terms={"avoid": term})).axes
    np.testing.assert_array_equal(panel.lines[2].get_xdata(), [0, 1, 2, 3])
    np.testing.assert_array_equal(panel.lines[2].get_ydata(), term.history)
    np.testing.assert_array_equal(panel.lines[0].get_ydata()[1:], [1.0, 3.0])
    np.testing.assert_array_equal(panel.lines[1].get_ydata(), [0.1, 0.2])
    x = {str(line.get_label()): line.get_xdata()[0] for line in panel.lines[3:]}
    assert x["conditioned ProMP"] < 0.0
    assert x["optimised"] > 3.0
    assert panel.get_xlabel() == "iteration of the stage collision"


def test_a_history_of_another_scene_is_not_drawn(result: Plan) -> None:
    """Where packs are pushed, the optimiser looks at the scene without them."""
    term = Term(1.0, 2.0, 1.5, (0.0, 0.0, 0.0), "joint")
    (panel,) = cost_figure(replace(result, terms={"avoid": term})).axes
    np.testing.assert_array_equal(panel.lines[2].get_ydata(), [2.0, 1.5])


def test_the_joint_figure_has_a_panel_for_every_joint(result: Plan) -> None:
    panels = {panel.get_title(loc="left"): panel for panel in joint_figure(result).axes}
    robot = result.robot
    for joint, (name, low, high) in enumerate(
        zip(robot.joint_names, robot.lower, robot.upper, strict=True)
    ):
        panel = panels[f"{name} [rad], limits {low:.2f} to {high:.2f}"]
        for line, motion in zip(panel.lines, drawn.motions(result), strict=False):
            assert line.get_label() == motion.name
            q = motion.trajectory.sample(line.get_xdata())[0][:, joint]
            np.testing.assert_allclose(line.get_ydata(), q, atol=1e-12)
            assert np.asarray(line.get_xdata())[-1] == pytest.approx(result.trajectory.duration)


def test_a_limit_is_drawn_where_a_joint_comes_near_it(result: Plan) -> None:
    positions = result.trajectory.positions.copy()
    positions[-1, 0] = result.robot.upper[0] - 0.01
    near = replace(result, trajectory=replace(result.trajectory, positions=positions))
    first, second = joint_figure(near).axes[:2]
    heights = [
        np.asarray(line.get_ydata())[0] for line in first.lines if line.get_label() == "limit"
    ]
    assert heights == [result.robot.upper[0]]
    assert [line for line in second.lines if line.get_label() == "limit"] == []


def test_the_picture_names_the_moment_and_what_is_predicted(result: Plan) -> None:
    figure = reach_figure(result)
    now = drawn.moment(result)
    title = figure.get_suptitle()
    assert str(now) in title
    assert result.prediction is not None
    harm = f"predicted harm {result.prediction.harm:.2f} of at most"
    assert f"{harm} {result.prediction.threshold:g}" in title
    assert "%" not in title  # one figure, of one meaning
    assert str(result.status) in title
    words = {text.get_text() for legend in figure.legends for text in legend.get_texts()}
    assert {f"tool, {motion.name}" for motion in drawn.motions(result)} <= words
    assert {"chosen tool path", "where it was"} <= words
    assert {"tool at this moment", "tool at the end"} <= words
    assert not [panel for panel in figure.axes if "$" in panel.get_title()]


def test_a_close_view_leaves_out_what_only_touches_its_rim(result: Plan) -> None:
    """The clusters of scenario 3 were slivers at the edges of its first close view."""
    grey = np.array(to_rgba(drawn.COLOURS["avoid"])[:3])
    shown = []
    for panel in reach_figure(result).axes[1:]:
        colours = panel.collections[0].get_facecolors()[:, :3]
        shades = colours / np.maximum(colours.max(axis=1, keepdims=True), 1e-9)
        shown.append(int(np.isclose(shades, grey / grey.max(), atol=1e-3).all(axis=1).sum()))
    assert shown == [0, 2]


def test_no_two_labels_of_a_picture_overlap(result: Plan, shelf: Plan) -> None:
    for one in (result, shelf):
        figure = reach_figure(one)
        png(figure)
        named = {item.id for item in (one.scene.target, *one.scene.pushables) if item is not None}
        for panel in figure.axes[1:]:
            texts = [text for text in panel.texts if text.get_text().split(",")[0] in named]
            assert {text.get_text().split(",")[0] for text in texts} == named
            boxes = [text.get_bbox_patch().get_window_extent() for text in texts]  # type: ignore[union-attr]
            for i, a in enumerate(boxes):
                for b in boxes[:i]:
                    assert not a.shrunk(0.9, 0.75).overlaps(b.shrunk(0.9, 0.75))


def test_packs_are_drawn_where_the_hand_has_pushed_them(shelf: Plan) -> None:
    now = drawn.moment(shelf)
    assert now.event == "at the goal"
    items = [i for i in drawn.placed(shelf, now) if i.item.role == "pushable"]
    assert max(item.shift for item in items) > 0.02
    for item in items:
        along_x_g = (item.position - item.item.position) @ shelf.scene.frame[0]
        assert along_x_g == pytest.approx(0.0, abs=1e-9)  # it slides on its board
    turned = [i for i in items if isinstance(i.item.shape, Box)]
    assert any(not np.allclose(item.rotation, item.item.rotation) for item in turned)


def test_an_arm_that_stays_is_drawn(result: Plan) -> None:
    q = np.tile(result.trajectory.positions[0], (3, 1))
    still = Trajectory.through(q, 0.1, result.trajectory.joint_names)
    staying = replace(
        result, trajectory=still, initial=still, followed=still, first=1, prediction=None
    )
    assert "the arm stays at its start" in reach_figure(staying).get_suptitle()


def test_pictures_are_the_same_each_time(result: Plan) -> None:
    assert png(joint_figure(result)) == png(joint_figure(result))


def test_figures_need_no_display_and_leave_pyplot_alone() -> None:
    code = (
        "import sys\n"
        "from optipromp import plan\n"
        "from optipromp.looks.viewer.figures import plan_figures\n"
        "assert 'reach.png' in plan_figures(plan('scenario-1', planner='promp'))\n"
        "assert 'matplotlib.pyplot' not in sys.modules\n"
    )
    hidden = ("DISPLAY", "WAYLAND_DISPLAY", "MPLBACKEND")
    environment = {name: value for name, value in os.environ.items() if name not in hidden}
    subprocess.run([sys.executable, "-c", code], check=True, env=environment, timeout=300)
