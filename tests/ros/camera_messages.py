"""A picture with depth as the messages of a camera."""

import io
import itertools
import struct

import numpy as np
from PIL import Image

from optipromp.core.scenes.pose import Pose
from optipromp_eyes import CameraModel, DepthPicture
from optipromp_ros import Message, from_bytes, message, to_bytes
from optipromp_ros.scenes import xyz
from optipromp_ros.trajectories import time_message

FRAME = "camera_color_optical_frame"


def sent(item: Message) -> Message:
    """A message as it arrives."""
    return from_bytes(to_bytes(item), item.__msgtype__)


def header(stamp: int, frame: str = FRAME) -> Message:
    return message("std_msgs/msg/Header", stamp=time_message(stamp), frame_id=frame)


def states(names, q, stamp: int = 0, velocity=()) -> Message:
    """A ``JointState``, as most drivers send it: without efforts; ``stamp`` 0: without a stamp."""
    return message(
        "sensor_msgs/msg/JointState", header=header(stamp, ""), name=names, position=q,
        velocity=velocity,
    )  # fmt: skip


def image(pixels: np.ndarray, encoding: str, stamp: int, *, spare: int = 0, big: bool = False):
    """An ``Image``; ``spare`` bytes fill up each row."""
    rows = np.ascontiguousarray(pixels.astype(pixels.dtype.newbyteorder(">" if big else "<")))
    rows = rows.reshape(len(pixels), -1).view(np.uint8)
    rows = np.pad(rows, ((0, 0), (0, spare)), constant_values=7)
    height, width = pixels.shape[:2]
    return message(
        "sensor_msgs/msg/Image", header=header(stamp), height=height, width=width,
        encoding=encoding, is_bigendian=int(big), step=rows.shape[1], data=rows.ravel(),
    )  # fmt: skip


def compressed(pixels: np.ndarray, stamp: int, kind: str) -> Message:
    """A ``CompressedImage``: ``png`` of colours; ``16UC1`` or ``32FC1`` of depth, as PNG, or with
    ``rvl`` after it; or ``16UC1 plain``, a depth that image_transport sends like colours."""
    data, name = io.BytesIO(), "rgb8; png compressed bgr8"
    before = b""
    if kind != "png":
        kind, _, code = kind.partition(" ")
        name = f"{kind}; png compressed " if code == "plain" else f"{kind}; compressedDepth {code}"
        a, b = 100.0, -1.0
        before = b"" if code == "plain" else struct.pack("<iff", 0, a, b)
        if kind == "32FC1":
            with np.errstate(divide="ignore"):
                pixels = np.where(pixels > 0, np.rint(a / pixels + b), 0).astype(np.uint16)
    if kind != "png" and code == "rvl":
        data.write(rvl(pixels))
    else:
        Image.fromarray(pixels).save(data, format="PNG")
    content = np.frombuffer(before + data.getvalue(), dtype=np.uint8)
    return message(
        "sensor_msgs/msg/CompressedImage", header=header(stamp), format=name, data=content
    )


def rvl(steps: np.ndarray) -> bytes:
    """Steps of depth by RVL, number by number: A. D. Wilson, ISS 2017."""
    numbers, left, before = list[int](), steps.ravel().astype(int).tolist(), 0
    while left:
        for zero in (True, False):
            run = list(itertools.takewhile(lambda step, zero=zero: (step == 0) == zero, left))
            left = left[len(run) :]
            numbers.append(len(run))
        for step in run:
            off, before = step - before, step
            numbers.append(2 * off if off >= 0 else -2 * off - 1)
    groups = list[int]()
    for number in numbers:
        while number > 7:
            groups.append(8 | number & 7)
            number >>= 3
        groups.append(number)
    groups += [0] * (-len(groups) % 8)
    words = (np.reshape(groups, (-1, 8)) << np.arange(28, -4, -4)).sum(axis=1).tolist()
    return struct.pack(f"<ii{len(words)}I", *steps.shape[::-1], *words)


def info(camera: CameraModel, stamp: int = 0, bent: tuple[float, ...] = (), **further) -> Message:
    k = (camera.fx, 0.0, camera.cx, 0.0, camera.fy, camera.cy, 0.0, 0.0, 1.0)
    p = (*k[:3], 0.0, *k[3:6], 0.0, *k[6:], 0.0)
    return message(
        "sensor_msgs/msg/CameraInfo", header=header(stamp), width=camera.width,
        height=camera.height, distortion_model="plumb_bob", d=bent, k=k, p=p, **further,
    )  # fmt: skip


def cloud(picture: DepthPicture, stamp: int) -> Message:
    """An organised ``PointCloud2`` with a gap after x, y, z, as drivers send it."""
    layout = {
        "names": ["x", "y", "z", "rgb"], "formats": ["<f4"] * 3 + ["<u4"],
        "offsets": [0, 4, 8, 16], "itemsize": 32,
    }  # fmt: skip
    cells = np.zeros(picture.depth.shape, dtype=np.dtype(layout))
    for k, name in enumerate("xyz"):
        cells[name] = np.where(picture.depth > 0.0, picture.points[:, :, k], np.nan)
    r, g, b = np.moveaxis(picture.rgb.astype(np.uint32), 2, 0)
    cells["rgb"] = r << 16 | g << 8 | b
    fields = [
        message("sensor_msgs/msg/PointField", name=name, offset=at, datatype=7, count=1)
        for name, at in zip(("x", "y", "z", "rgb"), (0, 4, 8, 16), strict=True)
    ]
    height, width = picture.depth.shape
    return message(
        "sensor_msgs/msg/PointCloud2", header=header(stamp), height=height, width=width,
        fields=fields, point_step=32, row_step=32 * width, data=cells.view(np.uint8).ravel(),
    )  # fmt: skip


def frames(stamp: int, *links: tuple[str, str, Pose]) -> Message:
    """A ``TFMessage`` of parents, children and the pose of the one in the other."""
    made = []
    for up, name, pose in links:
        w, x, y, z = pose.orientation
        turn = message("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)
        place = xyz("geometry_msgs/msg/Vector3", pose.position)
        to = message("geometry_msgs/msg/Transform", translation=place, rotation=turn)
        made.append(
            message(
                "geometry_msgs/msg/TransformStamped", header=header(stamp, up),
                child_frame_id=name, transform=to,
            )
        )  # fmt: skip
    return message("tf2_msgs/msg/TFMessage", transforms=made)
