"""Half the extent of an object along a direction."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from optipromp.core.geometry import Box, Capsule, Cylinder, Ellipsoid, Sphere
from optipromp.core.scenes import SceneObject

SHAPES = Sphere(0.02), Box((0.1, 0.04, 0.02)), Cylinder(0.03, 0.12), Capsule(0.02, 0.08)
unit = st.tuples(*[st.floats(-1.0, 1.0)] * 3).filter(lambda v: np.linalg.norm(v) > 0.1)


@pytest.mark.parametrize("shape", SHAPES, ids=lambda shape: type(shape).__name__)
@given(axis=unit, turn=unit)
def test_it_is_that_of_the_mesh(shape, axis, turn):
    along, rotation = np.array(axis) / np.linalg.norm(axis), Rotation.from_rotvec(turn).as_matrix()
    item = SceneObject("n", "pushable", shape, np.zeros(3), rotation)
    inside = float(np.abs(shape.mesh(96).vertices @ rotation.T @ along).max())
    assert inside - 1e-9 <= item.extent(along) <= 1.02 * inside


def test_of_other_shapes_it_is_the_radius() -> None:
    """Never too small: a window that is too long asks for more, not for less."""
    item = SceneObject("n", "pushable", Ellipsoid((0.01, 0.02, 0.03)), np.zeros(3))
    assert item.extent(np.array([1.0, 0.0, 0.0])) == item.radius == 0.03
