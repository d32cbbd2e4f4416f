"""A motion that is streamed: the reference at each tick, its records, and how it ends early."""

import math
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from optipromp.core.arrays import FloatArray, frozen
from optipromp.core.errors import ExecutionError, InvalidRequestError
from optipromp.core.execution.streaming import Asking, Line, Question, Reply
from optipromp.core.parameters import Checked, parameter
from optipromp.core.planning.timing import stopped
from optipromp.core.robots.model import Robot
from optipromp.core.trajectory import State, Trajectory

TIE = 1e-9  # [s] by which times that were added up may differ, chosen

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

    join: float = parameter(
        1e-4, "rad or m", "choice", "largest distance of a joint where one curve replaces another"
    )
    join_velocity: float = parameter(
        1e-3, "rad/s or m/s", "choice", "largest difference of a joint's velocity at that instant"
    )
    join_acceleration: float = parameter(
        1e-2, "rad/s^2 or m/s^2", "choice", "largest difference of a joint's acceleration there"
    )
    wait: float = parameter(
        10.0, "s", "choice", "longest time that an arm stands still for the first curve of a source"
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("record", "advance"):
            if getattr(self, name) <= 0.0:
                raise InvalidRequestError(f"Guard.{name} is 0; it must be above 0")


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


class Steered(Protocol):
    """What a motion is streamed to; see ``Follower``."""

    robot: Robot
    guard: Guard

    def state(self) -> State:
        """The measured state."""

    def stream(self) -> AbstractContextManager[Iterator[float]]:
        """Control of the arm; times of its ticks [s]."""

    def command(self, reference: State) -> None:
        """Command a reference."""


class Streamed:
    """The execution of curves: the last reference, the records, and the reason of an early end.

    ``time`` is that of the references; a tick advances it by ``Guard.advance`` at most. A motion
    that ends early continues along a curve to rest. That curve begins at the measured state if the
    arm left the curve or a tick was late, else at the last reference. A faulty measurement shifts a
    reference by ``Guard.tracking`` at most.
    """

    def __init__(
        self, arm: Steered, curve: Trajectory, watch: Watch | None, aborted: threading.Event
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
        error, guard = np.abs(self.asked.q - measured.q), self.arm.guard
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
        off = np.clip(measured.q - self.asked.q, -most, most)
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
        arm: Steered,
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
            self.asking.ask(Question(self.time, measured, self.asked))
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
        stretch, reason, now = answer.stretch, answer.refusal, self.time
        self.silent = stretch is None and self.taken > 0 and self.line.ended(answer.asked)
        if stretch is None:
            return
        meets, before = max(stretch.begins, now), self.line.until(stretch.begins, now)
        away = "" if reason else self._apart(stretch.at(meets), before.at(meets))
        if away and stretch.begins < now - TIE:
            self.missed += 1
        elif reason or away:
            self.refused.append(f"{now:.3f} s: {reason or away}")
        else:
            self.line, self.taken = before.then(stretch, meets), self.taken + 1

    def _apart(self, one: State, running: State) -> str:
        """Where a stretch leaves the running curve; empty where it meets it."""
        guard = self.arm.guard
        most = {
            "q": guard.join,
            "velocity": guard.join_velocity,
            "acceleration": guard.join_acceleration,
        }
        if (found := apart(one, running, most)) is None:
            return ""
        what = "" if found.what == "q" else f"{'an' if found.what[0] == 'a' else 'a'} {found.what} "
        return (
            f"the curve begins with {what}{found.away:.4g} from the running one at "
            f"{self.arm.robot.joint_names[found.joint]} (at most {found.most:g})"
        )

    def _done(self) -> Executed:
        return replace(super()._done(), refused=tuple(self.refused), missed=self.missed)


@dataclass(frozen=True)
class Apart:
    """The joint that is farthest from another state in ``what``, and the limit of that."""

    what: str
    joint: int
    away: float
    most: float


def apart(one: State, other: State, limits: Mapping[str, float]) -> Apart | None:
    """The first of the fields of a state whose largest difference is beyond its limit."""
    for what, most in limits.items():
        away = np.abs(getattr(one, what) - getattr(other, what))
        joint = int(np.argmax(away))
        if away[joint] > most:
            return Apart(what, joint, float(away[joint]), most)
    return None


def standing(robot: Robot, state: State) -> Trajectory:
    """A curve that stands still at the positions of ``state``; it lasts 1 s, any time would do."""
    return Trajectory.through(np.tile(state.q, (2, 1)), 1.0, robot.joint_names)


def measured_state(arm: Steered) -> State:
    """The arm's state. Raises ValueError if its number of joints is not the robot's."""
    found = arm.state()
    if found.q.shape != (arm.robot.n_joints,):
        raise ValueError(f"{found.q.size} joints, where {arm.robot.name} has {arm.robot.n_joints}")
    return found


def in_words(what: str, error: BaseException) -> str:
    """A failure ``what`` and its ``error`` in one line."""
    return f"{what} ({type(error).__name__}: {error})".partition("\n")[0]
