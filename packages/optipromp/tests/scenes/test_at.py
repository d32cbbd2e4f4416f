"""A copy of an object at another position."""

from dataclasses import replace

import numpy as np
import pytest

from optipromp import Scene, load_scene, plan
from optipromp.core.errors import InvalidSceneError

SCENE = load_scene("scenario-4")


def test_a_fruit_is_moved_with_its_stem_and_stays_the_same_fruit() -> None:
    fruit = replace(SCENE.pushables[0], covariance=np.diag([1.0, 2.0, 3.0]) * 1e-6)
    moved = fruit.at([0.4, 0.1, 0.5])
    np.testing.assert_array_equal(moved.position, [0.4, 0.1, 0.5])
    by = moved.position - fruit.position
    np.testing.assert_allclose(moved.stem.points - fruit.stem.points, [by] * 2, atol=1e-15)
    assert moved.stem.length == pytest.approx(fruit.stem.length)
    same = "id", "role", "shape", "physical"
    assert all(getattr(moved, name) == getattr(fruit, name) for name in same)
    np.testing.assert_array_equal(moved.orientation, fruit.orientation)
    np.testing.assert_array_equal(moved.covariance, fruit.covariance)
    np.testing.assert_array_equal(fruit.position, SCENE.pushables[0].position)  # not changed


def test_a_crop_is_made_of_copies() -> None:
    fruit = SCENE.pushables[0]
    further = [fruit.at(fruit.position + [0.0, 0.3 + 0.1 * k, 0.0], f"far{k}") for k in range(3)]
    scene = replace(SCENE, objects=(*SCENE.objects, *further))
    assert isinstance(scene, Scene)
    assert [item.id for item in scene.pushables][-3:] == ["far0", "far1", "far2"]
    assert plan(scene).success


def test_what_is_no_position_is_refused() -> None:
    fruit = SCENE.pushables[0]
    with pytest.raises(InvalidSceneError, match=r"position has shape \(2,\)"):
        fruit.at([0.1, 0.2])
    with pytest.raises(InvalidSceneError, match=r"position\[1\] is nan"):
        fruit.at([0.1, np.nan, 0.2])
