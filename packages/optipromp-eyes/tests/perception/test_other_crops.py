"""Eyes for other crops: their files, by name and of one's own; through the command line."""

import json
from pathlib import Path

import pytest
from tests.cli.fixtures import invoke
from tests.perception.shots import written

from optipromp.core.errors import InvalidRequestError, OptiPrompError
from optipromp.core.scenes.crops import crop_names, crop_to_dict, load_crop
from optipromp_eyes import EyeParameters, eyes_of
from optipromp_sim.generate import generate
from optipromp_sim.simulation.photograph import photograph


@pytest.fixture(scope="module")
def tomatoes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Pictures of tomatoes that are 47 to 76 mm wide."""
    scenes = (generate("cluster", seed, crop=load_crop("tomato")) for seed in (300, 303))
    a, b = (photograph(scene, seed=300).picture for scene in scenes)
    return written(tmp_path_factory.mktemp("tomatoes"), a=a, b=b)


def found(*words: object) -> int:
    """How many fruits ``see`` finds, in scenes or without one."""
    done = invoke("see", *words, "--json")
    assert done.exit_code in (0, 1), done.output
    return sum(len(each["fruits"]) for each in json.loads(done.stdout)["pictures"])


def test_tomatoes_are_seen_with_their_own_sizes(tomatoes: Path, tmp_path: Path) -> None:
    """Of 8 fruits in two pictures; wider than 56 mm are no strawberries, which eyes expect."""
    assert found(tomatoes, "--known", "scenario-3", "--out", tmp_path / "a") <= 3
    for option in ("--crop", "--eyes"):
        words = ("--known", "scenario-3", option, "tomato", "--out", tmp_path / option)
        assert found(tomatoes, *words) >= 7


def test_a_file_of_the_eyes_goes_before_the_crop_and_the_crop_before_what_is_usual(
    tmp_path: Path,
) -> None:
    own = tmp_path / "eyes.yaml"
    own.write_text("ripe_hue: 55\n")
    tomato, usual = load_crop("tomato"), EyeParameters()
    assert eyes_of(None) == usual
    told = eyes_of(tomato, own)
    assert (told.ripe_hue, told.green_hue) == (55.0, tomato.eyes["green_hue"])
    assert (told.radius, told.stem_length) == (0.03, tomato["stem_length"])
    assert told.least_radius == usual.least_radius < told.radius < 0.038 < told.most_radius


def test_a_crop_file_carries_its_eyes_through_a_scene(tmp_path: Path) -> None:
    file = tmp_path / "yellow.yaml"
    file.write_text("name: yellow\nlike: tomato\neyes: {ripe_hue: 55, source: by eye}\n")
    crop = load_crop(file)
    assert crop.eyes == {**load_crop("tomato").eyes, "ripe_hue": 55.0, "source": "by eye"}
    assert load_crop(crop_to_dict(crop)) == crop
    assert eyes_of(crop) == eyes_of(None, file)


@pytest.mark.parametrize("name", crop_names())
def test_the_eyes_of_every_crop_that_ships_are_in_range_and_have_a_source(name: str) -> None:
    crop = load_crop(name)
    p, width = eyes_of(crop), crop.rows["width"]
    assert p.least_radius < 0.5 * width.value - width.spread
    assert 0.5 * width.value + width.spread < p.most_radius
    assert not crop.eyes or crop.eyes["source"]


@pytest.mark.parametrize(
    ("text", "told"),
    [("ripe_heu: 5", "ripe_heu.*did you mean 'ripe_hue'"), ("ripe_hue: red", "must be a number"),
     ("ripe_hue: 400", "at most 360"), ("ripe_dye: 50", "ripe_dye is 50.*at most 1 "),
     ("tilt: 0", "tilt is 0; must be above 0"), ("radius: 35", "[.]radius is 35; must be at most"),
     ("least_radius: 0.02", "between least_radius and most_radius, 0.02"),
     ("name: a\nlike: tomato\neyes: {ripe_heu: 5}", "eyes of a: .*did you mean 'ripe_hue'"),
     ("name: a\neyes: {ripe_hue: 5}", "width is missing"), ("[1, 2]", "must be a mapping")],
)  # fmt: skip
def test_wrong_eyes_are_refused_by_name_and_range(text: str, told: str, tmp_path: Path) -> None:
    file = tmp_path / "eyes.yaml"
    file.write_text(text)
    with pytest.raises(OptiPrompError, match=told):
        eyes_of(None, file)


def test_an_unknown_crop_is_refused_with_those_that_ship() -> None:
    with pytest.raises(InvalidRequestError, match=r"'tomatto'.*did you mean 'tomato'"):
        eyes_of(None, "tomatto")
