"""Executors: they move an arm along a curve, with checks before and during the motion."""

import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np

from optipromp.core import judging
from optipromp.core.arrays import FloatArray, frozen
from optipromp.core.errors import ExecutionError, InvalidRequestError
from optipromp.core.parameters import Checked, parameter
from optipromp.core.planning.timing import stopped
from optipromp.core.robots.model import Robot
from optipromp.core.trajectory import State, Trajectory

Watch = Callable[[float, State], bool | None]
"""Called with the time in the curve [s] and the measured state; True ends the motion."""


@dataclass(frozen=True)
class Guard(Checked):
    """Limits beyond which an executor refuses a curve or ends a motion."""

    start: float = parameter(
        0.01, "rad or m", "choice", "largest distance of a joint from where the curve begins"
    )
    start_velocity: float = parameter(
        0.02, "rad/s or m/s", "choice", "largest difference of a joint's velocity at the begin"
    )
    tracking: float = parameter(
        0.1, "rad or m", "choice", "largest distance of a joint from the curve while it moves"
    )
    record: float = parameter(100.0, "Hz", "choice", "rate of the records and of ``watch``")
    advance: float = parameter(
        0.02, "s", "choice", "that the reference goes on by at a tick, at most: a late one slows it"
    )
    late: float = parameter(
        0.1, "s", "choice", "longest time between two ticks; after a longer one the motion ends"
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("record", "advance"):
            if getattr(self, name) <= 0.0:
                raise InvalidRequestError(f"Guard.{name} is 0; it must be above 0")


@dataclass(frozen=True, eq=False)
class Executed:
    """The result of executing a curve.

    Attributes:
        finished: whether the curve was followed to its end.
        reason: of an early end; empty if finished.
        times: (R,) of the records, since the begin [s]; delays of late ticks do not count.
        reference: (R, n) commanded positions [rad or m].
        positions: (R, n) measured positions [rad or m].
        largest_error: largest distance of a measured from a commanded position [rad or m].
    """

    finished: bool
    reason: str
    times: FloatArray
    reference: FloatArray
    positions: FloatArray
    largest_error: float


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

    def abort(self) -> None:
        """Bring a moving arm to rest, from any thread; ``execute`` then returns."""


class Follower(ABC):
    """An executor that streams a curve to a controller as a sequence of references.

    A subclass takes control and waits for ticks (:meth:`stream`), commands a reference and reads
    the state. This class refuses curves, tracks the arm, aborts, and brings the arm to rest after a
    failure.

    Args:
        robot: its joints and limits.
        guard: limits for refusing and stopping.
    """

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
        guard, robot = self.guard, self.robot
        if curve.joint_names != robot.joint_names:
            own = ", ".join(robot.joint_names)
            return f"the curve moves {', '.join(curve.joint_names)}; the arm has {own}"
        first = curve.at(0.0)
        for what, away, most in (
            ("begins", np.abs(first.q - now.q), guard.start),
            ("begins with a velocity", np.abs(first.velocity - now.velocity), guard.start_velocity),
        ):
            joint = int(np.argmax(away))
            if away[joint] > most:
                return (
                    f"the curve {what} {away[joint]:.4g} from where {robot.joint_names[joint]} is "
                    f"(at most {most:g}): plan from the arm's state, or move to the start first"
                )
        last = curve.at(curve.duration)
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
        if not self._busy.acquire(blocking=False):
            raise InvalidRequestError("another curve is being executed; abort it first")
        try:
            self._aborted.clear()
            try:
                now = _measured(self)
            except Exception as error:
                told = _in_words("the state could not be read", error)
                raise ExecutionError(f"{told}; the arm has not moved") from error
            if reason := self.refusal(curve, now):
                raise InvalidRequestError(reason)
            return _Run(self, curve, watch, self._aborted).followed()
        finally:
            self._busy.release()


class _Run:
    """The execution of a curve: the last reference, the records, and the reason of an early end.

    ``time`` is that of the references; a tick advances it by ``Guard.advance`` at most. A motion
    that ends early continues along a curve to rest. That curve begins at the measured state if the
    arm left the curve or a tick was late, else at the last reference. A faulty measurement shifts a
    reference by ``Guard.tracking`` at most.
    """

    def __init__(
        self, arm: Follower, curve: Trajectory, watch: Watch | None, aborted: threading.Event
    ) -> None:
        self.arm, self.curve, self.watch, self.aborted = arm, curve, watch, aborted
        self.time, self.began, self.reason, self.asked = 0.0, 0.0, "", curve.at(0.0)
        self.tick: float | None = None
        self.trouble: BaseException | None = None
        self.rows: list[tuple[float, FloatArray, FloatArray]] = []

    def followed(self) -> Executed:
        """Follow the curve to its end, or to rest.

        Raises:
            ExecutionError: a failure, or no tick at all.
        """
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
            measured = _measured(arm)
        except BaseException as error:
            self._in_trouble("the state could not be read", error)
        if measured is not None and late > guard.late:
            told = f"a tick came {late:.3g} s after the last, at {self.time:.3f} s"
            self._stop(told, self._near(measured))
        curve, now = self.curve, min(self.time - self.began, self.curve.duration)
        reference = curve.at(now)
        try:
            arm.command(reference)
        except BaseException as error:
            if self.trouble is not None:
                raise
            self._in_trouble("a reference could not be commanded", error)
            return False
        self.asked = reference
        if measured is not None:
            self._look(measured, now >= curve.duration)
        return now >= curve.duration and curve is self.curve

    def _look(self, measured: State, last: bool) -> None:
        """Record the reference and the measurement, and stop the motion if it must end."""
        due = not self.rows or self.time - self.rows[-1][0] >= 1.0 / self.arm.guard.record - 1e-9
        if due or last:
            self.rows.append((self.time, self.asked.q, measured.q))
        if self.reason:
            return
        error, guard = np.abs(self.asked.q - measured.q), self.arm.guard
        joint = int(np.argmax(error))
        if self.aborted.is_set():
            self._stop("it was aborted", self.asked)
        elif error[joint] > guard.tracking:
            name = self.arm.joint_names[joint]
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
            self.reason = _in_words(f"at {self.time:.3f} s {what}", error)

    def _near(self, measured: State) -> State:
        """The measured state, at most ``Guard.tracking`` away from the last reference."""
        most, fastest = self.arm.guard.tracking, self.arm.robot.velocity
        off = np.clip(measured.q - self.asked.q, -most, most)
        return State(self.asked.q + off, np.clip(measured.velocity, -fastest, fastest))

    def _stop(self, reason: str, state: State) -> None:
        """Continue along a curve from ``state`` to rest."""
        if not self.reason:
            self.reason, self.began = reason, self.time
            self.curve = stopped(self.arm.robot, state)

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


def _measured(arm: Follower) -> State:
    """The arm's state. Raises ValueError if its number of joints is not the robot's."""
    found = arm.state()
    if found.q.shape != (arm.robot.n_joints,):
        raise ValueError(f"{found.q.size} joints, where {arm.robot.name} has {arm.robot.n_joints}")
    return found


def _in_words(what: str, error: BaseException) -> str:
    """A failure ``what`` and its ``error`` in one line."""
    return f"{what} ({type(error).__name__}: {error})".partition("\n")[0]
