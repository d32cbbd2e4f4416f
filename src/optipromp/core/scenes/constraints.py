"""What the tool must keep on its whole way to a goal in free space."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from optipromp.core.arrays import FloatArray
from optipromp.core.errors import InvalidSceneError
from optipromp.core.scenes.pose import Pose
from optipromp.core.scenes.values import array, unit

_MOST_ANGLE = 90.0  # [degrees] a wider cone keeps nothing upright


def _z() -> FloatArray:
    return np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, eq=False)
class HeldUpright:
    """An axis of the tool stays within an angle of a direction, as that of a full cup.

    Args:
        angle: largest angle between both [degrees].
        axis: (3,) in the tool's frame (:class:`optipromp.core.scenes.goals.RegionGoal`); z is the
            tool axis.
        direction: (3,) in the base frame.
    """

    angle: float
    axis: FloatArray = field(default_factory=_z)
    direction: FloatArray = field(default_factory=_z)

    def __post_init__(self) -> None:
        if not 0.0 < self.angle <= _MOST_ANGLE:
            raise InvalidSceneError(
                f"path.upright.angle is {self.angle:g}: must be above 0 and at most "
                f"{_MOST_ANGLE:g} [degrees]"
            )
        object.__setattr__(self, "axis", unit("path.upright.axis", self.axis))
        object.__setattr__(self, "direction", unit("path.upright.direction", self.direction))


@dataclass(frozen=True, eq=False)
class OnPlane:
    """The tool point stays near a plane.

    Args:
        point: (3,) of the plane, in the base frame [m].
        normal: (3,) of the plane, in the base frame.
        within: largest distance of the tool point from the plane [m].
    """

    point: FloatArray
    normal: FloatArray
    within: float

    def __post_init__(self) -> None:
        if not 0.0 < self.within < math.inf:
            raise InvalidSceneError(f"path.plane.within is {self.within:g}: must be above 0 [m]")
        object.__setattr__(self, "point", array("path.plane.point", self.point, 3))
        object.__setattr__(self, "normal", unit("path.plane.normal", self.normal))


@dataclass(frozen=True, eq=False)
class PathConstraints:
    """What the tool keeps from the start to the goal; None: nothing of the kind."""

    upright: HeldUpright | None = None
    plane: OnPlane | None = None

    def transformed(self, pose: Pose) -> PathConstraints:
        """The same constraints in another frame, in which their frame has the ``pose``."""
        upright, plane = self.upright, self.plane
        if upright is not None:
            upright = replace(upright, direction=pose.rotation @ upright.direction)
        if plane is not None:
            normal = pose.rotation @ plane.normal
            plane = OnPlane(pose @ plane.point, normal, plane.within)
        return PathConstraints(upright, plane)
