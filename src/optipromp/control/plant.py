"""The plant as tracked, in the frame of a plan."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from optipromp.control.look import Look
from optipromp.control.parameters import LoopParameters
from optipromp.control.servo import Displacement, Route
from optipromp.control.stiffness import Stiffness
from optipromp.core.arrays import FloatArray
from optipromp.core.planning.task import spaced
from optipromp.core.robots.model import Robot
from optipromp.core.scenes.scene import Scene, SceneObject, Stem
from optipromp.core.scenes.trusses import rooted

if TYPE_CHECKING:
    from optipromp.control.tracked import Tracked

MOVED = 1e-4  # [m] of a predicted push, below which a fruit counts as free: a choice


def scene_of(
    base: Scene, tracked: Tracked, offset: FloatArray | None = None, stems: Stiffness | None = None
) -> Scene:
    """The scene to plan in: what stands still in ``base``, and the tracked fruits at rest.

    ``base``: the scene with robot, tool, approach, and objects that stand still. ``tracked``: the
    fruits. ``offset``: (3,) common displacement that is left out [m]; None: none. ``stems``: what
    is believed of their stiffness; None: as the push model assumes.
    """
    still = tuple(item for item in base.objects if item.role in ("static", "avoid"))
    grown = {item.id: item.stem for item in base.objects if item.stem is not None}
    seen = [_as_grown(item, grown.get(item.id)) for item in tracked.objects()]
    if stems is not None:
        seen = [stems.told(item, base.up) for item in seen]
    if offset is not None:
        seen = [shifted(item, -offset) for item in seen]
    return replace(base, objects=rooted([*still, *seen]), goal=None)


def tracked_at_most(scene: Scene, most: int) -> Scene:
    """The scene with at most so many fruits; those farther from the target are only avoided."""
    fruits = [item for item in scene.objects if item.role in ("target", "pushable")]
    if len(fruits) <= most:
        return scene
    centre = (scene.target or fruits[0]).position
    fruits.sort(key=lambda item: (item.role != "target", math.dist(item.position, centre)))
    far = {item.id for item in fruits[most:]}
    objects = (replace(o, role="avoid") if o.id in far else o for o in scene.objects)
    return replace(scene, objects=tuple(objects))


def _as_grown(item: SceneObject, known: Stem | None) -> SceneObject:
    """A tracked fruit on the stem that the scene states, where that is bent or grows from another.

    A bent stem is shifted with its fruit.
    """
    if item.stem is None or known is None:
        return item
    points = item.stem.points
    if len(known.points) > 2:
        points = known.points + (item.position - known.points[0])
    return replace(item, stem=replace(item.stem, points=points, parent=known.parent))


def shifted(item: SceneObject, by: FloatArray) -> SceneObject:
    """An object and its stem, shifted ``by`` (3,) [m]."""
    stem = item.stem
    if stem is not None:
        stem = replace(stem, points=stem.points + by)
    return replace(item, position=item.position + by, stem=stem)


def target_row(tracked: Tracked) -> int | None:
    """The row of the confirmed target; None: there is none."""
    for row, (role, sure) in enumerate(zip(tracked.roles, tracked.confirmed, strict=True)):
        if role == "target" and sure:
            return row
    return None


def deviation(tracked: Tracked, row: int) -> float:
    """Largest standard deviation of the position of a track along any direction [m]."""
    return float(np.sqrt(np.linalg.eigvalsh(tracked.covariance[row])[-1]))


def outside(robot: Robot, q: FloatArray, tracked: Tracked) -> bool:
    """Whether the target is outside of the tool at ``q`` (n,), as far as the looks tell."""
    tool, row = robot.tool, target_row(tracked)
    if tool is None or row is None:
        return tool is not None
    point, axis = robot.tool_pose(q)
    away = tracked.positions[row] - point
    along = float(away @ axis)
    aside = float(np.linalg.norm(away - along * axis))
    spread = deviation(tracked, row)
    return aside > max(tool.mouth[1], 0.01) + spread or along > tool.depth + spread


def unseen(tracked: Tracked, eye: FloatArray, since: float) -> dict[str, str | None]:
    """The confirmed fruits that no look has shown ``since`` a time [s], and what hides each.

    What hides a fruit is the track nearest to the ray to it from the ``eye`` (3,), where that track
    covers the ray; None: nothing that is tracked.
    """
    radii = np.array([shape.measure.bound for shape in tracked.shapes])
    out: dict[str, str | None] = {}
    for row in np.flatnonzero(tracked.confirmed & (tracked.last_seen < since)).tolist():
        way = tracked.positions[row] - eye
        far = float(np.linalg.norm(way))
        others = tracked.positions - eye
        along = others @ way / far
        aside = np.linalg.norm(others - along[:, None] * way / far, axis=1)
        covers = (aside < radii) & (along > 0.0) & (along < far - radii[row])
        covers[row] = False
        nearest = int(np.argmin(np.where(covers, aside, np.inf)))
        out[tracked.ids[row]] = tracked.ids[nearest] if covers.any() else None
    return out


def settled(tracked: Tracked, most: float) -> bool:
    """Whether the rest of every fruit in view is known to a standard deviation ``most`` [m]."""
    fresh = tracked.time - tracked.last_seen < 0.3  # [s] in view: a choice
    spread = np.linalg.eigvalsh(tracked.rest_covariance[fresh & tracked.confirmed])
    return bool(np.sqrt(spread.max(initial=0.0)) <= most)


def displaced(planned: Scene, tracked: Tracked) -> tuple[FloatArray, FloatArray, list[int]]:
    """The fruits of a plan's scene that are still tracked.

    Returns: Rest positions (F, 3) in the plan's scene [m], displacements (F, 3) of these fruits
    since [m], and the rows of their tracks.
    """
    before = {o.id: o.position for o in planned.objects if o.role in ("target", "pushable")}
    rows = [row for row, name in enumerate(tracked.ids) if name in before]
    places = np.array([before[tracked.ids[row]] for row in rows]).reshape(-1, 3)
    return places, tracked.rest[rows] - places, rows


def field_of(planned: Scene, tracked: Tracked, length: float) -> Displacement:
    """The displacement of the plant against a plan's scene."""
    places, moved, rows = displaced(planned, tracked)
    return Displacement(places, lambda times: moved + tracked.moves(times)[:, rows], length)


def appeared(planned: Scene, tracked: Tracked) -> list[str]:
    """The confirmed fruits that a plan's scene does not have."""
    before = {item.id for item in planned.objects}
    sure = zip(tracked.ids, tracked.confirmed, strict=True)
    return [name for name, confirmed in sure if confirmed and name not in before]


def changed(planned: Scene, tracked: Tracked) -> float:
    """Largest motion of a fruit against the mean of all [m]; infinite for a new or lost fruit."""
    before = {o.id for o in planned.objects if o.role in ("target", "pushable")}
    now = {name for name, sure in zip(tracked.ids, tracked.confirmed, strict=True) if sure}
    if before != now:
        return float(np.inf)
    _, moved, _ = displaced(planned, tracked)
    return float(np.linalg.norm(moved - moved.mean(axis=0), axis=1).max(initial=0.0))


def motion_of(route: Route, phase: float) -> tuple[FloatArray, FloatArray] | None:
    """Points and axes (P, 3) of the tool on the approach of a route until ``phase`` [s].

    None before the approach, and while the tool surely touches nothing.
    """
    made, times = route.plan, route.trajectory.times
    model = None if made is None else made.push_model
    if model is None:
        return None
    rows = np.flatnonzero((times >= route.approach) & (times <= phase))
    if len(rows) < 2:
        return None
    motion = spaced(route.points[rows], route.axes[rows])
    return None if model.clear(*motion) else motion


def pushed_by(route: Route, phase: float) -> dict[str, FloatArray]:
    """Displacement (3,) of each fruit that the push of a route moves until ``phase`` [m], by id."""
    motion = motion_of(route, phase)
    if motion is None:
        return {}
    assert route.plan is not None
    assert route.plan.push_model is not None
    found = route.plan.push_model.moved(*motion)
    places = {item.id: item.position for item in route.scene.objects}
    pushed = {
        name: position - places[name]
        for name, position in zip(found.ids, found.positions, strict=True)
    }
    return {name: by for name, by in pushed.items() if float(np.linalg.norm(by)) > MOVED}


def gave_way(
    scene: Scene, look: Look, tracked: Tracked, pushed: Mapping[str, FloatArray],
    parameters: LoopParameters,
) -> list[tuple[SceneObject, FloatArray]]:  # fmt: skip
    """The pushed fruits of a plan's scene that a look shows, and their displacements (3,) [m].

    ``scene``: of the plan. ``look``: from which detections are taken. ``tracked``: the fruits at
    the time of the look. ``pushed``: predicted displacement (3,) of fruits, by id [m].
    ``parameters``: with the least displacement that counts, and the reach of a detection.
    """
    fruits = {item.id: item for item in scene.objects if item.stem is not None}
    found = np.array([look.camera @ item.position for item in look.detections]).reshape(-1, 3)
    out = []
    for row, name in enumerate(tracked.ids):
        if name not in pushed or name not in fruits or not len(found):
            continue
        away = np.linalg.norm(found - tracked.positions[row], axis=1)
        by = found[int(away.argmin())] - (tracked.positions[row] - pushed[name])
        if away.min() <= parameters.reach and np.linalg.norm(by) >= parameters.yielded:
            out.append((fruits[name], by))
    return out
