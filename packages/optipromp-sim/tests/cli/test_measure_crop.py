"""``optipromp measure-crop``: what a ruler, a kitchen scale and a phone say of a crop."""

import math
from pathlib import Path

import pytest
from tests.cli.fixtures import refused, told

from optipromp.core.scenes.crops import load_crop

TABLE = """width,length,mass,stem_length,stem_diameter,sag_load,sag,swings,swing_first,swing_last
31,42,19,120,2.4,5,18,5,30,1.2
29,40,16,140,2.5,5,22,5,28,1.0
34,45,24,,,,,,,
"""


def test_a_table_of_measurements_becomes_a_crop(tmp_path: Path) -> None:
    (tmp_path / "fruits.csv").write_text(TABLE)
    out = tmp_path / "mine.yaml"
    pulls = "pull_along=520,480,610", "pull_across=310,280"
    document = told("measure-crop", tmp_path / "fruits.csv", *pulls, "--out", out)
    crop, usual = load_crop(out), load_crop("strawberry")
    assert crop["width"] == pytest.approx((0.031 + 0.029 + 0.034) / 3.0)
    assert crop.rows["width"].spread == pytest.approx(0.00251661, rel=1e-5)
    assert crop.rows["width"].source == "measured, n = 3: width"
    fruits = ((0.031, 0.042, 0.019), (0.029, 0.040, 0.016), (0.034, 0.045, 0.024))
    density = [mass / (math.pi / 6.0 * long * wide**2) for wide, long, mass in fruits]
    assert crop["density"] == pytest.approx(sum(density) / 3.0)
    # tip of a beam: sag = F L³ / 3EI, of a round stem: I = π d⁴ / 64
    stems = ((0.120, 0.0024, 0.018), (0.140, 0.0025, 0.022))
    beams = [0.005 * 9.81 * b**3 / (3.0 * sag) / (math.pi * d**4 / 64.0) for b, d, sag in stems]
    assert crop["stem_modulus"] == pytest.approx(sum(beams) / 2.0)
    falls = [math.log(ratio) / 5.0 for ratio in (30.0 / 1.2, 28.0)]
    ratios = [fall / math.hypot(2.0 * math.pi, fall) for fall in falls]
    assert crop["damping_ratio"] == pytest.approx(sum(ratios) / 2.0)
    assert crop.rows["abscission"].values == pytest.approx((0.53667 * 9.81, 0.295 * 9.81), rel=1e-4)
    assert crop.rows["damping_ratio"].source.startswith("measured, n = 2")
    assert crop.rows["grip_force"] == usual.rows["grip_force"]
    assert document["guesses"] == [
        "pressed_force", "pressed_time", "edge_force", "abscission_moment"
    ]  # fmt: skip
    assert document["measured"]["stem_modulus"]["value"] == crop["stem_modulus"]


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ("width=0.031", "in mm and g: width: 3.1e-05 m is out of range: must be 0.004 to 0.4 m"),
        ("width=31,30 length=40", "numbers of measurements differ: length 1, width 2"),
        (
            "width=31 length=40 mass=300",
            "density: 14905.2 kg/m^3 is out of range: must be 100 to 1500 kg/m^3",
        ),
        ("swings=3 swing_first=9 swing_last=9.5", "must be, as swings die out"),
        ("stem_length=50 stem_diameter=2 sag_load=5 sag=20", "hang a lighter weight"),
        ("widht=31", "did you mean 'width'?"),
        ("nowhere.csv", "nowhere.csv"),
    ],
)
def test_nonsense_is_refused_with_its_unit(tmp_path: Path, given: str, words: str) -> None:
    out = tmp_path / "mine.yaml"
    assert words in refused("measure-crop", *given.split(), "--out", out)
    assert not out.exists()
