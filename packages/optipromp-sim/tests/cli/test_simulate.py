"""``optipromp simulate``."""

import json
import shutil

import pytest
from tests.cli.fixtures import completed, refused, told


def test_a_scene_is_planned_for_executed_and_told(tmp_path):
    result = completed("simulate", "scenario-1", "--planner", "promp", "--out", tmp_path, code=1)
    assert "failed: static_contact" in result.stdout
    assert "table-top" in result.stdout
    document = json.loads((tmp_path / "outcome.json").read_text())
    assert document["cause"] == "static_contact"
    assert (tmp_path / "rollout.npz").exists()
    assert sorted(p.name for p in tmp_path.iterdir()) == ["outcome.json", "rollout.npz"]


def test_a_plans_folder_is_executed_as_it_is(reach, tmp_path):
    shutil.copytree(reach, tmp_path, dirs_exist_ok=True)
    document = told("simulate", tmp_path)
    assert document["success"] is True
    assert document["planner"] == "opti-promp"
    assert document["plan_status"] == "success"
    assert document["static_contacts"] == []
    assert json.loads((tmp_path / "outcome.json").read_text())["success"] == document["success"]
    same = told("simulate", tmp_path / "plan.json", "--in", "scenario-3")
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
        (["scenario-3", "--latency", "0.1", "--noise", "detector"], "--noise, --latency: only"),
        (["scenario-3", "--camera", "hand"], "--camera: only with --closed-loop"),
        (["scenario-3", "--closed-loop", "--planner", "promp"], "--planner: not with"),
        (["scenario-3", "--closed-loop", "--noise", "detect"], "did you mean 'detector'"),
        (["scenario-3", "--closed-loop", "--camera", "head"], "palm, hand, beside"),
        (["scenario-3", "--sway-frequency", "0.5:1"], "state --sway"),
        (["scenario-3", "--sway", "0.01", "--sway-frequency", "2:1"], "write it as 0.5:1.6"),
    ],
)
def test_wrong_input_is_one_line_and_exit_code_2(tmp_path, monkeypatch, arguments, words):
    monkeypatch.chdir(tmp_path)
    assert words in refused("simulate", *arguments)
    assert not list(tmp_path.iterdir())
    document = told("simulate", *arguments, code=2)
    assert document["status"] == "INVALID_REQUEST"


def test_a_motion_to_a_free_goal_picks_nothing_and_says_so(tmp_path):
    scene = {
        "name": "free", "robot": "panda", "tool": {"kind": "cup", "radius": 0.03},
        "start": [0, -0.3, 0, -2.2, 0, 1.9, 0.8], "objects": [],
        "goal": {"joints": [0.3, -0.3, 0, -2.2, 0, 1.9, 0.8]},
    }  # fmt: skip
    (tmp_path / "free.yaml").write_text(json.dumps(scene))
    result = completed("simulate", tmp_path / "free.yaml", "--out", tmp_path)
    assert "(plan: success)  nothing harmed" in result.stdout
    assert "picked" not in result.stdout
