"""viser's server, made to hear nobody but pages that it served itself."""

import http
import inspect
import io
from collections.abc import Callable
from contextlib import redirect_stdout
from typing import Any
from urllib.parse import urlsplit

from optipromp.errors import InvalidRequestError

NEEDED = "a 3-D view needs viser: pip install 'optipromp[view]'"
HERE = frozenset({"localhost", "127.0.0.1", "::1"})


def listening(host: str, port: int) -> Any:
    """A silent viser server, without its tunnel: any window could publish the page by it.

    A website that this machine's browser has open can connect to any port of the machine, and
    viser lets it. So a request is refused whose ``Origin`` is not the page's own address, and, at
    an address of this machine, one to another name (a name that was made to mean this machine).

    Raises:
        InvalidRequestError: viser is not installed.
    """
    try:
        import viser
        from websockets.asyncio import server as module
    except ImportError:
        raise InvalidRequestError(NEEDED) from None
    sockets: Any = module
    serve = sockets.serve

    def guarded(*args: Any, process_request: Callable[..., Any], **settings: Any) -> Any:
        async def checked(connection: Any, request: Any) -> Any:
            if not is_own(request.headers.get("Origin"), request.headers.get("Host", ""), host):
                return connection.respond(http.HTTPStatus.FORBIDDEN, "another origin\n")
            answer = process_request(connection, request)
            return await answer if inspect.isawaitable(answer) else answer

        return serve(*args, process_request=checked, **settings)

    # viser has no setting for it, and has called `serve` when its constructor returns
    sockets.serve = guarded
    try:
        with redirect_stdout(io.StringIO()):
            server: Any = viser.ViserServer(host=host, port=port, verbose=False)
    finally:
        sockets.serve = serve
    server.request_share_url = lambda *_, **__: None
    return server


def is_own(origin: str | None, asked: str, host: str) -> bool:
    """Whether a request comes from the page that listens at ``host``, or from no browser.

    Args:
        origin: header of the request, of the page that makes it; None where there is none.
        asked: the header ``Host``.
        host: that the server listens at.
    """
    try:
        name = urlsplit(f"//{asked}").hostname
        own = urlsplit(origin or f"//{asked}").netloc.lower() == asked.lower()
    except ValueError:
        return False
    return own and (host not in HERE or name in HERE)
