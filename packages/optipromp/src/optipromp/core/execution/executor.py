"""Executors: they move an arm along curves, with checks before and during the motion."""

import math
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, replace
from typing import Protocol, runtime_checkable

import numpy as np

from optipromp.core import judging
from optipromp.core.arrays import FloatArray, frozen
from optipromp.core.errors import ExecutionError, InvalidRequestError
from optipromp.core.execution.streaming import (
    JOIN,
    PERIOD,
    TIE,
    Asking,
    AskingApart,
    Line,
    Reply,
    gap_beyond,
)
from optipromp.core.execution.streaming import Source as Source
from optipromp.core.execution.streaming import Stretch as Stretch
from optipromp.core.parameters import Checked, parameter
from optipromp.core.planning.timing import stopped
from optipromp.core.robots.model import Robot
from optipromp.core.trajectory import State, Trajectory
from optipromp.core.values import Positive

Watch = Callable[[float, State], bool | None]
"""Called with the time in the curve [s] and the measured state; True ends the motion."""


@dataclass(frozen=True)
class Guard(Checked):
    """Limits beyond which an executor refuses a curve or ends a motion.

    Distances are from the curve, or from the curve that runs.
    """

    start: float = parameter(0.01, "rad or m", "choice", "largest distance of a joint at the begin")
    start_velocity: float = parameter(0.02, "rad/s or m/s", "choice", "the same of a velocity")
    tracking: float = parameter(0.1, "rad or m", "choice", "the same of a joint while it moves")
    record: Positive = parameter(100.0, "Hz", "choice", "rate of the records and of ``watch``")
    # a late tick slows the reference
    advance: Positive = parameter(0.02, "s", "choice", "largest advance of the reference at a tick")
    late: float = parameter(0.1, "s", "choice", "between two ticks; after longer the motion ends")
    join: float = parameter(
        JOIN["q"], "rad or m", "choice", "largest step where a curve takes over"
    )
    join_velocity: float = parameter(
        JOIN["velocity"], "rad/s or m/s", "choice", "the same of a velocity"
    )
    join_acceleration: float = parameter(
        JOIN["acceleration"], "rad/s^2 or m/s^2", "choice", "of an acceleration"
    )
    wait: float = parameter(10.0, "s", "choice", "longest wait for the first curve of a source")


@dataclass(frozen=True, eq=False)
class Executed:
    """The result of executing a curve, or the curves of a source.

    Attributes:
        finished: whether the curve, or the last one of a source, was followed to its end.
        reason: of an early end; empty if finished.
        times: (R,) of the records, since the begin [s]; delays of late ticks do not count.
        reference: (R, n) commanded positions [rad or m].
        positions: (R, n) measured positions [rad or m].
        largest_error: largest distance of a measured from a commanded position [rad or m].
        refused: a reason for each stretch of a source that was refused.
        missed: number of stretches that came after their begin and did not meet the motion.
    """

    finished: bool
    reason: str
    times: FloatArray
    reference: FloatArray
    positions: FloatArray
    largest_error: float
    refused: tuple[str, ...] = ()
    missed: int = 0


class Streamed:
    """The execution of curves: the last reference, the records, and the reason of an early end.

    ``time`` is that of the references; a tick advances it by ``Guard.advance`` at most. A motion
    that ends early continues along a curve to rest. That curve begins at the measured state if the
    arm left the curve or a tick was late, else at the last reference. A faulty measurement shifts a
    reference by ``Guard.tracking`` at most.
    """

    def __init__(
        self, arm: "Follower", curve: Trajectory, watch: Watch | None, aborted: threading.Event
    ) -> None:
        self.arm, self.line, self.watch, self.aborted = arm, Line.of(curve), watch, aborted
        self.time, self.reason, self.asked = 0.0, "", curve.at(0.0)
        self.tick: float | None = None
        self.trouble: BaseException | None = None
        self.rows: list[tuple[float, FloatArray, FloatArray]] = []

    def followed(self) -> Executed:
        """Follow the curves to their end, or to rest."""
        ended = False
        try:
            with self.arm.stream() as ticks:
                for tick in ticks:
                    if ended := self._at(tick):
                        break
        except Exception as error:
            self._in_trouble("control was lost", error)
        if self.trouble is not None:
            if not isinstance(self.trouble, Exception):
                raise self.trouble
            rest = "came to rest" if ended else "could not be brought to rest"
            raise ExecutionError(f"{self.reason}; the arm {rest}", self._done()) from self.trouble
        if self.tick is None:
            raise ExecutionError("the controller gave no tick; the arm has not moved")
        if not ended:
            self.reason = self.reason or "control of the arm was lost"
        return self._done()

    def _at(self, tick: float) -> bool:
        """Command the reference at the controller's time ``tick`` [s]; True after the last."""
        arm, guard, measured = self.arm, self.arm.guard, None
        late = 0.0 if self.tick is None else max(tick - self.tick, 0.0)
        self.tick, self.time = tick, self.time + min(late, guard.advance)
        try:
            measured = measured_state(arm)
        except BaseException as error:
            self._in_trouble("the state could not be read", error)
        if measured is not None and late > guard.late:
            told = f"a tick came {late:.3g} s after the last, at {self.time:.3f} s"
            self._stop(told, self._near(measured))
        line, reference = self.line, self.line.at(self.time)
        try:
            arm.command(reference)
        except BaseException as error:
            if self.trouble is not None:
                raise
            self._in_trouble("a reference could not be commanded", error)
            return False
        self.asked = reference
        if measured is not None:
            self._look(measured, line.ended(self.time))
        return line is self.line and line.ended(self.time) and self._over()

    def _over(self) -> bool:
        """Whether the motion is over, at the end of its last curve."""
        return True

    def _look(self, measured: State, last: bool) -> None:
        """Record the reference and the measurement, and stop the motion if it must end."""
        due = not self.rows or self.time - self.rows[-1][0] >= 1.0 / self.arm.guard.record - 1e-9
        if due or last:
            self.rows.append((self.time, self.asked.q, measured.q))
        if self.reason:
            return
        error, guard = np.abs(self.arm.robot.apart(measured.q, self.asked.q)), self.arm.guard
        joint = int(np.argmax(error))
        if self.aborted.is_set():
            self._stop("it was aborted", self.asked)
        elif error[joint] > guard.tracking:
            name = self.arm.robot.joint_names[joint]
            told = f"{name} was {error[joint]:.3g} from the curve at {self.time:.3f} s"
            self._stop(told, self._near(measured))
        elif due and self.watch is not None:
            try:
                if self.watch(self.time, measured):
                    self._stop(f"watch ended it at {self.time:.3f} s", self.asked)
            except BaseException as error:
                self._in_trouble("watch failed", error)

    def _in_trouble(self, what: str, error: BaseException) -> None:
        """Note the first failure, and come to rest."""
        if self.trouble is None:
            self.trouble = error
            self._stop(what, self.asked)
            self.reason = in_words(f"at {self.time:.3f} s {what}", error)

    def _near(self, measured: State) -> State:
        """The measured state, at most ``Guard.tracking`` away from the last reference."""
        most, fastest = self.arm.guard.tracking, self.arm.robot.velocity
        off = np.clip(self.arm.robot.apart(measured.q, self.asked.q), -most, most)
        return State(self.asked.q + off, np.clip(measured.velocity, -fastest, fastest))

    def _stop(self, reason: str, state: State) -> None:
        """Continue along a curve from ``state`` to rest."""
        if not self.reason:
            self.reason = reason
            self.line = Line.of(stopped(self.arm.robot, state), self.time)

    def _done(self) -> Executed:
        shape = 0, self.arm.robot.n_joints
        times, wanted, found = (
            (np.array(column) for column in zip(*self.rows, strict=True))
            if self.rows
            else (np.zeros(0), np.zeros(shape), np.zeros(shape))
        )
        largest = float(np.abs(wanted - found).max(initial=0.0))
        return Executed(
            not self.reason, self.reason, frozen(times), frozen(wanted), frozen(found), largest
        )


class Following(Streamed):
    """The execution of the curves of a source, from rest at ``begin``.

    ``due`` is the time of the next question [s]; ``taken`` the number of stretches taken;
    ``silent`` whether the source's last answer was None to a question after the last curve's end.
    """

    def __init__(
        self,
        arm: "Follower",
        begin: State,
        asking: Asking,
        period: float,
        watch: Watch | None,
        aborted: threading.Event,
    ) -> None:
        super().__init__(arm, standing(arm.robot, begin), watch, aborted)
        self.asking, self.period, self.due = asking, period, 0.0
        self.taken, self.silent, self.missed = 0, False, 0
        self.refused: list[str] = []

    def _over(self) -> bool:
        return self.silent or bool(self.reason)

    def _look(self, measured: State, last: bool) -> None:
        super()._look(measured, last)
        if self.reason:
            return
        if self.time >= self.due - TIE:
            missed = math.floor((self.time - self.due + TIE) / self.period)
            self.due += self.period * (1 + missed)
            self.asking.ask((self.time, measured, self.asked))
        for answer in self.asking.answers():
            self._answered(answer)
        if not self.taken and self.time >= self.arm.guard.wait:
            told = f" that can be taken; at {self.refused[-1]}" if self.refused else ""
            self._stop(f"no stretch came{told}", self.asked)

    def _answered(self, answer: Reply) -> None:
        """Take, refuse or miss the stretch of an answer; nothing once the motion must end."""
        if self.reason:
            return
        if answer.error is not None:
            self._in_trouble("the source failed", answer.error)
            return
        stretch, reason, now, guard = answer.stretch, answer.refusal, self.time, self.arm.guard
        self.silent = stretch is None and self.taken > 0 and self.line.ended(answer.asked)
        if stretch is None:
            return
        if not reason:
            joins = guard.join, guard.join_velocity, guard.join_acceleration
            try:
                self.line = self.line.take(stretch, now, most=dict(zip(JOIN, joins, strict=True)))
                self.taken += 1
                return
            except ExecutionError as away:
                if stretch.begins < now - TIE:
                    self.missed += 1
                    return
                reason = away.message
        self.refused.append(f"{now:.3f} s: {reason}")

    def _done(self) -> Executed:
        return replace(super()._done(), refused=tuple(self.refused), missed=self.missed)


def standing(robot: Robot, state: State) -> Trajectory:
    """A curve that stands still at the positions of ``state``; it lasts 1 s, any time would do."""
    return Trajectory.still(state.q, (0.0, 1.0), robot.joint_names)


def measured_state(arm: "Follower") -> State:
    """The arm's state. Raises ValueError if its number of joints is not the robot's."""
    found = arm.state()
    if found.q.shape != (arm.robot.n_joints,):
        raise ValueError(f"{found.q.size} joints, where {arm.robot.name} has {arm.robot.n_joints}")
    return found


def in_words(what: str, error: BaseException) -> str:
    """A failure ``what`` and its ``error`` in one line."""
    return f"{what} ({type(error).__name__}: {error})".partition("\n")[0]


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
        if (gap := gap_beyond(curve.at(0.0), now, most)) is None:
            return ""
        what, joint, away = gap
        return (
            f"the curve begins{'' if what == 'q' else ' with a velocity'} {away:.4g} from where "
            f"{self.robot.joint_names[joint]} is (at most {most[what]:g}): plan from the arm's "
            "state, or move to the start first"
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
        if not isinstance(curve, Trajectory):
            raise InvalidRequestError(f"the curve is a {type(curve).__name__}, not a Trajectory")
        with self._begun() as now:
            if reason := self.refusal(curve, now):
                raise InvalidRequestError(reason)
            return Streamed(self, curve, watch, self._aborted).followed()

    def follow(
        self, source: Source, *, period: float = PERIOD, watch: Watch | None = None
    ) -> Executed:
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
