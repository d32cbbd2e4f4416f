"""Crops through the command line: scenes, runs and studies of them."""

from dataclasses import replace
from pathlib import Path

import pytest
from tests.cli.fixtures import told as run

from optipromp.core.scenes import load_crop, load_scene
from optipromp.core.scenes.crops import crop_from_dict, crop_to_dict, save_crop


def test_generate_draws_the_fruits_of_a_crop(tmp_path: Path) -> None:
    told = ["generate", "--preset", "cluster", "--seed", 0, "--count", 4, "--crop", "tomato"]
    made = run(*told, "--out", tmp_path)
    crop, widths = load_crop("tomato"), []
    for record in made["scenes"]:
        scene = load_scene(record["file"])
        assert scene.crop == crop
        for item in (scene.target, *scene.pushables):
            wide, _, half = item.shape.radii
            widths.append(2.0 * wide)
            assert half / wide == pytest.approx(0.9, abs=0.1)
            assert item.stem.length == pytest.approx(0.06, abs=0.031)
            assert not item.physical
        assert scene.tool.parameters["radius"] > scene.target.shape.radii[0]
    assert len(set(widths)) == len(widths) > 8
    assert sum(widths) / len(widths) == pytest.approx(0.06, abs=0.005)
    run(*told, "--out", tmp_path / "again")
    for record in made["scenes"]:
        name = Path(record["file"]).name
        assert (tmp_path / name).read_text() == (tmp_path / "again" / name).read_text()
    save_crop(replace(crop, name="mine"), tmp_path / "mine.yaml")
    told = run("check", tmp_path / "mine.yaml")
    assert (told["kind"], told["name"], told["width"]) == ("crop", "mine", "0.06 m")
    assert set(told["guesses"]) == set(crop.guesses)
    refused = run("generate", "--preset", "shelf", "--crop", "apple", "--out", tmp_path, code=2)
    assert "takes no crop" in refused["message"]


@pytest.fixture(scope="module")
def frail(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A strawberry of which one row is a guess: how hard it may be pressed."""
    document = crop_to_dict(load_crop("strawberry"))
    for name, row in document.items():
        if isinstance(row, dict) and name != "pressed_force":
            row.pop("guess", None)
            row.pop("range", None)
    document["pressed_force"]["range"] = [0.1, 10.0]
    file = tmp_path_factory.mktemp("crop") / "frail.yaml"
    save_crop(crop_from_dict(document, "frail"), file)
    return file


def test_a_study_tells_which_guess_changes_a_result(frail: Path, tmp_path: Path) -> None:
    told = ["bench", "study", "presets=cluster", "planners=opti-promp", "seeds=4:5"]
    told += ["--workers", "1", "--crop", str(frail), "--out", str(tmp_path)]
    made = run(*told, "vary=crop")
    names = [cell["preset"] for cell in made["cells"]]
    assert names == ["as the crop", "pressed_force 0.1 N", "pressed_force 10 N"]
    assert [cell["kept"] for cell in made["cells"]] == [1, 0, 1]
    assert made["cells"][1]["causes"] == {"crushed": 1}
    assert [cell["changed"] for cell in made["cells"]] == [0, 1, 0]
    assert "| changed |" in (tmp_path / "tables.md").read_text()
    run("report", tmp_path, "--out", tmp_path / "report.html")
    report = (tmp_path / "report.html").read_text()
    assert ">changed<" in report
    assert "vary=crop --crop CROP.yaml" in report


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("vary=crop",), "name it (--crop)"),
        (("--crop", "tomatoe"), "did you mean 'tomato'?"),
    ],
)
def test_a_study_refuses_guesses_of_no_crop(words, told, tmp_path):
    words += ("presets=cluster", "seeds=0:1")
    made = run("bench", "study", *words, "--out", tmp_path, code=2)
    assert told in made["message"]


def test_a_run_tells_what_its_verdict_hangs_on(frail: Path, tmp_path: Path) -> None:
    """Of a scene that holds its crop: the crop's file is elsewhere."""
    told = ("generate", "--preset", "cluster", "--seed", 4, "--crop", frail, "--out", tmp_path)
    (record,) = run(*told)["scenes"]
    made = run("simulate", record["file"], "--out", tmp_path / "run")
    assert made["crop"]["name"] == "strawberry"
    assert made["crop"]["hangs_on"] == ["pressed_force"]
    assert made["crop"]["decided"] == made["crop"]["guesses"] == []
    assert 0.1 < max(each["pressed_force"] for each in made["crop"]["figures"].values()) < 5.0
