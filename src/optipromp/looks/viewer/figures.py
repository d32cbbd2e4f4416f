"""Figures of a plan (the arm at one moment, joints over time, costs), and of a learnt primitive.

Drawn with matplotlib's object-oriented interface, without a display; nothing global is changed.
"""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from optipromp.core.judging import RATES
from optipromp.looks.viewer.drawn import FOLLOWED, OPTIMISED, PRIMITIVE, RED, motions
from optipromp.looks.viewer.reach import reach_figure, title

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from optipromp.core.judging import Violation
    from optipromp.core.planning import Plan, Term
    from optipromp.core.promp import Demonstrations, ProMP
    from optipromp.core.robots.model import Robot
    from optipromp.core.trajectory import Trajectory

LIMIT, RECORDED = "#7a7f87", "#3d434b"
LEAST = 0.05  # [rad or m] shown above and below the middle of a joint's motion, at least
CHANGED = 0.01  # change of a cost over its largest value above which the cost is drawn
_NAMES = {
    "static": "$F_s$, static obstacles",
    "avoid": "$F_d$, objects to avoid",
    "push": "$F_p$, pushing",
    "velocity": "$F_v$, joint velocity",
}


def plan_figures(plan: "Plan") -> dict[str, bytes]:
    """The figures of a plan as PNG files: ``reach``, ``joints``, and ``cost`` if one changed."""
    figures = {"reach": reach_figure(plan), "joints": joint_figure(plan)}
    if changed_terms(plan):
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


def changed_terms(plan: "Plan") -> Mapping[str, "Term"]:
    """The costs that differ between the trajectories or over the iterations."""
    out = {}
    for name, term in plan.terms.items():
        values = [term.initial, term.followed, term.final, *term.history]
        if max(values) - min(values) > CHANGED * max(map(abs, values)):
            out[name] = term
    return out


def cost_figure(plan: "Plan") -> "Figure":
    """Each cost that changed: at the conditioned ProMP, the followed path and each iteration."""
    from matplotlib.figure import Figure

    terms = changed_terms(plan)
    columns = 1 if len(terms) == 1 else 2
    rows = -(-len(terms) // columns)
    figure = Figure(figsize=(5.4 * columns, 3.1 * rows + 0.7), layout="constrained")
    panels = figure.subplots(rows, columns, squeeze=False).ravel()
    for panel, (name, term) in zip(panels, terms.items(), strict=False):
        _draw_cost(panel, _NAMES.get(name, name), term, {motion.name for motion in motions(plan)})
    for panel in panels[len(terms) :]:
        panel.set_visible(False)
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=3, frameon=False)
    figure.suptitle(f"{title(plan)}\ncosts", fontsize=11)
    return figure


def joint_figure(plan: "Plan") -> "Figure":
    """Joint positions of each trajectory over time, with the limits that are near."""
    robot = plan.robot
    figure, panels = _joint_panels(robot.n_joints)
    for joint, (panel, name) in enumerate(zip(panels, robot.joint_names, strict=True)):
        for motion in motions(plan):
            times = np.linspace(0.0, motion.trajectory.duration, 301)
            q = motion.trajectory.sample(times)[0][:, joint]
            panel.plot(times, q, color=motion.colour, lw=motion.width, label=motion.name)
        low, high = panel.get_ylim()
        room = max(0.5 * (high - low), LEAST)
        low, high = 0.5 * (low + high) - room, 0.5 * (low + high) + room
        limits = robot.lower[joint], robot.upper[joint]
        for limit in limits:
            if low - room < limit < high + room:
                panel.axhline(limit, color=LIMIT, lw=1.0, ls=(0, (4, 3)), label="limit")
                low, high = min(low, limit - 0.1 * room), max(high, limit + 0.1 * room)
        panel.set_ylim(low, high)
        unit = "m" if (robot.kinematics.kind[robot.kinematics.dof == joint] == 1).any() else "rad"
        panel.set_title(
            f"{name} [{unit}], limits {limits[0]:.2f} to {limits[1]:.2f}".replace("$", r"\$"),
            fontsize=9,
            loc="left",
        )
        panel.margins(x=0.0)
        _plain(panel)
    found = [panel.get_legend_handles_labels() for panel in panels]
    unique = {
        label: handle
        for handles, labels in found
        for label, handle in zip(labels, handles, strict=True)
    }
    figure.legend(
        unique.values(), unique.keys(), loc="outside lower center", ncols=4, frameon=False
    )
    figure.suptitle(f"{title(plan)}\njoints over time [s]", fontsize=11)
    return figure


def trajectory_figure(trajectory: "Trajectory") -> "Figure":
    """Joint positions over time."""
    figure, panels = _joint_panels(len(trajectory.joint_names))
    times = np.linspace(0.0, trajectory.duration, 301)
    q = trajectory.sample(times)[0]
    for joint, (panel, name) in enumerate(zip(panels, trajectory.joint_names, strict=True)):
        panel.plot(times, q[:, joint], color=OPTIMISED, lw=1.6)
        panel.set_title(f"{name} [rad or m]".replace("$", r"\$"), fontsize=9, loc="left")
        panel.margins(x=0.0)
        _plain(panel)
    figure.suptitle("joints over time [s]", fontsize=11)
    return figure


def limits_figure(
    trajectory: "Trajectory", robot: "Robot", violations: "Sequence[Violation]", name: str
) -> "Figure":
    """Each joint's velocity, acceleration and jerk over their limits, over time, and violations.

    A violation that has a time is a vertical line in the panel of its kind, else in all panels.
    """
    from matplotlib import colormaps
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.0, 8.0), layout="constrained")
    panels = figure.subplots(len(RATES), 1, sharex=True)
    t = np.linspace(0.0, trajectory.duration, 2001)
    _, velocity, acceleration = trajectory.sample(t)
    jerk = np.gradient(acceleration, t, axis=0)
    colours = colormaps["tab10"](np.arange(robot.n_joints) % 10)
    limits = robot.velocity, robot.acceleration, robot.jerk
    for panel, kind, values, limit in zip(
        panels, RATES, (velocity, acceleration, jerk), limits, strict=True
    ):
        for joint, label in enumerate(robot.joint_names):
            share = 100.0 * values[:, joint] / limit[joint]
            panel.plot(t, share, color=colours[joint], lw=1.2, label=label)
        high = max(112.0, 1.1 * float(np.abs(100.0 * values / limit).max()))
        for side in (-100.0, 100.0):
            panel.axhline(side, color=LIMIT, lw=1.0, ls=(0, (4, 3)))
        for found in violations:
            if found.time is not None and (found.kind == kind or found.kind not in RATES):
                panel.axvline(found.time, color=RED, lw=1.2)
                panel.annotate(
                    f" {found.kind} {found.subject}", (found.time, 0.97 * high), fontsize=8,
                    color=RED, va="top", ha="left" if found.time < t[-1] / 2 else "right",
                )  # fmt: skip
        panel.set_ylim(-high, high)
        panel.set_title(f"{kind}, % of its limit", fontsize=9, loc="left")
        panel.margins(x=0.0)
        _plain(panel)
    panels[-1].set_xlabel("time [s]")
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=7, frameon=False)
    wrong = f"{len(violations)} violations" if violations else "no violation"
    figure.suptitle(f"{name}: {wrong}".replace("$", r"\$"), fontsize=11)
    return figure


def primitive_figure(promp: "ProMP", demonstrations: "Demonstrations | tuple[()]" = ()) -> "Figure":
    """Each joint over the phase: the demonstrations, the mean, and two standard deviations."""
    figure, panels = _joint_panels(promp.n_joints)
    phases = np.linspace(0.0, 1.0, 201)
    mean, band = promp.mean_trajectory(phases), 2.0 * promp.standard_deviation(phases)
    faint = float(np.clip(20.0 / max(len(demonstrations), 1), 0.3, 0.8))
    for j, panel in enumerate(panels):
        for i, item in enumerate(demonstrations):
            label = "demonstrations" if i == 0 else None
            panel.plot(
                item.phases, item.positions[:, j], color=RECORDED, lw=0.7, alpha=faint, label=label
            )
        panel.fill_between(
            phases, mean[:, j] - band[:, j], mean[:, j] + band[:, j], color=OPTIMISED, alpha=0.2,
            lw=0, label="learnt mean ± 2 standard deviations",
        )  # fmt: skip
        panel.plot(phases, mean[:, j], color=OPTIMISED, lw=1.8)
        panel.set_title(promp.joint_names[j].replace("$", r"\$"), fontsize=9, loc="left")
        panel.set_ylabel("rad or m", fontsize=8)
        panel.margins(x=0.0, y=0.06)
        _plain(panel)
    handles, labels = panels[0].get_legend_handles_labels()
    legend = figure.legend(handles, labels, loc="outside lower center", ncols=2, frameon=False)
    for handle in legend.legend_handles:
        if handle is not None and handle.get_label() == "demonstrations":
            handle.set_alpha(1.0)
    counted = f"{promp.basis.count} bases a joint"
    if len(demonstrations):
        counted = f"{len(demonstrations)} demonstrations, {counted}"
    figure.suptitle(f"{counted}: joints over the phase", fontsize=11)
    return figure


def _joint_panels(joints: int) -> tuple["Figure", "NDArray[np.object_]"]:
    """A figure with a panel for each joint, column by column; the lowest have tick labels."""
    from matplotlib.figure import Figure

    columns = 2 if joints > 3 else 1
    rows = -(-joints // columns)
    figure = Figure(figsize=(5.6 * columns, 1.8 * rows + 0.9), layout="constrained")
    panels = figure.subplots(rows, columns, squeeze=False).ravel(order="F")
    for joint, panel in enumerate(panels):
        panel.set_visible(joint < joints)
        panel.tick_params(labelbottom=joint % rows == rows - 1 or joint == joints - 1)
    return figure, panels[:joints]


def _draw_cost(panel: "Axes", name: str, term: "Term", drawn: set[str]) -> None:
    """Draw a cost at each of the ``drawn`` trajectories, and at each iteration of its stage.

    Changes by other stages, before and after, lie apart from the iterations. The joint stage has no
    others: where its iterations do not begin at the followed path, they are of a scene without
    packs, and are not drawn.
    """
    alone = term.stage == "joint"
    optimised = len(term.history) > 1 and not (
        alone and not np.isclose(term.history[0], term.followed)
    )
    history = np.array(term.history if optimised else [term.followed, term.final])
    last = len(history) - 1
    gap = max(1.0, 0.25 * last)
    begin = 0.0 if np.isclose(history[0], term.followed) else -gap
    end = last if np.isclose(history[-1], term.final) else last + gap
    before = begin - gap if "followed path" in drawn else begin
    points = [
        (before, term.initial, PRIMITIVE, "conditioned ProMP", "ProMP"),
        (begin, term.followed, FOLLOWED, "followed path",
         "0" if optimised and begin == 0.0 else "followed"),
        (end, term.final, OPTIMISED, "optimised",
         f"{last}" if optimised and end == last else "optimised"),
    ]  # fmt: skip
    points = [point for point in points if point[3] in drawn]
    for at, values_at in (
        ([before, begin, 0.0], [term.initial, term.followed, history[0]]),
        ([last, end], [history[-1], term.final]),
    ):
        panel.plot(at, values_at, color=LIMIT, lw=1.0, ls=(0, (2, 2)))
    panel.plot(np.arange(last + 1), history, color=OPTIMISED, lw=1.6, marker="o", ms=3)
    for x, value, colour, label, _ in points:
        panel.plot([x], [value], color=colour, marker="o", ms=8, ls="none", label=label, zorder=4)
    values = np.array([term.initial, term.followed, term.final, *history])
    if values.min() > 0 and values.max() > 30 * values.min():
        panel.set_yscale("log")
    else:
        panel.set_ylim(min(0.0, float(values.min())), 1.12 * float(values.max()))
    told = " → ".join(f"{value:#.3g}" if value else "0" for _, value, *_ in points)
    panel.set_title(f"{name}: {told}", fontsize=9.5, loc="left")
    ticks = {x: tick for x, *_, tick in points}
    ticks |= {0.0: "0"} if begin < 0.0 else {}
    ticks |= {last: f"{last}"} if end > last else {}
    if optimised:
        ticks |= {t: f"{t:.0f}" for t in panel.get_xticks() if 0 < t < 0.93 * last and t % 1 == 0}
        panel.set_xlabel(f"iteration of the stage {term.stage}")
    panel.set_xticks([*ticks], [*ticks.values()])
    panel.set_ylabel("cost")
    panel.margins(x=0.08)
    _plain(panel)


def _plain(panel: "Axes") -> None:
    panel.spines[["top", "right"]].set_visible(False)
    panel.grid(color="#e6e8eb", lw=0.7)
    panel.set_axisbelow(True)
    panel.tick_params(labelsize=8)
