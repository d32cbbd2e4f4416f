"""The picture of a reach at one moment: the arm, the tool paths, and the pushed objects."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.spatial import ConvexHull

from optipromp.core.arrays import FloatArray
from optipromp.core.geometry.faces import sphere, tube
from optipromp.core.planning import Plan
from optipromp.core.pushing.path import evenly, length
from optipromp.core.robots.model import Robot
from optipromp.core.scenes.hand import flange_of
from optipromp.looks.appearance import PUSHABLES, shape_faces
from optipromp.looks.viewer import drawn
from optipromp.looks.viewer.drawn import COLOURS, OPTIMISED, STILL, Moment, Motion, Placed

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

ARM = "#86a5d4"
_LINK_RADIUS = 0.042  # [m] of a drawn link: slender, so that objects behind it show
_NEAR = 0.35  # [m] from the target, within which objects and paths must be in the close views
_TALL, _WIDE = 1.5, 0.56  # height of a close view over its width, side by side and stacked
_PANEL = {True: 3.7, False: 4.7}  # [inch] width of a close view, side by side and stacked
_TEXT = 8.5  # [points]
_RIM = 0.15  # of the width of an object to avoid; a close view that shows less leaves it out
_NOW, _END = 0.34, 0.14  # opacity of the tool in the close views, at the moment and at the end
_DOWN = 0.7  # of the vertical in a direction of sight that is called down: 45 degrees
_DOTS = 0.015  # [m] between the dots of the chosen tool path
WORDS = {"conditioned ProMP": "movement primitive", "followed path": "led past the fruits"}


def reach_figure(plan: Plan, words: Mapping[str, str] = WORDS) -> Figure:
    """Three views of one moment of a plan: the whole arm, and the cluster along x_g and y_g. The
    lines are the paths of the tool point, one for each trajectory, called by ``words``. Pushed
    objects are at their predicted places of that moment; dashed outlines are their first places."""
    from matplotlib.figure import Figure
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    now = drawn.moment(plan)
    objects = drawn.placed(plan, now)
    views = _close_views(plan)
    frames = [_frame(camera, plan, objects) for camera, _ in views]
    across, up = np.max([np.ptp(frame, axis=0) for frame in frames], axis=0)
    tall = up > across
    aspect = _TALL if tall else _WIDE
    above = ConstrainedLayoutEngine(rect=(0.0, 0.08, 1.0, 0.92))  # the legend
    figure = Figure(figsize=(13.4, 6.9), facecolor="white", layout=above)
    panels = figure.subplot_mosaic(
        [["arm", "0", "1"]] if tall else [["arm", "0"], ["arm", "1"]],
        width_ratios=[1.45, 1.0, 1.0] if tall else [1.0, 1.0],
    )
    _draw_wide(panels["arm"], plan, objects, now)
    half = 0.5 * max(across, up / aspect) * np.array([[-1.0, -aspect], [1.0, aspect]])
    for n, (camera, name) in enumerate(views):
        axes, corners = panels[str(n)], frames[n].mean(axis=0) + half
        _close(camera, plan, [o for o in objects if _enters(o, camera, corners)], now).draw(axes)
        axes.set(xlim=corners[:, 0], ylim=corners[:, 1])
        _overlay(axes, camera, plan)
        _outlines(axes, camera, objects)
        _labels(axes, camera, objects, _PANEL[tall])
        axes.set_title(name, fontsize=_TEXT, color="#555555")
    (_, right), (low, high) = panels["1"].get_xlim(), panels["1"].get_ylim()
    x, y = right - 0.055, low + 0.015 * (high - low)  # of a bar of 5 cm
    panels["1"].plot([x, x + 0.05], [y, y], color="#222222", lw=2)
    panels["1"].text(x + 0.025, y + 0.008 * (high - low), "5 cm", ha="center", fontsize=8)
    figure.suptitle(title(plan, now), fontsize=11)
    _legend(figure, plan, objects, (now, words))
    return figure


def _close_views(plan: Plan) -> list[tuple[Camera, str]]:
    """The cameras along x_g and y_g and their captions; the second is upright in the world."""
    x_g, y_g, z_g = plan.scene.frame
    focus = _focus(plan)
    place = "from above" if x_g[2] > _DOWN else "from below" if x_g[2] < -_DOWN else "from one side"
    front = (Camera(focus, -x_g, z_g), f"{place}; the approach goes up")
    if abs(z_g[2]) >= abs(x_g[2]):
        return [front, (Camera(focus, y_g, z_g), "turned by 90°; the approach goes up")]
    sign = float(np.sign(x_g[2]))
    side = Camera(focus, -sign * y_g, sign * x_g)
    return [front, (side, "turned by 90°; the approach goes to the right")]


def title(plan: Plan, now: Moment | None = None) -> str:
    """Scene, planner and status; with a moment also the moment and the push prediction."""
    lines = [f"{plan.scene.name}, {plan.planner}: {plan.status}"]
    if now is not None:
        lines.append(f"{now} of {plan.trajectory.duration:.1f} s")
        if plan.failure <= 1.0:
            lines[-1] += f"; predicted to end clean with probability {1.0 - plan.failure:.2f}"
        elif plan.scene.pushables:
            lines[-1] += "; whether it ends clean is not predicted"
    return "\n".join(lines).replace("$", r"\$")


def _draw_wide(axes: Axes, plan: Plan, objects: Sequence[Placed], now: Moment) -> None:
    focus = _focus(plan)
    middle = 0.5 * focus
    reach = max(0.6, float(np.linalg.norm(focus)))
    heading = float(np.arctan2(focus[1], focus[0])) if np.hypot(*focus[:2]) > 1e-6 else 0.0
    views = [
        Camera.orbit(middle, heading + turn, 0.28, 3.5 * reach) for turn in (-1.0, 1.0, -2.1, 2.1)
    ]
    items = [item.position - focus for item in plan.scene.static if np.isfinite(item.radius)]
    before = [sum(max(0.0, float(view.axes[2] @ at)) for at in items) for view in views]
    picture = Picture(views[int(np.argmin(before))])  # static objects hide the focus least
    for item in objects:
        _add_object(picture, item, 0.3 if item.item.role == "avoid" else 1.0)
    when = now.waypoint / (len(plan.trajectory.positions) - 1)
    for motion in drawn.motions(plan)[:-1]:
        q = motion.trajectory.positions
        bones = _bones(plan.robot, q[round(when * (len(q) - 1))])
        picture.add(tube(bones, 0.012, 8), motion.colour)
    _add_arm(picture, plan.robot, plan.trajectory.positions[now.waypoint])
    picture.draw(axes)
    _floor(axes, picture.camera, reach)
    _overlay(axes, picture.camera, plan, 0.6)


def _enters(placed: Placed, camera: Camera, corners: FloatArray) -> bool:
    """Whether a close view with ``corners`` (2, 2) shows more of an object to avoid than a rim."""
    inside = placed.item.radius * (1.0 - 2.0 * _RIM)
    at = camera.project(placed.position)[:2]
    beyond = np.max([corners[0] - at, at - corners[1]])
    return placed.item.role != "avoid" or bool(beyond < inside)


def _close(camera: Camera, plan: Plan, objects: Sequence[Placed], now: Moment) -> Picture:
    picture = Picture(camera)
    for item in objects:
        before = float(camera.axes[2] @ (item.position - camera.target)) > 0.03
        static = 0.15 if before else 1.0  # static objects before the target are faint
        _add_object(picture, item, {"avoid": 0.25, "static": static}.get(item.item.role, 1.0))
    for at, alpha in {-1: _END, now.waypoint - len(plan.trajectory.positions): _NOW}.items():
        picture.add(tool_faces(plan.robot, plan.trajectory.positions[at]), OPTIMISED, alpha)
    radii = {f"{item.item.id} pushed": item.item.radius for item in objects}
    for name, point, colour in drawn.conditioned_on(plan):
        if name in radii:
            picture.add(sphere(point, radii[name]), colour, 0.35)
    return picture


def tool_faces(robot: Robot, q: FloatArray) -> FloatArray:
    """Faces (F, 4, 3) of the tool at a configuration (n,); without a tool, of the last link."""
    if robot.tool is None:
        cover, centers = robot.spheres, robot.sphere_centers(q)
        last = np.flatnonzero(cover.link == cover.link.max())
        return np.concatenate([sphere(centers[k], cover.radius[k], 12) for k in last])
    hand, solids = flange_of(robot, q), robot.tool.solids()
    turned = [(one.shape, hand @ one.position, hand.rotation @ one.rotation) for one in solids]
    return np.concatenate([shape_faces(*each) for each in turned])


def _add_object(picture: Picture, placed: Placed, alpha: float) -> None:
    colour = COLOURS.get(placed.item.role, placed.colour)
    faces = shape_faces(placed.item.shape, placed.position, placed.rotation)
    picture.add(faces, colour, alpha)
    if placed.stem is not None and placed.item.stem is not None:
        picture.add(tube(placed.stem, placed.item.stem.radius, 8), colour)


def _bones(robot: Robot, q: FloatArray) -> FloatArray:
    """Points (k, 3) from the base through the joints to the flange [m]."""
    corners = [np.zeros(3)]
    for corner in (*robot.segment_frames(q)[0], flange_of(robot, q).position):
        if np.linalg.norm(corner - corners[-1]) > 1e-6:
            corners.append(corner)
    return np.stack(corners)


def _add_arm(picture: Picture, robot: Robot, q: FloatArray) -> None:
    bones = _bones(robot, q)
    slender = min(_LINK_RADIUS, 0.12 * max(float(np.linalg.norm(bones[-1])), 0.1))
    picture.add(tube(bones, slender), ARM)
    for joint in bones[1:-1]:
        picture.add(sphere(joint, 1.3 * slender), ARM)
    picture.add(tool_faces(robot, q), ARM)


def _focus(plan: Plan) -> FloatArray:
    """The point (3,) in the middle of the picture: the target, or the last tool point [m]."""
    if plan.scene.target is not None:
        return np.asarray(plan.scene.target.position, dtype=float)
    return np.asarray(plan.robot.tool_pose(plan.trajectory.positions[-1])[0])


def _frame(camera: Camera, plan: Plan, objects: Sequence[Placed]) -> FloatArray:
    """Two corners (2, 2) of a close view that holds the fruits, and the tool among them [m]."""
    tool = tool_faces(plan.robot, plan.trajectory.positions[-1]).reshape(-1, 3)
    seen = [] if drawn.still(plan) and plan.scene.target is not None else [tool]
    for item in objects:
        if item.item.role in ("target", "pushable") and (
            np.linalg.norm(item.item.position - camera.target) < _NEAR
        ):
            for at in (item.position, item.item.position):
                seen.append(at + 1.4 * item.item.radius * np.vstack([np.eye(3), -np.eye(3)]))
    tool, _ = plan.robot.tool_pose(plan.trajectory.positions[plan.first :])
    points = np.array([*tool, *(point for _, point, _ in drawn.conditioned_on(plan)[1:])])
    seen.append(points[np.linalg.norm(points - camera.target, axis=1) < _NEAR])
    flat = camera.project(np.concatenate(seen))[:, :2]
    low, high = flat.min(axis=0), flat.max(axis=0)
    margin = 0.05 * (high - low) + [0.04, 0.0]
    return np.stack([low - margin, high + margin])


def _floor(axes: Axes, camera: Camera, reach: float) -> None:
    ticks = np.arange(-4, 5) * 0.15 * max(1.0, reach)
    for tick in ticks:
        for ends in (
            [[tick, ticks[0], 0], [tick, ticks[-1], 0]],
            [[ticks[0], tick, 0], [ticks[-1], tick, 0]],
        ):
            x, y, _ = camera.project(np.array(ends)).T
            axes.plot(x, y, color="#dfe3e8", lw=0.8, zorder=0)


def _overlay(axes: Axes, camera: Camera, plan: Plan, thin: float = 1.0) -> None:
    """Draw the tool path of each trajectory, the chosen one, and the conditioned points."""

    def flat(points: FloatArray) -> tuple[Any, Any]:
        x, y, _ = camera.project(points).T
        return x, y

    for motion in drawn.motions(plan):
        tool, _ = plan.robot.tool_pose(motion.trajectory.resample(50.0).positions)
        width = thin * motion.width
        axes.plot(*flat(tool), color=motion.colour, lw=width, zorder=3)
    path = drawn.tool_path(plan)
    if len(path) and thin == 1.0:
        spaced = evenly(path, 2 + int(length(path) / _DOTS))
        axes.plot(*flat(spaced), "o", color="black", ms=2.8, zorder=4)
    points = {name: (flat(point), colour) for name, point, colour in drawn.conditioned_on(plan)}
    for name, (at, colour) in points.items():
        axes.plot(*at, marker="o", ms=7.5 * thin, color=colour, mec="black", mew=0.7, zorder=5)
        if f"{name} pushed" in points:
            axes.annotate(
                "", points[f"{name} pushed"][0], at, zorder=5, annotation_clip=True,
                arrowprops={"arrowstyle": "->", "color": "black", "lw": 1.1 * thin},
            )  # fmt: skip


def _outlines(axes: Axes, camera: Camera, objects: Sequence[Placed]) -> None:
    """Draw dashed outlines of pushed objects at their first places."""
    from matplotlib.patches import Polygon

    for placed in objects:
        if placed.shift > STILL:
            item = placed.item
            faces = shape_faces(item.shape, item.position, item.rotation)
            flat = camera.project(faces.reshape(-1, 3))[:, :2]
            corners = flat[ConvexHull(flat).vertices]
            axes.add_patch(
                Polygon(corners, fill=False, ec=placed.colour, lw=1.3, ls=(0, (4, 2.5)), zorder=2.5)
            )
            if item.stem is not None:
                x, y, _ = camera.project(np.asarray(item.stem.points)).T
                axes.plot(x, y, color=placed.colour, lw=1.0, ls=(0, (4, 2.5)))


def _labels(axes: Axes, camera: Camera, objects: Sequence[Placed], inches: float) -> None:
    """Write names in two columns at the edges, spread apart, each with a line to its object."""
    (left, right), (low, high) = axes.get_xlim(), axes.get_ylim()
    middle, per_point = 0.5 * (left + right), (right - left) / (72.0 * inches)
    columns: dict[bool, list[tuple[Placed, FloatArray]]] = {False: [], True: []}
    for item in objects:
        x, y, _ = camera.project(item.position)
        if item.item.role in ("target", "pushable") and left < x < right and low < y < high:
            columns[bool(x >= middle)].append((item, np.array([x, y])))
    for on_right, column in columns.items():
        heights = drawn.spread([float(at[1]) for _, at in column], 1.6 * _TEXT * per_point)
        edge = 0.98 * right + 0.02 * left if on_right else 0.98 * left + 0.02 * right
        for (item, at), height in zip(column, heights, strict=True):
            axes.annotate(
                item.label.replace("$", r"\$"), tuple(at.tolist()), (edge, height), va="center",
                ha="right" if on_right else "left", fontsize=_TEXT, color=item.colour,
                weight="bold", zorder=6,
                arrowprops={"arrowstyle": "-", "color": item.colour, "lw": 0.7, "shrinkB": 3},
                bbox={"boxstyle": "round,pad=0.15", "fc": "white", "ec": "none", "alpha": 0.8},
            )  # fmt: skip


def _legend(
    figure: Figure, plan: Plan, objects: Sequence[Placed], told: tuple[Moment, Mapping[str, str]]
) -> None:
    from matplotlib.lines import Line2D

    now, lines = told

    def line(text: str, colour: str, **style: object) -> Line2D:
        return Line2D([], [], label=text, color=colour, **style)  # type: ignore[arg-type]

    paths: Sequence[Motion] = () if drawn.still(plan) else drawn.motions(plan)
    first = [line(f"tool, {lines.get(m.name, m.name)}", m.colour, lw=m.width) for m in paths]
    if len(drawn.tool_path(plan)):
        first.append(line("chosen tool path", "black", marker="o", ls="none", ms=3.2))
    block = {"marker": "s", "ls": "none", "ms": 9}
    ends = {"tool at this moment": _NOW}
    if paths and now.waypoint < len(plan.trajectory.positions) - 1:
        ends["tool at the end"] = _END
    first += [line(text, OPTIMISED, alpha=alpha, **block) for text, alpha in ends.items()]
    pushed = any(item.shift > STILL for item in objects)
    aside = "to push aside" + ", and how far it is pushed" * pushed
    names = {"target": "target", "pushable": aside, "avoid": "to avoid", "static": "static"}
    roles = {item.item.role for item in objects}
    ball = {"marker": "o", "ls": "none", "ms": 8}
    second = [
        line(text, COLOURS.get(role, PUSHABLES[0]), **ball)
        for role, text in names.items()
        if role in roles
    ]
    if pushed:
        second.append(line("where it was", PUSHABLES[0], lw=1.3, ls=(0, (4, 2.5))))
    words = {"goal": "target", "camera": "camera", "start": "start"}
    conditioned = {
        words.get(name, "pushed pose" if name.endswith(" pushed") else "unripe fruit"): colour
        for name, _, colour in drawn.conditioned_on(plan)
    }
    point = {"marker": "o", "ls": "none", "ms": 7, "mec": "black", "mew": 0.7}
    first += [
        line(f"conditioned at: {text}" if i == 0 else text, colour, **point)
        for i, (text, colour) in enumerate(conditioned.items())
    ]
    for place, handles in ((0.035, first), (0.0, second)):
        if not handles:
            continue
        figure.legend(
            handles=handles, loc="lower center", bbox_to_anchor=(0.5, place), ncols=len(handles),
            frameon=False, fontsize=9,
        )  # fmt: skip


_TOWARDS_LIGHT = np.array([-0.35, 0.75, 0.56])  # in the camera's right, up, back


@dataclass(frozen=True)
class Camera:
    """A camera that looks along ``forward``, from ``distance`` [m] or (None) with parallel rays."""

    target: FloatArray  # (3,) [m] the point in the middle of the picture
    forward: FloatArray  # (3,)
    up: FloatArray  # (3,)
    distance: float | None = None

    @staticmethod
    def orbit(target: FloatArray, azimuth: float, elevation: float, distance: float) -> Camera:
        """A camera at ``azimuth`` and ``elevation`` [rad] about ``target``, z upwards."""
        flat = np.cos(elevation)
        away = np.array([np.cos(azimuth) * flat, np.sin(azimuth) * flat, np.sin(elevation)])
        return Camera(np.asarray(target), -away, np.array([0.0, 0.0, 1.0]), distance)

    @property
    def axes(self) -> FloatArray:
        """(3, 3) with rows right, up and back (towards the eye)."""
        back = -self.forward / np.linalg.norm(self.forward)
        right = np.cross(self.up, back)
        right /= np.linalg.norm(right)
        return np.stack([right, np.cross(back, right), back])

    def project(self, points: FloatArray) -> FloatArray:
        """Picture coordinates [m at the target] and depth, larger nearer the eye: (..., 3)."""
        seen = (np.asarray(points) - self.target) @ self.axes.T
        if self.distance is None:
            return np.asarray(seen)
        scale = self.distance / np.maximum(self.distance - seen[..., 2:], 0.05 * self.distance)
        return np.concatenate([seen[..., :2] * scale, seen[..., 2:]], axis=-1)


@dataclass
class Picture:
    """Collects shaded faces; :meth:`draw` paints them, the farthest first. matplotlib's own 3-D
    axes sort whole objects, so that objects in front vanish behind others."""

    camera: Camera
    _corners: list[FloatArray] = field(default_factory=list)
    _colours: list[FloatArray] = field(default_factory=list)

    def add(self, faces: FloatArray, colour: str, alpha: float = 1.0) -> None:
        """Add faces (F, 4, 3); those that face away from the camera are left out. Faces of glass
        (``alpha`` below 1) are one flat shape: where they cover each other, and along their seams,
        it is as dark as elsewhere."""
        from matplotlib.colors import to_rgba

        normal = np.cross(faces[:, 2] - faces[:, 0], faces[:, 3] - faces[:, 1])
        length = np.linalg.norm(normal, axis=1)
        keep = length > 1e-14
        faces, normal = faces[keep], normal[keep] / length[keep, None]
        back = self.camera.axes[2]
        if self.camera.distance is None:
            to_eye = np.broadcast_to(back, normal.shape)
        else:
            to_eye = self.camera.target + self.camera.distance * back - faces.mean(axis=1)
        facing = np.einsum("fi,fi->f", normal, to_eye) > 0.0
        faces, normal = faces[facing], normal[facing]
        brightness = 0.5 + 0.5 * np.clip(normal @ self.camera.axes.T @ _TOWARDS_LIGHT, 0.0, 1.0)
        base = np.array(to_rgba(colour, alpha))
        shades = np.tile(base, (len(faces), 1))
        shades[:, :3] *= brightness[:, None]
        if alpha < 1.0 and len(faces):
            shades = shades.mean(axis=0, keepdims=True)
        self._corners.append(self.camera.project(faces))
        self._colours.append(shades)

    def draw(self, axes: Axes) -> None:
        """Paint everything onto ``axes``, one metre to the unit, without ticks."""
        from matplotlib.collections import PathCollection
        from matplotlib.path import Path

        paths: list[Path] = []
        depths = []
        for corners, colour in zip(self._corners, self._colours, strict=True):
            closed = np.concatenate([corners, corners[:, :1]], axis=1)
            flat = [Path(face, closed=True) for face in closed[..., :2]]
            depth = corners[..., 2].mean(axis=1)
            if len(colour) < len(flat):
                flat, depth = [Path.make_compound_path(*flat)], depth.mean(keepdims=True)
            paths += flat
            depths.append(depth)
        colours = np.concatenate(self._colours)
        # An edge in a face's own colour hides the seam to its neighbour; on glass it would show.
        edges = np.where(colours[:, 3:] < 1.0, 0.0, colours)
        order = np.argsort(np.concatenate(depths), kind="stable")
        axes.add_collection(
            PathCollection(
                [paths[k] for k in order],
                facecolors=colours[order],
                edgecolors=edges[order],
                linewidths=0.35,
            ),
            autolim=False,
        )
        seen = np.concatenate(self._corners)[..., :2]
        low, high = seen.min(axis=(0, 1)), seen.max(axis=(0, 1))
        margin = 0.03 * float(np.max(high - low))
        axes.set_xlim(low[0] - margin, high[0] + margin)
        axes.set_ylim(low[1] - margin, high[1] + margin)
        axes.set_aspect("equal")
        axes.set_axis_off()
