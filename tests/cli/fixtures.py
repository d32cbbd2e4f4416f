"""Commands called in this process, and a folder of a plan, made once."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from optipromp.cli.main import app

RUN = [sys.executable, "-m", "optipromp"]


def ran(command: list[str] | str, **more: Any) -> Any:
    """A process that has ended; a command in one text is of the shell."""
    given = {"capture_output": True, "text": True} | more
    return subprocess.run(command, shell=isinstance(command, str), check=False, **given)


def invoke(*words: object) -> Any:
    return CliRunner().invoke(app, [*map(str, words)])


def completed(*words: object, code: int = 0) -> Any:
    """A command that has ended with a code."""
    done = invoke(*words)
    assert done.exit_code == code, done.output
    return done


def told(*words: object, code: int = 0) -> Any:
    """The document that a command prints under --json, which ends with a code."""
    return read(completed(*words, "--json", code=code).stdout)


def refused(*words: object, code: int = 2) -> str:
    """What a command says that refuses its input, in one line."""
    done = completed(*words, code=code)
    assert len(done.stderr.strip().splitlines()) == 1, done.stderr
    return " ".join(done.output.split())


def call(*words: object) -> tuple[int, str, str]:
    """The exit code, and what is printed to standard output and to standard error."""
    result = invoke(*words)
    return result.exit_code, result.stdout, result.stderr


def read(text: str) -> Any:
    return json.loads(text, parse_constant=pytest.fail)


@pytest.fixture(scope="session")
def reach(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a reach in scenario-3, to read only."""
    out = tmp_path_factory.mktemp("plan") / "reach"
    completed("plan", "scenario-3", "--reach", "--no-figures", "--out", out)
    return out
