"""Eyes that are taught another crop by ten marks, and what they then see in other pictures."""

import json
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.cli.fixtures import completed
from tests.perception.dyed import crop_of, marks_on, recall, shots_of
from tests.perception.shots import written

from optipromp.core.scenes.crops import load_crop
from optipromp_eyes import EyeParameters, eyes_of
from optipromp_sim.simulation.photograph import Photograph

TEN = {"ripe": 3, "unripe": 4, "stem": 3}
SEEDS, TAUGHT = range(400, 407), 4  # pictures, and how many of them are marked
CROPS: Mapping[str, tuple[Any, ...]] = {  # width, length over width, stem [m]; colours; focal
    "yellow-tomato": (
        (0.055, 0.95, 0.08), {"ripe": (50, 0.8, 0.8), "unripe": (85, 0.5, 0.6),
                              "stem": (95, 0.5, 0.4)}, 480.0),
    "white-strawberry": (
        (0.032, 1.2, 0.15), {"ripe": (30, 0.1, 0.9), "unripe": (75, 0.4, 0.75),
                             "stem": (95, 0.55, 0.45)}, 480.0),
    "blueberry": (
        (0.016, 0.9, 0.03), {"ripe": (225, 0.5, 0.35), "unripe": (95, 0.4, 0.6),
                             "stem": (80, 0.45, 0.45)}, 1200.0),
}  # fmt: skip


@cache
def pictures_of(name: str) -> tuple[dict[str, Photograph], dict[str, Photograph]]:
    """Of a crop: pictures to teach by, and others."""
    sizes, dye, focal = CROPS[name]
    shots = list(shots_of(crop_of(name, *sizes), dye, SEEDS, focal).items())
    return dict(shots[:TAUGHT]), dict(shots[TAUGHT:])


def taught(
    shots: Mapping[str, Photograph], marks: object, folder: Path, *more: object, code: int = 0
) -> Any:
    """What the command did that teaches by these pictures and marks."""
    written(folder, **{name: shot.picture for name, shot in shots.items()})
    (folder / "marks.json").write_text(json.dumps(marks))
    known, own = ("--known", "scenario-3"), ("--teach", folder / "marks.json")
    out = "--out", folder / "taught.yaml"
    return completed("see", folder, *known, *own, *out, *more, code=code)


def refusal(*given: Any) -> str:
    return " ".join(taught(*given, code=2).output.split())


@pytest.mark.parametrize("name", [*CROPS, "white-strawberry by clicks"])
def test_ten_marks_teach_a_crop_that_the_eyes_then_see_elsewhere(name: str, tmp_path: Path) -> None:
    """Of seven fruits and more in three other pictures."""
    name, _, click = name.partition(" by ")
    teach, others = pictures_of(name)
    done = taught(teach, marks_on(teach, TEN, bool(click)), tmp_path, "--json")
    assert json.loads(done.stdout)["name"] == "taught"
    crop = load_crop(tmp_path / "taught.yaml")
    assert crop["width"] == pytest.approx(CROPS[name][0][0], rel=0.35 if click else 0.15)
    visible, found, right, wrong, stems = recall(others, eyes_of(crop))
    assert visible >= 7
    assert found == visible
    assert right == found
    assert wrong <= 1
    assert stems >= 0.6 * found
    if not click:  # of the right kind, untaught
        assert recall(others, EyeParameters())[2] < 0.8 * right


def test_coco_teaches_as_a_list_does(tmp_path: Path) -> None:
    teach, _ = pictures_of("white-strawberry")
    marks = marks_on(teach, TEN)
    names, kinds = [*teach], ["leaf", *TEN]
    coco = {
        "images": [{"id": k, "file_name": f"{name}.rgb.png"} for k, name in enumerate(names)],
        "categories": [{"id": k, "name": kind} for k, kind in enumerate(kinds)],
        "annotations": [
            {"image_id": names.index(m["picture"]), "category_id": kinds.index(m["kind"]),
             "bbox": [*m["box"][:2], *np.subtract(m["box"][2:], m["box"][:2]).tolist()]}
            for m in marks
        ],
    }  # fmt: skip
    coco["annotations"].append({"image_id": 0, "category_id": 0, "bbox": [1, 1, 5, 5]})
    crops = []
    for folder, given in ((tmp_path / "list", marks), (tmp_path / "coco", coco)):
        folder.mkdir()
        taught(teach, given, folder)
        crops.append(load_crop(folder / "taught.yaml"))
    assert crops[0] == crops[1]


def test_the_taught_file_is_of_the_crop_that_it_is_like_in_all_else(tmp_path: Path) -> None:
    teach, _ = pictures_of("yellow-tomato")
    taught(teach, marks_on(teach, TEN), tmp_path, "--crop", "tomato")
    crop, tomato = load_crop(tmp_path / "taught.yaml"), load_crop("tomato")
    assert crop.name == "taught"
    changed = {name for name, row in crop.rows.items() if row != tomato.rows[name]}
    assert changed == {"width", "elongation"}
    assert not any(crop.rows[name].guess for name in changed)
    assert crop.eyes["source"] == "taught by 3 ripe, 4 unripe, 3 stem"


def test_kinds_of_one_colour_are_refused_with_what_their_colours_are(tmp_path: Path) -> None:
    """Ripe fruits that look as unripe ones: every second unripe one is said to be ripe."""
    teach, _ = pictures_of("yellow-tomato")
    marks = [m for m in marks_on(teach, {"unripe": 8}) if m["kind"] == "unripe"]
    for k, mark in enumerate(marks):
        mark["kind"] = ("ripe", "unripe")[k % 2]
    told = refusal(teach, marks, tmp_path)
    assert "ripe cannot be told from the rest by colour (hue 8" in told
    assert "brightness" in told
    assert "--finder" in told
    assert not (tmp_path / "taught.yaml").exists()


@pytest.mark.parametrize(
    ("change", "told"),
    [({"picture": "elsewhere"}, "'elsewhere', which is no picture: valid are"),
     ({"kind": "rip"}, "mark 1: kind is 'rip': valid are ripe, unripe, stem; did you mean 'ripe'"),
     ({"box": [9, 9, 5, 12]}, "must be left, top, right, bottom"),
     ({"box": [1, 2]}, "must be left"),
     ({"box": [600, 2, 9000, 9]}, "no depth was measured: mark another one")],
)  # fmt: skip
def test_a_mark_that_cannot_be_used_is_refused_by_its_cause(
    change: dict[str, object], told: str, tmp_path: Path
) -> None:
    teach, _ = pictures_of("yellow-tomato")
    marks = marks_on(teach, TEN)
    marks[0] |= change
    assert told in refusal(teach, marks, tmp_path)


def test_too_few_marks_and_files_that_are_none_are_refused(tmp_path: Path) -> None:
    teach, _ = pictures_of("yellow-tomato")
    few = marks_on(teach, {"ripe": 2})
    assert "2 ripe fruits are marked: mark at least 3" in refusal(teach, few, tmp_path)
    assert "give --out FILE.yaml" in refusal(teach, few, tmp_path, "--out", tmp_path / "folder")
    assert "must be a list of marks" in refusal(teach, {"boxes": []}, tmp_path)
