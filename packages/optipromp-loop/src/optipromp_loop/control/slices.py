"""Work that runs in the time that the controller's cycles leave over."""

import math
import threading
import time
from collections.abc import Callable
from typing import Generic, TypeVar

from optipromp.core.budget import between_steps, pause

T = TypeVar("T")


class _Dropped(BaseException):
    """Ends a thread whose result is no longer wanted."""


class Sliced(Generic[T]):
    """Work in a thread that runs only while a cycle of the controller lends it time.

    On one core, a search of 50 ms must not delay a cycle of 20 ms. The thread waits at every
    :func:`optipromp.core.budget.step` until the next slice. Never do two threads run at once, so
    the same slices give the same result. Time between two slices does not count for deadlines.
    """

    def __init__(self, work: Callable[[], T]) -> None:
        self._work = work
        self._go, self._back = threading.Semaphore(0), threading.Semaphore(0)
        self._steps, self._until = 0.0, 0.0
        self._dropped, self.done = False, False
        self._error: BaseException | None = None
        self._thread = threading.Thread(target=self._run, daemon=True)

    def lend(self, steps: float = math.inf, seconds: float = math.inf) -> bool:
        """Let the work run for some ``steps`` or ``seconds`` [s], at least one step.

        Returns: Whether the work is done.
        """
        if self.done:
            return True
        self._steps, self._until = steps, time.perf_counter() + seconds
        if not self._thread.ident:
            self._thread.start()
        else:
            self._go.release()
        self._back.acquire()
        return self.done

    def result(self) -> T:
        """The result of work that is done. Raises the error of work that failed."""
        assert self.done
        if self._error is not None:
            raise self._error
        return self._result

    def drop(self) -> None:
        """Give the work up; its thread ends at the next step."""
        if self._thread.ident and not self.done:
            self._dropped = True
            self._go.release()
            self._thread.join()
        self.done = True

    def _run(self) -> None:
        between_steps(self._wait)
        try:
            self._result = self._work()
        except _Dropped:
            pass
        except BaseException as error:  # it is raised where the result is read
            self._error = error
        self.done = True
        self._back.release()

    def _wait(self, weight: int) -> None:
        self._steps -= weight
        if self._steps > 0 and time.perf_counter() < self._until:
            return
        began = time.perf_counter()
        self._back.release()
        self._go.acquire()
        pause(time.perf_counter() - began)
        if self._dropped:
            raise _Dropped
