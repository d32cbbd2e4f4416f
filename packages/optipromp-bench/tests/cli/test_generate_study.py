import json
import re
from dataclasses import replace
from pathlib import Path

import pytest
from tests.cli.fixtures import call, invoke, refused
from tests.cli.fixtures import told as document_of
from tests.experiments.rows import ROW
from tests.scenes.six_joints import six

from optipromp.core.scenes import bare_robot, load_scene
from optipromp_bench.experiments import study


def ran(*words: object) -> str:
    code, out, error = call(*words)
    assert code == 0, out + error
    return out


def test_generate_writes_scenes_and_tells_of_redraws(tmp_path: Path) -> None:
    words = "generate --preset mixed --seed 3 --count 2 --out"
    assert "sampled again" in ran(*words.split(), tmp_path)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["mixed-3.yaml", "mixed-4.yaml"]
    assert load_scene(tmp_path / "mixed-4.yaml").name == "mixed-4"


def test_generate_json(tmp_path: Path) -> None:
    document = document_of("generate", "--preset", "shelf", "--out", tmp_path)
    assert document["preset"] == "shelf"
    (scene,) = document["scenes"]
    assert Path(scene["file"]).exists()
    assert document["redraws"] == scene["redraws"] == sum(scene["reasons"].values())


def test_generate_leaves_the_scenes_as_a_detector_sees_them(tmp_path: Path) -> None:
    words = "generate --preset cluster --seed 6 --count 8 --out"
    told = [*words.split(), str(tmp_path)]
    missed = 0
    for record in document_of(*told, "--noise", "detector")["scenes"]:
        true, seen = load_scene(Path(record["file"])), load_scene(Path(record["seen"]))
        assert {i.id for i in true.objects} - {i.id for i in seen.objects} == set(record["missed"])
        assert seen.target.covariance is not None
        missed += len(record["missed"])
    assert missed > 0
    assert refused(*told, "--noise", "lower")


@pytest.fixture
def quick(monkeypatch):
    def run_trials(_, preset, seed, condition, planners, version):
        row = replace(
            ROW, preset=preset, seed=seed, cause="stem_caught", causes="", version=version
        )
        return [replace(row, planner=planner, success=planner == "chomp") for planner in planners]

    monkeypatch.setattr(study, "run_trials", run_trials)
    monkeypatch.setattr(study, "warm_up", lambda *_: None)


def test_study_prints_rates_and_causes(quick, tmp_path: Path) -> None:
    arguments = [
        "bench", "study", "presets=cluster, shelf", "planners=straight,chomp", "seeds=5:8",
        "--workers", "1", "--out", str(tmp_path),
    ]  # fmt: skip
    ran(*arguments)
    told = (tmp_path / "tables.md").read_text()
    assert "3 stem caught" in told
    assert "44–100" in told  # 3 of 3
    names = {"rows.csv", "study.json", "summary.json", "study.svg"}
    assert names <= {p.name for p in tmp_path.iterdir()}
    assert (tmp_path / "study.svg").read_text().startswith("<svg")
    document = document_of(*arguments)
    assert document["runs"] == 12
    assert [cell["rate"] for cell in document["cells"]] == [0.0, 1.0, 0.0, 1.0]
    kept = json.loads((tmp_path / "summary.json").read_text())["cells"]
    assert [{"study": "", **cell} for cell in kept] == document["cells"]
    assert json.loads((tmp_path / "study.json").read_text())["risk"] == 0.03
    assert "holds rows with risk 0.03, this study has 0.01" in refused(*arguments, "risk=0.01")
    assert "study.0.seeds" in refused(*arguments, "seeds=5")
    old = refused("study", "--preset", "cluster")
    assert "study is now: optipromp bench study presets=NAMES" in old


def test_scenes_of_another_robot_and_a_plan_with_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """--robot of generate names the robot in the file; --robot of plan takes its place."""
    monkeypatch.chdir(tmp_path)  # which holds the robot and the scenes
    (tmp_path / "six.urdf").write_text(six())
    told = ["--robot", str(tmp_path / "six.urdf"), "--tip", "tool0", "--base", "base"]
    out = tmp_path / "scenes"
    ran("generate", "--preset", "cluster", *told, "--out", out)
    scene = load_scene(out / "cluster-0.yaml")
    assert scene.choice.tip == "tool0"
    assert bare_robot(scene).joint_names == tuple(f"j{k}" for k in range(6))
    wrong = document_of("plan", out / "cluster-0.yaml", "--robot", "panda", code=2)
    assert wrong["status"] == "START_INVALID"
    assert "l9" in document_of("plan", out / "cluster-0.yaml", "--tip", "l9", code=2)["message"]


def test_generate_tells_how_scenes_may_read_a_robot_that_lies_elsewhere(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    robots, here = tmp_path / "ro bots", tmp_path / "here"
    robots.mkdir()
    here.mkdir()
    (robots / "six.urdf").write_text(six())
    monkeypatch.chdir(here)
    words = "generate --preset cluster --tip tool0 --base base --out scenes --robot"
    told = [*words.split(), str(robots / "six.urdf")]
    export = ran(*told).splitlines()[-1].partition(": ")[2]
    assert export == f"export OPTIPROMP_FOLDERS='{robots}'"
    assert document_of(*told)["folders"] == [str(robots)]
    monkeypatch.setenv("OPTIPROMP_FOLDERS", str(robots))
    assert bare_robot(load_scene(here / "scenes" / "cluster-0.yaml")).n_joints == 6
    assert "export" not in ran(*told)


@pytest.mark.filterwarnings("ignore:no built-in demonstrations")
def test_the_ten_minutes_of_add_a_robot(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The steps of docs/add-a-robot.md: what the page says to type works for an arm never seen."""
    pytest.importorskip("mujoco")
    page = Path(__file__).resolve().parents[4] / "docs/add-a-robot.md"
    section = page.read_text().split("## In ten minutes")[1].split("## ")[0]
    commands = [" ".join(words.split()) for words in re.findall(r"`optipromp ([^`]*)`", section)]
    assert [words.split()[0] for words in commands] == [
        "check", "generate", "plan", "simulate", "bench",
    ]  # fmt: skip
    monkeypatch.chdir(tmp_path)
    (tmp_path / "my-arm.urdf").write_text(six())
    for words in commands:
        quick = words.replace("--count 10", "--count 2").replace("seeds=0:50", "seeds=0:1")
        result = invoke(*quick.replace(" --video", "").split())
        harms = words.startswith("plan") and "HARM_PREDICTED" in result.output  # an answer too
        assert result.exit_code == 0 or harms, f"{words}: {result.output}"
    assert (tmp_path / "look/cover.png").is_file()
    assert (tmp_path / "plans/cluster-0/outcome.json").is_file()
    assert (tmp_path / "study/rows.csv").is_file()
