"""What the page opens, what it computes of a plan, and the command that serves it."""

import re
import signal
import subprocess
import sys
import urllib.error
import urllib.request
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.cli.fixtures import completed

from optipromp.core.errors import InvalidRequestError, InvalidSceneError
from optipromp.core.scenes.io import load_scene, save_scene
from optipromp.looks.viewer.serving import tube
from optipromp_eyes.pictures import png_file
from optipromp_page import content
from optipromp_page.stage import open_source
from optipromp_page.tabs import Recorder


def test_moving_a_fruit_keeps_its_root_and_moving_the_root_keeps_the_fruit() -> None:
    scene = load_scene("scenario-3")
    grips, fruit = content.grips(scene), scene.pushables[0]
    after = content.moved(scene, grips["n1"], fruit.position + [0.01, 0.0, 0.0])
    assert np.allclose(after.pushables[0].position - fruit.position, [0.01, 0.0, 0.0])
    assert np.array_equal(after.pushables[0].stem.root, fruit.stem.root)
    assert np.array_equal(after.pushables[0].stem.points[0], after.pushables[0].position)
    assert after.pushables[1] is scene.pushables[1]
    after = content.moved(scene, grips["n1: stem root"], fruit.stem.root + [0.0, 0.02, 0.0])
    assert np.array_equal(after.pushables[0].position, fruit.position)
    assert np.allclose(after.pushables[0].stem.root - fruit.stem.root, [0.0, 0.02, 0.0])
    whole = grips[content.FRUITS]
    after = content.moved(scene, whole, content.place(scene, whole) + [0.0, 0.0, 0.03])
    for old, new in zip(scene.objects, after.objects, strict=True):
        shift = [0.0, 0.0, 0.03] if old.stem is not None else np.zeros(3)
        assert np.allclose(new.position - old.position, shift)
        assert old.stem is None or np.allclose(new.stem.points - old.stem.points, shift)
    with pytest.raises(InvalidSceneError, match="no length"):
        content.moved(scene, grips["n1: stem root"], fruit.position)


def test_a_scene_that_was_seen_brings_its_picture_and_so_does_its_plan(tmp_path: Path) -> None:
    scene, folder = tmp_path / "row.yaml", tmp_path / "reach"
    save_scene(load_scene("scenario-3"), scene)
    assert open_source(str(scene)).seen is None
    pixels = np.random.default_rng(0).integers(0, 256, (6, 8, 3), dtype=np.uint8)
    (tmp_path / "row.overlay.png").write_bytes(png_file(pixels))
    assert np.array_equal(open_source(str(scene)).seen, pixels)
    words = ("--reach", "--out", folder, "--no-figures")
    completed("plan", scene, *words)
    assert np.array_equal(open_source(str(folder)).seen, pixels)
    (tmp_path / "row.overlay.png").write_bytes(b"no picture")
    assert open_source(str(scene)).seen is None
    completed("plan", "scenario-3", *words)
    assert open_source(str(folder)).seen is None  # that of the earlier plan is gone


def test_the_bundle_ends_where_the_plan_does(made) -> None:
    found = content.initial_bundle(made)
    ends = made.robot.tool_pose(made.initial.positions[[0, -1]])[0]
    assert np.allclose(found.mean[[0, -1]], ends, atol=1e-9)
    assert found.radius[0] < 1e-6  # exact at the start
    assert found.radius[-1] < 0.01 < found.radius.max()  # and known at the goal, but not between
    corners, faces = tube(found.mean, found.radius, 8)
    ring = corners.reshape(len(found.mean), 8, 3)
    assert np.allclose(ring.mean(axis=1), found.mean)
    off = np.linalg.norm(ring - found.mean[:, None], axis=2)
    assert np.allclose(off, np.maximum(found.radius, 1e-5)[:, None])
    assert faces.max() == len(corners) - 1


def test_an_arm_without_demonstrations_has_no_bundle(made) -> None:
    own = replace(made.robot, joint_names=tuple("abcdefg"))
    assert content.initial_bundle(replace(made, task=replace(made.task, robot=own))) is None


def test_candidates_are_those_of_the_plans_own_search(made) -> None:
    found = content.candidates(made)
    harms = [harm for _, harm in found]
    assert harms == sorted(harms, reverse=True)
    chosen = made.robot.tool_pose(made.followed.positions[made.first :])[0]
    apart = [np.linalg.norm(chosen[:, None] - path, axis=2).min(axis=1).max() for path, _ in found]
    assert min(apart) < 1e-3  # [m] the chosen path is one of them


def test_clearances_agree_with_the_judge(made) -> None:
    q = made.trajectory.resample(100.0).positions
    found = content.clearances(made.scene, made.robot, q)
    m = made.metrics
    judged = {
        "arm to avoid": m.clearance_avoid, "tool to avoid": m.clearance_avoid_tool,
        "arm to pushable": m.clearance_pushable,
    }  # fmt: skip
    assert found.series.keys() == judged.keys()
    for words, value in judged.items():
        assert found.series[words].min() == pytest.approx(value, abs=1e-3)
    assert found.nearest.shape == (len(q), len(made.robot.spheres.radius))


def test_a_recording_out_of_reach_leaves_the_arm_and_a_short_one_is_refused(made) -> None:
    start = made.trajectory.positions[0]
    recorder = Recorder(made.robot, start)
    assert not recorder.drag(np.array([3.0, 0.0, 0.0]), 1.0)
    assert np.array_equal(recorder.q, start)
    with pytest.raises(InvalidRequestError, match="samples"):
        recorder.accept()


def test_what_cannot_be_opened_is_named(tmp_path: Path) -> None:
    with pytest.raises(InvalidRequestError, match="holds neither a plan"):
        open_source(str(tmp_path))
    with pytest.raises(InvalidRequestError, match="not both folders of a rollout"):
        open_source("scenario-3", "scenario-4")
    (tmp_path / "rows.csv").touch()
    with pytest.raises(InvalidRequestError, match="'optipromp report "):
        open_source(str(tmp_path))


def test_the_command_serves_its_own_files_to_this_machine_and_ctrl_c_ends_it() -> None:
    command = [sys.executable, "-m", "optipromp", "view", "scenario-3", "--no-browser", "--port"]
    with subprocess.Popen([*command, "0"], stdout=subprocess.PIPE, text=True) as served:
        line = served.stdout.readline()
        url = re.search(r"http://localhost:(\d+)", line)
        assert url is not None, line
        with urllib.request.urlopen(url[0]) as answer:
            assert b"<!doctype html>" in answer.read().lower()
        for path in (
            "/../../../../etc/passwd",
            "/%2e%2e/%2e%2e/%2e%2e/etc/passwd",
            "/pyproject.toml",
        ):
            with pytest.raises(urllib.error.HTTPError, match=r"40[034]"):
                urllib.request.urlopen(url[0] + path)
        taken = subprocess.run([*command, url[1]], capture_output=True, text=True, timeout=120)
        assert taken.returncode == 2
        assert f"cannot listen at localhost:{url[1]}" in taken.stderr
        listening = Path("/proc/net/tcp").read_text(encoding="ascii")
        assert re.search(rf": 0100007F:{int(url[1]):04X} 00000000:0000 0A", listening)
        served.send_signal(signal.SIGINT)
        assert served.wait(timeout=30) == 0
        assert served.stdout.read().strip() == "closed"
    with pytest.raises(urllib.error.URLError):
        urllib.request.urlopen(url[0])
