"""The commands on bags of joint states."""

import json
from pathlib import Path

import numpy as np
import pytest
from tests.ros.recorded import JOINTS, guided, joint_states
from typer.testing import CliRunner

from optipromp.cli.main import app
from optipromp.core.promp import ProMP
from optipromp_ros import write_bag

runner = CliRunner()
MIDDLE = np.array([0.0, 0.0, 0.0, -1.5, 0.0, 1.5, 0.0])  # [rad] from which ±1 is within the limits


def panda(count: int = 5) -> tuple[np.ndarray, np.ndarray]:
    """Times and positions of a Panda that is guided by hand."""
    times, q = guided(count)
    return times, q + MIDDLE


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("bags") / "guided"
    write_bag(path, joint_states(*panda()))
    return path


def test_learn_takes_a_bag_and_says_where_it_was_cut(bag: Path, tmp_path: Path) -> None:
    out = tmp_path / "reach.npz"
    learn = ["learn", str(bag), "--out", str(out), "--robot", "panda", "--bases", "7"]
    result = runner.invoke(app, [*learn, "--json"])
    assert result.exit_code == 0, result.stderr
    document = json.loads(result.stdout)
    assert document["demonstrations"] == 5
    assert document["recording"]["topic"] == "/joint_states"
    assert [cut["demonstration"] for cut in document["recording"]["cuts"]] == [True] * 5
    promp = ProMP.load(out)
    assert promp.joint_names == JOINTS
    words = runner.invoke(app, [*learn, "--no-figure"])
    assert "5 demonstrations in 1600 messages of /joint_states" in words.stdout
    first = document["recording"]["cuts"][0]
    assert f"{first['start']:.2f} to {first['end']:.2f} s" in words.stdout


def test_check_knows_a_bag(bag: Path, tmp_path: Path) -> None:
    single = tmp_path / "guided.mcap"
    write_bag(single, joint_states(*panda(2)))
    for path, count in ((bag, 5), (single, 2)):
        result = runner.invoke(app, ["check", str(path), "--json"])
        assert result.exit_code == 0, result.stderr
        document = json.loads(result.stdout)
        assert (document["kind"], document["demonstrations"]) == ("demonstrations", count)
        highest = dict(zip(document["joints"], document["highest"], strict=True))
        assert np.abs(np.array([highest[joint] for joint in JOINTS]) - MIDDLE).max() < 1.1
