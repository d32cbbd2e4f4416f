"""``optipromp export``."""

import json

import numpy as np
import pytest
from tests.cli.fixtures import completed, invoke, refused, told

import optipromp_ros as ros
from optipromp import load_robot


def test_a_plan_is_written_as_a_model(reach, tmp_path):
    mujoco = pytest.importorskip("mujoco")
    model = tmp_path / "new" / "reach.xml"
    document = told("export", reach, "--mjcf", model)
    assert (document["status"], document["message"]) == ("success", "")
    assert document["files"] == {"mjcf": str(model)}
    assert mujoco.MjModel.from_xml_path(str(model)).nu == 7
    again = completed("export", reach / "plan.json", "--mjcf", tmp_path / "again.xml")
    assert again.stdout == f"wrote {tmp_path / 'again.xml'}\n"
    assert (tmp_path / "again.xml").read_bytes() == model.read_bytes()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["scenario-3"], "give at least one of --mjcf FILE.xml, --mcap FILE.mcap, --robot"),
        (["scenario-3", "--mcap", "scene.bag"], "--mcap is 'scene.bag': its name must end in"),
        (["scenario-3", "--mjcf", "scene"], "--mjcf is 'scene': its name must end in .xml"),
        (["panda", "--mjcf", "a.xml"], "panda is a robot; export takes a scene or a plan"),
        (["panda", "--robot", "a.npz"], "--robot is 'a.npz': its name must end in .robot"),
    ],
)
def test_wrong_input_is_one_line_and_exit_code_2(tmp_path, monkeypatch, arguments, words):
    monkeypatch.chdir(tmp_path)
    assert words in refused("export", *arguments)
    assert json.loads(invoke("export", *arguments, "--json").stdout)["files"] == {}
    assert not list(tmp_path.iterdir())


def test_a_plan_becomes_a_bag_that_is_valid(reach, tmp_path):
    bag = tmp_path / "reach.mcap"
    assert told("export", reach, "--mcap", bag, "--prefix", "fr3_")["files"] == {"mcap": str(bag)}
    topics = {item.topic: item.message for item in ros.read_bag(bag)}
    assert set(topics) == {"/planning_scene", "/joint_trajectory", "/display_planned_path"}
    assert topics["/joint_trajectory"].joint_names[0] == "fr3_joint1"
    rows = np.load(reach / "trajectory.npz")["times"]  # at 1000 Hz, too
    assert len(topics["/joint_trajectory"].points) == len(rows) > 3000
    completed("validate", str(bag), "--scene", "scenario-3")
    scene = tmp_path / "scene.mcap"
    completed("export", "scenario-3", "--mcap", scene)
    assert [item.topic for item in ros.read_bag(scene)] == ["/planning_scene"]


def test_the_robot_of_a_scene_or_by_name_is_written_resolved(tmp_path):
    files = {item: tmp_path / f"{item}.robot" for item in ("panda", "scenario-3")}
    for item, file in files.items():
        assert told("export", item, "--robot", file)["files"] == {"robot": str(file)}
    assert files["panda"].read_bytes() == files["scenario-3"].read_bytes()
    assert load_robot(files["panda"]).tool is None
