"""Pictures with depth from a bag, and where their camera was."""

import os
from collections.abc import Collection, Iterator
from typing import NamedTuple

import numpy as np

from optipromp.core.errors import InvalidRequestError
from optipromp.core.scenes.scene import Scene
from optipromp_eyes.pictures import CameraModel, DepthPicture
from optipromp_ros.frames import TF
from optipromp_ros.images import APART, CAMERA_INFO, SHOWN, Pictures
from optipromp_ros.places import CameraPlace
from optipromp_ros.recordings import JOINT_STATE
from optipromp_ros.trajectories import NANO
from optipromp_ros.types import read_bag


class BagPicture(NamedTuple):
    """A picture of a bag, the seconds from the bag's first picture to its exposure, and when that
    was [ns since 1970]."""

    picture: DepthPicture
    time: float
    stamp: int


def bag_pictures(
    path: str | os.PathLike[str], scene: Scene, *, topics: Collection[str] | None = None,
    every: float = 1.0, camera: CameraModel | None = None, prefix: str = "",
) -> Iterator[BagPicture]:  # fmt: skip
    """The pictures of a bag, in the base frame of a scene's robot.

    Read are ``Image`` (rgb8, bgr8, rgba8, bgra8; depth 16UC1, 32FC1), ``CompressedImage`` of both,
    their ``CameraInfo``, or an organised ``PointCloud2`` with colours. Colour and depth of one
    picture are 20 ms apart at most; depth is registered to the colour. Where the camera was tell
    ``/tf`` and ``/tf_static``, by the names of the robot's links, which may have a prefix; joint
    states tell where the robot's links were, if no frames do.

    Args:
        path: of the bag.
        scene: whose robot is in the bag.
        topics: of colour and depth, or of a cloud; None: all, if there is one of each kind. Of
            joint states, where the arm's are on several: else ``/joint_states``.
        every: seconds from one picture to the next, at least.
        camera: whose pose, in the base or on the hand, is taken in place of the bag's frames.
        prefix: before the arm's joints and links, of one of several; empty: the only one there is.

    Raises:
        InvalidRequestError: no bag, no pictures, several topics of a kind, or a camera that no
            frame tells the place of.
    """
    taken = Pictures(topics, live=False)
    where = CameraPlace(path, scene, camera, prefix, topics or ())
    for item in read_bag(path, types=(TF, JOINT_STATE, CAMERA_INFO)):
        if item.message.__msgtype__ == CAMERA_INFO:
            taken.heard(item.topic, item.message)
        else:
            where.heard(item)
    first = last = None
    for topic, item, _ in read_bag(path, topics=topics, types=SHOWN):
        found = taken.heard(topic, item)
        if found is None or (last is not None and found.stamp < last + every * NANO):
            continue
        first, last = found.stamp if first is None else first, found.stamp
        picture = found.picture(where.at(found.header.frame_id, found.stamp))
        yield BagPicture(picture, (found.stamp - first) / NANO, found.stamp)
    if first is None:
        seen = ", ".join(f"{topic} ({what})" for topic, what in taken.seen.items()) or "none"
        if np.isfinite(taken.apart):
            raise InvalidRequestError(
                f"{path}: no picture with depth: the stamps of colour and depth are "
                f"{taken.apart:.3g} s apart at least, must be {APART:g} at most: have the camera's "
                "driver synchronise them"
            )
        raise InvalidRequestError(
            f"{path}: no picture with depth; needed are colour, depth and camera_info, or a cloud. "
            f"Topics: {seen}"
        )
