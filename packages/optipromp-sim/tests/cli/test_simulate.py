"""``optipromp simulate``."""

import json
import shutil

import pytest
from typer.testing import CliRunner

from optipromp.cli.main import app

pytest.importorskip("mujoco")


def invoke(*arguments):
    return CliRunner().invoke(app, ["simulate", *map(str, arguments)])


def test_a_scene_is_planned_for_executed_and_told(tmp_path):
    result = invoke("scenario-1", "--planner", "promp", "--out", tmp_path)
    assert result.exit_code == 1
    assert "failed: static_contact" in result.stdout
    assert "table-top" in result.stdout
    document = json.loads((tmp_path / "outcome.json").read_text())
    assert document["cause"] == "static_contact"
    assert (tmp_path / "rollout.npz").exists()
    assert sorted(p.name for p in tmp_path.iterdir()) == ["outcome.json", "rollout.npz"]


def test_a_plans_folder_is_executed_as_it_is(reach, tmp_path):
    shutil.copytree(reach, tmp_path, dirs_exist_ok=True)
    result = invoke(tmp_path, "--json")
    document = json.loads(result.stdout)
    assert (result.exit_code, document["success"]) == (0, True)
    assert document["planner"] == "opti-promp"
    assert document["plan_status"] == "success"
    assert document["static_contacts"] == []
    assert json.loads((tmp_path / "outcome.json").read_text())["success"] == document["success"]
    again = invoke(tmp_path / "plan.json", "--json", "--in", "scenario-3")
    same = json.loads(again.stdout)
    for key in ("seconds", "real_time_factor"):
        del document[key], same[key]
    assert same == document


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["panda"], "takes a scene or a plan"),
        (["nowhere"], "no file and nothing built in"),
        (["scenario-3", "--slow", "0"], "--slow"),
        (["scenario-3", "--speed", "0"], "ControlParameters.speed"),
    ],
)
def test_wrong_input_is_one_line_and_exit_code_2(tmp_path, monkeypatch, arguments, words):
    monkeypatch.chdir(tmp_path)
    result = invoke(*arguments)
    assert result.exit_code == 2
    assert words in result.stderr
    assert len(result.stderr.strip().splitlines()) == 1
    assert json.loads(invoke(*arguments, "--json").stdout)["status"] == "INVALID_REQUEST"


def test_a_motion_to_a_free_goal_picks_nothing_and_says_so(tmp_path):
    scene = {
        "name": "free", "robot": "panda", "tool": {"kind": "cup", "radius": 0.03},
        "start": [0, -0.3, 0, -2.2, 0, 1.9, 0.8], "objects": [],
        "goal": {"joints": [0.3, -0.3, 0, -2.2, 0, 1.9, 0.8]},
    }  # fmt: skip
    (tmp_path / "free.yaml").write_text(json.dumps(scene))
    result = invoke(tmp_path / "free.yaml", "--out", tmp_path)
    assert result.exit_code == 0, result.stdout
    assert "(plan: success)  nothing harmed" in result.stdout
    assert "picked" not in result.stdout
