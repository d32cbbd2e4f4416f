"""Executors: they move an arm along curves, with checks before and during the motion."""

import threading
from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from typing import Protocol, runtime_checkable

import numpy as np

from optipromp.core import judging
from optipromp.core.errors import ExecutionError, InvalidRequestError
from optipromp.core.execution.running import Executed as Executed
from optipromp.core.execution.running import (
    Following,
    Streamed,
    apart,
    in_words,
    measured_state,
    standing,
)
from optipromp.core.execution.running import Guard as Guard
from optipromp.core.execution.running import Watch as Watch
from optipromp.core.execution.streaming import PERIOD, Asking, AskingApart
from optipromp.core.execution.streaming import Source as Source
from optipromp.core.execution.streaming import Stretch as Stretch
from optipromp.core.robots.model import Robot
from optipromp.core.trajectory import State, Trajectory


@runtime_checkable
class Executor(Protocol):
    """An arm that executes curves. ``optipromp.core.execution.contract`` tests one."""

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the n joints, in the order of the arrays."""

    def state(self) -> State:
        """The measured state of the arm."""

    def execute(self, curve: Trajectory, watch: Watch | None = None) -> Executed:
        """Follow a curve in its own time; return when the arm is at rest.

        Raises:
            InvalidRequestError: the curve does not begin where the arm is, has other joints, breaks
                a limit or does not end at rest, or another curve is being executed. The arm has not
                moved.
            ExecutionError: the arm's state cannot be read, or ``watch`` or the controller fails.
                The message says whether the arm was brought to rest.
        """

    def follow(
        self, source: Source, *, period: float = PERIOD, watch: Watch | None = None
    ) -> Executed:
        """Follow the curves of a source, each of which may replace the running one in motion.

        The arm begins at rest where it is. The source is asked every ``period`` [s] of the
        executor's time, which begins at 0 and goes on by ``Guard.advance`` at most at a late tick.
        A stretch takes over at its ``begins``, in place of stretches that would do so later. It is
        refused, and what runs goes on, if

        - its joints are not the arm's, it breaks a limit or does not end at rest, or
        - at ``begins`` it is more than ``Guard.join`` from what runs then, in position, or by
          ``Guard.join_velocity`` or ``Guard.join_acceleration``.

        A stretch whose ``begins`` has passed takes over at once if its curve meets at the present
        time what runs; else it is missed. The motion is finished once the last curve has come to
        its end and the source, asked after that end, has returned None. It ends early as that of
        :meth:`execute`, or if no stretch has been taken by ``Guard.wait``.

        Raises:
            InvalidRequestError: the arm moves or is beyond a limit, ``period`` is not positive, or
                another curve is being executed. The arm has not moved.
            ExecutionError: as :meth:`execute`, or the source fails.
        """

    def abort(self) -> None:
        """Bring a moving arm to rest, from any thread; ``execute`` or ``follow`` then returns."""


class Follower(ABC):
    """An executor that streams curves to a controller as a sequence of references.

    A subclass takes control and waits for ticks (:meth:`stream`), commands a reference and reads
    the state. This class refuses curves, tracks the arm, aborts, and brings the arm to rest after a
    failure.

    Args:
        robot: its joints and limits.
        guard: limits for refusing and stopping.
    """

    synchronous = True
    """Whether ``follow`` asks its source between two ticks, which then waits for it. If False, a
    thread asks: a slow source delays no tick. ``follow`` returns once the running call of the
    source has returned; control is given back before."""

    def __init__(self, robot: Robot, guard: Guard | None = None) -> None:
        self.robot, self.guard = robot, guard or Guard()
        self._busy, self._aborted = threading.Lock(), threading.Event()

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the n joints, in the order of the arrays."""
        return self.robot.joint_names

    @abstractmethod
    def state(self) -> State:
        """The measured state of the arm."""

    @abstractmethod
    def stream(self) -> AbstractContextManager[Iterator[float]]:
        """Take control of the arm, and release it at the end, also after an error.

        The iterator waits for the controller's next tick and yields the time since the first tick
        [s]. It ends when control is lost.
        """

    @abstractmethod
    def command(self, reference: State) -> None:
        """Command a reference, which holds until the next."""

    def abort(self) -> None:
        """See :class:`Executor`."""
        self._aborted.set()

    def refusal(self, curve: Trajectory, now: State) -> str:
        """The reason to refuse a curve; empty if it may be executed."""
        return self._others(curve) or self._elsewhere(curve, now) or self._beyond(curve)

    def _others(self, curve: Trajectory) -> str:
        """A reason if the curve moves other joints."""
        own = self.robot.joint_names
        if curve.joint_names == own:
            return ""
        return f"the curve moves {', '.join(curve.joint_names)}; the arm has {', '.join(own)}"

    def _elsewhere(self, curve: Trajectory, now: State) -> str:
        """A reason if the curve does not begin as the arm is."""
        most = {"q": self.guard.start, "velocity": self.guard.start_velocity}
        if (found := apart(curve.at(0.0), now, most)) is None:
            return ""
        return (
            f"the curve begins{'' if found.what == 'q' else ' with a velocity'} {found.away:.4g} "
            f"from where {self.robot.joint_names[found.joint]} is (at most {found.most:g}): "
            "plan from the arm's state, or move to the start first"
        )

    def _beyond(self, curve: Trajectory) -> str:
        """A reason if the curve does not end at rest or breaks a limit."""
        robot, last = self.robot, curve.at(curve.duration)
        if last.moving and max(np.abs(last.velocity).max(), np.abs(last.acceleration).max()) > 1e-6:
            return "the curve does not end at rest"
        found = judging.extremes(curve)
        beyond = np.maximum(robot.lower - found.lowest, found.highest - robot.upper)
        if (beyond > 1e-6).any():
            return f"the curve leaves the limits of {robot.joint_names[int(np.argmax(beyond))]}"
        shares = found.largest / np.stack([robot.velocity, robot.acceleration, robot.jerk])
        if shares.max() > 1.0 + judging.ROUNDING:
            row, joint = divmod(int(np.argmax(shares)), robot.n_joints)
            return (
                f"{judging.RATES[row]} of {robot.joint_names[joint]} reaches "
                f"{shares[row, joint]:.3f} of its limit"
            )
        return ""

    def execute(self, curve: Trajectory, watch: Watch | None = None) -> Executed:
        """See :class:`Executor`."""
        if not isinstance(curve, Trajectory):
            raise InvalidRequestError(f"the curve is a {type(curve).__name__}, not a Trajectory")
        with self._begun() as now:
            if reason := self.refusal(curve, now):
                raise InvalidRequestError(reason)
            return Streamed(self, curve, watch, self._aborted).followed()

    def follow(
        self, source: Source, *, period: float = PERIOD, watch: Watch | None = None
    ) -> Executed:
        """See :class:`Executor`."""
        if not callable(source):
            raise InvalidRequestError(f"the source is a {type(source).__name__}, not a function")
        if not (np.isfinite(period) and period > 0.0):
            raise InvalidRequestError(f"period is {period}; it must be positive [s]")
        with self._begun() as now:
            if reason := self.refusal(standing(self.robot, now), now):
                raise InvalidRequestError(f"the arm cannot be held where it is: {reason}")
            made = Asking if self.synchronous else AskingApart
            asking = made(source, lambda curve: self._others(curve) or self._beyond(curve))
            try:
                return Following(self, now, asking, period, watch, self._aborted).followed()
            finally:
                asking.close()

    @contextmanager
    def _begun(self) -> Iterator[State]:
        """The arm's state before a motion; no other motion begins until the end."""
        if not self._busy.acquire(blocking=False):
            raise InvalidRequestError("another curve is being executed; abort it first")
        try:
            self._aborted.clear()
            try:
                now = measured_state(self)
            except Exception as error:
                told = in_words("the state could not be read", error)
                raise ExecutionError(f"{told}; the arm has not moved") from error
            yield now
        finally:
            self._busy.release()
