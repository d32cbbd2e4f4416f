"""Who may speak to the page's server, what they send, and windows that come and go: without a
browser."""

import asyncio
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any

import msgspec
import pytest
import viser

from optipromp.core.errors import InvalidRequestError
from optipromp.looks.viewer.serving import is_own
from optipromp_page.panel import Page, plain_name
from optipromp_page.stage import open_source

CAMERA = {
    "type": "ViewerCameraMessage", "wxyz": [1.0, 0.0, 0.0, 0.0], "position": [1.0, 1.0, 1.0],
    "fov": 1.0, "near": 0.01, "far": 100.0, "look_at": [0.0, 0.0, 0.0],
    "up_direction": [0.0, 0.0, 1.0], "image_height": 300, "image_width": 400,
}  # fmt: skip


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Page]:
    page = Page(
        replace(open_source("scenario-3"), reach=True), out=tmp_path_factory.mktemp("saved")
    )
    yield page
    page.stop()


def sent(
    page: Page, message: Any = None, stay: float = 0.0, origin: str | None = None,
    name: str = "localhost",
) -> int | None:  # fmt: skip
    """The code with which the server refuses a window of an origin, or closes it once it sends a
    message; None: it does neither."""
    from websockets.asyncio.client import connect
    from websockets.exceptions import ConnectionClosed, InvalidStatus
    from websockets.typing import Subprotocol

    async def window() -> int | None:
        protocol, port = Subprotocol(f"viser-v{viser.__version__}"), page.server.get_port()
        url, given = f"ws://{name}:{port}", {"origin": origin, "host": "localhost"}
        try:
            async with connect(url, subprotocols=[protocol], max_size=None, **given) as socket:
                if message is not None:
                    await socket.send(message)
                end = time.monotonic() + stay
                while (left := end - time.monotonic()) > 0.0:
                    await asyncio.wait_for(socket.recv(), left)
        except InvalidStatus as refused:
            return refused.response.status_code
        except ConnectionClosed as closed:
            return None if closed.rcvd is None else closed.rcvd.code
        except TimeoutError:
            pass
        return None

    with ThreadPoolExecutor(1) as thread:  # a browser of an earlier test keeps a loop in this one
        return thread.submit(lambda: asyncio.run(window())).result()


def test_the_page_itself_and_programs_connect_and_no_other_website(page: Page) -> None:
    assert sent(page, origin=page.url) is None
    assert sent(page) is None
    assert sent(page, origin="https://evil.example:8080") == 403


@pytest.mark.parametrize(
    "message",
    ["text", b"", b"\xff\x00", msgspec.msgpack.encode([1]), msgspec.msgpack.encode({"type": "x"}),
     msgspec.msgpack.encode({**CAMERA, "position": None})],
)  # fmt: skip
def test_what_is_no_message_ends_its_window_in_a_line(page, message, capfd):
    assert sent(page, message, 20.0) == 1007
    told = capfd.readouterr().err
    assert told.startswith("a window sent what is no message: ")
    assert told.count("\n") == 1


def test_a_name_that_was_made_to_mean_this_machine_is_refused(page: Page) -> None:
    url = page.url.replace("localhost", "evil.example")
    assert sent(page, origin=url, name="evil.example") == 403
    request = urllib.request.Request(page.url, headers={"Host": "evil.example"})
    with pytest.raises(urllib.error.HTTPError, match="403"):
        urllib.request.urlopen(request)


@pytest.mark.parametrize(
    ("origin", "asked", "host", "own"),
    [
        (None, "localhost:1", "localhost", True),
        ("http://localhost:1", "localhost:1", "127.0.0.1", True),
        ("http://[::1]:1", "[::1]:1", "localhost", True),
        ("http://robot.lab:1", "robot.lab:1", "0.0.0.0", True),
        ("http://evil:1", "robot.lab:1", "0.0.0.0", False),
        ("http://localhost:2", "localhost:1", "localhost", False),
        ("null", "localhost:1", "localhost", False),
        ("http://robot.lab:1", "robot.lab:1", "localhost", False),
        ("http://[::1", "localhost:1", "localhost", False),
        (None, "", "localhost", False),
    ],
)
def test_own(origin: str | None, asked: str, host: str, own: bool) -> None:
    assert is_own(origin, asked, host) is own


@pytest.mark.parametrize("path", ["/", "/none", "/" + "a" * 5000])
def test_no_other_page_may_frame_this_one(page, path, capfd):
    try:
        with urllib.request.urlopen(page.url + path) as answer:
            headers = answer.headers
    except urllib.error.HTTPError as refused:
        headers = refused.headers
    if len(path) < 100:  # viser ends the others without an answer of its own
        assert headers["X-Frame-Options"] == "DENY"
        assert headers["Content-Security-Policy"] == "frame-ancestors 'none'"
    assert capfd.readouterr().err == ""


def test_windows_that_leave_at_once_leave_nothing(page: Page) -> None:
    for k in range(40):
        sent(page, msgspec.msgpack.encode(CAMERA), (0.0, 0.01, 0.02, 0.05)[k % 4])
    end = time.monotonic() + 60.0
    while page.windows and time.monotonic() < end:
        time.sleep(0.1)
    assert not page.windows


@pytest.mark.parametrize("name", ["a\nb", "../a", "..", "", "\u202ea", "a" * 100])
def test_what_is_no_plain_name_is_not_saved_under(name: str) -> None:
    with pytest.raises(InvalidRequestError, match="plain file name"):
        plain_name(name)
    assert plain_name(" a b-1.ü ") == "a b-1.ü"
