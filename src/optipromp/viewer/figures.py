"""The figures of a plan: cost over iterations, joints over time, the arm before and after.

Drawn with matplotlib's object-oriented interface, without a display; nothing global is changed.
"""

from typing import TYPE_CHECKING

import numpy as np

from optipromp.viewer.reach import reach_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from optipromp.planning import Plan, Term

__all__ = ["cost_figure", "joint_figure", "plan_figures", "png", "reach_figure"]

BEFORE, AFTER, LIMIT = "#c8362c", "#1f5fb4", "#7a7f87"
_NAMES = {
    "static": "static obstacles",
    "avoid": "objects to avoid",
    "push": "pushing",
    "velocity": "velocity",
}


def plan_figures(plan: "Plan") -> dict[str, bytes]:
    """The figures of a plan as PNG files: ``reach``, ``joints`` and ``cost`` where it has one."""
    figures = {"reach": reach_figure(plan), "joints": joint_figure(plan)}
    if _optimised(plan):
        figures["cost"] = cost_figure(plan)
    return {f"{name}.png": png(figure) for name, figure in figures.items()}


def png(figure: "Figure", dpi: int = 160) -> bytes:
    """The figure as the content of a PNG file."""
    from io import BytesIO

    from matplotlib.backends.backend_agg import FigureCanvasAgg

    FigureCanvasAgg(figure)
    stream = BytesIO()
    figure.savefig(stream, format="png", dpi=dpi, metadata={"Software": "optipromp"})
    return stream.getvalue()


def cost_figure(plan: "Plan") -> "Figure":
    """Each term's cost over the iterations of the stage that optimises it."""
    from matplotlib.figure import Figure

    terms = _optimised(plan)
    columns = max(1, min(2, len(terms)))
    rows = max(1, -(-len(terms) // columns))
    figure = Figure(figsize=(4.4 * columns, 3.0 * rows), layout="constrained")
    panels = figure.subplots(rows, columns, squeeze=False).ravel()
    for panel, (name, term) in zip(panels, terms.items(), strict=False):
        solver = next((stage.solver for stage in plan.stages if stage.name == term.stage), "")
        _draw_cost(panel, _NAMES.get(name, name), term, solver)
    for panel in panels[len(terms) :]:
        panel.set_visible(False)
    figure.suptitle(f"{_title(plan)}: cost over iterations", fontsize=11)
    return figure


def joint_figure(plan: "Plan") -> "Figure":
    """Joint positions over time before (red) and after (blue), with their limits."""
    from matplotlib.figure import Figure

    robot = plan.robot
    columns = 2 if robot.n_joints > 3 else 1
    rows = -(-robot.n_joints // columns)
    figure = Figure(figsize=(5.2 * columns, 1.75 * rows + 0.7), layout="constrained")
    panels = figure.subplots(rows, columns, squeeze=False).ravel(order="F")
    for joint, (panel, name) in enumerate(zip(panels, robot.joint_names, strict=False)):
        prismatic = bool(np.any(robot.kinematics.kind[robot.kinematics.dof == joint] == 1))
        for trajectory, colour, label, width in (
            (plan.initial, "#e79a94", "before", 3.6),
            (plan.trajectory, AFTER, "after", 1.4),
        ):
            times = np.linspace(0.0, plan.trajectory.duration, trajectory.n_knots)
            panel.plot(times, trajectory.positions[:, joint], color=colour, lw=width, label=label)
        for limit in (robot.lower[joint], robot.upper[joint]):
            if np.isfinite(limit):
                panel.axhline(limit, color=LIMIT, lw=1.0, ls=(0, (4, 3)), label="limit")
        panel.set_title(f"{name} [{'m' if prismatic else 'rad'}]", fontsize=9, loc="left")
        panel.margins(x=0.0, y=0.08)
        _plain(panel)
    for panel in panels[robot.n_joints :]:
        panel.set_visible(False)
    handles, labels = panels[0].get_legend_handles_labels()
    unique = dict(zip(labels, handles, strict=True))
    figure.legend(
        unique.values(), unique.keys(), loc="outside lower center", ncols=3, frameon=False
    )
    figure.suptitle(f"{_title(plan)}: joints over time [s]", fontsize=11)
    return figure


def _optimised(plan: "Plan") -> dict[str, "Term"]:
    """The terms that a stage optimised and that were not zero all along."""
    return {
        name: term
        for name, term in plan.terms.items()
        if len(term.history) > 1 and any(term.history)
    }


def _draw_cost(panel: "Axes", name: str, term: "Term", solver: str) -> None:
    history = np.asarray(term.history, dtype=float)
    iterations = np.arange(len(history))
    panel.plot(iterations, history, color=AFTER, lw=1.6, marker="o", ms=3.5)
    panel.plot(iterations[:1], history[:1], color=BEFORE, marker="o", ms=5)
    positive = history[history > 0]
    if len(positive) == len(history) and history.max() > 30 * history.min():
        panel.set_yscale("log")
    else:
        panel.set_ylim(0.0, 1.08 * float(history.max()))
    first, last = history[0], history[-1]
    if last > 0 and first > last:
        change = f", ÷ {first / last:.3g}"
    elif last == 0 and first > 0:
        change = ", to zero"
    else:
        change = ""
    stage = f", {solver}" if solver else ""
    panel.set_title(f"{name}{stage}{change}", fontsize=9, loc="left")
    panel.set_xlabel("iteration")
    panel.set_ylabel("cost")
    _plain(panel)


def _plain(panel: "Axes") -> None:
    panel.spines[["top", "right"]].set_visible(False)
    panel.grid(color="#e6e8eb", lw=0.7)
    panel.set_axisbelow(True)
    panel.tick_params(labelsize=8)


def _title(plan: "Plan") -> str:
    strategy = f", {plan.strategy}" if plan.strategy else ""
    return f"{plan.scene.name}, {plan.planner}{strategy}"
