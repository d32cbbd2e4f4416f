"""The Franka adapter, for whose references the time of the simulated arm (``server.py``) waits."""

import socket
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import franky
from tests.franka.server import BEATS

from optipromp.core.trajectory import State
from optipromp_loop.control import Franky


class Paced(Franky):
    """Franky, unchanged, that tells the simulated arm of each reference.

    ``led`` is how long it was under control [s of the arm's time]: between two motions that time
    runs on while Python works, by as much as the machine lets it wait.
    """

    led = 0.0

    def __init__(self, host: str, *of: Any, **more: Any) -> None:
        super().__init__(host, *of, realtime_config=franky.RealtimeConfig.Ignore, **more)
        self._beats = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._beats.connect((host, BEATS))

    def close(self) -> None:
        super().close()
        self._beats.close()

    @property
    def now(self) -> float:
        """The arm's time [s]."""
        return float(self.arm.state.time.to_sec())

    @contextmanager
    def stream(self) -> Iterator[Iterator[float]]:
        began = self.now
        self._beats.send(b"2")  # from the begin of control on
        with super().stream() as ticks:
            try:
                yield ticks
            finally:
                self._beats.send(b"0")
        self.led += self.now - began

    def command(self, reference: State) -> None:
        super().command(reference)
        self._beats.send(b"1")
