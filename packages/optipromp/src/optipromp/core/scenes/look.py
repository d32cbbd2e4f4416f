"""Looks: what a detector saw at one moment; the door of every camera."""

import math
from dataclasses import dataclass
from typing import Annotated

from annotated_types import Ge, Gt, Le, Unit

from optipromp.core.errors import InvalidRequestError
from optipromp.core.scenes.objects import SceneObject
from optipromp.core.scenes.pose import Pose
from optipromp.core.values import Validated


@dataclass(frozen=True, eq=False)
class Look(Validated):
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
    view: Annotated[float, Gt(0.0), Le(3.15), Unit("rad")] = 1.2
    near: Annotated[float, Ge(0.0), Unit("m")] = 0.0
    far: Annotated[float, Gt(0.0), Unit("m or inf")] = math.inf

    def __post_init__(self) -> None:
        super().__post_init__()
        for item in self.detections:
            if item.covariance is None:
                raise InvalidRequestError(
                    f"detection {item.id} has no covariance: give covariance or sigma [m]"
                )
        if not self.near < self.far:
            raise InvalidRequestError(f"far is {self.far:g}: must be above near, {self.near:g} [m]")

    def in_base(self) -> tuple[SceneObject, ...]:
        """The detections in the robot's base frame."""
        return tuple(item.transformed(self.camera) for item in self.detections)
