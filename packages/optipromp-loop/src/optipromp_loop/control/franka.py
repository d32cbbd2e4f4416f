"""Executors for a Franka arm, by ``franky`` or ``panda-python``; not tested on a real arm.

Both stream joint references to an impedance controller at up to 1 kHz. Making an executor imports
the package.

>>> from optipromp import plan
>>> from optipromp_loop.control import PandaPy  # or Franky
>>> arm = PandaPy("robot.local")  # doctest: +SKIP
>>> made = plan("scenario-3", start_state=arm.state())  # doctest: +SKIP
>>> arm.execute(made.trajectory.slowed(5.0)).finished  # doctest: +SKIP
True
"""

import queue
import threading
import time
from abc import abstractmethod
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, Self

import numpy as np

from optipromp.core.arrays import FloatArray
from optipromp.core.errors import ExecutionError, InvalidRequestError
from optipromp.core.execution.executor import Follower, Guard, in_words
from optipromp.core.robots.library import load_robot
from optipromp.core.robots.model import Robot
from optipromp.core.trajectory import State

STIFFNESS = (600.0, 600.0, 600.0, 600.0, 250.0, 150.0, 50.0)  # [N m/rad] default of panda-python
DAMPING = (50.0, 50.0, 50.0, 20.0, 20.0, 20.0, 10.0)  # [N m s/rad] default of panda-python
# [N m/rad], [N m s/rad] with a stiffer wrist: dry friction of 0.76, 0.44 and 0.25 N m in
# joints 5 to 7 (the FR3 of franky-sim) leaves at most 2 mrad at rest
FRANKY_STIFFNESS = (600.0, 600.0, 600.0, 600.0, 400.0, 250.0, 150.0)
FRANKY_DAMPING = (50.0, 50.0, 50.0, 30.0, 25.0, 25.0, 17.0)
FRANKY_RATE = 500.0  # [Hz] of franky's references, chosen
CONNECT = 10.0  # [s] longest wait for an arm to answer, chosen


def _module(name: str, package: str) -> Any:
    import importlib

    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise InvalidRequestError(
            f"{package} is not installed ({error}); run: pip install {package}"
        ) from None


class _Franka(Follower):
    """The base of both adapters: joints and limits, gains, and the state of libfranka."""

    synchronous = False
    stiffness, damping = STIFFNESS, DAMPING

    def __init__(
        self,
        host: str,
        robot: Robot | None = None,
        guard: Guard | None = None,
        *,
        stiffness: Sequence[float] | None = None,
        damping: Sequence[float] | None = None,
        **options: Any,
    ) -> None:
        self._connect(host, options)
        super().__init__(robot or load_robot("panda"), guard)
        self._gains = {
            "stiffness": np.array(self.stiffness if stiffness is None else stiffness),
            "damping": np.array(self.damping if damping is None else damping),
        }

    @abstractmethod
    def _connect(self, host: str, options: dict[str, Any]) -> None:
        """Import the package and connect to the arm."""

    @abstractmethod
    def _read(self) -> Any:
        """The state of libfranka."""

    def state(self) -> State:
        """Measured positions and velocities, commanded accelerations."""
        found = self._read()
        return State(np.array(found.q), np.array(found.dq), np.array(found.ddq_d))

    def force(self) -> FloatArray:
        """libfranka's estimate of the force (3,) of the world on the tool, in the base [N].

        libfranka states what the arm does to the world, the opposite.
        """
        return -np.array(self._read().O_F_ext_hat_K, dtype=np.float64)[:3]


def _since(
    ticks: Callable[[], bool], clock: Callable[[], float] = time.perf_counter
) -> Iterator[float]:
    """Times of a ``clock`` since the first tick [s], until ``ticks`` returns False."""
    began = None
    while ticks():
        now = clock()
        began = now if began is None else began
        yield now - began


class PandaPy(_Franka):
    """By ``panda-python`` (extra ``panda-py``): ``JointPosition``, a joint impedance controller.

    Further keywords are those of ``panda_py.Panda``.

    Args:
        host: of the arm.
        robot: joints and limits; None: the built-in Panda.
        guard: limits for refusing and stopping.
        stiffness: (7,) [N m/rad].
        damping: (7,) [N m s/rad].

    Raises:
        InvalidRequestError: panda-python is not installed.
    """

    def _connect(self, host: str, options: dict[str, Any]) -> None:
        module = _module("panda_py", "panda-python")
        self._controllers = _module("panda_py.controllers", "panda-python")
        self.panda = module.Panda(host, **options)
        self._controller: Any = None

    def _read(self) -> Any:
        return self.panda.get_state()

    @contextmanager
    def stream(self) -> Iterator[Iterator[float]]:
        self._controller = self._controllers.JointPosition(**self._gains)
        self._controller.set_control(np.array(self._read().q))
        self.panda.start_controller(self._controller)
        try:
            with self.panda.create_context(frequency=1000.0) as context:
                yield _since(context.ok)
        finally:
            self.panda.stop_controller()
            self._controller = None

    def command(self, reference: State) -> None:
        self._controller.set_control(reference.q, reference.velocity)


class Franky(_Franka):
    """By ``franky-control`` (extra ``franky``): ``JointImpedanceTracker``.

    An arm serves one connection: :meth:`close` it, or use ``with``, before the next. Ticks have
    the arm's own time. Arguments are as of :class:`PandaPy`; further keywords are those of
    ``franky.Robot``. Its ``realtime_config`` is ``franky.RealtimeConfig.Enforce``; a kernel without
    PREEMPT_RT needs ``Ignore``.

    Raises:
        InvalidRequestError: franky is not installed, or the kernel is no real-time one.
        ExecutionError: the arm cannot be connected to, or does not answer within 10 s.
    """

    stiffness, damping = FRANKY_STIFFNESS, FRANKY_DAMPING

    def _connect(self, host: str, options: dict[str, Any]) -> None:
        self._franky = franky = _module("franky", "franky-control")
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
        if self.arm is None:
            raise ExecutionError("the connection to the arm is closed")
        return self._seen or self.arm.state

    @contextmanager
    def stream(self) -> Iterator[Iterator[float]]:
        def now() -> float:  # of the state that is measured at this tick: the arm moves on
            self._seen = self.arm.state
            return float(self._seen.time.to_sec())

        made = self._franky.JointImpedanceTracker(self.arm, period=1.0 / FRANKY_RATE, **self._gains)
        with made as self._tracker:
            yield _since(lambda: self._tracker.tick() is not None, now)

    def command(self, reference: State) -> None:
        self._tracker.set_target(reference.q, reference.velocity)
        self._seen = None
