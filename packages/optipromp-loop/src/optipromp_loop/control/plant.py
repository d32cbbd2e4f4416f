"""The plant as it is tracked: the scene to plan in, what has moved, and what hides a fruit."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from optipromp.core.arrays import FloatArray
from optipromp.core.planning.task import posed
from optipromp.core.robots.grippers import Scissor
from optipromp.core.robots.model import Robot
from optipromp.core.robots.mounted import unmounted
from optipromp.core.robots.tool_protocol import Tool
from optipromp.core.scenes.look import Look
from optipromp.core.scenes.objects import rooted
from optipromp.core.scenes.scene import JointGoal, Scene, SceneObject
from optipromp_loop.control.parameters import CONTROL
from optipromp_loop.control.tracker import Tracked


def tracked_scene(
    base: Scene, tracked: Tracked, offset: FloatArray | None = None,
    start: FloatArray | None = None,
) -> Scene:  # fmt: skip
    """The scene to plan in: what stands still in ``base``, and the tracked fruits at rest.

    ``offset``: (3,) common displacement that is left out [m]; None: none. ``start``: (n,)
    of the arm; None: that of ``base``.
    """
    still = tuple(item for item in base.objects if item.role in ("static", "avoid"))
    objects, told = tracked.objects(), told_of(base, tracked)
    seen = tuple(_as_told(item, *one) for item, one in zip(objects, told, strict=True))
    if offset is not None:
        seen = tuple(item.shifted(-offset) for item in seen)
    start = base.start if start is None else start
    return replace(base, objects=rooted([*still, *seen]), goal=None, start=start)


def told_of(base: Scene, tracked: Tracked) -> list[tuple[SceneObject | None, FloatArray | None]]:
    """What a scene told of each confirmed fruit, None: nothing; and its shift (3,) [m] where it
    stays as it was told, else None.

    A fruit that was told surely and hangs where it was told, beside what all fruits have moved,
    stays as it was told.
    """
    told = {item.id: item for item in base.objects if item.stem is not None}
    rows = np.flatnonzero(tracked.confirmed).tolist()
    found = [(told.get(tracked.ids[row]), tracked.rest[row]) for row in rows]
    by = [place - one.position for one, place in found if one is not None]
    common = np.median(by, axis=0) if by else np.zeros(3)
    if float(np.linalg.norm(common)) <= CONTROL.settled:  # they hang where they were told
        common = np.zeros(3)
    out = list[tuple[SceneObject | None, FloatArray | None]]()
    for one, place in found:
        sure = one is not None and one.covariance is None
        away = place - one.position - common if one is not None and sure else np.full(3, np.inf)
        out.append((one, common if float(np.linalg.norm(away)) <= CONTROL.settled else None))
    return out


def _as_told(item: SceneObject, told: SceneObject | None, shift: FloatArray | None) -> SceneObject:
    """A tracked fruit with what a scene ``told`` of it, where it stays so moved by ``shift`` (3,).

    Of other fruits, a stem that is bent or grows from another is kept, shifted with its fruit.
    """
    if told is None or told.stem is None or item.stem is None:
        return item
    if shift is not None:
        return replace(told.shifted(shift), role=item.role)
    points = item.stem.points
    if len(told.stem.points) > 2:
        points = told.stem.points + (item.position - told.stem.points[0])
    return replace(item, stem=replace(item.stem, points=points, parent=told.stem.parent))


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


def first_tracks(scene: Scene, known: float) -> list[SceneObject]:
    """The fruits of a scene, to be tracked from the first; ``known``: deviation of others [m]."""
    assumed = known**2 * np.eye(3)
    fruits = (item for item in scene.objects if item.role in ("target", "pushable"))
    return [o if o.covariance is not None else replace(o, covariance=assumed) for o in fruits]


def target_row(tracked: Tracked) -> int | None:
    """The row of the confirmed target; None: there is none."""
    for row, (role, sure) in enumerate(zip(tracked.roles, tracked.confirmed, strict=True)):
        if role == "target" and sure:
            return row
    return None


def outside(robot: Robot, q: FloatArray, tracked: Tracked, planned: FloatArray) -> bool:
    """Whether the target is outside of the tool at ``q`` (n,), as far as the looks tell.

    What a tool without a mouth takes is at ``planned`` (3,), from the tool point [m]; so is what
    hangs from blades.
    """
    row = target_row(tracked)
    if robot.tool is None or row is None:
        return robot.tool is not None
    place, spread = tracked.positions[row], tracked.covariance[row]
    known = float(np.sqrt(np.linalg.eigvalsh(spread)[-1]))  # along any direction
    if robot.tool.mouth[0] > 0.0 and not isinstance(unmounted(robot.tool), Scissor):
        return not inside(robot, q, place, known)
    point, _ = robot.tool_pose(q)
    return math.dist(place, point + planned) > _wide(robot.tool) + known


def inside(robot: Robot, q: FloatArray, place: FloatArray, spread: float = 0.0) -> bool:
    """Whether a ``place`` (3,), known to ``spread`` [m], is in the mouth of the tool at ``q``."""
    if robot.tool is None or robot.tool.mouth[0] <= 0.0:
        return False
    point, axis = robot.tool_pose(q)
    along = float((place - point) @ axis)
    aside = float(np.linalg.norm(place - point - along * axis))
    wide = _wide(robot.tool) + spread  # as deep below the tool point, at most
    return aside <= wide and -wide <= along <= robot.tool.depth + spread


def _wide(tool: Tool) -> float:
    """How far beside its place a target still is in a tool [m]."""
    return max(tool.mouth[1], 0.01)


def untold(look: Look, base: Scene, reach: float) -> Look:
    """A look without what ``base`` says is there to be avoided, within ``reach`` [m]: it stands."""
    known = [item.position for item in base.objects if item.role == "avoid"]
    kept = tuple(
        item
        for item in look.detections
        if item.role != "avoid"
        or all(math.dist(look.camera @ item.position, place) > reach for place in known)
    )
    return look if len(kept) == len(look.detections) else replace(look, detections=kept)


MOUTH = np.array([0.6, 1.2, 1.8])  # heights below the rim of balls of one radius: a choice


def mouth_balls(robot: Robot, q: FloatArray, eye: FloatArray | None) -> FloatArray:
    """Balls (B, 4) that fill the mouth of the tool at ``q`` (n,): centres and radii [m].

    They hide what is inside from an ``eye`` (3,) beside the tool; none for one that looks out of
    the mouth, or that is not known.
    """
    tool, none = robot.tool, np.zeros((0, 4))
    if tool is None or tool.mouth[0] <= 0.0 or eye is None:
        return none
    point, axis = robot.tool_pose(q)
    if float(np.linalg.norm(np.cross(eye - point, axis))) < tool.mouth[0]:
        return none
    along = tool.depth - MOUTH * tool.mouth[0]
    return np.column_stack([point + along[:, None] * axis, np.full(len(MOUTH), tool.mouth[0])])


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


def rests_known(tracked: Tracked, most: float) -> bool:
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


def appeared(planned: Scene, tracked: Tracked) -> list[str]:
    """The confirmed fruits that a plan's scene does not have."""
    before = {item.id for item in planned.objects}
    sure = zip(tracked.ids, tracked.confirmed, strict=True)
    return [name for name, confirmed in sure if confirmed and name not in before]


def moved_by(planned: Scene, tracked: Tracked, apart: bool = False) -> float:
    """Largest motion of a fruit since a scene was planned in [m]; infinite for a new or lost fruit.

    ``apart``: against the mean of all.
    """
    fruits = {o.id for o in planned.objects if o.role in ("target", "pushable")}
    now = {name for name, sure in zip(tracked.ids, tracked.confirmed, strict=True) if sure}
    if appeared(planned, tracked) or fruits - now:
        return float(np.inf)
    _, by, _ = displaced(planned, tracked)
    by = by - by.mean(axis=0) if apart else by
    return float(np.linalg.norm(by, axis=1).max(initial=0.0))


def without_fruits(scene: Scene, q: FloatArray | None = None) -> Scene:
    """The scene with robot and what stands still, and no fruits.

    Args:
        scene: with fruits, or without.
        q: (n,) its goal; None: its start.
    """
    still = tuple(item for item in scene.objects if item.role in ("static", "avoid"))
    rest = JointGoal(posed(scene)[1].q if q is None else q)
    return replace(scene, objects=still, goal=rest, waypoints=None, place=None)
