"""A page as a browser has it open."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from queue import Queue
from typing import Any

PATIENCE = 180.0  # [s] pictures are drawn by the processor here, beside all else
SMALL, TALL = {"width": 400, "height": 300}, {"width": 390, "height": 844}  # [pixel] of a tab


def idle(worker: Any) -> None:
    """Wait until a window's thread has done its jobs, and those that they have posted."""
    left: Queue[int] = Queue()
    while True:
        worker.post("idle", lambda: left.put(len(worker._jobs)))
        if not left.get(timeout=PATIENCE):
            return


@dataclass
class Opened:
    """A page of the server in a browser tab, and the server's side of it."""

    page: Any
    tab: Any
    window: Any
    errors: list[str]

    @property
    def panel(self) -> Any:
        """The controls."""
        return self.window.panel

    def press(self, label: str) -> None:
        """Press a button, and wait until all it causes is done."""
        button = self.tab.get_by_role("button", name=label, exact=True)
        self.until(button.is_enabled, f"{label} stays disabled")
        button.dispatch_event("click")
        time.sleep(0.3)
        self.settle()

    def show(self, tab: str) -> None:
        """Bring a tab of the panel to the front; a browser that draws may miss a click."""
        button = self.tab.get_by_role("tab", name=tab)

        def shown() -> bool:
            if button.get_attribute("aria-selected") == "true":
                return True
            button.dispatch_event("click")
            return False

        self.until(shown, f"{tab} stays behind")

    def settle(self) -> None:
        """Wait until the window's thread has nothing left to do."""
        idle(self.window.worker)
        assert "error: " not in self.panel.status.content  # a job broke off

    def do(self, job: Callable[[], None]) -> None:
        """Have a job done in the window's thread."""
        self.window.worker.post(f"test {time.monotonic()}", job)
        self.settle()

    def drag(self, name: str, to: Any, phase: str = "end") -> None:
        """Drag the handle of a thing to a point (3,) [m], and wait until all it causes is done."""
        self.do(lambda: self.window.select(name))
        self.window.handle.drag(to, phase, time.perf_counter())
        self.settle()

    def listed(self, label: str, words: str, *, red: bool | None = None) -> None:
        """Wait until the table has such a row, red or not."""
        row = self.tab.locator("tr").filter(has_text=label).filter(has_text=words)
        row.first.wait_for(timeout=1e3 * PATIENCE, state="attached")
        if red is not None:
            assert ("600" in (row.first.get_attribute("style") or "")) == red, label

    def until(self, holds: Callable[[], bool], what: str | list[str]) -> None:
        """Wait until something holds."""
        end = time.monotonic() + PATIENCE
        while not holds():
            assert time.monotonic() < end, what
            self.tab.wait_for_timeout(50)

    def told(self, words: str) -> None:
        """Wait until the page's state says so."""
        self.tab.locator(".status").filter(has_text=words).wait_for(
            timeout=1e3 * PATIENCE, state="attached"
        )
