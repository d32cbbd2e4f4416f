"""Commands that packages add by the entry-point group ``optipromp.commands``."""

import json
import os
from pathlib import Path

import pytest
from tests.cli.fixtures import RUN, ran

COMMANDS = '''
from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated
import typer
from optipromp.cli.command import Report, command
from optipromp.core.errors import InvalidRequestError

@dataclass(frozen=True)
class Words:
    how: Annotated[str, typer.Option(metavar="WORD")] = "very"

@command()
def ripe(name: Annotated[str, typer.Argument()], words: Words) -> Report:
    """Tell whether NAME is ripe."""
    if name == "nothing":
        raise InvalidRequestError("nothing is not a fruit")
    return Report({"ripe": name}, [f"{name} is {words.how} ripe"], 1)

def bare() -> None:
    """Not decorated."""
'''
POINTS = """[optipromp.commands]
ripe = stranger_commands:ripe
list = stranger_commands:ripe
gone = stranger_commands:gone
bare = stranger_commands:bare
"""


@pytest.fixture
def place(tmp_path: Path) -> Path:
    (tmp_path / "stranger_commands.py").write_text(COMMANDS)
    information = tmp_path / "stranger-1.0.dist-info"
    information.mkdir()
    (information / "METADATA").write_text("Metadata-Version: 2.1\nName: stranger\nVersion: 1.0\n")
    (information / "entry_points.txt").write_text(POINTS)
    return tmp_path


def run(place: Path, *words: str) -> tuple[int, str, str]:
    paths = os.pathsep.join([str(place), os.environ.get("PYTHONPATH", "")])
    done = ran([*RUN, *words], env=os.environ | {"PYTHONPATH": paths})
    return done.returncode, done.stdout, done.stderr


def test_a_package_adds_a_command(place: Path) -> None:
    assert run(place, "ripe", "n1") == (1, "n1 is very ripe\n", "")
    assert run(place, "ripe", "n1", "--how", "half") == (1, "n1 is half ripe\n", "")
    code, stdout, stderr = run(place, "ripe", "n1", "--json")
    assert (code, json.loads(stdout), stderr) == (1, {"ripe": "n1"}, "")
    code, stdout, stderr = run(place, "ripe", "nothing", "--json")
    assert (code, json.loads(stdout)["status"]) == (2, "INVALID_REQUEST")
    assert stderr == "error INVALID_REQUEST: nothing is not a fruit\n"


def test_the_help_lists_it_and_warns_of_what_cannot_be_loaded(place: Path) -> None:
    code, stdout, stderr = run(place, "--help")
    assert code == 0
    assert "Tell whether NAME is ripe." in stdout
    assert stdout.count("List the built-in robots and scenes") == 1  # ours comes first
    bare, gone = stderr.splitlines()
    assert gone.startswith("warning: stranger: its command gone is left out (AttributeError: ")
    assert bare.startswith("warning: stranger: its command bare is left out (TypeError: ")
    assert run(place, "list")[2] == ""  # packages are not looked through for a command of ours
    code, _, stderr = run(place, "gone")
    assert code == 2
    assert "No such command 'gone'" in stderr
