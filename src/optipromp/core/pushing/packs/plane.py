"""The objects around the target, as shapes on the plane of its board."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from optipromp.core.arrays import FloatArray
from optipromp.core.geometry.shapes import Box, Cylinder
from optipromp.core.pushing.packs.flat import shapes
from optipromp.core.pushing.packs.quasi_static import Bench
from optipromp.core.pushing.parameters import PUSH
from optipromp.core.robots.tool_protocol import Tool
from optipromp.core.scenes.scene import Scene, SceneObject

STANDING = PUSH.standing


@dataclass(frozen=True, eq=False)
class Plane:
    """The objects around the target, projected along x_g."""

    bench: Bench
    state: FloatArray  # (B, 3) poses of the objects: u, v [m], turn [rad]
    spread: FloatArray  # (B,) standard deviation of the detected positions [m]
    entry: float  # u of the tool point at the beginning of a path [m]
    drop: float  # offset of the path along x_g from the target's middle before its end [m]


def plane(scene: Scene, tool: Tool, behind: Sequence[FloatArray] = ()) -> Plane:
    """The plane of a scene that :class:`optipromp.core.pushing.packs.standing.Standing` applies to.

    ``behind`` are convex polygons (k, 2) of the wrist behind the tool, in its outline's frame [m].
    """
    target, frame = scene.target, scene.frame
    assert target is not None
    standing = (target, *packs(scene, target))
    parts, area, lever = zip(*(_footprint(obj, frame) for obj in standing), strict=True)
    flat = np.array([frame[[2, 1]] @ (obj.position - target.position) for obj in standing])
    tall = np.array([2.0 * obj.extent(frame[0]) for obj in standing])
    walls, edge, drop = [], -np.inf, 0.0
    thick = float(tool.spheres()[:, 3].max()) + STANDING.low
    bottom = target.extent(frame[0])
    level = np.abs((scene.positions - target.position) @ frame[0]) - scene.bounds
    around = scene.around(target.position, STANDING.around, "static")
    for obj in scene.objects_at(around[level[around] < bottom + STANDING.touching]):
        if not isinstance(obj.shape, Box):
            continue
        height = float(frame[0] @ (obj.position - target.position))
        half = obj.extent(frame[0])
        part, _, _ = _footprint(obj, frame)
        assert not isinstance(part, float)
        at = part + frame[[2, 1]] @ (obj.position - target.position)
        if abs(height) < half:
            walls.append(at)
        elif abs(abs(height) - half - bottom) < STANDING.touching and _covers(at):
            edge = max(edge, float(at[:, 0].min()))
            drop = np.sign(height) * max(0.0, abs(height) - half - thick)
    friction = PUSH.plane.friction * PUSH.plane.density * PUSH.beam.gravity * np.array(area) * tall
    objects = shapes(list(parts))
    begin = float(np.min(flat[:, 0] - objects.radius))
    if np.isfinite(edge):  # there is a board
        begin = min(begin, edge)
    mouth = np.array([tool.front - tool.reach, tool.tip - tool.reach, tool.gripper_radius])
    if tool.mouth[0] == 0.0:  # the tool grips nothing: no target is too deep between fingers
        mouth[1:] = np.inf, 0.0
    hand = shapes([*tool.outline(), *behind])
    return Plane(
        Bench(objects, 1.0 / friction, np.array(lever) ** 2, shapes(walls), hand, mouth, edge),
        np.column_stack([flat, np.zeros(len(flat))]),
        np.array([_spread(obj) for obj in standing]),
        begin - STANDING.before - (tool.tip - tool.reach),
        float(drop),
    )


def packs(scene: Scene, target: SceneObject) -> tuple[SceneObject, ...]:
    """The pushables that stand around the target, in file order; of too many the nearest."""
    rows = scene.around(target.position, STANDING.around, "pushable")
    rows = rows[[obj.stem is None for obj in scene.objects_at(rows)]]
    if len(rows) > STANDING.most:
        away = np.linalg.norm(scene.positions[rows] - target.position, axis=1)
        rows = np.sort(rows[np.argsort(away, kind="stable")[: STANDING.most]])
    return scene.objects_at(rows)


def _spread(obj: SceneObject) -> float:
    if obj.covariance is None:
        return STANDING.unsure
    return max(STANDING.unsure, float(np.sqrt(np.max(np.diag(obj.covariance)))))


def _footprint(obj: SceneObject, frame: FloatArray) -> tuple[FloatArray | float, float, float]:
    """Outline about the centre, its area [m²], and the friction moment over the friction [m].

    Cans and packs stand on the rim of their base: the last is the radius of a disc, and 0.81 of
    half the diagonal of a rectangle.
    """
    shape = obj.shape
    if isinstance(shape, Cylinder) and abs(float(obj.rotation[:, 2] @ frame[0])) > np.cos(
        np.deg2rad(STANDING.tilt)
    ):
        return shape.radius, np.pi * shape.radius**2, shape.radius
    if isinstance(shape, Box):
        signs = np.array([[a, b, c] for a in (-1, 1) for b in (-1, 1) for c in (-1, 1)])
        corners = (0.5 * signs * np.array(shape.size)) @ obj.rotation.T @ frame[[2, 1]].T
        hull = _hull(corners)
        a, b = hull, np.roll(hull, -1, axis=0)
        area = 0.5 * abs(float(np.sum(a[:, 0] * b[:, 1] - b[:, 0] * a[:, 1])))
        return hull, area, 0.81 * float(np.linalg.norm(hull, axis=1).mean())
    radius = obj.radius
    return radius, np.pi * radius**2, radius


def _hull(points: FloatArray) -> FloatArray:
    """Convex hull (k, 2), counter-clockwise, of points (m, 2)."""
    from scipy.spatial import ConvexHull  # slow to import, and seldom needed

    ordered = np.unique(np.round(points, 9), axis=0)  # points within 1 nm are one
    corners = ConvexHull(ordered).vertices
    return np.asarray(ordered[np.roll(corners, -int(np.argmin(corners)))])


def _covers(corners: FloatArray) -> bool:
    """Whether the box about ``corners`` (k, 2) contains the origin."""
    return bool((corners.min(axis=0) <= 0.0).all() and (corners.max(axis=0) >= 0.0).all())
