"""The push model of objects that stand on a board.

Trials in the plane of the board, in (u, v) along z_g and y_g from the target, predict whether an
object in the way has room at the side, and whether the target stays in place.

A path is tried in the perceived state and in sampled states, in the quasi-static model. Most paths
are bad: a trial ends as soon as the cost is sure to exceed a limit.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from optipromp.core.arrays import BoolArray, FloatArray, frozen, lengths
from optipromp.core.compiled import called, inner, kernel
from optipromp.core.geometry.shapes import Box, Cylinder
from optipromp.core.pushing.model import Candidates, Moved, PushModel, Round, Schedule
from optipromp.core.pushing.packs.flat import clear_ahead, shapes
from optipromp.core.pushing.packs.quasi_static import Bench, Pushed, push_once, pushed
from optipromp.core.pushing.parameters import PUSH
from optipromp.core.pushing.path import STEP, ToolPath, stepped, through
from optipromp.core.robots.model import Robot
from optipromp.core.robots.tool_geometry import hull
from optipromp.core.robots.tool_protocol import Tool
from optipromp.core.scenes.scene import Scene, SceneObject, measures_of, rows_around

PACK = PUSH.pack
AMONG = 0.3  # [m] behind the target, within which the arm may meet objects that stand: a choice
WALLS_EVERY = 5  # poses of a path for one at which its distance from the walls is measured


@inner
def _excess(value, free, unit):
    """Cost of a value above ``free``: ((value - free) / unit)², 0 below."""
    return (max(0.0, value - free) / unit) ** 2


@called
def motion_cost(start, end):
    """Cost of the target's motion from one state (B, 3) to another."""
    u, v = end[0, 0] - start[0, 0], end[0, 1] - start[0, 1]
    return float((u * u + v * v) / (PACK.moved * PACK.moved))


@called
def depth_cost(bench, end):
    """Cost of a target that ends too deep between the fingers."""
    return _excess(end[0, 0], 0.4 * bench.mouth[1], PACK.beyond)


@called
def edge_cost(bench, u):
    """Cost of an object that ends near the front of the board."""
    return _excess(bench.edge + PACK.behind, u, PACK.back)


@called
def force_cost(force):
    """Cost of the largest force [N]."""
    return _excess(force, PACK.light, PACK.heavy)


@called
def wall_cost(room):
    """Cost of a distance to the walls [m]."""
    return _excess(PACK.wide, room, PACK.tight)


@called
def _taken(bench, u, v):
    """Whether an object ends between the fingers."""
    palm, tip, half = bench.mouth
    return bool(palm < u < tip and abs(v) < half)


@kernel
def cost_of(bench, corners, states, slips, so_far, limit):
    """Mean cost of a path over trials, or infinity where it is sure to exceed ``limit``.

    A trial costs where the target moves, an object jams, an object ends between the fingers, the
    force is large, or a wall or the board's edge is near. The trials of the largest cost for
    earlier paths come first: they end a bad path soon.

    ``corners``: (k, 3) of the path in (u, v), the last column 0. ``states``: (N, B, 3) poses of the
    objects in each trial. ``slips``: (N,) coefficients of friction between objects, and with the
    tool. ``so_far``: (N,) summed cost of each trial for earlier paths; changed in place. ``limit``:
    largest mean cost of interest.
    """
    path = stepped(corners, PACK.step)
    room = clear_ahead(path, WALLS_EVERY, bench.hand, bench.walls, PACK.wide)
    always = 0.001 * len(path) + wall_cost(room)
    total, trials = 0.0, len(slips)
    costs = np.full(trials, -1.0)  # of the trials so far; -1: not made yet
    hardest = PACK.light + PACK.heavy * math.sqrt(PACK.worst)
    report = np.zeros(3)
    for _ in range(trials):
        left = (limit - always) * trials - total
        if left < 0.0:
            return math.inf
        n = -1
        for k in range(trials):
            if costs[k] < 0.0 and (n < 0 or so_far[k] > so_far[n]):
                n = k
        end = states[n].copy()
        enough = min(hardest, PACK.light + PACK.heavy * math.sqrt(left))
        pushed(bench, path, end, slips[n], PACK.far, enough, report)
        force, jam, done = report
        if done < 1.0:
            one = float(PACK.worst * (2.0 - done))
        else:
            one = motion_cost(states[n], end) + depth_cost(bench, end)
            one += (jam / PACK.jam) ** 2 + force_cost(force)
            for b in range(1, len(end)):
                if _taken(bench, end[b, 0], end[b, 1]):
                    one += PACK.taken
                one += edge_cost(bench, end[b, 0])
            one = min(one, 2.0 * PACK.worst)
        costs[n] = one
        so_far[n] += one
        total += one
    total = 0.0
    for n in range(trials):  # in the order of the trials: the sum does not depend on ``so_far``
        total += costs[n]
    return always + total / trials


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
    level = np.abs((scene.positions - target.position) @ frame[0]) - measures_of(scene.world)[2]
    around = rows_around(scene, target.position, STANDING.around, "static")
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
        elif (
            abs(abs(height) - half - bottom) < STANDING.touching
            and ((at.min(axis=0) <= 0.0) & (at.max(axis=0) >= 0.0)).all()
        ):  # the target stands on it
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
    rows = rows_around(scene, target.position, STANDING.around, "pushable")
    rows = rows[~scene.hangs[rows]]
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
        corners = hull(np.unique(np.round(corners, 9), axis=0))  # points within 1 nm are one
        outline = np.roll(corners, -int(np.lexsort(corners.T[::-1])[0]), axis=0)
        a, b = outline, np.roll(outline, -1, axis=0)
        area = 0.5 * abs(float(np.sum(a[:, 0] * b[:, 1] - b[:, 0] * a[:, 1])))
        return outline, area, 0.81 * float(np.linalg.norm(outline, axis=1).mean())
    radius = obj.radius
    return radius, np.pi * radius**2, radius


class PathsBetween(Candidates):
    """Paths between packs on a board, from the entry of the ``board`` to the target, in (u, v)."""

    schedule = Schedule(
        rounds=(Round(150, 1), *[Round(75, 1)] * 4, *[Round(25, 4)] * 3), runs=3, kept=20,
        states=1 + STANDING.samples, fresh=0.0, lenient=1.12,
    )  # fmt: skip

    def __init__(self, scene: Scene, board: Plane) -> None:
        assert scene.target is not None
        self._target, self._board = scene.target.position, board
        self._upright = scene.frame[[2, 1, 0]]  # (u, v) and up
        self.entry = float(self._target @ scene.frame[2]) + board.entry
        self._low = np.array([board.entry, -STANDING.sideways, -np.inf])
        self._high = np.array([0.0, STANDING.sideways, np.inf])

    def path(self, x: FloatArray) -> ToolPath:
        """From the entry at v = x[0] through the corners (u, v) in x[1:] to the target."""
        entry, drop = self._board.entry, self._board.drop
        between = len(x) // 2
        corners = np.zeros((between + (3 if drop else 2), 3))
        corners[: between + 2, 2] = drop  # low over the board, and up at the end
        corners[0, 0], corners[0, 1] = entry, x[0]
        corners[1 : between + 1, :2] = x[1:].reshape(-1, 2)
        corners = np.minimum(np.maximum(corners, self._low), self._high)
        return through(self._target + corners @ self._upright, STANDING.speed)

    def aside(self, x: FloatArray, path: ToolPath) -> float:
        """0: the harm includes walls and length."""
        return 0.0

    def first(self) -> FloatArray:
        """No candidate."""
        return np.zeros((0, 1))

    def spread(self, run: int) -> tuple[FloatArray, FloatArray]:
        """About the straight line from the entry."""
        corners = STANDING.first_corners if run == 0 else STANDING.corners
        shares = np.linspace(1.0, 0.0, corners + 2)[1:-1]
        line = np.ravel([[share * self._board.entry, 0.0] for share in shares])
        return np.append(0.0, line), np.append(
            STANDING.spread_aside, np.tile([STANDING.spread_along, STANDING.spread_aside], corners)
        )


MOVES = 1e-4  # [m or rad] motion of an object in a step of the model that is a push: a choice
EVERY = round(PUSH.pack.step / STEP)  # points of a path per step of the model


class Standing(PushModel):
    """The push model of objects that stand on a board, for one scene.

    Args:
        scene: the scene.
        tool: with an outline.
        behind: convex polygons (k, 2) of the wrist behind the tool, in the outline's frame [m].
        seed: of the sampled states.
        rings: (k, 3) of hand and last link, see :func:`rings_of`; without them no motion is clear.
        risk: share of promised successes that may be broken.
    """

    good, states = STANDING.good, 1 + STANDING.samples
    calibration = PUSH.packs

    def __init__(
        self, scene: Scene, tool: Tool, behind: Sequence[FloatArray] = (), seed: int = 0,
        rings: FloatArray | None = None, risk: float = PUSH.harm.risk,
    ) -> None:  # fmt: skip
        assert scene.target is not None
        self.threshold = self.calibration.allowed(risk)
        self.target, self.frame = scene.target.position, scene.frame
        self._rings = rings
        # (3, 3) to (u, v) and a turn of the hand, of 0
        self._flat = np.vstack([scene.frame[[2, 1]], np.zeros(3)]).T
        self.board = plane(scene, tool, behind)
        self.bench = self.board.bench
        self.candidates = PathsBetween(scene, self.board)
        seen = (scene.target, *packs(scene, scene.target))
        self.names = [obj.id for obj in seen]
        self._seen = np.array([obj.position for obj in seen])
        near = self.bench.objects.radius[:, None] + np.zeros(3)  # along x_g, y_g, z_g
        near[:, 0] = [obj.extent(self.frame[0]) for obj in seen]
        near += STANDING.sure * self.board.spread[:, None]
        place = (self._seen - self.target) @ self.frame.T
        self._packs = (place - near).min(axis=0), (place + near).max(axis=0)
        rng = np.random.default_rng(seed)
        self._so_far = dict[int, FloatArray]()  # summed cost of each trial, by number of states
        self._places = np.tile(self.board.state, (self.states, 1, 1))
        errors = rng.standard_normal((STANDING.samples, len(self.board.state), 2))
        self._places[1:, :, :2] += self.board.spread[:, None] * errors
        self._slips = PUSH.plane.friction * np.append(
            1.0, rng.uniform(STANDING.slippery_least, STANDING.slippery_most, STANDING.samples)
        )

    def _corners(self, points: FloatArray) -> FloatArray:
        """Every EVERY-th of the points (P, 3), and the last one, as poses in (u, v)."""
        chosen = np.concatenate([points[:-1:EVERY], points[-1:]])
        return (chosen - self.target) @ self._flat

    def harm(
        self, points: FloatArray, axes: FloatArray, states: int, limit: float = np.inf
    ) -> float:
        flat = self._corners(points)
        so_far = self._so_far.setdefault(states, np.zeros(states))
        tried = self._places[:states], self._slips[:states]
        return float(cost_of(self.bench, flat, *tried, so_far, limit))

    def clear(self, points: FloatArray, axes: FloatArray) -> bool:
        """See :class:`PushModel`; clear of the box that holds all packs."""
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
        flat = self._corners(points)
        one = [
            cost_of(self.bench, flat, place[None], np.array([slip]), np.zeros(1), np.inf)
            for place, slip in zip(self._places, self._slips, strict=True)
        ]
        worst, bench, path = int(np.argmax(one)), self.bench, stepped(flat, PACK.step)
        before, end = self._places[worst], self._end(path, worst)
        for name, (u, v, _) in zip(self.names[1:], end.state[1:], strict=True):
            if _taken(bench, u, v):
                return name, "ends between the fingers"
        moved = np.linalg.norm(end.state[:, :2] - before[:, :2], axis=1)
        target, farthest = self.names[0], self.names[int(np.argmax(moved))]
        if end.jam > PUSH.plane.jammed:
            return farthest, "is jammed"
        over = int(np.argmin(end.state[:, 0]))
        behind = float(end.state[over, 0]) - bench.edge
        if behind < 0.0:
            return self.names[over], "is pushed off the board"
        room = clear_ahead(path, WALLS_EVERY, bench.hand, bench.walls, PACK.wide)
        costs = (
            (depth_cost(bench, end.state), target,
             f"is {1e3 * end.state[0, 0]:.0f} mm beyond the tool point at the end"),
            (motion_cost(before, end.state), target,
             f"is pushed by {1e3 * moved[0]:.0f} mm"),
            (force_cost(end.force), farthest, f"is pushed with {end.force:.0f} N"),
            (edge_cost(bench, end.state[over, 0]), self.names[over],
             f"ends {1e3 * behind:.0f} mm behind the front of the board"),
            (wall_cost(room), "",
             f"the hand comes within {1e3 * max(room, 0.0):.0f} mm of a wall"),
        )  # fmt: skip
        _, name, cause = max(costs)
        return name, cause

    def moved(self, points: FloatArray, axes: FloatArray) -> Moved:
        flat = (points - self.target) @ self._flat
        end = self._end(stepped(flat, PACK.step), 0)
        shift = (end.state - self._places[0]) @ self._flat.T
        return Moved(tuple(self.names), self._seen + shift, end.state[:, 2])

    def pushing(self, points: FloatArray, axes: FloatArray) -> BoolArray:
        """See :class:`PushModel`; where an object moves in a step of the model."""
        flat = (points - self.target) @ self._flat
        path, state = stepped(flat, PACK.step), self._places[0]
        moves = np.zeros(len(path), dtype=bool)
        for step in range(1, len(path)):
            end = push_once(
                self.bench, path[step - 1 : step + 1], state, float(self._slips[0])
            ).state
            moves[step] = np.abs(end - state).max() > MOVES
            state = end
        gone = np.append(0.0, np.cumsum(lengths(np.diff(flat, axis=0))))
        rows = np.ceil(gone / max(gone[-1], 1e-9) * (len(path) - 1) - 1e-9).astype(np.int64)
        return np.asarray(moves[rows] | moves[np.minimum(rows + 1, len(path) - 1)])

    def _end(self, path: FloatArray, state: int) -> Pushed:
        """Effect of the hand, led along poses (T, 3), on one of the states."""
        return push_once(self.bench, path, self._places[state], float(self._slips[state]))


def applies(scene: Scene, tool: Tool | None) -> bool:
    """Whether the approach is level, and a pushable stands in the scene."""
    stands = not scene.hangs[scene.rows("pushable")].all()
    if scene.target is None or tool is None or not stands:
        return False
    _, y_g, z_g = scene.frame
    steep = max(abs(float(z_g @ scene.up)), abs(float(y_g @ scene.up)))
    return bool(steep < np.sin(np.deg2rad(STANDING.tilt)))


@lru_cache(maxsize=32)
def rings_of(robot: Robot) -> FloatArray:
    """Circles (k, 3) that the body spheres of last link and tool make about the tool axis.

    Columns: height over the tool point, distance from the axis, radius of the sphere [m].
    """
    own = np.asarray(robot.spheres.distal)
    center = robot.spheres.center[own] - robot.tool_point
    height = center @ robot.tool_axis
    aside = lengths(center - height[:, None] * robot.tool_axis)
    return frozen(np.column_stack([height, aside, robot.spheres.radius[own]]))


def wrist(robot: Robot, scene: Scene, target: FloatArray, goal: FloatArray) -> list[FloatArray]:
    """The links among the standing objects, a box (4, 2) per link.

    The boxes are in the coordinates of the tool's outline, at the target.
    """
    local = (robot.sphere_centers(goal) - target) @ scene.frame.T
    radius, link = np.asarray(robot.spheres.radius), np.asarray(robot.spheres.link)
    packs = [(obj.position - target) @ scene.frame[0] for obj in scene.pushables]
    tall = max(obj.radius for obj in scene.pushables)
    low, high = min(packs) - tall, max(packs) + tall
    level_with = (local[:, 0] + radius > low) & (local[:, 0] - radius < high)
    near = level_with & (local[:, 2] + radius > -AMONG) & (link < robot.n_own_links)
    out = []
    for one in np.unique(link[near]):
        mine = near & (link == one)
        flat, wide = local[mine][:, [2, 1]], radius[mine, None]
        (u0, v0), (u1, v1) = (flat - wide).min(axis=0), (flat + wide).max(axis=0)
        out.append(np.array([[u0, v0], [u1, v0], [u1, v1], [u0, v1]]))
    return out
