"""The picture of a reach: the arm before (red) and after (blue) among what hangs in its way."""

from typing import TYPE_CHECKING

import numpy as np

from optipromp.arrays import FloatArray
from optipromp.geometry.shapes import HalfSpace
from optipromp.trajectory import Trajectory
from optipromp.viewer import solids
from optipromp.viewer.picture import Camera, Picture

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from optipromp.planning import Plan
    from optipromp.robots.model import Robot

BEFORE, AFTER = "#d8463a", "#2a6cc4"
_COLOURS = {"target": "#d11a2a", "pushable": "#7fb24a", "avoid": "#4f9d69", "static": "#b39b7c"}
_STEM = "#3f6b2f"
_LINK_RADIUS = 0.042  # [m] the arm is drawn slender, so that what is behind it shows


def reach_figure(plan: "Plan") -> "Figure":
    """Two views of a plan: the whole arm, and the cluster seen along the scene's x_g.

    Red is where the conditioned primitive goes, blue the plan; the dots are the tool's path, one a
    knot. Both arms stand at the knot where the plan passes the last object it has to push aside
    (at the end, where there is none).
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10.4, 6.2), layout="constrained", facecolor="white")
    wide, close = figure.subplots(1, 2, width_ratios=[1.25, 1.0])
    _draw_wide(wide, plan)
    _draw_close(close, plan)
    strategy = f", {plan.strategy}" if plan.strategy else ""
    figure.suptitle(f"{plan.scene.name}, {plan.planner}{strategy}: {plan.status}", fontsize=11)
    _legend(figure, plan)
    return figure


def passing_knot(plan: "Plan", positions: FloatArray) -> int:
    """The knot at which the tool passes the pushable it meets last; without any, the last knot."""
    points, _ = plan.robot.tool_pose(positions)
    up = plan.scene.frame[2]
    heights = [float(up @ item.position) for item in plan.scene.pushables]
    if not heights:
        return len(positions) - 1
    along = points @ up
    start = int(np.argmin(along))
    return start + int(np.argmin(np.abs(along[start:] - max(heights))))


def _draw_wide(axes: "Axes", plan: "Plan") -> None:
    focus = _focus(plan)
    base = np.zeros(3)
    middle = 0.5 * (focus + base)
    reach = max(0.6, float(np.linalg.norm(focus)))
    heading = float(np.arctan2(focus[1], focus[0])) if np.hypot(*focus[:2]) > 1e-6 else 0.0
    views = [
        Camera.orbit(middle, heading + turn, 0.28, 3.5 * reach) for turn in (-1.0, 1.0, -2.1, 2.1)
    ]
    picture = Picture(min(views, key=lambda view: _hidden(view, plan, focus)))
    _add_floor(picture, reach)
    _add_objects(picture, plan, translucent=0.32)
    _add_arms(picture, plan)
    _add_paths(picture, plan, radius=0.006)
    picture.draw(axes)


def _draw_close(axes: "Axes", plan: "Plan") -> None:
    frame, focus = plan.scene.frame, _focus(plan)
    picture = Picture(Camera(focus, -frame[0], frame[2]))
    _add_objects(picture, plan, translucent=0.30)
    _add_paths(picture, plan, radius=0.0028)
    knot = passing_knot(plan, plan.trajectory.positions)
    radius = max(plan.robot.gripper_radius, 0.01)
    for at in (knot, plan.trajectory.n_knots - 1):
        point, axis = plan.robot.tool_pose(plan.trajectory.positions[at])
        picture.add(solids.cup(point - 0.03 * axis, axis, radius, 0.05), AFTER, 0.22)
    picture.draw(axes)
    half = max(0.17, 3.2 * radius)
    axes.set_xlim(-half, half)
    axes.set_ylim(-1.35 * half, 0.95 * half)
    for item in plan.scene.objects:
        if item.role in ("target", "pushable"):
            x, y, _ = picture.camera.project(np.asarray(item.position))
            if abs(x) < half and -1.35 * half < y < 0.95 * half:
                _label(axes, x + min(item.radius, 0.02), y, item.id)
    axes.set_title("along x_g: y_g to the right, z_g up", fontsize=8.5, color="#555555")
    bar, low = 0.05, -1.26 * half
    axes.plot([0.55 * half, 0.55 * half + bar], [low, low], color="#222222", lw=2)
    axes.text(0.55 * half + 0.5 * bar, low + 0.02 * half, "5 cm", ha="center", fontsize=8)


def _label(axes: "Axes", x: float, y: float, text: str) -> None:
    from matplotlib.patheffects import withStroke

    axes.annotate(
        text,
        (x, y),
        xytext=(4, 0),
        textcoords="offset points",
        va="center",
        fontsize=8.5,
        path_effects=[withStroke(linewidth=2.5, foreground="white")],
    )


def _focus(plan: "Plan") -> FloatArray:
    """What the picture is about: the target, or where the tool ends."""
    if plan.scene.target is not None:
        return np.asarray(plan.scene.target.position, dtype=float)
    point, _ = plan.robot.tool_pose(plan.trajectory.positions[-1])
    return np.asarray(point)


def _hidden(view: Camera, plan: "Plan", focus: FloatArray) -> float:
    """How far static things stand before the focus, seen from the camera [m]."""
    back = view.axes[2]
    nearer = [
        float(back @ (item.position - focus))
        for item in plan.scene.static
        if not isinstance(item.shape, HalfSpace)
    ]
    return sum(max(0.0, distance) for distance in nearer)


def _add_floor(picture: Picture, reach: float) -> None:
    ticks = np.arange(-4, 5) * 0.15 * max(1.0, reach)
    ends = np.array([ticks[0], ticks[-1]])
    for tick in ticks:
        for line in (
            np.array([[tick, ends[0], 0.0], [tick, ends[1], 0.0]]),
            np.array([[ends[0], tick, 0.0], [ends[1], tick, 0.0]]),
        ):
            across = np.cross(line[1] - line[0], [0.0, 0.0, 1.0])
            across *= 0.002 / np.linalg.norm(across)
            steps = np.linspace(0.0, 1.0, 17)[:, None]
            centre = line[0] + steps * (line[1] - line[0]) - [0.0, 0.0, 0.01]
            strip = np.stack(
                [centre[:-1] + across, centre[1:] + across, centre[1:] - across,
                 centre[:-1] - across], axis=1,
            )  # fmt: skip
            picture.add(strip, "#d5d9de", framed=False)
            picture.add(strip[:, ::-1], "#d5d9de", framed=False)


def _add_objects(picture: Picture, plan: "Plan", translucent: float) -> None:
    for item in plan.scene.objects:
        alpha = translucent if item.role == "avoid" else 1.0
        faces = solids.shape_faces(item.shape, item.position, item.rotation)
        picture.add(faces, _COLOURS[item.role], alpha)
        if item.stem is not None:
            picture.add(solids.tube(np.asarray(item.stem.points), item.stem.radius, 8), _STEM)


def _add_arms(picture: Picture, plan: "Plan") -> None:
    for trajectory, colour in _motions(plan):
        positions = trajectory.positions
        _add_arm(picture, plan.robot, positions[passing_knot(plan, positions)], colour)


def _add_arm(picture: Picture, robot: "Robot", q: FloatArray, colour: str) -> None:
    origins, rotations = robot.segment_frames(q)
    flange = origins[-1] + rotations[-1] @ robot.flange_translation
    point, axis = robot.tool_pose(q)
    corners = [np.zeros(3), *origins, flange]
    chain = [corners[0]]
    for corner in corners[1:]:
        if np.linalg.norm(corner - chain[-1]) > 1e-6:
            chain.append(corner)
    slender = min(_LINK_RADIUS, 0.12 * max(float(np.linalg.norm(flange)), 0.1))
    picture.add(solids.tube(np.stack(chain), slender), colour)
    for joint in chain[1:-1]:
        picture.add(solids.sphere(joint, 1.3 * slender), colour)
    tool = robot.tool
    height, depth = getattr(tool, "height", 0.0), getattr(tool, "depth", 0.0)
    floor = point - (height - depth) * axis
    picture.add(solids.tube(np.stack([flange, floor]), 0.3 * slender), colour)
    if height > 0:
        picture.add(solids.cup(floor, axis, robot.gripper_radius, height), colour)


def _motions(plan: "Plan") -> list[tuple[Trajectory, str]]:
    """Before and after, or the plan alone where nothing was optimised."""
    if np.array_equal(plan.initial.positions, plan.trajectory.positions):
        return [(plan.trajectory, AFTER)]
    return [(plan.initial, BEFORE), (plan.trajectory, AFTER)]


def _add_paths(picture: Picture, plan: "Plan", radius: float) -> None:
    for trajectory, colour in _motions(plan):
        points, _ = plan.robot.tool_pose(trajectory.positions)
        picture.dots(points, radius, colour)


def _legend(figure: "Figure", plan: "Plan") -> None:
    from matplotlib.lines import Line2D

    motions = [colour for _, colour in _motions(plan)]
    words = ("before", "after") if len(motions) > 1 else ("plan",)
    entries = list(zip(words, motions, strict=True))
    names = {
        "target": "target",
        "pushable": "to push aside",
        "avoid": "to avoid",
        "static": "static",
    }
    present = {item.role for item in plan.scene.objects}
    entries += [(text, _COLOURS[role]) for role, text in names.items() if role in present]
    handles = [
        Line2D([], [], color=colour, marker="o", ls="none", ms=7, label=text)
        for text, colour in entries
    ]
    figure.legend(
        handles=handles, loc="outside lower center", ncols=len(handles), frameon=False, fontsize=9
    )
