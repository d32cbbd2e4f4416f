"""Where an arm is by its joint states, as they come, and whether that is known."""

from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from optipromp.core.arrays import FloatArray
from optipromp.core.errors import InvalidRequestError, StartInvalidError
from optipromp.core.execution.executor import Guard
from optipromp.core.execution.streaming import gap_beyond
from optipromp.core.robots.measured import AT_REST, Measured
from optipromp.core.robots.model import Robot
from optipromp.core.robots.turns import Turns
from optipromp.core.trajectory import State
from optipromp_ros.trajectories import NANO, hear, nanoseconds
from optipromp_ros.types import Message

OLD = 1.0  # [s] of a state after which the arm may be elsewhere: a choice
UNHEARD = "no joint states were heard"
BEGIN = Guard()  # of an executor, by which a curve begins where the arm is


@dataclass(frozen=True, eq=False)
class ArmState:
    """The joint states of an arm so far; each message gives a new one.

    Joints that may turn stand on the turn that their driver means: a plan begins there.

    Attributes:
        measured: of the last :data:`OLD` seconds, which count from ``origin`` [ns].
        turns: of the joints.
        old: [s] of a state after which it is not known where the arm is.
        why: states were not understood, or none came; empty: the newest were.
        came: the newest, by its arrival [ns]; None: recorded.
        since: [ns] from when on the arm is where it is, to ``AT_REST`` times :data:`OLD`.
        place: (n,) where it was then.
        told: whether all states have velocities.
    """

    measured: Measured
    turns: Turns
    old: float = OLD
    why: str = UNHEARD
    origin: int = 0
    came: int | None = None
    since: int = 0
    place: FloatArray | None = None
    told: bool = True

    @classmethod
    def of(cls, robot: Robot, prefix: str = "", old: float = OLD) -> "ArmState":
        """Of a robot of which nothing was heard; ``prefix``: see :class:`Measured`."""
        return cls(Measured(robot.joint_names, prefix=prefix, kept=OLD), robot.turns, old)

    @cached_property
    def newest(self) -> tuple[int, State] | None:
        """Time of the newest state of all joints [ns], and that state; None: it is not known."""
        found = self.measured.newest
        return found and (self.origin + round(found[0] * NANO), found[1])

    def heard(self, item: Message, now: int | None) -> "ArmState":
        """After a ``sensor_msgs/JointState`` that came at ``now`` [ns].

        Raises:
            InvalidRequestError: it has none of the arm's joints; the first such is :attr:`why`.
        """
        before = 0 if self.newest is None else self.newest[0]
        stamp = nanoseconds(item.header.stamp) or now or before + 1
        measured, origin = copy(self.measured), self.origin or stamp
        try:
            told = hear(measured, item, (stamp - origin) / NANO) and self.told
        except InvalidRequestError as error:
            if not measured.mine(item.name):
                if self.why != UNHEARD:
                    raise
                return replace(self, why=f"{UNHEARD}: {error.message}")
            measured.forget()
            return ArmState(measured, self.turns, self.old, error.message)
        after = replace(self, measured=measured, why="", origin=origin, came=now, told=told)
        if (newest := after.newest) is None:
            return after
        time, q = newest[0], newest[1].q
        far = self.place is None or np.abs(self.turns.apart(q, self.place)).max() > AT_REST * OLD
        return replace(after, since=time, place=q) if far else after

    def known(self, now: int | None) -> State:
        """The state of the arm at ``now`` [ns]; None: of recorded states, whose age is not judged.

        Raises:
            StartInvalidError: none came, they are old, or they were not understood.
        """
        if (newest := self.newest) is None:
            raise StartInvalidError(self.why or self.measured.silent)
        times = newest[0], self.came
        ages = [(now - time) / NANO for time in times if now is not None and time is not None]
        age = max(ages, key=abs, default=0.0)
        if abs(age) > self.old:
            told = f"{age:.2f} s old" if age > 0.0 else f"{-age:.2f} s ahead of the clock"
            raise StartInvalidError(f"joint states are {told}: must be at most {self.old:g} s old")
        return newest[1]

    def at_rest(self, now: int | None) -> State:
        """As :meth:`known`, of an arm that is known to stand.

        Raises:
            StartInvalidError: also where it moves, or where states without velocities do not tell.
        """
        state = self.known(now)
        if state.moving:
            k = int(np.argmax(np.abs(state.velocity)))
            name, speed = self.measured.joints[k], state.velocity[k]
            raise StartInvalidError(f"the arm moves: {name} at {speed:.3g}: must be at rest")
        stood = OLD if self.told or now is None else (now - self.since) / NANO
        if stood < OLD:
            raise StartInvalidError(
                f"joint states have no velocities, and by their positions the arm stands for "
                f"{stood:.2f} s: must be {OLD:g} s"
            )
        return state

    def begins(self, begin: State, now: int | None) -> None:
        """Refuse a curve that does not begin where the arm is, as an executor does.

        Raises:
            StartInvalidError: as :meth:`known`; or the arm is elsewhere.
        """
        state = self.known(now)
        most = {"q": BEGIN.start} | ({"velocity": BEGIN.start_velocity} if self.told else {})
        if (gap := gap_beyond(begin, state, most)) is not None:
            what, joint, away = gap
            raise StartInvalidError(
                f"the plan begins{'' if what == 'q' else ' with a velocity'} {away:.4g} from where "
                f"{self.measured.joints[joint]} is (at most {most[what]:g}): must begin where the "
                "arm is"
            )
