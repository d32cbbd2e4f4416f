"""Crop files, and scenes that name them."""

from dataclasses import replace

import numpy as np
import pytest

from optipromp.core.errors import InvalidSceneError
from optipromp.core.scenes import load_crop, load_scene, save_scene
from optipromp.core.scenes.crops import (
    ROWS,
    crop_from_dict,
    crop_names,
    crop_to_dict,
    detaching,
    save_crop,
)


@pytest.mark.parametrize("name", ["strawberry", "tomato", "apple"])
def test_a_crop_survives_its_file(name, tmp_path):
    crop = load_crop(name)
    assert name in crop_names()
    assert list(crop.rows) == list(ROWS)
    assert all(row.source for row in crop.rows.values())
    for file in ("crop.yaml", "crop.json"):
        save_crop(crop, tmp_path / file)
        assert load_crop(tmp_path / file) == crop


def test_a_scene_names_its_crop(tmp_path):
    scene = replace(load_scene("scenario-3"), crop=load_crop("tomato"))
    save_scene(scene, tmp_path / "scene.yaml")
    assert "crop: tomato" in (tmp_path / "scene.yaml").read_text()
    assert load_scene(tmp_path / "scene.yaml").crop == load_crop("tomato")
    (tmp_path / "mine.yaml").write_text("name: mine\nlike: apple\n")
    text = (tmp_path / "scene.yaml").read_text()
    (tmp_path / "scene.yaml").write_text(text.replace("crop: tomato", "crop: mine.yaml"))
    assert load_scene(tmp_path / "scene.yaml").crop == replace(load_crop("apple"), name="mine")
    (tmp_path / "scene.yaml").write_text(text.replace("crop: tomato", "crop: /etc/crop.yaml"))
    with pytest.raises(InvalidSceneError, match="outside the folder"):
        load_scene(tmp_path / "scene.yaml")
    (tmp_path / "scene.yaml").write_text(text.replace("crop: tomato", "crop: {name: a, width: 3}"))
    with pytest.raises(InvalidSceneError, match="crop: width: is 3: must be a mapping"):
        load_scene(tmp_path / "scene.yaml")


def test_a_scene_holds_a_crop_of_a_file(tmp_path):
    """Wherever the file is, and the scene is moved."""
    crop = load_crop("tomato").changed("width", 0.05)
    save_crop(crop, tmp_path / "elsewhere.yaml")
    scene = replace(load_scene("scenario-3"), crop=load_crop(tmp_path / "elsewhere.yaml"))
    save_scene(scene, tmp_path / "inner" / "scene.yaml")
    (tmp_path / "elsewhere.yaml").unlink()
    assert load_scene(tmp_path / "inner" / "scene.yaml").crop == crop


WIDTH = {"value": 60, "unit": "mm", "source": "ruler"}


@pytest.mark.parametrize(
    ("document", "told"),
    [
        ({"name": "a"}, "width is missing: state it, or like: apple, strawberry, tomato"),
        ({"like": "tomatoe"}, "like is 'tomatoe'.*did you mean 'tomato'"),
        ({"width": WIDTH | {"unit": "m"}}, "width: 60 m is out of range: must be 0.004 to 0.4 m"),
        ({"width": WIDTH | {"unit": "N"}}, "width.unit is 'N': valid are mm, cm, m"),
        ({"width": {"value": 60, "unit": "mm"}}, "width.source is missing"),
        ({"width": WIDTH | {"range": [50, 70]}}, "width: range is .*: must be of a guess"),
        (
            {"abscission": {"value": [5, 3], "unit": "N", "angles": [0, 60], "source": "scale"}},
            "abscission: angles are .*: must ascend from 0 to 90",
        ),
    ],
)
def test_a_crop_is_refused_by_its_row(document, told):
    whole = {"name": "a"} | ({} if document == {"name": "a"} else {"like": "tomato"}) | document
    with pytest.raises(InvalidSceneError, match=rf"mine.yaml: {told}"):
        crop_from_dict(whole, "mine.yaml")


def test_rows_that_are_missing_are_of_the_crop_that_it_is_like():
    crop = crop_from_dict({"name": "mine", "like": "tomato", "width": WIDTH}, "mine.yaml")
    assert crop["width"] == 0.06
    assert crop.rows["edge_force"] == load_crop("tomato").rows["edge_force"]
    assert crop_from_dict(crop_to_dict(crop), "again") == crop


def test_a_pull_detaches_by_its_angle():
    """Beyond 90 degrees by what is across the stem: F(90) / sin."""
    forces = detaching(load_crop("strawberry"), np.array([0.0, 15.0, 90.0, 150.0]))
    np.testing.assert_allclose(forces, [5.0, 4.5, 3.0, 6.0])


def test_a_verdict_hangs_on_the_guesses_whose_ends_change_it():
    """A lasting force bears 5 N, guessed between 2.5 and 10; a blow's energy is measured."""
    rows = load_crop("strawberry").rows
    for share, hangs in ((0.4, False), (0.6, True), (1.5, True), (2.1, False)):
        assert rows["pressed_force"].hangs(5.0 * share) is hangs
        assert not rows["impact_energy"].hangs(0.04 * share)
