"""Figures of a plan (the arm at one moment, joints over time, costs), and of a learnt primitive.
Drawn with matplotlib's object-oriented interface, without a display; nothing global is changed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from textwrap import fill
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial import cKDTree

from optipromp.core.arrays import BoolArray, FloatArray, frame_along, lengths
from optipromp.core.budget import Budget
from optipromp.core.judging import RATES, Violation
from optipromp.core.planning import Picked, Plan, Term, goals
from optipromp.core.planning.legs import curve_of, legs_of
from optipromp.core.planning.plan import plan as make_plan
from optipromp.core.planning.result import Planned
from optipromp.core.planning.task import Task, resolve
from optipromp.core.promp import Demonstrations, ProMP
from optipromp.core.robots import ik
from optipromp.core.robots.model import Robot
from optipromp.core.scenes.scene import JointGoal, Scene
from optipromp.core.trajectory import Trajectory, chained
from optipromp.looks.appearance import arm_parts, hex_colour, scene_parts
from optipromp.looks.viewer.drawn import (
    FOLLOWED,
    GREEN,
    OPTIMISED,
    PRIMITIVE,
    RED,
    motions,
)
from optipromp.looks.viewer.reach import reach_figure, title

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

LIMIT, RECORDED = "#7a7f87", "#3d434b"
SHOWN = ("limit", *RATES)  # kinds of violation that have a panel
APART = 2.0  # [% of a joint's range] from the plan, where the conditioned ProMP is drawn: a choice
CHANGED = 0.1  # change of a cost over its largest value above which the cost is drawn: a choice
_NAMES = {
    "static": "$F_s$, static obstacles",
    "avoid": "$F_d$, objects to avoid",
    "push": "$F_p$, pushing",
    "velocity": "$F_v$, joint velocity",
}


def plan_figures(made: Plan | Picked) -> dict[str, bytes]:
    """The figures of a plan as PNG files: ``reach``, ``joints``, and ``cost`` if one changed."""
    plan = legs_of(made)["reach"]
    figures = {"reach": reach_figure(plan), "joints": joint_figure(made)}
    if changed_terms(plan):
        figures["cost"] = cost_figure(plan)
    return {f"{name}.png": png(figure) for name, figure in figures.items()}


def png(figure: Figure, dpi: int = 160) -> bytes:
    """The figure as the content of a PNG file."""
    from io import BytesIO

    from matplotlib.backends.backend_agg import FigureCanvasAgg

    FigureCanvasAgg(figure)
    stream = BytesIO()
    figure.savefig(stream, format="png", dpi=dpi, metadata={"Software": "optipromp"})
    return stream.getvalue()


def changed_terms(plan: Plan) -> Mapping[str, Term]:
    """The costs that changed over the iterations of a stage. Iterations of the joint stage that do
    not begin at the followed path do not count: they are of a scene without packs."""
    out = {}
    for name, term in plan.terms.items():
        values = term.history or (0.0,)
        own = term.stage != "joint" or np.isclose(values[0], term.followed)
        if own and max(values) - min(values) > CHANGED * max(map(abs, values)):
            out[name] = term
    return out


def cost_figure(plan: Plan) -> Figure:
    """Each of the :func:`changed_terms`: at ProMP, followed path and each iteration."""
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


def joint_figure(made: Plan | Picked) -> Figure:
    """Each joint's place, velocity and acceleration over their limits, and the conditioned ProMP.
    The ProMP is drawn where it differs from the reach, at equal shares of both durations."""
    plan, *later = legs_of(made).values()
    promp = plan.initial.slowed(plan.duration / plan.initial.duration)
    before = chained([promp, *(leg.trajectory for leg in later)])
    return _over_limits(curve_of(made), plan.robot, (), title(plan), before)


def trajectory_figure(trajectory: Trajectory) -> Figure:
    """Joint positions over time."""
    figure, panels = _joint_panels(len(trajectory.joint_names))
    times = np.linspace(0.0, trajectory.duration, 301)
    q = trajectory.sample(times)[0]
    for joint, (panel, name) in enumerate(zip(panels, trajectory.joint_names, strict=True)):
        panel.plot(times, q[:, joint], color=OPTIMISED, lw=1.6)
        _plain(panel, f"{name} [rad or m]".replace("$", r"\$"))
    figure.suptitle("joints over time [s]", fontsize=11)
    return figure


def limits_figure(
    trajectory: Trajectory, robot: Robot, violations: Sequence[Violation], name: str
) -> Figure:
    """Each joint's place between its limits, and velocity, acceleration and jerk over theirs. A
    violation that has a time is a vertical line in the panel of its kind, else in all panels."""
    wrong = f"{len(violations)} violations" if violations else "no violation"
    heading = f"{name}: {wrong}".replace("$", r"\$")
    return _over_limits(trajectory, robot, violations, heading)


def _over_limits(
    trajectory: Trajectory, robot: Robot, violations: Sequence[Violation], heading: str,
    before: Trajectory | None = None,
) -> Figure:  # fmt: skip
    """A panel for each kind of limit that a joint has; dotted: ``before``, then without jerks."""
    from matplotlib import colormaps
    from matplotlib.figure import Figure

    t = np.linspace(0.0, trajectory.duration, 2001)
    q, velocity, acceleration = trajectory.sample(t)
    span = 0.01 * (robot.upper - robot.lower)  # 1 % of the range
    most = robot.velocity, robot.acceleration, robot.jerk
    rates = velocity, acceleration, np.gradient(acceleration, t, axis=0)
    rows = [("limit", "position, % of the way from the lower to the upper limit", span, q)]
    rows += [
        (kind, f"{kind}, % of its limit", 0.01 * limit, values)
        for kind, limit, values in zip(RATES, most, rates, strict=True)
        if kind != "jerk" or before is None
    ]
    rows = [row for row in rows if np.isfinite(row[2]).any()]
    figure = Figure(figsize=(9.0, 1.0 + 2.4 * len(rows)), layout="constrained")
    panels = figure.subplots(len(rows), 1, sharex=True, squeeze=False).ravel()
    colours = colormaps["tab10"](np.arange(robot.n_joints) % 10)
    for panel, (kind, words, unit, values) in zip(panels, rows, strict=True):
        place = kind == "limit"
        unit = np.where(np.isinf(unit), np.nan, unit)
        share = (values - robot.lower if place else values) / unit
        for joint, label in enumerate(robot.joint_names):
            panel.plot(t, share[:, joint], color=colours[joint], lw=1.2, label=label)
        if place and before is not None:
            first = (before.sample(t / t[-1] * before.duration)[0] - robot.lower) / unit
            for joint in np.flatnonzero(np.abs(first - share).max(axis=0) > APART).tolist():
                panel.plot(t, first[:, joint], color=colours[joint], lw=1.0, ls=":")
                words += "" if "dotted" in words else "; dotted: the conditioned ProMP"
        low, high = (0.0, 100.0) if place else (-100.0, 100.0)
        for side in (low, high):
            panel.axhline(side, color=LIMIT, lw=1.0, ls=(0, (4, 3)))
        room = 0.06 * (high - low)
        low, high = min(low, np.nanmin(share)) - room, max(high, np.nanmax(share)) + room
        for found in violations:
            if found.time is not None and (found.kind == kind or found.kind not in SHOWN):
                panel.axvline(found.time, color=RED, lw=1.2)
                panel.annotate(
                    f" {found.kind} {found.subject}", (found.time, high - 0.3 * room), fontsize=8,
                    color=RED, va="top", ha="left" if found.time < t[-1] / 2 else "right",
                )  # fmt: skip
        panel.set_ylim(low, high)
        _plain(panel, words)
    panels[-1].set_xlabel("time [s]")
    handles, labels = panels[0].get_legend_handles_labels()
    widest = 0.7 + 0.09 * max(map(len, labels))  # [in] of a line and its name, measured
    columns = min(7, max(1, int(9.0 / widest)))
    figure.legend(handles, labels, loc="outside lower center", ncols=columns, frameon=False)
    figure.suptitle(heading, fontsize=11)
    return figure


def primitive_figure(promp: ProMP, demonstrations: Demonstrations | tuple[()] = ()) -> Figure:
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
        _plain(panel, promp.joint_names[j].replace("$", r"\$"))
        panel.set_ylabel("rad or m", fontsize=8)
        panel.margins(y=0.06)
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


def _joint_panels(joints: int) -> tuple[Figure, NDArray[np.object_]]:
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


def _draw_cost(panel: Axes, name: str, term: Term, drawn: set[str]) -> None:
    """Draw a cost at each of the ``drawn`` trajectories, and at each iteration of its stage.
    Changes by other stages, before and after, lie apart from the iterations."""
    history = np.array(term.history)
    last = len(history) - 1
    gap = max(1.0, 0.25 * last)
    begin = 0.0 if np.isclose(history[0], term.followed) else -gap
    end = last if np.isclose(history[-1], term.final) else last + gap
    before = begin - gap if "followed path" in drawn else begin
    points = [
        (before, term.initial, PRIMITIVE, "conditioned ProMP", "ProMP"),
        (begin, term.followed, FOLLOWED, "followed path",
         "0" if begin == 0.0 else "followed"),
        (end, term.final, OPTIMISED, "optimised",
         f"{last}" if end == last else "optimised"),
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
    ticks = {x: tick for x, *_, tick in points}
    ticks |= {0.0: "0"} if begin < 0.0 else {}
    ticks |= {last: f"{last}"} if end > last else {}
    ticks |= {t: f"{t:.0f}" for t in panel.get_xticks() if 0 < t < 0.93 * last and t % 1 == 0}
    panel.set_xlabel(f"iteration of the stage {term.stage}")
    panel.set_xticks([*ticks], [*ticks.values()])
    panel.set_ylabel("cost")
    _plain(panel, f"{name}: {told}", size=9.5, room=0.08)


def _plain(panel: Axes, title: str, size: float = 9.0, room: float = 0.0) -> None:
    panel.set_title(title, fontsize=size, loc="left")
    panel.margins(x=room)
    panel.spines[["top", "right"]].set_visible(False)
    panel.grid(color="#e6e8eb", lw=0.7)
    panel.set_axisbelow(True)
    panel.tick_params(labelsize=8)


SOLID = "#9aa0a8"
_VIEWS = ((0, 2), (1, 2), (0, 1))
_SIZE, _TICKS = 5.0, 6  # [inch] of a view; ticks where it is as wide as high
_COLOURS = ("#2f6db3", "#c8662b", "#3f8f4f")  # of neighbouring links
PALE, FULL, DARK = "#dfeaf5", "#a9cbe8", "#656d77"
_CELLS, _TRIED, _NEAR = 45, 20_000, 6
"""Of a section of a workspace: points on a side, random configurations, and those of them from
which descents begin to a point; choices."""
_MET = 1e-3  # [m] error of a descent below which a point is reached: a choice


def cover_figure(robot: Robot) -> Figure:
    """Three views of the arm at home: its looks grey, its body spheres as circles."""
    from matplotlib.collections import EllipseCollection, PolyCollection
    from matplotlib.figure import Figure

    centers, radius = robot.sphere_centers(robot.home), np.asarray(robot.spheres.radius)
    surface = _surface(robot, robot.home)
    colours = [_COLOURS[link % len(_COLOURS)] for link in robot.spheres.link]
    figure = Figure(figsize=(len(_VIEWS) * _SIZE, _SIZE), layout="constrained", facecolor="white")
    for axes, view in zip(figure.subplots(1, len(_VIEWS)), _VIEWS, strict=True):
        axes.add_collection(
            PolyCollection(list(surface[..., view]), facecolors=SOLID, linewidths=0.0)
        )
        axes.add_collection(
            EllipseCollection(
                2.0 * radius, 2.0 * radius, np.zeros(len(radius)), units="xy",
                offsets=centers[:, view], offset_transform=axes.transData,
                facecolors="none", edgecolors=colours, linewidths=0.8,
            )
        )  # fmt: skip
        low = (centers[:, view] - radius[:, None]).min(axis=0)
        high = (centers[:, view] + radius[:, None]).max(axis=0)
        axes.set(aspect="equal", xlim=(low[0], high[0]), ylim=(low[1], high[1]))
        axes.set(xlabel=f"{'xyz'[view[0]]} [m]", ylabel=f"{'xyz'[view[1]]} [m]")
        bins = int(np.clip(_TICKS * np.divide(*(high - low)), 1, _TICKS))
        axes.locator_params("x", nbins=bins, min_n_ticks=min(2, bins))
    count, most = len(radius), max(robot.excess.values(), default=0.0)
    reach = f", at most {1000.0 * most:.0f} mm beyond the links" if robot.excess else ""
    figure.suptitle(f"{robot.name}: {count} body spheres{reach}")
    return figure


def _surface(robot: Robot, q: FloatArray) -> FloatArray:
    """Triangles (m, 3, 3) of the looks of an arm at ``q`` (n,)."""
    origins, turns = robot.segment_frames(q)
    parts = (
        part if (k := part.segment) < 0 else part.placed(origins[k], turns[k])
        for part in arm_parts(robot)
    )
    return np.concatenate([part.vertices[part.faces] for part in parts])


def _tries(robot: Robot) -> FloatArray:
    """Random configurations (m, n) within the joint limits."""
    finite = np.isfinite(robot.lower) & np.isfinite(robot.upper)
    low, high = np.where(finite, [robot.lower, robot.upper], [[-np.pi], [np.pi]])
    return np.asarray(low + (high - low) * ik.uniform(0, (_TRIED, robot.n_joints)))


def reached(robot: Robot, points: FloatArray, axis: FloatArray | None = None) -> BoolArray:
    """Which points (m, 3) the tool point gets to within the joint limits; with an ``axis`` (3,),
    those where the tool axis is along it. Nothing is in the way. Descents begin at the nearest
    poses of many random configurations."""
    q = _tries(robot)
    at, along = robot.tool_pose(q)
    lever, wanted = (0.0, np.zeros(3)) if axis is None else (ik.AXIS_LENGTH, axis)
    asked = np.hstack([points, np.tile(lever * wanted, (len(points), 1))])
    near = cKDTree(np.hstack([at, lever * along])).query(asked, _NEAR)[1].ravel()
    axes = along[near] if axis is None else np.tile(axis, (len(near), 1))
    errors = ik.each(robot, np.repeat(points, _NEAR, axis=0), axes, q[near])[1]
    return np.asarray(errors.reshape(-1, _NEAR).min(axis=1) < _MET)


def workspace_figure(robot: Robot, q: FloatArray, task: Task | None = None) -> Figure:
    """Two sections through the workspace of an arm that stands at ``q`` (n,): upright through its
    base and the goal of the ``task``, and level through the goal; without a task its tool point is
    the goal. Pale is where the tool point gets, strong where it does with the tool axis of the
    goal (:func:`reached`). The arm and the objects are drawn whole."""
    from matplotlib.collections import PolyCollection
    from matplotlib.figure import Figure
    from matplotlib.patches import Patch

    up, blocked, shown = np.eye(3)[2], "", [(DARK, _surface(robot, q))]
    start, _ = at, axis = robot.tool_pose(q)
    if task is not None:
        if isinstance(goal := task.goal, JointGoal):
            at, axis = robot.tool_pose(goal.joints)
        else:
            at, axis = goal.position, axis if goal.axis is None else goal.axis
        up, blocked = np.asarray(task.scene.up), goals.choose(task, 0)[1]
        drawn = {item.id for item in task.scene.objects if np.isfinite(item.radius)}
        parts = [part for part in scene_parts(task.scene) if part.owner in drawn]
        shown += [(hex_colour(part.colour), part.vertices[part.faces]) for part in parts]
    flat = at - (at @ up) * up
    level = flat / norm if (norm := np.linalg.norm(flat)) > _MET else frame_along(up)[:, 0]
    far = 1.05 * float(lengths(robot.tool_pose(_tries(robot))[0]).max())
    line = np.linspace(-far, far, _CELLS)
    across, other = np.meshgrid(line, line)
    figure = Figure(figsize=(2 * _SIZE, _SIZE + 0.6), layout="constrained", facecolor="white")
    for axes, second, through, name in zip(
        figure.subplots(1, 2), (up, np.cross(up, level)), (np.zeros(3), (at @ up) * up),
        ("height above the base", "to the left of that line"), strict=True,
    ):  # fmt: skip
        points = (through + across[..., None] * level + other[..., None] * second).reshape(-1, 3)
        for colour, along in ((PALE, None), (FULL, axis)):
            met = reached(robot, points, along).reshape(across.shape)
            axes.contourf(line, line, 1.0 * met, [0.5, 1.5], colors=[colour])
        view = np.stack([level, second], axis=1)
        for colour, faces in shown:
            axes.add_collection(PolyCollection(faces @ view, facecolors=colour))
        axes.plot(*(start @ view), "o", color="black", label="tool point at the start")
        if task is not None:
            colour, mark, said = (RED, "X", "not reached") if blocked else (GREEN, "P", "reached")
            axes.plot(*(at @ view), mark, color=colour, ms=8, mec="white", label=f"goal, {said}")
        axes.set(aspect="equal", xlabel="away from the base [m]", ylabel=f"{name} [m]")
    shades = Patch(color=PALE, label="within reach"), Patch(color=FULL, label="along the axis too")
    handles = [*axes.get_legend_handles_labels()[0], *shades]
    figure.legend(handles=handles, loc="outside lower center", ncols=4, frameon=False)
    figure.suptitle(fill(f"{robot.name}: {blocked or 'its workspace'}", 100), fontsize=11)
    return figure


class _Standing:
    """The planner of an arm that stays at its start."""

    def solve(self, task: Task, budget: Budget) -> Planned:
        rest = np.zeros((2, task.robot.n_joints))
        still = Trajectory(
            np.array([0.0, 0.1]), task.start + rest, rest, rest, task.robot.joint_names
        )
        return Planned(still)


def scene_figure(scene: Scene) -> Figure:
    """Three views of a scene: the whole arm at its start, and the cluster along x_g and y_g."""
    made = make_plan(scene, planner=_Standing())
    figure = reach_figure(made)
    words = f"{scene.name}: {made.robot.name} at its start"
    figure.suptitle(words.replace("$", r"\$"), fontsize=11)
    return figure


def scene_pictures(scene: Scene) -> dict[str, bytes]:
    """``scene.png``, ``workspace.png``, and ``scene.html`` (3-D, without a network) where viser is
    installed."""
    task = resolve(scene)
    out = {"scene.png": png(scene_figure(scene))}
    out["workspace.png"] = png(workspace_figure(task.robot, task.start, task))
    if find_spec("viser") is not None:
        from optipromp.looks.viewer.serving import scene_page

        out["scene.html"] = scene_page(scene).encode("utf-8")
    return out
