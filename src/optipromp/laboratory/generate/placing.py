"""The place of a robot's base before a generated scene, and the start of its motions.

The presets are stated for the built-in Panda. The base of another robot is placed where its tool
can best move from the start to the far ends of the box of targets.
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
from optipromp.laboratory.generate.fitting import fitted
from optipromp.laboratory.generate.spare import LOW, MISS, NECKS, lowest, spare

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
    (:func:`optipromp.laboratory.generate.fitting.fitted`).
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
    at_flange, spheres = arm.spheres.distal, arm.spheres
    before = (spheres.center - arm.flange_translation) @ arm.tool_axis + spheres.radius
    farthest = float(before[at_flange].max(initial=0.0))
    length = max(bunches.NECK, float(np.ceil(farthest / NECKS) * NECKS))
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

    ``robot``: with its tool. ``way``: tool points (P, 3) from the start, in the frame of the
    preset's base [m]. ``axis``: (3,) tool axis at all of them.
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
