"""Detectors of one's own, and the network: regions of what they say, fruits of what they see."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.loaded import script
from tests.perception.shots import shot_of

from optipromp.core.errors import InvalidRequestError
from optipromp.core.scenes.pose import Pose
from optipromp_eyes import look_at
from optipromp_eyes.detector import ByDetector, Detected, cut, finder_named, of_coco
from optipromp_eyes.pictures import CameraModel, DepthPicture

shapes = script("shapes").shapes


def picture() -> DepthPicture:
    """A ball of 20 pixels before a wall."""
    depth = np.full((120, 160), 0.9)
    rows, columns = np.indices(depth.shape)
    depth[np.hypot(rows - 60, columns - 80) < 20] = 0.5
    rgb = np.zeros((120, 160, 3), dtype=np.uint8)
    camera = CameraModel(160, 120, 150.0, 150.0, 79.5, 59.5, Pose())
    return DepthPicture(rgb, depth, camera)


def test_a_box_is_cut_by_depth() -> None:
    shown = picture()
    ball = shown.depth < 0.6
    assert (cut(shown, (55, 35, 106, 86)) == ball).all()
    assert not cut(shown, (-20, -20, -5, -5)).any()
    rod = np.abs(np.indices(ball.shape)[1] - 80) < 8  # before the middle of the ball
    crossed = replace(shown, depth=np.where(rod, 0.44, shown.depth))
    assert (ball & ~rod & cut(crossed, (55, 35, 106, 86))).sum() > 0.3 * ball.sum()
    right = ball & (np.indices(ball.shape)[1] >= 78)
    assert (cut(shown, (78, 35, 104, 86)) == right).all()


def test_masks_and_boxes_become_regions_the_surest_first() -> None:
    shown = picture()
    ball = shown.depth < 0.6
    left = ball & (np.indices(ball.shape)[1] < 80)
    told = [
        Detected("berry", 0.6, box=(55, 35, 106, 86)),
        Detected("red", 0.9, mask=left),
        Detected("leaf", 0.9, mask=ball),
        Detected("berry", 0.1, mask=ball),
        Detected("peduncle", 0.8, mask=np.eye(120, 160, dtype=bool)),
    ]
    finder = ByDetector(lambda rgb: told, {"red": "ripe", "berry": "unripe", "peduncle": "stem"})
    found = finder.find(shown)
    assert [region.kind for region in found.regions] == ["ripe", "unripe", "stem"]
    assert (found.regions[0].pixels == left).all()
    assert not (found.regions[1].pixels & left).any()
    assert (found.regions[1].pixels | left == ball).all()
    with pytest.raises(InvalidRequestError, match="neither mask nor box"):
        ByDetector(lambda rgb: [Detected("ripe", 1.0)]).find(shown)
    with pytest.raises(InvalidRequestError, match="shape"):
        ByDetector(lambda rgb: [Detected("ripe", 1.0, mask=np.ones((2, 2), bool))]).find(shown)


def test_a_score_is_the_probability_of_ripeness_unless_the_detector_tells_one() -> None:
    shot = shot_of()
    mask = next(shot.masks == k for k, one in enumerate(shot.marked, 1) if one.kind == "ripe")
    for score, ripe, role in ((0.31, None, "pushable"), (0.9, None, "target"),
                              (0.31, 0.9, "target"), (0.9, 0.5, "pushable")):  # fmt: skip
        finder = ByDetector.of([Detected("ripe", score, mask=mask, ripe=ripe)])
        (fruit,) = look_at(shot.picture, up=shot.scene.up, finder=finder).detections
        assert (fruit.item.role, fruit.region.kind, fruit.region.score) == (role, "ripe", score)


@pytest.mark.parametrize(
    ("change", "told"),
    [({"counts": "abc", "size": [4, 4]}, "run lengths"), ([[1, 1]], "polygons"),
     ({"counts": [3, 3], "size": [4, 4]}, "not of 4 x 4 pixels")],
)  # fmt: skip
def test_masks_of_another_form_are_refused(change: object, told: str) -> None:
    thing = {"image_id": 1, "category_id": 1, "bbox": [0, 0, 2, 2], "segmentation": change}
    image = {"id": 1, "file_name": "a.rgb.png", "width": 4, "height": 4}
    document = {"images": [image], "categories": [{"id": 1, "name": "ripe"}]}
    good = {"counts": [4, 2, 10], "size": [4, 4]}
    given = {**document, "annotations": [{**thing, "segmentation": good, "score": 0.5}]}
    (one,) = of_coco(given, "own.json")["a"]
    assert (one.score, one.mask.nonzero()) == (0.5, (pytest.approx([0, 1]), pytest.approx([1, 1])))
    with pytest.raises(InvalidRequestError, match=told):
        of_coco({**document, "annotations": [thing]}, "own.json")


def test_a_detector_that_knows_the_truth_finds_what_is_round() -> None:
    """Flat shapes are no fruits: the measuring refuses them, whatever the detector says."""
    drawn = shapes(3)

    def detect(rgb: np.ndarray) -> list[Detected]:
        rows = [k for k, m in enumerate(drawn.marked, 1) if m.kind in ("ripe", "unripe")]
        return [Detected(drawn.marked[k - 1].kind, 0.9, mask=drawn.masks == k) for k in rows]

    sight = look_at(drawn.picture, finder=ByDetector(detect))
    assert sight.found.fruits
    assert len(sight.detections) < len(sight.found.fruits)


def test_the_shown_finder_of_rf_detr_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A file with the inputs and outputs of RF-DETR, that finds the same boxes in every picture."""
    onnx = pytest.importorskip("onnx")
    helper, shown = onnx.helper, picture()
    boxes = np.array([[[80 / 160, 60 / 120, 50 / 160, 50 / 120], [0.1, 0.1, 0.1, 0.1]]], np.float32)
    logits = np.array([[[2.0, -1.0, 3.0], [-4.0, -3.0, 2.0]]], np.float32)
    real = onnx.TensorProto.FLOAT
    graph = helper.make_graph(
        [helper.make_node("Constant", [], [name], value=onnx.numpy_helper.from_array(value))
         for name, value in (("dets", boxes), ("labels", logits))], "detr",
        [helper.make_tensor_value_info("input", real, [1, 3, 56, 56])],
        [helper.make_tensor_value_info(name, real, value.shape)
         for name, value in (("dets", boxes), ("labels", logits))],
    )  # fmt: skip
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=9)
    onnx.save(model, tmp_path / "rf-detr.onnx")
    page = (Path(__file__).parents[4] / "docs" / "eyes.md").read_text("utf-8")
    (block,) = (part for part in page.split("```") if "rf-detr.onnx" in part)
    (tmp_path / "own_rf_detr.py").write_text(block, "utf-8")
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    (found,) = finder_named("own_rf_detr:finder").find(shown).regions
    assert found.kind == "ripe"
    assert found.score == pytest.approx(1.0 / (1.0 + np.exp(-2.0)))
    assert (found.pixels == (shown.depth < 0.6)).all()


def test_finders_by_name() -> None:
    made = finder_named("tests.perception.finders:own")
    assert made.find(picture()).fruits == ()
    for name, words in (("colour", "valid are"), ("no.where:X", "cannot be loaded"),
                        ("numpy:pi", "no method")):  # fmt: skip
        with pytest.raises(InvalidRequestError, match=words):
            finder_named(name)
    with pytest.raises(InvalidRequestError, match="goes with the finder 'network'"):
        finder_named("geometry", "a.onnx")
