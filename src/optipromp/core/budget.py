"""What a plan may cost: time, steps of work, and memory."""

import math
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field

from optipromp.core.errors import InvalidRequestError

LEAST_MEMORY = 800_000_000
"""[bytes] of address space; with less, LLVM waits without end and hears no signal."""


def check_memory() -> None:
    """Refuse to begin where the process may have too little memory to compile kernels in.

    Raises:
        InvalidRequestError: the address space is limited below :data:`LEAST_MEMORY`.
    """
    if sys.platform != "win32":
        import resource

        limit, _ = resource.getrlimit(resource.RLIMIT_AS)
        if 0 <= limit < LEAST_MEMORY:
            raise InvalidRequestError(
                f"memory is limited to {limit / 1e6:.0f} MB (ulimit -v): "
                f"must be at least {LEAST_MEMORY / 1e6:.0f}"
            )


class _Pauses(threading.local):
    seconds = 0.0


_pauses = _Pauses()


def clock() -> float:
    """Seconds of this thread's clock: ``time.perf_counter()`` less :func:`pauses <pause>`."""
    return time.perf_counter() - _pauses.seconds


def pause(seconds: float) -> None:
    """Count so many seconds just past as none; a kernel was compiled in them."""
    _pauses.seconds += seconds


@dataclass
class Budget:
    """What a plan may cost. It is asked once in each step of the work, and counts them.

    A step is an iteration of an optimiser, a candidate of a search, a batch of samples of a tree,
    or a choice of what to try next. How many a plan takes depends on nothing but its input: steps
    cut it at the same place on every machine. Time is over when two more steps as long as the
    longest so far would overrun it: one, and the judgement that follows the last.

    Args:
        deadline: of :func:`clock` [s].
        steps: how many there may be.
        say: called with a short text as each part of the work begins.
    """

    deadline: float = math.inf
    steps: float = math.inf
    say: Callable[[str], object] = str  # nobody hears it
    used: int = field(default=0, init=False)
    cut: bool = field(default=False, init=False)
    longest: float = field(default=0.0, init=False)
    last: float = field(default=math.inf, init=False)

    @property
    def ending(self) -> str:
        """What of it ran out."""
        return "effort ran out" if self.used > self.steps else "time ran out"

    def spent(self) -> bool:
        """Count a step; whether there may be no further one."""
        now = clock()
        self.longest = max(self.longest, now - self.last)
        self.last, self.used = now, self.used + (not self.cut)
        self.cut |= self.used > self.steps or now + 2.0 * self.longest > self.deadline
        return self.cut
