"""Who may speak to the page's server."""

import asyncio
import urllib.error
import urllib.request
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

import pytest

pytest.importorskip("viser")

from optipromp.looks.viewer.serving import is_own, listening
from optipromp_page.panel import usable


@pytest.fixture(scope="module")
def port() -> Iterator[int]:
    free = usable("localhost", 0)
    server = listening("localhost", free)
    yield server.get_port()
    server.stop()


def connect(port: int, origin: str | None, name: str = "localhost") -> bool:
    """Whether a browser's page of an origin gets a connection."""
    from websockets.asyncio.client import connect as open_socket
    from websockets.exceptions import InvalidStatus
    from websockets.typing import Origin, Subprotocol

    async def attempt() -> bool:
        try:
            async with open_socket(
                f"ws://{name}:{port}",
                origin=None if origin is None else Origin(origin),
                subprotocols=[Subprotocol("viser-v1.1.1")],
                host="localhost",
            ):
                return True
        except InvalidStatus as refused:
            return refused.response.status_code != 403

    # in a thread of its own: a browser that an earlier test has started keeps a loop in this one
    with ThreadPoolExecutor(1) as thread:
        return thread.submit(lambda: asyncio.run(attempt())).result()


def test_the_page_itself_and_programs_connect(port: int) -> None:
    assert connect(port, f"http://localhost:{port}")
    assert connect(port, None)


@pytest.mark.parametrize(
    "origin", ["http://evil.example", "http://localhost:1", "null", "https://evil.example:8080"]
)
def test_a_website_in_the_same_browser_is_refused(port: int, origin: str) -> None:
    assert not connect(port, origin)


def test_a_name_that_was_made_to_mean_this_machine_is_refused(port: int) -> None:
    assert not connect(port, f"http://evil.example:{port}", "evil.example")
    request = urllib.request.Request(f"http://localhost:{port}/", headers={"Host": "evil.example"})
    with pytest.raises(urllib.error.HTTPError, match="403"):
        urllib.request.urlopen(request)


def test_the_files_of_the_page_are_served(port: int) -> None:
    with urllib.request.urlopen(f"http://localhost:{port}/") as answer:
        assert b"<html" in answer.read().lower()


@pytest.mark.parametrize(
    ("origin", "asked", "host", "own"),
    [
        (None, "localhost:1", "localhost", True),
        ("http://localhost:1", "localhost:1", "127.0.0.1", True),
        ("http://[::1]:1", "[::1]:1", "localhost", True),
        ("http://robot.lab:1", "robot.lab:1", "0.0.0.0", True),
        ("http://evil:1", "robot.lab:1", "0.0.0.0", False),
        ("http://robot.lab:1", "robot.lab:1", "localhost", False),
        ("http://[::1", "localhost:1", "localhost", False),
        (None, "", "localhost", False),
    ],
)
def test_own(origin: str | None, asked: str, host: str, own: bool) -> None:
    assert is_own(origin, asked, host) is own
