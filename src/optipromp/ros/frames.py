"""The tree of frames that ``tf2_msgs/TFMessage`` tells, over time."""

import bisect
from collections.abc import Iterator, Mapping

from scipy.spatial.transform import Rotation

from optipromp.core.scenes.pose import Pose
from optipromp.ros.scenes import quaternion, vector
from optipromp.ros.trajectories import nanoseconds
from optipromp.ros.types import Message

HELD = 200_000_000  # [ns] before its first and after its last time, a frame is as then: a choice


class Frames:
    """Frames by name: each one's parent, and its pose there over time.

    Attributes:
        still: parent and pose of each frame that does not move.
    """

    def __init__(self) -> None:
        self.still: dict[str, tuple[str, Pose]] = {}
        self._moving: dict[str, tuple[str, list[int], list[Pose]]] = {}

    @property
    def names(self) -> tuple[str, ...]:
        """All frames that were told, and their parents."""
        still = [name for child, (up, _) in self.still.items() for name in (child, up)]
        moving = [name for child, (up, *_) in self._moving.items() for name in (child, up)]
        return tuple(dict.fromkeys(still + moving))

    def heard(self, item: Message, still: bool) -> None:
        """Take a ``TFMessage`` in; ``still``: of frames that do not move (``/tf_static``)."""
        for one in item.transforms:
            name, up = one.child_frame_id.lstrip("/"), one.header.frame_id.lstrip("/")
            to = one.transform
            pose = Pose(vector(to.translation), quaternion(to.rotation))
            if still:
                self.still[name] = (up, pose)
                continue
            stamp = nanoseconds(one.header.stamp)
            _, times, poses = self._moving.setdefault(name, (up, [], []))
            k = bisect.bisect_right(times, stamp)
            times.insert(k, stamp)
            poses.insert(k, pose)

    def find(self, name: str, known: Mapping[str, Pose], stamp: int = 0) -> Pose | None:
        """The pose of a frame in the base at a ``stamp`` [ns].

        ``name``: of the frame. ``known``: poses of frames in the base, the surest first. ``stamp``:
        of what was seen.

        Returns: None: no known frame is in the same tree, or its pose at that time was not told.
        """
        mine = dict(self._chain(name, stamp))
        for other, pose in known.items():
            for common, there in self._chain(other, stamp):
                if common in mine:
                    return pose @ there.inverse() @ mine[common]
        return None

    def _chain(self, name: str, stamp: int) -> Iterator[tuple[str, Pose]]:
        """The frame and its parents, each with the pose of the frame in it; a loop ends it."""
        met, pose, name = set[str](), Pose(), name.lstrip("/")
        while name not in met:
            met.add(name)
            yield name, pose
            step = self._step(name, stamp)
            if step is None:
                return
            name, pose = step[0], step[1] @ pose

    def _step(self, name: str, stamp: int) -> tuple[str, Pose] | None:
        """Parent and pose in it, between two times on the way that turns evenly."""
        if name not in self._moving:
            return self.still.get(name)
        up, times, poses = self._moving[name]
        if not times[0] - HELD <= stamp <= times[-1] + HELD:
            return None
        k = bisect.bisect_right(times, stamp)
        if k in (0, len(times)):
            return up, poses[min(k, len(times) - 1)]
        share = (stamp - times[k - 1]) / (times[k] - times[k - 1])
        a, b = poses[k - 1], poses[k]
        turn = Rotation.from_matrix(a.rotation.T @ b.rotation).as_rotvec() * share
        place = a.position + share * (b.position - a.position)
        return up, Pose(place, a.rotation @ Rotation.from_rotvec(turn).as_matrix())
