"""An executor moves an arm along a curve; the checks that every one of ours makes."""

import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np

from optipromp import judging
from optipromp.arrays import FloatArray, frozen
from optipromp.errors import InvalidRequestError
from optipromp.parameters import Checked, parameter
from optipromp.planning.timing import stopped
from optipromp.robots.model import Robot
from optipromp.trajectory import State, Trajectory

Watch = Callable[[float, State], bool | None]
"""Called with the time since the begin [s] and the measured state; True ends the motion."""


@dataclass(frozen=True)
class Guard(Checked):
    """When an executor refuses a curve, or ends a motion."""

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


@dataclass(frozen=True, eq=False)
class Executed:
    """What became of a curve.

    Attributes:
        finished: whether it was followed to its end.
        reason: why it was not; empty where it was.
        times: (R,) of the records, since the begin [s].
        reference: (R, n) positions that were asked for.
        positions: (R, n) measured ones.
        largest_error: largest distance of a joint from the curve [rad or m].
    """

    finished: bool
    reason: str
    times: FloatArray
    reference: FloatArray
    positions: FloatArray
    largest_error: float


@runtime_checkable
class Executor(Protocol):
    """An arm that executes curves. ``optipromp.execution.contract`` tests one."""

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the n joints, in the order of the arrays."""

    def state(self) -> State:
        """Where the arm is and how it moves."""

    def execute(self, curve: Trajectory, watch: Watch | None = None) -> Executed:
        """Follow a curve in its own time; return when the arm is at rest.

        Raises:
            InvalidRequestError: the curve does not begin where the arm is, has other joints, breaks
                a limit, does not end at rest, or another one is being executed. The arm has not
                moved then.
        """

    def abort(self) -> None:
        """Bring the arm to rest, from any thread; ``execute`` returns then. Else do nothing."""


class Follower(ABC):
    """An executor that streams a curve to a controller, one reference at a time.

    A subclass says how to begin (:meth:`stream`), how to wait for the next tick, how to command a
    reference and how to read the state. Everything else is here: refusing, tracking, aborting.

    Args:
        robot: its joints and limits.
        guard: when to refuse and when to stop.
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
        """Where the arm is and how it moves."""

    @abstractmethod
    def stream(self) -> AbstractContextManager[Iterator[float]]:
        """Take control of the arm; let go of it at the end, whatever happens.

        The iterator waits for the controller's next tick and gives the time since the first one
        [s]. It ends where control was lost.
        """

    @abstractmethod
    def command(self, reference: State) -> None:
        """Ask the controller for a reference, until the next one."""

    def abort(self) -> None:
        """See :class:`Executor`."""
        self._aborted.set()

    def refusal(self, curve: Trajectory, now: State) -> str:
        """Why a curve is not executed; empty where it may be."""
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
        if not self._busy.acquire(blocking=False):
            raise InvalidRequestError("another curve is being executed; abort it first")
        try:
            self._aborted.clear()
            if reason := self.refusal(curve, self.state()):
                raise InvalidRequestError(reason)
            return self._followed(curve, watch)
        finally:
            self._busy.release()

    def _followed(self, curve: Trajectory, watch: Watch | None) -> Executed:
        began, reason, lost = 0.0, "", True
        rows: list[tuple[float, FloatArray, FloatArray]] = []
        with self.stream() as ticks:
            for time in ticks:
                now = min(time - began, curve.duration)
                reference, measured = curve.at(now), self.state()
                self.command(reference)
                error = np.abs(reference.q - measured.q)
                due = not rows or time - rows[-1][0] >= 1.0 / self.guard.record - 1e-9
                if due or now >= curve.duration:
                    rows.append((time, reference.q, measured.q))
                if not reason:
                    reason = self._why_not(time, error, measured, watch if due else None)
                    if reason:  # from here on another curve, to rest
                        curve, began = stopped(self.robot, reference), time
                        continue
                if now >= curve.duration:
                    lost = False
                    break
        if lost:
            reason = reason or "control of the arm was lost"
        times, wanted, found = (np.array(column) for column in zip(*rows, strict=True))
        largest = float(np.abs(wanted - found).max())
        return Executed(
            not reason, reason, frozen(times), frozen(wanted), frozen(found), largest
        )  # fmt: skip

    def _why_not(self, time: float, error: FloatArray, measured: State, watch: Watch | None) -> str:
        if self._aborted.is_set():
            return "it was aborted"
        joint = int(np.argmax(error))
        if error[joint] > self.guard.tracking:
            name = self.robot.joint_names[joint]
            return f"{name} was {error[joint]:.3g} from the curve at {time:.3f} s"
        if watch is not None and watch(time, measured):
            return f"watch ended it at {time:.3f} s"
        return ""
