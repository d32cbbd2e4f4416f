"""Pictures with leaves, and abstract shapes."""

import numpy as np
import pytest
from tests.loaded import script

from optipromp_sim.generate import generate
from optipromp_sim.simulation.photograph import PhotoParameters, photograph

shapes = script("shapes").shapes

SMALL = PhotoParameters(width=160, height=120, focal=120.0)


def shot(seed, looks="rich"):
    return photograph(generate("wild", seed), "beside", seed, SMALL, looks=looks)


def kinds(picture):
    seen = np.unique(picture.masks)
    return {each.kind for k, each in enumerate(picture.marked, start=1) if k in seen}


def test_rich_pictures_have_leaves_and_repeat():
    one, again, plain = shot(65_100), shot(65_100), shot(65_100, "plain")
    np.testing.assert_array_equal(one.picture.rgb, again.picture.rgb)
    np.testing.assert_array_equal(one.masks, again.masks)
    np.testing.assert_array_equal(one.picture.depth, again.picture.depth)
    assert {"ripe", "unripe", "calyx", "stem", "leaf", "other"} <= kinds(one)
    assert "leaf" not in kinds(plain)
    np.testing.assert_array_equal(
        one.picture.camera.pose.position, plain.picture.camera.pose.position
    )


@pytest.mark.slow  # eight photographs
def test_a_third_of_the_stems_ends_is_visible():
    visible, count = 0, 0
    for seed in range(65_100, 65_108):
        taken = shot(seed)
        camera = taken.picture.camera
        for item in taken.scene.objects:
            (x, y) = np.rint(camera.pixels(camera.pose.inverse() @ item.stem.root)).astype(int)
            near = taken.mask(item.id, "stem")[max(y - 1, 0) : y + 2, max(x - 1, 0) : x + 2]
            visible, count = visible + bool(x >= 0 and y >= 0 and near.any()), count + 1
    assert 0.2 < visible / count < 0.45  # StrawDI: 0.33


def test_shapes_have_their_truth_and_repeat():
    found = set()
    for seed in range(8):
        one, again = shapes(seed), shapes(seed)
        np.testing.assert_array_equal(one.picture.rgb, again.picture.rgb)
        np.testing.assert_array_equal(one.masks, again.masks)
        found |= kinds(one)
        for row, each in enumerate(one.marked, start=1):
            mask = one.masks == row
            if each.kind not in ("ripe", "unripe"):
                continue
            depths = one.picture.depth[mask & (one.picture.depth > 0.0)]
            if len(depths) > 30:  # flat
                assert np.subtract(*np.quantile(depths, [0.75, 0.25])) < 0.03
    assert found == {"ripe", "unripe", "calyx", "stem", "leaf", "other"}
    assert not np.array_equal(shapes(1).picture.rgb, shapes(2).picture.rgb)
