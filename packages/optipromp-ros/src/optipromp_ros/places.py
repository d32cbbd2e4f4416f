"""Where the camera of a bag was: by its file, or by frames and joint states."""

import os
from collections.abc import Collection
from functools import cached_property

from optipromp.core.errors import InvalidRequestError
from optipromp.core.planning.task import posed
from optipromp.core.robots.measured import Measured
from optipromp.core.scenes.hand import flange_of
from optipromp.core.scenes.pose import Pose
from optipromp.core.scenes.scene import Scene
from optipromp_eyes.pictures import CameraModel
from optipromp_ros.frames import TF, Frames, known_frames, link_prefix
from optipromp_ros.recordings import of_one_arm, tell
from optipromp_ros.trajectories import NANO
from optipromp_ros.types import Recorded

STATIC = "tf_static"  # end of the topic of frames that do not move


class CameraPlace:
    """Where the camera of a bag was; arguments are those of :func:`optipromp_ros.bag_pictures`."""

    def __init__(
        self, path: str | os.PathLike[str], scene: Scene, camera: CameraModel | None, prefix: str,
        topics: Collection[str],
    ) -> None:  # fmt: skip
        self._path, self._robot, self._base = path, posed(scene)[0], scene.base
        self._camera, self._prefix, self._topics = camera, prefix, topics
        self._frames, self._states = Frames(), list[Recorded]()

    def heard(self, item: Recorded) -> None:
        """Take frames or joint states in."""
        if item.message.__msgtype__ == TF:
            self._frames.heard(item.message, item.topic.endswith(STATIC))
        else:
            self._states.append(item)

    @cached_property
    def arm(self) -> tuple[Measured, int]:
        """The arm, and from when its times count [ns]; joint states of others are left out."""
        robot, states = self._robot, self._states
        asked = [item for item in states if item.topic in self._topics] or states
        names = [self._prefix + name for name in robot.joint_names]
        what = "the joint states"
        arm = Measured(robot.joint_names, robot.turns, prefix=self._prefix, what=what)
        return arm, tell(arm, of_one_arm(self._path, asked, names))[0]

    def at(self, frame: str, stamp: int) -> Pose:
        """The pose of a camera's ``frame`` in the base at a ``stamp`` [ns].

        Raises:
            InvalidRequestError: nothing tells it.
        """
        (arm, origin), robot, q, why = self.arm, self._robot, None, ""
        try:
            q = arm.at((stamp - origin) / NANO)
        except InvalidRequestError as error:
            why = f"; {error.message}"
        if self._camera is not None and (self._camera.mount != "hand" or q is not None):
            return self._camera.on(None if q is None else flange_of(robot, q)).pose
        before = link_prefix(self._frames.names, robot, arm.prefix, self._prefix)
        known = known_frames(robot, before, self._base, q)
        del known[""]
        try:
            if self._camera is None:
                return self._frames.find(frame, known, stamp)
            hand = self._frames.find(before + robot.arm.tip, known, stamp)
            return self._camera.on(hand).pose
        except InvalidRequestError as error:
            where = "the hand" if self._camera else "the camera"
            cure = "" if self._camera else ": give --camera with its position and orientation"
            raise InvalidRequestError(
                f"{self._path}: no frames tell where {where} was: {error.message}{why}{cure}"
            ) from None
