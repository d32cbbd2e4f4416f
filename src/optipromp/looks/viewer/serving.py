"""viser's server, made to accept connections only from pages that it served itself."""

import asyncio
import http
import inspect
import io
import logging
import sys
import warnings
from collections.abc import Awaitable, Callable
from contextlib import redirect_stdout
from typing import Any
from urllib.parse import urlsplit

from optipromp.core.errors import InvalidRequestError, installed_by
from optipromp.core.shown import printable

NEEDED = f"a 3-D view needs viser: {installed_by('view')}"
HERE = frozenset({"localhost", "127.0.0.1", "::1"})
ALONE = {"X-Frame-Options": "DENY", "Content-Security-Policy": "frame-ancestors 'none'"}
"""Headers that keep other pages from showing this one in a frame, and so from stealing clicks."""
WORDS = 200  # letters of the line about a broken connection, at most
SILENT = logging.getLogger(f"{__name__}.websockets")
SILENT.setLevel(logging.CRITICAL + 1)  # it would write a traceback of every malformed request


def listening(host: str, port: int) -> Any:
    """A silent viser server, without the tunnel by which any window could publish the page.

    A website that is open in this machine's browser can connect to any port of the machine, and
    viser accepts it. So a request is refused if its ``Origin`` is not the page's address. At an
    address of this machine, a request to any other host name is refused too (DNS rebinding). No
    other page may show this one in a frame. A malformed message ends its connection, with a line on
    standard error.
    """
    try:
        import viser
        from websockets.asyncio import server as module
    except ImportError:
        raise InvalidRequestError(NEEDED) from None
    sockets: Any = module
    serve = sockets.serve

    def guarded(
        handler: Handler, *args: Any, process_request: Callable[..., Any], **settings: Any
    ) -> Any:
        async def checked(connection: Any, request: Any) -> Any:
            if not is_own(request.headers.get("Origin"), request.headers.get("Host", ""), host):
                return connection.respond(http.HTTPStatus.FORBIDDEN, "another origin\n")
            answer = process_request(connection, request)
            answer = await answer if inspect.isawaitable(answer) else answer
            if answer is not None:
                answer.headers.update(ALONE)
            return answer

        return serve(_tolerant(handler), *args, process_request=checked, logger=SILENT, **settings)

    # viser has no setting for it, and has called `serve` when its constructor returns
    sockets.serve = guarded
    try:
        with redirect_stdout(io.StringIO()):
            server: Any = viser.ViserServer(host=host, port=port, verbose=False)
    finally:
        sockets.serve = serve
    server.request_share_url = lambda *_, **__: None
    for told in ("Queued a .* on a closed connection", r"\[viser\] .* does not match annotation"):
        warnings.filterwarnings("ignore", told, UserWarning)  # windows close at any moment
    return server


Handler = Callable[[Any], Awaitable[None]]


def _tolerant(handler: Handler) -> Handler:
    """A handler of connections that ends a broken one with a line instead of a traceback."""

    def tell(error: BaseException | None) -> None:
        words = printable(f"{type(error).__name__}: {error}")[:WORDS]
        sys.stderr.write(f"a window sent what is no message: {words}\n")

    async def handle(connection: Any) -> None:
        loop = asyncio.get_running_loop()
        loop.set_exception_handler(lambda _, context: tell(context.get("exception")))
        try:
            await handler(connection)
        except Exception as error:  # viser's reader raises whatever goes wrong in it
            tell(error)
            await connection.close(1007, "no message")

    return handle


def is_own(origin: str | None, asked: str, host: str) -> bool:
    """Whether a request comes from the page that listens at ``host``, or from no browser.

    ``origin``: header of the request, of the page that makes it; None where there is none.
    ``asked``: the header ``Host``. ``host``: that the server listens at.
    """
    try:
        name = urlsplit(f"//{asked}").hostname
        own = urlsplit(origin or f"//{asked}").netloc.lower() == asked.lower()
    except ValueError:
        return False
    return own and (host not in HERE or name in HERE)
