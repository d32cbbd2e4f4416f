"""A study of scene files, through the command line."""

import csv
import json
from pathlib import Path

import pytest
from tests.cli.fixtures import call

from optipromp import load_scene, save_scene
from optipromp_bench.experiments.rows import rows_of
from optipromp_bench.experiments.study import settings_of


def study(*words: object) -> tuple[int, str, str]:
    return call("bench", "study", *words)


@pytest.fixture
def crop(tmp_path: Path) -> Path:
    for name in ("scenario-3", "scenario-4"):
        save_scene(load_scene(name), tmp_path / "crop" / f"my-{name}.yaml")
    return tmp_path / "crop"


def test_rows_name_the_files_and_a_study_goes_on(crop: Path, tmp_path: Path) -> None:
    words = "--scenes", crop, "planners=opti-promp", "--workers", 1, "risk=0.1"
    words += "--out", tmp_path / "out"
    code, stdout, _ = study(*words, "--json")
    assert code == 0
    assert json.loads(stdout)["runs"] == 2
    rows = rows_of(tmp_path / "out")
    assert [(row.preset, row.seed) for row in rows] == [
        ("my-scenario-3.yaml", 0),
        ("my-scenario-4.yaml", 0),
    ]
    assert all(row.success and row.plan_status == "success" for row in rows)
    before = (tmp_path / "out" / "rows.csv").read_bytes()
    assert study(*words)[0] == 0
    assert (tmp_path / "out" / "rows.csv").read_bytes() == before
    more = study(*words, "seeds=0:2", "noise_position=0.002")
    assert more[0] == 2  # rows of another noise are not mixed
    assert study(*words, "seeds=0:2")[0] == 0
    with (tmp_path / "out" / "rows.csv").open() as file:
        assert [row["seed"] for row in csv.DictReader(file)] == ["0", "0", "1", "1"]
    assert settings_of(tmp_path / "out")[1] == ""  # each scene's own
    (crop / "my-scenario-4.yaml").write_text((crop / "my-scenario-3.yaml").read_text())
    code, _, stderr = study(*words)
    assert code == 2
    assert "scenes" in stderr


def test_loops_on_files(crop: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    words = "--scenes", crop, "loops=open", "conditions=none", "--out", out
    code, stdout, _ = study(*words, "--workers", 1)
    assert code == 0
    assert all(word in stdout for word in ("By condition", "open", "gave", "wrote rows"))
    code, stdout, _ = study(*words, "--workers", 1, "--json")
    told = json.loads(stdout)
    assert (code, told["runs"]) == (0, 2)
    kept = json.loads((out / "summary.json").read_text())["loops"]
    assert [{"study": "", **cell} for cell in kept] == told["cells"]
    assert {(row.preset, row.loop) for row in rows_of(out)} == {
        ("my-scenario-3.yaml", "open"),
        ("my-scenario-4.yaml", "open"),
    }


def test_wrong_scenes_are_refused(crop: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    code, _, stderr = study("--scenes", crop, "presets=cluster", "--out", out)
    assert (code, "state one of them" in stderr) == (2, True)
    text = (crop / "my-scenario-3.yaml").read_text()
    (crop / "my-scenario-3.yaml").write_text(text.replace("objects:", "objets:"))
    code, _, stderr = study("--scenes", crop, "risk=0.1", "--out", out)
    assert (code, "my-scenario-3.yaml" in stderr) == (2, True)
    assert not out.exists()
