"""Pictures with depth from messages: images, compressed images, and organised point clouds."""

import math
import struct
from collections import deque
from collections.abc import Collection
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from optipromp.core.arrays import FloatArray
from optipromp.core.errors import InvalidRequestError
from optipromp.core.scenes.pose import Pose
from optipromp_eyes.pictures import CameraModel, DepthPicture, Image8, decoded, taken
from optipromp_ros.camera_infos import Infos, camera_of, is_rectified, is_registered
from optipromp_ros.rvl import decoded_rvl
from optipromp_ros.trajectories import NANO, nanoseconds
from optipromp_ros.types import Message

IMAGE, COMPRESSED = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
CLOUD, CAMERA_INFO = "sensor_msgs/msg/PointCloud2", "sensor_msgs/msg/CameraInfo"
SHOWN = IMAGE, COMPRESSED, CLOUD
PICTURES = *SHOWN, CAMERA_INFO
APART = 0.02  # [s] between the stamps of colour and depth of one picture, at most: a choice
WAITING = 8  # messages of one kind that wait for the other: a choice
LOST = 2  # infos in a row without which pictures wait for none: a choice
OFF = 0.5  # [pixel] of a cloud's points from a camera's picture, at most: a choice
LEAST = 100  # points of a cloud that tell its camera: a choice
_COLOURS = {"rgb8": (3, [0, 1, 2]), "bgr8": (3, [2, 1, 0]), "rgba8": (4, [0, 1, 2]),
            "bgra8": (4, [2, 1, 0])}  # fmt: skip
_DEPTHS = {"16UC1": ("u2", 1e-3), "mono16": ("u2", 1e-3), "32FC1": ("f4", 1.0)}  # [m] of a step
_NUMBERS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}

Part = Literal["colour", "depth", "cloud", "camera"]


@dataclass(frozen=True, eq=False)
class Taken:
    """A picture in messages, to be decoded when it is wanted."""

    header: Message  # of the colours, with the frame of the camera, z forward
    colour: Message  # the image, or the cloud
    depth: Message | None = None  # the image of depth; None: a cloud
    info: Message | None = None  # the ``CameraInfo``; None: a cloud
    rectified: bool = False  # whether the topic says that its pictures have no distortion
    aligned: bool = False  # whether the topic says that the depth is registered to the colour

    @property
    def stamp(self) -> int:
        """Of the exposure [ns]."""
        return nanoseconds(self.header.stamp)

    def picture(self, pose: Pose | None = None) -> DepthPicture:
        """The picture without distortion; ``pose``: of its camera in the base."""
        pose = Pose() if pose is None else pose
        if self.depth is None:
            return _of_cloud(self.colour, pose).thinned()
        rgb, depth = _colour(self.colour), _depth(self.depth)
        if rgb.shape[:2] != depth.shape:
            raise InvalidRequestError(
                f"depth has {depth.shape[1]} x {depth.shape[0]} pixels and colour "
                f"{rgb.shape[1]} x {rgb.shape[0]}: take the depth that is registered to the "
                "colour, as aligned_depth_to_color"
            )
        frames = self.depth.header.frame_id, self.header.frame_id
        if not self.aligned and all(frames) and len(set(frames)) > 1:
            raise InvalidRequestError(
                f"depth is of the imager {frames[0]!r} and colour of {frames[1]!r}: take the depth "
                "that is registered to the colour, as aligned_depth_to_color or depth_registered"
            )
        assert self.info is not None
        height, width = depth.shape
        camera = camera_of(self.info, width, height, self.rectified, pose)
        return taken(rgb, depth, camera).thinned()


class Pictures:
    """Joins messages to pictures: colour with the depth of the same moment and the camera.

    Where infos come with the pictures, a picture waits for that of its own stamp.

    Args:
        topics: of colour and depth, or of a cloud; None: all, of which each kind may have one.
        live: whether infos come with the pictures; else all are heard before the first.
    """

    def __init__(self, topics: Collection[str] | None = None, live: bool = True) -> None:
        self._topics = topics
        self._of: dict[Part, str] = {}
        self._waiting: dict[Part, deque[Message]] = {
            "colour": deque(maxlen=WAITING), "depth": deque(maxlen=WAITING),
        }  # fmt: skip
        self._infos = Infos(topics or (), live)
        self._joined: tuple[Message, Message] | None = None  # colour and depth without their info
        self._patience = 0  # pictures that wait for the info of their stamp, until some are lost
        self.seen = dict[str, str]()
        """What each topic of pictures has, by its name."""
        self.apart = math.inf
        """Least time between the stamps of a colour and a depth that make no picture [s]."""

    def heard(self, topic: str, item: Message) -> Taken | None:
        """Take a message in; returns the picture that it completes."""
        part = part_of(item)
        if self._topics is not None and topic not in self._topics and part != "camera":
            return None
        self.seen[topic] = part or _encoding(item)
        if part == "camera":
            self._infos.heard(topic, item)
            return self._completed()
        if part is None:
            return None
        if self._of.setdefault(part, topic) != topic:
            raise InvalidRequestError(
                f"{self._of[part]} and {topic} both have {part}: name the topics to take"
            )
        if part == "cloud":
            return Taken(item.header, item)
        self._waiting[part].append(item)
        self._join(part, item)
        return self._completed()

    def _join(self, part: Part, item: Message) -> None:
        """Join a message with its nearest of the other kind; both are then used up."""
        other = self._waiting["depth" if part == "colour" else "colour"]
        at = nanoseconds(item.header.stamp)

        def away(one: Message) -> int:
            return abs(nanoseconds(one.header.stamp) - at)

        near = min(other, key=away, default=None)
        if near is None or away(near) > APART * NANO:
            self.apart = min(self.apart, math.inf if near is None else away(near) / NANO)
            return
        self._patience -= self._joined is not None  # its info was lost
        self._joined = (item, near) if part == "colour" else (near, item)
        for waiting in self._waiting.values():
            waiting.clear()

    def _completed(self) -> Taken | None:
        """The picture whose colour, depth and info are there."""
        if self._joined is None:
            return None
        (colour, depth), (one, other) = self._joined, (self._of["colour"], self._of["depth"])
        frames = colour.header.frame_id, depth.header.frame_id
        found = self._infos.find(one, frames, nanoseconds(colour.header.stamp))
        if found is None or (self._infos.live and self._patience > 0 and not found[1]):
            return None
        info, exact = found
        self._patience, self._joined = LOST if exact else self._patience, None
        return Taken(colour.header, colour, depth, info, is_rectified(one), is_registered(other))


def part_of(item: Message) -> Part | None:
    """What a message has of a picture; None: nothing that is read, such as an infrared image."""
    kind, encoding = item.__msgtype__, _encoding(item)
    if kind == CAMERA_INFO:
        return "camera"
    if kind == CLOUD:
        return "cloud"
    if kind == COMPRESSED:
        if "compressedDepth" in encoding or encoding.partition(";")[0] in _DEPTHS:
            return "depth"  # the latter without loss, as PNG or TIFF
        return None if encoding.startswith("mono") else "colour"
    if encoding in _COLOURS:
        return "colour"
    return "depth" if encoding in _DEPTHS else None


def _encoding(item: Message) -> str:
    return str(getattr(item, "encoding", "") or getattr(item, "format", ""))


def _colour(item: Message) -> Image8:
    if item.__msgtype__ == COMPRESSED:
        return decoded(bytes(item.data), "a compressed image", "RGB").astype(np.uint8)
    count, order = _COLOURS[item.encoding]
    rows = _rows(item, "u1", count)
    return rows.reshape(int(item.height), int(item.width), count)[:, :, order]


def _depth(item: Message) -> FloatArray:
    """Depths [m]; 0 where nothing was measured."""
    if item.__msgtype__ == COMPRESSED:
        data, name = bytes(item.data), "a compressed depth"
        if "compressedDepth" not in item.format:
            plain = decoded(data, name)
            scale = 1.0 if plain.dtype.kind == "f" else _DEPTHS["16UC1"][1]
            return _measured(plain.astype(np.float64) * scale)
        if len(data) < 12:  # that tell how depths were coded, before a PNG or RVL
            raise InvalidRequestError(f"{name} has {len(data)} bytes; must have 12")
        _, a, b = struct.unpack("<iff", data[:12])
        rvl = item.format.rstrip().endswith("rvl")
        steps = (decoded_rvl(data[12:]) if rvl else decoded(data[12:], name)).astype(np.float64)
        if not item.format.startswith("32FC1"):
            return np.asarray(steps * _DEPTHS["16UC1"][1])
        with np.errstate(divide="ignore"):
            return _measured(np.where(steps > 0.0, a / (steps - b), 0.0))
    kind, scale = _DEPTHS[item.encoding]
    return _measured(_rows(item, kind, 1).astype(np.float64) * scale)


def _measured(depth: FloatArray) -> FloatArray:
    return np.asarray(np.where(np.isfinite(depth) & (depth > 0.0), depth, 0.0))


def _rows(item: Message, kind: str, count: int) -> NDArray[Any]:
    """(height, width · count) numbers of an image, without what fills up its rows."""
    number = np.dtype(kind).newbyteorder(">" if item.is_bigendian else "<")
    wide = int(item.width) * count * number.itemsize
    height, step = int(item.height), int(item.step)
    data = np.asarray(item.data, dtype=np.uint8)
    if step < wide or len(data) < height * step:
        raise InvalidRequestError(
            f"an image {item.encoding} of {item.width} x {item.height} pixels has {len(data)} "
            f"bytes in rows of {step}: too few"
        )
    rows = data[: height * step].reshape(height, step)[:, :wide]
    return np.ascontiguousarray(rows).view(number)


def _of_cloud(item: Message, pose: Pose) -> DepthPicture:
    """The picture of an organised cloud; its camera is that which fits its points."""
    height, width = int(item.height), int(item.width)
    if height < 2:
        raise InvalidRequestError(
            f"a cloud of {height} x {width} points has no rows: take the organised one"
        )
    fields = {field.name: field for field in item.fields}
    lacking = [name for name in ("x", "y", "z", "rgb") if name not in fields]
    if "rgba" in fields and lacking == ["rgb"]:
        fields["rgb"], lacking = fields["rgba"], []
    if lacking:
        raise InvalidRequestError(f"a cloud without {', '.join(lacking)}: has {', '.join(fields)}")
    order = ">" if item.is_bigendian else "<"
    chosen = [fields[name] for name in ("x", "y", "z")]
    places = [field.offset for field in (*chosen, fields["rgb"])]
    data = np.asarray(item.data, dtype=np.uint8)[: height * int(item.row_step)]
    try:
        forms = [order + _NUMBERS[field.datatype] for field in chosen] + [order + "u4"]
        layout: Any = {
            "names": ["x", "y", "z", "rgb"], "formats": forms, "offsets": places,
            "itemsize": int(item.point_step),
        }  # fmt: skip
        rows = data.reshape(height, int(item.row_step))[:, : width * int(item.point_step)]
        cells = np.ascontiguousarray(rows).view(np.dtype(layout)).reshape(height, width)
    except (KeyError, TypeError, ValueError):
        raise InvalidRequestError(
            f"a cloud of {height} x {width} points has {len(data)} bytes, "
            f"row_step {item.row_step}, point_step {item.point_step} and fields at {places}: must "
            "fit together"
        ) from None
    packed = cells["rgb"].astype(np.uint32)
    rgb = np.dstack([(packed >> shift & 255).astype(np.uint8) for shift in (16, 8, 0)])
    x, y, z = (np.asarray(cells[name], dtype=np.float64) for name in ("x", "y", "z"))
    good = np.isfinite(x) & np.isfinite(y) & np.isfinite(z) & (z > 0.0)
    if good.sum() < LEAST:
        raise InvalidRequestError(f"a cloud has {int(good.sum())} points before its camera")
    row, column = np.nonzero(good)
    fx, cx, off = _line(x[good] / z[good], column)
    fy, cy, low = _line(y[good] / z[good], row)
    if not (max(off, low) < OFF and min(fx, fy) > 0.0):
        raise InvalidRequestError(
            "the points of a cloud are not those of a camera's picture: must be in its optical "
            "frame (x right, y down, z forward), one a pixel"
        )
    camera = CameraModel(width, height, fx, fy, cx, cy, pose)
    return DepthPicture(rgb, np.where(good, z, 0.0), camera)


def _line(slope: FloatArray, place: NDArray[np.int64]) -> tuple[float, float, float]:
    """Focal length, middle and root mean square error of ``place`` = focal · slope + middle."""
    rows = np.column_stack([slope, np.ones_like(slope)])
    found = np.linalg.lstsq(rows, place, rcond=None)[0]
    return float(found[0]), float(found[1]), math.sqrt(float(((rows @ found - place) ** 2).mean()))
