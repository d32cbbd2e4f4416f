"""The plant as tracked, in the frame of a plan."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from optipromp.control.servo import Displacement, Route
from optipromp.core.arrays import FloatArray
from optipromp.core.planning.task import spaced
from optipromp.core.scenes.scene import Scene, SceneObject, Stem
from optipromp.core.scenes.trusses import rooted

if TYPE_CHECKING:
    from optipromp.control.tracked import Tracked


def scene_of(base: Scene, tracked: Tracked, offset: FloatArray | None = None) -> Scene:
    """The scene to plan in: what stands still in ``base``, and the tracked fruits at rest.

    Args:
        base: the scene with robot, tool, approach, and objects that stand still.
        tracked: the fruits.
        offset: (3,) common displacement that is left out [m]; None: none.
    """
    still = tuple(item for item in base.objects if item.role in ("static", "avoid"))
    grown = {item.id: item.stem for item in base.objects if item.stem is not None}
    seen = [_as_grown(item, grown.get(item.id)) for item in tracked.objects()]
    if offset is not None:
        seen = [shifted(item, -offset) for item in seen]
    return replace(base, objects=rooted([*still, *seen]), goal=None)


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


def settled(tracked: Tracked, most: float) -> bool:
    """Whether the rest of every fruit in view is known to a standard deviation ``most`` [m]."""
    fresh = tracked.time - tracked.last_seen < 0.3  # [s] in view: a choice
    spread = np.linalg.eigvalsh(tracked.rest_covariance[fresh & tracked.confirmed])
    return bool(np.sqrt(spread.max(initial=0.0)) <= most)


def displaced(planned: Scene, tracked: Tracked) -> tuple[FloatArray, FloatArray, list[int]]:
    """The fruits of a plan's scene that are still tracked.

    Returns:
        Rest positions (F, 3) in the plan's scene [m], displacements (F, 3) of these fruits since
        [m], and the rows of their tracks.
    """
    before = {o.id: o.position for o in planned.objects if o.role in ("target", "pushable")}
    rows = [row for row, name in enumerate(tracked.ids) if name in before]
    places = np.array([before[tracked.ids[row]] for row in rows]).reshape(-1, 3)
    return places, tracked.rest[rows] - places, rows


def field_of(planned: Scene, tracked: Tracked, length: float) -> Displacement:
    """The displacement of the plant against a plan's scene."""
    places, moved, rows = displaced(planned, tracked)
    return Displacement(places, lambda times: moved + tracked.moves(times)[:, rows], length)


def changed(planned: Scene, tracked: Tracked) -> float:
    """Largest motion of a fruit against the mean of all [m]; infinite for a new or lost fruit."""
    before = {o.id for o in planned.objects if o.role in ("target", "pushable")}
    now = {name for name, sure in zip(tracked.ids, tracked.confirmed, strict=True) if sure}
    if before != now:
        return float(np.inf)
    _, moved, _ = displaced(planned, tracked)
    return float(np.linalg.norm(moved - moved.mean(axis=0), axis=1).max(initial=0.0))


def pushed_by(route: Route, phase: float) -> dict[str, FloatArray]:
    """Displacement (3,) of each fruit by the push of a route until ``phase`` [m], by id."""
    made = route.plan
    model = None if made is None else made.push_model
    if made is None or model is None:
        return {}
    first = float(route.trajectory.times[made.first])
    times = route.trajectory.times
    rows = np.flatnonzero((times >= first) & (times <= phase))
    if len(rows) < 2:
        return {}
    points, axes = spaced(route.points[rows], route.axes[rows])
    if model.clear(points, axes):
        return {}
    found = model.moved(points, axes)
    places = {item.id: item.position for item in made.scene.objects}
    return {
        name: position - places[name]
        for name, position in zip(found.ids, found.positions, strict=True)
    }
