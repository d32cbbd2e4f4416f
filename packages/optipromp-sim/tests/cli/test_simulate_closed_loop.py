"""``optipromp simulate --closed-loop``, and the disturbances."""

import json
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image
from tests.cli.fixtures import invoke, refused, told

from optipromp.core.geometry import Sphere
from optipromp.core.scenes import Place, Scene, SceneObject, Stem
from optipromp.core.scenes.io import save_scene
from optipromp.core.scenes.scene import JointGoal, ToolSpec, bare_robot
from optipromp_page.stage import load_replay
from optipromp_sim.commands.simulate import loop_lines
from optipromp_sim.generate import generate
from optipromp_sim.situations import SETTLE


def test_a_pick_in_closed_loop_is_told_and_left(tmp_path):
    result = invoke("simulate", "scenario-3", "--closed-loop", "--out", tmp_path, "--json")
    document = json.loads(result.stdout)
    assert document["loop"] == "closed"
    assert document["result"] in ("clean", "harmed", "gave_up", "missed")
    assert result.exit_code == (0 if document["result"] == "clean" else 1)
    shown = "\n".join(loop_lines(document))  # what is printed without --json
    stages = [decision["stage"] for decision in document["decisions"]]
    assert stages[-1] == document["stage"]
    assert document["stage"] in ("done", "gave_up")
    for decision in document["decisions"]:
        assert decision["why"][:20] in shown
    assert document["looks"] > 5
    assert 0.0 < document["cycle_median"] <= document["cycle_p99"]
    assert document["worst_jump"] < 1e-6
    assert sorted(p.name for p in tmp_path.iterdir()) == ["loop.npz", "outcome.json", "rollout.npz"]


def test_a_pick_from_a_plant_that_sways_is_drawn_and_replayed(tmp_path):
    """The arm stands until the sway has settled, the film shows the looks, the page replays it."""
    arguments = ["simulate", "scenario-3", "--closed-loop", "--sway", "0.01", "--slow", "0.05"]
    result = invoke(*arguments, "--gif", "--json", "--out", tmp_path)
    document = json.loads(result.stdout)
    assert document["decisions"][0]["time"] > SETTLE
    assert document["displacement"]["ripe"] > 0.005
    shown = load_replay(tmp_path)
    assert shown.record.times[0] == pytest.approx(SETTLE)
    assert shown.record.begun == tuple(item["stage"] for item in document["decisions"])
    with Image.open(tmp_path / "run.gif") as picture:
        assert picture.n_frames > 5


def test_a_loop_in_a_scene_with_a_place_brings_the_fruit_there(tmp_path):
    """The loop picks; retreat and carry follow, as plan_pick plans them."""
    ripe = SceneObject(
        "ripe", "target", Sphere(0.017), np.array([0.45, 0.0, 0.8]),
        stem=Stem(np.array([[0.45, 0.0, 0.8], [0.45, 0.01, 0.97]])),
    )  # fmt: skip
    place = Place(np.array([0.35, -0.35, 0.45]), np.array([0.6, 0.0, -0.8]))
    start = np.array([1.42, 1.10, -1.26, -2.42, -1.69, 1.02, 0.8])
    scene = Scene("one", "panda", (ripe,), ToolSpec("cup", {"radius": 0.03}), start, place=place)
    save_scene(scene, tmp_path / "scene.yaml")
    out = tmp_path / "out"
    document = told("simulate", tmp_path / "scene.yaml", "--closed-loop", "--out", out)
    assert document["legs"] == dict.fromkeys(("reach", "retreat", "carry"), "success")
    assert document["placed"] is True
    assert document["placed_off"] < 0.01
    shown = load_replay(out)
    assert shown.record is not None
    row = list(shown.arrays["fruit_ids"]).index("ripe")
    away = np.linalg.norm(shown.arrays["fruit_positions"][-1, row] - place.position)
    assert away < 0.04
    far = replace(scene, place=replace(place, position=np.array([1.6, 0.0, 0.4])))
    save_scene(far, tmp_path / "far.yaml")
    result = invoke("simulate", tmp_path / "far.yaml", "--closed-loop", "--out", out)
    assert result.exit_code == 1
    assert "closed loop: missed  failed: not_placed" in result.stdout
    assert "of the plan, carry: " in " ".join(result.stdout.split())


def test_the_options_of_the_loop_reach_it(tmp_path):
    """Looks that are late are waited for at the camera point."""
    common = ("simulate", "scenario-3", "--closed-loop")
    document = told(*common, "--out", tmp_path, "--latency", "1")
    times = [decision["time"] for decision in document["decisions"]]
    at = [item["why"] for item in document["decisions"]].index("at the camera point")
    assert times[at + 1] - times[at] > 1.0  # [s] the latency


def test_a_loop_that_finds_no_plan_gives_up_and_moves_nothing(tmp_path):
    document = told("simulate", "scenario-1", "--closed-loop", "--out", tmp_path, code=1)
    assert document["result"] == document["stage"] == "gave_up"
    assert "table-top" in document["decisions"][-1]["why"]
    assert document["worst_limit"] == 0.0


def test_a_scene_without_a_target_is_refused(tmp_path):
    scene = generate("cluster", 0)
    left = tuple(item for item in scene.objects if item.role == "static")
    home = JointGoal(bare_robot(scene).home)
    save_scene(replace(scene, objects=left, goal=home), tmp_path / "bare.yaml")
    assert "has no target" in refused("simulate", tmp_path / "bare.yaml", "--closed-loop")


def test_fruits_that_hang_aside_are_missed_by_an_open_loop(tmp_path):
    asked = "simulate", "scenario-3", "--out", tmp_path, "--shift", "0.06"
    assert not told(*asked, code=1)["success"]


def test_a_plan_is_refused_in_closed_loop(reach):
    assert "give the scene" in refused("simulate", reach, "--closed-loop")
