r"""A way for a hand through things that stand on a board: where to push what, decided beforehand.

A thing in the way has to go to one side, and there has to be room for it there; where the target
stands close by it must not be pushed along. Which way does that is found by trying: ways of a few
corners are drawn at random, each is played through in the quasi-static model
(:mod:`optipromp.pushing.quasi_static`), and the draw closes in on the best (cross-entropy method).

All of it happens in the plane of the board, in (u, v) along z_g and y_g from the target.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from optipromp.arrays import FloatArray
from optipromp.geometry.shapes import Box, Cylinder
from optipromp.pushing.quasi_static import Shapes, push, room, shapes
from optipromp.robots.tools import FrankaHand
from optipromp.scenes.scene import Scene, SceneObject

GRAVITY, FRICTION, DENSITY = 9.81, 0.4, 600.0  # what the planner takes for granted of packs
STEP = 0.003  # [m] of the model
UPRIGHT = np.cos(np.deg2rad(5.0))
LEVEL = np.sin(np.deg2rad(5.0))
BEFORE = 0.025  # [m] before everything, where the tool point enters
SIDEWAYS = 0.12  # [m] the way leads aside at most
CORNERS = (3, 4)  # of a way, besides its ends: in turn
ATTEMPTS = 6  # runs of the search, until a way is good
ROUNDS = ((300, 1), (150, 1), (150, 1), (150, 1), (150, 1), (50, 4), (50, 4), (50, 4))
"""Of a run: how many ways are drawn, and in how many trials each is judged."""
CLOSER = ((80, 6), (80, 6), (80, 6))
"""The same, about the best way of a run that is not good enough yet and not hopeless."""
HOPELESS = 16.0  # a cost
KEPT = 20  # ways that the next draw closes in on
TRIALS = 14  # with everything a little elsewhere, for the ways that are left
GOOD = 1.0  # a cost that needs no better
LOW = 0.006  # [m] over the board that the hand's cover spheres go, so that packs do not topple
SLIPPERY = 0.4, 1.4  # the friction of the trials, in that which is taken for granted
UNSURE = 0.006  # [m] deviation of a thing that the scene states no covariance of


Trial = tuple[FloatArray, float]
"""Where things stand (B, 3), and the coefficient of friction between them."""


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


@dataclass(frozen=True, eq=False)
class Way:
    """A way of the tool, and what it is expected to do.

    Attributes:
        corners: (k, 3) of the tool point, from the entry to the target [m].
        cost: expected; below 1 the target stands nearly still and everything goes where there is
            room.
    """

    corners: FloatArray
    cost: float


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
    standing = (target, *scene.pushables)
    parts, area, lever = zip(*(_footprint(thing, frame) for thing in standing), strict=True)
    flat = np.array([frame[[2, 1]] @ (thing.position - target.position) for thing in standing])
    tall = np.array([2.0 * _half_height(thing, frame) for thing in standing])
    walls, edge, drop = [], -np.inf, 0.0
    thick = float(tool.spheres()[:, 3].max()) + LOW
    bottom = _half_height(target, frame)
    for thing in scene.static:
        if not isinstance(thing.shape, Box):
            continue
        height = float(frame[0] @ (thing.position - target.position))
        half = _half_height(thing, frame)
        part, _, _ = _footprint(thing, frame)
        assert not isinstance(part, float)
        at = part + frame[[2, 1]] @ (thing.position - target.position)
        if abs(height) < half:
            walls.append(at)
        elif abs(abs(height) - half - bottom) < 0.01 and _covers(at):
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


def ways(
    scene: Scene,
    tool: FrankaHand,
    rng: np.random.Generator,
    count: int = 1,
    deadline: float = np.inf,
    behind: Sequence[FloatArray] = (),
) -> list[Way]:
    """The best ways found, best first.

    Args:
        scene: that :func:`ploughs`.
        tool: the hand.
        rng: where the draws come from.
        count: how many are wanted.
        deadline: ``time.perf_counter()`` after which no further run of the search begins.
        behind: convex polygons (k, 2) of the wrist behind the hand, as of its outline [m].
    """
    bench = plane(scene, tool)
    parts = shapes([*tool.outline(), *behind])
    target = scene.target
    assert target is not None

    trials = [(bench.state, FRICTION)]
    for _ in range(TRIALS):
        slip = FRICTION * float(rng.uniform(*SLIPPERY))
        trials.append((bench.state + _errors(bench, rng), slip))

    def value(at: FloatArray, chosen: Sequence[Trial]) -> float:
        corners = drawn(bench, at)
        worth = [min(cost(bench, tool, parts, corners, *one), 2.0 * WORST) for one in chosen]
        return float(np.mean(worth))

    best: list[tuple[float, FloatArray]] = []
    for attempt in range(ATTEMPTS):
        bends = CORNERS[attempt % len(CORNERS)]
        spread = np.array([0.06, *[0.05, 0.06] * bends])
        shares = np.linspace(1.0, 0.0, bends + 2)[1:-1]
        middle = np.array([0.0, *np.ravel([[share * bench.entry, 0.0] for share in shares])])
        found = _search(value, trials, middle, spread, spread, ROUNDS, rng)
        if GOOD < found[0][0] < HOPELESS:
            found += _search(value, trials, found[0][1], 0.3 * spread, spread, CLOSER, rng)
        best = sorted(best + found, key=lambda item: item[0])
        if best[0][0] < GOOD or time.perf_counter() > deadline:
            break
    frame = scene.frame[[2, 1, 0]]
    out = []
    for worth, at in best[:count]:
        corners = drawn(bench, at)
        out.append(Way(target.position + lowered(corners, bench.drop) @ frame, worth))
    return out


def _search(
    value: Callable[[FloatArray, Sequence[Trial]], float],
    trials: Sequence[Trial],
    middle: FloatArray,
    deviation: FloatArray,
    spread: FloatArray,
    rounds: Sequence[tuple[int, int]],
    rng: np.random.Generator,
) -> list[tuple[float, FloatArray]]:
    """One run of the cross-entropy method: some ways and what they cost, best first.

    Ways are judged with everything where it was seen (the first of ``trials``); those that do well
    there, and what is drawn near them, with everything a little elsewhere.
    """
    seen: list[tuple[float, FloatArray]] = []
    for turn, (draws, count) in enumerate(rounds):
        if turn and count != rounds[turn - 1][1]:
            seen = [(value(at, trials[:count]), at) for _, at in seen[:KEPT]]
        for _ in range(draws):
            at = middle + deviation * rng.standard_normal(len(middle))
            seen.append((value(at, trials[:count]), at))
        seen.sort(key=lambda item: item[0])
        seen = seen[: 3 * KEPT]
        best = np.array([at for _, at in seen[:KEPT]])
        middle = best.mean(axis=0)
        deviation = best.std(axis=0) + 0.1 * spread
    final = [(value(at, trials), at) for _, at in seen[:KEPT]]
    return sorted(final, key=lambda item: item[0])


FAR = 0.03  # [m] that the target may move before a trial is given up
WORST = 25.0  # a trial that fails costs this, however badly it does


def drawn(bench: Plane, at: FloatArray) -> FloatArray:
    """Corners (k, 2) of a way, from the numbers it is drawn as: v of the entry, u and v of each."""
    middle = at[1:].reshape(-1, 2)
    corners = np.vstack([[bench.entry, at[0]], middle, [0.0, 0.0]])
    corners[:, 0] = np.clip(corners[:, 0], bench.entry, 0.0)
    corners[:, 1] = np.clip(corners[:, 1], -SIDEWAYS, SIDEWAYS)
    return corners


def lowered(corners: FloatArray, drop: float) -> FloatArray:
    """Corners (k, 3) in (u, v) and along x_g of a way (k, 2): low, and up where it ends."""
    if drop == 0.0:
        return np.column_stack([corners, np.zeros(len(corners))])
    flat = np.vstack([corners, corners[-1:]])
    return np.column_stack([flat, [drop] * len(corners) + [0.0]])


def cost(
    bench: Plane,
    tool: FrankaHand,
    parts: Shapes,
    corners: FloatArray,
    state: FloatArray,
    slip: float = FRICTION,
) -> float:
    """What a way does that it should not: moves the target, jams, takes in others, pushes hard.

    Args:
        bench: the plane.
        tool: the hand, ``parts`` its outline.
        corners: (k, 2) of the way.
        state: (B, 3) where things stand.
        slip: coefficient of friction between things, and with the tool.
    """
    path = stepped(corners)
    result = push(
        path, parts, bench.things, state, bench.friction, bench.lever, bench.walls, slip, FAR
    )
    if result.done < 1.0:
        return WORST * (2.0 - result.done)
    end = result.state
    total = (float(np.linalg.norm(end[0, :2] - state[0, :2])) / 0.008) ** 2
    front, tip = tool.front - tool.reach, tool.tip - tool.reach
    total += (max(0.0, end[0, 0] - 0.4 * tip) / 0.002) ** 2
    total += (result.jam / 0.002) ** 2 + (max(0.0, result.force - 5.0) / 3.0) ** 2
    for u, v, _ in end[1:]:
        if front < u < tip and abs(v) < tool.gripper_radius:
            total += 10.0
        total += (max(0.0, bench.edge + 0.01 - u) / 0.005) ** 2
    if len(bench.walls.size):
        total += (max(0.0, 0.016 - room(path[::5], parts, bench.walls)) / 0.004) ** 2
    return float(total + 0.001 * len(path))


def stepped(corners: FloatArray) -> FloatArray:
    """Poses (T, 3) along a way (k, 2) in steps of the model; the hand does not turn."""
    steps = np.linalg.norm(np.diff(corners, axis=0), axis=1)
    at = np.append(0.0, np.cumsum(steps))
    wanted = np.linspace(0.0, at[-1], max(2, int(np.ceil(at[-1] / STEP)) + 1))
    keep = np.append(True, steps > 1e-9)
    out = np.zeros((len(wanted), 3))
    for i in range(2):
        out[:, i] = np.interp(wanted, at[keep], corners[keep, i])
    return out


def _errors(bench: Plane, rng: np.random.Generator) -> FloatArray:
    out = np.zeros_like(bench.state)
    out[:, :2] = bench.deviation[:, None] * rng.standard_normal((len(out), 2))
    return out


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

    A disc's moment is 2/3 of its radius under even pressure; a rectangle's is near 0.38 of its
    diagonal.
    """
    shape = thing.shape
    if isinstance(shape, Cylinder) and abs(float(thing.rotation[:, 2] @ frame[0])) > UPRIGHT:
        return shape.radius, np.pi * shape.radius**2, 2.0 / 3.0 * shape.radius
    if isinstance(shape, Box):
        signs = np.array([[a, b, c] for a in (-1, 1) for b in (-1, 1) for c in (-1, 1)])
        corners = (0.5 * signs * np.array(shape.size)) @ thing.rotation.T @ frame[[2, 1]].T
        hull = _hull(corners)
        a, b = hull, np.roll(hull, -1, axis=0)
        area = 0.5 * abs(float(np.sum(a[:, 0] * b[:, 1] - b[:, 0] * a[:, 1])))
        return hull, area, 0.76 * float(np.linalg.norm(hull, axis=1).mean()) * 0.5
    radius = thing.radius
    return radius, np.pi * radius**2, 2.0 / 3.0 * radius


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
