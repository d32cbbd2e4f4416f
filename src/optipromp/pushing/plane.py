"""What stands on a board around a target, as discs and rectangles on a plane.

The plane is the board's, in (u, v) along z_g and y_g from the target.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from optipromp.arrays import FloatArray
from optipromp.geometry.shapes import Box, Cylinder
from optipromp.pushing.flat import Shapes, shapes
from optipromp.pushing.trials import Bench
from optipromp.robots.tools import FrankaHand
from optipromp.scenes.scene import Scene, SceneObject

GRAVITY, FRICTION, DENSITY = 9.81, 0.4, 600.0  # what the planner takes for granted of packs
UPRIGHT = np.cos(np.deg2rad(5.0))
LEVEL = np.sin(np.deg2rad(5.0))
BEFORE = 0.025  # [m] before everything, where the tool point enters
LOW = 0.006  # [m] over the board that the hand's cover spheres go, so that packs do not topple
TOUCHING = 0.01  # [m] between the target and the board that it stands on
AROUND = 1.0  # [m] about the target within which things are looked at
MOST = 100  # pushables that are; every trial asks each of them for every other
UNSURE = 0.006  # [m] deviation of a thing that the scene states no covariance of


@dataclass(frozen=True, eq=False)
class Plane:
    """What stands around the target, seen along x_g.

    Attributes:
        things: the target first, then the pushables.
        state: (B, 3) where they stand: u, v [m], turn [rad].
        deviation: (B,) of their detected positions [m].
        friction, lever: (B,) see :func:`optipromp.pushing.quasi_static.push`.
        walls: static things at the target's height.
        edge: u of the board's front, behind which things must stay [m].
        entry: u of the tool point where the way begins [m].
        drop: along x_g, how far lower than the target's middle the hand goes until it is there [m].
    """

    things: Shapes
    state: FloatArray
    deviation: FloatArray
    friction: FloatArray
    lever: FloatArray
    walls: Shapes
    edge: float
    entry: float
    drop: float

    def bench(self, tool: FrankaHand, behind: Sequence[FloatArray] = ()) -> Bench:
        """The same for trials with a hand, and convex polygons (k, 2) ``behind`` it [m]."""
        mouth = np.array([tool.front - tool.reach, tool.tip - tool.reach, tool.gripper_radius])
        hand = shapes([*tool.outline(), *behind])
        return Bench(
            self.things, 1.0 / self.friction, self.lever**2, self.walls, hand, mouth, self.edge
        )


def ploughs(scene: Scene, tool: object) -> bool:
    """Whether a hand is to go through things that stand: a level approach, no stems, some pack."""
    if scene.target is None or not isinstance(tool, FrankaHand) or not scene.pushables:
        return False
    stand = all(thing.stem is None for thing in (scene.target, *scene.pushables))
    _, y_g, z_g = scene.frame
    return stand and max(abs(float(z_g[2])), abs(float(y_g[2]))) < LEVEL


def plane(scene: Scene, tool: FrankaHand) -> Plane:
    """The plane of a scene that :func:`ploughs`."""
    target, frame = scene.target, scene.frame
    assert target is not None
    standing = (target, *_packs(scene, target))
    parts, area, lever = zip(*(_footprint(thing, frame) for thing in standing), strict=True)
    flat = np.array([frame[[2, 1]] @ (thing.position - target.position) for thing in standing])
    tall = np.array([2.0 * _half_height(thing, frame) for thing in standing])
    walls, edge, drop = [], -np.inf, 0.0
    thick = float(tool.spheres()[:, 3].max()) + LOW
    bottom = _half_height(target, frame)
    level = np.abs((scene.positions - target.position) @ frame[0]) - scene.bounds
    around = scene.around(target.position, AROUND, "static")
    for thing in scene.things(around[level[around] < bottom + TOUCHING]):
        if not isinstance(thing.shape, Box):
            continue
        height = float(frame[0] @ (thing.position - target.position))
        half = _half_height(thing, frame)
        part, _, _ = _footprint(thing, frame)
        assert not isinstance(part, float)
        at = part + frame[[2, 1]] @ (thing.position - target.position)
        if abs(height) < half:
            walls.append(at)
        elif abs(abs(height) - half - bottom) < TOUCHING and _covers(at):
            edge = max(edge, float(at[:, 0].min()))
            drop = np.sign(height) * max(0.0, abs(height) - half - thick)
    things = shapes(list(parts))
    first = float(np.min(flat[:, 0] - things.radius))
    return Plane(
        things, np.column_stack([flat, np.zeros(len(flat))]),
        np.array([_deviation(thing) for thing in standing]),
        FRICTION * DENSITY * GRAVITY * np.array(area) * tall, np.array(lever), shapes(walls), edge,
        min(first, edge) - BEFORE - (tool.tip - tool.reach), float(drop),
    )  # fmt: skip


def _packs(scene: Scene, target: SceneObject) -> tuple[SceneObject, ...]:
    """The pushables around the target, in file order; the nearest where they are too many."""
    rows = scene.around(target.position, AROUND, "pushable")
    if len(rows) > MOST:
        away = np.linalg.norm(scene.positions[rows] - target.position, axis=1)
        rows = np.sort(rows[np.argsort(away, kind="stable")[:MOST]])
    return scene.things(rows)


def _deviation(thing: SceneObject) -> float:
    if thing.covariance is None:
        return UNSURE
    return max(UNSURE, float(np.sqrt(np.max(np.diag(thing.covariance)))))


def _half_height(thing: SceneObject, frame: FloatArray) -> float:
    up = thing.rotation.T @ frame[0]
    match thing.shape:
        case Box(size):
            return 0.5 * float(np.abs(up) @ np.array(size))
        case Cylinder(radius, length):
            return 0.5 * length * abs(float(up[2])) + radius * float(np.hypot(up[0], up[1]))
    return thing.radius


def _footprint(thing: SceneObject, frame: FloatArray) -> tuple[FloatArray | float, float, float]:
    """Outline about the centre, its area [m²], and the friction moment over the friction [m].

    Cans and packs stand on the rim of their base: a disc's moment is its radius, a rectangle's
    0.81 of half its diagonal.
    """
    shape = thing.shape
    if isinstance(shape, Cylinder) and abs(float(thing.rotation[:, 2] @ frame[0])) > UPRIGHT:
        return shape.radius, np.pi * shape.radius**2, shape.radius
    if isinstance(shape, Box):
        signs = np.array([[a, b, c] for a in (-1, 1) for b in (-1, 1) for c in (-1, 1)])
        corners = (0.5 * signs * np.array(shape.size)) @ thing.rotation.T @ frame[[2, 1]].T
        hull = _hull(corners)
        a, b = hull, np.roll(hull, -1, axis=0)
        area = 0.5 * abs(float(np.sum(a[:, 0] * b[:, 1] - b[:, 0] * a[:, 1])))
        return hull, area, 0.81 * float(np.linalg.norm(hull, axis=1).mean())
    radius = thing.radius
    return radius, np.pi * radius**2, radius


def _hull(points: FloatArray) -> FloatArray:
    """Convex hull (k, 2), counter-clockwise, of points (m, 2); nearly equal ones are one."""
    ordered = np.unique(np.round(points, 9), axis=0)

    def half(sequence: Sequence[FloatArray]) -> list[FloatArray]:
        chain: list[FloatArray] = []
        for p in sequence:
            while len(chain) > 1:
                a, b = chain[-2], chain[-1]
                if (b[0] - a[0]) * (p[1] - a[1]) - (b[1] - a[1]) * (p[0] - a[0]) > 1e-12:
                    break
                chain.pop()
            chain.append(p)
        return chain

    lower, upper = half(list(ordered)), half(list(ordered[::-1]))
    return np.array([*lower[:-1], *upper[:-1]])


def _covers(corners: FloatArray) -> bool:
    """Whether the box about ``corners`` (k, 2) is under the origin."""
    return bool((corners.min(axis=0) <= 0.0).all() and (corners.max(axis=0) >= 0.0).all())
