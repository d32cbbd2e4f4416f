"""Pictures with depth from a bag, and where their camera was."""

import os
from collections.abc import Collection, Iterator
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

import numpy as np

from optipromp.core.errors import InvalidRequestError
from optipromp.core.planning.task import posed
from optipromp.core.robots.measured import Measured
from optipromp.core.scenes.hand import flange_of
from optipromp.core.scenes.pose import Pose
from optipromp.core.scenes.scene import Scene
from optipromp_eyes.pictures import CameraModel, DepthPicture
from optipromp_ros.images import APART, CAMERA_INFO, SHOWN, Pictures, Taken
from optipromp_ros.live import TOOL, WORLD
from optipromp_ros.loop import Frames
from optipromp_ros.recordings import JOINT_STATE
from optipromp_ros.trajectories import NANO, hear, nanoseconds
from optipromp_ros.types import read_bag

TF = "tf2_msgs/msg/TFMessage"
STATIC = "tf_static"  # end of the topic of frames that do not move


class BagPicture(NamedTuple):
    """A picture of a bag, and the seconds from the bag's first picture to its exposure."""

    picture: DepthPicture
    time: float


def bag_pictures(
    path: str | os.PathLike[str], scene: Scene, *, topics: Collection[str] | None = None,
    every: float = 1.0, camera: CameraModel | None = None, prefix: str = "",
) -> Iterator[BagPicture]:  # fmt: skip
    """The pictures of a bag, in the base frame of a scene's robot.

    Read are ``Image`` (rgb8, bgr8, rgba8, bgra8; depth 16UC1, 32FC1), ``CompressedImage`` of both,
    their ``CameraInfo``, or an organised ``PointCloud2`` with colours. Colour and depth of one
    picture are 20 ms apart at most; depth is registered to the colour. Where the camera was tell
    ``/tf`` and ``/tf_static``, by the names of the robot's links, which may have a prefix; joint
    states tell where the robot's last link was, if no frames do.

    Args:
        path: of the bag.
        scene: whose robot is in the bag.
        topics: of colour and depth, or of a cloud; None: all, if there is one of each kind.
        every: seconds from one picture to the next, at least.
        camera: whose pose, in the base or on the hand, is taken in place of the bag's frames.
        prefix: before the arm's joints and links, of one of several; empty: the only one there is.

    Raises:
        InvalidRequestError: no bag, no pictures, several topics of a kind, or a camera that no
            frame tells the place of.
    """
    taken, where = Pictures(topics, live=False), _Where(scene, camera, prefix)
    types = TF, JOINT_STATE, CAMERA_INFO
    for topic, item, _ in read_bag(path, types=types):
        if item.__msgtype__ == CAMERA_INFO:
            taken.heard(topic, item)
        else:
            where.heard(topic, item)
    first = last = None
    for topic, item, _ in read_bag(path, topics=topics, types=SHOWN):
        found = taken.heard(topic, item)
        if found is None or (last is not None and found.stamp < last + every * NANO):
            continue
        first, last = found.stamp if first is None else first, found.stamp
        picture = found.picture(where.at(found, Path(path)))
        yield BagPicture(picture, (found.stamp - first) / NANO)
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


class _Where:
    """Where the camera was: by the camera's file, else by frames and joint states."""

    def __init__(self, scene: Scene, camera: CameraModel | None, prefix: str) -> None:
        self._robot, self._prefix = posed(scene)[0], prefix
        self._world = Pose() if scene.base is None else scene.base.inverse()
        self._camera, self._frames = camera, Frames()
        joints, turns = self._robot.joint_names, self._robot.turns
        self._arm = Measured(joints, turns, prefix=prefix, what="the joint states")
        self._first: int | None = None  # stamp of the first joint states [ns]

    def heard(self, topic: str, item: object) -> None:
        """Take frames or joint states in; those of other joints are left out."""
        if item.__msgtype__ == TF:  # type: ignore[attr-defined]
            self._frames.heard(item, topic.endswith(STATIC))
            return
        stamp = nanoseconds(item.header.stamp)  # type: ignore[attr-defined]
        self._first = stamp if self._first is None else self._first
        with suppress(InvalidRequestError):
            hear(self._arm, item, (stamp - self._first) / NANO)

    def at(self, taken: Taken, path: Path) -> Pose:
        """The pose of a picture's camera in the base."""
        links = [name for name in self._robot.link_names if name != TOOL]
        known = {self._named(links[0]): Pose()}
        flange = self._named(links[-1])
        why = ""
        if self._first is not None:
            try:
                q = self._arm.at((taken.stamp - self._first) / NANO)
                known[flange] = flange_of(self._robot, q)
            except InvalidRequestError as error:
                why = f" ({error.message})"
        known |= {WORLD: self._world}
        if self._camera is not None:
            mounted = self._camera.mount == "hand"
            hand = self._frames.find(flange, known, taken.stamp) if mounted else None
            if mounted and hand is None:
                raise InvalidRequestError(
                    f"{path}: the camera is on the hand, and neither joint states nor frames tell "
                    f"where that was{why}"
                )
            return self._camera.on(hand).pose
        pose = self._frames.find(taken.header.frame_id, known, taken.stamp)
        if pose is None:
            raise InvalidRequestError(
                f"{path}: no frames lead from the camera, {taken.header.frame_id!r}, to "
                f"{next(iter(known))!r} when it was taken{why}: give --camera with its position "
                "and orientation"
            )
        return pose

    def _named(self, link: str) -> str:
        """The frame of a link; in a bag it may have a prefix."""
        names, link = self._frames.names, self._prefix + link
        fits = [name for name in names if name.endswith(link)]
        return link if link in names or len(fits) != 1 else fits[0]
