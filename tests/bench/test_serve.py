"""A policy in another process picks as it picks here."""

import subprocess
import sys
from collections.abc import Iterator

import pytest

from optipromp.bench.running import Exercise, attempted
from optipromp.bench.serve import Served
from optipromp.bench.sets import scene_of
from optipromp.bench.tracks import loaded
from optipromp.core.errors import InvalidRequestError

PROGRAM = """
from optipromp.bench.entries.own import Blind
from optipromp.bench.serve import serve
serve(Blind(), calls=2)
"""
WRONG = """
import socket
with socket.create_server(("127.0.0.1", 0)) as listening:
    print(f"tcp:127.0.0.1:{listening.getsockname()[1]}", flush=True)
    caller, _ = listening.accept()
    with caller, caller.makefile("rwb") as stream:
        stream.readline()
        stream.write(b"velocity 1 2 3\\n")
        stream.flush()
"""


def started(program: str) -> Iterator[str]:
    with subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        yield process.stdout.readline().decode().strip()
        process.kill()


def test_the_address_is_asked_for() -> None:
    with pytest.raises(InvalidRequestError, match="no policy answers"):
        loaded("tcp:127.0.0.1:notaport")


@pytest.fixture
def address() -> Iterator[str]:
    yield from started(PROGRAM)


@pytest.fixture
def wrong() -> Iterator[str]:
    yield from started(WRONG)


def test_a_served_policy_acts_as_at_home(address: str) -> None:
    away, _ = attempted(Exercise(address, "policy", "limp", 110_000, engines=("arm",)))
    home, _ = attempted(Exercise("blind", "policy", "limp", 110_000, engines=("arm",)))
    assert away[0].result == home[0].result == "clean"
    assert away[0].judged() == home[0].judged()


def test_answers_that_are_none_are_told(wrong: str) -> None:
    entry = Served(wrong.removeprefix("tcp:"))
    scene, _ = scene_of("limp", 110_000)
    with pytest.raises(InvalidRequestError, match="velocity 1 2 3"):
        entry.reset(scene, 0)
    entry.close()


def test_nobody_there_is_told() -> None:
    with pytest.raises(InvalidRequestError, match="start it"):
        Served("127.0.0.1:1")
