"""The pick, from ``plan`` to what shows and judges it to its end."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests import folders
from tests.cli import fixtures
from tests.cli.fixtures import completed, invoke

import optipromp_ros as ros
from optipromp import Picked, load_pick, plan
from optipromp.core.files import read_npz
from optipromp.core.scenes.io import load_scene, save_scene
from optipromp.core.scenes.scene import PoseGoal
from optipromp.looks.reports import plan_report
from optipromp_sim.generate import generate

LEGS = ["reach", "retreat"]
FILES = {"plan.json", *folders.FILES}
OUT = {"retreat.csv", "retreat.npz"}


@pytest.fixture(scope="module")
def pick(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a pick in scenario-4, to read only."""
    out = tmp_path_factory.mktemp("plan") / "pick"
    document = fixtures.told("plan", "scenario-4", "--no-figures", "--out", out)
    assert list(document["legs"]) == LEGS
    assert {leg["status"] for leg in document["legs"].values()} == {"success"}
    assert document.keys() >= json.loads((out / "plan.json").read_text()).keys() - {
        "format", "version", "scene_file", "sha256", "reason", "notes",
    }  # fmt: skip
    return out


def test_a_pick_is_written_with_its_way_out(pick: Path) -> None:
    assert {path.name for path in pick.iterdir()} == FILES | OUT
    made = load_pick(pick)
    assert list(made.legs) == LEGS
    rows = np.genfromtxt(pick / "retreat.csv", delimiter=",", names=True)
    assert rows["time"][-1] == pytest.approx(made.legs["retreat"].duration)
    last = read_npz(pick / "trajectory.npz")["positions"][-1]
    assert rows[0].tolist()[1:8] == pytest.approx(last, abs=1e-8)


def test_a_pick_is_executed_until_the_fruit_is_out_of_the_plant(pick: Path, tmp_path: Path) -> None:
    done = completed("simulate", pick, "--out", tmp_path, "--json")
    made = load_pick(pick)
    told, rollout = json.loads(done.stdout), read_npz(tmp_path / "rollout.npz")
    assert told["picked"]
    assert told["duration"] > made.duration
    assert rollout["q"][-1] == pytest.approx(made.end, abs=0.01)
    row = [*rollout["fruit_ids"]].index("ripe")
    place = rollout["fruit_positions"][:, row]
    assert np.linalg.norm(place[-1] - place[0]) > 0.09  # [m] a retreat is 0.1 long
    assert not rollout["attached"][-1, row]  # its stem is cut
    alone = invoke("simulate", pick, "--reach", "--out", tmp_path, "--json")
    assert json.loads(alone.stdout)["duration"] < told["duration"] - 1.0


def test_the_harm_of_the_whole_decides_not_that_of_the_reach_alone(tmp_path: Path) -> None:
    """All who are asked of the pick say the same."""
    save_scene(generate("table-top", 743004), tmp_path / "scene.yaml")
    alone = invoke("plan", tmp_path / "scene.yaml", "--reach", "--json")
    assert json.loads(alone.stdout)["status"] == "HARM_PREDICTED"
    done = invoke(
        "plan", tmp_path / "scene.yaml", "--no-figures", "--out", tmp_path / "pick", "--json"
    )
    document = json.loads(done.stdout)
    assert (done.exit_code, document["status"]) == (0, "success"), done.stdout
    assert document["legs"]["reach"]["status"] == "HARM_PREDICTED"
    made = load_pick(tmp_path / "pick")
    assert isinstance(made, Picked)
    assert made.success
    for command in ("check", "validate", "simulate"):
        assert invoke(command, tmp_path / "pick").exit_code == 0, command
    assert "success, the reach in" in plan_report(tmp_path / "pick").decode()


def test_a_way_out_that_harms_is_the_status_of_the_pick(tmp_path: Path) -> None:
    save_scene(generate("table-top", 743009), tmp_path / "scene.yaml")
    done = invoke("plan", tmp_path / "scene.yaml", "--no-figures", "--out", tmp_path, "--json")
    document = json.loads(done.stdout)
    assert document["legs"]["reach"]["status"] == "success"
    harmful = document["legs"]["retreat"]["status"]
    assert (done.exit_code, document["status"]) == (1, harmful)
    assert document["message"].startswith("retreat: ")
    assert invoke("check", tmp_path).exit_code == invoke("validate", tmp_path).exit_code == 1
    told = json.loads(invoke("simulate", tmp_path, "--json").stdout)
    assert "; the way out failed: retreat: " in told["message"]


def test_without_a_tool_or_a_target_a_reach_is_planned(tmp_path: Path) -> None:
    scene = load_scene("scenario-4")
    target = scene.target
    goal = PoseGoal(target.position, np.array([0.0, 0.0, 1.0]))
    kept = tuple(item for item in scene.objects if item is not target)
    scenes = {"bare": replace(scene, tool=None), "empty": replace(scene, objects=kept, goal=goal)}
    for name, one in scenes.items():
        save_scene(one, tmp_path / f"{name}.yaml")
        done = invoke("plan", tmp_path / f"{name}.yaml", "--no-figures", "--json")
        assert done.exit_code in (0, 1), done.stderr
        assert "legs" not in json.loads(done.stdout)


def test_a_reach_that_fails_has_its_own_document() -> None:
    done = invoke("plan", "scenario-1", "--json")
    document = json.loads(done.stdout)
    assert (done.exit_code, document["status"]) == (1, "GOAL_IN_COLLISION")
    assert "legs" not in document
    assert document["message"] == plan("scenario-1").message


@pytest.mark.parametrize("planner", ["promp", "i-promp"])
def test_other_planners_have_a_way_out_too(planner: str) -> None:
    document = json.loads(invoke("plan", "scenario-4", "--planner", planner, "--json").stdout)
    reach = plan("scenario-4", planner=planner)
    assert document["metrics"]["goal_error"] == pytest.approx(reach.metrics.goal_error)
    assert ("legs" in document) == reach.success


def test_a_pick_is_checked_judged_exported_and_shown_to_its_end(pick: Path, tmp_path: Path) -> None:
    made = load_pick(pick)
    checked = json.loads(invoke("check", pick, "--json").stdout)
    assert checked["duration"] == pytest.approx(made.duration)
    assert list(checked["legs"]) == LEGS
    judged = json.loads(invoke("validate", pick, "--json").stdout)
    assert [leg["status"] for leg in judged["legs"].values()] == ["success", "success"]
    completed("export", pick, "--mcap", tmp_path / "pick.mcap")
    topics = {item.topic: item.message for item in ros.read_bag(tmp_path / "pick.mcap")}
    assert {"/joint_trajectory", "/joint_trajectory/retreat"} < set(topics)
    assert len(topics["/display_planned_path"].trajectory) == 2
    content = plan_report(pick).decode("utf-8")
    for words in ('<th scope="row">retreat</th>', "--seed 0 --out DIR"):
        assert words in content
