"""Where a robot stands before a generated scene, and where its motions start.

The presets are stated for the built-in Panda. The base of another robot is moved about them until
its tool can go from the start to the far ends of the targets' box, with room to spare.
"""

import functools
import itertools
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from optipromp.core.arrays import FloatArray, frozen
from optipromp.core.errors import InvalidRequestError
from optipromp.core.robots import ik
from optipromp.core.robots.kernels import PRISMATIC
from optipromp.core.robots.library import Choice, load_arm
from optipromp.core.robots.model import Robot
from optipromp.core.robots.tools import make_tool, with_tool
from optipromp.core.scenes.pose import Pose
from optipromp.core.scenes.scene import Scene, ToolSpec
from optipromp.laboratory.generate import bunches

PLACES_APART = 0.1  # [m] chosen: between places tried for the base
NEAREST, BEYOND = 0.2, 0.3  # [m] chosen: from the base's axis to the way; arm's length and tool
YAWS = (0.0, 0.5 * np.pi, -0.5 * np.pi, np.pi)  # [rad] tried, the first that is best
IK_STARTS, BRANCHES = 24, 4  # of inverse kinematics; solutions followed at each place
MARGIN, ROOM, SPEED_RATIO = (
    0.3,
    0.05,
    0.2,
)  # [rad or m], [m], [m/rad] chosen: as good as one another
LOW = bunches.BEFORE[1] + bunches.FRUIT_RADII[1]  # [m] of the lowest pushable below the target
BESIDE = 0.1  # [m] from the tool's axis, chosen: where pushables hang, and are pushed to
NECKS = 0.005  # [m] steps in the length of a cup's neck
MISS = 1e-4  # [m] an error of inverse kinematics above it is a miss


@dataclass(frozen=True, eq=False)
class Standpoint:
    """``pose``: of the preset's base in the robot's base frame; ``start`` (n,) of its motions.

    ``low`` [m]: how far the links but the last stay below the tool point, beside the tool.
    """

    pose: Pose
    start: FloatArray
    low: float


def at_robot(scene: Scene, robot: str | Path, choice: Choice) -> Scene:
    """``scene``, which is stated for the Panda, before another robot; see :func:`place`."""
    path = Path(robot).absolute() if Path(robot).suffix else robot
    placed, length = _with_cup(load_arm(path, choice=choice)[0])
    assert scene.tool is not None  # every generated scene has one
    tool = ToolSpec(scene.tool.kind, {**scene.tool.parameters, "length": length})
    moved = scene.transformed(placed.pose)
    return replace(moved, robot=str(path), choice=choice, start=placed.start, tool=tool)


@functools.lru_cache(maxsize=16)
def _with_cup(arm: Robot) -> tuple[Standpoint, float]:
    """The placement of an arm, and the length of the cup's neck that it needs [m].

    The neck is so long that the cup stands before the links at the flange, a gripper's fingers for
    one, and that the other links stay below the lowest pushable.
    """
    at_flange, spheres = arm.spheres.distal, arm.spheres
    before = (spheres.center - arm.flange_translation) @ arm.tool_axis + spheres.radius
    farthest = float(before[at_flange].max(initial=0.0))
    length = max(bunches.NECK, float(np.ceil(farthest / NECKS) * NECKS))
    placed = _placed(arm, length)
    if placed.low < LOW:
        length += float(np.ceil((LOW - placed.low) / NECKS) * NECKS)
        placed = _placed(arm, length)
    return placed, round(length, 3)


def _placed(arm: Robot, length: float) -> Standpoint:
    cup = make_tool("cup", {"radius": bunches.GRIPPER_RADIUS[1], "height": 0.05, "length": length})
    return place(with_tool(arm, cup), bunches.way(), np.array([0.0, 0.0, 1.0]))


def place(robot: Robot, way: FloatArray, axis: FloatArray) -> Standpoint:
    """The place from which a robot's tool can go along ``way``.

    Places on a grid of :data:`PLACES_APART` about the base, and the branches of inverse kinematics
    there, are ranked by :func:`spare`; where the robot would touch itself at the start, it does not
    stand.

    Args:
        robot: with its tool.
        way: points (P, 3) of the tool in the frame of the preset's base [m], from its start.
        axis: (3,) of the tool, all along.

    Raises:
        InvalidRequestError: the robot can follow the way from no place.
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
            if (score := spare(robot, q)) > best:
                best, found = score, Standpoint(pose, frozen(q[0]), lowest(robot, q))
    if found is None:
        raise InvalidRequestError(f"{robot.name}: no place of its base lets it reach the scenes")
    return found


def lowest(robot: Robot, q: FloatArray) -> float:
    """How far links but the last and the tool stay below the tool point, :data:`BESIDE` its axis.

    Least of configurations (m, n) [m].
    """
    points, axes = robot.tool_pose(q)
    off = (robot.sphere_centers(q) - points[:, None])[:, ~robot.spheres.distal]
    radius = robot.spheres.radius[~robot.spheres.distal]
    along = np.einsum("mbi,mi->mb", off, axes)
    aside = np.linalg.norm(off - along[:, :, None] * axes[:, None], axis=2)
    return float(np.where(aside - radius < BESIDE, -along - radius, np.inf).min())


def _unwound(robot: Robot, q: FloatArray) -> FloatArray:
    """``q`` (n,) with its turning joints within half a turn of home, where the limits allow it."""
    turns = 2.0 * np.pi * np.round((q - robot.home) / (2.0 * np.pi))
    turns[robot.kinematics.dof[robot.kinematics.kind == PRISMATIC]] = 0.0
    near = q - turns
    return np.where((near < robot.lower) | (near > robot.upper), q, near)


def spare(robot: Robot, q: FloatArray) -> float:
    """The least room of configurations (m, n), of four kinds.

    To the limits, between links, to singularities, and of the arm below the tool: each over what is
    as good of it, :data:`MARGIN`, ROOM, SPEED_RATIO and LOW.
    """
    margin = float(np.minimum(q - robot.lower, robot.upper - q).min())
    jp, ja = robot.tool_jacobian(q)
    rates = np.linalg.svd(np.concatenate([jp, ik.AXIS_LENGTH * ja], axis=1), compute_uv=False)
    rate = float(rates[:, min(5, robot.n_joints) - 1].min())  # of a point and an axis
    room = float(robot.self_gaps(q).min(initial=np.inf))
    return min(margin / MARGIN, room / ROOM, rate / SPEED_RATIO, lowest(robot, q) / LOW)
