"""A policy in another process picks as it picks here."""

import subprocess
import sys
from collections.abc import Iterator

import pytest

from optipromp.bench.running import Exercise, attempted
from optipromp.bench.serve import Served
from optipromp.core.errors import InvalidRequestError

PROGRAM = """
from optipromp.bench.entries.own import Blind
from optipromp.bench.serve import serve
serve(Blind(), calls=1)
"""


def started(program: str) -> Iterator[str]:
    with subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE) as process:
        yield process.stdout.readline().decode().strip()
        process.kill()


@pytest.fixture
def address() -> Iterator[str]:
    yield from started(PROGRAM)


def test_a_served_policy_acts_as_at_home(address: str) -> None:
    away, _ = attempted(Exercise(address, "policy", "limp", 110_000, engines=("arm",)))
    home, _ = attempted(Exercise("blind", "policy", "limp", 110_000, engines=("arm",)))
    assert away[0].result == home[0].result == "clean"
    assert away[0].judged() == home[0].judged()


@pytest.mark.parametrize("address", ["127.0.0.1:1", "127.0.0.1:x", ":99999", "", "a" * 300 + ":80"])
def test_nobody_there_is_told(address: str) -> None:
    with pytest.raises(InvalidRequestError, match="start it"):
        Served(address).begin()
