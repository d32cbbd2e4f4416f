"""Plans to files and back."""

import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.folders import FILES, Arrays, rows, stated
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
            for of in ("times", "positions", "velocities", "accelerations"):
                here, there = (getattr(getattr(one, curve), of) for one in (again, result))
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


def within(folder: Path, key: str, **changes: object) -> None:
    """What plan.json says under ``key``, with other words."""
    stated(folder, **{key: json.loads((folder / "plan.json").read_text())[key] | changes})


def two_joints(arrays: Arrays) -> Arrays:
    return {k: v[:, :2] if v.ndim == 2 else v[:2] if v.dtype.kind == "U" else v
            for k, v in arrays.items()}  # fmt: skip


DAMAGES: dict[str, Callable[[Path], Any]] = {
    "missing": lambda folder: (folder / "plan.json").unlink(),
    "truncated": lambda folder: os.truncate(folder / "plan.json", 200),
    "list": lambda folder: (folder / "plan.json").write_text("[]"),
    "format": lambda folder: stated(folder, format=99),
    "key": lambda folder: stated(folder, metrics={}),
    "scene": lambda folder: within(folder, "scene_file", objects=None),
    "npz": lambda folder: (folder / "waypoints.npz").write_bytes(b"PK"),
    "columns": lambda folder: rows(folder, two_joints),
    "metrics": lambda folder: within(folder, "metrics", goal_error="x"),
    "status": lambda folder: stated(folder, status="splendid"),
    "message": lambda folder: stated(folder, status="success", message=""),
    "first": lambda folder: stated(folder, first=10**9),
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_damage_is_named_and_what_a_file_says_is_not_believed(result, tmp_path, damage):
    write_plan(result, tmp_path)
    DAMAGES[damage](tmp_path)
    with pytest.raises(OptiPrompError, match=str(tmp_path)):
        load_plan(tmp_path)
