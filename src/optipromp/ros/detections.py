"""Looks of a camera as ``vision_msgs/Detection3DArray``."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import cast, get_args

import numpy as np

from optipromp.control.look import Look
from optipromp.core.arrays import FloatArray
from optipromp.core.errors import InvalidRequestError
from optipromp.core.geometry.shapes import Ellipsoid, Shape, Sphere
from optipromp.core.parameters import Checked, parameter
from optipromp.core.scenes.objects import Role, SceneObject, Stem
from optipromp.core.scenes.pose import Pose
from optipromp.ros.live import in_base
from optipromp.ros.scenes import read_pose, vector
from optipromp.ros.trajectories import NANO, nanoseconds
from optipromp.ros.types import Message

DETECTIONS = "vision_msgs/msg/Detection3DArray"
ROUND = 1.2  # [1] longest over shortest side of the box of a ball: a choice


@dataclass(frozen=True)
class DetectionParameters(Checked):
    """What the classes of a detector mean, and what its messages do not tell.

    Raises:
        InvalidRequestError: a role that is no fruit's, or a class of ``stems`` without a role.
    """

    roles: Mapping[str, str] = parameter(
        {"ripe": "target", "unripe": "pushable"},
        "",
        "choice",
        "target, pushable or avoid, by class; detections of other classes are left out",
    )
    stems: tuple[str, ...] = parameter(
        (), "", "choice", "classes whose box has its z axis along the stem, fruit to root"
    )
    stem_length: float = parameter(0.15, "m", "guess", "of these stems")
    sigma: float = parameter(
        0.005, "m", "choice", "standard deviation of a coordinate where the covariance is zero"
    )
    least_score: float = parameter(0.0, "1", "choice", "detections with a lower score are left out")
    view: float = parameter(1.2, "rad", "choice", "full opening angle of the camera's cone of view")

    def __post_init__(self) -> None:
        super().__post_init__()
        for name, role in self.roles.items():
            if role not in get_args(Role) or role == "static":
                raise InvalidRequestError(
                    f"role of class {name!r} is {role!r}: must be target, pushable or avoid"
                )
        for name in self.stems:
            if name not in self.roles:
                raise InvalidRequestError(
                    f"class {name!r} has stems and no role: must be one of {', '.join(self.roles)}"
                )


def read_detections(
    item: Message,
    frames: Mapping[str, Pose],
    parameters: DetectionParameters | None = None,
    *,
    time: float | None = None,
) -> Look:
    """The look of a ``vision_msgs/Detection3DArray``.

    Read of each detection are the class of its best hypothesis with the covariance of the
    position, the pose and the size of its box, and its id. A box whose sides are nearly equal is a
    ball, another an ellipsoid.

    Args:
        item: the message; ``header.frame_id`` is the frame of the camera, z forward.
        frames: poses of frames in the robot's base frame at the time of the exposure, by name.
        parameters: see :class:`DetectionParameters`.
        time: of the exposure [s]; None: ``header.stamp`` in seconds.

    Raises:
        InvalidRequestError: an unknown frame, or a detection in another frame; another type.
        InvalidSceneError: a wrong value; the message names the detection.
    """
    if item.__msgtype__ != DETECTIONS:
        raise InvalidRequestError(f"a {item.__msgtype__} is no look: must be a {DETECTIONS}")
    given = parameters or DetectionParameters()
    camera = in_base(item.header, frames)
    found = []
    for k, one in enumerate(item.detections):
        frame = one.header.frame_id
        if frame not in ("", item.header.frame_id):
            raise InvalidRequestError(
                f"detections[{k}].header.frame_id is {frame!r}: must be that of all, "
                f"{item.header.frame_id!r}"
            )
        read = _read(one, k, given)
        if read is not None:
            found.append(read)
    at = nanoseconds(item.header.stamp) / NANO if time is None else time
    return Look(at, camera, tuple(found), given.view)


def _read(one: Message, k: int, given: DetectionParameters) -> SceneObject | None:
    best = max(one.results, key=lambda result: float(result.hypothesis.score), default=None)
    if best is None or best.hypothesis.score < given.least_score:
        return None
    name = best.hypothesis.class_id
    role = given.roles.get(name)
    if role is None:
        return None
    pose = read_pose(one.bbox.center)
    covariance = np.array(best.pose.covariance, dtype=np.float64)
    if covariance.size != 36:
        raise InvalidRequestError(f"detections[{k}] has a covariance of {covariance.size}, not 36")
    covariance = covariance.reshape(6, 6)[:3, :3]
    if not covariance.any():
        covariance = given.sigma**2 * np.eye(3)
    stem = None
    if name in given.stems:
        stem = Stem.along(pose.position, pose.rotation[:, 2], given.stem_length)
    shape = _shape(vector(one.bbox.size), k)
    name, place = one.id or f"detection{k}", (pose.position, pose.orientation)
    return SceneObject(name, cast(Role, role), shape, *place, stem=stem, covariance=covariance)


def _shape(size: FloatArray, k: int) -> Shape:
    if not (np.isfinite(size).all() and size.min() > 0.0):
        raise InvalidRequestError(f"detections[{k}].bbox.size is {size}: must be above 0 [m]")
    if size.max() <= ROUND * size.min():
        return Sphere(0.5 * float(size.mean()))
    x, y, z = (0.5 * size).tolist()
    return Ellipsoid((x, y, z))
