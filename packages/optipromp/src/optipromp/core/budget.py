"""The limits of a plan's cost: time, steps of work, and memory."""

import math
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field

from optipromp.core.errors import InvalidRequestError

LEAST_MEMORY = 800_000_000
"""Least address space [bytes]; with less, LLVM waits without end and ignores signals."""


def check_memory() -> None:
    """Refuse to begin if the process has too little memory to compile kernels."""
    if sys.platform != "win32":
        import resource

        limit, _ = resource.getrlimit(resource.RLIMIT_AS)
        if 0 <= limit < LEAST_MEMORY:
            raise InvalidRequestError(
                f"memory is limited to {limit / 1e6:.0f} MB (ulimit -v): "
                f"must be at least {LEAST_MEMORY / 1e6:.0f}"
            )


class _Thread(threading.local):
    paused = 0.0
    between: Callable[[int], object] | None = None


_thread = _Thread()


def clock() -> float:
    """This thread's time [s]: ``time.perf_counter()`` without :func:`pauses <pause>`."""
    return time.perf_counter() - _thread.paused


def pause(seconds: float) -> None:
    """Exclude the last ``seconds`` from this thread's :func:`clock`: a kernel was compiled."""
    _thread.paused += seconds


def between_steps(call: Callable[[int], object] | None) -> None:
    """Set a function that this thread calls at every :func:`step` with its weight; None: none.

    A thread that works in slices waits there for its next slice.
    """
    _thread.between = call


def step(weight: int = 1) -> None:
    """A place at which the work of this thread may wait, after work of ``weight`` steps."""
    if _thread.between is not None:
        _thread.between(weight)


@dataclass
class Budget:
    """The limits of a plan's cost; :meth:`spent` counts the steps of the work.

    A step is an iteration of an optimiser, a candidate of a search, a batch of samples of a tree,
    or a choice of what to try next. The number of steps depends on the input only, so a limit of
    steps cuts a plan at the same place on every machine. Time runs out when two further steps as
    long as the longest would pass the deadline: a step, and the judgement after the last step.

    ``deadline``: of :func:`clock` [s]. ``steps``: the most steps. ``say``: called with a short text
    as each part of the work begins.
    """

    deadline: float = math.inf
    steps: float = math.inf
    say: Callable[[str], object] = str  # no effect
    used: int = field(default=0, init=False)
    cut: bool = field(default=False, init=False)
    longest: float = field(default=0.0, init=False)
    last: float = field(default=math.inf, init=False)

    @property
    def ending(self) -> str:
        """The limit that ran out, in words."""
        return "effort ran out" if self.used > self.steps else "time ran out"

    def spent(self) -> bool:
        """Count a step; True if there may be no further step."""
        step()
        now = clock()
        self.longest = max(self.longest, now - self.last)
        self.last, self.used = now, self.used + (not self.cut)
        self.cut |= self.used > self.steps or now + 2.0 * self.longest > self.deadline
        return self.cut
