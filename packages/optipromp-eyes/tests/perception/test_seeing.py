"""Pictures of scenes, and what is seen in them; through the command line."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from tests.cli.fixtures import invoke, refused, told
from tests.loaded import script
from tests.perception.shots import SEED, shot_of, written

from optipromp import load_scene
from optipromp_eyes import look_at, seen_scene
from optipromp_eyes.pictures import ENDS, load_picture
from optipromp_sim.generate import generate
from optipromp_sim.simulation.photograph import Photograph, StereoParameters, photograph, sensed

STUDY, COCO = script("studies/eyes"), script("coco")


@pytest.fixture(scope="module")
def pictures(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("pictures")
    told("render", "--preset", "cluster", "--seeds", f"{SEED}:{SEED + 1}", "--out", folder)
    return folder


@pytest.fixture(scope="module")
def shot() -> Photograph:
    return shot_of()


def test_from_a_picture_to_a_plan(pictures: Path, tmp_path: Path) -> None:
    (record,) = told("see", pictures, "--out", tmp_path)["pictures"]
    true, seen = load_scene(pictures / f"cluster-{SEED}.yaml"), load_scene(record["scene"])
    assert np.linalg.norm(seen.target.position - true.target.position) < 0.01
    assert len(seen.pushables) == len(true.pushables)
    assert seen.camera is not None
    assert all(item.covariance is not None for item in seen.pushables)
    overlay = np.asarray(Image.open(record["overlay"]))
    plain = np.asarray(Image.open(pictures / f"cluster-{SEED}.rgb.png"))
    assert overlay.shape == plain.shape
    assert (overlay != plain).any()
    assert told("plan", record["scene"])["status"] == "success"


def test_a_detector_that_ran_elsewhere_sees_by_its_file(pictures: Path, tmp_path: Path) -> None:
    """Boxes and masks of COCO; what has no score is sure, and what the file lacks is not there."""
    document = COCO.document(COCO.photographs(pictures))
    (ripe,) = (k["id"] for k in document["categories"] if k["name"] == "ripe")
    for each in document["annotations"]:
        each["score"] = 0.5 if each["category_id"] == ripe else 0.9
    (tmp_path / "found.json").write_text(json.dumps(document))
    words = "see", pictures, "--boxes", tmp_path / "found.json", "--out", tmp_path
    (record,) = told(*words, code=1)["pictures"]
    assert record["scene"] is None  # ripe with a probability of 0.5
    assert {fruit["score"] for fruit in record["fruits"]} == {0.5, 0.9}
    assert all(0.5 < fruit["fit"] <= 1.0 for fruit in record["fruits"])
    assert "--boxes goes without --finder" in refused(*words, "--finder", "geometry")
    kinds = [k["id"] for k in document["categories"] if k["name"] in ("ripe", "unripe")]
    fruits = [each for each in document["annotations"] if each["category_id"] in kinds]
    document["annotations"] = [{**each, "segmentation": None, "score": 0.9} for each in fruits]
    document["images"][0]["file_name"] = f"frames/cluster-{SEED}.JPG"
    (tmp_path / "found.json").write_text(json.dumps(document))
    (record,) = told(*words)["pictures"]
    assert any(fruit["stem_seen"] for fruit in record["fruits"])  # by its colour
    for key, field, message in (
        ("images", "file_name", f"has no image 'cluster-{SEED}', but ['kumquat']"),
        ("categories", "name", "the classes are ['kumquat']; rename its categories: ripe, unripe"),
    ):
        other = {**document, key: [{**each, field: "kumquat"} for each in document[key]]}
        (tmp_path / "found.json").write_text(json.dumps(other))
        assert message in told(*words, code=2)["message"]


def test_what_is_seen_is_of_the_crop_that_is_named(pictures: Path, tmp_path: Path) -> None:
    """The preset's fruits of 30 to 40 mm are strawberries, and no tomatoes."""
    others = {}
    for name in ("strawberry", "tomato"):
        (record,) = told("see", pictures, "--crop", name, "--out", tmp_path / name)["pictures"]
        assert load_scene(record["scene"]).crop.name == name
        others[name] = [words for words in record["assumed"] if "of another width" in words]
    assert others["strawberry"] == []
    assert "of another width than a tomato, 60 mm: " in others["tomato"][0]


def test_files_of_one_picture_give_the_scene_of_the_folder(pictures: Path, tmp_path: Path) -> None:
    name = pictures / f"cluster-{SEED}"
    told("see", pictures, "--out", tmp_path)
    picture = load_picture(*(Path(f"{name}{end}") for end in ENDS))
    np.savez(tmp_path / "depth.npz", depth=picture.depth)
    told(
        "see", "--rgb", f"{name}.rgb.png", "--depth", tmp_path / "depth.npz", "--camera",
        f"{name}.camera.json", "--known", f"{name}.yaml", "--out", tmp_path / "one.yaml",
    )  # fmt: skip
    one = (tmp_path / "one.yaml").read_text()
    assert one.replace("one.solids", f"{name.name}.solids") == (
        (tmp_path / f"{name.name}.yaml").read_text()
    )


def test_the_same_seed_gives_the_same_picture_and_another_seed_another(shot: Photograph) -> None:
    again = photograph(generate("cluster", SEED), seed=SEED)
    assert (again.picture.rgb == shot.picture.rgb).all()
    assert (again.picture.depth == shot.picture.depth).all()
    other = photograph(generate("cluster", SEED), seed=SEED + 1)
    assert (other.picture.rgb != shot.picture.rgb).mean() > 0.5


def test_masks_and_depth_are_where_the_fruits_are(shot: Photograph) -> None:
    camera = shot.picture.camera
    for mark in shot.marked:
        if mark.kind in ("ripe", "unripe") and mark.share > 0.9:
            item = shot.fruits[mark.id]
            local = camera.pose.inverse() @ item.position
            column, row = np.rint(camera.pixels(local)).astype(int)
            mask = shot.mask(mark.id, mark.kind)
            assert mask[row, column]
            assert shot.true_depth[row, column] == pytest.approx(local[2] - item.radius, abs=0.003)


def test_eyes_find_what_the_truth_says(shot: Photograph) -> None:
    figures = STUDY.figures([STUDY.compared(shot)])
    assert figures["recall"] == 1.0
    assert figures["false"] == 0
    assert figures["kind_right"] == 1.0
    assert figures["center_90_mm"] < 8.0
    assert figures["angle_mean_deg"] < 8.0


def test_a_palm_camera_sees_what_is_below_the_target() -> None:
    figures = STUDY.figures([STUDY.compared(photograph(generate("cluster", SEED), "palm", SEED))])
    assert figures["visible"] >= 2
    assert figures["recall"] == 1.0
    assert figures["center_90_mm"] < 10.0


def test_an_unseen_stem_is_upright_and_said(shot: Photograph) -> None:
    sight = look_at(shot.picture, up=shot.scene.up)
    bare = tuple(replace(item, stem=None) for item in sight.look.detections)
    sight = replace(sight, look=replace(sight.look, detections=bare))
    scene, assumed = seen_scene(sight, shot.scene)
    assert any("stem not seen" in words for words in assumed)
    for item in (*scene.pushables, scene.target):
        assert item.stem.unseen
        assert item.stem.vector @ scene.up > 0.7 * item.stem.length


def test_stereo_errors_are_as_large_as_said() -> None:
    depth = np.full((120, 160), 0.45)
    given = StereoParameters(scale=0.0, holes=0.0)
    measured = sensed(depth, 480.0, given, np.random.default_rng(0))
    expected = 0.45**2 * given.subpixel / (480.0 * given.baseline)
    assert measured.std() == pytest.approx(expected, rel=0.1)
    depth[:, 80:] = 0.30
    measured = sensed(depth, 480.0, given, np.random.default_rng(0))
    hidden = round(480.0 * given.baseline * (1 / 0.30 - 1 / 0.45))
    assert (measured[:, 80 - hidden + 3 : 77] == 0.0).mean() > 0.9


def test_pictures_round_trip(shot: Photograph, tmp_path: Path) -> None:
    read = load_picture(*(written(tmp_path, a=shot.picture) / f"a{end}" for end in ENDS))
    assert (read.rgb == shot.picture.rgb).all()
    assert np.abs(read.depth - shot.picture.depth).max() <= 0.5e-4 + 1e-12
    assert read.camera.pose.position == pytest.approx(shot.picture.camera.pose.position)


@pytest.mark.parametrize(
    ("words", "why"),
    [(["see"], "--rgb"), (["see", "nowhere"], "no such folder"), (["see", "."], "no pictures"),
     (["see", "--rgb", "a.png"], "--depth and --camera"),
     (["render", "--out", "o"], "--preset"), (["render", "scenario-3", "--preset", "field",
      "--out", "o"], "one of them"),
     (["render", "scenario-3", "--seeds", "3", "--out", "o"], "0:10")],
)  # fmt: skip
def test_what_is_asked_wrongly_is_said(
    words: list[str], why: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert why in refused(*words)


def test_see_tells_what_it_doubts(tmp_path: Path) -> None:
    shown = shot_of(SEED + 1).picture
    late = replace(shown, depth=np.roll(shown.depth, 18, 1))
    folder = written(tmp_path, late=late)
    (record,) = told("see", folder, code=1)["pictures"]
    assert any("not registered to the colours" in doubt for doubt in record["doubts"])
    assert "doubt: edges of depth lie" in " ".join(invoke("see", folder).stdout.split())


@pytest.mark.parametrize(
    ("factor", "said"),
    [(0.0, "the depth is 0 at every pixel: nothing was measured"),
     (0.25, "with 4 times these, 1 ripe are seen: compare the unit of depth"),
     (10.0, "with 0.1 times these, 1 ripe are seen: compare the unit of depth")],
)  # fmt: skip
def test_depths_in_other_units_are_named_where_no_fruit_is_seen(
    factor: float, said: str, shot: Photograph, tmp_path: Path
) -> None:
    picture = shot.picture
    np.savez(tmp_path / "a.npz", depth=factor * picture.depth)
    rgb, _, camera = (written(tmp_path, a=picture) / f"a{end}" for end in ENDS)
    words = "see", "--rgb", rgb, "--depth", tmp_path / "a.npz", "--camera", camera
    (record,) = told(*words, code=1)["pictures"]
    assert record["scene"] is None
    assert record["message"].startswith("no ripe fruit is seen")
    assert said in record["message"]
