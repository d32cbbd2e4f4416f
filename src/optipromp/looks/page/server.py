"""The page's server, with a state for each browser window."""

import asyncio
import io
import socket
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any

from optipromp.core.errors import InvalidRequestError
from optipromp.looks.page.panel import Panel
from optipromp.looks.page.replay import Source
from optipromp.looks.page.window import Window
from optipromp.looks.viewer.serving import listening


class Page:
    """A running server. :meth:`stop` ends it and its threads.

    ``source``: that each window opens with. ``host``: address of the server. ``port``: of the
    server; 0: any free one. ``out``: folder into which windows save.
    """

    def __init__(
        self, source: Source, *, host: str = "localhost", port: int = 0, out: Path = Path("out")
    ) -> None:
        self.source, self.out = source, out
        self.windows: dict[int, Window] = {}
        self.panels: dict[int, Panel] = {}
        self.server = listening(host, usable(host, port))
        self.url = f"http://{host}:{self.server.get_port()}"
        self.server.on_client_connect(self._enter)
        self.server.on_client_disconnect(self._leave)

    # Coroutines, since viser awaits these in the order of events. It gives functions to threads in
    # any order: a window that leaves before it enters would stay for ever.

    async def _enter(self, client: Any) -> None:
        window = Window(client, self.source, self.out)
        self.windows[client.client_id] = window

        def begin() -> None:
            panel = Panel(window)
            if client.client_id in self.windows:  # it may have left meanwhile
                self.panels[client.client_id] = panel
                window.start()

        window.post("start", begin)

    async def _leave(self, client: Any) -> None:
        window = self.windows.pop(client.client_id, None)
        if window is not None:
            await asyncio.to_thread(window.close)
        self.panels.pop(client.client_id, None)

    def stop(self) -> None:
        """Close every window and the server."""
        for window in list(self.windows.values()):
            window.close()
        with redirect_stdout(io.StringIO()):
            self.server.stop()


def usable(host: str, port: int) -> int:
    """The port, or a free one for 0."""
    try:
        family, *_ = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        with socket.socket(family, socket.SOCK_STREAM) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind((host, port))
            return int(probe.getsockname()[1])
    except (OSError, OverflowError) as error:
        raise InvalidRequestError(f"cannot listen at {host}:{port}: {error}") from None
