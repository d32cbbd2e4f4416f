"""Way points of the tool before a goal, joined by straight lines."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from optipromp.core.arrays import FloatArray
from optipromp.core.errors import InvalidSceneError
from optipromp.core.scenes.goals import Goal, JointGoal, PoseGoal, RegionGoal
from optipromp.core.scenes.pose import Pose
from optipromp.core.scenes.values import limited

LINE_WITHIN = 5e-4  # [m] distance from the lines where the scene states none: a choice
_MOST_TURN = 179.0  # [degrees] a half turn between two way points could go either way
_LEAST = 1e-6  # [m, rad] a line that is shorter in both is none


@dataclass(frozen=True, eq=False)
class Lines:
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
    speed: float | None = None
    within: float = LINE_WITHIN

    def __post_init__(self) -> None:
        points = tuple(_region(point, f"waypoints[{k}]") for k, point in enumerate(self.points))
        for k, point in enumerate(points):
            if point.within is not None or point.angle is not None:
                raise InvalidSceneError(f"waypoints[{k}] has a tolerance: only the goal may")
        if not points:
            raise InvalidSceneError("waypoints has no entries: must have at least one")
        for name in ("speed", "within"):
            limited(f"waypoints.{name}", getattr(self, name))
        object.__setattr__(self, "points", points)

    def to(self, goal: Goal) -> tuple[RegionGoal, ...]:
        """The points and the ``goal``, which is a pose of the tool or a region of poses."""
        return *self.points, _region(goal, "goal")

    def transformed(self, pose: Pose) -> Lines:
        """The same lines in another frame, in which their frame has the ``pose``."""
        return replace(self, points=tuple(point.transformed(pose) for point in self.points))


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
