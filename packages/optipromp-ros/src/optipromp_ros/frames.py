"""Frames by name: those that messages tell, as tf2 has them, and those of a robot's links."""

import bisect
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from itertools import pairwise
from operator import attrgetter
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from optipromp.core.arrays import FloatArray
from optipromp.core.errors import InvalidRequestError, InvalidSceneError
from optipromp.core.robots.measured import GAP
from optipromp.core.robots.model import Robot
from optipromp.core.scenes.hand import tool_frame
from optipromp.core.scenes.pose import Pose
from optipromp_ros.scenes import links_of, place_of, read_quaternion, root_of, vector
from optipromp_ros.trajectories import NANO, nanoseconds
from optipromp_ros.types import Message

TF = "tf2_msgs/msg/TFMessage"
WORLD = "world"  # Name of the frame in which the scene's ``base`` is the pose of the robot's base
TOOL = "tool"
"""Name of the frame at the tool point: z along the tool axis, y along the opening of fingers."""
HELD = round(GAP * NANO)  # [ns]; before its first and after its last time, a frame is as then
SAME = 1e-6  # [m and 1] by which two poses differ that are one: rounding of messages


def known_frames(
    robot: Robot, prefix: str = "", base: Pose | None = None, q: FloatArray | None = None
) -> dict[str, Pose]:
    """The frames of messages by name: their poses in the base frame, the surest first.

    The empty name is that of the base frame. ``world`` is the frame in which the base has the pose
    ``base`` (None: the base frame). Links stand behind the ``prefix``; those that move, and
    :data:`TOOL`, are known with the arm at ``q`` (n,). A link beyond a joint that is not the arm's
    (a finger) may be elsewhere than its file says, and is not known. ``world`` may be a link.
    """
    found = {"": Pose(), prefix + root_of(robot): Pose()}
    if q is not None:
        origins, turns = robot.segment_frames(q)
    for name, link in links_of(robot).items():
        if link.segment < 0:
            found[prefix + name] = place_of(link)
        elif q is not None:
            found[prefix + name] = Pose(origins[link.segment], turns[link.segment]) @ place_of(link)
    if q is not None:
        found[TOOL] = tool_frame(robot, q)
    found.setdefault(WORLD, Pose() if base is None else base.inverse())
    return found


def link_prefix(names: Collection[str], robot: Robot, joints: str | None, stated: str = "") -> str:
    """What stands before a robot's links among the ``names`` of frames.

    A platform may have a frame of the same name as a link of the arm, without the prefix.

    Args:
        names: of frames.
        robot: whose links these are.
        joints: what stands before its joints; None: that is not known.
        stated: with which all of it must end; empty: anything.

    Raises:
        InvalidRequestError: several arms have these links.
    """
    links = {root_of(robot), *links_of(robot)}
    before = [name.removesuffix(link) for name in names for link in links if name.endswith(link)]
    found = Counter(each for each in before if each == stated or not each[-1:].isalnum())
    said = stated or joints
    if said is not None and said in found:
        return said
    found = Counter({each: n for each, n in found.items() if each.endswith(stated)})
    most = [each for each, n in found.items() if n == max(found.values())]
    if len(most) > 1:
        raise InvalidRequestError(
            f"the arm's frames stand behind each of the prefixes {', '.join(map(repr, most))}: "
            "name that of the arm"
        )
    return most[0] if most else stated or joints or ""


class _Told(NamedTuple):
    stamp: int  # [ns]
    up: str
    pose: Pose  # in the parent


_stamp = attrgetter("stamp")


class Frames:
    """Frames by name: each one's parent, and its pose there over time.

    As in tf2, a parent belongs to each sample, and between samples of two parents the earlier one
    counts. What tf2 takes and nobody knows is refused: a frame that two senders hang on two parents
    in turn, a motion across a gap, a time that was twice, as a clock was set back.
    """

    def __init__(self) -> None:
        self.names = set[str]()  # of all that were told, and of their parents
        self._still: dict[str, tuple[str, Pose]] = {}  # of frames that do not move
        # parts, between which a clock was set
        self._moving: dict[str, list[list[_Told]]] = {}

    def heard(self, item: Message, still: bool) -> None:
        """Take a ``TFMessage`` in; ``still``: of frames that do not move (``/tf_static``).

        Raises:
            InvalidSceneError: a wrong value; the message names the frame.
        """
        for one in item.transforms:
            name, up = one.child_frame_id.lstrip("/"), one.header.frame_id.lstrip("/")
            to, stamp = one.transform, nanoseconds(one.header.stamp)
            try:
                told = _Told(stamp, up, Pose(vector(to.translation), read_quaternion(to.rotation)))
            except InvalidSceneError as error:
                raise InvalidSceneError(f"frame {name!r}: {error.message}") from None
            self.names |= {name, up}
            if still:
                self._still[name] = told[1:]
                continue
            parts = self._moving.setdefault(name, [[]])
            if parts[-1] and stamp < parts[-1][-1].stamp - HELD:
                parts.append([])
            bisect.insort_right(parts[-1], told, key=_stamp)

    def find(self, name: str, known: Mapping[str, Pose], stamp: int = 0) -> Pose:
        """The pose of a frame in the base at a ``stamp`` [ns].

        ``known``: poses of frames in the base, the surest first.

        Raises:
            InvalidRequestError: no known frame is in the same tree, or its pose at that time was
                not told.
        """
        name = name.lstrip("/")
        mine, why = self._chain(name, stamp)
        for other, pose in known.items():
            for common, there in self._chain(other, stamp)[0].items():
                if common in mine:
                    return pose @ there.inverse() @ mine[common]
        shown = " or ".join(repr(each) for each in known)
        raise InvalidRequestError(
            f"header.frame_id is {name!r}{why}: must be {shown}, or hang on one of these"
        )

    def _chain(self, name: str, stamp: int) -> tuple[dict[str, Pose], str]:
        """The frame and its parents, with the poses of the frame in each, and why no more.

        A loop ends it.
        """
        met, pose = dict[str, Pose](), Pose()
        while name not in met:
            met[name] = pose
            if name in self._moving:
                found = [_at(part, stamp) for part in self._moving[name]]
                told = [each for each in found if not isinstance(each, str)]
                if not told or any(not _same(told[0], each) for each in told):
                    why = "the clock of its frames was set back" if told else found[0]
                    return met, f" ({name!r}: {why})"
                up, on = told[0]
            elif name in self._still:
                up, on = self._still[name]
            else:
                break
            name, pose = up, on @ pose
        return met, ""


def _same(one: tuple[str, Pose], other: tuple[str, Pose]) -> bool:
    a, b = (np.column_stack([each[1].rotation, each[1].position]) for each in (one, other))
    return one[0] == other[0] and bool(np.abs(a - b).max() < SAME)


def _at(part: Sequence[_Told], stamp: int) -> tuple[str, Pose] | str:
    """Parent and pose in it, between two times on the way that turns evenly; or why not."""
    k = bisect.bisect_right(part, stamp, key=_stamp)
    before, after = part[max(k - 1, 0)], part[min(k, len(part) - 1)]
    away = max(before.stamp - stamp, stamp - after.stamp)
    if away > HELD:
        return f"not told within {GAP:g} s of then"
    low = bisect.bisect_left(part, stamp - HELD, key=_stamp)
    high = bisect.bisect_right(part, stamp + HELD, key=_stamp)
    near = [one.up for one in part[min(low, max(k - 2, 0)) : max(high, k + 2)]]
    if sum(one != other for one, other in pairwise(near)) > 1:
        return f"it hangs on {' and '.join(sorted(set(near)))} in turn"
    if before is after or stamp == before.stamp:
        return before[1:]
    if (gap := after.stamp - before.stamp) > HELD and not _same(before[1:], after[1:]):
        return f"it moved while nothing was told for {gap / NANO:.3f} s"
    if before.up != after.up:
        return before[1:]
    share = (stamp - before.stamp) / (after.stamp - before.stamp)
    a, b = before.pose, after.pose
    turn = Rotation.from_matrix(a.rotation.T @ b.rotation).as_rotvec() * share
    place = a.position + share * (b.position - a.position)
    return before.up, Pose(place, a.rotation @ Rotation.from_rotvec(turn).as_matrix())
