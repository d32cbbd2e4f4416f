"""Looks as messages."""

import numpy as np
from tests.ros.camera_messages import header

from optipromp.core.arrays import frame_along
from optipromp.core.scenes.pose import Pose
from optipromp_loop.control import Look
from optipromp_ros import message
from optipromp_ros.scenes import pose_message, xyz

EPOCH = 1_790_000_000_123_456_789  # [ns] of a clock of ROS


SIGMA = np.diag([0.002, 0.002, 0.004]) ** 2


def seen(name, place, *, size=(0.03, 0.03, 0.03), up=(0.0, 0.0, 1.0), spread=SIGMA, **further):
    """A ``Detection3D`` in the frame of the camera, whose box has z along ``up``."""
    pose = pose_message(Pose(np.array(place, float), frame_along(np.array(up, float))))
    covariance = np.zeros((6, 6))
    covariance[:3, :3] = spread
    there = message(
        "geometry_msgs/msg/PoseWithCovariance", pose=pose, covariance=covariance.ravel()
    )
    results = [
        message(
            "vision_msgs/msg/ObjectHypothesisWithPose", pose=there,
            hypothesis=message("vision_msgs/msg/ObjectHypothesis", class_id=one, score=score),
        )
        for one, score in (("background", 0.3), (name, 0.9))
    ]  # fmt: skip
    box = message(
        "vision_msgs/msg/BoundingBox3D", center=pose,
        size=xyz("geometry_msgs/msg/Vector3", np.array(size)),
    )  # fmt: skip
    return message("vision_msgs/msg/Detection3D", results=results, bbox=box, **further)


def array(*items, stamp=EPOCH, frame="camera"):
    return message(
        "vision_msgs/msg/Detection3DArray", header=header(stamp, frame), detections=list(items)
    )


def array_of(look: Look, stamp, frame="camera"):
    """What a node of a detector sends of a look."""
    items = []
    for item in look.detections:
        name = "ripe" if item.role == "target" else "unripe"
        up = np.array([0.0, 0.0, 1.0])
        if item.stem is not None:
            up = item.stem.points[-1] - item.stem.points[0]
        size = 2.0 * item.shape.measure.bound * np.ones(3)
        spread = item.covariance
        items.append(
            seen(name, item.position, size=size, up=up / np.linalg.norm(up), spread=spread)
        )
    return array(*items, stamp=stamp, frame=frame)
