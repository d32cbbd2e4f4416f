"""The goals of a scene, its way points and the constraints of its path, from their models."""

from __future__ import annotations

import numpy as np

from optipromp.core.errors import InvalidSceneError
from optipromp.core.scenes.constraints import HeldUpright, OnPlane, PathConstraints
from optipromp.core.scenes.goal_models import GoalModel, LinesModel, PathModel, ToleranceModel
from optipromp.core.scenes.goals import Goal, JointGoal, PoseGoal, RegionGoal
from optipromp.core.scenes.lines import LINE_WITHIN, Lines
from optipromp.core.scenes.pose import Pose


def goal_of(given: GoalModel, scale: float, frame: Pose) -> Goal:
    """The goal in the base frame."""
    if given.joints is not None:
        return JointGoal(np.array(given.joints))
    position = frame @ (scale * np.array(given.position))
    axis = frame.rotation @ np.array(given.axis) if given.axis else None
    if axis is not None and given.tolerance is None:
        return PoseGoal(position, axis)
    allowed = given.tolerance or ToleranceModel()
    within = None if allowed.position is None else scale * np.array(allowed.position)
    region = RegionGoal(
        scale * np.array(given.position),
        np.array(given.axis) if given.axis else None,
        None if given.orientation is None else np.array(given.orientation),
        float(within[0]) if within is not None and len(within) == 1 else within,
        allowed.angle,
        None if allowed.orientation is None else np.array(allowed.orientation),
    )
    return region if frame.is_identity else region.transformed(frame)


def lines_of(given: LinesModel | None, scale: float, frame: Pose) -> Lines | None:
    """The way points in the base frame."""
    if given is None:
        return None
    points = []
    for k, one in enumerate(given.points):
        try:
            pose = RegionGoal(
                scale * np.array(one.position),
                np.array(one.axis) if one.axis else None,
                None if one.orientation is None else np.array(one.orientation),
            )
        except InvalidSceneError as error:
            words = error.message.removeprefix("goal.")
            raise InvalidSceneError(f"waypoints[{k}].{words}") from None
        points.append(pose if frame.is_identity else pose.transformed(frame))
    within = LINE_WITHIN if given.within is None else scale * given.within
    return Lines(tuple(points), None if given.speed is None else scale * given.speed, within)


def path_of(
    given: PathModel | None, scale: float, frame: Pose, world: Pose
) -> PathConstraints | None:
    """The constraints of the path in the base frame; upright is by default up in the world."""
    if given is None:
        return None
    upright = plane = None
    if given.upright is not None:
        told, axis = given.upright, given.upright.axis
        up = world.rotation[:, 2]
        if told.direction is not None:
            up = frame.rotation @ np.array(told.direction)
        upright = HeldUpright(told.angle, np.array([0.0, 0.0, 1.0] if axis is None else axis), up)
    if given.plane is not None:
        point = frame @ (scale * np.array(given.plane.point))
        normal = frame.rotation @ np.array(given.plane.normal)
        plane = OnPlane(point, normal, scale * given.plane.within)
    return PathConstraints(upright, plane)
