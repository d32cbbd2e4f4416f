"""The camera of a picture, by the ``CameraInfo`` of its topic and moment."""

import re
from collections.abc import Collection
from typing import NamedTuple

import numpy as np

from optipromp.core.arrays import FloatArray
from optipromp.core.errors import InvalidRequestError
from optipromp.core.scenes.pose import Pose
from optipromp_eyes.pictures import CameraModel
from optipromp_ros.trajectories import NANO, nanoseconds
from optipromp_ros.types import Message

NEAR = 0.02  # [s] from a picture, at most, of an info where infos change: a choice
KEPT = 16  # contents of the infos of a topic while a camera runs: a choice
INFO = "camera_info"  # end of the topic of infos, beside that of pictures
TRANSPORTS = "compressed", "compressedDepth"  # ends that image_transport adds to a topic
STRAIGHT = {"rect", "rectified", "undistorted"}
REGISTERED = {"aligned", "registered"}
MODELS = "plumb_bob", "rational_polynomial", ""


class _Span(NamedTuple):
    """Infos of one content, one after another: their first and last stamp [ns]."""

    first: int
    last: int
    info: Message


class Infos:
    """The infos that were heard, of each topic.

    ``named``: topics that are taken before others. ``live``: whether a camera runs, of which only
    the last contents are kept; else all infos are heard before the first picture.
    """

    def __init__(self, named: Collection[str], live: bool) -> None:
        self._named, self.live = frozenset(named), live
        self._of: dict[str, list[_Span]] = {}

    def heard(self, topic: str, item: Message) -> None:
        """Take an info in."""
        stamp, spans = nanoseconds(item.header.stamp), self._of.setdefault(topic, [])
        if spans and _content(spans[-1].info) == _content(item):
            first, last, _ = spans.pop()
            spans.append(_Span(min(first, stamp), max(last, stamp), item))
        else:
            spans.append(_Span(stamp, stamp, item))
        if self.live:
            del spans[:-KEPT]

    def find(self, topic: str, frames: tuple[str, str], stamp: int) -> tuple[Message, bool] | None:
        """The info of a picture, and whether it is of that moment; None: none was heard.

        Args:
            topic: of the colours; infos beside it go first, then those of its frame.
            frames: of the colours and of the depth.
            stamp: of the colours [ns].

        Raises:
            InvalidRequestError: infos of several cameras, none of which is beside the colours; or
                infos change about then, and none is of that moment.
        """
        said = {name: spans[-1].info for name, spans in self._of.items()}
        of = {name: info.header.frame_id for name, info in said.items()}
        unsaid = {name for name in of if self.live or not (of[name] and frames[0])}
        same = ({name for name in of if of[name] == frame} for frame in frames)
        for some in (self._named, {_beside(topic)}, *same, unsaid):
            found = [name for name in said if name in some]
            if len({_content(said[name]) for name in found}) > 1:
                raise InvalidRequestError(
                    f"{' and '.join(found)} tell of different cameras, and none is beside {topic}: "
                    "name the one to take, with the topics of colour and depth"
                )
            if found:
                return _nearest(self._of[found[0]], found[0], stamp)
        return None


def _nearest(spans: list[_Span], topic: str, stamp: int) -> tuple[Message, bool]:
    """The info whose time is nearest, the last of equally near ones; and whether it is exact."""
    aside = [max(span.first - stamp, stamp - span.last, 0) for span in spans][::-1]
    away = min(aside)
    if away > NEAR * NANO and len({span.first > stamp for span in spans}) > 1:
        raise InvalidRequestError(
            f"{topic} changes about a picture, and its nearest message is {away / NANO:.3g} s "
            f"from it: must be {NEAR:g} s at most"
        )
    return spans[-1 - aside.index(away)].info, away == 0


def _beside(topic: str) -> str:
    """The topic of the infos beside a topic of pictures, as image_transport has it."""
    return "/".join([*_base(topic).split("/")[:-1], INFO])


def _base(topic: str) -> str:
    head, _, last = topic.rpartition("/")
    return head if last in TRANSPORTS else topic


def _words(name: str) -> set[str]:
    return set(re.split(r"[^a-z0-9]+", name.lower()))


def is_rectified(topic: str) -> bool:
    """Whether a word in the name of a topic says that its pictures have no distortion."""
    last = _words(_base(topic).rpartition("/")[2])
    return bool(STRAIGHT & last) or ("raw" not in last and bool(STRAIGHT & _words(topic)))


def is_registered(topic: str) -> bool:
    """Whether a word in the name of a topic says that its depth is registered to the colours."""
    return bool(REGISTERED & _words(topic))


def _numbers(info: Message, name: str) -> FloatArray:
    """An array of an info; in ROS 1, and in bags that were converted, its name is upper case."""
    return np.asarray(getattr(info, name, getattr(info, name.upper(), ())), dtype=np.float64)


def _content(info: Message) -> tuple[object, ...]:
    roi = info.roi
    part = roi.x_offset, roi.y_offset, roi.width, roi.height, info.binning_x, info.binning_y
    arrays = (_numbers(info, name).tobytes() for name in "dkp")
    return info.width, info.height, info.distortion_model, *part, *arrays


def camera_of(info: Message, width: int, height: int, rectified: bool, pose: Pose) -> CameraModel:
    """The camera of a picture of ``width`` x ``height`` pixels.

    An info has the numbers of the whole sensor; ``roi`` is the part of it that a picture shows, in
    pixels of the sensor, of which ``binning`` make one of the picture.

    Args:
        info: a ``CameraInfo``.
        width, height: of the picture [pixel].
        rectified: whether the picture has no distortion, so that ``p`` holds.
        pose: of the camera in the base.

    Raises:
        InvalidRequestError: arrays of wrong lengths, a distortion that is not read, or a picture of
            another size.
    """
    k, p, d = (_numbers(info, name) for name in "kpd")
    if (len(k), len(p)) != (9, 12):
        sizes = f"k has {len(k)} and p {len(p)} numbers"
        raise InvalidRequestError(f"a CameraInfo's {sizes}; must have 9 and 12")
    matrix = p.reshape(3, 4) if rectified and p[0] > 0.0 else k.reshape(3, 3)
    bent = () if rectified or not np.any(d) else tuple(d.tolist())
    if bent and info.distortion_model not in MODELS:
        raise InvalidRequestError(
            f"distortion {info.distortion_model!r} is not read: take the rectified pictures"
        )
    roi, across, down = info.roi, max(int(info.binning_x), 1), max(int(info.binning_y), 1)
    told = (roi.width or info.width) / across, (roi.height or info.height) / down
    if max(abs(told[0] - width), abs(told[1] - height)) >= 1.0:
        raise InvalidRequestError(
            f"a picture has {width} x {height} pixels; its CameraInfo tells of {told[0]:g} x "
            f"{told[1]:g} (width, height, roi and binning)"
        )
    cx, cy = (matrix[0, 2] - roi.x_offset) / across, (matrix[1, 2] - roi.y_offset) / down
    return CameraModel(
        width, height, float(matrix[0, 0]) / across, float(matrix[1, 1]) / down, float(cx),
        float(cy), pose, distortion=bent,
    )  # fmt: skip
