"""The place of a robot's base before a generated scene, and the start of its motions.

The presets are stated for the built-in Panda. The base of another robot is placed where its tool
can best move from the start to the far ends of the box of targets.

For an arm that no place serves for all scenes, the base is placed before each scene. Candidates are
places at which the tool stands upright at the target: configurations sampled at random, whose tool
axis inverse kinematics turns to the approach. From each, the arm follows the way of the scene: down
to the camera point and the start, and aside of both ends by the radius of the cup. Where no
candidate fits, the generator draws another scene. Fruits keep their sizes; the working distances
(neck of the cup, camera point, start) shrink with the arm's reach.
"""

import functools
import itertools
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from optipromp.core.arrays import FloatArray, frozen
from optipromp.core.errors import InvalidRequestError
from optipromp.core.geometry.distances import distances
from optipromp.core.planning.options import Optimised
from optipromp.core.robots import ik
from optipromp.core.robots.kernels import PRISMATIC
from optipromp.core.robots.library import Choice, load_arm
from optipromp.core.robots.model import Robot, random_postures
from optipromp.core.robots.tools import make_tool, with_tool
from optipromp.core.scenes.pose import Pose
from optipromp.core.scenes.scene import Scene, ToolSpec, obstacles_of
from optipromp_sim.generate import bunches

# choices that weigh alike: to a joint limit [rad or m], between links [m], tool speed [m/rad]
MARGIN, ROOM, SPEED_RATIO = 0.3, 0.05, 0.2
LOW = bunches.BEFORE[1] + bunches.FRUIT_RADII[1]  # [m] from the target down to the lowest pushable
BESIDE = 0.1  # [m] from the tool's axis: pushables hang, and are pushed, within it: a choice
NECKS = 0.005  # [m] step of the length of a cup's neck: a choice
MISS = 1e-4  # [m] largest error of inverse kinematics on the way


def lowest(robot: Robot, q: FloatArray) -> FloatArray:
    """Heights (m,) of the tool point over any link beside the tool, in configurations (m, n) [m].

    These are the links before the last one, within :data:`BESIDE` of the tool axis. The height is
    along that axis.
    """
    points, axes = robot.tool_pose(q)
    off = (robot.sphere_centers(q) - points[:, None])[:, ~robot.spheres.distal]
    radius = robot.spheres.radius[~robot.spheres.distal]
    along = np.einsum("mbi,mi->mb", off, axes)
    aside = np.linalg.norm(off - along[:, :, None] * axes[:, None], axis=2)
    height = np.where(aside - radius < BESIDE, -along - radius, np.inf)
    return np.asarray(height.min(axis=1, initial=np.inf))


def spare(robot: Robot, q: FloatArray, low: float = LOW) -> FloatArray:
    """The least of four margins (m,) of each of the configurations (m, n).

    They are the distance to a joint limit over :data:`MARGIN`, the gap between links over ``ROOM``,
    the least singular value of the tool's Jacobian over ``SPEED_RATIO``, and :func:`lowest` over
    ``low`` [m].
    """
    margin = np.minimum(q - robot.lower, robot.upper - q).min(axis=1)
    jp, ja = robot.tool_jacobian(q)
    rates = np.linalg.svd(np.concatenate([jp, ik.AXIS_LENGTH * ja], axis=1), compute_uv=False)
    rate = rates[:, min(5, robot.n_joints) - 1]  # of a point and an axis
    room = robot.self_gaps(q).min(axis=1, initial=np.inf)
    margins = margin / MARGIN, room / ROOM, rate / SPEED_RATIO, lowest(robot, q) / low
    return np.asarray(np.min(margins, axis=0))


REACH = 0.855  # [m] of the Panda from its shoulder, published: the scenes are stated for it
SAMPLES = 40_000  # configurations, chosen: of an arm of six joints 1.4 % stand upright
UPRIGHT = 0.9  # [1] chosen: cosine from the approach of an axis that is turned to the approach
MOST = 1_500  # upright configurations, chosen
ACROSS = 0.1  # [1] chosen: cosine of the angle between two axes that are across each other
CELLS = 0.08  # [m] chosen: of an arm of the Panda's reach, between two places of its target
EACH = 4  # postures a cell, chosen: on different branches
BELOW = 0.03  # [m] chosen, for such an arm: of the start below the camera point
LEAST_DROP = 0.02  # [m] chosen: of a scene without a pushable below the target
ALONG = 0.02  # [m] chosen: between configurations along the way
LENGTHENED = 3  # times that a neck is made longer, chosen


class UnfitError(Exception):
    """A scene that the arm can work at from no place; ``requirement`` is what failed, in words."""

    def __init__(self, requirement: str, message: str) -> None:
        super().__init__(message)
        self.requirement = requirement


@dataclass(frozen=True, eq=False)
class Work:
    """The working distances of a scene for an arm, in the frame of the preset's base."""

    way: FloatArray  # tool points (P, 3), the target first [m]
    start: int  # index of the start in ``way``
    drop: float  # from the target down to the lowest pushable [m]
    camera: float  # distance of the camera point before the lowest fruit [m]
    scale: float  # of working distances

    @property
    def down(self) -> float:
        """From the target to the start [m]."""
        return float(np.linalg.norm(self.way[self.start] - self.way[0]))


NECK = "links below the fruits"


class Unfit(NamedTuple):
    """A requirement that a candidate fails; later ones are nearer to a fit, and so are less."""

    order: int
    lack: float
    requirement: str
    told: str


@functools.lru_cache(maxsize=16)
def reach_of(arm: Robot) -> float:
    """Largest distance of the flange from the first joint in sampled configurations [m]."""
    points = arm.tool_pose(random_postures(arm, SAMPLES))[0]
    return float(np.linalg.norm(points - arm.kinematics.translation[0], axis=1).max())


def _farthest(arm: Robot, axis: FloatArray) -> float:
    """How far the links at the flange reach along an ``axis`` (3,) beyond the flange [m]."""
    before = (arm.spheres.center - arm.flange_translation) @ axis + arm.spheres.radius
    return float(before[arm.spheres.distal].max(initial=0.0))


def mount_of(arm: Robot) -> tuple[tuple[float, ...], tuple[float, ...]] | None:
    """The mount that turns a tool to the last joint's axis, where the flange's z is across it.

    Position [m] and orientation, a quaternion w, x, y, z; None where z is not across the axis.
    """
    last, body = arm.kinematics.axis[-1], arm.spheres.center[arm.spheres.distal]
    ahead = float(np.vstack([body, arm.flange_translation]).mean(axis=0) @ last)
    axis, across = arm.flange_rotation.T @ last, np.array([0.0, 0.0, 1.0])
    axis = -axis if ahead < 0.0 else axis  # to the side on which the last link is
    if arm.kinematics.kind[-1] == PRISMATIC or abs(axis[2]) > ACROSS:
        return None
    turn = np.append(1.0 + axis[2], np.cross(across, axis))
    return (0.0, 0.0, 0.0), tuple((turn / np.linalg.norm(turn)).tolist())


def work_of(scene: Scene, arm: Robot) -> Work:
    """The working distances of a scene of the Panda for another arm."""
    target, (_, _, up) = scene.target, scene.frame
    assert target is not None
    assert scene.tool is not None
    scale = min(1.0, reach_of(arm) / REACH)
    heights = [float((item.position - target.position) @ up) for item in scene.pushables]
    extents = [item.radius for item in scene.pushables]
    drop = max(0.0, *(r - h for h, r in zip(heights, extents, strict=True)), 0.0)
    camera = scale * scene.approach.camera_distance
    before = target.position - (drop + camera) * up
    start = before - scale * BELOW * up
    corners, radius = [target.position, before, start, before], scene.tool.parameters["radius"]
    for turn in range(4):
        aside = radius * np.array([np.cos(0.5 * np.pi * turn), np.sin(0.5 * np.pi * turn), 0.0])
        corners += [before + aside, target.position + aside, before + aside, before]
    pieces = [target.position[None]]
    ends = [0]
    for a, b in itertools.pairwise(corners):
        count = max(1, int(np.ceil(np.linalg.norm(b - a) / ALONG)))
        pieces.append(a + np.arange(1, count + 1)[:, None] / count * (b - a))
        ends.append(ends[-1] + count)
    return Work(np.concatenate(pieces), ends[2], drop, camera, scale)


def fitted(scene: Scene, arm: Robot, named: str, choice: Choice) -> Scene:
    """The ``scene`` of the Panda before another arm, whose base is placed for this scene.

    The tool is turned by :func:`mount_of`; its neck is longer where links would reach fruits.

    ``scene``: of a preset. ``arm``: without a tool.
    """
    assert scene.tool is not None
    work, mount = work_of(scene, arm), mount_of(arm)
    own = {**scene.tool.parameters, **({} if mount is None else {"mount": mount})}
    axis = arm.flange_rotation @ make_tool(scene.tool.kind, own).rotation[:, 2]
    neck = max(work.scale * bunches.NECK, _farthest(arm, axis))
    lengthened = 0
    while True:
        neck = round(float(np.ceil(neck / NECKS - 1e-9)) * NECKS, 3)
        parameters = {**own, "length": neck}
        found = _best(scene, with_tool(arm, make_tool(scene.tool.kind, parameters)), work)
        if not isinstance(found, Unfit):
            break
        if found.requirement != NECK or lengthened == LENGTHENED:
            told = f"{arm.name} can work there from no place of its base: {found.told}"
            raise UnfitError(found.requirement, told)
        neck, lengthened = neck + found.lack, lengthened + 1
    pose, start = found
    moved = scene.transformed(pose)
    return replace(
        moved, robot=named, choice=choice, start=frozen(start),
        tool=ToolSpec(scene.tool.kind, parameters),
        approach=replace(moved.approach, camera_distance=work.camera),
    )  # fmt: skip


def _best(scene: Scene, robot: Robot, work: Work) -> tuple[Pose, FloatArray] | Unfit:
    """The best pose of the preset's base, and the configuration (n,) at the start there; what the
    candidate nearest to a fit fails, where none fits."""
    up, low = scene.frame[2], max(work.drop, LEAST_DROP)
    upright = _upright(robot, up, work.scale * CELLS, low)
    if isinstance(upright, Unfit):
        return upright
    best, fit, failed = -np.inf, None, list[Unfit]()
    axes = np.tile(up, (len(work.way), 1))
    lower, upper = robot.limits(Optimised.limit_margin)  # as plans keep
    inner = replace(robot, lower=lower, upper=upper)
    for point, begin in zip(*upright, strict=True):
        shift = point - work.way[0]
        near = np.clip(begin, inner.lower, inner.upper)
        q, errors = ik.track(inner, work.way + shift, axes, near)
        why = _failure(scene, robot, work, shift, q, errors)
        if why is not None:
            failed.append(why)
        elif (score := float(spare(robot, q, low).min())) > best:
            best, fit = score, (Pose(shift), q[work.start])
    return fit or min(failed, key=lambda each: (-each.order, each.lack))


def _failure(
    scene: Scene, robot: Robot, work: Work, shift: FloatArray, q: FloatArray, errors: FloatArray
) -> Unfit | None:
    """The first requirement that configurations (P, n) along the way fail."""
    whole = f"on the way of {1e3 * work.down:.0f} mm from the start to the target, and aside of it,"
    if (off := float(errors.max())) > MISS:
        told = f"{whole} the tool is off by {1e3 * off:.0f} mm at least"
        return Unfit(1, off, "way to the target", told)
    if (touch := -float(robot.self_gaps(q).min(initial=np.inf))) > 0.0:
        told = f"{whole} links overlap by {1e3 * touch:.0f} mm at least"
        return Unfit(2, touch, "room between links", told)
    solid = obstacles_of(scene, "static", "avoid")
    if len(solid.kind):
        spheres = robot.spheres
        centers = robot.sphere_centers(q) - shift
        away = distances(solid, centers.reshape(-1, 3))[0].min(axis=1).reshape(centers.shape[:2])
        gaps = away - spheres.radius
        least = float(gaps[work.start].min()), float(gaps[:, ~spheres.distal].min(initial=np.inf))
        if (entered := -min(least)) > 0.0:
            told = f"{whole} links enter obstacles by {1e3 * entered:.0f} mm at least"
            return Unfit(3, entered, "clearance from obstacles", told)
    if (above := work.drop - float(lowest(robot, q).min())) > 0.0:
        told = (
            f"links beside the tool reach {1e3 * above:.0f} mm above the lowest fruit, which hangs "
            f"{1e3 * work.drop:.0f} mm below the target"
        )
        return Unfit(4, above, NECK, told)
    return None


def _upright(
    robot: Robot, up: FloatArray, cell: float, low: float
) -> tuple[FloatArray, FloatArray] | Unfit:
    """Tool points (K, 3) at which the tool stands along ``up``, and configurations (K, n).

    Of each cell of distance and height, of edge ``cell`` [m], they are the :data:`EACH` with the
    most to spare, ``low`` as of :func:`spare`. Unfit if there are none.
    """
    q = random_postures(robot, SAMPLES)
    points, axes = robot.tool_pose(q)
    near = np.flatnonzero(axes @ up > UPRIGHT)[:MOST]
    points, q = points[near], q[near]
    direction = "direction of the tool"
    if not len(q):
        off = float(np.degrees(np.arccos(min(1.0, (axes @ up).max()))))
        told = f"the tool is {off:.0f} degrees off the approach at least (of {SAMPLES} postures)"
        return Unfit(0, off, direction, told)
    q, errors = ik.each(robot, points, np.tile(up, (len(q), 1)), q)
    upright = errors < MISS
    if not upright.any():
        told = f"the tool cannot stand along the approach (of {len(q)} postures within 26 degrees)"
        return Unfit(0, float(errors.min()), direction, told)
    gaps = robot.self_gaps(q).min(axis=1, initial=np.inf)
    good = upright & (gaps > 0.0)
    if not good.any():
        overlap = -float(gaps[upright].max())
        told = f"links overlap by {1e3 * overlap:.0f} mm at least where the tool is upright"
        return Unfit(0, overlap, "room between links", told)
    points, q = points[good], q[good]
    score = spare(robot, q, low)
    cells: dict[tuple[int, ...], list[int]] = {}
    for k in np.argsort(-score, kind="stable").tolist():
        x, y, z = points[k]
        cells.setdefault((int(np.hypot(x, y) // cell), int(z // cell)), []).append(k)
    rows = [k for members in cells.values() for k in members[:EACH]]
    return points[rows], q[rows]


PLACES_APART = 0.1  # [m] between the places that are tried for the base: a choice
NEAREST = 0.2  # [m] from the base's axis to the middle of the way, at least: a choice
BEYOND = 0.3  # [m] beyond the sum of the links up to which places are tried: a choice
YAWS = (0.0, 0.5 * np.pi, -0.5 * np.pi, np.pi)  # [rad] of the base; the first of equals is taken
IK_STARTS, BRANCHES = 24, 4  # of inverse kinematics; solutions followed at each place: choices


@dataclass(frozen=True, eq=False)
class Standpoint:
    """A place of a robot's base."""

    pose: Pose  # of the preset's base in the robot's base frame
    start: FloatArray  # (n,) configuration in which the motions start
    low: float  # height of the tool point over the links beside the tool, see :func:`lowest` [m]


def at_robot(scene: Scene, robot: str | Path, choice: Choice) -> Scene:
    """The ``scene`` of the Panda in the base frame of another robot; see :func:`place`.

    Where no one place serves all scenes, the base is placed for this scene
    (:func:`fitted`).
    """
    path = Path(robot).absolute() if Path(robot).suffix else robot
    arm = load_arm(path, choice=choice)[0]
    standing = _with_cup(arm)
    if standing is None:
        return fitted(scene, arm, str(path), choice)
    placed, length = standing
    assert scene.tool is not None  # every generated scene has one
    tool = ToolSpec(scene.tool.kind, {**scene.tool.parameters, "length": length})
    moved = scene.transformed(placed.pose)
    return replace(moved, robot=str(path), choice=choice, start=placed.start, tool=tool)


@functools.lru_cache(maxsize=16)
def _with_cup(arm: Robot) -> tuple[Standpoint, float] | None:
    """The placement of an arm, and the length of the cup's neck that it needs [m]; None: no place.

    With such a neck the cup is before all links at the flange (a gripper's fingers, for instance),
    and the other links stay below the lowest pushable.
    """
    length = max(bunches.NECK, float(np.ceil(_farthest(arm, arm.tool_axis) / NECKS) * NECKS))
    try:
        placed = _placed(arm, length)
        if placed.low < LOW:
            length += float(np.ceil((LOW - placed.low) / NECKS) * NECKS)
            placed = _placed(arm, length)
    except InvalidRequestError:
        return None
    return placed, round(length, 3)


def _placed(arm: Robot, length: float) -> Standpoint:
    cup = make_tool("cup", {"radius": bunches.GRIPPER_RADIUS[1], "height": 0.05, "length": length})
    return place(with_tool(arm, cup), bunches.way(), np.array([0.0, 0.0, 1.0]))


def place(robot: Robot, way: FloatArray, axis: FloatArray) -> Standpoint:
    """The best place from which a robot's tool can move along ``way``.

    Candidates are the places on a grid of :data:`PLACES_APART`, each with several branches of
    inverse kinematics. They are ranked by :func:`spare`; a candidate that collides with itself at
    the start is left out.

    ``way``: tool points (P, 3) from the start, in the frame of the preset's base [m]. ``axis``:
    (3,) tool axis at all of them.
    """
    middle = 0.5 * (way.min(axis=0) + way.max(axis=0))
    far = float(np.linalg.norm(robot.kinematics.translation, axis=1).sum()) + BEYOND
    best, found = -np.inf, None
    radii, heights = np.arange(NEAREST, far, PLACES_APART), np.arange(-far, far, PLACES_APART)
    for yaw, radius, height in itertools.product(YAWS, radii, heights):
        if np.hypot(radius, height) > far:
            continue
        turn = Pose(np.zeros(3), np.array([np.cos(0.5 * yaw), 0.0, 0.0, np.sin(0.5 * yaw)]))
        centre = np.array([radius * np.cos(yaw), radius * np.sin(yaw), height])
        pose = Pose(centre - turn @ middle, turn.orientation)
        line, axes = pose @ way, np.tile(turn @ axis, (len(way), 1))
        for begin in ik.solve(robot, line[0], axes[0], starts=IK_STARTS).joints[:BRANCHES]:
            q, errors = ik.track(robot, line, axes, _unwound(robot, begin))
            if errors.max() > MISS or robot.self_gaps(q[0]).min(initial=0.0) < 0.0:
                continue
            if (score := float(spare(robot, q).min())) > best:
                best, found = score, Standpoint(pose, frozen(q[0]), float(lowest(robot, q).min()))
    if found is None:
        raise InvalidRequestError(f"{robot.name}: no place of its base lets it reach the scenes")
    return found


def _unwound(robot: Robot, q: FloatArray) -> FloatArray:
    """``q`` (n,) with revolute joints within half a turn of home, where the limits allow it."""
    turns = 2.0 * np.pi * np.round((q - robot.home) / (2.0 * np.pi))
    turns[robot.kinematics.dof[robot.kinematics.kind == PRISMATIC]] = 0.0
    near = q - turns
    return np.where((near < robot.lower) | (near > robot.upper), q, near)
