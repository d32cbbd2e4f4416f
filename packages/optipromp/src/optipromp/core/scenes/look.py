"""Looks: what a detector saw at one moment; the door of every camera."""

import math
from dataclasses import dataclass

from optipromp.core.errors import InvalidRequestError
from optipromp.core.scenes.objects import SceneObject
from optipromp.core.scenes.pose import Pose


@dataclass(frozen=True, eq=False)
class Look:
    """The detections of one picture.

    A detection is a :class:`SceneObject` in the frame of the camera, whose z axis points forward,
    with the covariance of its position. Its role is what the detector takes the object for. Its id
    is the detector's own, and need not mean the same object in another look. A fruit whose stem was
    not seen has none.

    Attributes:
        time: of the exposure, by the clock of the controller [s].
        camera: pose of the camera in the robot's base frame at that time.
        detections: all objects that were found, static ones left out.
        view: full opening angle of the camera's cone of view [rad]; an object outside the cone is
            not missed.
        near: distance from the camera below which it measures nothing [m]; 0: not known.
        far: distance from the camera above which it measures nothing [m]; infinite: not known.

    Raises:
        InvalidRequestError: a detection without a covariance, an angle outside 0 to pi, or limits
            that are negative, not a number, or leave no distance between them.
    """

    time: float
    camera: Pose
    detections: tuple[SceneObject, ...]
    view: float = 1.2
    near: float = 0.0
    far: float = math.inf

    def __post_init__(self) -> None:
        for item in self.detections:
            if item.covariance is None:
                raise InvalidRequestError(
                    f"detection {item.id} has no covariance: give covariance or sigma [m]"
                )
        if not 0.0 < self.view <= 3.15:
            raise InvalidRequestError(f"view is {self.view:g}; must be above 0, at most pi [rad]")
        if not 0.0 <= self.near < self.far:
            raise InvalidRequestError(
                f"near is {self.near:g} and far is {self.far:g}; near must not be negative, and "
                "far above it [m]"
            )

    def in_base(self) -> tuple[SceneObject, ...]:
        """The detections in the robot's base frame."""
        return tuple(item.transformed(self.camera) for item in self.detections)
