"""The network of the eyes: its grouping, its file, and what it finds in a picture."""

from dataclasses import replace
from importlib import resources
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.loaded import script
from tests.perception.shots import shot_of

from optipromp.core.arrays import FloatArray, IntArray
from optipromp_eyes import ByNetwork
from optipromp_eyes.network import CLASSES, SCALE, depths_seen, encoded, grouped
from optipromp_sim.simulation.photograph import Photograph

STUDY = script("studies/eyes")

SEED = 60012
MOST = 5_000_000  # bytes of a file of weights: what a package may carry
WEIGHTS = sorted(Path(str(resources.files("optipromp_eyes") / "data")).glob("*.onnx"))


@pytest.fixture(scope="module")
def shot() -> Photograph:
    return shot_of(SEED)


def answer(owner: IntArray, noise: float, seed: int) -> tuple[FloatArray, FloatArray]:
    """Probabilities and offsets of a network that knows fruits, but for noise [pixel]."""
    sure = np.full((len(CLASSES), *owner.shape), 0.02)
    sure[1] = np.where(owner > 0, 0.88, 0.02)
    sure[0] = np.where(owner > 0, 0.02, 0.88)
    offsets = noise * np.random.default_rng(seed).standard_normal((2, *owner.shape))
    for k in range(1, owner.max() + 1):
        rows, columns = np.nonzero(owner == k)
        if len(rows):
            offsets[0, rows, columns] += 0.5 * (columns.min() + columns.max()) - columns
            offsets[1, rows, columns] += 0.5 * (rows.min() + rows.max()) - rows
    return sure, offsets


disc = st.tuples(st.integers(15, 105), st.integers(15, 145), st.integers(6, 14))


@settings(deadline=None, max_examples=40)
@given(discs=st.lists(disc, max_size=6), noise=st.floats(0.0, 1.0), seed=st.integers(0, 99))
def test_fruits_that_touch_are_parted_by_their_votes(
    discs: list[tuple[int, int, int]], noise: float, seed: int
) -> None:
    rows, columns = np.indices((120, 160))
    owner = np.zeros((120, 160), dtype=np.int64)
    kept: list[tuple[int, int, int]] = []
    for r, c, radius in discs:  # that overlap by a fifth of the smaller at most
        if all(
            np.hypot(r - a, c - b) > radius + other - 0.2 * min(radius, other)
            for a, b, other in kept
        ):
            kept.append((r, c, radius))
            owner[(np.hypot(rows - r, columns - c) <= radius) & (owner == 0)] = len(kept)
    found = grouped(*answer(owner, noise, seed))
    assert found.max(initial=0) == len(kept)
    assert not found[owner == 0].any()
    for k in range(1, len(kept) + 1):
        mine = np.bincount(found[owner == k], minlength=1)
        best = int(mine.argmax())
        assert best > 0
        assert mine[best] >= 0.97 * (owner == k).sum()
        assert (owner[found == best] == k).mean() >= 0.97


def test_a_fruit_that_a_stem_cuts_in_two_stays_one() -> None:
    rows, columns = np.indices((60, 80))
    whole = np.hypot(rows - 30, columns - 40) <= 12
    owner = np.where(whole & (np.abs(columns - 42) > 1), 1, 0)
    found = grouped(*answer(owner, 0.5, 0))
    assert (found == owner).mean() > 0.999
    assert found.max() == 1


def test_weights_are_small_enough_to_ship() -> None:
    assert WEIGHTS
    for file in WEIGHTS:
        assert file.stat().st_size < MOST, f"{file.name} is too large for a package"


def test_what_the_network_is_shown() -> None:
    rgb = np.full((2, 3, 3), 255, dtype=np.uint8)
    depth = np.array([[0.3, 0.6, 0.0], [0.0, 3.0, 0.05]])
    seen = encoded(rgb, depth, 0.3 * SCALE)
    assert seen.shape == (5, 2, 3)
    assert seen[:3] == pytest.approx(0.5)
    assert seen[3] == pytest.approx(np.array([[1.0, 0.5, 0.0], [0.0, 0.1, 4.0]]))  # 4 at most
    assert (seen[4] == [[0, 0, 1], [1, 0, 0]]).all()


def test_the_shipped_network_finds_the_fruits_of_a_picture(shot: Photograph) -> None:
    finder = ByNetwork()
    told = STUDY.figures([STUDY.compared(shot, finder)])
    assert told["visible"] >= 2
    assert told["recall"] == 1.0
    assert told["false"] == 0
    assert told["ripe_right"] == 1.0  # of all fruits few are ripe: kind_right tells little
    assert told["kind_right"] == 1.0
    assert told["center_90_mm"] < 10.0
    found = finder.find(shot.picture)
    scores = [region.score for region in found.fruits]
    assert scores == sorted(scores, reverse=True)
    shown = sum(region.pixels.astype(int) for region in found.fruits)
    assert shown.max() == 1  # no pixel is of two fruits
    (stems,) = found.stems
    truth = np.isin(shot.masks, [k for k, m in enumerate(shot.marked, 1) if m.kind == "stem"])
    assert (stems.pixels & truth).sum() > 0.3 * truth.sum()
    again = finder.find(shot.picture)
    assert all(
        (a.pixels == b.pixels).all() for a, b in zip(found.regions, again.regions, strict=True)
    )


def test_another_size_of_picture_is_as_good(shot: Photograph) -> None:
    """Regions lie at the picture's own pixels, whatever the network sees."""
    half = shot.picture
    camera = replace(
        half.camera, width=half.camera.width // 2, height=half.camera.height // 2,
        fx=half.camera.fx / 2, fy=half.camera.fy / 2, cx=(half.camera.cx - 0.5) / 2,
        cy=(half.camera.cy - 0.5) / 2,
    )  # fmt: skip
    small = replace(half, rgb=half.rgb[1::2, 1::2], depth=half.depth[1::2, 1::2], camera=camera)
    large, little = ByNetwork().find(half).fruits, ByNetwork().find(small).fruits
    assert len(large) == len(little)
    for a in large:  # the order is of scores, which differ a little
        shares = [
            (a.pixels[1::2, 1::2] & b.pixels).sum() / (a.pixels[1::2, 1::2] | b.pixels).sum()
            for b in little
        ]
        assert max(shares) > 0.8


@pytest.mark.parametrize("factor", [0.6, 1.4])
def test_a_fruit_is_as_large_for_the_network_whatever_the_lens(
    shot: Photograph, factor: float
) -> None:
    """The same pixels by a lens of another focal length, from another distance."""
    camera = shot.picture.camera
    moved = replace(
        shot.picture, depth=factor * shot.picture.depth,
        camera=replace(camera, fx=factor * camera.fx, fy=factor * camera.fy),
    )  # fmt: skip
    first, second = (ByNetwork().find(picture).fruits for picture in (shot.picture, moved))
    assert len(first) == len(second)
    for a, b in zip(first, second, strict=True):
        assert (a.pixels == b.pixels).all()


def test_fruits_far_apart_in_depth_are_seen_at_two_scales(shot: Photograph) -> None:
    depth = shot.picture.depth.copy()
    assert len(depths_seen(shot.picture)) == 1
    depth[:, depth.shape[1] // 2 :] *= 0.3
    low, high = depths_seen(replace(shot.picture, depth=depth))
    assert low < 0.6 * high


def test_a_picture_of_nothing_has_no_fruits(shot: Photograph) -> None:
    bare = replace(
        shot.picture, rgb=np.full_like(shot.picture.rgb, 90),
        depth=np.zeros_like(shot.picture.depth),
    )  # fmt: skip
    assert ByNetwork().find(bare).fruits == ()
