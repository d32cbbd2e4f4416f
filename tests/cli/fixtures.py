"""A folder of a plan, made once."""

from pathlib import Path

import pytest
from typer.testing import CliRunner

from optipromp.cli.main import app


@pytest.fixture(scope="session")
def reach(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a reach in scenario-3, to read only."""
    out = tmp_path_factory.mktemp("plan") / "reach"
    done = CliRunner().invoke(
        app, ["plan", "scenario-3", "--reach", "--no-figures", "--out", str(out)]
    )
    assert done.exit_code == 0, done.stderr
    return out
