"""Annotations of pictures as COCO, read back by a reader of our own, as COCO's format tells."""

import json
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image
from tests.loaded import script

from optipromp.core.errors import InvalidRequestError
from optipromp.core.geometry.shapes import Ellipsoid
from optipromp.core.scenes.pose import Pose
from optipromp.core.scenes.scene import Scene, SceneObject, Stem, ToolSpec
from optipromp_sim.commands.generate import write_shot
from optipromp_sim.generate import generate
from optipromp_sim.simulation.photograph import PhotoParameters, photograph

coco = script("coco")
CATEGORIES, KEYS, document, record = coco.CATEGORIES, coco.KEYS, coco.document, coco.record


def decoded(segmentation):
    """The mask of run lengths: 0 and 1 in turn, column by column."""
    rows, columns = segmentation["size"]
    flat, value = [], 0
    for count in segmentation["counts"]:
        flat += [value] * count
        value = 1 - value
    assert len(flat) == rows * columns
    return np.array(flat, dtype=bool).reshape(columns, rows).T


def pixels(path):
    with Image.open(path) as opened:
        return np.asarray(opened)


def checked(content):
    """The document, after what COCO asks of all documents has been asserted."""
    images = {each["id"]: each for each in content["images"]}
    kinds = {each["id"]: each for each in content["categories"]}
    numbers = [each["id"] for each in content["annotations"]]
    assert len(set(numbers)) == len(numbers) > 0
    for each in content["annotations"]:
        image, kind = images[each["image_id"]], kinds[each["category_id"]]
        mask = decoded(each["segmentation"])
        assert mask.shape == (image["height"], image["width"])
        assert each["iscrowd"] == 0
        assert each["area"] == mask.sum() > 0
        rows, columns = np.nonzero(mask)
        x, y, wide, high = each["bbox"]
        assert (x, y) == (columns.min(), rows.min())
        assert (x + wide - 1, y + high - 1) == (columns.max(), rows.max())
        assert ("keypoints" in each) == (kind["supercategory"] == "fruit")
        if "keypoints" in each:
            points = np.reshape(each["keypoints"], (-1, 3))
            assert len(points) == len(kind["keypoints"]) == len(KEYS)
            assert each["num_keypoints"] == (points[:, 2] > 0).sum()
    return content


def test_key_points_of_a_photograph_are_where_the_fruit_is():
    """A fruit 40 cm before a level camera: its ends are above one another, 60 mm apart.

    The camera looks back at the arm, whose meshes differ with what is installed.
    """
    at = np.array([0.5, 0.0, 0.8])
    stem = Stem(np.array([at + [0.0, 0.0, 0.03], at + [0.0, 0.0, 0.13]]))
    ripe = SceneObject("ripe", "target", Ellipsoid((0.02, 0.02, 0.03)), at, stem=stem)
    level = Pose(at + [0.4, 0.0, 0.0], np.array([[0.0, 0, -1], [1, 0, 0], [0, -1, 0]]))
    scene = Scene("one", "panda", (ripe,), tool=ToolSpec("cup", {"radius": 0.03}), camera=level)
    still = PhotoParameters(width=160, height=120, focal=120.0, jitter=0.0)
    try:
        shot = photograph(scene, "beside", 1, still)
    except InvalidRequestError as error:
        pytest.skip(error.message)
    wanted = [[79.5, 59.5 + 120.0 * z / 0.4] for z in (0.03, -0.03, -0.13)]
    np.testing.assert_allclose(shot.keys["ripe"], wanted, atol=0.3)
    bare = replace(shot, masks=np.where(shot.mask("ripe", "stem"), 0, shot.masks))
    for seen, told in ((shot, [2, 2, 2]), (bare, [2, 2, 1])):  # hidden is the stem's root
        content = checked(document([record("one", seen)]))
        (fruit,) = [each for each in content["annotations"] if "keypoints" in each]
        assert fruit["keypoints"][2::3] == told
        assert fruit["object"] == "ripe"


def test_annotations_of_a_folder_are_those_of_its_pictures(tmp_path, monkeypatch):
    small = PhotoParameters(width=160, height=120, focal=120.0)
    made = []
    for seed in (3, 4):
        try:
            shot = photograph(generate("cluster", seed), "beside", seed, small)
        except InvalidRequestError as error:
            pytest.skip(error.message)
        write_shot(shot, shot.scene.name, tmp_path)
        made.append(record(shot.scene.name, shot))
    monkeypatch.setattr("sys.argv", ["coco.py", str(tmp_path)])
    coco.main()
    content = json.loads((tmp_path / "annotations.json").read_text())
    assert content == json.loads(json.dumps(checked(document(made))))
    fruits = [each for each in content["annotations"] if "keypoints" in each]
    assert {v for each in fruits for v in each["keypoints"][2::3]} == {0, 2}  # outside, visible
    assert [each["name"] for each in content["categories"]] == [*CATEGORIES]
    for image in content["images"]:
        name = image["file_name"].removesuffix(".rgb.png")
        assert image["camera"] == json.loads((tmp_path / f"{name}.camera.json").read_text())
        masks, depth = (pixels(tmp_path / f"{name}.{end}.png") for end in ("masks", "depth"))
        assert masks.shape == depth.shape == (image["height"], image["width"])
        rows = json.loads((tmp_path / f"{name}.masks.json").read_text())
        own = [each for each in content["annotations"] if each["image_id"] == image["id"]]
        kept = [r for r in rows if r["kind"] in CATEGORIES and (masks == r["value"]).any()]
        for row, each in zip(kept, own, strict=True):
            np.testing.assert_array_equal(decoded(each["segmentation"]), masks == row["value"])
            assert each["object"] == row["id"]
