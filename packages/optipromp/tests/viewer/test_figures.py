"""Figures of a plan."""

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from optipromp.core.geometry.shapes import Box
from optipromp.core.planning import Plan, Term, plan
from optipromp.core.planning.task import resolve
from optipromp.core.promp import Basis, Demonstration, Demonstrations, fit
from optipromp.core.scenes.pose import Pose
from optipromp.core.trajectory import Trajectory
from optipromp.looks.viewer import drawn
from optipromp.looks.viewer.figures import (
    changed_terms,
    cost_figure,
    joint_figure,
    plan_figures,
    png,
    primitive_figure,
    reach_figure,
    reached,
    workspace_figure,
)
from optipromp.looks.viewer.reach import WORDS
from optipromp_sim.generate import generate

SIGNATURE = b"\x89PNG\r\n\x1a\n"


@pytest.fixture(scope="module")
def result() -> Plan:
    return plan("scenario-3")


@pytest.fixture(scope="module")
def shelf() -> Plan:
    return plan(generate("shelf", 100))


def test_every_figure_is_a_picture(result: Plan) -> None:
    figures = plan_figures(result)
    assert set(figures) == {"reach.png", "joints.png"}  # no cost changes over its iterations
    for content in figures.values():
        assert content.startswith(SIGNATURE)
        assert len(content) > 10_000


@pytest.mark.parametrize(
    ("term", "shown"),
    [
        (Term(3.0, 3.0, 3.0, (), ""), False),
        (Term(1.0, 2.0, 1.5, (1.0, 0.5, 0.0), "joint"), False),  # of a scene without packs
        (Term(1.0, 1.0, 0.2, (3.0, 2.0, 0.1), "collision"), True),
        (Term(0.0, 2e-5, 0.0, (2e-5, 0.0), "joint"), True),
    ],
)
def test_a_cost_is_drawn_where_its_iterations_change_it(result, term, shown):
    one = replace(result, terms={"velocity": term})
    assert set(changed_terms(one)) == ({"velocity"} if shown else set())
    if shown:
        assert png(cost_figure(one)).startswith(SIGNATURE)


@pytest.fixture(scope="module")
def paper() -> Plan:
    return plan("paper-3", planner="paper")


def test_the_cost_figure_shows_first_and_last_value_and_each_history(paper: Plan) -> None:
    panels = [panel for panel in cost_figure(paper).axes if panel.get_visible()]
    terms = changed_terms(paper)
    assert set(terms) == {"avoid", "push"}
    assert "cost.png" in plan_figures(paper)
    for panel, term in zip(panels, terms.values(), strict=True):
        lines = {str(line.get_label()): line for line in panel.lines}
        assert lines["conditioned ProMP"].get_ydata() == [term.initial]
        assert lines["optimised"].get_ydata() == [term.final]
        np.testing.assert_array_equal(panel.lines[2].get_ydata(), term.history)


def shares(panel: Axes) -> dict[str, Line2D]:
    """The lines of the joints by name."""
    return {str(line.get_label()): line for line in panel.lines if line.get_label()[0] != "_"}


def test_the_joint_figure_shows_each_joint_between_its_limits(result: Plan, paper: Plan) -> None:
    for one in (result, paper):
        robot, curve = one.robot, one.trajectory
        place, velocity, acceleration = joint_figure(one).axes
        for j, name in enumerate(robot.joint_names):
            t = np.asarray(shares(place)[name].get_xdata())
            assert (t[0], t[-1]) == (0.0, pytest.approx(curve.duration))
            q, v, a = curve.sample(t)
            low, high = robot.lower[j], robot.upper[j]
            for panel, share in (
                (place, (q[:, j] - low) / (high - low)),
                (velocity, v[:, j] / robot.velocity[j]),
                (acceleration, a[:, j] / robot.acceleration[j]),
            ):
                np.testing.assert_allclose(shares(panel)[name].get_ydata(), 100 * share, atol=1e-9)
        for panel, limits in ((place, (0, 100)), (velocity, (-100, 100))):
            bottom, top = panel.get_ylim()
            assert bottom < limits[0] < limits[1] < top


def test_a_joint_without_limits_has_no_place_between_them(result: Plan) -> None:
    """Neither has a kind of limit that no joint has a panel."""
    robot = result.robot
    lower = np.append(-np.inf, robot.lower[1:])
    free = replace(robot, lower=lower, acceleration=np.full(7, np.inf))
    place, velocity = joint_figure(replace(result, task=replace(result.task, robot=free))).axes
    assert np.isnan(np.asarray(shares(place)["joint1"].get_ydata())).all()
    assert np.isfinite(np.asarray(shares(place)["joint2"].get_ydata())).all()
    assert velocity.get_title(loc="left").startswith("velocity")


def test_the_picture_names_the_moment_and_what_is_predicted(result: Plan) -> None:
    figure = reach_figure(result)
    now = drawn.moment(result)
    title = figure.get_suptitle()
    assert str(now) in title
    assert f"end clean with probability {1.0 - result.prediction.probability:.2f}" in title
    assert "%" not in title  # one figure, of one meaning
    assert str(result.status) in title
    words = {text.get_text() for legend in figure.legends for text in legend.get_texts()}
    assert {f"tool, {WORDS.get(m.name, m.name)}" for m in drawn.motions(result)} <= words
    assert {"chosen tool path", "where it was"} <= words
    assert {"tool at this moment", "tool at the end"} <= words
    assert not [panel for panel in figure.axes if "$" in panel.get_title()]


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


def test_a_workspace_has_what_the_arm_can_do_and_tells_a_goal_beyond_it(result: Plan) -> None:
    robot = result.robot
    share = np.random.default_rng(1).random((200, robot.n_joints))
    points, axes = robot.tool_pose(robot.lower + share * (robot.upper - robot.lower))
    assert reached(robot, points).mean() > 0.97
    assert not reached(robot, points / np.linalg.norm(points, axis=1)[:, None] * 1.4).any()
    within = [reached(robot, points[k : k + 1], axes[k])[0] for k in range(10)]
    assert sum(within) >= 9
    far = result.scene.each(lambda item: item.transformed(Pose(np.array([1.0, 0.0, 0.0]))))
    figure = workspace_figure(robot, robot.home, resolve(far))
    assert "goal, not reached" in [text.get_text() for text in figure.legends[0].get_texts()]
    assert "no configuration within the joint limits" in figure.get_suptitle()


def test_pictures_are_the_same_each_time(result: Plan) -> None:
    assert png(joint_figure(result)) == png(joint_figure(result))


def test_figures_need_no_display_and_leave_pyplot_alone(tmp_path: Path) -> None:
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
    # a terminal of Jupyter names a backend that need not be installed
    environment["MPLBACKEND"] = "module://matplotlib_inline.backend_inline"
    command = "plan", "scenario-1", "--planner", "promp", "--out", str(tmp_path)
    told = [sys.executable, "-m", "optipromp", *command]
    assert subprocess.run(told, env=environment, timeout=300, check=False).returncode in (0, 1)
    assert (tmp_path / "reach.png").exists()


@pytest.mark.parametrize("joints", [1, 3, 7])
def test_a_panel_a_joint_with_every_demonstration_and_the_band(joints: int) -> None:
    rng = np.random.default_rng(0)
    names = (r"$\frac{$", *(f"q{j}" for j in range(1, joints)))
    y = rng.normal(size=(5, 1, joints)) + rng.normal(size=(5, 30, joints)).cumsum(axis=1) / 20
    demos = Demonstrations(tuple(Demonstration(np.arange(30.0), item) for item in y), names)
    promp = fit(demos, Basis(7))
    figure = primitive_figure(promp, demos)
    panels = {panel.get_title(loc="left"): panel for panel in figure.axes if panel.get_visible()}
    assert len(panels) == joints
    at = np.linspace(0.0, 1.0, 201)
    for j, name in enumerate(names):
        panel = panels[name.replace("$", r"\$")]
        *recorded, mean = panel.get_lines()
        for line, item in zip(recorded, y, strict=True):
            np.testing.assert_array_equal(line.get_ydata(), item[:, j])
        np.testing.assert_allclose(mean.get_ydata(), promp.mean_trajectory(at)[:, j])
        (band,) = panel.collections
        corners = band.get_paths()[0].vertices[:, 1]
        deviation = promp.standard_deviation(at)[:, j]
        assert corners.max() == pytest.approx(np.max(mean.get_ydata() + 2 * deviation))
        assert corners.min() == pytest.approx(np.min(mean.get_ydata() - 2 * deviation))
    assert png(figure).startswith(b"\x89PNG")
