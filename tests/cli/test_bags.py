"""The commands on bags of joint states."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from tests.ros.recorded import JOINTS, guided, joint_states
from typer.testing import CliRunner

from optipromp import plan
from optipromp.cli.main import app
from optipromp.core.promp import ProMP
from optipromp.ros import Recorded, joint_trajectory, message, write_bag

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


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--topic", "/arm"], "error INVALID_REQUEST: .* has no topic '/arm': it has /text"),
        ([], "error INVALID_DEMONSTRATION: .* has no messages of type sensor_msgs/msg/JointState"),
    ],
)
def test_what_a_bag_lacks_is_one_line(tmp_path: Path, arguments: list[str], words: str) -> None:
    write_bag(tmp_path / "x.mcap", [Recorded("/text", message("std_msgs/msg/String"))])
    learn = ["learn", str(tmp_path / "x.mcap"), "--out", str(tmp_path / "p.npz")]
    result = runner.invoke(app, [*learn, *arguments])
    assert result.exit_code == 2
    (line,) = result.stderr.splitlines()
    assert re.match(words, line)
    assert not (tmp_path / "p.npz").exists()


def test_validate_judges_the_trajectory_of_a_bag(tmp_path: Path) -> None:
    made = plan("scenario-3")
    for name, rows in (("good.mcap", made.trajectory), ("fast.mcap", made.trajectory.slowed(0.1))):
        write_bag(tmp_path / name, [Recorded("/arm", joint_trajectory(rows, prefix="fr3_"))])
    validate = ["validate", "--scene", "scenario-3", "--json"]
    good, fast = (
        runner.invoke(app, [*validate, str(tmp_path / name)]) for name in ("good.mcap", "fast.mcap")
    )
    assert (good.exit_code, fast.exit_code) == (0, 1), good.stderr
    assert json.loads(good.stdout)["rows"] == made.trajectory.n_waypoints
    assert json.loads(fast.stdout)["violations"]
