r"""The rules of the method: the neighbours, and the side on which the tool passes each of them.

Neighbours are the pushables before the target and near the approach line (method §4). The tool
passes each on the side away from its stem (method §5, constraints 1 and 2):
:math:`d_n\cdot(fk-X_n)\ge R_{gripper}` with a unit vector :math:`d_n` of the lateral plane. The
rule ``paper`` takes :math:`d_n=\pm y_g` with the sign of :math:`-y_g\cdot S_n`; ``lateral-plane``
takes :math:`d_n` against the lateral part of the stem. ``shortest`` takes, among the directions
well clear of the stem, the one that keeps the tool nearest to the approach line.

:func:`path_past` gives the path for such directions: at every height the point nearest to the
approach line that keeps its clearance from each pushable whose window contains the height.

I-ProMP pushes each neighbour to a position that its stem determines (method §4, 3 and 4): a fruit
on a stem of length L, inclined by θ0 in the push plane, swings by
:math:`\Delta\theta=\arcsin(R_{gripper}/L)-\theta_0`, a chord of
:math:`2L\sin(\Delta\theta/2)`, until it clears the gripper.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import islice, product
from typing import Literal, get_args

import numpy as np

from optipromp.core.arrays import FloatArray, rotation
from optipromp.core.compiled import inner, kernel
from optipromp.core.errors import InvalidRequestError
from optipromp.core.pushing.parameters import PUSH
from optipromp.core.robots.model import Robot
from optipromp.core.scenes.scene import Scene, SceneObject, rows_around

DriftRule = Literal["shortest", "lateral-plane", "paper"]
RULE = PUSH.rule


def neighbours(scene: Scene, gripper_radius: float) -> tuple[SceneObject, ...]:
    """Pushables before the target along z_g and near the approach line, first met first.

    They are within ``RULE.search_radius`` [m] of the target, and within D_plane of the approach
    line: ``RULE.plane_factor`` times ``gripper_radius`` [m], plus two standard deviations of the
    detected positions of target and pushable. A scene without a target has no neighbours.

    Returns:
        The neighbours by position along z_g; ties by distance from the target. A truss is met
        where it is cut, and its own fruits are below.
    """
    target = scene.target
    if target is None:
        return ()
    place, own = target.position, tuple[SceneObject, ...]()
    if scene.approach.truss:
        place, own = place + scene.approach.shift, scene.taken
    x_g, y_g, z_g = scene.frame
    found = []
    for obj in scene.objects_at(rows_around(scene, place, RULE.search_radius, "pushable")):
        off = obj.position - place
        along = float(off @ z_g)
        aside = math.hypot(off @ x_g, off @ y_g)
        distance = math.hypot(*off)
        doubt = math.sqrt(detection_variance(target) + detection_variance(obj))
        wide = RULE.plane_factor * gripper_radius + RULE.unsure * doubt
        if along < 0.0 and distance <= RULE.search_radius and aside <= wide and obj not in own:
            found.append((along, distance, obj.id, obj))
    return tuple(obj for *_, obj in sorted(found, key=lambda f: f[:3]))


def detection_variance(obj: SceneObject) -> float:
    """Mean variance of an object's detected position [m²]; 0 where the scene gives none."""
    return 0.0 if obj.covariance is None else float(np.trace(obj.covariance)) / 3.0


@dataclass(frozen=True, eq=False)
class Drift:
    """Directions in which the tool passes the neighbours of a plan.

    Attributes:
        ids: neighbours, first met first.
        centers: (N, 3) of the neighbours [m].
        directions: (N, 3) unit vectors of the lateral plane.
        windows: (N, 2) first and last height of the tool point in passing, along z_g from the
            centre [m].
    """

    ids: tuple[str, ...]
    centers: FloatArray
    directions: FloatArray
    windows: FloatArray


def stem_side(
    scene: Scene, obj: SceneObject, rule: DriftRule, gripper_radius: float
) -> FloatArray | None:
    """Direction (3,) away from the stem of ``obj``; None for a stem that decides no side."""
    if obj.stem is None:
        return None
    x_g, y_g, _ = scene.frame
    stem = obj.stem.vector
    least = np.sin(np.deg2rad(RULE.least_inclination)) * float(np.linalg.norm(stem))
    if rule == "paper":
        share = float(y_g @ stem)
        return None if abs(share) < least else np.asarray(-np.sign(share) * y_g)
    flat = (x_g @ stem) * x_g + (y_g @ stem) * y_g
    length = float(np.linalg.norm(flat))
    away = None if length < least else -flat / length
    if rule == "lateral-plane" or scene.target is None:
        return away
    off = scene.target.position - obj.position
    inwards = (x_g @ off) * x_g + (y_g @ off) * y_g
    distance = float(np.linalg.norm(inwards))
    if distance <= max(RULE.centred * gripper_radius, 1e-6):
        return away
    inwards = inwards / distance
    if away is None or length < np.sin(np.deg2rad(RULE.upright)) * float(np.linalg.norm(stem)):
        return np.asarray(inwards)
    return _towards(away, inwards, float(np.deg2rad(RULE.widest_turn)))


def _towards(start: FloatArray, goal: FloatArray, most: float) -> FloatArray:
    """The unit vector ``start``, turned by at most ``most`` [rad] towards ``goal``."""
    cosine = float(np.clip(start @ goal, -1.0, 1.0))
    if cosine >= np.cos(most):
        return goal
    across = goal - cosine * start
    length = float(np.linalg.norm(across))
    if length < 1e-9:
        return start
    return np.asarray(np.cos(most) * start + np.sin(most) * across / length)


def passing_windows(
    scene: Scene, objects: Sequence[SceneObject], directions: FloatArray, depth: float
) -> FloatArray:
    """The windows (N, 2) of :class:`Drift` for pushables passed in ``directions`` (N, 3) [m].

    The paper's window is the extent of the pushable along z_g. The rim, ``depth`` [m] above the
    tool point, decides whether a fruit ends inside the mouth, and must be aside before it reaches
    the pushable: the window begins lower by the depth. It ends with the paper's window, or earlier,
    as soon as the rim is safely past the centre, where the rim takes in the target or the next
    pushable asks for another direction.
    """
    if scene.target is None or not len(objects):
        return np.zeros((0, 2))
    up = scene.frame[2]
    radii = np.array([obj.radius for obj in objects])
    heights = np.array([obj.position for obj in objects]) @ up
    capture = float(scene.target.position @ up) - depth - scene.target.radius
    under = np.full(len(radii), RULE.under)
    windows = rim_windows(heights, radii, np.array(directions), depth, capture, under)
    return np.asarray(windows)


@kernel
def rim_windows(heights, radii, directions, depth, capture, under):
    """The ``rim`` windows (N, 2) of pushables at ``heights`` (N,) along z_g, first met first [m].

    At the height ``capture`` of the tool point the rim takes in the target. The rim must be aside
    from ``under`` (N,) below each pushable on. For the other arguments see :func:`passing_windows`.
    """
    count = len(heights)
    windows, lowest = np.empty((count, 2)), heights - depth - radii - under
    for i in range(count):
        turn = capture
        for k in range(i + 1, count):
            alike = 0.0
            for m in range(3):
                alike += directions[i, m] * directions[k, m]
            if alike < RULE.alike:
                turn = min(turn, lowest[k])
        released = -depth + RULE.release * radii[i]
        windows[i, 0] = lowest[i] - heights[i]
        windows[i, 1] = min(radii[i], max(turn - RULE.room_to_turn - heights[i], released))
    return windows


def drift_choices(
    scene: Scene, objects: Sequence[SceneObject], rule: DriftRule = "lateral-plane", *,
    depth: float = 0.0, gripper_radius: float = 0.0,
) -> tuple[Drift, ...]:  # fmt: skip
    """Every combination of sides on which the tool may pass ``objects``, at most eight.

    A stem that leans decides the side. With a vertical stem, or none, both sides along y_g are
    possible. The first choice stays nearest to the approach line. ``depth``: see
    :func:`passing_windows`. ``gripper_radius`` [m] is used by the rule ``shortest``.

    Raises:
        InvalidRequestError: an unknown rule.
    """
    if rule not in get_args(DriftRule):
        raise InvalidRequestError(f"drift is {rule!r}; use one of {', '.join(get_args(DriftRule))}")
    y_g = scene.frame[1]
    centers = np.array([obj.position for obj in objects]).reshape(-1, 3)
    options: list[list[FloatArray]] = []
    for obj in objects:
        side = stem_side(scene, obj, rule, gripper_radius)
        if side is not None:
            options.append([side])
            continue
        assert scene.target is not None  # objects are neighbours of a target
        first = y_g if y_g @ (scene.target.position - obj.position) >= 0.0 else -y_g
        options.append([first, -first])
    chosen = islice(product(*options), RULE.most_choices)
    return tuple(
        Drift(
            tuple(obj.id for obj in objects),
            centers,
            directions,
            passing_windows(scene, objects, directions, depth),
        )
        for directions in (np.array(sides).reshape(-1, 3) for sides in chosen)
    )


def rule_paths(
    scene: Scene, objects: Sequence[SceneObject], robot: Robot, camera: FloatArray,
    rule: DriftRule = "shortest",
) -> list[FloatArray]:  # fmt: skip
    """Corners (k, 3) of the paths from ``camera`` (3,) past neighbours, by choice of sides [m]."""
    assert scene.target is not None
    assert scene.aim is not None
    depth = 0.0 if robot.tool is None else robot.tool.depth
    offsets = robot.gripper_radius + PUSH.hanging.clearance * np.array([o.radius for o in objects])
    capture = max(depth + scene.target.radius, 0.0)
    return [
        path_past(
            drift.centers, drift.directions, drift.windows, offsets, np.array(scene.aim),
            np.array(scene.frame), np.array(camera), capture,
        )
        for drift in drift_choices(
            scene, objects, rule, depth=depth, gripper_radius=robot.gripper_radius
        )
    ]  # fmt: skip


@kernel
def path_past(centers, directions, windows, offsets, goal, frame, camera, capture):
    """Corners (k, 3) of the path from the camera point to the goal [m].

    ``centers``: (N, 3) of the neighbours; ``directions`` and ``windows`` as in :class:`Drift`.
    ``offsets``: (N,) lateral distances in which the tool passes the neighbours [m]. ``goal``: (3,)
    end of the path. ``frame``: (3, 3) rows x_g, y_g, z_g. ``camera``: (3,) beginning of the path.
    ``capture``: depth below the goal from which the path is on the approach line [m].
    """
    lateral, up, n = frame[:2], frame[2], len(centers)
    heights, flat, towards = np.zeros(n), np.zeros((n, 2)), np.zeros((n, 2))
    start, farthest = np.zeros(3), 0.0
    for m in range(3):
        for a in range(3):
            start[a] += (camera[m] - goal[m]) * frame[a, m]
        for k in range(n):
            heights[k] += (centers[k, m] - goal[m]) * up[m]
            for a in range(2):
                flat[k, a] += (centers[k, m] - goal[m]) * lateral[a, m]
                towards[k, a] += directions[k, m] * lateral[a, m]
    for k in range(n):
        x, y = flat[k, 0] + offsets[k] * towards[k, 0], flat[k, 1] + offsets[k] * towards[k, 1]
        farthest = max(farthest, math.sqrt(x * x + y * y))
    above = np.arange(max(0, math.ceil((-capture - start[2]) / RULE.level)))
    levels = start[2] + above * RULE.level
    local = np.zeros((2 * len(levels) + 3, 3))
    local[0] = start
    count = _corners(levels, windows, heights, flat, towards, offsets, farthest, local)
    local[count, 2] = max(start[2], -capture)
    corners = np.empty((count + 2, 3))
    for c in range(count + 2):
        for m in range(3):
            aside = local[c, 0] * lateral[0, m] + local[c, 1] * lateral[1, m]
            corners[c, m] = goal[m] + aside + local[c, 2] * up[m]
    return corners


@kernel
def _corners(levels, windows, heights, flat, directions, offsets, farthest, corners):
    """Append corners (k, 3) where windows begin and end, in place; returns their number.

    ``levels`` (L,) are the candidate heights of corners. ``heights`` (N,) and ``flat`` (N, 2) are
    the positions of the neighbours along the approach line and across it.
    """
    n = heights.shape[0]
    inside, before = np.zeros(n, dtype=np.bool_), np.zeros(n, dtype=np.bool_)
    p, last, has_last, count = np.zeros(2), np.zeros(2), False, 1
    for i in range(levels.shape[0]):
        some, same = False, True
        for k in range(n):
            above = levels[i] - heights[k]
            before[k] = inside[k]
            inside[k] = windows[k, 0] <= above <= windows[k, 1]
            some |= inside[k]
            same &= inside[k] == before[k]
        if not some:
            has_last = False
            continue
        if not (has_last and same):
            _aside(flat, directions, offsets, inside, farthest, p)
            apart = max(abs(p[0] - last[0]), abs(p[1] - last[1]))
            if not has_last or apart > 2e-6:  # [m]: not the same point
                last[0], last[1] = p[0], p[1]
                corners[count, 0], corners[count, 1], corners[count, 2] = p[0], p[1], levels[i]
                count += 1
                corners[count, 0], corners[count, 1] = p[0], p[1]
                count += 1
                has_last = True
        corners[count - 1, 2] = levels[i]  # the last level with this point
    return count


@inner
def _aside(flat, directions, offsets, active, farthest, p):
    """``p`` (2,) out: the point nearest to the approach line that is aside of all ``active`` (N,).

    By cyclic projection on the half-planes of the neighbours. The point is at most ``farthest``
    from the line: half-planes of opposite sides meet far away, and give way to a compromise.
    """
    p[0] = p[1] = 0.0
    for _ in range(RULE.sweeps):
        x, y = p[0], p[1]
        for k in range(flat.shape[0]):
            if not active[k]:
                continue
            dx, dy = directions[k, 0], directions[k, 1]
            short = offsets[k] - (dx * (p[0] - flat[k, 0]) + dy * (p[1] - flat[k, 1]))
            if short > 0.0:
                p[0] += short * dx
                p[1] += short * dy
                away = math.sqrt(p[0] * p[0] + p[1] * p[1])
                if away > farthest:
                    p[0] *= farthest / away
                    p[1] *= farthest / away
        if p[0] == x and p[1] == y:
            break


@dataclass(frozen=True, eq=False)
class Push:
    """One push: the neighbour ``id`` goes from ``position`` to ``pushed`` (3,) [m].

    ``direction`` is the unit tangent, ``swing`` the angle Δθ [rad]; 0 for a fruit that hangs clear.
    """

    id: str
    position: FloatArray
    pushed: FloatArray
    direction: FloatArray
    swing: float


def pushes(
    scene: Scene, objects: Sequence[SceneObject], gripper_radius: float,
    rng: np.random.Generator | None = None, direction_deviation: float = 0.0,
) -> tuple[Push, ...]:  # fmt: skip
    """The pushes of the neighbours, first met first.

    Args:
        scene: with a target, unless ``objects`` is empty.
        objects: neighbours in the order the tool meets them.
        gripper_radius: R_gripper [m].
        rng: samples the push directions.
        direction_deviation: standard deviation of the push direction about the approach [rad].

    Returns:
        A push of each neighbour along a candidate tangent: towards the next neighbour, the last
        neighbour away from the target.

    Raises:
        InvalidRequestError: neighbours in a scene without a target.
    """
    if not objects:
        return ()
    if scene.target is None:
        raise InvalidRequestError("pushes need a scene with a target: the last goes away from it")
    z_g = scene.frame[2]
    out = []
    for i, obj in enumerate(objects):
        if i + 1 < len(objects):
            wish = objects[i + 1].position - obj.position
        else:
            wish = obj.position - scene.target.position
        direction = max(_tangents(scene, obj), key=lambda line: abs(float(line @ wish)))
        if direction @ wish < 0.0:
            direction = -direction
        if rng is not None and direction_deviation > 0.0:
            direction = rotation(z_g, rng.normal(0.0, direction_deviation)) @ direction
        out.append(_push(scene, obj, direction, gripper_radius))
    return tuple(out)


def _tangents(scene: Scene, obj: SceneObject) -> tuple[FloatArray, FloatArray]:
    """The candidate push lines S × z and S × (S × z); y_g and x_g without a stem or its lean."""
    x_g, y_g, z_g = scene.frame
    if obj.stem is None:
        return y_g, x_g
    stem = obj.stem.vector / math.hypot(*obj.stem.vector)
    across = np.cross(stem, z_g)
    length = math.hypot(*across)
    if length < 1e-6:
        return y_g, x_g
    across = across / length
    return across, np.cross(stem, across)


def _push(scene: Scene, obj: SceneObject, direction: FloatArray, gripper_radius: float) -> Push:
    if obj.stem is None:
        return Push(obj.id, obj.position, obj.position + gripper_radius * direction, direction, 0.0)
    root = obj.stem.root
    arm = obj.position - root
    length = math.hypot(*arm)
    along = arm / length
    # across the stem: the direction may have been turned, or the stem be bent
    tangent = direction - (direction @ along) * along
    tangent = tangent / math.hypot(*tangent)
    z_g = scene.frame[2]
    level = tangent - (tangent @ z_g) * z_g
    flat = math.hypot(*level)
    inclined = math.atan2(arm @ (level / flat if flat > 1e-9 else tangent), -(arm @ z_g))
    swing = max(0.0, math.asin(min(1.0, gripper_radius / length)) - inclined)
    pushed = root + length * (math.cos(swing) * along + math.sin(swing) * tangent)
    return Push(obj.id, obj.position, pushed, tangent, swing)
