"""A little mutated input at each door; ``scripts/fuzz.py --doors`` gives as much as one likes.

The camera's door stands for all in the ordinary suite; the others are tried once a landing.
"""

import warnings
from pathlib import Path
from random import Random

import pytest
from tests.fuzzing.doors import DOORS, camera, depth_array, picture_file

COUNT = 12
FEW = {"network": 2, "answers": 4, "bench_zip": 4, "bench_run": 4, "episode_options": 4}


@pytest.mark.parametrize(
    "make",
    [pytest.param(m, marks=() if m is camera else pytest.mark.slow) for _, m in DOORS],
    ids=lambda make: make.__name__,
)
def test_what_comes_through_a_door_is_refused_or_right(make, tmp_path, monkeypatch):
    for k in range(FEW.get(make.__name__, COUNT)):
        folder = tmp_path / str(k)
        folder.mkdir()
        monkeypatch.chdir(folder)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            assert make(Random(k)).run(folder).split()[0] in ("error", "success")


@pytest.mark.slow
@pytest.mark.parametrize("make", [camera, depth_array, picture_file])
def test_some_of_it_is_right(make, tmp_path: Path) -> None:
    """Else a door refuses whatever comes, and the hunt sees nothing behind it."""
    outcomes = []
    for k in range(60):
        folder = tmp_path / str(k)
        folder.mkdir()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            outcomes.append(make(Random(f"right:{k}")).run(folder))
    assert outcomes.count("success") >= 3
