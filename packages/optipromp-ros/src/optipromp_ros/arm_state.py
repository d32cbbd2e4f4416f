"""Where an arm is by its newest joint states, and whether that is known."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from optipromp.core.arrays import FloatArray
from optipromp.core.errors import InvalidRequestError, StartInvalidError
from optipromp.core.execution.executor import Guard, gap_beyond
from optipromp.core.robots.measured import AT_REST
from optipromp.core.trajectory import State
from optipromp_ros.trajectories import NANO, joint_motion, nanoseconds
from optipromp_ros.types import Message

OLD = 1.0  # [s] of a state after which the arm may be elsewhere: a choice
BEGIN = Guard()  # of an executor, by which a curve begins where the arm is


@dataclass(frozen=True, eq=False)
class ArmState:
    """The newest joint states of an arm.

    Attributes:
        state: None: they were not understood, or none came.
        why: the state is not known.
        times: of their stamp, where they have one, and of their arrival [ns].
        since: [ns] from when on the arm is where it is, to ``AT_REST`` times :data:`OLD`.
        place: (n,) where it was then.
        told: whether they have velocities.
    """

    state: State | None = None
    why: str = "no joint states were heard"
    times: tuple[int, ...] = ()
    since: int = 0
    place: FloatArray | None = None
    told: bool = False

    def heard(self, item: Message, joints: Sequence[str], now: int | None) -> "ArmState":
        """After a ``sensor_msgs/JointState`` of the n ``joints`` that came at ``now`` [ns]."""
        stamp = nanoseconds(item.header.stamp)
        times = tuple(time for time in (stamp or None, now) if time is not None)
        try:
            state = joint_motion(item, joints, "joint_states")
        except InvalidRequestError as error:
            return ArmState(why=error.message, times=times)
        since, place, told = max(times, default=0), state.q, len(item.velocity) > 0
        if self.place is not None and np.abs(state.q - self.place).max() <= AT_REST * OLD:
            since, place = self.since, self.place
        return ArmState(state, "", times, since, place, told)

    def known(self, now: int | None) -> State:
        """The state of the arm at ``now`` [ns]; None: of recorded states, whose age is not judged.

        Raises:
            StartInvalidError: none came, they are old, or they were not understood.
        """
        if self.state is None:
            raise StartInvalidError(self.why)
        ages = [0.0 if now is None else (now - time) / NANO for time in self.times]
        age = max(ages, key=abs, default=0.0 if now is None else math.inf)
        if abs(age) > OLD:
            told = f"{age:.1f} s old" if age > 0.0 else f"{-age:.1f} s ahead of the clock"
            raise StartInvalidError(f"joint states are {told}: must be at most {OLD:g} s old")
        return self.state

    def at_rest(self, joints: Sequence[str], now: int | None) -> State:
        """As :meth:`known`, of an arm that is known to stand.

        Raises:
            StartInvalidError: also where it moves, or where states without velocities do not tell.
        """
        state = self.known(now)
        if state.moving:
            k = int(np.argmax(np.abs(state.velocity)))
            raise StartInvalidError(
                f"the arm moves: {joints[k]} at {state.velocity[k]:.3g}: must be at rest"
            )
        stood = OLD if self.told or now is None else (now - self.since) / NANO
        if stood < OLD:
            raise StartInvalidError(
                f"joint states have no velocities, and by their positions the arm stands for "
                f"{stood:.2f} s: must be {OLD:g} s"
            )
        return state

    def begins(self, begin: State, joints: Sequence[str], now: int | None) -> None:
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
                f"{joints[joint]} is (at most {most[what]:g}): must begin where the arm is"
            )
