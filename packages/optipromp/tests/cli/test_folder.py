"""``optipromp plan`` on a folder, from ``generate`` to ``simulate``'s input."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.cli.fixtures import call, read
from tests.folders import FILES

from optipromp.cli.check import Kind, kind_of
from optipromp.cli.plan import outputs, scene_files
from optipromp.core.errors import InvalidRequestError
from optipromp.core.output import load_pick, load_plan
from optipromp.core.planning import Picked, Plan, plan
from optipromp.core.scenes import Place, save_scene
from optipromp_sim.generate import generate


def test_scenes_are_planned_with_all_legs(tmp_path: Path) -> None:
    scenes, plans = tmp_path / "scenes", tmp_path / "plans"
    place = Place(np.array([0.45, -0.35, 0.45]), np.array([0.0, 0.0, 1.0]))
    save_scene(replace(generate("tight", 3), place=place), scenes / "placed.yaml")
    save_scene(generate("tight", 4), scenes / "reached.yaml")
    code, stdout, _ = call("plan", scenes, "--out", plans, "--json", "--workers", 2)
    placed, reached = read(stdout)["scenes"]
    assert code == 0
    assert list(placed["legs"]) == ["reach", "retreat", "carry"]
    assert list(reached["legs"]) == ["reach", "retreat"]
    kept = load_pick(plans / "placed")
    assert isinstance(kept, Picked)
    assert list(kept.legs) == list(placed["legs"])
    assert kept.success
    assert isinstance(load_pick(plans / "reached"), Picked)
    assert call("plan", scenes, "--out", plans, "--reach", "--workers", 2)[0] == 0
    assert isinstance(load_pick(plans / "reached"), Plan)


def test_generated_scenes_are_planned_each_into_its_folder(tmp_path: Path) -> None:
    scenes, plans = tmp_path / "scenes", tmp_path / "plans"
    assert call("generate", "--preset", "table-top", "--count", 3, "--out", scenes)[0] == 0
    code, stdout, stderr = call(
        "plan", scenes, "--reach", "--out", plans, "--json", "--progress", "--workers", 2
    )
    document = read(stdout)
    assert "3 of 3 planned" in stderr
    assert [Path(record["file"]) for record in document["scenes"]] == sorted(scenes.iterdir())
    assert document["of"] == 3
    statuses = [record["status"] for record in document["scenes"]]
    assert document["succeeded"] == statuses.count("success")
    assert code == (0 if document["succeeded"] == 3 else 1)
    for record in document["scenes"]:
        folder = Path(record["out"])
        assert folder.parent == plans
        assert {path.name for path in folder.iterdir()} == {"plan.json", *FILES}
        assert kind_of(str(folder)) is Kind.PLAN
        kept, alone = load_plan(folder), plan(record["file"])
        assert (kept.trajectory.positions == alone.trajectory.positions).all()
        assert record["metrics"] == read(json.dumps(alone.metrics.to_dict()))


def test_a_file_whose_name_steers_a_terminal_is_shown_escaped(tmp_path: Path) -> None:
    (tmp_path / "a\x1b[31m\u202eb.yaml").write_text("format: 1\nrobot: panda\nobjects: 3\n")
    (tmp_path / "c\x1b[31m.yaml").write_text("urdf: arm.urdf\n")
    code, stdout, stderr = call("plan", tmp_path)
    assert code == 2
    assert "a\\x1b[31m\\u202eb" in stdout
    assert "c\\x1b[31m.yaml: a robot, not a scene" in stderr
    assert "\x1b" not in stdout + stderr


def test_one_that_fails_makes_the_exit_code_but_stops_nothing(tmp_path: Path) -> None:
    (tmp_path / "a.yaml").write_text("format: 1\nname: no\nrobot: panda\nobjects: 3\n")
    for name in ("b", "c"):
        assert call("generate", "--preset", "shelf", "--count", 1, "--out", tmp_path / name)[0] == 0
        next((tmp_path / name).iterdir()).rename(tmp_path / f"{name}.yaml")
    code, stdout, _ = call("plan", tmp_path, "--planner", "promp", "--json")
    scenes = read(stdout)["scenes"]
    assert code == 2
    assert scenes[0]["status"] == "INVALID_SCENE"
    assert scenes[0].keys() >= {"scene", "status", "message", "metrics", "terms", "time"}
    assert all(record["metrics"] for record in scenes[1:])
    code, stdout, _ = call("plan", tmp_path, "--planner", "promp")
    assert code == 2
    assert "INVALID_SCENE" in stdout
    assert "of 3 plans succeeded" in stdout


def test_a_folder_without_scenes_is_refused(tmp_path: Path) -> None:
    code, stdout, stderr = call("plan", tmp_path, "--json")
    assert code == 2
    assert read(stdout)["status"] == "INVALID_REQUEST"
    assert "no scene file" in stderr


def test_a_folder_of_a_plan_is_no_folder_of_scenes_and_its_file_no_robot(tmp_path: Path) -> None:
    call("plan", "scenario-3", "--planner", "promp", "--out", tmp_path, "--no-figures")
    assert {path.name for path in tmp_path.iterdir()} == {"plan.json", *FILES}
    with pytest.raises(InvalidRequestError, match="for 'simulate'"):
        scene_files(tmp_path)
    assert kind_of(str(tmp_path / "plan.json")) is Kind.PLAN
    code, stdout, _ = call("check", tmp_path / "plan.json", "--json")
    assert read(stdout)["kind"] == "plan"
    assert code in (0, 1)


def test_files_that_share_a_stem_keep_apart() -> None:
    files = [Path("s/one.json"), Path("s/one.yaml"), Path("s/two.yaml")]
    assert outputs(files, Path("o")) == [Path("o/one.json"), Path("o/one.yaml"), Path("o/two")]
