"""A folder of a plan, and the rows of the paper's scenarios, made once."""

from pathlib import Path

import pytest
from typer.testing import CliRunner

from optipromp.cli.main import app
from optipromp.laboratory.experiments.scenarios import ScenarioRow, run_scenarios


@pytest.fixture(scope="session")
def reach(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a reach in scenario-3, to read only."""
    out = tmp_path_factory.mktemp("plan") / "reach"
    done = CliRunner().invoke(
        app, ["plan", "scenario-3", "--reach", "--no-figures", "--out", str(out)]
    )
    assert done.exit_code == 0, done.stderr
    return out


@pytest.fixture(scope="session")
def scenario_rows() -> tuple[ScenarioRow, ...]:
    return run_scenarios()
