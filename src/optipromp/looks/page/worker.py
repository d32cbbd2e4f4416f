"""The thread of a window: jobs in order, of each kind only the newest."""

import sys
import threading
import time
import traceback
from collections.abc import Callable

Job = Callable[[], None]
CLOCK_RATE = 20.0  # [Hz] of a clock that runs


class Worker:
    """Runs jobs one after another. A new job of a kind takes the place of a waiting one.

    Args:
        tick: called with the seconds since the last call, while :attr:`running` and nothing waits.
        failed: called with the error of a job, which is also printed on standard error.
    """

    def __init__(self, tick: Callable[[float], None], failed: Callable[[Exception], None]) -> None:
        self._tick, self._failed = tick, failed
        self._jobs: dict[str, Job] = {}
        self._ready = threading.Condition()
        self._alive, self._busy = True, False
        self.running = False
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def post(self, kind: str, job: Job) -> None:
        """Queue a job, in place of a waiting one of its kind."""
        with self._ready:
            self._jobs.pop(kind, None)
            self._jobs[kind] = job
            self._ready.notify_all()

    def drop(self, kind: str) -> None:
        """Forget a waiting job."""
        with self._ready:
            self._jobs.pop(kind, None)

    def wait(self, seconds: float = 60.0) -> bool:
        """Wait until no job is left; False where the time runs out first."""
        with self._ready:
            return self._ready.wait_for(lambda: not (self._jobs or self._busy), seconds)

    def stop(self) -> None:
        """End the thread after its present job."""
        with self._ready:
            self._alive = False
            self._jobs.clear()
            self._ready.notify_all()
        if threading.current_thread() is not self._thread:
            self._thread.join(timeout=10.0)

    def _run(self) -> None:
        last = time.monotonic()
        while True:
            with self._ready:
                if not self._jobs and self._alive:
                    self._ready.wait(1.0 / CLOCK_RATE if self.running else None)
                if not self._alive:
                    return
                kind = next(iter(self._jobs), None)
                job = None if kind is None else self._jobs.pop(kind)
                self._busy = job is not None
            now = time.monotonic()
            try:
                if job is not None:
                    job()
                elif self.running:
                    self._tick(now - last)
            except Exception as error:  # the window stays, and says so
                traceback.print_exc(file=sys.stderr)
                self._failed(error)
            last = now
            with self._ready:
                self._busy = False
                self._ready.notify_all()
