"""The commands, called in this process."""

import json
from pathlib import Path
from typing import get_args

import numpy as np
import pytest
from tests.cli.fixtures import completed, invoke, refused, told

from optipromp.cli import console
from optipromp.core.promp import Basis, ProMP, load_demonstrations, residuals
from optipromp.core.robots.tools import TOOLS


@pytest.fixture
def demonstrations(tmp_path: Path) -> Path:
    phase = np.linspace(0.0, 1.0, 40)
    goals = np.linspace(0.5, 1.0, 6)
    positions = goals[:, None, None] * (phase**2 * (3 - 2 * phase))[None, :, None] * np.ones(3)
    path = tmp_path / "recorded.npz"
    np.savez(path, positions=positions, joint_names=np.array(["a", "b", "c"]))
    return path


def test_list_as_json_is_one_document() -> None:
    document = told("list")
    assert {"panda", "scara"} <= set(document["robots"])
    assert {f"scenario-{i}" for i in (1, 2, 3, 4)} <= set(document["scenes"])
    assert document["tools"] == [*TOOLS]
    assert document["planners"][:3] == ["promp", "i-promp", "opti-promp"]
    of_planners = [document["settings"], *document["planner_settings"].values()]
    assert all(one["meaning"] for settings in of_planners for one in settings.values())


def test_presets_are_those_of_the_library() -> None:
    from optipromp_sim.generate import PRESETS

    assert get_args(console.Preset) == PRESETS


@pytest.mark.parametrize(
    ("opening", "told"),
    [
        (0.06, ""),
        (0.046, "; 25 degrees off the approach it is 39.6 mm wide: fits"),
        (0.03, "in the cone of the approach it is nowhere narrower than 3"),
    ],
)
def test_check_says_that_a_cup_is_too_narrow(tmp_path: Path, opening: float, told: str) -> None:
    """A fruit of 36 x 60 mm leans by 45 degrees: it is 49.5 mm wide across the vertical."""
    path = tmp_path / "narrow.yaml"
    path.write_text(
        "name: narrow\nrobot: panda\n"
        f"tool: {{kind: cup, radius: 0.032, opening: {opening}}}\n"
        "objects:\n"
        "  - {id: ripe, role: target, shape: {ellipsoid: {radii: [0.018, 0.018, 0.03]}},\n"
        "     position: [0.45, 0.0, 0.89], orientation: [0.92388, 0.0, 0.382683, 0.0],\n"
        "     stem: {root: [0.55, 0.0, 0.99]}}\n",
        encoding="utf-8",
    )
    result = completed("check", path)
    said = " ".join(result.stderr.split())
    assert ("too narrow" in said) is bool(told)
    if told:
        wide = "ripe is 49.5 mm wide across the approach, the tool's opening"
        assert f"{wide} {1e3 * opening:.1f} mm is too narrow: one of 51.5 mm fits" in said
        assert told in said


def test_check_tells_the_body_of_a_robot(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ball = '<collision><geometry><box size="0.1 0.1 0.2"/></geometry></collision>'
    joints = "".join(
        f'<joint name="{a}{b}" type="continuous"><parent link="{a}"/><child link="{b}"/>'
        '<origin xyz="0 0 0.4"/><axis xyz="1 0 0"/></joint>'
        for a, b in ("ab", "bc", "cd")
    )
    links = "".join(f'<link name="{link}">{ball}</link>' for link in "abcd")
    path = tmp_path / "arm.urdf"
    path.write_text(f'<robot name="arm">{links}{joints}</robot>')
    (tmp_path / "arm.srdf").write_text(
        '<robot name="arm"><disable_collisions link1="a" link2="c"/></robot>'
    )
    arguments = ["check", str(path), "--out", str(tmp_path / "out"), "--json"]
    document = json.loads(invoke(*arguments).stdout)
    assert sum(document["spheres"].values()) == document["body_spheres"]
    assert set(document["spheres"]) == set("abcd")
    assert 0.0 < document["excess"]["a"] < 0.03
    assert "a and c (arm.srdf)" in document["may_touch"]
    monkeypatch.setattr("optipromp.cli.check.LISTED", 3)
    shown = dict(line.split(maxsplit=1) for line in invoke("check", path).stdout.splitlines()[1:])
    assert shown["links"] == "a, b, c, and 1 more (--json)"
    assert shown["joints"] == "ab, bc, cd"
    for name in ("cover", "workspace"):
        assert (tmp_path / "out" / f"{name}.png").read_bytes().startswith(b"\x89PNG")


def test_check_leaves_pictures_of_a_scene(tmp_path: Path, demonstrations: Path) -> None:
    completed("check", "scenario-4", "--out", tmp_path)
    for name in ("scene", "workspace"):
        assert (tmp_path / f"{name}.png").read_bytes().startswith(b"\x89PNG")
    assert b"</html>" in (tmp_path / "scene.html").read_bytes()[-200:].lower()
    assert "no --out" in refused("check", demonstrations, "--out", tmp_path)


def test_an_error_under_json_is_still_one_document() -> None:
    result = invoke("check", "nothing-of-that-name", "--json")
    document = json.loads(result.stdout)
    assert result.exit_code == 2
    assert document["status"] == "INVALID_REQUEST"
    assert "scenario-1" in document["message"]


@pytest.mark.parametrize("command", [["plan", "scenario-3"], ["scenarios"]])
def test_an_unwritable_folder_is_refused_before_the_work(tmp_path, command):
    blocked = tmp_path / "file"
    blocked.write_text("in the way")
    assert "cannot write" in refused(*command, "--out", blocked / "reach")
    assert blocked.read_text() == "in the way"


def test_learn_leaves_a_primitive_that_check_knows(demonstrations: Path, tmp_path: Path) -> None:
    out = tmp_path / "reach.npz"
    arguments = ["learn", str(demonstrations), "--out", str(out), "--bases", "7", "--json"]
    document = json.loads(invoke(*arguments).stdout)
    assert document["bases"] == 7
    assert document["held_out_residual"] == {}
    assert document["demonstrations"] == 6
    assert Path(document["figure"]).read_bytes().startswith(b"\x89PNG")
    checked = json.loads(invoke("check", out, "--json").stdout)
    assert (checked["kind"], checked["bases"]) == ("primitive", 7)


def test_learn_says_its_residual_and_how_many_bases_it_chose(demonstrations, tmp_path):
    out = tmp_path / "reach.npz"
    arguments = ["learn", str(demonstrations), "--out", str(out), "--no-figure"]
    document = json.loads(invoke(*arguments, "--json").stdout)
    held_out = {int(count): value for count, value in document["held_out_residual"].items()}
    assert document["bases"] == min(held_out, key=lambda count: held_out[count])
    rest = np.concatenate(residuals(load_demonstrations(demonstrations), Basis(document["bases"])))
    assert document["residual"]["rms"] == pytest.approx(np.sqrt((rest**2).mean()))
    assert document["residual"]["joints"]["b"]["largest"] == pytest.approx(np.abs(rest[:, 1]).max())
    assert document["figure"] is None
    assert not out.with_suffix(".png").exists()
    result = invoke(*arguments)
    assert result.stderr == ""
    assert f"{document['residual']['rms']:.4f}" in result.stdout.split("all")[-1]
    assert f"{document['bases']} bases a joint, cross-validated" in result.stdout


def test_learn_warns_of_what_its_bases_cannot_follow(tmp_path: Path) -> None:
    """A demonstration that jumps by 1 rad in a joint half-way."""
    positions = np.linspace(0.0, 1.0, 40)[None, :, None] * np.arange(1.0, 5.0)[:, None, None]
    positions[2, 20:] += 1.0
    positions[2, 20] += 0.05  # without it, sample 19 is as far away, up to rounding
    path, out = tmp_path / "jump.npz", tmp_path / "p.npz"
    np.savez(path, positions=positions, joint_names=np.array(["a"]))
    arguments = ["learn", str(path), "--out", str(out), "--bases", "6"]
    result = completed(*arguments)
    assert result.stderr.startswith("warning: ")
    assert ".py" not in result.stderr
    assert "warning: the bases are more than 0.05 rad (or m) from 1 of 4 demon" in result.stderr
    assert "furthest is demonstration 2, a, at phase 0.5" in result.stderr
    message = json.loads(invoke(*arguments, "--json").stdout)["message"]
    assert message in result.stderr


def test_names_are_asked_for(demonstrations: Path, tmp_path: Path) -> None:
    """Without names a file is learnt from with a warning, or in the order of a robot one names."""
    arrays = dict(np.load(demonstrations))
    del arrays["joint_names"]
    arrays["positions"] *= 0.4  # within the limits of the SCARA's lift
    path, out = tmp_path / "nameless.npz", tmp_path / "p.npz"
    np.savez(path, **arrays)
    learn = ["learn", str(path), "--out", str(out), "--no-figure"]
    for arguments in (learn, ["check", str(path)], ["check", str(out)]):
        result = completed(*arguments)
        assert "has joints called joint_1, joint_2 and so on, as columns with" in result.stderr
    result = invoke(*learn, "--robot", "scara", "--json")
    names = ["lift_joint", "shoulder_joint", "elbow_joint"]
    assert json.loads(result.stdout)["joints"] == names
    assert "taken to be lift_joint, shoulder_joint, elbow_joint, in this order" in result.stderr
    np.savez(path, **arrays, joint_names=np.array(sorted(names)))
    result = invoke(*learn, "--robot", "scara", "--json")
    assert json.loads(result.stdout)["joints"] == names
    assert result.stderr == ""
    start = arrays["positions"][:, :, [1, 2, 0]].mean(axis=0)[0]
    np.testing.assert_allclose(ProMP.load(out).mean_trajectory(2)[0], start, atol=0.01)
    said = refused(*learn, "--robot", "panda")
    assert said.startswith(f"error INVALID_DEMONSTRATION: {path}: the robot has no joint")


def test_learn_by_expectation_maximisation(demonstrations: Path, tmp_path: Path) -> None:
    out = tmp_path / "reach.npz"
    completed("learn", demonstrations, "--out", out, "--em")
    assert out.exists()


def test_learn_leaves_nothing_where_it_cannot_write(demonstrations: Path, tmp_path: Path) -> None:
    for out, words in (
        (demonstrations / "x.npz", "error INVALID_REQUEST: cannot write"),
        (tmp_path / "a.promp", "error INVALID_REQUEST: --out "),
    ):
        assert refused("learn", demonstrations, "--out", out).startswith(words.strip())
    assert sorted(path.name for path in tmp_path.iterdir()) == ["recorded.npz"]
