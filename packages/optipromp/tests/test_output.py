"""Plans to files and back."""

import hashlib
import json
from pathlib import Path

import numpy as np
import pytest
from tests.folders import FILES
from tests.robots.builders import TOOLS, cup_parts, joined, write_obj

from optipromp import OptiPrompError, load_plan, load_robot, with_tool, write_plan
from optipromp.core.planning import Plan, plan
from optipromp.core.promp import load_demonstrations
from optipromp.core.scenes import load_scene, scene_from_dict, scene_to_dict

MADE = ("scenario-3", "opti-promp"), ("scenario-2", "i-promp"), ("scenario-4", "paper")


@pytest.fixture(scope="module", params=MADE)
def result(request: pytest.FixtureRequest) -> Plan:
    scene, planner = request.param
    if planner == "paper":
        pytest.importorskip("optipromp_paper")
    return plan(scene, planner=planner, seed=3)


def test_a_plan_comes_back_as_it_was(result: Plan, tmp_path: Path) -> None:
    names = write_plan(result, tmp_path / "reach")
    assert set(names) == {"plan.json", *FILES}
    assert {path.name for path in (tmp_path / "reach").iterdir()} == set(names)
    (tmp_path / "reach").rename(tmp_path / "moved")
    for source in (tmp_path / "moved", tmp_path / "moved" / "plan.json"):
        again = load_plan(source)
        assert again.to_dict() == result.to_dict()
        for curve in ("trajectory", "initial", "followed"):
            for rows in ("times", "positions", "velocities", "accelerations"):
                here, there = (getattr(getattr(one, curve), rows) for one in (again, result))
                np.testing.assert_array_equal(here, there)
        assert again.prediction == result.prediction
        assert again.trajectory.joint_names == result.trajectory.joint_names
        assert again.scene.name == result.scene.name
        assert again.stages == result.stages
        assert again.contacts == result.contacts


def test_the_csv_is_a_demonstration(result: Plan, tmp_path: Path) -> None:
    write_plan(result, tmp_path, rate=100.0)
    recorded = load_demonstrations(tmp_path / "trajectory.csv")
    assert recorded.joint_names == result.trajectory.joint_names
    rows = result.trajectory.resample(100.0)
    np.testing.assert_allclose(recorded[0].positions, rows.positions, atol=1e-8)
    np.testing.assert_allclose(recorded[0].times, rows.times, atol=1e-8)


def test_the_rows_of_both_files_are_the_curve_at_the_rate(result: Plan, tmp_path: Path) -> None:
    write_plan(result, tmp_path, rate=250.0)
    rows = result.trajectory.resample(250.0)
    kinds = rows.positions, rows.velocities, rows.accelerations
    table = np.loadtxt(tmp_path / "trajectory.csv", delimiter=",", skiprows=1)
    np.testing.assert_allclose(table, np.column_stack([rows.times, *kinds]), rtol=1e-9, atol=1e-9)
    with np.load(tmp_path / "trajectory.npz") as archive:
        for name, wanted in zip(("positions", "velocities", "accelerations"), kinds, strict=True):
            np.testing.assert_array_equal(archive[name], wanted)
        assert tuple(archive["joint_names"]) == rows.joint_names


def test_a_mesh_tool_of_a_scene_file_comes_back(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # which holds the mesh and the plan
    write_obj(tmp_path / "cup.obj", *joined(cup_parts()))
    stated = {"kind": "mesh", "file": "cup.obj", "tool_point": [0.0, 0.0, 0.12], "opening": 0.044,
              "height": 0.04}  # fmt: skip
    document = scene_to_dict(load_scene("scenario-1")) | {"tool": stated}
    made = plan(scene_from_dict(document, base_dir=tmp_path), planner="promp")
    write_plan(made, tmp_path / "out")
    again = load_plan(tmp_path / "out")
    np.testing.assert_array_equal(again.robot.spheres.center, made.robot.spheres.center)
    assert again.to_dict() == made.to_dict()


def test_a_plan_of_another_tool_than_the_scenes_is_not_mistaken_for_one_of_it(tmp_path):
    other = with_tool(load_robot("panda"), TOOLS["spoon"])
    write_plan(plan("scenario-3", planner="promp", robot=other), tmp_path)
    assert (tmp_path / "trajectory.csv").exists()
    with pytest.raises(OptiPrompError, match="with another robot or tool than the scene's"):
        load_plan(tmp_path)


@pytest.mark.parametrize(
    "damage", ["missing", "truncated", "list", "format", "key", "scene", "npz"]
)
def test_damage_is_named(result: Plan, tmp_path: Path, damage: str) -> None:
    write_plan(result, tmp_path)
    path = tmp_path / "plan.json"
    document = json.loads(path.read_text())
    match damage:
        case "missing":
            path.unlink()
        case "truncated":
            path.write_text(path.read_text()[:200])
        case "list":
            path.write_text("[]")
        case "format":
            path.write_text(json.dumps(document | {"format": 99}))
        case "key":
            del document["metrics"]["M_c"]
            path.write_text(json.dumps(document))
        case "scene":
            del document["scene_file"]["objects"]
            path.write_text(json.dumps(document))
        case "npz":
            (tmp_path / "waypoints.npz").write_bytes(b"PK")
    with pytest.raises(OptiPrompError, match=str(tmp_path)):
        load_plan(tmp_path)


@pytest.mark.parametrize("damage", ["columns", "metrics", "status", "message", "first"])
def test_what_a_file_says_is_not_believed(result: Plan, tmp_path: Path, damage: str) -> None:
    write_plan(result, tmp_path)
    path, rows = tmp_path / "plan.json", tmp_path / "waypoints.npz"
    document = json.loads(path.read_text()) | {"status": "success"}
    with np.load(rows) as found:
        arrays = {key: found[key] for key in found.files}
    match damage:
        case "columns":
            arrays = {k: v[:, :2] if v.ndim == 2 else v[:2] if v.dtype.kind == "U" else v
                      for k, v in arrays.items()}  # fmt: skip
        case "metrics":
            document["metrics"]["goal_error"] = "x"
        case "status":
            document["status"] = "splendid"
        case "message":
            document["message"] = ""
        case "first":
            document["first"] = 10**9
    np.savez(rows, **arrays)
    document["sha256"]["waypoints.npz"] = hashlib.sha256(rows.read_bytes()).hexdigest()
    path.write_text(json.dumps(document))
    with pytest.raises(OptiPrompError, match=str(tmp_path)):
        load_plan(tmp_path)
