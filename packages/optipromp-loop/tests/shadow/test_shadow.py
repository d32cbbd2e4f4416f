"""The shadow of recordings whose picks are known: by the command, from files."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scripts.shadow_picks import Done, record
from tests.cli.fixtures import told

from optipromp import parts, plan, plan_pick, save_scene
from optipromp.core.errors import InvalidRequestError
from optipromp.core.planning.task import posed
from optipromp.core.robots.measured import Measured, Series
from optipromp.core.scenes.hand import flange_of
from optipromp_eyes.pictures import picture_files
from optipromp_loop.control import without_fruits
from optipromp_loop.shadow.recording import Mark, closings, load_recorded, span_of
from optipromp_sim.generate import generate
from optipromp_sim.simulation.photograph import PhotoParameters, photograph

SCENE = generate("cluster", 110_000)
ROBOT, START = posed(SCENE)
REACH = plan(SCENE).trajectory


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording: our own motion, then one straight at the target, into the fruits beside it."""
    out = tmp_path_factory.mktemp("shift")
    ours, other = plan_pick(SCENE).legs, plan(SCENE, planner="promp").trajectory
    clean = Done(SCENE, REACH, "clean", ours["retreat"].trajectory)
    record([clean, Done(SCENE, other, "harmed")], out / "shift.json", "perfect")
    save_scene(without_fruits(SCENE), out / "cell.yaml")
    return out


def changed(folder: Path, **change: object) -> Path:
    """The recording after a change of its document."""
    document = json.loads((folder / "shift.json").read_text()) | change
    (folder / "changed.json").write_text(json.dumps(document))
    return folder / "changed.json"


Shadow = Callable[..., dict[str, Any]]


@pytest.fixture
def shadow(folder: Path) -> Shadow:
    """What the command answers about the recording after a change of its document."""

    def run(*words: str, code: int = 0, **change: object) -> dict[str, Any]:
        asked = "shadow", changed(folder, **change), "--known", folder / "cell.yaml"
        return dict(told(*asked, *words, code=code))

    return run


def test_a_harmful_pick_is_told_from_a_clean_one(shadow: Shadow, folder: Path) -> None:
    found = shadow("--out", str(folder / "shift.html"))
    (clean, harmed), summary = found["picks"], found["summary"]
    assert (clean["harmful"], harmed["harmful"]) == (False, True)
    assert (clean["theirs"]["status"], harmed["theirs"]["status"]) == ("success", "HARM_PREDICTED")
    assert clean["theirs"]["probability"] < 0.15 < 0.9 < harmed["theirs"]["probability"]
    assert 0.02 < harmed["apart"] < 0.5  # [m]
    assert all(t > 0.5 for pick in (clean, harmed) for ts in pick["seconds"].values() for t in ts)
    assert (summary["harmful"], summary["avoided"], summary["refused"]) == (1, 1, 0)
    assert summary["unclean"]["recorded"] > 0.9 > 0.2 > summary["unclean"]["ours"]
    content = (folder / "shift.html").read_text("utf-8")
    assert "Picks with predicted harm, as they were done: 1." in content
    assert content.count("<img") == 2
    assert "http" not in content  # it fetches nothing


def test_what_was_not_recorded_is_named_and_not_assumed(shadow: Shadow, folder: Path) -> None:
    looks = json.loads((folder / "shift.json").read_text())["looks"][:10]
    for look in looks:
        del look["camera"]
        for item in look["objects"]:
            del item["stem"]
    found = shadow(looks=looks)
    first, second = found["picks"]
    assert not first["why"]
    assert second["why"] == "nothing was detected between the pick before and its begin"
    assert second["ours"] is None
    assert [words.partition(":")[0] for words in found["lacks"]] == [
        "stems", "where the camera was, in 10 of 10 looks"
    ]  # fmt: skip
    assert shadow(looks=[], code=1)["summary"]["judged"] == 0
    assert "name the gripper's joint" in shadow(gripper=None, code=2)["message"]
    assert "'jaw'" in shadow(gripper="jaw", code=2)["message"]


def test_pictures_in_files_are_looked_at_where_nothing_was_detected(
    shadow: Shadow, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    small = PhotoParameters(width=320, height=240, focal=240.0)
    shot = photograph(SCENE, parameters=small)
    for name, content in picture_files("a", shot.picture).items():
        (folder / name).write_bytes(content)
    lens = shot.picture.camera.document()
    place = {key: lens.pop(key) for key in ("position", "orientation")}
    times = [look["time"] for look in json.loads((folder / "shift.json").read_text())["looks"]]
    files = {"rgb": "a.rgb.png", "depth": "a.depth.png"}
    shown = [{"time": time, **files, "camera": place} for time in times]
    seen = shadow(looks=None, pictures=shown, camera=lens)
    assert [pick["harmful"] for pick in seen["picks"]] == [False, True]
    assert seen["lacks"] == ["detections: by our eyes, in 2 of its pictures"]  # one a second
    robot, state = posed(SCENE)
    on_hand = flange_of(robot, state.q).inverse() @ shot.picture.camera.pose
    held = {key: getattr(on_hand, key).tolist() for key in place} | {"mount": "hand"}
    for camera in ("a.camera.json", lens | held):  # once in a file, and on the hand
        alone = {"time": times[0], **files, "camera": camera}
        (look,) = load_recorded(changed(folder, looks=None, pictures=[alone]), SCENE).looks
        np.testing.assert_allclose(look.camera.position, shot.picture.camera.pose.position)
        (ripe,) = (item for item in look.in_base() if item.role == "target")
        assert np.linalg.norm(ripe.position - SCENE.target.position) < 0.01
    for wrong, words in (
        ({"depth": None}, "has no depth: name a file of it"),
        ({"camera": lens}, "must have position and orientation, of the camera in the robot's base"),
        ({"rgb": "b.png", "camera": lens | place}, "b.png: cannot be read"),
        ({"camera": {}}, "width, height, fx, fy, cx, cy missing"),
        ({"time": 1e4}, "after the newest joint states"),
    ):
        assert words in shadow(looks=None, pictures=[alone | wrong], code=2)["message"]
    monkeypatch.setattr(parts, "added", lambda name: None)
    message = shadow(looks=None, pictures=[alone], code=2)["message"]
    assert "pip install -e packages/optipromp-eyes" in message


def test_marks_cut_the_picks(shadow: Shadow, folder: Path) -> None:
    read = load_recorded(folder / "shift.json", SCENE)
    closed = read.marks[0].closed
    (folder / "marks.json").write_text(json.dumps({"picks": [{"closed": closed, "start": 0.3}]}))
    found = shadow("--marks", str(folder / "marks.json"))
    assert found["cut"] == "as the recording's marks say"
    assert found["picks"][0]["seconds"]["recorded"][0] == pytest.approx(closed - 0.3)
    (whole,) = shadow(picks=[{"closed": closed, "end": closed + 0.1}])["picks"]
    assert "its way out was not recorded" in " ".join(whole["notes"])
    for look in (looks := json.loads((folder / "shift.json").read_text())["looks"]):
        for item in look["objects"]:  # what it took was unripe, and another is ripe
            item["role"] = "target" if item["id"] == SCENE.pushables[0].id else "pushable"
    (unripe,) = shadow(picks=[{"closed": closed}], looks=looks)["picks"]
    assert unripe["harmful"]
    (early,) = shadow(picks=[{"closed": 1.5}], code=1)["picks"]
    assert "closed where no fruit was seen" in early["why"]


def test_a_gripper_closes_where_its_joint_leaves_its_first_value() -> None:
    q = np.array([0.0, 0.001, 0.03, 0.04, 0.012, 0.0, 0.0, 0.01, 0.0])
    assert list(closings(Series(np.arange(9.0), q[:, None]))) == [2.0, 7.0]
    assert not list(closings(Series(np.arange(3.0), np.full((3, 1), 0.04))))


def test_a_pick_begins_at_the_last_stand_far_from_the_grasp_and_knows_no_gap() -> None:
    arm, gap = Measured(ROBOT.joint_names), Measured(ROBOT.joint_names)
    times = np.arange(0.0, REACH.duration + 4.0, 0.01)
    noise = np.random.default_rng(0).normal(0.0, 2e-4, (len(times), len(START.q)))
    for time, q in zip(times, REACH.sample(times - 1.0)[0] + noise, strict=True):
        arm.heard(time, ROBOT.joint_names, q)
        if not 1.5 < time < 2.0:
            gap.heard(time, ROBOT.joint_names, q)
    closed = Mark(closed=REACH.duration + 2.0)
    span = span_of(arm, ROBOT, closed, -np.inf, np.inf)
    assert span.start == pytest.approx(1.0, abs=0.15)
    assert span.reach.duration == pytest.approx(REACH.duration, abs=0.4)  # without the wait
    assert span.out is None
    np.testing.assert_allclose(span.reach.positions[0], START.q, atol=2e-3)
    with pytest.raises(InvalidRequestError, match="did not move"):
        span_of(arm, ROBOT, Mark(closed=0.5), -np.inf, np.inf)
    with pytest.raises(InvalidRequestError, match=r"no joint states for 0\.5\d s"):
        span_of(gap, ROBOT, closed, -np.inf, np.inf)
