"""Goals of a scene without a target, way points, and what the tool keeps on its way to them.

A goal is a configuration, a pose of the tool, or a region of poses.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Annotated

import numpy as np
from annotated_types import Gt, Le, Unit
from pydantic import PlainValidator

from optipromp.core.arrays import FloatArray, frozen
from optipromp.core.errors import InvalidSceneError
from optipromp.core.robots.model import Robot
from optipromp.core.scenes.pose import Array, Direction, Framed, Length, Point, Pose, Turn
from optipromp.core.scenes.rotations import IDENTITY, from_quaternion
from optipromp.core.values import direction

WITHIN = 1e-3  # [m] distance of the tool point from a goal without a tolerance; method §5
ANGLE = 2.0  # [degrees] the same of the tool's axis or orientation; method §5


@dataclass(frozen=True, eq=False)
class JointGoal(Framed, label="goal."):
    """A goal in joint space: ``joints`` (n,) [rad or m].

    A joint without limits may end any number of full turns away. Joints are of no frame.
    """

    joints: Annotated[FloatArray, Array(None)]


@dataclass(frozen=True, eq=False)
class PoseGoal(Framed, label="goal."):
    """A goal for the tool, in the base frame; the roll about the tool axis is free.

    Args:
        position: (3,) of the tool point [m].
        axis: (3,) of the tool axis; of any length above 0.
    """

    position: Point
    axis: Direction


@dataclass(frozen=True, eq=False)
class RegionGoal(Framed, label="goal."):
    """A goal for the tool, in the base frame: a region of tool points and of orientations.

    The tool's frame has its origin at the tool point and its z axis along the tool axis; its y axis
    is the direction in which fingers open. Without axis and orientation, the tool may point
    anywhere.

    Args:
        position: (3,) of the tool point [m].
        axis: (3,) of the tool axis, of any length above 0; the roll about it is free.
        orientation: of the tool's frame, in place of ``axis``: quaternion (4,) ``w, x, y, z``, or
            rotation matrix (3, 3).
        within: largest distance of the tool point from ``position`` [m], or half extents (3,) of a
            box about ``position`` [m]; None: :data:`WITHIN`.
        angle: largest angle off axis or orientation [degrees]; None: :data:`ANGLE`.
        box: orientation of the box, as ``orientation``; None: that of the tool at the goal, and
            without one the base frame's.

    Raises:
        InvalidSceneError: a value is out of range, or axis and orientation are both given.
    """

    position: Point
    axis: Direction | None = None
    orientation: Turn | None = None
    within: float | FloatArray | None = None
    angle: Annotated[float | None, Gt(0.0), Le(180.0), Unit("degrees")] = None
    box: Turn | None = None

    def __post_init__(self) -> None:
        if self.axis is not None and self.orientation is not None:
            raise InvalidSceneError("goal has axis and orientation: must have one of them at most")
        if self.angle is not None and self.axis is None and self.orientation is None:
            raise InvalidSceneError(
                f"goal.tolerance.angle is {self.angle:g}: goes with an axis or an orientation"
            )
        sizes = np.atleast_1d(np.array(WITHIN if self.within is None else self.within, dtype=float))
        if sizes.shape not in ((1,), (3,)) or not (np.isfinite(sizes) & (sizes > 0.0)).all():
            raise InvalidSceneError(
                f"goal.tolerance.position is {np.squeeze(sizes).tolist()}: must be a distance "
                "above 0 [m] or three half extents [x, y, z]"
            )
        if self.box is not None and len(sizes) == 1:
            raise InvalidSceneError("goal.tolerance.orientation: goes with half extents [x, y, z]")
        super().__post_init__()
        if len(sizes) == 3:
            object.__setattr__(self, "within", frozen(sizes))

    @property
    def rotation(self) -> FloatArray | None:
        """(3, 3) of the tool's frame, whose columns are its axes; None without an orientation."""
        return None if self.orientation is None else from_quaternion(self.orientation)

    @property
    def direction(self) -> FloatArray | None:
        """(3,) of the tool axis; None where the tool may point anywhere."""
        turned = self.rotation
        return self.axis if turned is None else frozen(turned[:, 2])

    @property
    def extents(self) -> tuple[FloatArray, FloatArray] | None:
        """Half extents (3,) [m] and axes (3, 3), in columns, of the box; None: a ball."""
        if not isinstance(self.within, np.ndarray):
            return None
        given = self.orientation if self.box is None else self.box
        return self.within, from_quaternion(IDENTITY if given is None else given)

    @property
    def radius(self) -> float:
        """Radius of the ball [m], or half the diagonal of the box."""
        within = WITHIN if self.within is None else self.within
        return float(within) if isinstance(within, int | float) else math.hypot(*within)

    @property
    def tilt(self) -> float:
        """Largest angle off axis or orientation [rad]."""
        return math.radians(ANGLE if self.angle is None else self.angle)

    def transformed(self, pose: Pose) -> RegionGoal:
        """The same goal in another frame, in which its present frame has the ``pose``."""
        along = self.box is None and self.orientation is None  # the box is along the frame's axes
        if along and isinstance(self.within, np.ndarray):
            return replace(self, box=IDENTITY).transformed(pose)
        return super().transformed(pose)


Goal = JointGoal | PoseGoal | RegionGoal  # a goal of a scene without a target


UP = frozen([0.0, 0.0, 1.0])
_MOST_LEAN = 90.0  # [degrees] a wider cone keeps nothing upright


@dataclass(frozen=True, eq=False)
class HeldUpright(Framed, label="path.upright."):
    """An axis of the tool stays within an angle of a direction, as that of a full cup.

    Args:
        angle: largest angle between both [degrees].
        axis: (3,) in the tool's frame (:class:`optipromp.core.scenes.goals.RegionGoal`); z is the
            tool axis.
        direction: (3,) in the base frame.
    """

    angle: Annotated[float, Gt(0.0), Le(_MOST_LEAN), Unit("degrees")]
    axis: Annotated[FloatArray, PlainValidator(direction)] = field(default_factory=lambda: UP)
    direction: Direction = field(default_factory=lambda: UP)


@dataclass(frozen=True, eq=False)
class OnPlane(Framed, label="path.plane."):
    """The tool point stays near a plane.

    Args:
        point: (3,) of the plane, in the base frame [m].
        normal: (3,) of the plane, in the base frame.
        within: largest distance of the tool point from the plane [m].
    """

    point: Point
    normal: Direction
    within: Length


@dataclass(frozen=True, eq=False)
class PathConstraints(Framed):
    """What the tool keeps from the start to the goal; None: nothing of the kind."""

    upright: HeldUpright | None = None
    plane: OnPlane | None = None


LINE_WITHIN = 5e-4  # [m] distance from the lines where the scene states none: a choice
_MOST_TURN = 179.0  # [degrees] a half turn between two way points could go either way
_LEAST = 1e-6  # [m, rad] a line that is shorter in both is none


@dataclass(frozen=True, eq=False)
class Lines(Framed, label="waypoints."):
    """The tool goes freely to the first point, then along straight lines to the goal.

    The orientation turns evenly with the way along a line, about one axis. Where the lines meet,
    the tool stops.

    Args:
        points: poses of the tool before the goal, without tolerances; a :class:`PoseGoal` is taken
            for the :class:`RegionGoal` with its axis.
        speed: largest speed of the tool point on the lines [m/s]; None: as fast as the joints may.
        within: largest distance of the tool point from the lines [m].

    Raises:
        InvalidSceneError: no points, a point with tolerances, a speed or distance that is not
            above 0.
    """

    points: tuple[RegionGoal, ...]
    speed: Annotated[float | None, Gt(0.0), Unit("m/s")] = None
    within: Length = LINE_WITHIN

    def __post_init__(self) -> None:
        points = tuple(_region(point, f"waypoints[{k}]") for k, point in enumerate(self.points))
        for k, point in enumerate(points):
            if point.within is not None or point.angle is not None:
                raise InvalidSceneError(f"waypoints[{k}] has a tolerance: only the goal may")
        if not points:
            raise InvalidSceneError("waypoints has no entries: must have at least one")
        object.__setattr__(self, "points", points)
        super().__post_init__()

    def to(self, goal: Goal) -> tuple[RegionGoal, ...]:
        """The points and the ``goal``, which is a pose of the tool or a region of poses."""
        return *self.points, _region(goal, "goal")


def _region(pose: object, name: str) -> RegionGoal:
    """A pose as a region; ``name`` begins the refusal of anything else."""
    if isinstance(pose, PoseGoal):
        return RegionGoal(pose.position, pose.axis)
    if not isinstance(pose, RegionGoal):
        raise InvalidSceneError(f"{name} is a {type(pose).__name__}: must be a pose of the tool")
    return pose


def pose_name(k: int, points: int) -> str:
    """The name in messages of pose ``k`` of way points, of which there are ``points``, and goal."""
    return "the goal" if k >= points else f"waypoints[{k}]"


def axes_of(pose: RegionGoal) -> FloatArray:
    """Directions (A, 3) that a pose states: the tool axis, or all axes of the tool's frame.

    A is 1, 3, or 0 where the tool may point anywhere.
    """
    turned = pose.rotation
    if turned is not None:
        return np.asarray(turned.T)
    return np.zeros((0, 3)) if pose.axis is None else pose.axis[None]


def check_lines(lines: Lines, goals: tuple[Goal, ...]) -> None:
    """Refuse lines that do not lead to one goal, or that do not tell how the tool turns."""
    if len(goals) != 1 or isinstance(goals[0], JointGoal):
        has = "joints" if len(goals) == 1 else f"{len(goals)} entries" if goals else ""
        told = f"goal has {has}" if has else "the scene has no goal"
        raise InvalidSceneError(f"{told}: waypoints go with one goal of the tool, with position")
    kinds = {0: "axis: free", 1: "axis", 3: "orientation"}
    poses, count = lines.to(goals[0]), len(lines.points)
    for k, (a, b) in enumerate(pairwise(poses)):
        one, other = (pose_name(i, count) for i in (k, k + 1))
        u, v = axes_of(a), axes_of(b)
        if len(u) != len(v):
            raise InvalidSceneError(
                f"{one} has {kinds[len(u)]} and {other} {kinds[len(v)]}: must be alike, as the "
                "tool turns evenly from one to the other"
            )
        turn = turn_between(u, v)
        if turn > math.radians(_MOST_TURN):
            raise InvalidSceneError(
                f"the tool turns by {math.degrees(turn):.0f} degrees from {one} to {other}: must "
                f"be less than {_MOST_TURN:g}; put a way point between"
            )
        if math.dist(a.position, b.position) < _LEAST and turn < _LEAST:
            raise InvalidSceneError(f"{other} is where {one} is: must be another pose")


def turn_between(a: FloatArray, b: FloatArray) -> float:
    """Angle of the rotation that takes directions ``a`` (A, 3) to ``b`` (A, 3) [rad].

    The chord of A unit vectors that turn by θ is 2 sin(θ/2), or √2 of that for a whole frame.
    """
    if not len(a):
        return 0.0
    chord = float(np.linalg.norm(a - b)) / (2.0 if len(a) == 1 else 2.0 * math.sqrt(2.0))
    return 2.0 * math.asin(min(1.0, chord))


def at_goal(robot: Robot, goal: Goal, q: FloatArray) -> bool:
    """Whether configuration ``q`` (n,) is at a goal, within its tolerances."""
    if isinstance(goal, JointGoal):
        return bool(np.max(np.abs(robot.turns.missed(q, goal.joints))) < WITHIN)
    point, axis = robot.tool_pose(q)
    if isinstance(goal, PoseGoal):
        near = np.linalg.norm(point - goal.position) < WITHIN
        return bool(near and axis @ goal.axis > math.cos(math.radians(ANGLE)))
    off, box = point - goal.position, goal.extents
    inside = math.hypot(*off) < goal.radius
    if box is not None:
        inside = bool((np.abs(off @ box[1]) < box[0]).all())
    if goal.rotation is not None:
        turn = robot.segment_frames(q)[1][-1] @ robot.tool_rotation
        cosine = 0.5 * (float(np.sum(turn * goal.rotation)) - 1.0)
    else:
        cosine = 1.0 if goal.axis is None else float(axis @ goal.axis)
    return inside and cosine > math.cos(goal.tilt)


def reached(robot: Robot, goals: tuple[Goal, ...], q: FloatArray) -> int | None:
    """The index of the first goal that configuration ``q`` (n,) is at; None: it is at none."""
    return next((k for k, goal in enumerate(goals) if at_goal(robot, goal, q)), None)
