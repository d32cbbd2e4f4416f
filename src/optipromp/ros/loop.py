"""The closed loop on topics, without ROS: states and detections in, curves that replace others out.

:class:`PickLoop` is what the node ``optipromp ros-node --loop`` runs.
"""

import bisect
from collections import deque
from collections.abc import Iterator, Mapping

import numpy as np
from scipy.spatial.transform import Rotation

from optipromp.control.controller import Controller
from optipromp.control.driver import without_fruits
from optipromp.core.arrays import FloatArray, frame_along
from optipromp.core.errors import InvalidRequestError
from optipromp.core.execution.streaming import Line
from optipromp.core.robots.model import Robot
from optipromp.core.scenes.pose import Pose
from optipromp.core.scenes.scene import Scene
from optipromp.core.trajectory import State
from optipromp.perception.pictures import flange_of
from optipromp.perception.watcher import Watcher
from optipromp.ros.images import PICTURES, Pictures
from optipromp.ros.live import (
    DETECTIONS,
    TOOL,
    DetectionParameters,
    frames_of,
    in_base,
    read_detections,
)
from optipromp.ros.scenes import quaternion, vector
from optipromp.ros.trajectories import NANO, joint_motion, nanoseconds, stretch_trajectory
from optipromp.ros.types import Message, message

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


STALE = 0.1  # [s] age of joint states above which the loop does nothing: five cycles, a choice
KEPT = 2.0  # [s] of joint states, to tell where a camera on the hand was: a choice
OK, WARN = 0, 1  # levels of a diagnostic_msgs/DiagnosticStatus


class PickLoop:
    """A pick in closed loop by messages.

    All times are those of the messages' stamps and of :meth:`tick`, which must share a clock.

    Args:
        scene: robot, tool, approach, and what stands still. Its fruits are left out: the camera
            tells of them.
        parameters: of the detections.
        controller: of the pick; None: one for ``scene``.
        rate: of the points of a trajectory [Hz]; None: the rows of the curves.
        prefix: of joint and link names in ROS.
        watcher: of pictures, where looks are made here of a camera's topics; None: pictures are
            refused, and detections tell of the fruits.

    Attributes:
        controller: with its stage and its decisions.
        frames: poses of frames in the robot's base frame, by name.
    """

    def __init__(
        self,
        scene: Scene,
        *,
        parameters: DetectionParameters | None = None,
        controller: Controller | None = None,
        rate: float | None = None,
        prefix: str = "",
        watcher: Watcher | None = None,
    ) -> None:
        self.watcher, self._pictures = watcher, Pictures()
        self.controller = controller or Controller(without_fruits(scene), real_time=True)
        self.parameters = parameters or DetectionParameters()
        robot = self.controller.robot
        self.frames = frames_of(robot, prefix, scene.base)
        self._flange = prefix + [name for name in robot.link_names if name != TOOL][-1]
        self._rate, self._prefix = rate, prefix
        self._mounts = Frames()
        self._states = deque[tuple[float, State]]()
        self._origin: int | None = None
        self._line: Line | None = None
        self._trouble = "no joint states"

    @property
    def ended(self) -> bool:
        """Whether the pick is done, or given up."""
        return self.controller.ended

    def heard(self, item: Message, topic: str = "") -> None:
        """Take a message in.

        Read are ``sensor_msgs/JointState``, ``vision_msgs/Detection3DArray``, and
        ``tf2_msgs/TFMessage`` of frames that stand still on the base, on the robot's last link (its
        flange) or on ``tool`` (at the tool point, z along its axis), themselves or through others.
        With a watcher also the messages of pictures that :func:`optipromp.ros.bag_pictures` reads.

        Args:
            item: the message.
            topic: of a picture: one with ``rect`` in its name has no distortion.

        Raises:
            InvalidRequestError: joints that are not the robot's; an unknown frame; detections or
                pictures from before the first joint states, or from long after the newest; another
                type of message.
            InvalidSceneError: a wrong value.
        """
        match item.__msgtype__:
            case "sensor_msgs/msg/JointState":
                state = joint_motion(item, self.controller.robot.joint_names, "joint_states")
                time = self._time(nanoseconds(item.header.stamp))
                if not self._states or time > self._states[-1][0]:
                    self._states.append((time, state))
                while self._states[0][0] < time - KEPT:
                    self._states.popleft()
            case "tf2_msgs/msg/TFMessage":
                self._mounts.heard(item, still=True)
            case _ if item.__msgtype__ == DETECTIONS:
                time = self._time(nanoseconds(item.header.stamp))
                frames = self._frames(self._at(time))
                look = read_detections(item, frames, self.parameters, time=time)
                self.controller.see(look)
            case kind if kind in PICTURES and self.watcher is not None:
                taken = self._pictures.heard(topic or kind, item)
                if taken is not None:
                    time = self._time(taken.stamp)
                    frames = self._frames(self._at(time))
                    self.watcher.watch(taken.picture(in_base(taken.header, frames)), time)
            case _:
                raise InvalidRequestError(
                    f"a {item.__msgtype__} is of no use here: must be a JointState, a "
                    "Detection3DArray or a TFMessage"
                )

    def tick(self, now: int) -> Message | None:
        """One cycle of the controller, to be called every ``controller.parameters.period``.

        Args:
            now: by the clock of the stamps [ns].

        Returns:
            The ``trajectory_msgs/JointTrajectory`` that takes over at its time stamp,
            ``controller.parameters.lead`` from now. None: what runs goes on or the arm stands,
            also where joint states are missing or old.
        """
        time = self._time(now)
        if not self._states or time - self._states[-1][0] > STALE:
            self._trouble = "joint states are old" if self._states else "no joint states"
            return None
        self._trouble = ""
        for look in () if self.watcher is None else self.watcher.looks():
            self.controller.see(look)
        measured = self._states[-1][1]
        reference = State(measured.q) if self._line is None else self._line.at(time)
        stretch = self.controller(time, measured, reference)
        if stretch is None or not np.ptp(stretch.curve.positions, axis=0).any():
            return None  # a controller of the arm holds it where it stands
        if self._line is None:
            self._line = Line.of(stretch.curve, stretch.begins)
        else:
            self._line = self._line.until(stretch.begins, time).then(stretch, stretch.begins)
        assert self._origin is not None
        return stretch_trajectory(stretch, self._origin, self._rate, self._prefix)

    def status(self) -> Message:
        """A ``diagnostic_msgs/DiagnosticStatus``: the last decision, the stage and the fruits."""
        loop = self.controller
        tracked = None if self._origin is None else loop.tracker.at(max(loop.tracker.time, 0.0))
        count = 0 if tracked is None else int(tracked.confirmed.sum())
        values = {
            "stage": str(loop.stage),
            "fruits": str(count),
            "tries left": str(loop.tries),
            "last cycle [ms]": f"{1e3 * loop.cycles[-1]:.1f}" if loop.cycles else "",
        }
        return message(
            "diagnostic_msgs/msg/DiagnosticStatus",
            level=WARN if self._trouble else OK,
            name="optipromp/loop",
            message=self._trouble or (loop.events[-1].why if loop.events else "looking"),
            hardware_id=loop.robot.name,
            values=[
                message("diagnostic_msgs/msg/KeyValue", key=key, value=value)
                for key, value in values.items()
            ],
        )

    def _time(self, stamp: int) -> float:
        """Seconds since the first stamp: few, so that they are exact to the nanosecond."""
        if self._origin is None:
            self._origin = stamp
        return (stamp - self._origin) / NANO

    def _at(self, time: float) -> FloatArray:
        """(n,) where the arm was, linear between joint states."""
        if not self._states or time < self._states[0][0] - STALE:
            raise InvalidRequestError("where the arm was is unknown: joint states must come first")
        ahead = time - self._states[-1][0]
        if ahead > STALE:
            raise InvalidRequestError(
                f"header.stamp is {ahead:.3f} s after the newest joint states: must be {STALE:g} s "
                "at most, by the same clock"
            )
        times = [at for at, _ in self._states]
        q = np.array([state.q for _, state in self._states])
        return np.array([np.interp(time, times, column) for column in q.T])

    def _frames(self, q: FloatArray) -> dict[str, Pose]:
        """The known frames with the arm at ``q`` (n,)."""
        flange, tool = moving(self.controller.robot, q)
        known = {**self.frames, self._flange: flange, TOOL: tool}
        found = {name: self._mounts.find(name, known) for name in self._mounts.names}
        return {**{name: pose for name, pose in found.items() if pose is not None}, **known}


def moving(robot: Robot, q: FloatArray) -> tuple[Pose, Pose]:
    """The flange, and the frame at the tool point, in the base frame, at ``q`` (n,)."""
    origins, rotations = robot.segment_frames(q)
    origin, turn = origins[-1], rotations[-1]
    axes = frame_along(robot.tool_axis)
    if robot.tool is not None:
        axes = robot.flange_rotation @ robot.tool.rotation
    return flange_of(robot, q), Pose(origin + turn @ robot.tool_point, turn @ axes)
