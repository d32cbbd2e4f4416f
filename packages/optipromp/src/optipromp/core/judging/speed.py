"""The passage of the tool past each pushable, and its speed among what it pushes.

A passage has a side, a lateral clearance and the distance from the stem. Push prediction holds for
a slow tool.
"""

import functools
import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from optipromp.core.arrays import BoolArray, FloatArray, IntArray, joined, lengths
from optipromp.core.compiled import called, inner, kernel
from optipromp.core.judging import distances
from optipromp.core.judging.curve import along
from optipromp.core.judging.kinematics import centers, last_poses
from optipromp.core.robots.model import Robot
from optipromp.core.scenes.scene import Scene
from optipromp.core.trajectory import Trajectory

DECIDED = np.sin(np.deg2rad(1.0))  # [-] a choice: a stem that leans less decides no side

ById = dict[str, float | None]
Ways = dict[str, tuple[float, float] | None]


class Passing(NamedTuple):
    """Figures by pushable [m], None where there is nothing to measure (method §6)."""

    M_p: ById  # y_g·(fk − X_n) where the tool passes n for the last time
    stem_projection: ById  # y_g·S_n
    drift_shortfall: ById  # constraint 1: lack of the offset that it asks for
    stem_gap: ById  # constraint 2: from the segment between tool and fruit to the stem's line
    passage: Ways  # components along x_g and y_g of fk − X_n there
    wrong: list[tuple[str, int, float]]  # passed on the stem's side: id, waypoint, depth [m]


class Pushables(NamedTuple):
    """K pushables of a scene, for the judgement of their passage."""

    ids: list[str]
    places: FloatArray  # (K, 3) X_n [m]
    radii: FloatArray  # (K,) of balls that hold the objects [m]
    half: FloatArray  # (K,) r_n, half the extent along z_g [m]
    hangs: BoolArray  # (K,) whether there is a stem
    flat: FloatArray  # (K, 3) S_n, the stem's first piece, without its part along z_g [m]
    leans: BoolArray  # (K,) whether the stem decides on which side to pass
    side: FloatArray  # (K,) s_n = −sign(y_g·S_n), 0 where the stem decides no side
    points: FloatArray  # (P, 3) of all stems [m]
    start: IntArray  # (K + 1,) where the points of each stem begin
    reach: FloatArray  # (K,) distance below which a passing tool may push the object [m]
    in_the_way: BoolArray  # (K,) whether a straight approach would push the object (method §4, 1)
    under: FloatArray  # (K,) distance of the top below the target's bottom, along z_g [m]
    projection: ById  # y_g·S_n [m]
    offset: FloatArray  # (K,) that constraint 1 asks for: the scene's drift_offset, else R_gripper
    camera: FloatArray  # (3,) camera point: before target and lowest fruit in the way [m], or NaN


@functools.lru_cache(maxsize=4)
def pushables_of(scene: Scene, gripper_radius: float) -> Pushables:
    """The scene's pushables, as passed by a gripper of radius ``gripper_radius`` [m]."""
    items, rows = scene.pushables, scene.rows("pushable")
    places, (_, lateral, up) = scene.positions[rows], scene.frame
    count = [0 if item.stem is None else len(item.stem.points) for item in items]
    hangs, start = np.array(count, dtype=int) > 0, np.zeros(len(items) + 1, dtype=np.int64)
    np.cumsum(count, out=start[1:])
    points = joined([item.stem.points for item in items if item.stem is not None]).reshape(-1, 3)
    stems = np.zeros((len(items), 3))
    first = start[:-1][hangs]
    stems[hangs] = points[first + 1] - points[first]
    flat = stems - (stems @ up)[:, None] * up
    least = DECIDED * lengths(stems)
    projection = stems @ lateral
    _, _, radii = distances.measured([item.shape for item in items])
    under = np.full(len(items), np.inf)
    in_the_way, camera = np.zeros(len(items), dtype=bool), np.full(3, np.nan)
    if scene.target is not None:
        off = places - scene.target.position
        along = off @ up
        aside = lengths(off - along[:, None] * up)
        in_the_way = (along >= -0.2) & (along < 0.0) & (aside <= 1.5 * gripper_radius)
        under = -along - scene.target.radius - radii
        lowest = (along - radii)[in_the_way].min(initial=0.0)
        camera = scene.target.position + (lowest - scene.approach.camera_distance) * up
    ids, asked = [item.id for item in items], scene.options.get("drift_offset")
    own = asked if isinstance(asked, Mapping) else {}
    usual = gripper_radius if asked is None or asked is own else asked
    return Pushables(
        ids, places, radii, np.array([item.extent(up) for item in items]), hangs, flat,
        hangs & (lengths(flat) >= least),
        np.where(hangs & (np.abs(projection) >= least), -np.sign(projection), 0.0),
        np.array(points), start, radii + 2.0 * gripper_radius, in_the_way, under,
        _known(ids, projection, hangs), np.array([float(own.get(n, usual)) for n in ids]), camera,
    )  # fmt: skip


def as_passed(scene: Scene, times: FloatArray, tips: FloatArray) -> Scene:
    """The scene in which each pushable that moves stands where it is as the tool passes it last.

    ``times`` (T,) [s] and tool points ``tips`` (T, 3) of the waypoints. A pushable that the tool
    does not pass stands where it is at the end.
    """
    when = {}
    for name, course in scene.drifting.items():
        passed = np.flatnonzero(np.diff(np.sign((tips - course.at(times)) @ scene.frame[2])))
        when[name] = float(times[passed[-1] if len(passed) else -1])
    return scene.standing(when)


def passages(scene: Scene, tips: FloatArray, rims: FloatArray, gripper_radius: float) -> Passing:
    """The passage of a tool past the pushables of a scene.

    Neither the tool point nor the centre of the rim may pass a pushable on the side of its stem:
    the rim decides to which side the fruit goes. The rim alone counts for a pushable so close under
    the target that the rim reaches the target before the tool point passes the pushable.

    Constraints 1 and 2 are evaluated at the waypoints of the passing window,
    |z_g·(fk − X_n)| <= r_n, and at the waypoint nearest the passage, from t_1 on: the waypoint
    nearest the camera point. They concern pushables that the tool passes then, within two gripper
    radii, or that a straight approach would push.

    ``tips``, ``rims``: (T, 3) tool points and centres of the rim at the waypoints [m].
    ``gripper_radius``: R_gripper [m].
    """
    objects = pushables_of(scene, gripper_radius)
    if not objects.ids:
        return Passing({}, {}, {}, {}, {}, [])
    across, lateral, up = map(np.array, scene.frame)
    tips, rims, places = np.array(tips), np.array(rims), np.array(objects.places)
    waypoint, tip = last_passages(tips, places, up)
    rim_waypoint, rim = last_passages(rims, places, up)
    closely_under = objects.under < float((rims[-1] - tips[-1]) @ up)
    tip_asked, rim_asked = (objects.in_the_way | (lengths(at) < objects.reach) for at in (tip, rim))
    tip_asked &= waypoint >= 0
    by_tip, by_rim = (np.einsum("ki,ki->k", at, objects.flat) for at in (tip, rim))
    bad_rim = (rim_waypoint >= 0) & rim_asked & (by_rim > 0.0)
    bad_tip = tip_asked & ~closely_under & (by_tip > 0.0)
    wrong = []
    for k in np.flatnonzero(objects.leans & (bad_rim | bad_tip)).tolist():
        at, by = (rim_waypoint, by_rim) if bad_rim[k] else (waypoint, by_tip)
        wrong.append((objects.ids[k], int(at[k]), float(by[k] / math.hypot(*objects.flat[k]))))

    m_p = tip @ lateral
    side = np.where(objects.side == 0.0, np.sign(m_p), objects.side)
    least, gap = np.full(len(places), np.inf), np.full(len(places), np.inf)
    stems = places, objects.radii, objects.half, objects.points, objects.start
    first = len(tips) - 1 - int(np.argmin(lengths(tips - objects.camera)[::-1]))  # the last of them
    first = 0 if scene.target is None else first
    passed = tip_asked & (waypoint >= first)
    rows = np.flatnonzero(passed)
    window(tips, first, rows, waypoint, side, lateral, up, stems, least, gap)
    return Passing(
        _known(objects.ids, m_p, waypoint >= 0),
        dict(objects.projection),
        _known(objects.ids, np.maximum(objects.offset - least, 0.0), passed),
        _known(objects.ids, gap, passed & objects.hangs),
        {
            name: (x, y) if at >= 0 else None
            for name, x, y, at in zip(
                objects.ids, (tip @ across).tolist(), m_p.tolist(), waypoint.tolist(), strict=True
            )
        },
        wrong,
    )


def _known(ids: list[str], values: FloatArray, known: BoolArray) -> ById:
    """Values (K,) by id, None for those that are not ``known`` (K,)."""
    found = zip(ids, values.tolist(), known.tolist(), strict=True)
    return {name: value if is_known else None for name, value, is_known in found}


@kernel
def last_passages(path, places, up):
    """The last crossings of a path (T, 3) with the level planes of ``places`` (K, 3).

    Places above or below the whole path are skipped.

    Returns: The waypoint (K,) nearest each crossing, -1 where there is no crossing; and the
    horizontal offset (K, 3) of this waypoint from the place [m], 0 where there is no crossing.
    """
    waypoint, at = np.full(len(places), -1), np.zeros((len(places), 3))
    lowest, highest = math.inf, -math.inf
    for t in range(path.shape[0]):
        height = path[t, 0] * up[0] + path[t, 1] * up[1] + path[t, 2] * up[2]
        lowest, highest = min(lowest, height - 1e-9), max(highest, height + 1e-9)
    for k in range(places.shape[0]):
        p = places[k]
        level = p[0] * up[0] + p[1] * up[1] + p[2] * up[2]
        if not lowest <= level <= highest:
            continue
        after = _over(path[-1], p, up)
        for before in range(path.shape[0] - 2, -1, -1):
            height = _over(path[before], p, up)
            if np.sign(height) != np.sign(after):
                waypoint[k], off = before, height
                if abs(after) < abs(height):
                    waypoint[k], off = before + 1, after
                for i in range(3):
                    at[k, i] = path[waypoint[k], i] - p[i] - off * up[i]
                break
            after = height
    return waypoint, at


@inner
def _over(point, place, up):
    """Component along ``up`` of the offset of a point from a place [m]."""
    x, y, z = point[0] - place[0], point[1] - place[1], point[2] - place[2]
    return x * up[0] + y * up[1] + z * up[2]


@kernel
def window(path, first, rows, waypoint, side, lateral, up, stems, least, gap):
    """The paper's constraints 1 and 2 over the passing windows, in place.

    ``path``: (T, 3) tool points at the waypoints [m]. ``first``: waypoint at t_1. ``rows``: indices
    of the pushables to evaluate. ``waypoint``: (K,) waypoint of each passage; the window includes
    it. ``side``: (K,) s_n. ``lateral``, ``up``: (3,) y_g and z_g. ``stems``: ``places``, ``radii``,
    ``half``, ``points`` and ``start`` of :class:`Pushables`. ``least``: (K,) smallest s_n·y_g·(fk −
    X_n) [m]. ``gap``: (K,) smallest distance from the stem's line to the segment from tool point to
    fruit, which ends at the fruit's surface, where the stem begins [m].
    """
    places, radii, half, points, start = stems
    for k in rows:
        p, end = places[k], np.empty(3)
        for t in range(first, path.shape[0]):
            if abs(_over(path[t], p, up)) > half[k] and t != waypoint[k]:
                continue
            least[k] = min(least[k], side[k] * _over(path[t], p, lateral))
            away = 0.0
            for i in range(3):
                away += (path[t, i] - p[i]) ** 2
            share = radii[k] / max(math.sqrt(away), radii[k])
            for i in range(3):
                end[i] = p[i] + share * (path[t, i] - p[i])
            for j in range(start[k], start[k + 1] - 1):
                gap[k] = min(gap[k], between(path[t], end, points[j], points[j + 1]))


@called
def between(a, b, c, d):
    """Distance [m] between the segments from a to b and from c to d (Ericson 2005, 5.1.9)."""
    uu = vv = uv = uw = vw = s = squared = 0.0
    for i in range(3):
        u, v, w = b[i] - a[i], d[i] - c[i], a[i] - c[i]
        uu, vv, uv, uw, vw = uu + u * u, vv + v * v, uv + u * v, uw + u * w, vw + v * w
    area = uu * vv - uv * uv
    if area > 1e-12 * uu * vv:
        s = min(max((uv * vw - uw * vv) / area, 0.0), 1.0)
    t = (uv * s + vw) / vv if vv > 0.0 else -1.0  # of a point: as before the begin of a line
    if not 0.0 <= t <= 1.0:
        t = min(max(t, 0.0), 1.0)
        s = min(max((uv * t - uw) / uu, 0.0), 1.0) if uu > 0.0 else 0.0
    for i in range(3):
        squared += (a[i] + s * (b[i] - a[i]) - c[i] - t * (d[i] - c[i])) ** 2
    return math.sqrt(squared)


PUSHED = 0.1  # [m/s] largest speed of the tool for which push prediction holds
BESIDE = 0.03  # [m/s] the same among objects that stand: at 0.05 m/s packs are pressed with 10 N
FASTER = 0.1  # [-] share by which a trajectory may exceed either: a choice
NEAR = 0.02  # [m] tool to fruit: a choice, several standard deviations of a well-known position
TOUCHED = 0.01  # [m] body to an object that stands: a choice, less than the planner's distance
LEVEL = math.sin(math.radians(5.0))  # [-] of an approach that pushes what stands: a choice
CONFIGURATIONS = 4_000  # measured together: 10 MB of sphere centres
PARTS = 8  # of the time between two checks; the speed is a mean over one part: a choice


def among_fruits(
    scene: Scene, robot: Robot, trajectory: Trajectory, rows: IntArray, points: FloatArray,
    axes: FloatArray,
) -> tuple[float, float] | None:  # fmt: skip
    """Largest speed of the tool among pushables [m/s], and its time [s].

    Where :func:`stands` applies, the speed is that near objects that stand: nearer than
    :data:`TOUCHED` to the first place of one of them is any part of the body. Else it is the speed
    near pushables that hang.

    The tool counts as a cylinder of the gripper's radius from flange to rim. The tool is among
    fruits where the distance to one of them, in its first place, is below :data:`NEAR`.

    ``rows``: (T,) indices of the waypoints among the checks. ``points``, ``axes``: (M, 3) tool
    points [m] and tool axes at the checks.

    Returns:
        None where the tool is never among pushables, neither applies, or the robot has no tool.
    """
    target, tool, near = scene.target, robot.tool, np.zeros(len(points), dtype=bool)
    if tool is None or target is None:
        return None
    if stands(scene):
        q = np.array(along(trajectory, np.diff(rows))[1])
        return _fastest(robot, trajectory, rows, _touching(scene, robot, q))
    if target.stem is None:
        return None
    objects = pushables_of(scene, robot.gripper_radius)
    moves = np.array([name in scene.drifting for name in objects.ids], dtype=bool)
    tools = [(points, objects.hangs & ~moves)]
    for k in np.flatnonzero(moves).tolist():  # the tool relative to what is where it is at time 0
        by = scene.drifting[objects.ids[k]].at(along(trajectory, np.diff(rows))[0])
        tools.append((points - by + objects.places[k], np.arange(len(moves)) == k))
    for at, which in tools:
        mark(
            np.array(at), np.array(axes), np.array(objects.places[which]),
            np.array(objects.radii[which]) + NEAR, robot.gripper_radius, tool.reach, tool.depth,
            near,
        )  # fmt: skip
    return _fastest(robot, trajectory, rows, near)


def _fastest(
    robot: Robot, trajectory: Trajectory, rows: IntArray, near: BoolArray
) -> tuple[float, float] | None:
    """Largest speed of the tool [m/s] and its time [s] where it is ``near`` (M,) at the checks."""
    if not near.any():
        return None
    times, q, _ = along(trajectory, PARTS * np.diff(rows))
    asked = np.repeat(near[1:] | near[:-1], PARTS)
    some, points = np.append(asked, False) | np.append(False, asked), np.zeros((len(q), 3))
    points[some], _ = last_poses(robot, q[some])
    fast = np.where(asked, lengths(np.diff(points, axis=0)) / np.diff(times), 0.0)
    worst = int(np.argmax(fast))
    return float(fast[worst]), float(times[worst])


def stands(scene: Scene) -> bool:
    """Whether the approach is level, and a pushable without a stem stands in the scene."""
    if scene.target is None:
        return False
    steep = max(abs(float(axis @ scene.up)) for axis in scene.frame[1:])
    return steep < LEVEL and any(item.stem is None for item in scene.pushables)


def largest_speed(scene: Scene) -> float:
    """The largest speed for which push prediction holds in the scene [m/s]."""
    return BESIDE if stands(scene) else PUSHED


def too_fast(scene: Scene, speed: float | None) -> bool:
    """Whether a ``speed`` among pushables [m/s] is above that for which push prediction holds."""
    return speed is not None and speed > largest_speed(scene) * (1.0 + FASTER)


def _touching(scene: Scene, robot: Robot, q: FloatArray) -> BoolArray:
    """Whether any part of the body is near the first place of an object that stands, at ``q``."""
    objects, rest = distances.objects_of(scene.world)
    loose = np.flatnonzero(objects.role == distances.PUSHABLE)
    loose, near = loose[~scene.hangs[objects.rows[loose]]], np.zeros(len(q), dtype=bool)
    radius = np.array(robot.spheres.radius)
    for start in range(0, len(q), CONFIGURATIONS):
        spheres, part = centers(robot, q[start : start + CONFIGURATIONS]), slice(start, None)
        for k in loose:
            beside(objects, k, spheres, radius, near[part])
        for item in rest:
            if item.role == "pushable" and item.stem is None:
                for m, row in enumerate(spheres):
                    away = distances.nearest(item, row[None], radius, TOUCHED)[0]
                    near[start + m] |= away < TOUCHED
    return near


@called
def beside(objects, k, spheres, radius, near):
    """Set ``near`` where one of spheres (M, B, 3) is near object ``k``; ``radius`` (B,) [m]."""
    size, p = objects.size[k], objects.position
    for m in range(spheres.shape[0]):
        for b in range(radius.shape[0]):
            reach = radius[b] + TOUCHED
            if near[m] or distances.apart_by(spheres[m], b, p, k) > objects.bound[k] + reach:
                continue
            x, y, z = distances.inside(objects.rotation, p, k, spheres[m], b)
            if distances.to_surface(objects.kind[k], size[0], size[1], size[2], x, y, z) < reach:
                near[m] = True


@kernel
def mark(points, axes, places, reach, radius, behind, ahead, near):
    """Set ``near`` (M,) where the tool is near a fruit.

    ``points``, ``axes``: (M, 3) tool points [m] and tool axes. ``places``, ``reach``: (K, 3)
    centres of the fruits; (K,) distance to the tool's surface below which each is near [m].
    ``radius``, ``behind``, ``ahead``: of the tool, and its length on either side of the tool point
    [m]. ``near``: written in place.
    """
    for m in range(len(points)):
        for k in range(len(places)):
            along = squared = 0.0
            for i in range(3):
                off = places[k, i] - points[m, i]
                along += off * axes[m, i]
                squared += off * off
            aside = radius + reach[k]
            if (
                -behind - reach[k] < along < ahead + reach[k]
                and squared - along * along < aside * aside
            ):
                near[m] = True
                break
