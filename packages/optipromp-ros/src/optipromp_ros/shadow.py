"""A picker's recording from a bag: joint states, detections, and when its gripper closed."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from optipromp.core.errors import InvalidRequestError
from optipromp.core.planning.task import posed
from optipromp.core.robots.measured import Series
from optipromp.core.scenes.look import Look
from optipromp.core.scenes.scene import Scene
from optipromp_eyes.eyes import look_as
from optipromp_loop.shadow.recording import CUT, UNKNOWN_VIEW, Mark, Recording, recorded
from optipromp_ros.frames import TF, known_frames
from optipromp_ros.images import SHOWN
from optipromp_ros.live import DETECTIONS, meaning, read_detections
from optipromp_ros.pictures import bag_pictures
from optipromp_ros.places import CameraPlace
from optipromp_ros.recordings import JOINT_STATE, stamp_of
from optipromp_ros.trajectories import NANO
from optipromp_ros.types import Recorded, read_bag


def load_picks(
    path: Path, scene: Scene, *, gripper: str | None, marks: Sequence[Mark] | None,
    roles: Sequence[str] = (), prefix: str = "",
) -> Recording:  # fmt: skip
    """The recording of a bag: ``JointState``, ``Detection3DArray``, ``/tf``; arguments as for
    :func:`optipromp_loop.shadow.recording.load_recorded`. Where nothing was detected, the eyes look
    at the bag's pictures with depth, at one a second (:func:`optipromp_ros.bag_pictures`).

    Times count from the first joint states. Detections in the frame of the base, or in ``world``,
    do not tell where the camera was. ``roles``: what the detector's classes mean, see
    :func:`optipromp_ros.live.meaning`. ``prefix``: before joints and links, of one of several arms.

    Raises:
        InvalidRequestError: no bag, joints that are missing, a camera whose place is unknown.
        InvalidSceneError: a wrong value of a detection.
    """
    where, seen = CameraPlace(path, scene, None, prefix, ()), list[Recorded]()
    fingers = list[tuple[int, float]]()
    for item in read_bag(path, types=(TF, JOINT_STATE, DETECTIONS)):
        if item.message.__msgtype__ == DETECTIONS:
            seen.append(item)
            continue
        where.heard(item)
        if item.message.__msgtype__ == JOINT_STATE and gripper in item.message.name:
            value = item.message.position[item.message.name.index(gripper)]
            fingers.append((stamp_of(item), float(value)))
    arm, origin = where.arm
    arm.series()  # tells what is missing
    still = known_frames(posed(scene)[0], prefix or arm.prefix or "", scene.base)
    looks = list[Look]()
    for item in seen:
        name, stamp = item.message.header.frame_id, stamp_of(item)
        known = still if name in still else {name: where.at(name, stamp)}
        look = read_detections(item.message, known, meaning(roles), time=(stamp - origin) / NANO)
        looks.append(replace(look, view=UNKNOWN_VIEW) if name in still else look)
    shown = list[Look]()
    if not seen and any(True for _ in read_bag(path, types=SHOWN)):
        for one in bag_pictures(path, scene, every=CUT.looked, prefix=prefix):
            shown.append(look_as(scene, one.picture, (one.stamp - origin) / NANO))
    if gripper is not None and not fingers:
        raise InvalidRequestError(f"{path}: no joint states name {gripper!r}, the gripper's joint")
    rows = np.array(sorted(fingers)).reshape(-1, 2)
    closing = Series((rows[:, 0] - origin) / NANO, rows[:, 1:]) if gripper else None
    return recorded(arm, looks, closing, gripper, marks, shown)
