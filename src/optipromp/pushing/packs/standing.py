"""The push model of objects that stand on a board, and its candidate paths.

A candidate path is a polyline in the plane of the board, in (u, v) along z_g and y_g from the
target. Trials in the model tell whether an object in the way finds room at the side, and whether
the target stays where it is.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from optipromp.arrays import FloatArray, frozen, lengths
from optipromp.geometry.shapes import Box, Cylinder
from optipromp.pushing.model import Calibration, Moved, PushModel, Round, Schedule
from optipromp.pushing.packs.flat import Shapes, clear, shapes
from optipromp.pushing.packs.quasi_static import JAMMED, Pushed, push
from optipromp.pushing.packs.trials import (
    BACK,
    BEHIND,
    BEYOND,
    HEAVY,
    LIGHT,
    MOVED,
    TIGHT,
    WIDE,
    Bench,
    cost,
    stepped,
)
from optipromp.pushing.parameters import PUSH
from optipromp.pushing.path import STEP, ToolPath, through
from optipromp.robots.model import Robot
from optipromp.robots.tool_protocol import Tool
from optipromp.scenes.scene import Scene, SceneObject

STANDING = PUSH.standing
SCHEDULE = Schedule(
    rounds=(Round(150, 1), *[Round(75, 1)] * 4, *[Round(25, 4)] * 3), runs=3, kept=20, screened=3,
    states=1 + STANDING.samples, fresh=0.0, lenient=1.12,
)  # fmt: skip


class Standing(PushModel):
    """The push model of objects that stand on a board, for one scene.

    Args:
        scene: the scene.
        tool: with an outline.
        behind: convex polygons (k, 2) of the wrist behind the tool, in the outline's frame [m].
        seed: of the sampled states.
        rings: (k, 3) the hand and the last link, see :func:`rings_of`; none: it is not known where
            they are clear of the packs.
        risk: share of promised successes that may be broken.
    """

    speed, good, states, schedule = STANDING.speed, STANDING.good, 1 + STANDING.samples, SCHEDULE
    calibration = Calibration(
        PUSH.packs.harm, PUSH.packs.failed, PUSH.harm.risks, PUSH.packs.thresholds
    )

    def __init__(
        self, scene: Scene, tool: Tool, behind: Sequence[FloatArray] = (), seed: int = 0,
        rings: FloatArray | None = None, risk: float = PUSH.harm.risk,
    ) -> None:  # fmt: skip
        assert scene.target is not None
        self.threshold = self.calibration.allowed(risk)
        self.target, self.frame = scene.target.position, scene.frame
        self._flat, self._upright = scene.frame[[2, 1]].T, scene.frame[[2, 1, 0]]
        self.board = plane(scene, tool)
        seen = (scene.target, *_packs(scene, scene.target))
        self.names = [obj.id for obj in seen]
        self._seen = np.array([obj.position for obj in seen])
        self.bench = self.board.bench(tool, behind)
        self.entry, self._rings = float(self.target @ self.frame[2]) + self.board.entry, rings
        near = self.board.objects.radius[:, None] + np.zeros(3)  # along x_g, y_g, z_g
        near[:, 0] = [_half_height(obj, self.frame) for obj in seen]
        place, near = (
            (self._seen - self.target) @ self.frame.T,
            near + STANDING.sure * self.board.spread[:, None],
        )
        self._packs = (place - near).min(axis=0), (place + near).max(axis=0)
        self._low = np.array([self.board.entry, -STANDING.sideways, -np.inf])
        self._high = np.array([0.0, STANDING.sideways, np.inf])
        rng = np.random.default_rng(seed)
        self._so_far = dict[int, FloatArray]()  # cost of each trial, by the number of states
        self._places = np.tile(self.board.state, (self.states, 1, 1))
        errors = rng.standard_normal((STANDING.samples, len(self.board.state), 2))
        self._places[1:, :, :2] += self.board.spread[:, None] * errors
        self._slips = PUSH.plane.friction * np.append(
            1.0, rng.uniform(STANDING.slippery_least, STANDING.slippery_most, STANDING.samples)
        )

    def _corners(self, points: FloatArray) -> FloatArray:
        """Every few of the points (P, 3), and the last, in (u, v)."""
        chosen = np.concatenate([points[: -1 : STANDING.every], points[-1:]])
        return (chosen - self.target) @ self._flat

    def harm(
        self, points: FloatArray, axes: FloatArray, states: int, limit: float = np.inf
    ) -> float:
        """See :class:`PushModel`; the costs are those of :mod:`optipromp.pushing.packs.trials`."""
        flat = self._corners(points)
        so_far = self._so_far.setdefault(states, np.zeros(states))
        tried = self._places[:states], self._slips[:states]
        return float(cost(self.bench, flat, *tried, so_far, limit))

    def clear(self, points: FloatArray, axes: FloatArray) -> bool:
        """See :class:`PushModel`; of the box that holds all packs."""
        if self._rings is None:
            return False
        height, aside, radius = self._rings.T
        lean, at = axes @ self.frame.T, (points - self.target) @ self.frame.T
        free = np.zeros(len(points), dtype=bool)
        for middle, along, low, high in zip(at.T, lean.T, *self._packs, strict=True):
            across = np.sqrt(np.maximum(1.0 - along**2, 0.0))[:, None] * aside + radius
            centers = middle[:, None] + along[:, None] * height
            free |= (centers - across).min(axis=1) > high
            free |= (centers + across).max(axis=1) < low
        return bool(free.all())

    def cause(self, points: FloatArray, axes: FloatArray) -> tuple[str, str]:
        """See :class:`PushModel`."""
        flat = self._corners(points)
        one = [
            float(cost(self.bench, flat, place[None], np.array([slip]), np.zeros(1), np.inf))
            for place, slip in zip(self._places, self._slips, strict=True)
        ]
        worst = int(np.argmax(one))
        before, bench = self._places[worst], self.bench
        path = stepped(flat, STANDING.every * STEP)
        end = self._end(path, worst)
        palm, tip, half = bench.mouth
        u, v = end.state[1:, 0], end.state[1:, 1]
        taken = np.flatnonzero((palm < u) & (u < tip) & (np.abs(v) < half))
        if len(taken):
            return self.names[1 + int(taken[0])], "ends between the fingers"
        moved = np.linalg.norm(end.state[:, :2] - before[:, :2], axis=1)
        if end.jam > JAMMED:
            return self.names[int(np.argmax(moved))], "is jammed"
        over = int(np.argmin(end.state[:, 0]))
        behind = float(end.state[over, 0]) - bench.edge
        if behind < 0.0:
            return self.names[over], "is pushed off the board"
        room = clear(path, 5, bench.hand, bench.walls, WIDE) if len(bench.walls.size) else WIDE
        deep = max(0.0, float(end.state[0, 0]) - 0.4 * tip)
        costs = (  # as of trials.cost
            ((deep / BEYOND) ** 2, self.names[0],
             f"is {1e3 * end.state[0, 0]:.0f} mm beyond the tool point at the end"),
            ((moved[0] / MOVED) ** 2, self.names[0], f"is pushed by {1e3 * moved[0]:.0f} mm"),
            ((max(0.0, end.force - LIGHT) / HEAVY) ** 2, self.names[int(np.argmax(moved))],
             f"is pushed with {end.force:.0f} N"),
            ((max(0.0, BEHIND - behind) / BACK) ** 2, self.names[over],
             f"ends {1e3 * behind:.0f} mm behind the front of the board"),
            (((WIDE - room) / TIGHT) ** 2, "",
             f"the hand comes within {1e3 * max(room, 0.0):.0f} mm of a wall"),
        )  # fmt: skip
        _, name, cause = max(costs)
        return name, cause

    def moved(self, points: FloatArray, axes: FloatArray) -> Moved:
        """See :class:`PushModel`."""
        flat = (points - self.target) @ self._flat
        end = self._end(stepped(flat, STANDING.every * STEP), 0)
        shift = (end.state - self._places[0])[:, :2] @ self._flat.T
        return Moved(tuple(self.names), self._seen + shift, end.state[:, 2])

    def _end(self, path: FloatArray, state: int) -> Pushed:
        """What the hand, led along poses (T, 3), does to one of the states."""
        bench = self.bench
        return push(
            path, bench.hand, bench.objects, self._places[state],
            1.0 / bench.yields, np.sqrt(bench.lever2), bench.walls, float(self._slips[state]),
        )  # fmt: skip

    def path(self, x: FloatArray) -> ToolPath:
        """From v of the entry x[0] through corners at u and v to the target, low over the board."""
        entry, drop = self.board.entry, self.board.drop
        between = len(x) // 2
        corners = np.zeros((between + (3 if drop else 2), 3))  # up, where it ends
        corners[: between + 2, 2] = drop
        corners[0, 0], corners[0, 1] = entry, x[0]
        corners[1 : between + 1, :2] = x[1:].reshape(-1, 2)
        corners = np.minimum(np.maximum(corners, self._low), self._high)
        return through(self.target + corners @ self._upright, STANDING.speed)

    def aside(self, x: FloatArray, path: ToolPath) -> float:
        """Nothing: the costs know of walls and length."""
        return 0.0

    def first(self) -> FloatArray:
        """None."""
        return np.zeros((0, 1))

    def spread(self, run: int) -> tuple[FloatArray, FloatArray]:
        """About the straight line from the entry."""
        corners = STANDING.first_corners if run == 0 else STANDING.corners
        shares = np.linspace(1.0, 0.0, corners + 2)[1:-1]
        line = np.ravel([[share * self.board.entry, 0.0] for share in shares])
        return np.append(0.0, line), np.append(
            STANDING.spread_aside, np.tile([STANDING.spread_along, STANDING.spread_aside], corners)
        )


@dataclass(frozen=True, eq=False)
class Plane:
    """What stands around the target, seen along x_g.

    Attributes:
        objects: the target first, then the pushables.
        state: (B, 3) where they stand: u, v [m], turn [rad].
        spread: (B,) standard deviation of their detected positions [m].
        friction, lever: (B,) see :func:`optipromp.pushing.packs.quasi_static.push`.
        walls: static objects at the target's height.
        edge: u of the board's front, behind which objects must stay [m].
        entry: u of the tool point where a path begins [m].
        drop: along x_g, how far lower than the target's middle the hand goes until it is there [m].
    """

    objects: Shapes
    state: FloatArray
    spread: FloatArray
    friction: FloatArray
    lever: FloatArray
    walls: Shapes
    edge: float
    entry: float
    drop: float

    def bench(self, tool: Tool, behind: Sequence[FloatArray] = ()) -> Bench:
        """The same for trials with a hand, and convex polygons (k, 2) ``behind`` it [m]."""
        mouth = np.array([tool.front - tool.reach, tool.tip - tool.reach, tool.gripper_radius])
        if tool.mouth[0] == 0.0:  # nothing is taken hold of, and the target is nowhere too deep
            mouth[1:] = np.inf, 0.0
        hand = shapes([*tool.outline(), *behind])
        return Bench(
            self.objects, 1.0 / self.friction, self.lever**2, self.walls, hand, mouth, self.edge
        )


@lru_cache(maxsize=32)
def rings_of(robot: Robot) -> FloatArray:
    """The body spheres (k, 3) of the last link and the tool, whatever the roll: their heights over
    the tool point, their distances from the tool axis, their radii [m]."""
    own = np.asarray(robot.spheres.distal)
    center = robot.spheres.center[own] - robot.tool_point
    height = center @ robot.tool_axis
    aside = lengths(center - height[:, None] * robot.tool_axis)
    return frozen(np.column_stack([height, aside, robot.spheres.radius[own]]))


def applies(scene: Scene, tool: Tool | None) -> bool:
    """Whether the tool comes to its target on the level, and something stands in the scene."""
    if scene.target is None or tool is None:
        return False
    stands = any(obj.stem is None for obj in scene.pushables)
    _, y_g, z_g = scene.frame
    return stands and bool(
        max(abs(float(z_g @ scene.up)), abs(float(y_g @ scene.up)))
        < np.sin(np.deg2rad(STANDING.tilt))
    )


def plane(scene: Scene, tool: Tool) -> Plane:
    """The plane of a scene that the model :func:`applies` to."""
    target, frame = scene.target, scene.frame
    assert target is not None
    standing = (target, *_packs(scene, target))
    parts, area, lever = zip(*(_footprint(obj, frame) for obj in standing), strict=True)
    flat = np.array([frame[[2, 1]] @ (obj.position - target.position) for obj in standing])
    tall = np.array([2.0 * _half_height(obj, frame) for obj in standing])
    walls, edge, drop = [], -np.inf, 0.0
    thick = float(tool.spheres()[:, 3].max()) + STANDING.low
    bottom = _half_height(target, frame)
    level = np.abs((scene.positions - target.position) @ frame[0]) - scene.bounds
    around = scene.around(target.position, STANDING.around, "static")
    for obj in scene.objects_at(around[level[around] < bottom + STANDING.touching]):
        if not isinstance(obj.shape, Box):
            continue
        height = float(frame[0] @ (obj.position - target.position))
        half = _half_height(obj, frame)
        part, _, _ = _footprint(obj, frame)
        assert not isinstance(part, float)
        at = part + frame[[2, 1]] @ (obj.position - target.position)
        if abs(height) < half:
            walls.append(at)
        elif abs(abs(height) - half - bottom) < STANDING.touching and _covers(at):
            edge = max(edge, float(at[:, 0].min()))
            drop = np.sign(height) * max(0.0, abs(height) - half - thick)
    objects = shapes(list(parts))
    begin = float(np.min(flat[:, 0] - objects.radius))
    if np.isfinite(edge):  # there is a board
        begin = min(begin, edge)
    return Plane(
        objects, np.column_stack([flat, np.zeros(len(flat))]),
        np.array([_spread(obj) for obj in standing]),
        PUSH.plane.friction * PUSH.plane.density * PUSH.beam.gravity * np.array(area) * tall,
        np.array(lever), shapes(walls), edge,
        begin - STANDING.before - (tool.tip - tool.reach), float(drop),
    )  # fmt: skip


def _packs(scene: Scene, target: SceneObject) -> tuple[SceneObject, ...]:
    """The pushables that stand around the target, in file order; the nearest of too many."""
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


def _half_height(obj: SceneObject, frame: FloatArray) -> float:
    up = obj.rotation.T @ frame[0]
    match obj.shape:
        case Box(size):
            return 0.5 * float(np.abs(up) @ np.array(size))
        case Cylinder(radius, length):
            return 0.5 * length * abs(float(up[2])) + radius * float(np.hypot(up[0], up[1]))
    return obj.radius


def _footprint(obj: SceneObject, frame: FloatArray) -> tuple[FloatArray | float, float, float]:
    """Outline about the centre, its area [m²], and the friction moment over the friction [m].

    Cans and packs stand on the rim of their base: a disc's moment is its radius, a rectangle's
    0.81 of half its diagonal.
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
