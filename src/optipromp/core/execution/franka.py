"""Executors for a Franka arm, by ``franky`` or ``panda-python``; not tested on a real arm.

Both stream joint references to an impedance controller at up to 1 kHz. Making an executor imports
the package.
"""

import time
from abc import abstractmethod
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np

from optipromp.core.errors import InvalidRequestError
from optipromp.core.execution.executor import Follower, Guard
from optipromp.core.robots.library import load_robot
from optipromp.core.robots.model import Robot
from optipromp.core.trajectory import State

STIFFNESS = (600.0, 600.0, 600.0, 600.0, 250.0, 150.0, 50.0)  # [N m/rad] default of panda-python
DAMPING = (50.0, 50.0, 50.0, 20.0, 20.0, 20.0, 10.0)  # [N m s/rad] default of panda-python
FRANKY_RATE = 500.0  # [Hz] of franky's references, chosen


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

    def __init__(
        self,
        host: str,
        robot: Robot | None = None,
        guard: Guard | None = None,
        *,
        stiffness: Sequence[float] = STIFFNESS,
        damping: Sequence[float] = DAMPING,
    ) -> None:
        self._connect(host)
        super().__init__(robot or load_robot("panda"), guard)
        self._gains = {"stiffness": np.array(stiffness), "damping": np.array(damping)}

    @abstractmethod
    def _connect(self, host: str) -> None:
        """Import the package and connect to the arm."""

    @abstractmethod
    def _read(self) -> Any:
        """The state of libfranka."""

    def state(self) -> State:
        """Measured positions and velocities, commanded accelerations."""
        found = self._read()
        return State(np.array(found.q), np.array(found.dq), np.array(found.ddq_d))


def _since(ticks: Callable[[], bool]) -> Iterator[float]:
    """Times since the first tick [s], until ``ticks`` returns False."""
    began = None
    while ticks():
        now = time.perf_counter()
        began = now if began is None else began
        yield now - began


class PandaPy(_Franka):
    """By ``panda-python`` (extra ``panda-py``): ``JointPosition``, a joint impedance controller.

    Args:
        host: of the arm.
        robot: joints and limits; None: the built-in Panda.
        guard: limits for refusing and stopping.
        stiffness: (7,) [N m/rad].
        damping: (7,) [N m s/rad].

    Raises:
        InvalidRequestError: panda-python is not installed.
    """

    def _connect(self, host: str) -> None:
        module = _module("panda_py", "panda-python")
        self._controllers = _module("panda_py.controllers", "panda-python")
        self.panda = module.Panda(host)
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

    It takes the arguments of :class:`PandaPy`.

    Raises:
        InvalidRequestError: franky is not installed.
    """

    def _connect(self, host: str) -> None:
        self._franky = _module("franky", "franky-control")
        self.arm = self._franky.Robot(host)
        self._tracker: Any = None

    def _read(self) -> Any:
        return self.arm.state

    @contextmanager
    def stream(self) -> Iterator[Iterator[float]]:
        made = self._franky.JointImpedanceTracker(self.arm, period=1.0 / FRANKY_RATE, **self._gains)
        with made as self._tracker:
            yield _since(lambda: self._tracker.tick() is not None)

    def command(self, reference: State) -> None:
        self._tracker.set_target(reference.q, reference.velocity)
