"""Demonstrations from a bag: joint states, cut into motions where the arm is still."""

import os
import warnings
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.ndimage import find_objects, label
from scipy.signal import savgol_filter

from optipromp.core.arrays import BoolArray, FloatArray
from optipromp.core.errors import InvalidDemonstrationError, InvalidRequestError
from optipromp.core.parameters import Checked, parameter
from optipromp.core.promp.demonstrations import Demonstration, Demonstrations
from optipromp.core.robots.measured import GAP, Measured, Series
from optipromp_ros.trajectories import NANO, hear, nanoseconds
from optipromp_ros.types import Recorded, read_bag

JOINT_STATE = "sensor_msgs/msg/JointState"
USUAL_TOPIC = "/joint_states"


@dataclass(frozen=True)
class CutParameters(Checked):
    """The definitions of a still phase and of a demonstration."""

    # noise of 1e-3 rad at 100 Hz gives the slope over ``window`` a deviation of 0.004 rad/s
    speed: float = parameter(0.03, "rad/s or m/s", "choice", "below it, every joint is still")
    window: float = parameter(0.2, "s", "choice", "of the slope of positions, by least squares")
    still: float = parameter(0.4, "s", "choice", "shortest still phase; a reversal is shorter")
    # moves the tool of an arm that reaches 1 m by 50 mm
    motion: float = parameter(0.05, "rad or m", "choice", "least range of a demonstration's joint")
    margin: float = parameter(0.1, "s", "choice", "of still phases at a demonstration's ends")
    gap: float = parameter(GAP, "s", "choice", "longest time without a message within it")
    rate: float = parameter(100.0, "Hz", "choice", "of the samples of a demonstration, at most")


@dataclass(frozen=True)
class Cut:
    """One motion of a recording.

    Attributes:
        start: [s] since the recording's first message.
        end: [s].
        motion: largest range of a joint [rad or m].
        demonstration: whether it is a demonstration; False: it is too small.
        whole: whether the arm was still before it and after it.
    """

    start: float
    end: float
    motion: float
    demonstration: bool
    whole: bool


@dataclass(frozen=True, eq=False)
class Recording:
    """The demonstrations of a bag, and the cuts between them.

    Attributes:
        demonstrations: in the order of the bag; times start at 0 [s], evenly spaced.
        cuts: all motions, also those that are too small.
        topic: that was read.
        messages: number of joint states that were read.
    """

    demonstrations: Demonstrations
    cuts: tuple[Cut, ...]
    topic: str
    messages: int

    def to_dict(self) -> dict[str, Any]:
        """Topic, number of messages and cuts as plain values."""
        cuts = [vars(cut) for cut in self.cuts]
        return {"topic": self.topic, "messages": self.messages, "cuts": cuts}


def load_recording(
    path: str | os.PathLike[str],
    joints: Sequence[str] | None = None,
    *,
    topic: str | None = None,
    prefix: str = "",
    parameters: CutParameters | None = None,
) -> Recording:
    """Demonstrations from the ``sensor_msgs/JointState`` messages of a bag.

    Joints are matched by name; messages without these joints (a gripper's) are left out. The joints
    of an arm may be in two messages or more. Times are those of the messages' headers, or of the
    bag where a header has none; where they run back, the recording is cut.

    Args:
        path: as for :func:`optipromp_ros.read_bag`.
        joints: of the robot, in its order; None: those of most messages, in the order of the first
            such message.
        topic: to read; None: see :func:`of_one_arm`.
        prefix: before the joints' names, of one of several arms; empty: the only one there is.
        parameters: definitions of a still phase and of a demonstration.

    Raises:
        InvalidRequestError: no bag, no such topic, missing joints.
        InvalidDemonstrationError: no joint states, or no motion among them.
    """
    limits = parameters or CutParameters()
    items = list(read_bag(path, topics=None if topic is None else (topic,), types=(JOINT_STATE,)))
    if not items:
        raise InvalidDemonstrationError(f"{path} has no messages of type {JOINT_STATE}")
    items = of_one_arm(path, items, joints and [prefix + name for name in joints])
    name = ", ".join(sorted({item.topic for item in items}))
    arm = _heard(f"{path}, {name}", items, joints, prefix, limits.gap)
    parts = arm.series()
    found, cuts = list[Demonstration](), list[Cut]()
    for one, q in (piece for part in parts for piece in _pieces(*part, limits)):
        for start, end, whole in _motions(one, q, limits):
            part = slice(start, end)
            motion = float(np.ptp(q[part], axis=0).max())
            large = motion >= limits.motion
            cuts.append(Cut(float(one[start]), float(one[end - 1]), motion, large, whole))
            if large:
                found.append(Demonstration(one[part] - one[start], q[part]))
    if not found:
        largest = max((cut.motion for cut in cuts), default=0.0)
        length = sum(float(times[-1] - times[0]) for times, _ in parts)
        raise InvalidDemonstrationError(
            f"{path}, {name}: no demonstration in {len(items)} joint states over "
            f"{length:.1f} s: the largest motion is {largest:.3g} rad (or m), must be "
            f"{limits.motion:g} at least, faster than {limits.speed:g} rad/s"
        )
    demonstrations = Demonstrations(tuple(found), arm.joints)
    return Recording(demonstrations, tuple(cuts), name, len(items))


def of_one_arm(
    path: str | os.PathLike[str], items: Sequence[Recorded], joints: Sequence[str] | None
) -> list[Recorded]:
    """The joint states of one arm: of several topics, where none of its joints is on two of them.

    Else those of ``/joint_states``. ``joints``: the arm's, with a prefix, if one is stated; None:
    any.

    Raises:
        InvalidRequestError: joints are on two topics, none of which is that one.
    """
    mine = dict[str, set[str]]()
    for item in items:
        found = {
            name for name in item.message.name if joints is None or name.endswith(tuple(joints))
        }
        mine.setdefault(item.topic, set()).update(found)
    topics = [topic for topic, names in mine.items() if names] or list(mine)
    if sum(map(len, mine.values())) > len(set().union(*mine.values())) or joints is None:
        if len(topics) > 1 and USUAL_TOPIC not in topics:
            raise InvalidRequestError(
                f"{path} has joint states on {', '.join(sorted(topics))}: one topic must be named"
            )
        topics = topics if len(topics) == 1 else [USUAL_TOPIC]
    return [item for item in items if item.topic in topics]


def tell(arm: Measured, items: Sequence[Recorded]) -> tuple[int, list[InvalidRequestError]]:
    """Tell an arm its joint states: from when its times count [ns], and the refusals of others."""
    origin, refusals = stamp_of(items[0]) if items else 0, list[InvalidRequestError]()
    for item in items:
        try:
            hear(arm, item.message, (stamp_of(item) - origin) / NANO)
        except InvalidRequestError as error:
            refusals.append(error)
    return origin, refusals


def _heard(
    what: str, items: Sequence[Recorded], joints: Sequence[str] | None, prefix: str, gap: float
) -> Measured:
    """The arm of a recording."""
    named = joints is not None
    if joints is None:
        most = Counter(frozenset(item.message.name) for item in items).most_common(1)[0][0]
        names = (item.message.name for item in items)
        joints = next(each for each in names if frozenset(each) == most)
    arm = Measured(joints, prefix=prefix, gap=gap, what=what)
    _, refusals = tell(arm, items)
    if refusals and arm.lacking:
        raise refusals[0]
    if refusals:
        warnings.warn(
            f"{len(refusals)} of {len(items)} messages are left out: {refusals[0].message}"
            + ("" if named else "; with the robot, joints of one arm in several messages join"),
            stacklevel=3,
        )
    return arm


def stamp_of(item: Recorded) -> int:
    """When a message was made, or recorded if that is not stated [ns]."""
    return nanoseconds(item.message.header.stamp) or item.stamp


def _pieces(
    times: FloatArray, positions: FloatArray, limits: CutParameters
) -> Iterable[tuple[FloatArray, FloatArray]]:
    """The stretches without a gap, evenly sampled: times (k,) [s] and positions (k, n)."""
    gaps = np.flatnonzero(np.diff(times) > limits.gap) + 1
    for rows in np.split(np.arange(len(times)), gaps):
        length = times[rows[-1]] - times[rows[0]]
        if length < limits.window:
            continue
        step = max(1.0 / limits.rate, float(np.median(np.diff(times[rows]))))
        even = np.linspace(times[rows[0]], times[rows[-1]], max(3, round(length / step) + 1))
        yield even, Series(times[rows], positions[rows]).at(even)


def _motions(
    times: FloatArray, positions: FloatArray, limits: CutParameters
) -> Iterable[tuple[int, int, bool]]:
    """First row and last row + 1 of each motion, and whether the arm is still before and after."""
    step = float(times[1] - times[0])
    count = min(2 * max(1, round(0.5 * limits.window / step)) + 1, len(times) - 1 | 1)
    slope = savgol_filter(positions, count, 1, deriv=1, delta=step, axis=0)
    moving = np.abs(slope).max(axis=1) >= limits.speed
    least, margin = limits.still / step, round(limits.margin / step)
    for start, end in _runs(~moving):
        if end - start < least and start > 0 and end < len(times):
            moving[start:end] = True
    for start, end in _runs(moving):
        whole = start > 0 and end < len(times)
        yield max(0, start - margin), min(len(times), end + margin), whole


def _runs(flags: BoolArray) -> Iterable[tuple[int, int]]:
    """First row and last row + 1 of each run of true flags."""
    return [(run.start, run.stop) for (run,) in find_objects(label(flags)[0])]
