"""What an arm of ROS follows."""

from collections import deque

from optipromp.core.trajectory import State, Trajectory
from optipromp_ros import Message, read_trajectories
from optipromp_ros.trajectories import nanoseconds


class Curves:
    """Curves of messages, each of which takes over at its stamp; the arm stands before the first.

    ``joins`` has the states before and after each that took over while another ran.
    """

    def __init__(self, joints: tuple[str, ...], start: State) -> None:
        self.joints, self.stands, self.joins = joints, start, list[tuple[State, State]]()
        self.runs: tuple[Trajectory, float] | None = None
        self._coming = deque[tuple[Trajectory, float]]()

    def heard(self, item: Message, origin: int = 0) -> Trajectory:
        """The curve of a message, whose stamp counts from ``origin`` [ns]."""
        (motion,) = read_trajectories(item, self.joints)
        self._coming.append((motion, (nanoseconds(item.header.stamp) - origin) / 1e9))
        return motion

    def at(self, now: float) -> State:
        """The reference at a time [s]."""
        while self._coming and self._coming[0][1] <= now + 1e-9:
            before, self.runs = self.runs, self._coming.popleft()
            if before is not None:
                self.joins.append((before[0].at(self.runs[1] - before[1]), self.runs[0].at(0.0)))
        return self.stands if self.runs is None else self.runs[0].at(now - self.runs[1])

    def ended(self, now: float) -> bool:
        """Whether the curve that runs has come to its end at a time [s]."""
        return self.runs is not None and now > self.runs[1] + self.runs[0].duration
