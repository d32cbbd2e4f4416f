"""The camera model is fitted to the eyes by a script."""

import numpy as np
import pytest
from tests.loaded import script as loaded

SEED = 60011


def test_the_fit_finds_the_numbers_that_made_the_looks() -> None:
    script = vars(loaded("fit_eyes"))
    rng = np.random.default_rng(1)
    fruits = []
    for seed in range(1500):
        hidden, kept = rng.random(), rng.standard_normal(3)
        for _ in range(2):
            found = rng.random() >= 0.05 + 0.85 * np.clip((hidden - 0.4) / 0.4, 0.0, 1.0)
            error = np.sqrt(0.6) * kept + np.sqrt(0.4) * rng.standard_normal(3)
            along, *across = error * [0.006, 0.003, 0.003] + [0.002, 0.0, 0.0]
            tilts = tuple(np.radians(4.0) * rng.standard_normal(2))
            if rng.random() > 0.8:
                tilts = np.nan, np.nan
            fruits.append(script["Observed"](
                ("cluster", seed, "a"), hidden, 0.4, found, along, tuple(across), tilts, 0.0
            ))  # fmt: skip
    given = script["Looked"](fruits, 2, 100, [0.1, 0.1], 0.9)
    made = script["fitted"](given, "beside")
    assert made.position == pytest.approx(0.003, rel=0.1)
    assert made.along == pytest.approx(2.0, rel=0.1)
    assert made.bias == pytest.approx(0.002, abs=0.0005)
    assert made.steady == pytest.approx(0.6, abs=0.1)
    assert made.missed == pytest.approx(0.05, abs=0.02)
    assert made.hidden == pytest.approx(0.9, abs=0.04)
    assert made.hidden_from == pytest.approx(0.4, abs=0.11)
    assert made.hidden_to == pytest.approx(0.8, abs=0.11)
    assert made.missed_steadily == pytest.approx(0.0, abs=0.15)
    assert made.angle == pytest.approx(4.0, rel=0.1)
    assert made.stem_seen == pytest.approx(0.8, abs=0.03)
    assert made.false == 0.02
    assert made.latency == 0.13
    with pytest.raises(ValueError, match="too few"):
        script["fitted"](given._replace(fruits=fruits[:5]), "beside")


@pytest.mark.slow  # pictures of two scenes, twice
def test_a_handful_of_pictures_is_fitted() -> None:
    script = vars(loaded("fit_eyes"))
    scenes = [("cluster", SEED), ("field", SEED)]
    seen = script["looked"](scenes, "beside")
    assert seen.pictures == 4
    made = script["fitted"](seen, "beside")
    assert 0.0001 < made.position < 0.006
    assert made.missed < 0.5
    eyes, model = (
        script["told"](f) for f in (seen.fruits, script["modelled"](scenes, "beside", made))
    )
    assert abs(eyes["recall"] - model["recall"]) < 0.35
