"""An executor for a Franka arm, by ``franky``; not tested on a real arm.

It streams joint references to an impedance controller. Making one imports the package.

>>> from optipromp import plan
>>> from optipromp_loop.control import Franky
>>> arm = Franky("robot.local")  # doctest: +SKIP
>>> made = plan("scenario-3", start_state=arm.state())  # doctest: +SKIP
>>> arm.execute(made.trajectory.slowed(5.0)).finished  # doctest: +SKIP
True
"""

import queue
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any, Self

import numpy as np

from optipromp.core.arrays import FloatArray
from optipromp.core.errors import ExecutionError, InvalidRequestError
from optipromp.core.execution.executor import Follower, Guard, in_words
from optipromp.core.robots.library import load_robot
from optipromp.core.robots.model import Robot
from optipromp.core.trajectory import State

# [N m/rad], [N m s/rad] with a stiffer wrist than franky's: dry friction of 0.76, 0.44 and 0.25 N m
# in joints 5 to 7 (the FR3 of franky-sim) leaves at most 2 mrad at rest
STIFFNESS = (600.0, 600.0, 600.0, 600.0, 400.0, 250.0, 150.0)
DAMPING = (50.0, 50.0, 50.0, 30.0, 25.0, 25.0, 17.0)
RATE = 500.0  # [Hz] of references, chosen
CONNECT = 10.0  # [s] longest wait for an arm to answer, chosen


class Franky(Follower):
    """By ``franky-control`` (extra ``franky``): ``JointImpedanceTracker``.

    An arm serves one connection: :meth:`close` it, or use ``with``, before the next. Ticks have
    the arm's own time. Further keywords are those of ``franky.Robot``. Its ``realtime_config`` is
    ``franky.RealtimeConfig.Enforce``; a kernel without PREEMPT_RT needs ``Ignore``.

    Args:
        host: of the arm.
        robot: joints and limits; None: the built-in Panda.
        guard: limits for refusing and stopping.
        stiffness: (7,) [N m/rad].
        damping: (7,) [N m s/rad].

    Raises:
        InvalidRequestError: franky is not installed, or the kernel is no real-time one.
        ExecutionError: the arm cannot be connected to, or does not answer within 10 s.
    """

    synchronous = False

    def __init__(
        self,
        host: str,
        robot: Robot | None = None,
        guard: Guard | None = None,
        *,
        stiffness: Sequence[float] = STIFFNESS,
        damping: Sequence[float] = DAMPING,
        **options: Any,
    ) -> None:
        try:
            import franky
        except ImportError as error:
            raise InvalidRequestError(
                f"franky-control is not installed ({error}); run: pip install franky-control"
            ) from None
        self._franky: Any = franky
        answer = queue.SimpleQueue[Any]()

        def connect() -> None:
            try:
                answer.put(franky.Robot(host, **options))
            except Exception as error:
                answer.put(error)

        threading.Thread(target=connect, daemon=True).start()
        try:
            found = answer.get(timeout=CONNECT)
        except queue.Empty:
            told = f"{host} does not answer within {CONNECT:g} s"
            raise ExecutionError(f"{told}; is another connection to it open?") from None
        if isinstance(found, Exception):
            told = in_words(f"{host} cannot be connected to", found)
            if type(found).__name__ == "RealtimeException":
                hint = "realtime_config=franky.RealtimeConfig.Ignore connects all the same"
                raise InvalidRequestError(f"{told}; {hint}") from found
            raise ExecutionError(told) from found
        self.arm: Any = found
        self._tracker: Any = None
        self._seen: Any = None  # at a tick, until its reference is commanded
        super().__init__(robot or load_robot("panda"), guard)
        self._gains = {"stiffness": np.array(stiffness), "damping": np.array(damping)}

    def close(self) -> None:
        """Abort a motion, and end the connection once it is at rest; then nothing can be asked."""
        self.abort()
        with self._busy:
            self.arm = self._tracker = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _read(self) -> Any:
        """The state of libfranka."""
        if self.arm is None:
            raise ExecutionError("the connection to the arm is closed")
        return self._seen or self.arm.state

    def state(self) -> State:
        """Measured positions and velocities, commanded accelerations."""
        found = self._read()
        return State(np.array(found.q), np.array(found.dq), np.array(found.ddq_d))

    def force(self) -> FloatArray:
        """libfranka's estimate of the force (3,) of the world on the tool, in the base [N].

        libfranka states what the arm does to the world, the opposite.
        """
        return -np.array(self._read().O_F_ext_hat_K, dtype=np.float64)[:3]

    @contextmanager
    def stream(self) -> Iterator[Iterator[float]]:
        made = self._franky.JointImpedanceTracker(self.arm, period=1.0 / RATE, **self._gains)
        with made as self._tracker:
            yield self._ticks()

    def _ticks(self) -> Iterator[float]:
        """The arm's times since the first tick [s]; the arm moves on after a state is measured."""
        began = None
        while self._tracker.tick() is not None:
            self._seen = self.arm.state
            now = float(self._seen.time.to_sec())
            began = now if began is None else began
            yield now - began

    def command(self, reference: State) -> None:
        self._tracker.set_target(reference.q, reference.velocity)
        self._seen = None
