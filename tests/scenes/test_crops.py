"""Crop files, and scenes that name them."""

from dataclasses import replace

import numpy as np
import pytest

from optipromp.core.errors import InvalidSceneError
from optipromp.core.scenes import load_crop, load_scene, save_scene
from optipromp.core.scenes.crops import (
    ROWS,
    crop_document,
    crop_from_dict,
    crop_names,
    hanging_on,
    save_crop,
)


@pytest.mark.parametrize("name", ["strawberry", "tomato", "apple"])
def test_a_crop_survives_its_file(name, tmp_path):
    crop = load_crop(name)
    assert name in crop_names()
    assert list(crop.rows) == list(ROWS)
    assert all(row.source for row in crop.rows.values())
    save_crop(crop, tmp_path / "crop.yaml")
    assert load_crop(tmp_path / "crop.yaml") == replace(crop, path=tmp_path / "crop.yaml")


def test_a_scene_names_its_crop(tmp_path):
    scene = replace(load_scene("scenario-3"), crop=load_crop("tomato"))
    save_scene(scene, tmp_path / "scene.yaml")
    assert "crop: tomato" in (tmp_path / "scene.yaml").read_text()
    assert load_scene(tmp_path / "scene.yaml").crop == load_crop("tomato")
    save_crop(load_crop("apple").changed("width", 0.07), tmp_path / "mine.yaml")
    own = replace(scene, crop=load_crop(tmp_path / "mine.yaml"))
    save_scene(own, tmp_path / "scene.yaml")
    assert "crop: mine.yaml" in (tmp_path / "scene.yaml").read_text()
    assert load_scene(tmp_path / "scene.yaml").crop["width"] == 0.07
    changed = replace(scene, crop=scene.crop.changed("width", 0.05))
    with pytest.raises(InvalidSceneError, match="was made in memory"):
        save_scene(changed, tmp_path / "scene.yaml")
    (tmp_path / "inner").mkdir()
    text = (tmp_path / "scene.yaml").read_text().replace("mine.yaml", "/etc/crop.yaml")
    (tmp_path / "inner" / "scene.yaml").write_text(text)
    with pytest.raises(InvalidSceneError, match="outside the folder"):
        load_scene(tmp_path / "inner" / "scene.yaml")


WIDTH = {"value": 60, "unit": "mm", "source": "ruler"}


@pytest.mark.parametrize(
    ("document", "told"),
    [
        ({"name": "a"}, "width is missing: state it, or like: apple, strawberry, tomato"),
        ({"like": "tomatoe"}, "like is 'tomatoe'.*did you mean 'tomato'"),
        ({"wdth": WIDTH}, "unknown key 'wdth'.*did you mean 'width'"),
        ({"width": WIDTH | {"unit": "m"}}, "width is 60 m: must be 0.004 to 0.4 m"),
        ({"width": WIDTH | {"unit": "N"}}, "width.unit is 'N': must be mm or cm or m"),
        ({"width": {"value": 60, "unit": "mm"}}, "width.source is missing"),
        ({"width": WIDTH | {"value": "60"}}, r"width.value\[0\] is '60': must be a number"),
        ({"width": WIDTH | {"range": [50, 70]}}, "width.range is .*: must be of a guess"),
        ({"width": WIDTH | {"value": [50, 60]}}, "width.value must be one number"),
        (
            {"abscission": {"value": [5, 3], "unit": "N", "angles": [0, 60], "source": "scale"}},
            "abscission.angles are .*: must ascend from 0 to 90",
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
    assert crop_from_dict(crop_document(crop), "again") == crop


def test_a_pull_detaches_by_its_angle():
    """Beyond 90 degrees by what is across the stem: F(90) / sin."""
    forces = load_crop("strawberry").detaching(np.array([0.0, 15.0, 90.0, 150.0]))
    np.testing.assert_allclose(forces, [5.0, 4.5, 3.0, 6.0])


def test_a_verdict_hangs_on_the_guesses_whose_ends_change_it():
    """A lasting force bears 5 N, guessed between 2.5 and 10; a blow's energy is measured."""
    for share, hangs in ((0.4, False), (0.6, True), (1.5, True), (2.1, False)):
        shares = {"pressed_force": share, "impact_energy": share}
        assert hanging_on(load_crop("strawberry"), shares) == (("pressed_force",) if hangs else ())
